"""The fault file, and its faults on the bus."""
