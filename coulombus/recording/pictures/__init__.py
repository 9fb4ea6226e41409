"""Plots of recordings, and the common style of all figures."""
