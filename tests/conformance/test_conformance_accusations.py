"""For each rule a slave that breaks it, which fails, and one that keeps it in the widest way that the
standard allows, which does not.
"""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance_bench import KIND_OF, VirtualLink, description, new_unit
from conformance_foreign import abort
from conformance_mutants import ok, written
from conformance_slaves import (
    CLOCK,
    MS,
    NMT,
    OPERATING_TIME,
    REQUEST,
    RESPONSE,
    SYNC,
    Slave,
    distorting_object,
    kept_object,
    late,
    late_emcy,
    late_mode_display,
    no_emcy_of_error_control,
    results,
    run_on,
    running_object,
    serves,
    stored_by_a_user,
    unit_of,
    with_clock,
    with_key,
    with_object,
    with_operating_time,
    without,
    without_restore,
    wrong_default,
)
from coulombus.conformance.catalogue import catalogue
from coulombus.conformance.report import as_dict, causes, heading, markdown, page
from coulombus.conformance.tester.storage import intention
from coulombus.conformance.tester.unit import Timing, Unit
from coulombus.wire.bus_link import BusFrame

few = settings(max_examples=6, deadline=None, derandomize=True)
LEFT_OPEN = "the standard leaves it open"


def outcomes(slave, *numbers, timing=None):
    return results(run_on(unit_of(slave, timing=timing), *numbers))


def only(outcome, *expected):
    assert {number: why for number, why in outcome.items() if why[0] not in expected} == {}


# objects that run


@pytest.mark.thorough
@few
@given(st.integers(MS, 1900 * MS), st.booleans())
def test_an_object_that_runs_at_any_rate_is_not_accused(period_ns, settable):
    for where, eds in ((CLOCK, with_clock), (OPERATING_TIME, with_operating_time)):
        slave = Slave(takes=running_object(where, period_ns, settable=settable), eds=eds)
        only(outcomes(slave, "4.2", "4.8", "4.9"), "pass")


@few
@given(st.integers(1, 0xFFFFFFFF))
def test_an_object_that_holds_another_value_and_does_not_run_fails(offset):
    for where, eds in ((CLOCK, with_clock), (OPERATING_TIME, with_operating_time)):
        slave = Slave(takes=distorting_object(where, lambda value: value + offset), eds=eds)
        only(outcomes(slave, "4.9"), "fail")


def test_a_clock_is_among_what_2_2_may_choose():
    def chosen(takes):
        for seed in range(40):
            unit = unit_of(Slave(takes=takes, eds=with_clock))
            unit.random.seed(seed)
            outcome = results(run_on(unit, "2.2"))["2.2"]
            if "1013h:00" in outcome[1]:
                return outcome
        raise AssertionError("no seed of 40 chose 1013h")

    assert chosen(running_object(CLOCK, MS)) == ("pass", chosen(running_object(CLOCK, MS))[1])
    assert chosen(distorting_object(CLOCK, lambda value: value + 1))[0] == "fail"


def _limited(text):
    return with_object(text, 0x2100, "DataType=0x0007\nAccessType=rw\nDefaultValue=0\nHighLimit=4000000000\n")


@pytest.mark.parametrize(("takes_it", "expected"), [(False, "pass"), (True, "fail")])
def test_a_refused_value_may_not_change_what_stands_and_a_counter_may(takes_it, expected):
    counter = running_object(OPERATING_TIME, 2 * MS)

    def takes(link, can_id, data, length):
        if can_id == REQUEST and written(data) == OPERATING_TIME and int.from_bytes(data[4:], "little") > 4_000_000_000:
            if takes_it:
                link.memory["held"] = 17
            return abort(OPERATING_TIME, 0x06090031)
        return held(link, can_id, data, length) if takes_it else counter(link, can_id, data, length)

    held = distorting_object(OPERATING_TIME, lambda value: value)
    assert outcomes(Slave(takes=takes, eds=_limited), "4.6")["4.6"][0] == expected


# limits of a count


def _count_refused_with(code):
    def takes(link, can_id, data, length):
        if can_id == REQUEST and written(data) in ((0x1A00, 0), (0x1600, 0)) and data[4] > 4:
            return abort(written(data), code)
        return can_id, data, length

    return takes


