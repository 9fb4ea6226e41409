"""Sweeps: plan, execute, store and evaluate many runs with different rigs and hands."""
