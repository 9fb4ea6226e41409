"""The draft of a rig file: which objects of a device it takes, which guesses it marks, and what it
refuses.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from coulombus.eds.reader import parse_eds, read_eds
from coulombus.host.cycle.controller import Controller
from coulombus.host.setup.device_plan import device_plans
from coulombus.host.setup.law_demand import cut_off
from coulombus.rigs.draft.device import DraftDevice
from coulombus.rigs.draft.discover import DeviceChoice, gather
from coulombus.rigs.draft.draft import Draft
from coulombus.rigs.draft.draft_text import rehearsal_marks
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from eds_edit import edit, fixed, gone
from foreign_eds import U8, U32, geared, with_variable
from places import CORPUS, RIGS, ROOT, beside

MOTOR, BRAKE = ((ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds"))
FOREIGN = edit(MOTOR, "1018sub1", DefaultValue="0x00000077")
"""Our drive under another maker's name."""
FOREIGN_BRAKE = edit(BRAKE, "1018sub1", DefaultValue="0x00000077")
DRAFTED = {
    *(
        "maxon_epos4_50-5",
        "nanotec_C5-E-1-09",
        "canopen_e35",
        "zeroerr_edriver_1.5",
        "yiyou_euservo_1.4",
        "elmo_gold_heig",
    ),
    *("cia_402_sample", "infranor_easy-ak", "roboteq_v2.0", "schneider_NEMA23_PVL", "moons_MBDV_dual"),
    *("maxon_epos2_50-5_347717", "technosoft_iPOS"),
}
"""Of the corpus' drives: those that can carry a torque, or a current, in a PDO."""
REFUSED = {
    *("animatics_cog", "esacademy_402_stepper_node8", "faulhaber_51-V_MCBL3003"),
    *("faulhaber_67-B_MCBL3006CO", "pilz_prbt_0_1", "schunk_PRL120", "technosoft_ISD860", "trinamic_TMCM-1270"),
}
"""Of the corpus' drives: those without a torque set-point that a PDO can carry."""


def own_object(text, index, name, data_type="0x0003", access="rww", **keys):
    """Add an object of the maker's own."""
    lines = {"ParameterName": name, "ObjectType": "0x7", "DataType": data_type, "AccessType": access, "PDOMapping": 1}
    return text + f"\n[{index:04X}]\n" + "".join(f"{key}={value}\n" for key, value in (lines | keys).items()) + "\n"


@pytest.fixture
def draft(tmp_path):
    """Draft a rig of EDS texts in a folder of their own."""

    def make(motor=FOREIGN, brake=BRAKE, *sensors, like="bench", answers=None, **options):
        devices = []
        for number, text in enumerate((motor, brake, *sensors)):
            node = ("motor", "brake", "transducer", "sensor_2")[number]
            (tmp_path / f"{node}-x.eds").write_text(text, encoding="utf-8")
            described = read_eds(tmp_path / f"{node}-x.eds")
            devices.append(
                DraftDevice(node, described, f"{node}-x.eds", number + 1, (answers or {}) if number == 0 else {})
            )
        rig = load_rig(like) if isinstance(like, str) else like
        return Draft(devices, rig.one_axis(), str(tmp_path / "my.toml"), **options)

    return make


def marks(draft, path):
    return " ".join(draft.text.notes.get(tuple(path.split(".")), ()))


def test_the_text_is_a_rig_file_without_warnings_that_says_what_it_guesses(draft):
    made = draft()
    rig = load_rig_text(str(made), made.path)
    axis = rig.one_axis()
    assert rig == made.rig
    assert rig.warnings == ()
    assert (axis.plant, axis.operator, axis.phases) == (None, None, ())
    assert (axis.motor.vendor_id, axis.motor.node_id, axis.motor.response_us) == (0x77, 1, 150.0)
    for path in ("motor.rated_torque_Nm", "motor.encoder_counts_rev", "mechanics.ratio", "motor.response_us", "host"):
        assert "CHECK" in marks(made, path), path
    assert rehearsal_marks(str(made)) == ()


