"""What the host tells of itself after each cycle: each field, each limit, each axis."""

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Phase, Trip
from coulombus.host.cycle.telemetry import write_axes, write_axis
from coulombus.kernels.records import new_records
from coulombus.recording.host_telemetry import (
    FIRST,
    MOST_FRAMES,
    NAME,
    OF_WORLD,
    PER_AXIS,
    SOURCE_INSIDE,
    Limit,
    inside_attachment,
    inside_pdos,
)
from coulombus.recording.pdo_columns import decode_field
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame


def told(rig="bench", mode="hybrid", **fields):
    """Return a host's first axis with these fields, and what it tells by the signals' names."""
    controllers = Controllers(load_rig(rig) if isinstance(rig, str) else rig, mode)
    axis = controllers.axes[0]
    axis.host.cycle = 1
    for name, value in fields.items():
        part, _, field = name.partition("__")
        getattr(axis, part)[field] = value
    return axis, said(controllers, axis)


def said(controllers, axis, t_ns=5):
    rows = new_records(Frame, MOST_FRAMES)
    count = write_axis(axis, 0, t_ns, rows, 0)
    found = {}
    attached = inside_attachment(controllers.each[0].law_state)[NAME]
    for pdo in inside_pdos(controllers.rig, attached):
        words = rows[:count]["word"][rows[:count]["can_id"] == pdo.layout.cob_id]
        for entry, start, signal in zip(pdo.layout.entries, pdo.layout.starts, pdo.signals, strict=False):
            found[signal.name] = [signal.si(one) for one in decode_field(words, start, entry).tolist()]
    return found


def test_each_field_of_a_cycle_is_told_by_its_name():
    _, found = told(
        host__phase=int(Phase.RUN),
        host__trip=int(Trip.SIGN_TRAVEL),
        host__gain=0.5,
        host__position_age=3,
        host__deadman_ok=1,
        motion__v_rad_s=-0.75,
        state__stuck=1,
        state__x_stuck=-1.25,
        state__psi_Nm=2.5,
        state__brake_Nm=3.5,
    )
    assert found == {
        "host.phase": [5],
        "host.trip": [38],
        "host.limits": [0],
        "host.gain": [0.5],
        "host.stuck": [1],
        "host.position_age": [3],
        "host.law_Nm": [2.5],
        "host.law_brake_Nm": [3.5],
        "host.velocity_rad_s": [-0.75],
        "host.x_stuck_rad": [-1.25],
    }


@pytest.mark.parametrize(
    ("counter", "limit"),
    [
        ("clipped_torque", Limit.TORQUE_CLIPPED),
        ("slowed_torque", Limit.TORQUE_SLOWED),
        ("limited_by_drive", Limit.BY_DRIVE),
        ("clipped_setpoints", Limit.SETPOINT_CLIPPED),
        ("negative_setpoints", Limit.SETPOINT_NEGATIVE),
        ("withheld_compensation", Limit.COMPENSATION_WITHHELD),
    ],
)
def test_a_limit_shows_in_the_cycle_in_which_it_acted(counter, limit):
    controllers = Controllers(load_rig("bench"), "hybrid")
    axis = controllers.axes[0]
    axis.host.deadman_ok = 1
    seen = []
    for cycle in range(1, 5):
        axis.host.cycle = cycle
        axis.host[counter] += cycle in (2, 3)
        seen += said(controllers, axis)["host.limits"]
    assert seen == [0, limit, limit, 0]


def test_a_missed_tpdo_and_an_open_switch_show():
    _, found = told(host__missed_in_a_row=2, host__deadman_ok=0)
    assert found["host.limits"] == [Limit.TPDO_MISSED | Limit.DEADMAN_OPEN]


def test_a_cycle_is_told_once_and_not_before_its_end():
    controllers = Controllers(load_rig("two_axes"), "hybrid")
    rows = new_records(Frame, 4 * MOST_FRAMES)
    controllers.axes[0].host.cycle = controllers.axes[1].host.cycle = 1
    controllers.axes[1].host.waiting = 1
    assert write_axes(controllers.axes, 7, rows, 2) == 5
    assert rows["can_id"][2:5].tolist() == [FIRST, FIRST + 1, FIRST + 2]
    assert set(rows["t_ns"][2:5].tolist()) == {7}
    assert set(rows["source"][2:5].tolist()) == {SOURCE_INSIDE}
    controllers.axes[1].host.waiting = 0
    assert write_axes(controllers.axes, 8, rows, 5) == 8
    assert rows["can_id"][5:8].tolist() == [FIRST + PER_AXIS + k for k in range(3)]
    assert write_axes(controllers.axes, 9, rows, 8) == 8


def test_an_age_and_a_gain_beyond_their_fields_end_at_them():
    _, found = told(host__position_age=1000, host__gain=1.5)
    assert found["host.position_age"] == [127]
    assert found["host.gain"] == [1.0]


def test_what_a_law_keeps_has_its_names_and_units():
    rig = load_rig("bench", overrides=["law.function=gms"])
    controllers = Controllers(rig, "active")
    axis = controllers.axes[0]
    axis.host.cycle = 1
    axis.state["user"] = np.arange(16) + 0.5
    found = said(controllers, axis)
    kept = {name: value for name, value in found.items() if name.startswith("host.law.")}
    assert kept == {f"host.law.F_{k + 1}_Nm": [k + 0.5] for k in range(4)} | {
        f"host.law.slips_{k + 1}": [k + 4.5] for k in range(4)
    }
    pdos = inside_pdos(rig, inside_attachment(controllers.each[0].law_state)[NAME])
    units = {signal.name: signal.unit for pdo in pdos for signal in pdo.signals}
    assert units["host.law.F_2_Nm"] == "Nm"
    assert units["host.law.slips_1"] == ""


