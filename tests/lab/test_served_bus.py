"""A bus in a thread of the test's process: its calls, its end, its refusals."""

from __future__ import annotations

import pytest

from coulombus.lab.served_bus import ServedBus, empty_bus, rig_bus
from places import RIGS, ROOT

pytestmark = [pytest.mark.real_time, pytest.mark.patient]


@pytest.fixture
def served(private_sockets):
    bus = empty_bus()
    yield bus
    bus.close()


def fails():
    raise OSError("in the bus's thread")


def test_an_error_of_a_call_is_the_callers_and_the_bus_goes_on(served):
    with pytest.raises(OSError, match="in the bus's thread"):
        served.call(fails)
    assert served.call(lambda: 42) == 42


def test_after_its_end_a_bus_refuses_calls_and_keeps_its_log(served):
    served.add(ROOT / "examples/ci/drive.eds", 5)
    served.close()
    with pytest.raises(RuntimeError, match="has ended"):
        served.call(lambda: 42)
    assert len(served.log.said("heartbeat boot-up node 5")) == 1


def test_a_refused_node_leaves_the_bus_as_it_was(served, tmp_path):
    served.add(ROOT / "examples/ci/drive.eds", 5)
    with pytest.raises(ValueError, match="is taken"):
        served.add(ROOT / "examples/ci/drive.eds", 5)
    served.add(ROOT / "examples/ci/drive.eds", 6, "auto")
    served.log.assert_said("heartbeat boot-up node 5", "heartbeat boot-up node 6")


def test_the_options_of_a_node_are_those_of_the_verb(served):
    with pytest.raises(ValueError, match="drive"):
        served.add(ROOT / "examples/ci/drive.eds", 5, "motor")
    with pytest.raises(ValueError, match="has no node id"):
        served.add(ROOT / "examples/ci/drive.eds")


def test_a_rig_of_several_buses_is_refused(tmp_path):
    text = (RIGS / "plane.toml").read_text()
    for joint, channel in (("shoulder", "a"), ("elbow", "b")):
        text += f'\n[axis.{joint}.bus]\nchannel = "{channel}"\n'
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(ValueError, match="has the buses a, b; a test's rig has one bus"):
        rig_bus(str(tmp_path / "rig.toml"))


def test_a_failure_of_the_bus_is_the_cause_of_the_next_refusal(private_sockets):
    bus = empty_bus()
    bus.call(lambda: bus._server.world.at(0, lambda world: fails()))
    bus._thread.join(60)
    with pytest.raises(RuntimeError, match="has ended") as caught:
        bus.call(lambda: 42)
    assert isinstance(caught.value.__cause__, OSError)
    bus.close()


def test_names_differ(served):
    other = empty_bus()
    assert isinstance(other, ServedBus)
    assert other.channel != served.channel
    other.close()
