"""The PDOs of a live bus without a rig: by their maps if known, else as raw bytes."""

from __future__ import annotations

from coulombus.eds.own_devices import told_identity
from coulombus.recording.maps.eds_files import EdsFiles
from coulombus.recording.maps.log_maps import LogMaps, pdo_without_map
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.wire.frame_batches import Block

__all__ = ["LearnedPdos"]


class LearnedPdos:
    """Learns PDOs from frames (`recording.maps`).

    Parameters
    ----------
    eds
        EDS files of nodes, or files to be matched by identity.
    """

    def __init__(self, eds: EdsFiles | None = None) -> None:
        self._maps = LogMaps(eds)
        self._came: set[int] = set()

    def take(self, block: Block) -> bool:
        """Learn from frames; return whether the result of `pdos` changed."""
        changed = self._maps.take(block.records)
        new = {can_id for can_id in block.rows if can_id < 0x800} - self._came
        self._came |= new
        return changed or any(pdo_without_map(can_id) or self._maps.pdo(can_id) for can_id in new)

    def pdos(self) -> tuple[RigPdo, ...]:
        """Return the received PDOs in the order of their identifiers; a PDO without a map has no signals."""
        mapped = {pdo.layout.cob_id: pdo for pdo in self._maps.pdos()}
        pdos = (mapped.get(can_id) or pdo_without_map(can_id) for can_id in sorted(self._came))
        return tuple(pdo for pdo in pdos if pdo is not None)

    def other_devices(self, rig: Rig) -> bool:
        """Return whether a node of the bus is another device than the rig's (1018h)."""
        for node in rig.nodes:
            seen, own = self._maps.identity(node.node_id), told_identity(node.description)
            if any(has not in (0, of_rig) for has, of_rig in zip(seen, own, strict=True) if of_rig):
                return True
        return False
