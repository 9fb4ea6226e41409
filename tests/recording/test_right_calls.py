"""A script that hands over the wrong thing is told the right call."""

import os
import re
from pathlib import Path

import pytest

from bench_recording import record
from coulombus.lab.simulate import simulate
from coulombus.monitor.callbacks import live
from coulombus.recording.comparison import compare
from coulombus.recording.export.export import export
from coulombus.recording.reading import blocks, read
from coulombus.recording.signals import series
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import RigError, load_rig
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.own_device import Device
from places import ROOT


class Place(os.PathLike):
    """A file's name that is no pathlib.Path."""

    def __init__(self, path):
        self.path_of_it = path

    def __fspath__(self):
        return str(self.path_of_it)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return record(tmp_path_factory.mktemp("run") / "run.pcapng")


@pytest.fixture(scope="module")
def recording(source):
    return read(source)


def assert_wrong_call(call, *right):
    with pytest.raises(WrongCall) as error:
        call()
    assert isinstance(error.value, TypeError)
    assert error.value.exit_status == 2
    for words in right:
        assert words in str(error.value)


@pytest.mark.parametrize("wrong", [3, None, b"run.pcapng", ["run.pcapng"]])
@pytest.mark.parametrize("call", [read, blocks])
def test_a_recording_is_named_by_its_path(call, wrong):
    assert_wrong_call(lambda: call(wrong), f"path is {wrong!r}", f'as in {call.__name__}("run.pcapng")')


@pytest.mark.parametrize("wrong", [3, {"name": "bench"}, b"bench"])
def test_a_rig_is_one_or_its_name(source, wrong):
    assert_wrong_call(lambda: read(source, wrong), f"the rig is {wrong!r}", 'load_rig("bench")')
    assert_wrong_call(lambda: load_rig(wrong), f"the rig is {wrong!r}", 'load_rig("bench")')


def test_a_rig_is_not_loaded_twice():
    assert_wrong_call(lambda: load_rig(load_rig("bench")), "the rig bench, which is loaded already")


@pytest.mark.parametrize("call", [load_rig, lambda rig, overrides: simulate(rig, overrides=overrides)])
def test_overrides_are_a_list(call):
    assert_wrong_call(
        lambda: call("bench", "limits.still_s=1.0"), "expected a list, as in overrides=['limits.still_s=1.0']"
    )
    assert_wrong_call(lambda: call("bench", ["limits.still_s=1.0", 3]), "overrides has 3 in it")


def test_overrides_of_a_loaded_rig_are_texts():
    rig = load_rig("bench")
    assert_wrong_call(lambda: simulate(rig, overrides="limits.still_s=1.0"), "overrides=['limits.still_s=1.0']")
    assert_wrong_call(lambda: rig.variant(["limits.still_s=1.0"]), "as in variant('mode.active.F_s_Nm=1.0')")


@pytest.mark.parametrize("wrong", [3, ["motor.position_rad"], slice(None), None])
def test_a_signal_is_asked_for_by_its_name(recording, wrong):
    assert_wrong_call(lambda: recording[wrong], f"recording[{wrong!r}]", "recording['motor.position_rad']")


def test_several_signals_are_asked_for_by_series(recording):
    names = ["motor.position_rad", "brake.setpoint_Nm"]
    right = "series(recording, 'motor.position_rad', 'brake.setpoint_Nm')"
    assert_wrong_call(lambda: recording[names], right)
    assert_wrong_call(lambda: series(recording, names), right)
    assert_wrong_call(lambda: series("run.pcapng", *names), "series(read('run.pcapng'), ")
    assert [len(signal) for signal in series(recording, *names)] == [400, 400]


@pytest.mark.parametrize("method", ["plot", "to_pandas", "to_xarray"])
def test_signals_are_a_list_of_names(recording, method):
    pytest.importorskip({"to_pandas": "pandas", "to_xarray": "xarray", "plot": "matplotlib"}[method])
    call = getattr(recording, method)
    assert_wrong_call(lambda: call("brake.setpoint_Nm"), "expected a list, as in signals=['brake.setpoint_Nm']")
    assert_wrong_call(lambda: call(3), "signals is 3: expected a list")
    assert_wrong_call(lambda: call(["brake.setpoint_Nm", 3]), "signals has 3 in it: expected texts alone")


def test_a_grid_is_a_number(recording):
    pytest.importorskip("pandas")
    assert_wrong_call(lambda: recording.to_pandas(grid_s="1 ms"), "grid_s is '1 ms'", "as in grid_s=0.001")


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("0.1:0.3", "span=(0.1, 0.3)"),
        (":10", "span=(None, 10.0)"),
        ("all", "span=(3.0, 5.0)"),
        (0.1, "span=(3.0, 5.0)"),
        ((1, 2, 3), "span=(3.0, 5.0)"),
        (("0.1", 0.3), "span=(3.0, 5.0)"),
    ],
)
def test_a_span_is_two_times(recording, wrong, right):
    assert_wrong_call(
        lambda: recording.plot(span=wrong), f"span is {wrong!r}", f"as in {right}; None leaves an end open"
    )


def test_a_span_may_be_a_list_of_whole_numbers(recording):
    assert recording.plot(span=[0, 1]).axes


