"""Log of a bus in a test: its frames as `coulombus decode` prints them, and assertions about their order.

A phrase names a line by its words, in any case: ``"SDO write 1017h"``, ``"NMT start node 5"``,
``"EMCY node 5"``, ``"heartbeat boot-up"``. The words are those of the decoded line, in any order; a
service, such as SDO, NMT, EMCY or TPDO1, stands first. ``write`` and ``read`` are the requests of
an SDO client, ``node 5`` is the line's node, and ``1017h`` stands for each of its sub-indices.
``of`` and ``to`` have no meaning.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import NamedTuple

from coulombus.eds.eds_folder import EdsFiles
from coulombus.kernels.records import Records
from coulombus.monitor.decode import BareDecoder, Row, as_text
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.sim_bus.faults.fault_file import FaultPlan
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.system.foreign_text import printable

__all__ = ["BusLog", "LoggedNetwork", "inject"]

REPORTED = 100
"""Lines of the log in a failure report, the newest."""
POLL_S = 0.005
MEANING = {
    "write": ("initiate", "download", "request"),
    "read": ("initiate", "upload", "request"),
    "of": (),
    "to": (),
}
NODE = re.compile(r"\bnode +(\S+)")
SERVICE = re.compile(r"sdo|nmt|emcy|heartbeat|sync|time|lss|error|[tr]pdo\d+")
"""First word of a phrase that is the line's service, and no word of an object's name."""
TIME_COLUMNS = 14


class _LoggedLine(NamedTuple):
    t_s: float
    node: str
    service: str
    words: frozenset[str]
    text: str


class BusLog:
    """Everything that was on the bus of `world`.

    Parameters
    ----------
    world : the bus and its devices, whose EDS files name the objects
    flush : passes the frames up to now to `write`
    patience_s : longest wait of an assertion for a line to come; 0 in virtual time
    """

    def __init__(self, world: VirtualNetwork, flush: Callable[[], object], patience_s: float = 0.0) -> None:
        self._world, self._flush, self._patience_s = world, flush, patience_s
        self._batches: list[Records] = []
        self._markers: list[tuple[int, str]] = []
        self._lines: list[_LoggedLine] = []
        self._decoded = self._devices = 0
        self._decoder = BareDecoder(KnownBus())
        world.on_frames = self.write

    def write(self, frames: Records) -> None:
        """Append a batch of frames."""
        self._batches.append(frames.copy())

    def mark(self, t_ns: int, text: str) -> None:
        """Add a line with a text, such as an injected fault."""
        self._markers.append((t_ns, text))

    def lines(self) -> list[str]:
        """Return all lines up to now: time [s], identifier, node, service, content."""
        return [line.text for line in self._decode()]

    def said(self, phrase: str) -> list[str]:
        """Return the lines of a phrase up to now."""
        matches = _matcher(phrase)
        return [line.text for line in self._decode() if matches(line)]

    def assert_said(self, *phrases: str) -> None:
        """Assert that the phrases are on the bus, in this order; other lines may be between them."""
        __tracebackhide__ = True

        def end() -> str:
            rest = iter(self._decode())
            missing = (phrase for phrase in phrases if not any(map(_matcher(phrase), rest)))
            return next(missing, "")

        if missing := self._await(end):
            before = phrases[: phrases.index(missing)]
            after = f" after {' and '.join(map(repr, before))}" if before else ""
            raise AssertionError(f"{missing!r} was not on the bus{after}")

    def assert_before(self, first: str, then: str) -> None:
        """Assert that `first` is on the bus, and only then, for the first time, `then`."""
        __tracebackhide__ = True
        is_first, is_then = _matcher(first), _matcher(then)

        def missing() -> str:
            return "" if any(map(is_then, self._decode())) else then

        if self._await(missing):
            raise AssertionError(f"{then!r} was not on the bus")
        for line in self._decode():
            if is_first(line):
                return
            if is_then(line):
                raise AssertionError(f"{then!r} was on the bus before {first!r}:\n{line.text}")

    def report(self, count: int = REPORTED) -> str:
        """Return the newest lines."""
        lines = self.lines()
        earlier = len(lines) - count
        return "\n".join([f"({earlier} earlier lines)", *lines[-count:]] if earlier > 0 else lines)

    def _await(self, missing: Callable[[], str]) -> str:
        """Return an empty text as soon as nothing is missing, or what is missing at the end."""
        end = time.monotonic() + self._patience_s
        while (text := missing()) and time.monotonic() < end:
            time.sleep(POLL_S)
        return text

    def _decode(self) -> list[_LoggedLine]:
        self._flush()
        devices = self._world.devices
        if len(devices) > self._devices:  # its EDS names the objects of its earlier frames, too
            self._devices, self._decoded, self._lines = len(devices), 0, []
            files = EdsFiles({device.node_id: device.description for device in devices})
            self._decoder = BareDecoder(KnownBus(eds=files))
        for batch in self._batches[self._decoded :]:
            self._lines += map(_line, self._decoder.rows(batch))
            self._decoded += 1
        while self._markers:
            t_ns, text = self._markers.pop(0)
            self._lines.append(_line({"t_s": t_ns / 1e9, "can_id": None, "node": None, "pdo": None, "service": text}))
            self._lines.sort(key=lambda line: line.t_s)
        return self._lines


class LoggedNetwork(VirtualNetwork):
    """A network in virtual time whose frames are in `log`."""

    def __init__(self) -> None:
        super().__init__()
        self.log = BusLog(self, self.flush)

    def inject(self, plan: FaultPlan, seed: int = 0) -> None:
        """Inject faults; their times count from now."""
        inject(self, plan, seed, self.log)


def inject(world: VirtualNetwork, plan: FaultPlan, seed: int, log: BusLog) -> None:
    """Inject faults on the bus of `world` from now on, with a line in its log for each.

    Raises
    ------
    coulombus.sim_bus.faults.fault_file.FaultError
        a fault is of a node that is not on this bus
    RuntimeError
        the bus has faults already
    """
    if world.injection is not None:
        raise RuntimeError("this bus has faults already: write all faults of a test together")
    Injection(world, plan, seed, log.mark)


def _line(row: Row) -> _LoggedLine:
    text = printable(as_text(row))
    service = (row["pdo"] or row["service"]).split()[0].lower()
    return _LoggedLine(row["t_s"], row["node"] or "", service, frozenset(_words(text[TIME_COLUMNS:])), text)


def _words(text: str) -> list[str]:
    return [word for word in re.split(r"[\s=(),]+", text.lower()) if word]


def _matcher(phrase: str) -> Callable[[_LoggedLine], bool]:
    """Return a function that tells whether a line has the words of a phrase."""
    node = NODE.search(phrase)
    words = _words(NODE.sub("", phrase))
    service = words.pop(0) if words and SERVICE.fullmatch(words[0]) else ""
    meant = [word for name in words for word in MEANING.get(name, (name,))]
    if not meant and not service:
        raise ValueError(f'phrase {phrase!r}; expected words of a line, such as "SDO write 1017h" or "NMT start"')

    def matches(line: _LoggedLine) -> bool:
        if (node is not None and line.node != node[1]) or service not in ("", line.service):
            return False
        return all(any(w == word or w.startswith(word + ":") for w in line.words) for word in meant)

    return matches
