"""The sender of a recorded frame: a node, or the host.

It follows from the identifier, by the rig or by CiA 301's predefined connection set.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import CobId
from coulombus.recording.reading import blocks
from coulombus.rigs.rig import Rig, RigError, load_rig
from coulombus.wire.frame import CAN_RTR_FLAG

__all__ = ["HOST", "rig_of", "senders"]

HOST, NOBODY = 0, -1
FROM_NODES = (
    *(CobId.EMCY, CobId.TPDO1, CobId.TPDO2, CobId.TPDO3, CobId.TPDO4),
    *(CobId.SDO_TX, CobId.HEARTBEAT),
)
"""Function codes of a node's frames: EMCY, TPDO1 to 4, SDO response, heartbeat (CiA 301, 7.3.3).
"""
TO_NODES = (CobId.RPDO1, CobId.RPDO2, CobId.RPDO3, CobId.RPDO4, CobId.SDO_RX)
"""RPDO1 to 4, SDO request."""


def senders(can_ids: npt.NDArray[np.int64], rig: Rig | None = None) -> npt.NDArray[np.int64]:
    """Return the node id of each frame's sender from the identifiers (with flags): 0 for the host, -1 if unknown.

    A remote frame is a request of the host (node guarding, a requested PDO).
    """
    table = np.full(0x800, NOBODY, np.int64)
    nodes = np.arange(1, 128)
    for code in FROM_NODES:
        table[code + nodes] = nodes
    for code in TO_NODES:
        table[code + nodes] = HOST
    table[[CobId.NMT, CobId.SYNC, CobId.TIME, CobId.LSS_RX]] = HOST
    if rig is not None:
        table[CobId.HEARTBEAT + rig.host.node_id] = HOST
        for pdo in rig.pdos():
            layout = pdo.layout
            table[layout.cob_id] = HOST if layout.direction == "rpdo" else pdo.node_id
    bare = can_ids & ~CAN_RTR_FLAG
    sender = np.where(can_ids & CAN_RTR_FLAG, HOST, table[bare & 0x7FF])
    return np.where(bare <= 0x7FF, sender, NOBODY)


def rig_of(path: str, name: str | None) -> Rig | None:
    """Return the rig of that name, else the rig attached to a recording, else None."""
    if name is not None:
        return load_rig(name)
    if not path.endswith(".pcapng"):
        return None
    try:
        return blocks(path).rig
    except RigError:
        return None
