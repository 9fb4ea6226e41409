"""PDO maps of a bus or log of which no rig is known."""
