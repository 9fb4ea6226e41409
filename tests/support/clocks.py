"""Time for code against the wall clock, which passes only while that code sleeps."""

from __future__ import annotations

__all__ = ["Clock"]


class Clock:
    """What the module `time` is to the code under test."""

    def __init__(self, ns=0):
        self.ns = ns

    def monotonic_ns(self):
        return self.ns

    def monotonic(self):
        return self.ns * 1e-9

    def sleep(self, seconds):
        self.ns += round(seconds * 1e9)
