"""Export recordings for other programs: tables of signals, logs of frames."""
