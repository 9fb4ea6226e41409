"""Replay recordings: on a bus, through the host, in the virtual rig."""
