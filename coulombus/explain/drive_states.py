"""Drives (CiA 402): faults, resets, incomplete enabling, uncommanded stops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from coulombus.eds.cia402 import COMMAND_OF_CONTROLWORD, NEXT_STATE, STATE_OF_STATUSWORD, Command, PowerState
from coulombus.explain.bus import Bus
from coulombus.explain.device_errors import error_check, error_text
from coulombus.explain.frames import Block

__all__ = ["Drives"]

STUCK_NS = 1_000_000_000
"""Time within which a drive must follow a command."""
STATUS, CONTROL, ERROR_CODE = 0x41, 0x40, 0x3F
STATE_BITS, COMMAND_BITS, RESET = 0x6F, 0x8F, 0x80
STEPS = {
    PowerState.SWITCH_ON_DISABLED: "transition 2 to Ready To Switch On",
    PowerState.READY_TO_SWITCH_ON: "transition 3 to Switched On",
    PowerState.SWITCHED_ON: "transition 4 to Operation Enabled",
}
"""Next command of enabling, by state."""
FAULTS = (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
WORD = 0xFFFF
AXES = 8


@dataclass
class _DriveAxis:
    state: int = -1
    control: int = -1
    since_ns: int = -1  # time since which a transition is due; -1: none
    row: int = -1
    resets: int = 0
    reset_ns: int = -1

    @property
    def command(self) -> Command:
        return Command(COMMAND_OF_CONTROLWORD[max(self.control, 0) & 0xF])

    @property
    def enabling(self) -> bool:
        """Whether the controlword leads, or should lead, to Operation Enabled, but the drive is not there."""
        return self.state in STEPS and self.command in (Command.SWITCH_ON, Command.ENABLE_OPERATION)


class Drives:
    """Tracks the state machine of every axis."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._axes: dict[tuple[int, int], _DriveAxis] = {}
        self._last: dict[tuple[int, int, int], int] = {}
        self._forgotten: set[int] = set()  # nodes whose assumed maps were wrong

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for node in self.bus.contradicted - self._forgotten:
            self._axes = {key: axis for key, axis in self._axes.items() if key[0] != node}
            self._forgotten.add(node)
        events = list(self._changes(block))
        for row, t_ns, node, index, value in self.bus.words:
            low, axis = (index - 0x6000) % 0x800, (index - 0x6000) // 0x800
            if low in (STATUS, CONTROL, ERROR_CODE):
                events.append((row, t_ns, node, axis, low, value))
        self.bus.words.clear()
        for row, t_ns, node, axis, low, value in sorted(events):
            self.note_overdue(t_ns)
            self._event(row, t_ns, node, axis, low, value)
        if len(block.t_ns):
            self.note_overdue(int(block.t_ns[-1]))

    def note_overdue(self, t_ns: int) -> None:
        """Note drives that have not followed their command for too long."""
        for (node, axis), drive in self._axes.items():
            due_ns = drive.since_ns + STUCK_NS
            if drive.since_ns < 0 or t_ns <= due_ns or drive.state < 0:
                continue
            if self.clues.stands("not_following", node, axis) or self._away(node, due_ns):
                continue
            text = f"controlword {drive.control:04X}h ({_words(drive.command)}), and the drive stays {_words(PowerState(drive.state))}"
            if drive.enabling:
                text += f": {STEPS[PowerState(drive.state)]} does not come"
                text += ", 0006h (shutdown) leads there" if drive.state == PowerState.SWITCH_ON_DISABLED else ""
            clue = self.clues.begin("not_following", node, drive.since_ns, text, row=drive.row, subject=axis)
            clue.axis = axis

    def _away(self, number: int, t_ns: int) -> bool:
        node = self.bus.nodes.get(number)
        return node is None or node.state_at(t_ns) in (4, 127, 0) or self.bus.left_on_order(number, t_ns)

    def _changes(self, block: Block) -> Iterator[tuple[int, int, int, int, int, int]]:
        """Yield (row, time, node, axis, object, value) for each change of a word."""
        for key, group in block.groups.items():
            pdo_map = self.bus.maps.get(key)
            if pdo_map is None or not pdo_map.fields:
                continue
            for low, mask in ((STATUS, STATE_BITS), (CONTROL, COMMAND_BITS), (ERROR_CODE, WORD)):
                for axis, field in pdo_map.find(low):
                    words = group.word >> field.start & mask
                    before = self._last.get((key, low, axis), -1)
                    changed = np.flatnonzero(np.concatenate(([words[0] != before], words[1:] != words[:-1])))
                    self._last[key, low, axis] = int(words[-1])
                    for i in changed.tolist():
                        if 8 * int(group.length[i]) >= field.start + 16:
                            yield int(group.rows[i]), int(group.t_ns[i]), pdo_map.node, axis, low, int(words[i])

    def _event(self, row: int, t_ns: int, node: int, axis: int, low: int, value: int) -> None:
        drive = self._axes.setdefault((node, axis), _DriveAxis())
        if low == ERROR_CODE:
            if value:
                clue = self.clues.begin("error_code", node, t_ns, f"603Fh: {error_text(value)}", row=row, subject=axis)
                clue.axis, clue.check = axis, error_check(value)
            else:
                self.clues.end("error_code", node, t_ns, "603Fh is 0", subject=axis)
            return
        if low == CONTROL:
            before, drive.control = drive.control, value & COMMAND_BITS
            if value & RESET and not max(before, 0) & RESET and drive.state in FAULTS:
                if drive.resets:
                    text = f"reset {drive.resets} had no effect: the drive stays in FAULT"
                    self.clues.note("reset_failed", node, t_ns, text, row=row, subject=(axis, drive.resets)).axis = axis
                drive.resets += 1
                drive.reset_ns = t_ns
        else:
            self._status(row, t_ns, node, axis, drive, value)
        self._expect(row, t_ns, node, axis, drive)

    def _status(self, row: int, t_ns: int, node: int, axis: int, drive: _DriveAxis, value: int) -> None:
        state = int(STATE_OF_STATUSWORD[value & 0x7F])
        before, drive.state = drive.state, state
        if state == before or state < 0:
            return
        axes_enabled = sum(a.state == PowerState.OPERATION_ENABLED for (n, _), a in self._axes.items() if n == node)
        self.bus.power.setdefault(node, []).append((t_ns, axes_enabled))
        number = sum(axis.state == PowerState.OPERATION_ENABLED for axis in self._axes.values())
        if not self.bus.powered or self.bus.powered[-1][1] != number:
            self.bus.powered.append((t_ns, number))
        command = drive.command if drive.control >= 0 else None
        if state in FAULTS and before not in FAULTS:
            came = f", it was {_words(PowerState(before))}" if before >= 0 else " when the log begins"
            clue = self.clues.begin("drive_fault", node, t_ns, f"the drive goes to FAULT{came}", row=row, subject=axis)
            clue.axis, drive.resets = axis, 0
        elif state not in FAULTS and before in FAULTS:
            after_s = (t_ns - drive.reset_ns) / 1e9
            tries = f", {after_s:.2f} s after reset {drive.resets}" if drive.resets else ", and no reset was seen"
            self.clues.end("drive_fault", node, t_ns, f"it leaves FAULT{tries}", subject=axis)
        if state == PowerState.QUICK_STOP_ACTIVE and command is not Command.QUICK_STOP:
            text = "the drive does a quick stop that no controlword commands"
            self.clues.begin("quick_stop", node, t_ns, text, row=row, subject=axis).axis = axis
        elif before == PowerState.QUICK_STOP_ACTIVE:
            self.clues.end("quick_stop", node, t_ns, "the quick stop is over", subject=axis)
        enabled = PowerState.OPERATION_ENABLED
        if before == enabled and command is Command.ENABLE_OPERATION and state < enabled:
            text = f"the drive goes from Operation Enabled to {_words(PowerState(state))} against its controlword"
            self.clues.begin("left_enabled", node, t_ns, text, row=row, subject=axis).axis = axis
        elif state == enabled:
            self.clues.end("left_enabled", node, t_ns, "it is in Operation Enabled again", subject=axis)

    def _expect(self, row: int, t_ns: int, node: int, axis: int, drive: _DriveAxis) -> None:
        """Store the time since which a transition of the drive is due."""
        moves = False
        if drive.control >= 0 and drive.state >= 0 and drive.state not in FAULTS:
            moves = int(NEXT_STATE[drive.state, drive.command]) != drive.state
            moves |= drive.enabling and drive.state == PowerState.SWITCH_ON_DISABLED
        if not moves:
            drive.since_ns = -1
            self.clues.end("not_following", node, t_ns, "the drive follows", subject=axis)
        elif drive.since_ns < 0:
            drive.since_ns, drive.row = t_ns, row


def _words(value: PowerState | Command) -> str:
    return (
        value.name.replace("_", " ").title() if isinstance(value, PowerState) else value.name.lower().replace("_", " ")
    )
