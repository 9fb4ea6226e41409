"""Live view of a bus: decode, monitor and describe frames."""
