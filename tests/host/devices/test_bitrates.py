"""The bit rate of a real bus: listened for first, asked for where all is quiet, left as it was."""

from __future__ import annotations

import json

import pytest

from coulombus.host.devices.bitrates import RATES, choose, run
from coulombus.host.errors import NodeMissing
from coulombus.wire.address import BusUnavailable
from devices_bench import DevicesLink


class Interface:
    """An interface whose bus has the bit rate `right`; `talks`: without being asked."""

    def __init__(self, right, *, talks, before=None, kind="can", refuses=""):
        self.right, self.talks, self.refuses = right, talks, refuses
        self.rate, self.listen, self.sent, self.history = before, False, [], []
        self.info = {"info_kind": kind, "info_data": {"bittiming": {"bitrate": before}} if before else {}}
        self.flags, self.reports, self.up = ["UP"], False, True

    def commands(self, words):
        if words[1] == "-details":
            return json.dumps([{"flags": self.flags, "linkinfo": self.info}])
        if self.refuses and self.refuses in words:
            raise BusUnavailable(f"Operation not permitted; with the rights for it: sudo {' '.join(words)}")
        if "bitrate" in words:
            self.rate, self.listen = int(words[words.index("bitrate") + 1]), words[-1] == "on"
            self.history.append((self.rate, self.listen))
        if "berr-reporting" in words:
            assert not self.up  # a driver takes it from an interface that is down
            self.reports = words[-1] == "on"
        self.up = words[-1] == "up" if words[-1] in ("up", "down") else self.up
        return ""

    def link(self, address):
        return _Link(self)


class _Link(DevicesLink):
    def __init__(self, interface):
        super().__init__()
        self.interface, self.error_frames = interface, 0
        if interface.talks:
            if interface.rate == interface.right:
                self.put(0x181, bytes(8), after_ns=300_000_000)
            else:
                self.error_frames = 5

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def send(self, can_id, data=b"", length=None):
        assert not self.interface.listen
        self.interface.sent.append(self.interface.rate)
        if self.interface.rate != self.interface.right:
            self.error_frames += 1
        elif can_id == 0x605:
            self.put(0x585, b"\x43\x00\x10\x00\x92\x01\x02\x00")


def test_a_bus_that_talks_is_found_by_listening_alone():
    interface = Interface(250_000, talks=True, before=500_000)
    tried = []
    assert choose("can0", tried.append, commands=interface.commands, link=interface.link) == 250_000
    assert tried == [1_000_000, 500_000, 250_000]
    assert interface.sent == []
    assert (interface.rate, interface.listen) == (250_000, False)


def test_a_quiet_bus_is_asked_at_each_rate():
    interface = Interface(125_000, talks=False)
    assert choose("can0", commands=interface.commands, link=interface.link) == 125_000
    assert (interface.rate, interface.listen) == (125_000, False)
    assert interface.sent.count(1_000_000) == 1  # the first error frame ends it there


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("reports", [True, False])
@pytest.mark.parametrize("talks", [True, False])
def test_an_interface_that_hears_nobody_is_as_it_was(talks, reports, up):
    interface = Interface(33_333, talks=talks, before=500_000)
    interface.flags = ["UP"] if up else []
    interface.info["info_data"]["ctrlmode"] = ["BERR-REPORTING"] if reports else []
    with pytest.raises(NodeMissing, match="no node was heard on socketcan:can0 at any bit rate"):
        choose("can0", commands=interface.commands, link=interface.link)
    assert (interface.rate, interface.listen) == (500_000, False)
    assert (interface.reports, interface.up) == (reports, up)
    assert bool(interface.sent) != talks
    assert {rate for rate, _ in interface.history} == set(RATES)


def test_an_interface_without_a_bit_rate_is_refused():
    interface = Interface(0, talks=False, kind="vcan")
    with pytest.raises(BusUnavailable, match="a vcan interface, which has no bit rate"):
        choose("vcan0", commands=interface.commands, link=interface.link)
    interface.info = None
    with pytest.raises(BusUnavailable, match="tells no bit rate"):
        choose("vcan0", commands=interface.commands, link=interface.link)


def test_without_the_rights_the_command_is_told():
    interface = Interface(0, talks=False, refuses="down")
    with pytest.raises(BusUnavailable, match="sudo ip link set can0 down"):
        choose("can0", commands=interface.commands, link=interface.link)


def test_a_driver_without_bus_error_reports_will_do():
    interface = Interface(500_000, talks=True, refuses="berr-reporting")
    assert choose("can0", commands=interface.commands, link=interface.link) == 500_000


def test_a_command_that_is_not_there_or_fails_is_told():
    with pytest.raises(BusUnavailable, match="`no-such-program x` cannot be run"):
        run(("no-such-program", "x"))
    with pytest.raises(BusUnavailable, match="sudo false"):
        run(("false",))
    assert run(("echo", "x")) == "x\n"