def _four_entries(text):
    for section in ("1A00", "1600"):
        for sub in range(5, 9):
            text = without_sub(f"{section}sub{sub}", text)
        text = with_key(f"{section}sub0", "HighLimit=4", text)
    return text


def without_sub(section, text):
    return "\n[".join(part for part in text.split("\n[") if not part.startswith(f"{section}]"))


@pytest.mark.parametrize(
    ("code", "expected"),
    [(0x06090030, "pass"), (0x06090031, "pass"), (0x06040042, "pass"), (0x06090032, "fail"), (0x06010002, "fail")],
)
def test_a_count_above_its_limit_may_be_refused_as_a_value(code, expected):
    slave = Slave(takes=_count_refused_with(code), eds=_four_entries)
    result, reason = outcomes(slave, "3.25")["3.25"]
    assert result == expected, reason
    assert (LEFT_OPEN in reason) == (code in (0x06090030, 0x06090031))


# waits


@pytest.mark.thorough
@few
@given(st.integers(0, 900))
def test_a_device_may_take_its_time_up_to_the_time_out(delay_ms):
    delay_ns = delay_ms * MS
    only(outcomes(Slave(takes=late_mode_display(delay_ns)), "P.8"), "pass")
    only(outcomes(Slave(takes=late(delay_ns, 0x80, 0x201, 0x301, 0x401, 0x501)), "R.1", "R.4", "R.7"), "pass")
    only(outcomes(Slave(sends=late_emcy(delay_ns)), "7.106", "7.6", "H.1", "H.4", "5.4", "E.5"), "pass")


@few
@given(st.integers(0, 400))
def test_an_nmt_command_may_take_effect_late(delay_ms):
    commands = ("9.3", "9.4", "10.2", "10.3", "10.4", "P.9")
    only(outcomes(Slave(takes=late(delay_ms * MS, NMT)), *commands), "pass")


@pytest.mark.thorough
@few
@given(st.integers(0, 70))
def test_pdos_and_sync_may_be_looked_at_late_after_a_start(delay_ms):
    cases = ("3.3", "3.5", "3.6", "3.7", "3.8", "6.3", "6.4", "R.1", "R.4", "T.4", "T.6", "H.5", "P.4")
    only(outcomes(Slave(takes=late(delay_ms * MS, NMT)), *cases), "pass")


@pytest.mark.parametrize("timeout_s", [0.1, 1.0])
def test_what_takes_longer_than_the_time_out_fails(timeout_s):
    slave = Slave(takes=late_mode_display(int(3e9 * timeout_s)))
    timing = Timing.from_timeout(timeout_s)
    assert outcomes(slave, "P.8", timing=timing)["P.8"][0] == "fail"
    assert outcomes(Slave(takes=late_mode_display(int(0.8e9 * timeout_s))), "P.8", timing=timing)["P.8"][0] == "pass"


# access types


def _fixed(places):
    def takes(link, can_id, data, length):
        if can_id == REQUEST and length == 8 and written(data) in places:
            return abort(written(data), 0x06010002)
        return can_id, data, length

    return takes


@pytest.mark.parametrize("access", ["ro", "const"])
@pytest.mark.parametrize(
    ("section", "places", "cases"),
    [
        ("1016sub1", ((0x1016, 1),), ("7.104", "7.105", "7.106", "7.107", "E.1", "H.1", "H.3", "H.4")),
        ("1A00sub2", ((0x1A00, 2),), ("3.22", "3.23", "3.24", "3.25", "3.26", "3.30", "M.1", "T.9")),
        ("6060", ((0x6060, 0),), ("P.2", "P.8")),
        ("1017", ((0x1017, 0),), ("2.15", "2.21", "7.101", "7.102", "S.7", "9.3")),
    ],
)
def test_what_the_eds_fixes_may_refuse_a_write(access, section, places, cases):
    slave = Slave(takes=_fixed(places), eds=lambda text: with_key(section, f"AccessType={access}", text))
    only(outcomes(slave, *cases), "pass", "not_applicable")
    broken = Slave(takes=_fixed(places))  # the EDS says rw
    assert any(why[0] == "fail" for why in outcomes(broken, *cases).values())


