"""What a device says of itself: readers of EDS, DCF, XDD, XDC; CiA's tables, PDO layout, codec."""
