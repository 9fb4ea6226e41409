"""Device descriptions: readers of EDS, DCF, XDD and XDC files; CiA's tables, PDO layouts, codec."""