# defaults


ALONE = ("4.2", "4.8", "8.7", "6.1", "7.1", "5.1")


@few
@given(st.integers(20, 20_000))
def test_what_a_user_has_stored_is_no_accusation(period_ms):
    unit = unit_of(Slave())
    stored_by_a_user(unit, 0x1017, period_ms.to_bytes(2, "little"))
    stored_by_a_user(unit, 0x100C, b"\x07\0")
    report = run_on(unit, *ALONE)
    only(results(report), "pass")
    assert "began from the device's defaults" in report.remarks[0]
    assert "ends with its defaults" in report.remarks[1]
    assert unit.number(0x1017) == 0


def test_a_case_that_needs_no_defaults_leaves_what_is_stored():
    unit = unit_of(Slave())
    stored_by_a_user(unit, 0x1017, b"\xc4\x09")
    report = run_on(unit, "2.1", "2.3")
    assert "began with the parameters that the device held" in report.remarks[0]
    assert unit.read(0x1017) == b"\xc4\x09"


def _no_1011(text):
    return without(0x1011, text)


@pytest.mark.thorough
def test_a_device_without_restore_is_never_stored_to():
    unit = unit_of(Slave(takes=without_restore, eds=_no_1011))
    unit.learn_abilities()
    assert "nothing is stored in it" in intention(unit, {"8.5"})
    report = run_on(unit)
    assert "saved" not in unit.link.memory
    only(results(report), "pass", "not_applicable")
    assert "no 1011h:01 on command" in report.remarks[0]
    assert "nothing was stored in it" in report.remarks[1]


def test_without_restore_a_stored_value_is_not_judged_and_a_constant_is():
    unit = unit_of(Slave(takes=without_restore, eds=_no_1011))
    stored_by_a_user(unit, 0x1017, b"\xc4\x09")
    outcome = results(run_on(unit, "4.2", "4.8"))
    only(outcome, "not_applicable")
    assert "may have been stored" in outcome["4.2"][1]
    wrong = serves((0x1000, 0), lambda link: 0x00020191, lambda link, data: abort((0x1000, 0), 0x06010002))

    def takes(link, can_id, data, length):
        found = wrong(link, can_id, data, length)
        return found if isinstance(found, bytes) else without_restore(link, can_id, data, length)

    unit = unit_of(Slave(takes=takes, eds=lambda text: with_key("1000", "DefaultValue=0x20192", _no_1011(text))))
    stored_by_a_user(unit, 0x1017, b"\xc4\x09")
    report = run_on_forced(unit, "4.2")
    assert results(report)["4.2"][0] == "fail"


def run_on_forced(unit, *numbers):
    from coulombus.conformance.runner import run, select

    return run(unit, select(numbers))


def _slow_flash(link, can_id, data, length):
    if (
        can_id == REQUEST
        and written(data) in ((0x1010, 1), (0x1010, 2), (0x1011, 1))
        and data[4:] in (b"save", b"load")
    ):
        link.later(link.memory.get("flash_ns", 0), can_id, data, length)
        return None
    return can_id, data, length


@few
@given(st.integers(0, 4500))
def test_a_flash_memory_may_take_as_long_as_a_boot_up(flash_ms):
    unit = unit_of(Slave(takes=_slow_flash))
    unit.link.memory["flash_ns"] = flash_ms * MS
    only(results(run_on(unit, "8.1", "8.3", "8.5", "8.6", "8.7", "8.9", "6.8")), "pass")


def _restore_refused(link, can_id, data, length):
    refused = can_id == REQUEST and written(data) == (0x1011, 1) and link.memory.get("saved")
    if can_id == REQUEST and written(data) == (0x1010, 1):
        link.memory["saved"] = True
    return abort((0x1011, 1), 0x08000021) if refused else (can_id, data, length)


def test_the_end_tells_what_stays_stored():
    report = run_on(unit_of(Slave(takes=_restore_refused)), "8.5")
    assert report.remarks[-1].startswith("what the run stored stays in the device: ")
    assert "08000021" in report.remarks[-1]


