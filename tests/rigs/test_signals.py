"""The host's PDOs and the SI scale of their signals, computed by hand from the bench's numbers."""

from __future__ import annotations

import math
import re

import pytest

from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from coulombus.rigs.signals import RigPdo, Signal
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
EDS = {name: (ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds")}


def signals(pdos: tuple[RigPdo, ...]) -> dict[str, Signal]:
    return {signal.name: signal for pdo in pdos for signal in pdo.signals}


def test_the_four_pdos_of_the_bench() -> None:
    pdos = [
        (pdo.node, pdo.node_id, pdo.layout.direction, pdo.layout.number, pdo.layout.cob_id, pdo.layout.length)
        for pdo in load_rig("bench").pdos()
    ]
    assert pdos == [
        ("motor", 1, "rpdo", 1, 0x201, 4),
        ("motor", 1, "tpdo", 1, 0x181, 8),
        ("brake", 2, "rpdo", 1, 0x202, 2),
        ("brake", 2, "tpdo", 1, 0x182, 6),
    ]


def test_entries_are_what_cia_402_and_404_say() -> None:
    entries = [
        [(entry.index, entry.subindex, entry.bits, entry.signed) for entry in pdo.layout.entries]
        for pdo in load_rig("bench").pdos()
    ]
    assert entries == [
        [(0x6040, 0, 16, False), (0x6071, 0, 16, True)],
        [(0x6041, 0, 16, False), (0x6064, 0, 32, True), (0x6077, 0, 16, True)],
        [(0x7300, 1, 16, True)],
        [(0x7130, 1, 16, True), (0x7130, 2, 16, True), (0x7130, 3, 16, True)],
    ]
    for pdo in load_rig("bench").pdos():
        pairs = zip(pdo.signals, pdo.layout.entries, strict=True)
        assert all((signal.index, signal.subindex) == (entry.index, entry.subindex) for signal, entry in pairs)


def test_transmission_identifiers_and_deadlines_follow_the_rig() -> None:
    rig = load_rig(
        "bench", ["bus.actuation=on_reception", "motor.node_id=5", "brake.node_id=126", "motor.setpoint_fault_s=0.05"]
    )
    pdos = [(pdo.layout.cob_id, pdo.layout.transmission, pdo.layout.event_ns) for pdo in rig.pdos()]
    assert pdos == [(0x205, 255, 50_000_000), (0x185, 1, 0), (0x27E, 255, 10_000_000), (0x1FE, 1, 0)]
    assert [pdo.layout.transmission for pdo in load_rig("bench").pdos()] == [1, 1, 1, 1]


def test_scales_of_the_bench() -> None:
    by_name = signals(load_rig("bench").pdos())
    count = 2 * math.pi / (8192 * 9.587)
    expected = {
        "motor.controlword": (1, ""),
        "motor.target_torque_Nm": (0.180 * 9.587 / 1000, "Nm"),  # 1 per mille is 1.73 mNm at the handle
        "motor.statusword": (1, ""),
        "motor.position_rad": (count, "rad"),
        "motor.torque_Nm": (0.180 * 9.587 / 1000, "Nm"),
        "brake.setpoint_Nm": (0.001, "Nm"),
        "brake.handle_torque_Nm": (0.001, "Nm"),
        "brake.coil_current_A": (0.001, "A"),
        "brake.coil_temperature_degC": (0.1, "degC"),
    }
    assert list(by_name) == list(expected)
    for name, (scale, unit) in expected.items():
        assert by_name[name].scale == pytest.approx(scale, rel=1e-12)
        assert by_name[name].offset == 0
        assert by_name[name].unit == unit
    two_counts_a_cycle = 2 * by_name["motor.position_rad"].si(1) / 1e-3
    assert two_counts_a_cycle == pytest.approx(0.160006, abs=1e-6), "the paper's velocity band"
    assert by_name["motor.target_torque_Nm"].raw(1.5) == 869
    assert by_name["brake.setpoint_Nm"].si(3500) == pytest.approx(3.5)


def test_polarities_turn_what_they_belong_to() -> None:
    bench = signals(load_rig("bench").pdos())
    for key, names in {
        "motor": {"motor.target_torque_Nm", "motor.torque_Nm"},
        "encoder": {"motor.position_rad"},
        "transducer": {"brake.handle_torque_Nm"},
    }.items():
        turned = signals(load_rig("bench", [f"mechanics.{key}_polarity=-1"]).pdos())
        assert {name for name in bench if turned[name].scale == -bench[name].scale} == names
        assert {name for name in bench if turned[name].scale == bench[name].scale} == set(bench) - names


def test_the_plant_does_not_touch_the_scales() -> None:
    """What the host believes is [mechanics]; the truth of the simulation must not leak into it."""
    rig = load_rig("bench", ["plant.ratio=5", "plant.motor_polarity=-1", "plant.encoder_counts_rev=100"])
    assert rig.pdos() == load_rig("bench").pdos()


def replaced(section: str, value: str) -> dict[str, str]:
    """Return the EDS texts with another default in one section of the brake's file."""
    text = EDS["mr_brake.eds"]
    start = text.index(f"[{section}]")
    at = text.index("DefaultValue=", start)
    assert at < text.index("\n[", start)
    return {**EDS, "mr_brake.eds": text[:at] + f"DefaultValue={value}" + text[text.index("\n", at) :]}


@pytest.mark.parametrize(
    ("section", "value", "name", "scale"),
    [
        ("6302sub1", "2", "brake.setpoint_Nm", 0.01),
        ("6132sub1", "0", "brake.handle_torque_Nm", 1.0),
        ("6131sub1", "0xFD560000", "brake.handle_torque_Nm", 1e-6),  # mNm with three decimal digits
        ("6131sub2", "0x03040000", "brake.coil_current_A", 1.0),  # kA
    ],
)
def test_digits_and_prefix_of_the_eds_file_give_the_scale(section: str, value: str, name: str, scale: float) -> None:
    rig = load_rig_text(BENCH, "r.toml", replaced(section, value))
    assert signals(rig.pdos())[name].scale == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize(
    ("section", "value", "expected"),
    [
        ("6131sub1", "0x00210000", "6131h:1 is 0x00210000; expected 0x00560000 (Nm), a prefix allowed"),  # newton
        ("6301sub1", "0x00040000", "6301h:1 is 0x00040000; expected 0x00560000 (Nm), a prefix allowed"),  # ampere
        ("6131sub3", "0x00050000", "6131h:3 is 0x00050000; expected 0x002D0000 (degC), a prefix allowed"),  # kelvin
        ("6131sub2", "0x00040300", "6131h:2 is 0x00040300; expected 0x00040000 (A), a prefix allowed"),  # A/s
        ("6132sub1", "12", "6132h:1 is 12; expected 0 to 9 decimal digits"),
        ("6302sub1", "", "6302h:1 has no default; expected a number"),
    ],
)
def test_another_unit_is_refused(section: str, value: str, expected: str) -> None:
    texts = replaced(section, value)
    with pytest.raises(RigError) as caught:
        load_rig_text(BENCH, "r.toml", texts)
    (error,) = caught.value.errors
    number = BENCH[: BENCH.index('eds = "mr_brake.eds"')].count("\n") + 1
    assert error.startswith(f"r.toml:{number}: brake.eds: got 'mr_brake.eds', but mr_brake.eds:")
    text, _, remedy = error.rpartition("; ")
    assert text.endswith(expected)
    assert re.fullmatch(
        r"give \[role\.\w+\] its scale_\w+( or table|, or take the role out with object = \"none\")", remedy
    )


def test_a_device_that_lacks_the_objects_is_refused_with_all_of_them() -> None:
    with pytest.raises(RigError) as caught:
        load_rig("bench", ["motor.eds=mr_brake.eds"])
    assert [error.rpartition(" describes no ")[2] for error in caught.value.errors] == [
        f"{name}h:0, which the host maps; take a device that has it, or bind the role to another object"
        for name in ("6040", "6071", "6041", "6064")
    ]


def test_an_object_that_cannot_be_mapped_is_refused() -> None:
    text = EDS["motor.eds"]
    start = text.index("[6064]")
    at = text.index("PDOMapping=1", start)
    assert at < text.index("\n[", start)
    texts = {**EDS, "motor.eds": text[:at] + "PDOMapping=0" + text[at + 12 :]}
    with pytest.raises(RigError, match=r"6064h:0 cannot be mapped into a TPDO; expected PDOMapping=1"):
        load_rig_text(BENCH, "r.toml", texts)
