"""Transport of frames: the frame and its exact length, addresses, sockets, the client, python-can's plugin."""
