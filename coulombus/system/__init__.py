"""Operating system services: file locks, private folders, signals, real-time settings; independent of all else here."""
