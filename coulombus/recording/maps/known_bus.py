"""What is known of a bus before its frames: names, PDOs and services, by a rig or by EDS files.

`recording.maps.log_maps` learns the same from a log. docs/explain.md has the order of the sources.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from coulombus.eds.cia301 import CobId
from coulombus.eds.description import Description
from coulombus.eds.pdo import COMMUNICATION, PDO_COUNT, PdoLayout, read_layout, unreadable
from coulombus.recording.host_telemetry import inside_pdos
from coulombus.recording.maps.eds_files import EdsFiles
from coulombus.recording.maps.log_maps import LogMaps
from coulombus.recording.maps.seen_maps import Objects
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo

__all__ = ["KnownBus", "KnownNode"]

NO_STATE = b"[]"
"""Empty names of a law's state: the recording has them, not the rig."""


@dataclass(frozen=True)
class KnownNode:
    """A node with the identifier of its emergencies (0: unknown) and the period of its heartbeat (0: none)."""

    name: str
    node_id: int
    emcy_id: int = 0
    heartbeat_s: float = 0.0


@dataclass(frozen=True)
class KnownBus:
    """The nodes and PDOs of a bus.

    Attributes
    ----------
    host : the node that commands the others; None: unknown
    period_s : of SYNC; 0: unknown
    rig, eds : the sources
    telemetry : PDOs of the host's telemetry, which are on no bus
    remarks : what of the sources is left out, and why
    """

    name: str
    nodes: tuple[KnownNode, ...]
    pdos: tuple[RigPdo, ...]
    host: KnownNode | None = None
    period_s: float = 0.0
    rig: Rig | None = None
    eds: EdsFiles = field(default_factory=EdsFiles)
    telemetry: tuple[RigPdo, ...] = ()
    remarks: tuple[str, ...] = ()

    @classmethod
    def of_rig(cls, rig: Rig) -> KnownBus:
        """Return what a rig file tells."""
        return cls(
            rig.name,
            tuple(KnownNode(node.name, node.node_id, node.emcy_id, node.part.heartbeat_s) for node in rig.nodes),
            rig.pdos(),
            KnownNode("host", rig.host.node_id, 0, rig.host.heartbeat_s),
            rig.bus.period_s,
            rig,
            telemetry=inside_pdos(rig, NO_STATE),
        )

    @classmethod
    def of_eds(cls, files: EdsFiles) -> KnownBus:
        """Return what EDS files tell; of a folder those DCF and XDC files that have a node id."""
        own = {file.node_id: file for file in reversed(files.candidates) if file.node_id}
        of_nodes = dict(sorted((own | files.of_nodes).items()))
        maps = LogMaps(EdsFiles(of_nodes))
        maps.learn()
        pdos = maps.pdos()
        nodes = tuple(_node(number, file) for number, file in of_nodes.items())
        remarks = tuple(text for number, file in of_nodes.items() for text in _left_out(number, file, pdos))
        return cls("_".join(f"node{number}" for number in list(of_nodes)[:4]), nodes, pdos, eds=files, remarks=remarks)

    @classmethod
    def of_device(cls, number: int, objects: Objects, files: EdsFiles) -> KnownBus:
        """Return the PDOs that a device has now, by the values of its objects; EDS files have names and types."""
        maps = LogMaps(files)
        maps.hold(number, objects)
        maps.learn()
        pdos = tuple(pdo for pdo in maps.pdos() if pdo.node_id == number)
        return cls(f"node{number}", (KnownNode(str(number), number),), pdos, eds=files)

    @property
    def names(self) -> Mapping[int, str]:
        """Names of the nodes by node id, with the host's."""
        host = {} if self.host is None else {self.host.node_id: self.host.name}
        return host | {node.node_id: node.name for node in self.nodes}


def _node(number: int, file: Description) -> KnownNode:
    def value(index: int, otherwise: int) -> int:
        default = file.default(index, 0, number) if file.has(index, 0) else None
        return default if isinstance(default, int) else otherwise

    emcy = value(0x1014, CobId.EMCY + number)
    is_valid = 0 < emcy & 0x1FFFFFFF < 0x800 and not emcy >> 31 & 1
    return KnownNode(str(number), number, emcy & 0x7FF if is_valid else 0, value(0x1017, 0) / 1e3)


def _left_out(number: int, file: Description, pdos: tuple[RigPdo, ...]) -> Iterator[str]:
    """Yield why PDOs of a node are not among `pdos`."""
    refused = unreadable(file, number)
    for text in refused.values():
        yield f"{text}: this PDO is left out"
    by_id = {pdo.layout.cob_id: pdo for pdo in pdos}
    for layout in _layouts(file, number, refused):
        counted = by_id.get(layout.cob_id)
        if counted is None or not layout.entries:
            continue
        own, other = f"{layout.direction.upper()}{layout.number}", f"{counted.node}.{counted.name}"
        if f"{number}.{own}" != other:
            reason = f"its identifier {layout.cob_id:03X}h is that of {other}, too"
            yield f"{file.path}: {number}.{own} is left out: {reason}"


def _layouts(file: Description, number: int, refused: Mapping[int, str]) -> Iterator[PdoLayout]:
    for direction, first in COMMUNICATION.items():
        for index in sorted(file.objects):
            if first <= index < first + PDO_COUNT and index not in refused:
                layout = read_layout(file, number, "rpdo" if direction == "rpdo" else "tpdo", index - first + 1)
                if layout.cob_id > 0:
                    yield layout