def test_devices_of_ours_are_as_the_packages_rig_has_them(draft):
    bench, made = load_rig("bench").one_axis(), draft(MOTOR, BRAKE)
    axis = made.rig.one_axis()
    assert axis.motor.model_copy(update={"eds": "motor.eds"}) == bench.motor
    assert axis.brake.model_copy(update={"eds": "mr_brake.eds"}) == bench.brake
    assert [p.layout for p in axis.pdos()] == [p.layout for p in bench.pdos()]
    assert "CHECK" not in marks(made, "motor.rated_torque_Nm")


@pytest.mark.parametrize(
    ("torque", "rated", "mark"),
    [
        (310, 0.31, "310, taken for mNm"),
        (60_000, 60.0, "60000, taken for mNm"),
        (310_000, 310.0, "310000, taken for mNm"),
        (31_000_000, 31.0, "31000000, taken for uNm"),
        (0, 0.18, "nothing"),
        (2_000_000_000, 0.18, "nothing"),
    ],
)
def test_the_larger_reading_of_the_rated_torque_is_the_safe_one(draft, torque, rated, mark):
    text = edit(FOREIGN, "6076", DefaultValue=torque)
    made = draft(text)
    assert made.rig.one_axis().motor.rated_torque_Nm == pytest.approx(rated)
    assert mark in marks(made, "motor.rated_torque_Nm")


def test_a_weak_motor_lowers_the_law_of_mode_active_alone(draft):
    modes = draft(edit(FOREIGN, "6076", DefaultValue=10)).rig.one_axis().mode
    assert modes["active"].F_s_Nm < 0.2
    assert modes["active"].F_d_Nm / modes["active"].F_s_Nm == pytest.approx(1.0 / 1.2, rel=0.02)
    assert (modes["hybrid"].F_s_Nm, modes["passive"].F_s_Nm) == (3.5, 3.5)
    assert modes["hybrid"].motor_limit_Nm < 0.168


@pytest.mark.parametrize(
    ("name", "vendor", "rated_Nm"),
    [
        ("Motor rated torque [uNm]", "0x77", 0.0382),
        ("Motor rated torque (mNm)", "0x77", 38.2),
        ("Motor rated torque in cNm", "0x77", 382.0),
        ("Motor rated torque \u00b5Nm", "0x77", 0.0382),
        ("Motor rated torque", "0xFB", 0.0382),
        ("Motor_rated_torque_Nmx", "0x77", 38.2),
    ],
)
def test_the_unit_in_the_name_or_of_the_maker_is_read(draft, name, vendor, rated_Nm):
    text = edit(edit(FOREIGN, "6076", DefaultValue=38_200, ParameterName=name), "1018sub1", DefaultValue=vendor)
    assert draft(text).rig.one_axis().motor.rated_torque_Nm == pytest.approx(rated_Nm)


@pytest.mark.parametrize(
    ("name", "data_type", "scale_Nm"),
    [
        ("Target torque [mNm]", "0x0004", 1e-3),
        ("Target torque [uNm]", "0x0004", 1e-6),
        ("Target torque", "0x0004", 0.18e-3),  # a per mille of the rated torque
        ("Target torque", "0x0003", 0.18e-3),
        ("Target current [mA]", "0x0003", 0.18 / 1700),  # 6075h
        ("Target current [A]", "0x0004", 0.18 / 1.7),
    ],
)
def test_the_unit_in_the_name_of_a_makers_set_point_is_read(draft, name, data_type, scale_Nm):
    bits = "20" if data_type == "0x0004" else "10"
    text = gone(edit(FOREIGN, "6502", DefaultValue=1 << 17 | 1), "6071").replace("0x60710010", f"0x300100{bits}")
    text = own_object(edit(text, "6075", DefaultValue=1700), 0x3001, name, data_type)
    made = draft(text)
    assert made.rig.one_axis().role.torque_setpoint.scale_Nm == pytest.approx(scale_Nm, rel=1e-3)
    assert "CHECK" in marks(made, "role.torque_setpoint.scale_Nm")


def test_a_unit_in_the_name_of_6071h_is_its_scale(draft):
    made = draft(edit(FOREIGN, "6071", ParameterName="Target torque [mNm]"))
    assert made.rig.one_axis().role.torque_setpoint.scale_Nm == 1e-3


