"""What a device says of itself: the EDS and DCF reader, CiA's tables, PDO layout and codec."""
