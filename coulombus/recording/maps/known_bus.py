"""What is known of a bus before its frames: names, PDOs and services, by a rig or by EDS files.

It never changes, so that several readers of frames can have it; each learns from its frames itself
(`recording.maps.log_maps`, `explain.bus`). docs/explain.md has the order of the sources.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from coulombus.eds.cia301 import CobId
from coulombus.eds.description import Description
from coulombus.eds.eds_folder import EdsFiles
from coulombus.eds.pdo import COMMUNICATION, PDO_COUNT, PdoLayout, read_layout, unreadable
from coulombus.recording.host_telemetry import inside_pdos
from coulombus.recording.maps.log_maps import LogMaps
from coulombus.recording.maps.seen_maps import Objects
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo, Signal

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
    """The nodes and PDOs of a bus, for every reader of frames.

    Attributes
    ----------
    rig, eds : the sources; without a rig, nodes are numbers
    learned : PDOs that the log or a device has shown; None: those of the EDS files
    """

    rig: Rig | None = None
    eds: EdsFiles = field(default_factory=EdsFiles)
    learned: tuple[RigPdo, ...] | None = None

    @classmethod
    def of_device(cls, number: int, objects: Objects, files: EdsFiles) -> KnownBus:
        """Return the PDOs that a device has now, by the values of its objects; EDS files have names and types."""
        maps = LogMaps(files)
        maps.hold(number, objects)
        maps.learn()
        return cls(eds=files, learned=tuple(pdo for pdo in maps.pdos() if pdo.node_id == number))

    @property
    def name(self) -> str:
        """The rig's name, else a word for files."""
        return "_".join(f"node{number}" for number in list(self._files)[:4]) if self.rig is None else self.rig.name

    @cached_property
    def nodes(self) -> tuple[KnownNode, ...]:
        """The nodes of the sources, without the host."""
        if self.rig is None:
            return tuple(_node(number, file) for number, file in self._files.items())
        return tuple(KnownNode(node.name, node.node_id, node.emcy_id, node.part.heartbeat_s) for node in self.rig.nodes)

    @cached_property
    def host(self) -> KnownNode | None:
        """The node that commands the others; None: unknown."""
        return None if self.rig is None else KnownNode("host", self.rig.host.node_id, 0, self.rig.host.heartbeat_s)

    @property
    def period_s(self) -> float:
        """Period of SYNC; 0: unknown."""
        return 0.0 if self.rig is None else self.rig.bus.period_s

    @property
    def names(self) -> dict[int, str]:
        """Names of the nodes by node id, with the host's."""
        if self.rig is None:
            return {number: str(number) for number in self._files}
        return {self.rig.host.node_id: "host"} | {node.node_id: node.name for node in self.rig.nodes}

    @cached_property
    def pdos(self) -> tuple[RigPdo, ...]:
        """The PDOs that are known before its frames."""
        if self.rig is not None:
            return self.rig.pdos()
        if self.learned is not None:
            return self.learned
        maps = LogMaps(EdsFiles(self._files))
        maps.learn()
        return maps.pdos()

    @property
    def telemetry(self) -> tuple[RigPdo, ...]:
        """PDOs of the host's telemetry, which are on no bus."""
        return () if self.rig is None else inside_pdos(self.rig, NO_STATE)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Texts about PDOs of EDS files that are left out."""
        files = {} if self.rig is not None else self._files
        return tuple(text for number, file in files.items() for text in _left_out(number, file, self.pdos))

    def signals(self) -> Iterator[tuple[RigPdo, Signal]]:
        """Yield every signal with its PDO."""
        return ((pdo, signal) for pdo in self.pdos for signal, _, _ in pdo.fields())

    @property
    def _files(self) -> dict[int, Description]:
        """EDS files by node id; of a folder those DCF and XDC files that have one."""
        with_id = {file.node_id: file for file in reversed(self.eds.candidates) if file.node_id}
        return dict(sorted((with_id | self.eds.of_nodes).items()))


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
        name, owner = f"{number}.{layout.direction.upper()}{layout.number}", f"{counted.node}.{counted.name}"
        if name != owner:
            reason = f"its identifier {layout.cob_id:03X}h is that of {owner}, too"
            yield f"{file.path}: {name} is left out: {reason}"


def _layouts(file: Description, number: int, refused: Mapping[int, str]) -> Iterator[PdoLayout]:
    for direction, first in COMMUNICATION.items():
        for index in sorted(file.objects):
            if first <= index < first + PDO_COUNT and index not in refused:
                layout = read_layout(file, number, "rpdo" if direction == "rpdo" else "tpdo", index - first + 1)
                if layout.cob_id > 0:
                    yield layout
