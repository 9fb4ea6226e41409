"""The data plane: the process that runs the cycle in real time."""
