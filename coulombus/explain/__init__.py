"""What went wrong on a CANopen bus: a log or a live bus in, incidents with cause and remedy out."""
