"""Nodes: boot-up, NMT, heartbeats, guarding and EMCY (CiA 301, 7.2.7 and 7.2.8)."""

from __future__ import annotations

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.explain.bus import EMCY, HEARTBEAT, NMT, Bus, Order
from coulombus.explain.device_errors import error_text
from coulombus.explain.frames import REMOTE, Block
from coulombus.explain.seen_node import SeenNode
from coulombus.wire.data_word import data_bytes

__all__ = ["Nodes"]

S = 1_000_000_000
LOST_KINDS = ("node_lost", "host_lost", "heartbeat_lost")
UNANSWERED = 3
"""Unanswered node guarding requests after which a node is lost: the usual life time factor."""
LEAST_PERIOD_NS = 500_000
"""1017h counts milliseconds: no producer is faster."""
SAME_NS = 300_000
"""Time within which two frames are one duplicated frame."""
LOST = 2.5
"""Periods after which a heartbeat is lost."""
USUAL = 8
"""Heartbeat intervals needed to learn their spread; before, none counts as late."""
ANSWERED_NS = 10 * S
"""Time after a reset command within which a boot-up is its response."""
STATES = {
    NmtState.STOPPED: "STOPPED",
    NmtState.OPERATIONAL: "OPERATIONAL",
    NmtState.PRE_OPERATIONAL: "PRE-OPERATIONAL",
}


