"""Friction from a recording of strokes: samples, equations, fit."""
