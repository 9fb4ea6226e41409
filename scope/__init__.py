"""Look at traffic: recordings by signal name in SI units, decoded frame by frame."""
