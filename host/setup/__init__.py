"""Bring-up over SDO, and the control plane."""
