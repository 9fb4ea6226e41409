"""What a study came to: thresholds and magnitudes with intervals, and pictures."""
