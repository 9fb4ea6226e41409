"""Single values of a rig file are changed as a person would: all else stays."""

from __future__ import annotations

import difflib
import stat

import pytest

from coulombus.rigs.errors import RigError
from coulombus.rigs.rewrite import NewValue, replace_file, rewritten
from coulombus.rigs.rig import load_rig, load_rig_text, packaged_rig
from coulombus.rigs.toml_lines import read_toml
from places import RIGS

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
MOTOR, HOST = ("motor", "response_us"), ("host", "compute_s")

TEXT = """\
[mechanics]
# the lab's own words
friction_Nm = 0.14               # identified, "coil" off
ratio = 9.587

[role.brake_setpoint]
table = [[0, 0.0],   # off
         [100, 1.0]] # end
"""


def test_a_value_takes_the_old_ones_place_and_the_users_comments_stay():
    text = rewritten(TEXT, {("mechanics", "friction_Nm"): NewValue(0.2, "was 0.14")}, "commission", "f")
    assert text == TEXT.replace(
        'friction_Nm = 0.14               # identified, "coil" off',
        '# commission was 0.14\nfriction_Nm = 0.2                # identified, "coil" off',
    )


def test_a_second_measurement_replaces_the_comment_of_the_first():
    key = ("mechanics", "friction_Nm")
    once = rewritten(TEXT, {key: NewValue(0.2, "first")}, "commission", "f")
    twice = rewritten(once, {key: NewValue(0.3, "second")}, "commission", "f")
    assert "first" not in twice
    assert twice.count("# commission") == 1
    assert "# the lab's own words" in twice


def test_a_table_over_several_lines_is_replaced_whole():
    key = ("role", "brake_setpoint", "table")
    text = rewritten(TEXT, {key: NewValue([[0, 0.0], [90, 1.5]], "stair")}, "commission", "f")
    assert text.endswith("# commission stair\ntable = [[0, 0.0], [90, 1.5]] # end\n")


def test_a_missing_key_comes_below_its_header_or_with_its_section_at_the_end():
    text = rewritten(TEXT, {("mechanics", "viscous"): NewValue(0.5, "new")}, "commission", "f")
    assert text.startswith("[mechanics]\n# commission new\nviscous = 0.5\n")
    text = rewritten(TEXT, {("role", "handle_torque", "offset_Nm"): NewValue(-0.1, "zero")}, "commission", "f")
    assert text.endswith("\n[role.handle_torque]\n# commission zero\noffset_Nm = -0.1\n")


def test_windows_line_ends_stay():
    text = rewritten(TEXT.replace("\n", "\r\n"), {("mechanics", "ratio"): NewValue(4.0, "x")}, "commission", "f")
    assert text.count("\r\n") == text.count("\n")


def test_a_key_in_an_inline_table_is_refused_with_what_to_write_by_hand():
    with pytest.raises(RigError, match=r"f: mechanics.ratio cannot be changed alone.*ratio = 4.0"):
        rewritten("mechanics = {ratio = 9.0}\n", {("mechanics", "ratio"): NewValue(4.0, "x")}, "commission", "f")


def test_every_number_of_the_bench_can_be_changed_and_loads():
    text = packaged_rig("bench").read_text()
    values = {("mechanics", "friction_Nm"): NewValue(0.2, "x"), ("limits", "travel_rad"): NewValue(2.0, "y")}
    rig = load_rig_text(rewritten(text, values, "commission", "bench"), "bench", load_rig("bench").eds_texts)
    assert (rig.one_axis().mechanics.friction_Nm, rig.one_axis().limits.travel_rad) == (0.2, 2.0)


def changed(text, numbers):
    values = {key: NewValue(value, f"today: {value}") for key, value in numbers.items()}
    return rewritten(text, values, "measured by coulombus measure", "r.toml")


def added_and_gone(before, after):
    lines = list(difflib.ndiff(before.splitlines(), after.splitlines()))
    return [[line[2:] for line in lines if line[0] == mark] for mark in "+-"]


def test_a_key_that_is_not_there_comes_below_its_section():
    after = changed(BENCH, {MOTOR: 150.0, HOST: 6e-05})
    added, gone = added_and_gone(BENCH, after)
    assert gone == []
    assert added == [
        *("# measured by coulombus measure today: 6e-05", "compute_s = 6e-05"),
        *("# measured by coulombus measure today: 150.0", "response_us = 150.0"),
    ]
    rig = load_rig_text(after, "r.toml")
    assert (rig.one_axis().motor.response_us, rig.host.compute_s) == (150.0, 6e-05)


