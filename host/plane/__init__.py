"""Friction in the plane on two joints: the force of a law shared out over brakes and motors; no bus, no file."""
