"""The course of a run: dead man's switch, stop, buses, result."""
