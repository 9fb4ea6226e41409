"""NMT commands that take a node out of OPERATIONAL while set-points are sent to it."""

from __future__ import annotations

from coulombus.eds.cia301 import NmtCommand
from coulombus.explain.bus import Bus, Order
from coulombus.explain.frames import Block, Integers

__all__ = ["Orders"]

WORKS_NS = 50_000_000
"""A master that still sends set-points so long after its own command would not have meant it."""
LEAST = 5
"""Set-points behind the command, at least."""


class Orders:
    """Compares NMT commands with the set-points (RPDOs) of the nodes concerned."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._seen = 0
        self._pending: dict[int, tuple[Order, int]] = {}
        """By node, the last command out of OPERATIONAL, and the number of set-points since."""
        self._at_work: set[int] = set()
        """Nodes that got set-points in the block before."""

    def take(self, block: Block) -> None:
        """Process a block."""
        orders, self._seen = self.bus.orders[self._seen :], len(self.bus.orders)
        set_points = [
            (known.node, group.t_ns)
            for key, group in block.groups.items()
            if (known := self.bus.maps.get(key)) is not None and known.direction == "rpdo"
        ]
        for order in orders:
            for node in [n for n in self.bus.nodes if order.concerns(n)]:
                if order.command == NmtCommand.START:
                    for n, t_ns in set_points:
                        if n == node and node in self._pending:
                            since = self._pending[node][0].t_ns
                            self._follow(node, t_ns[(t_ns > since) & (t_ns < order.t_ns)])
                    self._pending.pop(node, None)
                    self.clues.end("ordered_away", node, order.t_ns, "it is started again")
                elif node in self._at_work or any(n == node and t_ns[0] < order.t_ns for n, t_ns in set_points):
                    self._pending.setdefault(node, (order, 0))
        for node, t_ns in set_points:
            if node in self._pending:
                self._follow(node, t_ns[t_ns > self._pending[node][0].t_ns])
        self._at_work = {node for node, _ in set_points}

    def _follow(self, node: int, t_ns: Integers) -> None:
        order, count = self._pending[node]
        self._pending[node] = order, count + len(t_ns)
        late = len(t_ns) and int(t_ns[-1]) - order.t_ns >= WORKS_NS
        ended = 0 <= self.bus.safe_ns <= order.t_ns
        if late and count + len(t_ns) >= LEAST and not ended and not self.clues.stands("ordered_away", node):
            words = NmtCommand(order.command).name.lower().replace("_", " ")
            text = f"NMT {words}, and set-points still come {(int(t_ns[-1]) - order.t_ns) / 1e6:.0f} ms later"
            self.clues.begin("ordered_away", node, order.t_ns, text, row=order.row)
