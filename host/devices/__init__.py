"""Services for devices that no rig file describes yet: find, number, read, write, start them."""
