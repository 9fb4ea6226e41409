"""PDO maps of a bus or log without a rig."""
