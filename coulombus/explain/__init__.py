"""Diagnose a CANopen bus: from a log or a live bus to incidents with cause and remedy."""
