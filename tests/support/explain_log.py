"""Logs made by hand: a few nodes that do what they should, and then something that they should not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from coulombus.explain.explained import Explainer
from coulombus.kernels.records import new_records
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.wire.can_flags import CAN_ERR_FLAG
from coulombus.wire.data_word import data_word
from coulombus.wire.frame import Frame

MS = 1_000_000
BEAT = 100
FAULT, ENABLED, DISABLED = 0x0218, 0x0637, 0x0250
TYPE_402 = "4300100092010200"


class Log:
    """Frames by time [ms]; `add` takes them in any order."""

    def __init__(self):
        self.rows = []

    def add(self, ms, can_id, data=b""):
        self.rows.append((round(ms * MS), can_id, len(data), data_word(bytes(data)), 0))
        return self

    def boot(self, node, ms=0.0):
        return self.add(ms, 0x700 + node, b"\0")

    def order(self, ms, command, node=0):
        return self.add(ms, 0x000, bytes((command, node)))

    def beats(self, node, begin, end, state=5, period=BEAT):
        for ms in np.arange(begin, end, period):
            self.add(ms, 0x700 + node, bytes((state,)))
        return self

    def ask(self, node, ms, request, answer=None, after=0.3):
        self.add(ms, 0x600 + node, bytes.fromhex(request))
        if answer is not None:
            self.add(ms + after, 0x580 + node, bytes.fromhex(answer))
        return self

    def synchronous(self, node, ms, rpdo=False):
        """Configure a node's first TPDO or RPDO by SDO: sent after each SYNC."""
        low, base = ("14", 0x200) if rpdo else ("18", 0x180)
        cob_id = (base + node).to_bytes(4, "little").hex()
        self.ask(node, ms, f"2300{low}01{cob_id}", f"6000{low}0100000000")
        return self.ask(node, ms + 1, f"2f00{low}0201000000", f"6000{low}0200000000")

    def cycles(self, begin, end, tpdos=(), period=2.0, skip=lambda cycle, node: False, data=None):
        for cycle, ms in enumerate(np.arange(begin, end, period)):
            self.add(ms, 0x080)
            for place, node in enumerate(tpdos):
                if not skip(cycle, node):
                    content = data(cycle, node) if data else (0x0637).to_bytes(2, "little") + bytes((cycle % 7,))
                    self.add(ms + 0.2 + 0.1 * place, 0x180 + node, content)
        return self

    def error(self, ms, classes, data):
        return self.add(ms, CAN_ERR_FLAG | classes, data)

    @property
    def frames(self):
        frames = new_records(Frame, len(self.rows))
        frames[:] = sorted(self.rows, key=lambda row: row[0])
        return frames

    def explained(self, comments=(), pieces=1, inside=None, **knowledge):
        """Return the explanation, of the whole or of so many pieces one after the other."""
        explainer = Explainer(KnownBus(**knowledge))
        cuts = np.linspace(0, len(self.rows), pieces + 1).astype(int)
        for start, end in pairwise(cuts):
            remarks = [(row - start, text) for row, text in comments if start <= row < end]
            explainer.add_frames(self.frames[start:end], remarks, inside)
        explainer.end()
        return explainer.explanation()


def machine(*nodes, until=3000, beats=True):
    """Return a log of nodes that boot, are started, and run until a time [ms]."""
    log = Log()
    for node in nodes:
        log.boot(node, node)
    log.order(50, 1)
    for node in nodes if beats else ():
        log.beats(node, 60 + node, until)
    return log


def kinds(explanation):
    return [incident.root.kind for incident in explanation.incidents]


def only(explanation):
    assert len(explanation.incidents) == 1, kinds(explanation)
    return explanation.incidents[0]


def drive(log, node, words, until=3000, step=10.0):
    """Add a drive's device type and its statuswords: (from ms, word)."""
    log.ask(node, 20, "4000100000000000", TYPE_402)
    ms = 70.0
    while ms < until:
        word = [w for begin, w in words if begin <= ms][-1]
        log.add(ms, 0x180 + node, word.to_bytes(2, "little"))
        ms += step
    return log
