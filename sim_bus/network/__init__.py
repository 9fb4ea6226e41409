"""Bus, nodes and rig in virtual time."""
