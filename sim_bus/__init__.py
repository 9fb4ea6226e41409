"""The virtual CAN bus with its nodes, rig and faults."""
