"""Linux's flags in the 32 bits of a CAN identifier (``linux/can.h``), and its priority.

Imports nothing, so that tools can use it without the compiler.
"""

__all__ = ["CAN_EFF_FLAG", "CAN_ERR_FLAG", "CAN_RTR_FLAG", "arbitration_key"]

CAN_EFF_FLAG = 0x80000000
"""Extended frame: 29 bits of identifier."""
CAN_RTR_FLAG = 0x40000000
"""Remote frame."""
CAN_ERR_FLAG = 0x20000000
"""Error message of the controller, not a frame of the bus (``linux/can/error.h``)."""


def arbitration_key(can_id: int) -> int:
    """Return the arbitration field as a number: the lower number wins the bus.

    The bits of the field in their order on the wire, 32 of them: base identifier
    (11), RTR or SRR, IDE, identifier extension (18), RTR (ISO 11898-1).
    """
    if can_id & CAN_EFF_FLAG:
        base = (can_id >> 18) & 0x7FF
        remote = 1 if can_id & CAN_RTR_FLAG else 0
        return (base << 21) | (0b11 << 19) | ((can_id & 0x3FFFF) << 1) | remote
    remote = 1 if can_id & CAN_RTR_FLAG else 0
    return ((can_id & 0x7FF) << 21) | (remote << 20)
