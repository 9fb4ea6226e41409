"""The rig through its PDOs: identification, hold, maps of stability."""