@pytest.mark.thorough
@few
@given(st.integers(1, 0xFFFFFFFF))
def test_an_operating_time_is_left_open_and_a_wrong_default_fails(value):
    unit = unit_of(Slave(takes=kept_object(OPERATING_TIME, value), eds=with_operating_time))
    outcome = results(run_on(unit, "4.2", "4.8"))
    only(outcome, "pass")
    assert LEFT_OPEN in outcome["4.2"][1]
    assert unit.number(*OPERATING_TIME) == value  # it was given back
    broken = Slave(takes=wrong_default(OPERATING_TIME, value), eds=with_operating_time)
    only(outcomes(broken, "4.2", "4.8"), "fail")


# what the standard leaves open


OF_A_LOST_HEARTBEAT = ("7.106", "E.1", "E.3", "E.5", "E.7", "E.9", "H.1", "H.4", "7.6")


def test_an_error_control_event_without_emcy_is_left_open():
    outcome = outcomes(Slave(sends=no_emcy_of_error_control), *OF_A_LOST_HEARTBEAT, "5.4", "5.5", "5.6")
    only({number: outcome[number] for number in OF_A_LOST_HEARTBEAT}, "not_applicable")
    assert all(LEFT_OPEN in outcome[number][1] for number in OF_A_LOST_HEARTBEAT)
    only({number: outcome[number] for number in ("5.4", "5.5", "5.6")}, "pass")  # a short RPDO is one


def _heartbeats_and_guarding_are_not_watched(link, can_id, data, length):
    if can_id == REQUEST and written(data) == (0x100D, 0):
        return ok(data)
    return None if can_id in (0x77E, 0x77C) else (can_id, data, length)


def test_an_error_control_event_that_nobody_notices_fails():
    only(outcomes(Slave(takes=_heartbeats_and_guarding_are_not_watched), "7.106", "7.6", "H.5"), "fail")


@few
@given(st.sampled_from([0x05030000, 0x05040001, 0x05040002, 0x05040003, 0x08000000]))
def test_a_segment_out_of_turn_has_no_code_of_its_own(code):
    def sends(link, frame):
        if frame.can_id == RESPONSE and frame.data[0] == 0x80 and frame.data[4:] == b"\x01\0\x04\x05":
            return BusFrame(frame.t_ns, RESPONSE, frame.data[:4] + code.to_bytes(4, "little"), 8)
        return frame

    only(outcomes(Slave(sends=sends), "S.3", "S.8", "S.9", "S.10", "B.12", "B.13"), "pass")


def test_a_segment_out_of_turn_is_no_matter_of_access():
    def sends(link, frame):
        if frame.can_id == RESPONSE and frame.data[0] == 0x80 and frame.data[4:] == b"\x01\0\x04\x05":
            return BusFrame(frame.t_ns, RESPONSE, frame.data[:4] + b"\x02\0\x01\x06", 8)
        return frame

    only(outcomes(Slave(sends=sends), "S.3", "S.8", "S.9", "S.10", "B.12", "B.13"), "fail")


BLOCKS = ("2.19", "2.20", "2.21", "2.22", "2.23", "2.24", "2.25", "2.26", "2.27", *(f"B.{k}" for k in range(1, 15)))
CODES = (0x05040001, 0x05040000, 0x05040002, 0x06010000, 0x06010002, 0x06020000, 0x06040043, 0x08000000, 0x08000022)


@few
@given(st.sampled_from(CODES))
def test_a_device_that_aborts_block_transfers_has_none(code):
    def takes(link, can_id, data, length):
        blocks = can_id == REQUEST and length == 8 and data[0] >> 5 in (5, 6)
        return abort((int.from_bytes(data[1:3], "little"), data[3]), code) if blocks else (can_id, data, length)

    only(outcomes(Slave(takes=takes), *BLOCKS), "not_applicable")


# causes and frames


def _answers_block_uploads_expedited(link, can_id, data, length):
    if can_id == REQUEST and length == 8 and data[0] >> 5 == 5:
        return b"\x43" + data[1:4] + b"\x92\x01\x02\0"
    return can_id, data, length


