"""The CAN bus bit by bit: arbitration, errors, fault confinement, the cut cable."""