def test_what_the_live_device_says_counts_more_than_its_file(draft):
    answers = {(0x6076, 0): 250, (0x608F, 1): 20000, (0x608F, 2): 2, (0x6502, 0): 1 << 3}
    made = draft(answers=answers)
    axis = made.rig.one_axis()
    assert (axis.motor.rated_torque_Nm, axis.motor.encoder_counts_rev, axis.motor.mode) == (0.25, 10000, 4)
    assert "the device" in marks(made, "motor.rated_torque_Nm")


@pytest.mark.parametrize(
    ("modes", "mode", "guess"), [(1 << 9, 10, False), (1 << 3, 4, False), (1 << 9 | 1 << 3, 10, False), (0, 4, True)]
)
def test_the_mode_is_the_best_that_6502h_offers(draft, modes, mode, guess):
    made = draft(edit(FOREIGN, "6502", DefaultValue=modes))
    assert made.rig.one_axis().motor.mode == mode
    assert ("CHECK" in marks(made, "motor.mode")) is guess


def test_a_drive_that_tells_no_mode_has_cst_where_it_has_objects_of_it(draft):
    text = own_object(edit(FOREIGN, "6502", DefaultValue=0), 0x60B2, "Torque offset")
    made = draft(text)
    assert made.rig.one_axis().motor.mode == 10
    assert "CHECK" in marks(made, "motor.mode")


def test_counts_of_the_encoder_scale_what_is_counted(draft):
    made = draft(edit(FOREIGN, "608Fsub1", DefaultValue=4 * 8192))
    axis, bench = made.rig.one_axis(), load_rig("bench").one_axis()
    assert axis.motor.encoder_counts_rev == 4 * 8192
    finer = 4 * axis.mechanics.ratio / bench.mechanics.ratio
    assert axis.limits.encoder_jump_counts == round(500 * finer)
    assert axis.law.velocity_band_counts == round(2 * finer)
    assert axis.limits.sign_check_counts == round(20 * finer)


@pytest.mark.parametrize("rehearse", [False, True])
def test_gear_and_feed_make_the_counts_of_a_turn(draft, rehearse):
    made = draft(geared(FOREIGN), rehearse=rehearse)
    assert made.rig.one_axis().motor.encoder_counts_rev == 360
    assert "6092h = 3600/1, 6091h = 10:1 of the EDS file: 360 counts" in marks(made, "motor.encoder_counts_rev")
    live = draft(geared(FOREIGN), answers={(0x6092, 1): 36_000, (0x6092, 2): 1, (0x6091, 1): 10, (0x6091, 2): 1})
    assert live.rig.one_axis().motor.encoder_counts_rev == 3600
    assert "of the device" in marks(live, "motor.encoder_counts_rev")


def test_the_si_unit_makes_the_counts_of_a_turn(draft):
    made = draft(with_variable(FOREIGN, "60A8", U32, "0xFD410000", "rw"))
    assert made.rig.one_axis().motor.encoder_counts_rev == 360_000


@pytest.mark.parametrize(("code", "motor", "encoder"), [(0, 1, 1), (0xC0, 1, -1), (0x20, -1, 1), (0xA0, -1, -1)])
def test_the_polarity_is_told_and_written(draft, code, motor, encoder):
    made = draft(with_variable(FOREIGN, "607E", U8, code, "rw"), rehearse=True)
    axis = made.rig.one_axis()
    assert (axis.mechanics.motor_polarity, axis.mechanics.encoder_polarity) == (motor, encoder)
    assert [(row.index, row.type, row.value, row.when) for row in axis.motor.sdo] == [
        (0x607E, "UNSIGNED8", code, "before")
    ]
    assert f"607Eh = 0x{code:02X}" in marks(made, "motor.sdo")
    assert made.rig.warnings == ()


def test_a_constant_polarity_is_not_written(draft):
    made = draft(with_variable(FOREIGN, "607E", U8, 0xC0, "ro"))
    axis = made.rig.one_axis()
    assert (axis.motor.sdo, axis.mechanics.encoder_polarity) == ((), -1)


def test_counts_stay_below_half_the_range_of_a_narrow_position(draft):
    narrow = edit(edit(FOREIGN, "6064", DataType="0x0003"), "608Fsub1", DefaultValue=1 << 20)
    limits = draft(narrow.replace("0x60640020", "0x60640010")).rig.one_axis().limits
    assert 10_000 < limits.encoder_jump_counts < (1 << 15) / limits.missed_tpdo_cycles


