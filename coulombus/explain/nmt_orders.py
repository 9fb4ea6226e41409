"""NMT commands that take a node out of OPERATIONAL while set-points are sent to it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.explain.bus import Bus, Order
from coulombus.explain.frames import Block, Frames, Integers
from coulombus.wire.clock import NEVER_NS

__all__ = ["Orders"]

WORKS_NS = 50_000_000
"""A master that still sends set-points so long after its own command would not have meant it."""
AT_WORK_NS = 1_000_000_000
"""Time after a set-point within which its node is at work."""
FORGOTTEN_NS = 2_000_000_000
"""Time after the start of other nodes within which a node with set-points is started, too."""
UNSTARTED_NS = 10_000_000_000
"""Time with set-points within which a node is started, if no node is."""
NONE = np.zeros(0, np.int64)
LEAST = 5
"""Set-points behind the command, at least."""


class Orders:
    """Compares NMT commands with the set-points (RPDOs) of the nodes concerned."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._seen = 0
        self._pending: dict[int, tuple[Order, int]] = {}
        """By node, the last command out of OPERATIONAL, and the number of set-points since."""
        self._last_ns: dict[int, int] = {}
        self._last_row: dict[int, int] = {}
        """By node, time and row of the last set-point."""
        self._told: set[tuple[int, int]] = set()
        """Nodes that nobody starts, and since when they are PRE-OPERATIONAL [ns]."""

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        orders, self._seen = self.bus.orders[self._seen :], len(self.bus.orders)
        set_points = self._set_points(block)
        for order in orders:
            for node in [n for n in {*set_points, *self._last_ns} if order.concerns(n)]:
                rows, t_ns = set_points.get(node, (NONE, NONE))
                place = int(rows.searchsorted(order.row))
                if order.command == NmtCommand.START:
                    self._follow(node, rows[:place], t_ns[:place])
                    self._pending.pop(node, None)
                    self.clues.end("ordered_away", node, order.t_ns, "it is started again")
                    continue
                last_ns = int(t_ns[place - 1]) if place else self._last_ns.get(node, -AT_WORK_NS)
                if order.t_ns - last_ns < AT_WORK_NS and self._is_at_work(node, order.t_ns - 1):
                    self._pending.setdefault(node, (order, 0))
        for node, (rows, t_ns) in set_points.items():
            self._follow(node, rows, t_ns)
            self._forgotten(node, t_ns)
            self._last_ns[node], self._last_row[node] = int(t_ns[-1]), int(rows[-1])

    def _is_at_work(self, number: int, t_ns: int) -> bool:
        """Return whether a node is OPERATIONAL at a time [ns], as far as it says, and its drive is not disarmed."""
        node = self.bus.nodes.get(number)
        state = -1 if node is None else node.state_at(t_ns)
        return state in (NmtState.OPERATIONAL, -1) and not self.bus.is_disarmed(number, t_ns)

    def _forgotten(self, number: int, t_ns: Integers) -> None:
        """Note a node that gets set-points, and that no command starts while others are started."""
        node = self.bus.nodes.get(number)
        started_ns = next(
            (o.t_ns for o in self.bus.orders if o.command == NmtCommand.START and not o.concerns(number)), NEVER_NS
        )
        if node is None or self.clues.stands("not_started", number):
            return
        for (since_ns, state), (until_ns, _) in pairwise([*node.states, (NEVER_NS, -1)]):
            due_ns = min(max(since_ns, started_ns) + FORGOTTEN_NS, since_ns + UNSTARTED_NS)
            place = int(t_ns.searchsorted(due_ns))
            if state != NmtState.PRE_OPERATIONAL or place == len(t_ns) or t_ns[place] > until_ns:
                continue
            is_noted = (number, since_ns) in self._told
            if not is_noted and self.bus.ordered(number, min(started_ns, since_ns), int(t_ns[place])) is None:
                self._told.add((number, since_ns))
                text = "set-points come to it, and no command starts it: it stays PRE-OPERATIONAL"
                clue = self.clues.begin("not_started", number, since_ns, text, due_ns=due_ns)
                clue.who = "host"
                later = next((t for t, then in node.states if t >= until_ns and then == NmtState.OPERATIONAL), None)
                if later is None:
                    return
                self.clues.end("not_started", number, later, "it is OPERATIONAL")

    def _set_points(self, block: Block) -> dict[int, tuple[Integers, Integers]]:
        """Return rows and times of all RPDOs of each node: by its map, else by the identifier."""
        groups: dict[int, list[Frames]] = {}
        for key, group in block.groups.items():
            node = self.bus.receiver(key)
            if node is not None:
                groups.setdefault(node, []).append(group)
        set_points = {}
        for node, some in groups.items():
            rows, t_ns = (np.concatenate([getattr(group, name) for group in some]) for name in ("rows", "t_ns"))
            order = np.argsort(rows)
            set_points[node] = rows[order], t_ns[order]
        return set_points

    def _follow(self, node: int, rows: Integers, t_ns: Integers) -> None:
        """Count set-points behind a command, and note that they go on."""
        if node not in self._pending:
            return
        order, count = self._pending[node]
        t_ns = t_ns[rows > max(order.row, self._last_row.get(node, -1))]
        self._pending[node] = order, count + len(t_ns)
        number = count + 1 + np.arange(len(t_ns))
        late = np.flatnonzero((t_ns - order.t_ns >= WORKS_NS) & (number >= LEAST))
        ended = 0 <= self.bus.safe_ns <= order.t_ns
        node_then = self.bus.nodes.get(node)
        if node_then is not None:
            late = late[node_then.states_at(t_ns[late]) != NmtState.OPERATIONAL]  # else it does not obey
        if len(late) and not ended and not self.clues.stands("ordered_away", node):
            words = NmtCommand(order.command).name.lower().replace("_", " ")
            text = f"NMT {words}, and set-points still come {(int(t_ns[late[0]]) - order.t_ns) / 1e6:.0f} ms later"
            self.clues.begin("ordered_away", node, order.t_ns, text, row=order.row)