@pytest.mark.parametrize("wrong", [0.1, "Nm=0.1", [("Nm", 0.1)]])
def test_tolerances_are_of_signals_or_units(source, wrong):
    number = wrong if isinstance(wrong, float) else 0.1
    assert_wrong_call(
        lambda: compare(source, source, tolerances=wrong), f'tolerances={{"Nm": {number}}}', f'{{"": {number}}}'
    )


def test_a_tolerance_is_a_number(source):
    assert_wrong_call(lambda: compare(source, source, tolerances={"Nm": "0.1"}), "tolerances['Nm'] is '0.1'")


def test_recordings_are_compared_by_their_paths(recording):
    assert_wrong_call(lambda: compare(recording, recording), f"this one's name is its path: {recording.path!r}")


def test_a_recording_is_exported_by_its_path(recording, tmp_path):
    assert_wrong_call(lambda: export(recording, tmp_path / "a.csv", "csv"), "path is <recording", 'export("run.pcapng"')
    assert_wrong_call(lambda: export(recording.path, 3, "csv"), "out is 3")


def test_a_bus_is_named():
    assert_wrong_call(lambda: live(3), 'live("socketcan:can0")')


def test_a_simulation_writes_files_by_their_names():
    assert_wrong_call(lambda: simulate(record=3), "record is 3")
    assert_wrong_call(lambda: simulate(truth=3), "truth is 3")
    assert_wrong_call(lambda: simulate(faults=3), "faults is 3")


def test_any_path_like_names_a_file(source, recording, tmp_path):
    rig = Place(tmp_path / "own.toml")
    (tmp_path / "own.toml").write_text(recording.rig.effective())
    by_place = read(Place(source), rig)
    assert by_place.path == str(source)
    assert len(by_place["motor.position_rad"]) == 400
    assert next(iter(blocks(Place(source), Path(rig)))).rig.name == "bench"
    assert compare(Place(source), Place(source), rig=rig).equal
    assert export(Place(source), Place(tmp_path / "a.csv"), "csv", rig=rig).path == tmp_path / "a.csv"


def test_a_path_is_a_file_also_where_its_name_is_a_rigs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bench").write_text("nothing")
    with pytest.raises(RigError, match=re.escape("bench:1")):
        load_rig(Path("bench"))


def test_the_picture_of_a_comparison_is_looked_at_before_it_is_made(source, tmp_path, monkeypatch):
    from click.testing import CliRunner

    from coulombus.cli.main import main
    from coulombus.recording import comparison

    def never(*_, **__):
        raise AssertionError("two long recordings are read")

    monkeypatch.setattr(comparison, "compare", never)
    (tmp_path / "there.png").write_text("mine")
    for out, reason in (
        (tmp_path / "there.png", "there.png exists; choose another name"),
        (tmp_path / "no" / "folder.png", "no directory"),
    ):
        result = CliRunner().invoke(main, ["diff", str(source), str(source), "-o", str(out)])
        assert result.exit_code == 2
        assert reason in result.output


def test_numbers_of_a_simulation_and_of_a_device_are_numbers():
    eds = ROOT / "eds" / "motor.eds"
    assert_wrong_call(lambda: simulate("bench", "hybrid", "1s"), "seconds is '1s'", "seconds=13.0")
    assert_wrong_call(lambda: simulate("bench", "hybrid", 1.0, seed="x"), "seed is 'x': expected an integer", "seed=7")
    assert_wrong_call(lambda: simulate("bench", "hybrid", True), "seconds is True")
    assert_wrong_call(lambda: Device(eds, "five"), "node_id is 'five': expected an integer", "node_id=5")
    assert_wrong_call(lambda: Device(3, 5), "eds is 3", "Device(")
    assert_wrong_call(lambda: VirtualNetwork("fast"), "bitrate_bit_s is 'fast'", "bitrate_bit_s=500_000")
    assert_wrong_call(lambda: VirtualNetwork().add(eds, "five"), "node_id is 'five'")
    with pytest.raises(ValueError, match="bitrate_bit_s -1; expected bit/s"):
        VirtualNetwork(-1)


@pytest.mark.parametrize("wrong", [(3,), (None,), ("brake.setpoint_Nm", 3)])
def test_a_signal_of_series_is_a_text(recording, wrong):
    right = "expected one text each, as in series(recording, 'motor.position_rad')"
    assert_wrong_call(lambda: series(recording, *wrong), right)


def test_a_recording_has_its_signals_names(recording):
    assert "motor.position_rad" in recording
    assert "motor.nothing" not in recording
    assert 3 not in recording
    assert set(recording.names) == {name for name in recording.names if recording.has(name)} > {"brake.setpoint_Nm"}


def test_a_mode_that_is_misspelt_has_a_near_name():
    with pytest.raises(ValueError, match=r"'hybird': the rig has active, passive, hybrid; did you mean 'hybrid'\?"):
        simulate("bench", "hybird", 1)


def test_a_result_prints_what_it_has_in_lines():
    lines = repr(simulate("bench", "passive", 0.1)).splitlines()
    assert lines[0] == "<run in mode passive: no trip"
    assert all(line.startswith("  ") for line in lines[1:])
    assert max(map(len, lines)) < 100
    assert not any("None" in line or "{}" in line for line in lines)