def test_a_position_that_comes_seldom_is_waited_for(draft):
    text = edit(
        edit(FOREIGN, "1800sub2", AccessType="const", DefaultValue=255), "1800sub5", AccessType="const", DefaultValue=8
    )
    made = draft(fixed(text, 0x1A00, 0x1A01, 0x1A02, 0x1A03))
    assert made.rig.one_axis().limits.missed_tpdo_cycles == 10
    assert "every 8 ms" in marks(made, "limits.missed_tpdo_cycles")
    with pytest.raises(RigError, match="sent every 20 ms"):
        draft(edit(fixed(text, 0x1A00, 0x1A01, 0x1A02, 0x1A03), "1800sub5", DefaultValue=20))


@pytest.mark.parametrize("rated_mNm", [5, 310, 20_000, 60_000])
def test_no_ratio_is_chosen_to_make_a_rated_torque_fit(draft, rated_mNm):
    made = draft(edit(FOREIGN, "6076", DefaultValue=rated_mNm))
    axis, bench = made.rig.one_axis(), load_rig("bench").one_axis()
    assert axis.mechanics.ratio == bench.mechanics.ratio
    assert axis.motor.rated_torque_Nm == rated_mNm / 1000
    for name in axis.mode:
        mode = axis.mode[name]
        assert mode.motor_limit_Nm <= bench.mode[name].motor_limit_Nm
    coarse = rated_mNm * 1e-6 * axis.mechanics.ratio > 0.168
    assert ("commands no torque" in marks(made, "motor.rated_torque_Nm")) is coarse


@pytest.mark.parametrize(
    ("motor", "most_pm"),
    [
        (edit(FOREIGN, "6076", DefaultValue=5), 1000),
        (edit(FOREIGN, "6071", LowLimit=-100, HighLimit=100), 100),
        (edit(FOREIGN, "6071", LowLimit=-50, HighLimit=100), 50),
        (edit(FOREIGN, "6072", HighLimit=30), 30),
    ],
)
def test_a_weak_drive_lowers_the_limits_of_the_modes_and_bring_up_goes_on(draft, motor, most_pm):
    made = draft(motor)
    axis = made.rig.one_axis()
    most_Nm = axis.motor.rated_torque_Nm * axis.mechanics.ratio * most_pm / 1000
    limits = [mode.motor_limit_Nm for mode in map(axis.mode.__getitem__, axis.mode) if mode.motor_limit_Nm]
    assert max(limits) == pytest.approx(most_Nm, rel=0.01)
    assert max(limits) <= most_Nm
    assert "gives at most" in marks(made, "mode.active.motor_limit_Nm")
    for mode in axis.mode:
        plans = device_plans(Controller(axis, mode))
        assert [problem.text for problem in plans[0].problems if "HighLimit" in problem.text] == []
        assert cut_off(made.rig, mode) == []


def test_a_drive_whose_6064h_cannot_be_mapped_counts_by_6063h(draft):
    text = own_object(edit(FOREIGN, "6064", PDOMapping=0), 0x6063, "Position internal value", "0x0004", "ro")
    made = draft(text)
    assert {s.key: s.index for p in made.rig.pdos() for s in p.signals}["motor.position_rad"] == 0x6063


# makers' modes


def of_maxon(text):
    text = gone(edit(text, "1018sub1", DefaultValue="0xFB"), "6071")
    text = own_object(text, 0x2030, "Current Mode Setting Value")
    return text.replace("0x60710010", "0x20300010")


def test_a_makers_current_mode_is_bound_by_the_table(draft):
    text = of_maxon(edit(FOREIGN, "6502", DefaultValue=0))
    made = draft(text)
    axis = made.rig.one_axis()
    assert axis.motor.mode == -3
    setpoint = axis.allocation.bound["torque_setpoint"]
    assert setpoint.place == ("motor", 0x2030, 0)
    assert axis.allocation.bound["torque"].place == ("motor", 0x6078, 0)
    assert axis.allocation.bound["torque"].scale == setpoint.scale
    for path in ("motor.mode", "role.torque_setpoint.scale_Nm"):
        assert "CHECK" in marks(made, path)


