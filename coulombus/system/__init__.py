"""Operating system services: file locks, private folders, signals, real-time settings. It imports nothing else of ours."""
