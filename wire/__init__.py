"""How frames move: the frame, exact lengths on the wire, recordings."""
