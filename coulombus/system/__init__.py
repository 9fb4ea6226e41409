"""Operating system services: file locks, private folders, signals, real-time settings, quoting.

The package imports nothing else of this project.
"""
