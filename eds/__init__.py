"""What a device says of itself: the reader of EDS, DCF, XDD and XDC, CiA's tables, PDO layout and codec."""