def test_objects_that_a_makers_mode_needs_are_listed(draft):
    text = own_object(
        gone(edit(FOREIGN, "1018sub1", DefaultValue="0x1A3"), "6071"), 0x201C, "External online reference", "0x0004"
    )
    text = edit(text.replace("0x60710010", "0x201C0020"), "6502", DefaultValue="0x1F0065")
    axis = draft(text).rig.one_axis()
    assert axis.motor.mode == -5
    assert [(write.index, write.type, write.value) for write in axis.motor.sdo] == [(0x201D, "UNSIGNED16", 1)]
    assert axis.allocation.bound["torque_setpoint"].entry.bits == 32


def test_an_unknown_makers_set_point_is_found_by_its_name(draft):
    text = gone(edit(FOREIGN, "6502", DefaultValue=1 << 17 | 1), "6071").replace("0x60710010", "0x30010010")
    text = own_object(own_object(text, 0x3000, "Current limit"), 0x3001, "Target current")
    made = draft(text)
    assert made.rig.one_axis().motor.mode == -2  # bit 17
    assert made.rig.one_axis().allocation.bound["torque_setpoint"].entry.index == 0x3001
    assert "manual" in marks(made, "motor.mode")


@pytest.mark.parametrize(
    "name", ["Current limit", "Homing current", "Torque offset", "Target position", "Actual torque"]
)
def test_other_objects_of_a_maker_are_no_set_point(draft, name):
    text = own_object(gone(FOREIGN, "6071").replace("0x60710010", "0x30010010"), 0x3001, name)
    with pytest.raises(RigError, match="no torque or current set-point that a PDO can carry: 6071h is not described"):
        draft(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (gone(FOREIGN, "6071"), "6071h is not described"),
        (edit(FOREIGN, "6071", PDOMapping=0), "6071h is not mappable"),
        (edit(FOREIGN, "6502", DefaultValue=0x25), "6502h = 0x25 of the EDS file offers neither"),
    ],
)
def test_a_drive_without_a_set_point_is_refused_with_its_reason(draft, text, reason):
    with pytest.raises(RigError) as caught:
        draft(text)
    (line,) = caught.value.errors
    assert reason in line
    assert "take a drive that has one" in line
    assert caught.value.exit_status == 3
    assert caught.value.problems[0][:3] == ("torque_setpoint", "motor", "6071h")


# identity


def test_the_makers_numbers_of_DeviceInfo_stand_in_for_1018h(draft):
    text = edit(edit(FOREIGN, "1018sub1", DefaultValue=""), "DeviceInfo", VendorNumber="0x00000088")
    made = draft(text)
    assert made.rig.one_axis().motor.vendor_id == 0x88
    assert "CHECK" in marks(made, "motor.vendor_id")
    rehearsal = draft(text, rehearse=True)
    assert rehearsal.rig.one_axis().motor.vendor_id == 0
    assert "REHEARSAL" in marks(rehearsal, "motor.vendor_id")


# brakes and sensors


def test_an_output_in_volts_gets_a_table(draft):
    text = edit(edit(FOREIGN_BRAKE, "6301sub1", DefaultValue="0x00260000"), "6302sub1", DefaultValue=3)
    made = draft(MOTOR, edit(text, "7300sub1", HighLimit=20000))
    assert made.rig.one_axis().role.brake_setpoint.table == ((0, 0.0), (10000, 5.0))
    assert draft(MOTOR, text).rig.one_axis().role.brake_setpoint.table[-1] == (5000, 5.0)  # the file's HighLimit
    assert "CHECK" in marks(made, "role.brake_setpoint.table")


def test_an_output_in_Nm_needs_none(draft):
    assert draft(MOTOR, FOREIGN_BRAKE).rig.one_axis().role.brake_setpoint is None


def test_a_drive_feeds_the_coil_of_a_brake(draft):
    made = draft(MOTOR, edit(FOREIGN, "6075", DefaultValue=2000))
    axis = made.rig.one_axis()
    assert axis.brake.mode == 10
    assert axis.allocation.bound["brake_setpoint"].place == ("brake", 0x6071, 0)
    assert axis.allocation.bound["brake_setpoint"].scale == pytest.approx(2e-3 / 0.2)  # 1 per mille of 2 A, 0.2 A/Nm
    assert axis.allocation.bound.get("brake_controlword") is not None


