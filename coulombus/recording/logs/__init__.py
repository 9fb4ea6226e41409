"""Readers of other tools' logs, a module for each format; each tells every row that it leaves out."""
