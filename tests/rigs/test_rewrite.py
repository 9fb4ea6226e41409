"""Single values of a rig file are changed as a person would: all else stays."""

from __future__ import annotations

import pytest

from coulombus.rigs.mistakes import RigError
from coulombus.rigs.rewrite import NewValue, replace_file, rewritten
from coulombus.rigs.rig import load_rig, load_rig_text, packaged_rig

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
        '# commission was 0.14\nfriction_Nm = 0.2               # identified, "coil" off',
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


def test_a_file_that_was_changed_meanwhile_stays(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text("a = 1\n")
    with pytest.raises(RigError, match="changed meanwhile"):
        replace_file(path, "a = 0\n", "a = 2\n", tmp_path / "old.toml")
    assert path.read_text() == "a = 1\n"
    assert not (tmp_path / "old.toml").exists()


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "my.toml"
    path.write_text("a = 1\n")

    def full(fd):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(path, "a = 1\n", "a = 2\n", tmp_path / "old.toml")
    assert [one.name for one in tmp_path.iterdir()] == ["my.toml"]
    assert path.read_text() == "a = 1\n"