def test_a_driver_without_an_output_is_refused(draft):
    text = gone(FOREIGN_BRAKE, "7300", "7300sub0", "7300sub1")
    with pytest.raises(RigError, match="no analogue output that a PDO can carry"):
        draft(MOTOR, text)


def test_the_first_sensor_has_the_handle_torque(draft):
    volts = edit(FOREIGN_BRAKE, "6131sub1", DefaultValue="0x00260000")
    made = draft(MOTOR, BRAKE, volts, FOREIGN)
    bound = made.rig.one_axis().allocation.bound["handle_torque"]
    assert bound.place == ("transducer", 0x7130, 1)
    digits = 3
    assert bound.scale == pytest.approx(5.0 / (10 * 10**digits))
    assert "CHECK" in marks(made, "role.handle_torque.scale_Nm")
    assert "no role" in marks(made, "sensor.sensor_2")


def test_an_optional_role_in_another_unit_is_taken_out_with_its_reason(draft):
    made = draft(MOTOR, edit(FOREIGN_BRAKE, "6131sub2", DefaultValue="0x00260000"))
    assert made.rig.one_axis().role.coil_current.object == "none"
    assert "6131h" in marks(made, "role.coil_current.object")
    assert made.rig.one_axis().allocation.bound.get("handle_torque") is not None


def test_a_cycle_that_does_not_fit_is_made_longer(draft):
    made = draft(FOREIGN, BRAKE, FOREIGN_BRAKE, like=load_rig("bench", ["bus.bitrate_bit_s=500000"]))
    axis = made.rig.one_axis()
    assert axis.bus.period_s == 0.002
    assert axis.bus.tpdo_window_s == pytest.approx(0.00148)
    assert axis.limits.encoder_jump_counts == round(
        1000 * axis.motor.encoder_counts_rev * axis.mechanics.ratio / (8192 * 9.587)
    )


# the rehearsal, and other rigs


def test_a_rehearsal_is_simulated_as_it_is_believed_to_be(draft):
    made = draft(edit(FOREIGN, "6076", DefaultValue=310), rehearse=True)
    axis = made.rig.one_axis()
    assert made.rig.warnings == ()
    assert axis.simulation.plant.motor_rated_torque_Nm == 0.31
    assert len(axis.phases) == 3
    lines = str(made).splitlines()
    assert [lines[number - 1][:12] for number in rehearsal_marks(str(made))] == ["# REHEARSAL:"] * 2


def test_acknowledgements_are_marked(draft):
    made = draft(rehearse=True)
    made.acknowledge(["motor: no reaction to the host's loss"] * 2)
    assert made.rig.host.accept == ("motor: no reaction to the host's loss",)
    assert "REHEARSAL" in marks(made, "host.accept")
    assert load_rig_text(str(made), made.path) == made.rig


def test_another_rigs_acknowledgements_and_switch_are_not_taken_over(draft):
    like = load_rig("bench", ['host.accept=["motor: no torque limit"]', 'host.deadman="object:6078:0:0x0001"'])
    host = draft(like=like).rig.host
    assert (host.accept, host.deadman) == ((), "")


def test_the_host_gives_way_to_a_device_with_its_id(tmp_path):
    devices = gather((DeviceChoice("motor", "bench", 127), DeviceChoice("brake", "bench", 126)), tmp_path)
    rig = Draft(devices, load_rig("bench").one_axis(), str(tmp_path / "my.toml")).rig
    assert rig.host.node_id == 125


def test_a_law_beside_another_rig_is_found_from_anywhere(draft, tmp_path):
    folder = tmp_path / "other"
    folder.mkdir()
    (folder / "mine.py").write_text("", encoding="utf-8")
    text = (RIGS / "bench.toml").read_text(encoding="utf-8").replace('"karnopp"', '"mine.py:friction"')
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    like = load_rig(str(folder / "rig.toml"))
    assert draft(like=like).rig.law_function == f"{folder / 'mine.py'}:friction"


