"""The fault file, and the injection of its faults on the bus."""
