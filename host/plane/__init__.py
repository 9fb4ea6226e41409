"""Friction in the plane on two joints: split of a law's force between brakes and motors, without bus or file."""
