"""What is on the wire and what it means: EDS files and their reader, PDO layout and codec, CiA tables, the rig file."""
