"""Draft a rig file from EDS files and answering devices, for `coulombus init`."""
