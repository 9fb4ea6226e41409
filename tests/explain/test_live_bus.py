"""`explain --bus`: each incident is told when it is one, and again when its state changes."""

from __future__ import annotations

from coulombus.explain.explained import Explainer
from coulombus.explain.live_bus import Followed, explain_bus
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.address import parse_address
from explain_log import machine
from tiny_bus import tiny_bus


def test_a_live_bus_is_explained(private_sockets, monkeypatch):
    told = []
    with tiny_bus("t") as bus:

        class Heard(StopSignals):
            def __enter__(self):  # the client is there
                bus.deliver((0x703, b"\0"), (0x000, b"\x01\0"), (0x703, b"\x05"))
                bus.deliver((0x083, bytes.fromhex("1042010000000000")))
                return super().__enter__()

        monkeypatch.setattr("coulombus.explain.live_bus.StopSignals", Heard)
        tell = lambda explanation, incident: told.append((incident.root.kind, incident.node, incident.status))  # noqa: E731
        explanation = explain_bus(parse_address("coulombus:t"), tell, known=KnownBus(), seconds=0.3)
        assert bus.frames == []  # nothing is sent
    assert explanation.verdict == "unresolved"
    assert told == [("emcy", 3, "unresolved")]


def test_a_change_of_state_is_told_once():
    told = []
    followed = Followed(lambda explanation, incident: told.append((incident.root.kind, incident.status)))
    log = machine(3).add(1000, 0x083, bytes.fromhex("1042010000000000")).add(1500, 0x083, bytes(8))
    explainer = Explainer()
    for start in range(0, len(log.rows), 4):
        explainer.add_frames(log.frames[start : start + 4])
        explainer.note_overdue()
        followed.report_changes(explainer.explanation())
    assert told == [("emcy", "unresolved"), ("emcy", "recovered")]