def test_marks_of_a_rehearsal_stand_in_comments_only():
    text = 'a = 1\n# REHEARSAL: x\nb = 2  # REHEARSAL\nc = "REHEARSAL"\n# REHEARSALS\n'
    assert rehearsal_marks(text) == (2, 3)


# who is on the bus


def answers_of(path):
    description = parse_eds(path.read_bytes(), str(path))
    return {(index, sub): description.default(index, sub, 1) for index, sub in ((0x1000, 0), (0x1018, 1), (0x1018, 2))}


@pytest.fixture
def folder(tmp_path):
    for name, text in (("drive.eds", FOREIGN), ("driver.eds", FOREIGN_BRAKE)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "broken.eds").write_text("nothing", encoding="utf-8")
    return tmp_path


def test_live_devices_are_found_by_their_identity(folder):
    live = {
        9: answers_of(folder / "driver.eds"),
        5: answers_of(folder / "drive.eds"),
        7: answers_of(folder / "driver.eds"),
    }
    devices = gather((DeviceChoice("motor"), DeviceChoice("brake")), folder, live, folder)
    assert [(device.node, device.eds, device.node_id) for device in devices] == [
        ("motor", "drive.eds", 5),
        ("brake", "driver.eds", 9),
        ("sensor7", "driver.eds", 7),
    ]
    assert devices[0].answers[0x1018, 1] == 0x77


def test_a_named_file_finds_its_live_device(folder):
    live = {5: answers_of(folder / "drive.eds"), 9: answers_of(folder / "driver.eds")}
    devices = gather(
        (DeviceChoice("motor", str(folder / "drive.eds")), DeviceChoice("brake", "", 9)), None, live, folder
    )
    assert [(device.node, device.eds, device.node_id) for device in devices] == [
        ("motor", str(folder / "drive.eds"), 5),
        ("brake", str(folder / "driver.eds"), 9),
    ]


def test_a_live_device_without_a_file_is_told(folder):
    live = {5: {(0x1000, 0): 0x20192, (0x1018, 1): 0x99}}
    with pytest.raises(RigError, match="node 5 has 1018h 0x00000099 0x00000000, and none of 2 EDS files"):
        gather((DeviceChoice("motor"), DeviceChoice("brake", "bench")), folder, live, folder)


def test_no_live_device_of_a_kind_is_told(folder):
    with pytest.raises(RigError, match="no node on the bus is a drive"):
        gather((DeviceChoice("motor"), DeviceChoice("brake", "bench")), folder, {}, folder)


def test_files_are_named_from_the_rig_files_folder_on(folder):
    rigs = folder / "rigs"
    rigs.mkdir()
    choices = (
        DeviceChoice("motor", str(folder / "drive.eds")),
        DeviceChoice("brake", "bench", 1),
        DeviceChoice("transducer", str(folder / "driver.eds")),
    )
    devices = gather(choices, rigs)
    assert [(device.eds, device.node_id) for device in devices] == [
        ("../drive.eds", 2),
        ("mr_brake.eds", 1),
        ("../driver.eds", 3),
    ]
    (rigs / "mr_brake.eds").write_text("another", encoding="utf-8")
    assert Path(gather(choices, rigs)[1].eds).is_absolute()


@pytest.mark.thorough
@beside(CORPUS)
@pytest.mark.parametrize("node", ["motor", "brake"])
def test_drives_of_the_corpus_are_drafted_or_refused_with_a_reason(node):
    refused = {}
    for path in sorted(CORPUS.glob("*.eds")) + sorted(CORPUS.glob("*.dcf")):
        other = DeviceChoice("brake" if node == "motor" else "motor", "bench")
        both = sorted((DeviceChoice(node, str(path)), other), key=lambda choice: choice.node, reverse=True)
        for rehearse in (False, True):
            try:
                made = Draft(gather(both, None), load_rig("bench").one_axis(), "rig.toml", rehearse=rehearse)
            except RigError as error:
                refused.setdefault(path.stem, []).extend(error.errors)
                continue
            assert made.rig.warnings == ()
            assert path.stem not in refused
    assert refused.keys() >= REFUSED
    assert all(line.startswith(f"{node}: ") and "; " in line for lines in refused.values() for line in lines)
    assert not refused.keys() & DRAFTED
