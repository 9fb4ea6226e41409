"""The data plane: the cycle's process against the wall clock."""
