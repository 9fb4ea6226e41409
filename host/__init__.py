"""The host on the rig's PC: bring-up, cycle, laws, data plane and run."""
