"""A run from arming to its safe end: dead man's switch, control socket, buses, result."""
