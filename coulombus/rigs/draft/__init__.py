"""A rig file for devices that nobody has described yet: what `coulombus init` writes."""
