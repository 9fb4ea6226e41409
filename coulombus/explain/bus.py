"""Knowledge of a bus while its frames are read: nodes, NMT commands, objects, PDO maps.

`recording.maps.log_maps` learns maps, too, and keeps them through a node's boot-up, so that its signals go on.
Here such a map is unknown until it is seen again: an explanation says no more than the frames until then show.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, replace
from pathlib import Path

from coulombus.eds.cia301 import TPDOS, CobId, NmtCommand, NmtState
from coulombus.eds.cia402 import STATE_OF_STATUSWORD
from coulombus.eds.description import Description
from coulombus.eds.own_devices import is_another
from coulombus.eds.sdo_frames import where
from coulombus.explain.clues import Clues
from coulombus.explain.frames import REMOTE, SYNC, Block, Frames
from coulombus.explain.incident_words import OF_AXES
from coulombus.explain.seen_node import SeenNode
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.maps.seen_maps import SEEN, Map, identified, maps_of, maps_of_rig
from coulombus.wire.clock import NEVER_NS

__all__ = ["Bus", "Order", "Silence", "product"]

ENDING_NS = 1_000_000_000
"""Time after its last cycle within which a host that ends commands its nodes out of OPERATIONAL."""
WRITTEN_NS = 1_000_000_000
"""Longest time from a write that ends a PDO to the first one that does not come."""
TARGET = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}
NMT, SDO_TX, SDO_RX, HEARTBEAT, EMCY = map(int, (CobId.NMT, CobId.SDO_TX, CobId.SDO_RX, CobId.HEARTBEAT, CobId.EMCY))
PDOS, RPDOS = range(CobId.TPDO1, CobId.SDO_TX), range(CobId.RPDO1, CobId.SDO_TX)
"""Identifiers of PDOs, and those among which a usual RPDO's is."""
NAMES = {
    0x1000: "device type", 0x1001: "error register", 0x1003: "error history", 0x1005: "COB-ID SYNC",
    0x1006: "communication cycle period", 0x1010: "store parameters", 0x1011: "restore parameters",
    0x1014: "COB-ID EMCY", 0x1016: "consumer heartbeat time", 0x1017: "producer heartbeat time",
    0x1018: "identity", 0x1029: "error behaviour", 0x603F: "error code", 0x6040: "controlword",
    0x6041: "statusword", 0x6060: "modes of operation", 0x6061: "modes of operation display",
    0x6064: "position actual value", 0x6071: "target torque", 0x6072: "max torque", 0x607A: "target position",
    0x60FF: "target velocity", 0x6502: "supported drive modes",
    **{index: f"RPDO{index - 0x13FF} parameters" for index in range(0x1400, 0x1408)},
    **{index: f"RPDO{index - 0x15FF} map" for index in range(0x1600, 0x1608)},
    **{index: f"TPDO{index - 0x17FF} parameters" for index in range(0x1800, 0x1808)},
    **{index: f"TPDO{index - 0x19FF} map" for index in range(0x1A00, 0x1A08)},
}  # fmt: skip
"""Names of objects of CiA 301 and 402, for nodes without an EDS file."""


@dataclass
class Order:
    """An observed NMT command."""

    t_ns: int
    command: int
    node: int  # 0: all
    row: int

    def concerns(self, node: int) -> bool:
        """Return whether it addresses this node."""
        return self.node in (0, node)


@dataclass
class Silence:
    """A silence of the host: from when it is missed, until it is back [ns]."""

    due_ns: int
    back_ns: int = NEVER_NS


