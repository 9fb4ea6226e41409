"""Values of drives besides their state: following error, internal limit, mode, torque (CiA 402-2)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia402 import INTERNAL_LIMIT, STATE_OF_STATUSWORD, PowerState
from coulombus.eds.sdo_frames import where
from coulombus.explain.bus import Bus
from coulombus.explain.frames import SYNC, Block, Frames, Integers
from coulombus.recording.maps.seen_maps import Field, Map
from coulombus.wire.clock import NEVER_NS

__all__ = ["DriveValues"]

STATUS, MODE, MODE_SHOWN, TORQUE = 0x41, 0x60, 0x61, 0x77
DEVIATION = 0x2000
"""Statusword bit 13: its meaning depends on the mode."""
FOLLOWS, CYCLIC = 0x1000, (8, 9, 10)
"""Statusword bit 12 in the cyclic modes: the drive follows its set-points."""
DEVIATIONS = {1: "following error", 3: "slip too large", 6: "homing error", 7: "following error", 8: "following error"}
HELD_NS, MODE_NS = 200_000_000, 1_000_000_000
"""Time after which a bit or value counts; the same for a mode."""
MOTION = {0x6C: "velocity", 0x77: "torque", 0x64: "position"}
WATCHES = ((0x1016, 1), (0x6007, 0), (0x1400, 5))
"""Objects that end a motion without a host: heartbeat consumer, abort connection, event timer of the set-points."""
RUNS_NS, COMMANDED_NS = 500_000_000, 100_000_000
"""Time after the host is missed within which a drive's own watch ends its motion; time after which SYNC and set-points
do not come any more.
"""
RUNS = "0.5 s after its host fell silent"
OFF_TORQUE = 100
"""Least torque [per mille of the rated torque] that a drive with a disabled power stage cannot have."""
OFF = [PowerState.SWITCH_ON_DISABLED, PowerState.READY_TO_SWITCH_ON, PowerState.SWITCHED_ON, PowerState.FAULT]
Holds = npt.NDArray[np.bool_]


class DriveValues:
    """Monitors the statuswords' other bits, and other mapped values."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._since: dict[tuple[str, int, int], tuple[int, int]] = {}  # time and row of its beginning
        self._followed: dict[tuple[int, int], bool] = {}  # whether the drive ever told that it follows
        self._noted: dict[tuple[str, int, int], int] = {}  # the last of these times that was noted
        self._last_ns: dict[int, int] = {}  # the last frame of each identifier
        self._modes: dict[tuple[int, int], int] = {}  # last displayed
        self._wishes: dict[tuple[int, int], tuple[int, int]] = {}  # mode of the RPDO, and its time

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for group, pdo_map in self._pdos(block, "rpdo"):
            for axis, field in pdo_map.find(MODE):
                self._wish(pdo_map.node, axis, group.t_ns, _column(group, field))
        for group, pdo_map in self._pdos(block, "tpdo"):
            fields = {(low, axis): field for low in (STATUS, MODE_SHOWN, TORQUE) for axis, field in pdo_map.find(low)}
            axes = {axis for low, axis in fields if low == STATUS and self._is_source(pdo_map, axis)}
            for axis in axes:
                status = _column(group, fields[STATUS, axis])
                state = STATE_OF_STATUSWORD[status & 0x7F]
                if (MODE_SHOWN, axis) in fields:
                    self._mode(group, pdo_map.node, axis, state, _column(group, fields[MODE_SHOWN, axis]))
                if (TORQUE, axis) in fields:
                    self._torque(group, pdo_map.node, axis, state, _signed(group, fields[TORQUE, axis]))
                self._status(group, pdo_map.node, axis, status)
                self._runs_on(block, group, pdo_map, axis, state)
        for key, group in block.groups.items():
            self._last_ns[key] = int(group.t_ns[-1])

    def _pdos(self, block: Block, direction: str) -> Iterator[tuple[Frames, Map]]:
        for key, group in block.groups.items():
            pdo_map = self.bus.maps.get(key)
            if pdo_map is not None and pdo_map.direction == direction and (group.length >= pdo_map.length).all():
                yield group, pdo_map

    def _is_source(self, pdo_map: Map, axis: int) -> bool:
        """Return whether a PDO is the first one of the log with this axis' statusword."""
        first = self.bus.first_of
        sources = [
            other.can_id
            for other in self.bus.maps.values()
            if other.node == pdo_map.node and other.can_id in first and axis in {a for a, _ in other.find(STATUS)}
        ]
        return pdo_map.can_id == min(sources, key=lambda can_id: first[can_id])

    def _status(self, group: Frames, node: int, axis: int, status: Integers) -> None:
        mode = self._modes.get((node, axis), self._shown(node, axis))
        what = DEVIATIONS.get(mode, "" if mode in (4, 10) else "following error")
        enabled = STATE_OF_STATUSWORD[status & 0x7F] == PowerState.OPERATION_ENABLED
        holds = enabled & (status & DEVIATION != 0) if what else np.zeros(len(status), bool)
        self._held("following_error", node, axis, group, holds, 0, f"{what} (statusword bit 13)")
        if mode in CYCLIC:
            followed = enabled & (status & FOLLOWS != 0)
            seen = self._followed.get((node, axis), False)
            ignored = enabled & (status & FOLLOWS == 0) & (np.logical_or.accumulate(followed) | seen)
            self._followed[node, axis] = seen or bool(followed.any())
            text = "it follows its set-points no more (statusword bit 12)"
            self._held("setpoint_ignored", node, axis, group, ignored, HELD_NS, text)
        holds = enabled & (status & INTERNAL_LIMIT != 0)
        self._held("limit_active", node, axis, group, holds, HELD_NS, "internal limit active (statusword bit 11)")

    def _runs_on(self, block: Block, group: Frames, pdo_map: Map, axis: int, state: Integers) -> None:
        """Note a drive that is in Operation Enabled some time after its host fell silent."""
        node, subject = pdo_map.node, (axis, "PDO")
        for silence in self.bus.silences:
            at_ns = silence.due_ns + RUNS_NS
            i = int(group.t_ns.searchsorted(at_ns))
            if i == len(group) or self._noted.get(("runs_on", node, axis), -1) >= at_ns:
                continue
            self._noted["runs_on", node, axis] = at_ns
            enabled = state[i] == PowerState.OPERATION_ENABLED
            if not enabled or silence.back_ns < at_ns or self._commanded(block, node, at_ns):
                continue
            shown = {
                name: int(_signed(group, field)[i])
                for low, name in MOTION.items()
                for mapped, field in pdo_map.find(low)
                if mapped == axis
            }
            moving = [value for name, value in shown.items() if name != "position"]
            if moving and not any(moving):
                continue  # it is at rest
            objects = self.bus.nodes[node].objects
            unset = [where(*at) for at in WATCHES if not objects.get(at)]
            text = f"in Operation Enabled {RUNS}" + "".join(f", {name} {value}" for name, value in shown.items())
            text += f"; this log has no write of {', '.join(unset)}" if unset else ""
            t_ns, row = int(group.t_ns[i]), int(group.rows[i])
            self.clues.begin("runs_on", node, t_ns, text, row=row, subject=subject).axis = axis
        if self.clues.stands("runs_on", node, subject):
            silence = self.bus.silences[-1]
            behind = np.flatnonzero((state != PowerState.OPERATION_ENABLED) & (group.t_ns > silence.due_ns + RUNS_NS))
            ended_ns = int(group.t_ns[behind[0]]) if len(behind) else NEVER_NS
            if silence.back_ns < ended_ns:
                self.clues.end("runs_on", node, silence.back_ns, "the host is back", subject=subject)
            elif len(behind):
                self.clues.end("runs_on", node, ended_ns, "it is not in Operation Enabled any more", subject=subject)

    def _commanded(self, block: Block, node: int, at_ns: int) -> bool:
        """Return whether SYNC or set-points of a node still come at a time [ns]."""
        for key in {*block.groups, *self._last_ns}:
            if key != SYNC and self.bus.receiver(key) != node:
                continue
            last_ns, group = self._last_ns.get(key, -COMMANDED_NS), block.groups.get(key)
            if group is not None and group.t_ns[0] < at_ns:
                last_ns = int(group.t_ns[group.t_ns.searchsorted(at_ns) - 1])
            if at_ns - last_ns < COMMANDED_NS:
                return True
        return False

    def _torque(self, group: Frames, node: int, axis: int, state: Integers, torque: Integers) -> None:
        holds = np.isin(state, OFF) & (np.abs(torque) > OFF_TORQUE)
        text = f"{where(0x6077 + 0x800 * axis, 0)} shows more than {OFF_TORQUE / 10:g} % of the rated torque, and the power stage is off"
        self._held("torque_when_off", node, axis, group, holds, HELD_NS, text)

    def _mode(self, group: Frames, node: int, axis: int, state: Integers, shown: Integers) -> None:
        self._modes[node, axis] = int(shown[-1])
        wish, since_ns = self._wishes.get((node, axis), (-1, 0))
        if wish < 0:
            wish = self._written(node, axis)
        holds = (shown != wish) & (state == PowerState.OPERATION_ENABLED) & (group.t_ns > since_ns)
        text = f"mode of operation {wish} is commanded, {where(0x6061 + 0x800 * axis, 0)} shows {int(shown[-1])}"
        self._held("mode_refused", node, axis, group, holds if wish > 0 else np.zeros(len(holds), bool), MODE_NS, text)

    def _wish(self, node: int, axis: int, t_ns: Integers, wish: Integers) -> None:
        value, since_ns = self._wishes.get((node, axis), (-1, 0))
        changed = np.flatnonzero(wish != np.concatenate(([value], wish[:-1])))
        if len(changed):
            value, since_ns = int(wish[-1]), int(t_ns[changed[-1]])
        self._wishes[node, axis] = value, since_ns

    def _written(self, node: int, axis: int) -> int:
        seen = self.bus.nodes.get(node)
        return seen.objects.get((0x6060 + 0x800 * axis, 0), -1) if seen is not None else -1

    def _shown(self, node: int, axis: int) -> int:
        seen = self.bus.nodes.get(node)
        return seen.objects.get((0x6061 + 0x800 * axis, 0), self._written(node, axis)) if seen is not None else -1

    def _held(self, kind: str, node: int, axis: int, group: Frames, holds: Holds, least_ns: int, text: str) -> None:
        """Note periods in which a condition holds for long enough."""
        key = (kind, node, axis)
        if key not in self._since and not holds.any():
            return
        before = key in self._since
        for i in np.flatnonzero(holds != np.concatenate(([before], holds[:-1]))).tolist():
            t_ns = int(group.t_ns[i])
            if holds[i]:
                self._since[key] = t_ns, int(group.rows[i])
                continue
            since_ns, _ = self._since[key]
            if t_ns - since_ns >= least_ns:
                self._begin(key, text)
                self.clues.end(kind, node, t_ns, "it is over", subject=(axis, "PDO"))
            del self._since[key]
        if key in self._since and int(group.t_ns[-1]) - self._since[key][0] >= least_ns:
            self._begin(key, text)

    def _begin(self, key: tuple[str, int, int], text: str) -> None:
        (kind, node, axis), (t_ns, row) = key, self._since[key]
        if self._noted.get(key) == t_ns:
            return
        self._noted[key] = t_ns
        note = self.clues.note if kind == "limit_active" else self.clues.begin  # a limit is not a fault
        note(kind, node, t_ns, text, row=row, subject=(axis, "PDO")).axis = axis


def _column(group: Frames, field: Field) -> Integers:
    return group.word >> field.start & (1 << field.bits) - 1


def _signed(group: Frames, field: Field) -> Integers:
    half = 1 << field.bits - 1
    return (_column(group, field) ^ half) - half
