"""Recordings: pcapng and other tools' logs, signals by name in SI units, measures of a display."""
