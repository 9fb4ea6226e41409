"""The theory: the sampled loop, its describing functions, bounds and exact motions."""
