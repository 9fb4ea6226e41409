"""Converters behind a node's objects: Linux IIO, PWM, counters, a Python class (``coulombus node --io``)."""
