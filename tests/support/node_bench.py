"""One device in virtual time: frames in, frames out, deadlines in their order."""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.eds.reader import Description, read_eds
from coulombus.kernels.decorator import Entry
from coulombus.node import own_time
from coulombus.node.brake404 import BRAKE404
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC
from coulombus.node.profile import Profile
from coulombus.node.record import new_nodes
from coulombus.node.store import Store
from coulombus.wire.frame import data_bytes, data_word, new_queue
from places import EDS

MS, US = 1_000_000, 1_000
on_frame, on_time = Entry(own_time.on_frame), Entry(own_time.on_time)
"""As the loop calls them: so they are compiled already."""
KIND_OF = {"motor": DRIVE402, "mr_brake": BRAKE404}

_descriptions: dict[str, Description] = {}


def description(name: str) -> Description:
    if name not in _descriptions:
        _descriptions[name] = read_eds(EDS / f"{name}.eds")
    return _descriptions[name]


@dataclass(frozen=True)
class Sent:
    t_ns: int
    can_id: int
    data: bytes


class SdoAborted(Exception):
    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class Bench:
    """A device that is alone with its tester; `sent` holds all that it sent and the tester has not
    taken.
    """

    def __init__(
        self,
        name: str = "motor",
        node_id: int = 1,
        kind: Profile | None = None,
        eds: Description | None = None,
        store: Store | None = None,
    ):
        self.nodes = new_nodes(1)
        self.out = new_queue()
        kind = KIND_OF.get(name, GENERIC) if kind is None else kind
        self.device = Device(eds or description(name), node_id, kind, self.nodes[0], store)
        self.node = self.nodes[0]
        self.node_id = node_id
        self.t = 0
        self.sent: list[Sent] = []

    # the bus

    def power_on(self) -> None:
        self.device.power_on(self.t, self.out)
        self._collect()

    def frame(self, can_id: int, data: bytes = b"", *, length: int | None = None) -> None:
        """The end of a frame, at the present time."""
        size = len(data) if length is None else length
        word = data_word(data)
        arguments = (self.t, can_id, size, word, self.out)
        if on_frame(self.nodes, 0, *arguments):
            self.device.service(*arguments)
        self._collect()

    def run(self, duration_ns: int) -> None:
        """Let the time pass; deadlines at its very end are judged too."""
        self.until(self.t + duration_ns)

    def until(self, t_ns: int, *, judge_end: bool = True) -> None:
        calls = 0
        while self.node.next_ns < t_ns or (judge_end and self.node.next_ns == t_ns):
            calls += 1
            assert calls < 1_000_000, "the node asks for no end of calls"
            self.t = max(self.t, int(self.node.next_ns))
            before = self.t
            on_time(self.nodes, 0, self.t, self.out)
            assert self.node.next_ns > before
            self._collect()
        self.t = t_ns

    def at(self, t_ns: int, can_id: int, data: bytes = b"") -> None:
        """A frame at `t_ns`: before a deadline of the same time."""
        self.until(t_ns, judge_end=False)
        self.frame(can_id, data)

    def _collect(self) -> None:
        count = int(self.out["count"])
        for k in range(count):
            row = self.out.frames[k]
            data = data_bytes(int(row["word"]), int(row["length"]))
            self.sent.append(Sent(int(row["t_ns"]), int(row["can_id"]), data))
        self.out["count"] = 0

    # what the tester reads

    def take(self, can_id: int | None = None) -> list[Sent]:
        """Take what was sent (with this identifier)."""
        taken = [s for s in self.sent if can_id in (None, s.can_id)]
        self.sent = [s for s in self.sent if can_id not in (None, s.can_id)]
        return taken

    def emcy(self) -> list[tuple[int, int, int]]:
        """Take the EMCY messages: (code, register, information)."""
        frames = self.take(0x80 + self.node_id)
        return [(int.from_bytes(f.data[:2], "little"), f.data[2], int.from_bytes(f.data[3:], "little")) for f in frames]

    # services

    def nmt(self, command: int, node_id: int | None = None) -> None:
        self.frame(0x000, bytes((command, self.node_id if node_id is None else node_id)))

    def sync(self, data: bytes = b"") -> None:
        self.frame(0x080, data)

    def request(self, data: bytes) -> bytes | None:
        """One SDO request and its response, if there is one."""
        self.take(0x580 + self.node_id)
        self.frame(0x600 + self.node_id, data)
        answers = self.take(0x580 + self.node_id)
        assert len(answers) <= 1
        return answers[0].data if answers else None

    def _ask(self, data: bytes) -> bytes:
        answer = self.request(data)
        assert answer is not None
        if answer[0] == 0x80:
            raise SdoAborted(int.from_bytes(answer[4:], "little"))
        return answer

    def upload(self, index: int, subindex: int = 0) -> bytes:
        """Read an object by SDO, expedited or segmented."""
        head = index.to_bytes(2, "little") + bytes((subindex,))
        answer = self._ask(b"\x40" + head + bytes(4))
        assert answer[1:4] == head
        if answer[0] & 0x02:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        content, toggle = b"", 0
        while True:
            segment = self._ask(bytes((0x60 | toggle,)) + bytes(7))
            assert segment[0] & 0x10 == toggle
            content += segment[1 : 8 - (segment[0] >> 1 & 7)]
            toggle ^= 0x10
            if segment[0] & 1:
                assert len(content) == int.from_bytes(answer[4:], "little")
                return content

    def number(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        return int.from_bytes(self.upload(index, subindex), "little", signed=signed)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object by SDO: expedited where it fits."""
        head = index.to_bytes(2, "little") + bytes((subindex,))
        if 1 <= len(data) <= 4:
            self._ask(bytes((0x23 | (4 - len(data)) << 2,)) + head + data.ljust(4, b"\0"))
        else:
            self.download_segmented(index, subindex, data)

    def download_segmented(self, index: int, subindex: int, data: bytes, *, sized: bool = True) -> None:
        head = index.to_bytes(2, "little") + bytes((subindex,))
        size = len(data).to_bytes(4, "little") if sized else bytes(4)
        self._ask(bytes((0x21 if sized else 0x20,)) + head + size)
        toggle = 0
        for start in range(0, max(len(data), 1), 7):
            part = data[start : start + 7]
            last = start + 7 >= len(data)
            self._ask(bytes((toggle | (7 - len(part)) << 1 | last,)) + part.ljust(7, b"\0"))
            toggle ^= 0x10

    def write(self, index: int, subindex: int, value: int, size: int) -> None:
        self.download(index, subindex, (value & ((1 << 8 * size) - 1)).to_bytes(size, "little"))


def motor(**settings: int) -> Bench:
    """A motor that is OPERATIONAL; 6072h is 1000 unless said."""
    bench = Bench("motor", 1)
    bench.power_on()
    bench.write(0x6072, 0, settings.get("limit", 1000), 2)
    if "deadline_ms" in settings:
        bench.write(0x1400, 5, settings["deadline_ms"], 2)
    if "sync_us" in settings:
        bench.write(0x2002, 0, settings["sync_us"], 4)
    if "age_us" in settings:
        bench.write(0x2001, 0, settings["age_us"], 4)
    bench.nmt(1)
    bench.take()
    return bench


def setpoint(controlword: int, torque: int = 0) -> bytes:
    return controlword.to_bytes(2, "little") + torque.to_bytes(2, "little", signed=True)


def cycle(bench: Bench, data: bytes, period_ns: int = MS) -> None:
    """One cycle: SYNC, half a period later the RPDO, then the rest of the period."""
    start = bench.t
    bench.sync()
    bench.at(start + period_ns // 2, 0x200 + bench.node_id, data)
    bench.until(start + period_ns, judge_end=False)


def enable(bench: Bench, torque: int = 0) -> None:
    """Lead the drive to Operation Enabled by its RPDO1."""
    for controlword in (0x06, 0x07, 0x0F, 0x0F):
        cycle(bench, setpoint(controlword, torque))
    bench.sync()
    assert bench.node.power_state == 4
