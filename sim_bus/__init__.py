"""The virtual CAN bus and the simulated rig: arbitration, the plant's physics, the operator's hand."""
