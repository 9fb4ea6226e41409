"""Services for devices without a rig file: scan, LSS, SDO access, NMT commands."""