def test_an_odd_number_that_a_law_keeps_is_one_signal():
    rig = load_rig("bench", overrides=["law.function=lugre"])
    controllers = Controllers(rig, "active")
    controllers.axes[0].host.cycle = 1
    controllers.axes[0].state["user"] = 0.125
    assert said(controllers, controllers.axes[0])["host.law.z_rad"] == [0.125]


@pytest.mark.parametrize("field", ["host__gain", "host__position_age", "state__stuck"])
def test_nothing_is_told_as_nothing(field):
    name = {"host__gain": "host.gain", "host__position_age": "host.position_age", "state__stuck": "host.stuck"}[field]
    assert told(**{field: 0})[1][name] == [0]
    if field != "state__stuck":
        assert told(**{field: -7})[1][name] == [0]


def test_one_missed_tpdo_shows():
    assert told(host__missed_in_a_row=1, host__deadman_ok=1)[1]["host.limits"] == [Limit.TPDO_MISSED]
    assert told(host__missed_in_a_row=0, host__deadman_ok=1)[1]["host.limits"] == [0]


@pytest.mark.parametrize(("keeps", "lengths"), [(0, []), (1, [4]), (2, [8]), (3, [8, 4])])
def test_what_a_law_keeps_fills_frames_of_two_numbers(keeps, lengths):
    """The last one of an odd number has four bytes, and nothing behind them."""
    controllers = Controllers(load_rig("bench"), "hybrid")
    axis = controllers.axes[0]
    axis.host.cycle = 1
    axis.control["law_keeps"] = keeps
    axis.state["user"] = np.arange(16) - 7.5
    rows = new_records(Frame, MOST_FRAMES)
    count = 3 + len(lengths)
    assert write_axis(axis, 0, 5, rows, 2) == 2 + count
    assert rows["length"][2 : 2 + count].tolist() == [8, 8, 8, *lengths]
    assert rows["can_id"][2 : 2 + count].tolist() == [FIRST + k for k in range(count)]
    found = rows["word"][5 : 2 + count].copy().view(np.float32).tolist()
    assert found == ([k - 7.5 for k in range(keeps)] + [0.0] * (keeps % 2))


# a world outside


def with_world():
    """Return controllers of a rig with a world, whose first axis has finished a cycle."""
    controllers = Controllers(load_rig("bench", overrides=['world.rest="law"']), "active")
    controllers.axes[0].host.cycle = 1
    return controllers, controllers.axes[0]


def test_what_a_world_gives_has_its_names_and_two_frames_behind_the_others():
    controllers, axis = with_world()
    assert axis.world.on == 1
    for name, value in {
        "world_Nm": 1.5,
        "world_brake_Nm": 2.5,
        "share": 0.25,
        "law_share": 0.5001,
        "taken": (1 << 32) + 0x89ABCDEF,
    }.items():
        axis.world[name] = value
    rows = new_records(Frame, MOST_FRAMES + 2)
    assert write_axis(axis, 0, 5, rows, 2) == 7
    assert rows["can_id"][2:].tolist()[:5] == [FIRST + k for k in (0, 1, 2, OF_WORLD, OF_WORLD + 1)]
    assert rows["length"][2:7].tolist() == [8] * 5
    assert set(rows["t_ns"][2:7].tolist()) == {5}
    axis.host.cycle = 2
    assert {name: value for name, value in said(controllers, axis).items() if "world" in name or "share" in name} == {
        "host.world_Nm": [-1.5],
        "host.world_brake_Nm": [2.5],
        "host.world_share": [0.25],
        "host.law_share": [pytest.approx(0.5001)],
        "host.world_model": [0x89ABCDEF],
    }


def test_a_world_of_nothing_is_told_as_nothing():
    """Without a minus before the 0, as a reader of the frames has it."""
    _, axis = with_world()
    rows = new_records(Frame, MOST_FRAMES)
    assert write_axis(axis, 0, 5, rows, 0) == 5
    assert rows["word"][3:5].tolist() == [0, 10000 << 16]


@pytest.mark.parametrize(("on", "seen"), [(1, [0, Limit.WORLD_CLIPPED, Limit.WORLD_CLIPPED, 0]), (0, [0, 0, 0, 0])])
def test_what_a_world_asked_for_in_vain_shows_in_the_cycle_in_which_a_limit_acted(on, seen):
    controllers, axis = with_world()
    axis.host.deadman_ok, axis.world.on = 1, on
    limits = []
    for cycle in range(1, 5):
        axis.host.cycle = cycle
        axis.world.clipped += cycle in (2, 3)
        limits += said(controllers, axis)["host.limits"]
    assert limits == seen


def test_the_limits_of_the_host_and_of_its_world_show_together():
    controllers, axis = with_world()
    axis.host.deadman_ok = axis.host.clipped_torque = axis.world.clipped = 1
    axis.host.position_age, axis.host.gain, axis.state.stuck = 3, 0.5, 1
    signals = said(controllers, axis)
    assert signals["host.limits"] == [Limit.WORLD_CLIPPED | Limit.TORQUE_CLIPPED]
    assert (signals["host.gain"], signals["host.stuck"], signals["host.position_age"]) == ([0.5], [1], [3])