def test_a_value_that_stands_there_is_replaced_and_its_comment_stays():
    text = BENCH.replace("node_id = 1\n", "node_id = 1\n# mine\nresponse_us = 99.5   # from the manual\n", 1)
    after = changed(text, {MOTOR: 150.0})
    added, gone = added_and_gone(text, after)
    assert gone == ["response_us = 99.5   # from the manual"]
    assert added == ["# measured by coulombus measure today: 150.0", "response_us = 150.0  # from the manual"]
    again = changed(after, {MOTOR: 130.0})
    assert "150" not in again
    assert again.count("measured by coulombus measure") == 1  # the older measurement's comment is gone
    assert "# mine\n" in again


def test_a_guess_that_was_measured_is_no_guess_any_more():
    guess = "# CHECK: this device was not measured; see its manual\nresponse_us = 150.0\n"
    text = BENCH.replace("node_id = 1\n", f"node_id = 1\n# CHECK: another\nratio_of_mine = 1\n{guess}", 1)
    after = changed(text, {MOTOR: 80.0})
    assert "was not measured" not in after
    assert "# CHECK: another\n" in after


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_line_ends_stay(ending):
    text = BENCH.replace("\n", ending)
    after = changed(text, {MOTOR: 150.0})
    assert after.count("\r\n") == (after.count("\n") if ending == "\r\n" else 0)
    assert [line for line in after.split(ending) if "measure" not in line and "response" not in line] == text.split(
        ending
    )


def test_named_axes_have_their_own():
    text = (RIGS / "two_axes.toml").read_text()
    after = changed(text, {("axis", "left", *MOTOR): 110.0, ("axis", "right", "brake", "response_us"): 90.0})
    rig = load_rig_text(after, "r.toml")
    assert [axis.motor.response_us for axis in rig.axes] == [110.0, 20.0]
    assert [axis.brake.response_us for axis in rig.axes] == [20.0, 90.0]


def test_a_file_of_dotted_keys_alone_is_changed_too():
    text = "motor.node_id = 1\nmotor.eds = 'a.eds'\n[host]\nnode_id = 5\n"
    assert read_toml(changed(text, {MOTOR: 7.0})).values["motor"] == {"node_id": 1, "eds": "a.eds", "response_us": 7.0}


@pytest.mark.parametrize(
    "text",
    [
        "motor = {node_id = 1}\n",
        "motor = {node_id = 1, response_us = 5.0}\n",
        "[motor]\nresponse_us = [\n1,\n",
        'motor = "x"\n',
    ],
)
def test_what_cannot_be_changed_alone_is_refused_with_what_to_do(text):
    with pytest.raises(
        RigError,
        match=r"motor.response_us cannot be changed alone as it stands; write it by hand: motor.response_us = 150.0",
    ):
        changed(text, {MOTOR: 150.0})


def test_the_file_is_replaced_as_a_whole_and_the_old_one_kept(tmp_path):
    path = tmp_path / "my.toml"
    path.write_bytes(b"\xef\xbb\xbf" + BENCH.encode())
    path.chmod(0o640)
    link = tmp_path / "link.toml"
    link.symlink_to(path)
    text = load_rig(str(path)).text
    backup = replace_file(link, text, changed(text, {MOTOR: 150.0}))
    assert backup == tmp_path / "my.toml.bak"
    assert backup.read_bytes() == b"\xef\xbb\xbf" + BENCH.encode()
    assert link.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert load_rig(str(path)).one_axis().motor.response_us == 150.0
    second = replace_file(path, load_rig(str(path)).text, BENCH)
    assert second == tmp_path / "my.toml.bak2"  # no backup is lost
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.toml", "my.toml", "my.toml.bak", "my.toml.bak2"]


def test_a_file_that_was_changed_meanwhile_stays(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text(BENCH + "# somebody's\n")
    with pytest.raises(RigError, match="was changed meanwhile"):
        replace_file(path, BENCH, changed(BENCH, {MOTOR: 150.0}))
    assert path.read_text() == BENCH + "# somebody's\n"
    assert [path.name for path in tmp_path.iterdir()] == ["my.toml"]


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "my.toml"
    path.write_text("a = 1\n")

    def full(fd):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(path, "a = 1\n", "a = 2\n", tmp_path / "old.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["my.toml"]
    assert path.read_text() == "a = 1\n"
