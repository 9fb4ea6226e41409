"""Linux's flags in the 32 bits of a CAN identifier (``linux/can.h``).

Imports nothing, so that tools can use it without the compiler.
"""

__all__ = ["CAN_EFF_FLAG", "CAN_ERR_FLAG", "CAN_RTR_FLAG"]

CAN_EFF_FLAG = 0x80000000
"""Extended frame: 29 bits of identifier."""
CAN_RTR_FLAG = 0x40000000
"""Remote frame."""
CAN_ERR_FLAG = 0x20000000
"""Error message of the controller, not a frame of the bus (``linux/can/error.h``)."""
