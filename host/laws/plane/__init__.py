"""Friction laws in the plane: force and motion are vectors; one file a law, and how they are loaded."""
