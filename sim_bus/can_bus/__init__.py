"""The wire bit by bit: arbitration, errors, fault confinement, the cut cable."""
