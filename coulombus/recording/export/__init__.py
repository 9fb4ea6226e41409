"""What other programs read, made of a recording: tables of its signals, logs of its frames."""
