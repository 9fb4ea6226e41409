"""``coulombus commission``: what it asks, prints and writes, and how it ends."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli import commission as verb
from coulombus.cli.main import main
from coulombus.host.commission import session
from coulombus.host.commission.limits import LimitsStep
from coulombus.host.commission.transducer import WeightStep, ZeroStep
from coulombus.rigs.rig import load_rig, packaged_rig


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Return a call of the verb on a rig file of its own, with two steps only."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(session, "STEPS", (ZeroStep(), LimitsStep()))
    (tmp_path / "my.toml").write_text(packaged_rig("bench").read_text())

    def run(more, status=0, **options):
        result = CliRunner().invoke(main, ["commission", *more.split()], **options)
        assert "Traceback" not in result.output
        assert result.exit_code == status, result.output
        return result

    return run


OFF = "[role.handle_torque]\noffset_Nm = 0.1\n"


def test_a_rehearsed_step_prints_one_document_and_writes_copy_and_report(call, tmp_path):
    (tmp_path / "truth.toml").write_text(packaged_rig("bench").read_text() + OFF)
    words = "--rig my.toml --virtual --truth truth.toml --yes --step zero --json --report r.html"
    (step,) = json.loads(call(words).stdout)["steps"]
    assert step["what"] == "done"
    assert step["written"] == ["role.handle_torque.offset_Nm"]
    assert step["findings"][0]["new"] == pytest.approx(0.1, abs=0.002)
    assert "offset_Nm = 0." in (tmp_path / "my.toml").read_text()
    page = (tmp_path / "r.html").read_text()
    assert page == (tmp_path / "my.commission" / "report.html").read_text()
    assert page.count("<svg") == 1
    assert "Not done" in page
    assert len(list((tmp_path / "my.commission").glob("my.*.zero.toml"))) == 1


def test_an_interrupted_afternoon_goes_on_where_it_was(call):
    call("--rig my.toml --virtual --yes --step zero")
    listed = json.loads(call("--list --rig my.toml --json").stdout)["steps"]
    assert [bool(one["done"]) for one in listed] == [True, False]
    rest = call("--rig my.toml --virtual --yes --json")
    assert [one["step"] for one in json.loads(rest.stdout)["steps"]] == ["limits"]
    assert "zero: done at" in rest.stderr


def test_who_is_asked_and_says_no_is_not_moved(call, monkeypatch):
    monkeypatch.setattr(verb.click, "confirm", lambda *args, **options: False)
    monkeypatch.setattr(verb, "_somebody", lambda: True)
    result = call("--rig my.toml --virtual --step zero --json")
    assert json.loads(result.stdout)["steps"][0]["what"] == "skipped"
    assert "Nothing moves" in result.stderr
    assert "Ctrl-C" in result.stderr


def test_ctrl_c_at_the_question_is_status_130(call, monkeypatch):
    def leave(*args, **options):
        raise verb.click.Abort

    monkeypatch.setattr(verb, "_somebody", lambda: True)
    monkeypatch.setattr(verb.click, "confirm", leave)
    call("--rig my.toml --virtual --step zero", status=130)


def test_a_full_disk_at_the_rig_file_is_status_2_and_leaves_it_whole(call, tmp_path, monkeypatch):
    (tmp_path / "truth.toml").write_text(packaged_rig("bench").read_text() + OFF)

    def full(*args):
        raise OSError(28, "No space left on device", "my.toml")

    monkeypatch.setattr("coulombus.host.commission.session.replace_file", full)
    result = call("--rig my.toml --virtual --truth truth.toml --yes --step zero", status=2)
    assert "No space left on device" in result.stderr
    assert (tmp_path / "my.toml").read_text() == packaged_rig("bench").read_text()
    assert not (tmp_path / "my.commission" / "state.json").exists()


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        ("", 2, "give --rig"),
        ("--rig my.toml --virtual", 2, "no terminal to ask on"),
        ("--rig bench --virtual --yes", 2, "bench is a rig of the package"),
        ("--rig my.toml --truth my.toml --yes", 2, "--truth is for --virtual"),
        ("--rig my.toml --virtual --bus coulombus:x --yes", 2, "leave out --bus"),
        ("--rig my.toml --virtual --yes --step zerro", 2, "did you mean 'zero'?"),
        ("--rig none.toml --virtual --yes", 3, "cannot be read"),
        ("--rig my.toml --bus coulombus:none --yes --step zero", 4, "no bus coulombus:none"),
    ],
)
def test_what_cannot_be_commissioned_is_refused_with_the_remedy(call, private_sockets, words, status, text):
    assert text in call(words, status).stderr


def test_a_step_that_is_asked_for_and_cannot_be_done_is_status_1(call, monkeypatch):
    monkeypatch.setattr(session, "STEPS", (WeightStep(),))
    result = call("--rig my.toml --virtual --yes --step weight", 1)
    assert "give --weight-Nm" in result.stderr
    assert result.stdout == ""
    call("--rig my.toml --virtual --yes", 0)


def test_a_rig_of_several_axes_needs_the_name_of_one(call, tmp_path):
    (tmp_path / "two.toml").write_text(packaged_rig("two_axes").read_text())
    refused = call("--rig two.toml --virtual --yes", 3).stderr
    assert "one axis at a time: give --axis left" in " ".join(refused.split())
    assert "--axis middle" in call("--rig two.toml --virtual --yes --axis middle", 3).stderr
    assert "one axis, without a name" in call("--rig my.toml --virtual --yes --axis left", 3).stderr


@pytest.mark.thorough
def test_what_is_found_of_an_axis_is_written_below_it_and_leaves_the_other(call, tmp_path):
    text = packaged_rig("two_axes").read_text()
    (tmp_path / "two.toml").write_text(text)
    (tmp_path / "truth.toml").write_text(f"{text}\n[axis.right.role.handle_torque]\noffset_Nm = 0.1\n")
    words = "--rig two.toml --virtual --truth truth.toml --yes --step zero --json --axis"
    (right,) = json.loads(call(f"{words} right").stdout)["steps"]
    (left,) = json.loads(call(f"{words} left").stdout)["steps"]
    assert (right["written"], left["written"]) == (["axis.right.role.handle_torque.offset_Nm"], [])
    rig = load_rig(str(tmp_path / "two.toml"))
    roles = {axis.name: axis.role.handle_torque for axis in rig.axes}
    offsets = {name: role.offset_Nm if role else 0 for name, role in roles.items()}
    assert offsets == {"left": 0, "right": pytest.approx(0.1, abs=0.003)}
    assert sorted(path.name for path in (tmp_path / "two.commission").iterdir()) == ["left", "right"]
    assert "done at" in call("--rig two.toml --virtual --yes --axis right").stderr


def test_wider_limits_are_for_a_virtual_bus_alone(call):
    refused = call("--rig my.toml --bus socketcan:can0 --yes --shared-machine", 2).stderr
    assert "a motor could push unwatched" in " ".join(refused.split())