class Nodes:
    """Monitors the presence and NMT state of nodes."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._asked: dict[int, list[int]] = {}  # unanswered guarding requests
        self._toggles: dict[int, tuple[int, int]] = {}  # toggle bit and time of the last guarding response; -1: none
        self._short: dict[int, list[bool]] = {}  # whether the last heartbeats were far too early

    def frame(self, block: Block, row: int, t_ns: int, key: int, word: int, length: int) -> None:
        """Process a frame of NMT, heartbeat, guarding or EMCY."""
        if key == NMT:
            self._order(row, t_ns, word, length)
        elif key & REMOTE:
            self._guard(block, row, t_ns, key & 0x7F)
        elif key >= HEARTBEAT:
            if length == 1:
                self._toggle(row, t_ns, key & 0x7F, word)
                self._heartbeat(block, row, t_ns, key & 0x7F, word & 0x7F)
        else:
            self._emcy(row, t_ns, key - EMCY, data_bytes(word, length))

    def seen(self, block: Block) -> None:
        """Store each node's last frame, and note overdue events."""
        for key, group in block.groups.items():
            number = self.bus.sender(key)
            if number is not None:
                node = self.bus.node(number, int(group.t_ns[0]))
                node.last_ns = max(node.last_ns, int(group.t_ns[-1]))
        if len(block.t_ns):
            self.look(int(block.t_ns[-1]))

    def look(self, t_ns: int) -> None:
        """Note heartbeats overdue at a time."""
        for node in list(self.bus.nodes.values()):
            due = node.heartbeat_ns + node.period_ns
            if (
                node.number in self._toggles
                or node.heartbeat_ns < 0
                or not node.period_ns
                or t_ns < node.heartbeat_ns + LOST * node.period_ns
            ):
                continue
            if self.bus.ordered(node.number, node.heartbeat_ns, t_ns, NmtState.INITIALISING):
                continue
            if self._said_goodbye(node):
                continue
            silent = node.last_ns <= due
            lost = self._lost(node.number)
            kind = lost if silent else "heartbeat_lost"
            if self.clues.stands(lost, node.number):
                if silent:
                    continue
                self.clues.end(lost, node.number, node.last_ns, "other frames of it come again")
            if self.clues.stands(kind, node.number):
                continue
            what = "nothing comes from it any more" if silent else "its heartbeats stop, its other frames still come"
            begin = max(node.last_ns, node.heartbeat_ns) if silent else due
            text = f"{what}: the last heartbeat was due after {node.period_ns / 1e6:g} ms"
            self.clues.begin(kind, node.number, begin, text, row=node.heartbeat_row)

    def _said_goodbye(self, node: SeenNode) -> bool:
        """Return whether it is a host whose last NMT command before its silence was not a start: an orderly end."""
        until_ns = node.heartbeat_ns + LOST * node.period_ns
        last = next((order for order in reversed(self.bus.orders) if order.t_ns <= until_ns), None)
        return node.number == self.bus.host and last is not None and last.command != NmtCommand.START

    def _lost(self, number: int) -> str:
        return "host_lost" if number == self.bus.host else "node_lost"

    def _order(self, row: int, t_ns: int, word: int, length: int) -> None:
        if length != 2 or word & 0xFF not in list(NmtCommand):
            return
        self.bus.canopen += 1
        order = Order(t_ns, word & 0xFF, word >> 8 & 0x7F, row)
        self.bus.orders.append(order)
        for node in self.bus.nodes.values():
            if not order.concerns(node.number):
                continue
            if order.command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
                node.heartbeat_ns, node.period_ns = -1, 0
                node.gaps.clear()
            if order.command != NmtCommand.START:
                node.was_operational = False

    def _heartbeat(self, block: Block, row: int, t_ns: int, number: int, state: int) -> None:
        new = number not in self.bus.nodes
        node = self.bus.node(number, t_ns)
        self.bus.canopen += 1
        self._asked.pop(number, None)
        if state == NmtState.INITIALISING:
            self._boot(row, t_ns, node, new)
            return
        self._interval(block, row, t_ns, node)
        self._state(row, t_ns, node, state)
        node.heartbeat_ns, node.heartbeat_row, node.last_ns = t_ns, row, t_ns

    def _boot(self, row: int, t_ns: int, node: SeenNode, new: bool) -> None:
        reset = self.bus.ordered(node.number, max(node.booted_ns, t_ns - ANSWERED_NS), t_ns, NmtState.INITIALISING)
        lost = [kind for kind in LOST_KINDS if self.clues.stands(kind, node.number)]
        if node.booted_ns >= 0 and t_ns - node.booted_ns < SAME_NS:
            return  # a duplicated frame
        if reset is None and not new:
            text = "it sends boot-up without an NMT reset"
            if node.boots and self.clues.stands("restarted", node.number):
                text = "it sends boot-up again and again"
            self.clues.begin("restarted", node.number, t_ns, text, row=row)
        for kind in lost:
            self.clues.end(kind, node.number, t_ns, "it boots")
        self.clues.end("left_operational", node.number, t_ns, "it boots")
        node.boots += 1
        node.booted_ns, node.state = t_ns, NmtState.INITIALISING
        node.heartbeat_ns, node.period_ns = -1, 0
        node.gaps.clear()
        node.objects.clear()
        node.last_ns = t_ns
        self.bus.stale = True

    def _interval(self, block: Block, row: int, t_ns: int, node: SeenNode) -> None:
        """Learn the period of the heartbeats, and note late and early ones."""
        number = node.number
        for kind in LOST_KINDS:
            self.clues.end(kind, number, t_ns, "its heartbeats come again")
        if node.heartbeat_ns < 0 or number in self._toggles:
            return  # a guarded node only responds to requests
        gap = t_ns - node.heartbeat_ns
        configured = node.objects.get((0x1017, 0), 0) * 1_000_000
        if configured and configured != node.period_ns:
            node.period_ns = configured
            node.gaps.clear()
            return  # the first interval of a new period
        if not node.period_ns:
            if gap < LEAST_PERIOD_NS:
                return  # stamps of frames that waited in the recorder's queue
            node.gaps.append(gap)
            recent = sorted(node.gaps[-5:])
            if len(recent) >= 3 and recent[-1] < 1.3 * recent[0]:
                node.period_ns = recent[len(recent) // 2]
            return
        period = node.period_ns
        if gap > LOST * period and self._said_goodbye(node):
            return
        late_ns = self._late_after(node) if gap > 1.3 * period else 0
        if gap > LOST * period:
            due = node.heartbeat_ns + period
            last = self.bus.last_heard(block, number, round(node.heartbeat_ns + LOST * period))
            silent = last <= due
            kind = self._lost(number) if silent else "heartbeat_lost"
            text = f"no heartbeat for {gap / 1e6:.0f} ms, its period is {period / 1e6:g} ms"
            text += ", and none of its other frames" if silent else "; its other frames came"
            self.clues.begin(kind, number, max(last, node.heartbeat_ns) if silent else due, text, row=row)
            self.clues.end(kind, number, t_ns, "its heartbeats come again")
        elif late_ns and gap > late_ns:
            text = f"a heartbeat came after {gap / 1e6:.1f} ms, its period is {period / 1e6:g} ms"
            self.clues.note("heartbeat_late", number, t_ns, text, row=row)
        else:
            node.gaps = [*node.gaps[1 - USUAL :], gap]
        soon = self._short.setdefault(number, [])
        before, node.last_gap_ns = node.last_gap_ns, gap
        soon.append(SAME_NS < gap < 0.7 * period and 0.8 * period < gap + before < 1.2 * period)
        del soon[:-12]
        if sum(soon) >= 4:
            text = f"heartbeats come twice within a period of {period / 1e6:g} ms: two devices send them"
            self.clues.begin("duplicate_node", number, t_ns, text, row=row, subject="heartbeat")

    def _late_after(self, node: SeenNode) -> int:
        """Return the time [ns] after which a heartbeat is late: half a period after the longest
        usual interval, and never before half the time of every consumer in the log (1016h); 0 if
        the usual intervals are unknown. A producer may send only in its own cycle: then intervals
        of one and two cycles are usual.
        """
        if len(node.gaps) < USUAL:
            return 0
        waiting = [
            (value & 0xFFFF) * 1_000_000
            for consumer in self.bus.nodes.values()
            for (index, _), value in consumer.objects.items()
            if index == 0x1016 and value >> 16 & 0x7F == node.number
        ]
        return max(max(node.gaps) + node.period_ns // 2, min(waiting, default=0) // 2)

    def _state(self, row: int, t_ns: int, node: SeenNode, state: int) -> None:
        before, node.state = node.state, state
        number = node.number
        if state == NmtState.OPERATIONAL:
            node.was_operational = True
            self.clues.end("left_operational", number, t_ns, "it is OPERATIONAL again")
            self.clues.end("restarted", number, t_ns, "it is OPERATIONAL again")
            self.clues.end("not_started", number, t_ns, "it is OPERATIONAL")
            return
        since = max(node.heartbeat_ns - 10_000_000, 0)
        order = self.bus.ordered(number, since, t_ns)
        if before == NmtState.OPERATIONAL and order is None and node.was_operational:
            node.was_operational = False
            text = f"it went from OPERATIONAL to {STATES.get(NmtState(state), '?') if state in STATES else state} unordered"
            self.clues.begin("left_operational", number, t_ns, text, row=row)
        last = self.bus.ordered(number, -1, t_ns)
        period = node.period_ns or 100_000_000
        if (
            last is not None
            and last.command == NmtCommand.START
            and before == state
            and node.booted_ns < last.t_ns
            and t_ns - last.t_ns > 2 * period + 20_000_000
            and not self.clues.stands("left_operational", number)
        ):
            text = f"ordered to start at {self._at(last.t_ns)}, it stays {STATES.get(NmtState(state), state)}"
            if not self.clues.stands("not_started", number):
                self.clues.begin("not_started", number, last.t_ns, text, row=row)

    def _guard(self, block: Block, row: int, t_ns: int, number: int) -> None:
        """Process a request of node guarding (CiA 301, 7.2.8.3.2.1)."""
        self._toggles.setdefault(number, (-1, -1))
        waiting = self._asked.setdefault(number, [])
        waiting.append(t_ns)
        if len(waiting) == UNANSWERED and number in self.bus.nodes:
            silent = self.bus.last_heard(block, number, t_ns) <= waiting[0]
            kind = self._lost(number) if silent else "heartbeat_lost"
            text = "three node guarding requests are unanswered" + (
                ", and nothing else comes from it" if silent else ""
            )
            self.clues.begin(kind, number, waiting[0], text, row=row)

    def _toggle(self, row: int, t_ns: int, number: int, word: int) -> None:
        """Compare the toggle bit of a node guarding response with the previous one."""
        if number not in self._toggles:
            return
        if word & 0x7F == NmtState.INITIALISING:
            self._toggles[number] = -1, t_ns
            return
        (before, before_ns), toggle = self._toggles[number], word >> 7 & 1
        if toggle == before and t_ns - before_ns >= SAME_NS:
            text = f"two answers to node guarding in a row have toggle bit {toggle}"
            self.clues.note("guard_toggle", number, t_ns, text, row=row)
        self._toggles[number] = toggle, t_ns

    def _emcy(self, row: int, t_ns: int, number: int, data: bytes) -> None:
        if len(data) < 2:
            return
        self.bus.node(number, t_ns)
        self.bus.canopen += 1
        code = int.from_bytes(data[:2], "little")
        if code == 0:
            self.clues.end_all("emcy", number, t_ns, "EMCY 0000h: no error any more")
            return
        text = f"EMCY {error_text(code)}"
        if len(data) >= 3:
            text += f" (error register {data[2]:02X}h)"
        self.clues.begin("emcy", number, t_ns, text, row=row, subject=code)

    def _at(self, t_ns: int) -> str:
        return f"{(t_ns - self.bus.first_ns) / 1e9:.3f} s"
