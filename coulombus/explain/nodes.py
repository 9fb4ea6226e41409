"""Nodes: boot-up, NMT, heartbeats, guarding and EMCY (CiA 301, 7.2.7 and 7.2.8)."""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.eds.cia305 import LssService
from coulombus.explain.bus import EMCY, HEARTBEAT, NMT, Bus, Order, Silence
from coulombus.explain.clues import Clue
from coulombus.explain.device_errors import error_check, error_text
from coulombus.explain.frames import REMOTE, Block
from coulombus.explain.seen_node import SeenNode
from coulombus.wire.clock import NEVER_NS
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
BOOT_NS = 5 * S
"""Time after a reset command within which a node boots."""
FLYING_NS, HEEDED_NS = 20_000_000, S
"""Time after a command within which a node's frames may still be from before it; the same for heartbeats."""
FLIPS = 4
"""Successive heartbeats with another state than the one before that two devices send."""
PROGRAM_NS = 60 * S
"""Time after a command to its program (1F51h) within which a node may be silent and boot."""
START_NS = 20_000_000_000
"""Time after a command to start its program within which a node boots."""
LIFE_ERROR = 0x8130
"""EMCY of a node that misses the heartbeat or guarding of another one."""
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
        self._loss: dict[int, Clue] = {}  # the open loss of a node
        self._returns: dict[int, int] = {}  # time of the first frame of a lost node
        self._waived: set[int] = set()  # nodes from which nothing is due: its absence is noted, or in order
        self._ids: dict[int, int] = {}  # node ids that LSS gave, and when
        self._next_ns = NEVER_NS  # nothing is overdue before

    def frame(self, block: Block, row: int, t_ns: int, key: int, word: int, length: int) -> None:
        """Process a frame of NMT, heartbeat, guarding or EMCY."""
        if key == NMT:
            self._nmt_command(row, t_ns, word, length)
        elif key == CobId.LSS_RX:
            if word & 0xFF == LssService.CONFIGURE_NODE_ID:
                self._ids[word >> 8 & 0xFF] = t_ns
        elif key & REMOTE:
            self._guard(block, row, t_ns, key & 0x7F)
        elif key >= HEARTBEAT:
            if length == 1:
                self._toggle(row, t_ns, key & 0x7F, word)
                self._heartbeat(block, row, t_ns, key & 0x7F, word & 0x7F)
        else:
            self._emcy(row, t_ns, key - EMCY, data_bytes(word, length))

    def begin(self, block: Block) -> None:
        """Make the records of new nodes, and search the block for frames of lost ones."""
        for key, group in block.groups.items():
            number = self.bus.sender(key)
            if number is not None:
                node, first = self.bus.nodes.get(number), int(group.t_ns[0])
                if node is None or first < node.first_ns:
                    self.bus.node(number, first).first_ns = first
        self._loss = {number: clue for number, clue in self._loss.items() if clue.end_ns is None}
        for number in self._loss:
            self._seek(block, number)

    def end(self, block: Block) -> None:
        """Store each node's last frame."""
        for key, group in block.groups.items():
            number = self.bus.sender(key)
            if number is not None:
                node = self.bus.node(number, int(group.t_ns[0]))
                node.last_ns = max(node.last_ns, int(group.t_ns[-1]))

    def _seek(self, block: Block | None, number: int) -> None:
        """Find the first frame of a lost node that is no heartbeat."""
        clue = self._loss[number]
        for key, group in block.groups.items() if block is not None and clue.end_ns is None else ():
            place = int(group.t_ns.searchsorted(clue.due_ns, "right"))
            if place < len(group) and key & 0x780 != HEARTBEAT and self.bus.sender(key) == number:
                self._returns[number] = min(self._returns.get(number, NEVER_NS), int(group.t_ns[place]))
        self._next_ns = min(self._next_ns, self._returns.get(number, NEVER_NS))

    def _return(self, number: int, t_ns: int) -> None:
        """End a loss: a frame came that is no heartbeat."""
        del self._returns[number]
        clue, node = self._loss.pop(number), self.bus.nodes[number]
        if not self.clues.end(clue.kind, number, t_ns, "other frames of it come again"):
            return
        if node.heartbeat_ns >= 0 and node.period_ns:
            text = f"its heartbeats do not come, its other frames do: {self._due_text(node)}"
            self.clues.begin("heartbeat_lost", number, t_ns, text, row=node.heartbeat_row, due_ns=t_ns)

    def note_overdue(self, block: Block | None, t_ns: int) -> None:
        """Note what became overdue before a time [ns], in the order in which it did."""
        if self.bus.beats_changed:
            self.bus.beats_changed = False
            self._next_ns = self._earliest_ns()
        while self._next_ns < t_ns:
            at_ns = self._next_ns
            due = [(self._due_ns(node), node.number) for node in self.bus.nodes.values()]
            for when, number in sorted(due):
                if when <= at_ns:
                    self._overdue(block, when, self.bus.nodes[number])
            self._next_ns = self._earliest_ns()

    def _earliest_ns(self) -> int:
        """Return the time at which the first of all nodes counts as lost."""
        return min((self._due_ns(node) for node in self.bus.nodes.values()), default=NEVER_NS)

    def _due_ns(self, node: SeenNode) -> int:
        """Return the time at which a node counts as lost if no frame of it comes before."""
        if node.number in self._returns or node.number in self._waived:
            return self._returns.get(node.number, NEVER_NS)
        if node.reset_ns >= 0:
            return node.reset_ns + BOOT_NS
        if node.program_starts:
            return node.program_ns + START_NS
        if node.number in self._toggles or node.heartbeat_ns < 0 or not node.period_ns:
            return NEVER_NS
        return node.heartbeat_ns + round(LOST * node.period_ns)

    def _expect(self, node: SeenNode) -> None:
        """Wait for the next heartbeat or boot-up."""
        self._waived.discard(node.number)
        due_ns = self._due_ns(node)
        if due_ns < self._next_ns:
            self._next_ns = due_ns

    def _overdue(self, block: Block | None, at_ns: int, node: SeenNode) -> None:
        """Note a heartbeat or boot-up that did not come, or a node that came back."""
        if node.number in self._returns:
            self._return(node.number, at_ns)
            return
        self._waived.add(node.number)
        number, row = node.number, node.heartbeat_row
        last = self.bus.last_heard(block, number, at_ns)
        if self._has_moved(last):
            return
        if node.reset_ns >= 0:
            if last <= node.reset_ns + FLYING_NS:
                text = f"nothing comes from it since the reset command at {self._at(node.reset_ns)}: it does not boot"
                self._lost(block, node, last, text, row, node.reset_ns + BOOT_NS)
            return
        if node.program_starts:
            node.program_starts = False
            if last <= node.program_ns + FLYING_NS:
                text = f"nothing comes from it since its program was started at {self._at(node.program_ns)} (1F51h)"
                self._lost(block, node, last, text, row, node.program_ns + START_NS)
            return
        due = node.heartbeat_ns + node.period_ns
        if self._said_goodbye(node) or self._stands(number) or self._programmed(node, at_ns):
            return
        if last <= due:
            text = f"nothing comes from it any more: {self._due_text(node)}"
            self._lost(block, node, max(last, node.heartbeat_ns), text, row, due)
        else:
            text = f"its heartbeats stop, its other frames still come: {self._due_text(node)}"
            self.clues.begin("heartbeat_lost", number, due, text, row=row, due_ns=due)

    def _has_moved(self, last_ns: int) -> bool:
        """Return whether a node that is silent since then boots with a node id that LSS gave it; each one counts once."""
        for number, given_ns in self._ids.items():
            node = self.bus.nodes.get(number)
            if node is not None and node.first_ns == node.booted_ns > max(given_ns, last_ns):
                del self._ids[number]
                return True
        return False

    def _programmed(self, node: SeenNode, t_ns: int) -> bool:
        return node.program_ns >= 0 and t_ns - node.program_ns < PROGRAM_NS

    def _lost(self, block: Block | None, node: SeenNode, t_ns: int, text: str, row: int, due_ns: int) -> None:
        """Begin the loss of a node."""
        is_host = self.bus.is_host(node.number, due_ns) or self._ends_sync(block, node, due_ns)
        kind = "host_lost" if is_host else "node_lost"
        if kind == "host_lost":
            self.bus.silences.append(Silence(due_ns))
        self._loss[node.number] = self.clues.begin(kind, node.number, t_ns, text, row=row, due_ns=due_ns)
        self._seek(block, node.number)

    def _ends_sync(self, block: Block | None, node: SeenNode, due_ns: int) -> bool:
        """Return whether SYNC ended, too, at the silence of a node that only sent heartbeats: it is the host."""
        last_ns = self.bus.last_sync_ns(block, node.heartbeat_ns + round(LOST * node.period_ns))
        ended = 0 <= node.heartbeat_ns - node.period_ns <= last_ns <= due_ns
        return ended and self.bus.only_beats(node.number, due_ns)

    def _stands(self, number: int) -> bool:
        return any(self.clues.stands(kind, number) for kind in LOST_KINDS)

    def _due_text(self, node: SeenNode) -> str:
        return f"the last heartbeat was due after {node.period_ns / 1e6:g} ms"

    def _said_goodbye(self, node: SeenNode) -> bool:
        """Return whether it is a host that had started nodes, and commanded all of them away before its silence."""
        until_ns = node.heartbeat_ns + round(LOST * node.period_ns)
        others = [n for n in self.bus.nodes if n != node.number and self.bus.present(n, until_ns)]
        started = any(order.command == NmtCommand.START and order.t_ns <= until_ns for order in self.bus.orders)
        started |= any(self.bus.nodes[n].was(NmtState.OPERATIONAL, until_ns) for n in others)
        left = [self.bus.left_on_order(n, until_ns) for n in others]
        return bool(left) and all(left) and started and self.bus.is_host(node.number, until_ns)

    def _nmt_command(self, row: int, t_ns: int, word: int, length: int) -> None:
        if length != 2 or word & 0xFF not in list(NmtCommand):
            return
        self.bus.canopen += 1
        order = Order(t_ns, word & 0xFF, word >> 8 & 0x7F, row)
        self.bus.orders.append(order)
        if order.command == NmtCommand.START:
            self.bus.expect_sync(written=False)
        for node in self.bus.nodes.values():
            if not order.concerns(node.number) or node.first_ns > t_ns:
                continue
            if order.command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
                self._reset(order, node)
            if order.command != NmtCommand.START:
                node.was_operational = False

    def _reset(self, order: Order, node: SeenNode) -> None:
        """Wait for the boot-up of a node that is commanded to reset; a host does not command itself."""
        if self._stands(node.number) or node.reset_ns >= 0 or self.bus.is_host(node.number, order.t_ns):
            return
        node.reset_ns, node.reset_alone = order.t_ns, order.node == node.number
        self._expect(node)

    def _heartbeat(self, block: Block, row: int, t_ns: int, number: int, state: int) -> None:
        node = self.bus.node(number, t_ns)
        self.bus.canopen += 1
        if self._asked or self._loss or self._returns:
            for waiting in (self._asked, self._loss, self._returns):
                waiting.pop(number, None)
        if state == NmtState.INITIALISING:
            self._boot(row, t_ns, node)
            return
        if node.state == NmtState.INITIALISING and self.bus.ordered(number, node.booted_ns, t_ns) is not None:
            node.always_operational = False  # it obeys: it is no host
        if node.reset_ns >= 0:
            self._after_reset(row, t_ns, node, state)
        self._interval(row, t_ns, node)
        self._state(row, t_ns, node, state)
        node.heartbeat_ns, node.heartbeat_row, node.last_ns = t_ns, row, t_ns
        self._expect(node)

    def _boot(self, row: int, t_ns: int, node: SeenNode) -> None:
        reset = self.bus.ordered(node.number, max(node.booted_ns, t_ns - ANSWERED_NS), t_ns, NmtState.INITIALISING)
        lost = [kind for kind in LOST_KINDS if self.clues.stands(kind, node.number)]
        if node.booted_ns >= 0 and t_ns - node.booted_ns < SAME_NS:
            return  # a duplicated frame
        if reset is None and not self._programmed(node, t_ns) and node.first_ns < t_ns:
            text = "it sends boot-up without an NMT reset"
            if node.boots and self.clues.stands("restarted", node.number):
                text = "it sends boot-up again and again"
            self.clues.begin("restarted", node.number, t_ns, text, row=row)
        for kind in lost:
            self.clues.end(kind, node.number, t_ns, "it boots")
        for kind in ("left_operational", "not_hearing"):
            self.clues.end(kind, node.number, t_ns, "it boots")
        self.clues.end_all("emcy", node.number, t_ns, "it boots")
        node.boots += 1
        node.program_starts = False
        node.booted_ns = t_ns
        node.enter(t_ns, NmtState.INITIALISING)
        node.heartbeat_ns, node.period_ns, node.reset_ns = -1, 0, -1
        node.gaps.clear()
        node.objects.clear()
        node.last_ns = t_ns
        self.bus.stale = True

    def _after_reset(self, row: int, t_ns: int, node: SeenNode, state: int) -> None:
        """Compare a heartbeat after a reset command with those before it."""
        if state == node.state and t_ns < node.reset_ns + HEEDED_NS:
            return
        other = node.reset_alone or self.bus.host >= 0  # the sender of a command to all nodes does not obey it
        if other and state == node.state and t_ns - node.heartbeat_ns < LOST * (node.period_ns or HEEDED_NS):
            text = f"commanded to reset at {self._at(node.reset_ns)}, it sends heartbeats and no boot-up"
            since = node.life_ns if 0 <= node.reset_ns - node.life_ns < ANSWERED_NS else node.reset_ns
            self.clues.begin("not_hearing", node.number, since, text, row=row)
        node.reset_ns = -1

    def _interval(self, row: int, t_ns: int, node: SeenNode) -> None:
        """Learn the period of the heartbeats, and note late and early ones."""
        number = node.number
        if self.clues.any_open(number):
            if self.clues.end("host_lost", number, t_ns, "its heartbeats come again"):
                self.bus.silences[-1].back_ns = t_ns
            for kind in LOST_KINDS:
                self.clues.end(kind, number, t_ns, "its heartbeats come again")
        if node.heartbeat_ns < 0 or node.heartbeat_row < 0 or number in self._toggles:
            return  # a guarded node only responds to requests
        gap = t_ns - node.heartbeat_ns
        node.intervals.add(gap)
        configured = node.objects.get((0x1017, 0), 0) * 1_000_000
        if configured and configured != node.period_ns:
            node.period_ns, node.learned_ns = configured, t_ns
            node.gaps.clear()
            return  # the first interval of a new period
        if not node.period_ns:
            if gap < LEAST_PERIOD_NS:
                return  # stamps of frames that waited in the recorder's queue
            node.gaps.append(gap)
            recent = sorted(node.gaps[-5:])
            if len(recent) >= 3 and recent[-1] < 1.3 * recent[0]:
                node.period_ns, node.learned_ns = recent[len(recent) // 2], t_ns
            return
        period = node.period_ns
        late_ns = self._late_after(node) if gap > 1.3 * period else 0
        if LOST * period > gap > late_ns > 0:
            text = f"a heartbeat came after {gap / 1e6:.1f} ms, its period is {period / 1e6:g} ms"
            self.clues.note("heartbeat_late", number, t_ns, text, row=row)
        elif gap < LOST * period:
            node.gaps = [*node.gaps[1 - USUAL :], gap]
        soon = self._short.setdefault(number, [])
        before, node.last_gap_ns = node.last_gap_ns, gap
        soon.append(SAME_NS < gap < 0.7 * period and 0.8 * period < gap + before < 1.2 * period)
        del soon[:-12]
        if soon[-1] and sum(soon) >= 4:
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
        before = node.state
        node.enter(t_ns, state)
        self._alternates(row, t_ns, node, before != state)
        node.always_operational &= state == NmtState.OPERATIONAL
        number = node.number
        if state == NmtState.OPERATIONAL:
            node.was_operational = True
            if self.clues.any_open(number):
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

    def _alternates(self, row: int, t_ns: int, node: SeenNode, changes: bool) -> None:
        """Note two devices whose heartbeats tell two states in turn."""
        if not changes:
            node.flips.clear()
            return
        node.flips = times = [*node.flips[1 - FLIPS :], t_ns]
        if len(times) == FLIPS and self.bus.ordered(node.number, times[0], t_ns) is None:
            text = "its heartbeats tell two states in turn: two devices send them"
            if not self.clues.stands("duplicate_node", node.number, "heartbeat"):
                self.clues.begin("duplicate_node", node.number, times[0], text, row=row, subject="heartbeat")

    def _guard(self, block: Block, row: int, t_ns: int, number: int) -> None:
        """Process a request of node guarding (CiA 301, 7.2.8.3.2.1)."""
        self._toggles.setdefault(number, (-1, -1))
        waiting = self._asked.setdefault(number, [])
        waiting.append(t_ns)
        if len(waiting) == UNANSWERED and self.bus.present(number, t_ns):
            if self.bus.last_heard(block, number, t_ns) <= waiting[0]:
                text = "three node guarding requests are unanswered, and nothing else comes from it"
                self._lost(block, self.bus.nodes[number], waiting[0], text, row, waiting[0])
            else:
                text = "three node guarding requests are unanswered"
                self.clues.begin("heartbeat_lost", number, waiting[0], text, row=row, due_ns=waiting[0])

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
        code = int.from_bytes(data[:2], "little")
        self.bus.nodes[number].emergencies += code != 0
        if code == 0 and any(data[2:3]):
            return  # one error is over, another one remains (CiA 301, 7.2.7.1)
        if code == 0:
            self.clues.end_all("emcy", number, t_ns, "EMCY 0000h: no error any more")
            return
        if code == LIFE_ERROR:
            self.bus.nodes[number].life_ns = t_ns
        text = f"EMCY {error_text(code)}"
        if len(data) >= 3:
            text += f" (error register {data[2]:02X}h)"
        self.clues.begin("emcy", number, t_ns, text, row=row, subject=code).check = error_check(code)

    def _at(self, t_ns: int) -> str:
        return f"{(t_ns - self.bus.first_ns) / 1e9:.3f} s"
