"""The simulated rig: the plant's physics, the operator's hand."""