def test_a_wrong_block_upload_is_one_cause():
    report = run_on(unit_of(Slave(takes=_answers_block_uploads_expedited)), *BLOCKS)
    (cause,) = causes(report)
    assert set(cause.cases) == {number for number, why in results(report).items() if why[0] == "fail"}
    assert len(cause.cases) >= 20
    assert "43h" in cause.text
    assert cause.clause.startswith("CiA 301, 7.2.4")
    assert cause.frames
    for text in (markdown(report), page(report)):
        assert text.count(heading(1, cause)) == 1
        assert text.index(heading(1, cause)) < text.index("SDO block upload")
        assert text.count("command 43h") == 2  # above the frames, and with the first case
        assert text.count(cause.frames[-1]) == 1
    (entry,) = as_dict(report)["causes"]
    assert entry["cases"] == list(cause.cases)


def _no_heartbeats(link, frame):
    return None if frame.can_id == 0x701 and frame.length and frame.data != b"\0" else frame


def test_a_device_without_heartbeats_has_one_cause():
    numbers = ("7.102", "7.103", "7.202", "7.204", "7.206", "9.2", "9.3", "9.4", "10.2", "10.3", "10.4", "H.5", "N.1")
    report = run_on(unit_of(Slave(sends=_no_heartbeats)), *numbers)
    (cause,) = causes(report)
    assert cause.cases == tuple(outcome.case.id for outcome in report.outcomes)
    assert cause.text == "no heartbeat"


class SkewedLink(VirtualLink):
    """A bus whose stamps are behind the tester's clock, by more and more."""

    def tamper(self, frame):
        return [BusFrame(frame.t_ns - 700_000 - frame.t_ns // 1000, frame.can_id, frame.data, frame.length)]


def test_the_times_of_frames_do_not_run_backwards():
    eds = description("mr_brake")
    unit = Unit(SkewedLink(description("motor"), 1, KIND_OF["motor"]), eds, 1, Timing())
    failed = [outcome for outcome in run_on_forced(unit, "2.1", "4.2", "5.1", "7.2").outcomes if outcome.frames]
    assert failed
    for outcome in failed:
        times = [float(line.split()[0]) for line in outcome.frames]
        assert times == sorted(times)


def test_a_sound_run_has_no_cause():
    report = run_on(new_unit("motor"), "2.1", "4.2")
    assert causes(report) == []
    assert as_dict(report)["causes"] == []


def _no_sync(link, can_id, data, length):
    return None if can_id == SYNC else (can_id, data, length)


def _no_lss(link, can_id, data, length):
    return None if can_id == 0x7E5 else (can_id, data, length)


@pytest.mark.parametrize(
    ("takes", "numbers", "text"),
    [
        (_no_sync, ("3.6", "3.8", "3.22", "6.3", "6.4", "Y.1", "9.3", "10.3"), "no TPDO comes with a SYNC"),
        (_no_lss, ("L.1", "L.4", "L.5", "L.7", "L.8", "L.9"), "no LSS slave answers"),
        (late(10**12, 0x201, 0x301, 0x401, 0x501), ("R.1", "R.4", "R.6", "R.7"), "an RPDO does not act on its object"),
        (late_mode_display(10**12), ("P.8",), "6061h is "),
    ],
)
def test_one_fault_is_one_cause(takes, numbers, text):
    report = run_on(unit_of(Slave(takes=takes)), *numbers)
    (cause,) = causes(report)
    assert set(cause.cases) == set(numbers)
    assert cause.text.startswith(text)
    assert cause.clause.startswith("CiA ")


def test_every_case_has_its_clause():
    assert all(case.clause.startswith("CiA ") for case in catalogue())


def test_what_cannot_tell_its_state_is_left_open():
    """Neither heartbeat nor guarding: that 1029h acts cannot be seen."""

    def eds(text):
        return with_key("1017", "AccessType=const", without(0x100C, without(0x100D, text)))

    slave = Slave(sends=no_emcy_of_error_control, eds=eds)
    result, reason = outcomes(slave, "7.106")["7.106"]
    assert result == "not_applicable"
    assert "leaves OPERATIONAL" not in reason
