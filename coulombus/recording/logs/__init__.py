"""Readers of other tools' logs, a module per format; each reports every row that it omits."""
