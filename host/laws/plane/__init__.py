"""Friction laws in the plane, with force and motion as vectors: one file for each law, and their loading."""