class Bus:
    """State shared by all observers.

    Parameters
    ----------
    known
        Names and PDO maps of a rig, and EDS files.
    """

    def __init__(self, known_bus: KnownBus) -> None:
        rig = known_bus.rig
        self.descriptions = dict(known_bus.eds.of_nodes)
        self.candidates = known_bus.eds.candidates
        """EDS files to be matched with nodes by identity (1018h)."""
        self.of_rig = {} if rig is None else {node.node_id: node.description for node in rig.nodes}
        """EDS files of the rig's nodes, used for names only: `fixed` has the maps."""
        self.fixed = {} if rig is None else maps_of_rig(rig)
        """PDO maps of the rig, by identifier."""
        self.names = {} if rig is None else {node.node_id: node.name for node in rig.nodes}
        self.names |= {number: product(description) for number, description in self.descriptions.items()}
        self.others: list[int] = []  # nodes of the log that are not those of the rig
        self.clues = Clues()
        self.nodes: dict[int, SeenNode] = {}
        self.contradicted: set[int] = set()
        """Nodes whose PDOs contradict the assumed maps."""
        self.configured: set[int] = set()
        """Nodes whose maps were seen at any time: after a boot-up they are unknown, and not the usual ones."""
        self.first_of: dict[int, int] = {}
        """Time [ns] of the first frame of each key."""
        self.orders: list[Order] = []
        self.maps: dict[int, Map] = dict(self.fixed)
        self.first_ns = self.last_ns = -1
        self.frames = 0
        self.counts: dict[int, int] = {}
        self.safe_ns = -1  # time of the host's ordered end or trip; -1: none
        self.tripped = False
        self.host_runs = False  # whether a host of this project has begun its cycle, and not ended
        self.canopen = 0  # frames that occur only in CANopen
        self.stale = True
        self.beats_changed = False
        """Whether a write of 1017h changed when heartbeats are due."""
        self.power: dict[int, list[tuple[int, int]]] = {}
        """Number of a node's axes in Operation Enabled, from each time [ns] of a change."""
        self.sync_period_ns = 0
        """Period of SYNC [ns]; 0 until it is learned."""
        self.sync_since_ns = NEVER_NS
        """The SYNC [ns] with which its period was learned."""
        self.sync_written = False
        """Whether a write of 1006h, which the next start of a node may put into force, was seen."""
        self.sync_ns = -1
        """The last SYNC [ns] of the blocks before."""
        self.sync_off_ns = -NEVER_NS
        """The last time [ns] at which its producer was told to end SYNC (1005h)."""
        self.pdo_ends: dict[int, tuple[int, str]] = {}
        """By identifier, the last write that ends a PDO: time [ns] and text."""
        self.relearn_sync = False
        """Whether the period of SYNC may change from here on."""
        self.two_sync: list[tuple[int, int]] = []
        """Times [ns] within which two nodes produce SYNC, as known."""
        self.silences: list[Silence] = []
        """Silences of the host."""
        self.bitrate = 0 if rig is None else rig.axes[0].bus.bitrate_bit_s
        """Bit rate [bit/s] of the rig; 0: unknown."""
        self.host = -1 if rig is None else rig.host.node_id
        """The host's node id, if its heartbeat is known, else -1."""
        self.powered: list[tuple[int, int]] = []
        """Number of drives in Operation Enabled, from each time [ns] of a change."""
        self.words: list[tuple[int, int, int, int, int]] = []
        """Drives' objects seen in SDO transfers: row, time, node, index, value."""

    def add_frames(self, block: Block) -> None:
        """Count the frames, and detect nodes."""
        if len(block.t_ns) == 0:
            return
        if self.first_ns < 0:
            self.first_ns = int(block.t_ns[0])
        self.last_ns = max(self.last_ns, int(block.t_ns[-1]))
        self.frames += len(block.t_ns)
        for key, group in block.groups.items():
            self.counts[key] = self.counts.get(key, 0) + len(group)
            self.first_of.setdefault(key, int(group.t_ns[0]))

    def node(self, number: int, t_ns: int) -> SeenNode:
        """Return the record of a node that sent a frame."""
        node = self.nodes.get(number)
        if node is None:
            node = self.nodes[number] = SeenNode(number, t_ns, t_ns)
            self.stale = True
        node.last_ns = max(node.last_ns, t_ns)
        return node

    def name(self, number: int | None) -> str:
        """Return a node's name: by rig or EDS file, else its number."""
        if number is None:
            return "bus"
        if number == self.host:
            return "host"
        name = self.names.get(number)
        return f"{name} (node {number})" if name else f"node {number}"

    def sender(self, key: int) -> int | None:
        """Return the node that sends a group's frames; None: the host, or unknown."""
        if key & ~0x7FF or key < 0x81:
            return None
        pdo_map = self.maps.get(key)
        if pdo_map is not None:
            return pdo_map.node if pdo_map.direction == "tpdo" else None
        function, number = key & 0x780, key & 0x7F
        if number and function in (EMCY, SDO_TX, HEARTBEAT, *TPDOS):
            return number
        return None

    def receiver(self, key: int) -> int | None:
        """Return the node that a group's frames are set-points for: by its map, else by the identifier; None for none."""
        pdo_map = self.maps.get(key)
        if pdo_map is not None:
            return pdo_map.node if pdo_map.direction == "rpdo" else None
        return key & 0x7F or None if key in RPDOS and not key & 0x80 else None

    def last_heard(self, block: Block | None, number: int, before_ns: int) -> int:
        """Return the time of the node's last frame before this time; -1 if none is known."""
        node = self.nodes.get(number)
        last = node.last_ns if node is not None and node.last_ns < before_ns else -1
        for key, group in block.groups.items() if block is not None else ():
            if self.sender(key) == number:
                place = int(group.t_ns.searchsorted(before_ns))
                if place:
                    last = max(last, int(group.t_ns[place - 1]))
        return last

    def last_sync_ns(self, block: Block | None, before_ns: int) -> int:
        """Return the time of the last SYNC before this time; -1 if none is known."""
        group = None if block is None else block.groups.get(SYNC)
        place = 0 if group is None else int(group.t_ns.searchsorted(before_ns))
        return int(group.t_ns[place - 1]) if group is not None and place else self.sync_ns

    def ordered(self, number: int, after_ns: int, before_ns: int, *targets: int) -> Order | None:
        """Return the last NMT command to a node between these times, with the given target if any."""
        for command in reversed(self.orders):
            if command.t_ns > before_ns:
                continue
            if command.t_ns < after_ns:
                return None
            if command.concerns(number) and (not targets or TARGET.get(NmtCommand(command.command)) in targets):
                return command
        return None

    def present(self, number: int, t_ns: int) -> bool:
        """Return whether a frame of a node came until a time [ns]."""
        node = self.nodes.get(number)
        return node is not None and node.first_ns <= t_ns

    def heartbeat_periods(self, t_ns: int) -> list[int]:
        """Return the periods [ns] of all heartbeats but the host's that were learned until a time [ns]."""
        return [
            node.period_ns
            for node in self.nodes.values()
            if node.period_ns and node.learned_ns <= t_ns and not self.is_host(node.number, t_ns)
        ]

    def is_host(self, number: int, t_ns: int) -> bool:
        """Return whether a node is the host, as far as it is known at a time [ns].

        Without 1016h it is the only node that sent heartbeats and nothing else, that nobody asked or
        commanded by its id, and that stayed OPERATIONAL, on a bus with NMT commands.
        """
        if self.host >= 0:
            return number == self.host
        commanded = self._commanded(t_ns)
        alone = [n for n in self.nodes if self.present(n, t_ns) and self._only_beats(n, t_ns, commanded)]
        return bool(commanded) and alone == [number]

    def only_beats(self, number: int, t_ns: int) -> bool:
        """Return whether a node did nothing until a time [ns] but send heartbeats in OPERATIONAL."""
        return self._only_beats(number, t_ns, self._commanded(t_ns))

    def _commanded(self, t_ns: int) -> set[int]:
        """Return the node ids of the NMT commands until a time [ns]."""
        return {command.node for command in self.orders if command.t_ns <= t_ns}

    def _only_beats(self, number: int, t_ns: int, commanded: set[int]) -> bool:
        others = (
            REMOTE | HEARTBEAT + number,
            SDO_RX + number,
            SDO_TX + number,
            EMCY + number,
            *(base + number for base in TPDOS),
        )
        node = self.nodes[number]
        return (
            node.always_operational
            and number not in commanded
            and not any(0 <= self.first_of.get(key, -1) <= t_ns for key in others)
        )

    def left_on_order(self, number: int, before_ns: int) -> bool:
        """Return whether the last NMT command to a node before this time was not a start."""
        last = self.ordered(number, -1, before_ns)
        return last is not None and last.command != NmtCommand.START

    def is_disarmed(self, number: int, t_ns: int) -> bool:
        """Return whether a node's drive is known not to be in Operation Enabled at a time [ns]."""
        changes = self.power.get(number, [])
        place = bisect.bisect_right(changes, t_ns, key=lambda change: change[0])
        return place > 0 and changes[place - 1][1] == 0

    def order_due_ns(self, stop_ns: int, at_once_ns: int) -> int:
        """Return the time [ns] until which an NMT command explains that cyclic frames stop:
        `at_once_ns` after the stop, or later while no drive is in Operation Enabled and the host is
        ending.
        """
        place = bisect.bisect_left(self.powered, (stop_ns + 1,)) - 1
        disarmed = place >= 0 and self.powered[place][1] == 0
        return stop_ns + max(at_once_ns, ENDING_NS if disarmed else 0)

    def pdo_end(self, key: int, begin_ns: int, until_ns: int, text: str) -> tuple[str, str]:
        """Return the text of a PDO's stop and who made it, by the write that ends it; "" for the kind's culprit."""
        t_ns, write = self.pdo_ends.get(key, (-NEVER_NS, ""))
        is_written = begin_ns - WRITTEN_NS <= t_ns <= until_ns
        return (f"{text}: {write}", "client") if is_written else (text, "")

    def expect_sync(self, *, written: bool) -> None:
        """Note that SYNC may get another period: 1006h is written, or a node is started after that."""
        if written or self.sync_written:
            self.sync_written = written
            self.relearn_sync = self.stale = True

    def renew(self) -> None:
        """Rebuild the PDO maps from present knowledge."""
        if self.stale:
            self.stale = False
            for node in self.nodes.values():
                if node.number in self.of_rig and any(node.identity):
                    self._compare(node.number, node.identity)
            for number, description in identified(self.nodes, self.descriptions, self.candidates).items():
                self.descriptions[number] = description
                self.names.setdefault(number, product(description))
            maps = maps_of(self.nodes, self.descriptions, self.fixed)
            unknown = self.contradicted | self.configured
            self.maps = {}
            for key, pdo_map in maps.items():
                if pdo_map.source != "assumed" or pdo_map.node not in unknown:
                    self.maps[key] = pdo_map
                elif (
                    pdo_map.synchronous is not None or pdo_map.event_ns or pdo_map.inhibit_ns
                ):  # type and times were seen
                    self.maps[key] = replace(pdo_map, fields=(), source=SEEN)

    def doubt(self, block: Block) -> None:
        """Drop the assumed maps of a node whose PDOs have another length, or a word that is no statusword."""
        doubted = {
            pdo_map.node
            for key, group in block.groups.items()
            if (pdo_map := self.maps.get(key)) is not None
            and pdo_map.source == "assumed"
            and _contradicts(group, pdo_map)
        }
        if doubted:
            self.contradicted |= doubted
            self.stale = True
            self.renew()
            self.clues.retract([clue for clue in self.clues.all if clue.node in doubted and clue.kind in OF_AXES])

    def describe(self, number: int) -> Description | None:
        """Return the EDS file of a node, or None."""
        return self.descriptions.get(number) or self.of_rig.get(number)

    def object_text(self, number: int, index: int, subindex: int) -> str:
        """Return an object of a node as ``6041h:00 (statusword)``."""
        description = self.describe(number)
        name = NAMES.get(index, "")
        if description is not None and description.has(index, subindex):
            name = description.variable(index, subindex).name
        return where(index, subindex) + (f" ({name})" if name else "")

    def _compare(self, number: int, identity: tuple[int, int]) -> None:
        """Remove the rig's names from a node that is not the rig's device."""
        if not is_another(self.of_rig[number], identity):
            return
        del self.of_rig[number]
        self.others.append(number)
        self.names.pop(number, None)
        self.fixed = {can_id: pdo_map for can_id, pdo_map in self.fixed.items() if pdo_map.node != number}


def _contradicts(group: Frames, pdo_map: Map) -> bool:
    """Return whether frames cannot have an assumed map."""
    short, long = (group.length < pdo_map.length).any(), (group.length > pdo_map.length).any()
    if pdo_map.length and (short or (long and pdo_map.direction == "tpdo")):
        return True
    words = [group.word >> field.start for _, field in pdo_map.find(0x41) if pdo_map.direction == "tpdo"]
    return any(bool((STATE_OF_STATUSWORD[word & 0x7F] < 0).any()) for word in words)


def product(description: Description) -> str:
    """Return the product name in an EDS file."""
    return description.info.get("ProductName", "") or Path(description.path).stem
