"""Linux's flags in the 32 bits of a CAN identifier (``linux/can.h``). This
file imports nothing, so that tools may know them without the compiler.
"""

__all__ = ["CAN_EFF_FLAG", "CAN_ERR_FLAG", "CAN_RTR_FLAG"]

CAN_EFF_FLAG = 0x80000000
"""Extended: 29 bits of identifier."""
CAN_RTR_FLAG = 0x40000000
"""A remote frame."""
CAN_ERR_FLAG = 0x20000000
"""Not a frame of the bus but an error message of its controller (``linux/can/error.h``)."""
