"""``simulate --like``: the run of a recording, repeated to the byte; code is named again, never taken from it."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

import coulombus
from coulombus.cli.main import main
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.run.run import OUTSIDE, RUN, Code, NotRepeatable, Outputs, Run, recorded_run
from coulombus.host.run.run_recording import begin_recording
from coulombus.host.world.model_parts import Wall
from coulombus.lab.simulate import simulate, virtual_run
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import load_rig
from coulombus.rigs.rig_file import packaged_rig

FAULTS = (
    '[[fault]]\nkind = "flip"\non = "every 40th TPDO1 of node 1"\nbit = 30\n[[fault]]\nkind = "noise"\nrate = 1e-5\n'
)
SCRIPT = '[[at]]\nt_s = 0.25\nnode = "brake"\naction = "power_off"\nafter = "enabled"\n'
LAW = "def mine(motion, law, state):\n    state.brake_Nm = law.F_d\n    return 0.5 * motion.v_rad_s\n"


def call(*words, status=0):
    done = CliRunner().invoke(main, list(map(str, words)))
    assert done.exit_code == status, done.output
    return " ".join(done.output.split())


def wall(state):
    """Return a wall: the world of a run."""
    return Wall(0.0, 2.0)


def press(world):
    """Script of a run."""
    world.at(200_000_000, lambda _: None)


def rewritten(path, place, **changes):
    """Write the recording's attachments to `place`, those of `changes` instead."""
    attachments = {**read_pcapng(path).attachments, **changes}
    with PcapngWriter(place, attachments={k: v for k, v in attachments.items() if v is not None}):
        return place


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The recording of a short run."""
    path = tmp_path_factory.mktemp("plain") / "run.pcapng"
    simulate("bench", "active", 0.1, record=path, seed=3)
    return path


def test_a_run_with_everything_is_repeated_when_its_files_are_gone(tmp_path):
    place = tmp_path / "mine"
    place.mkdir()
    shutil.copy(packaged_rig("bench"), place / "rig.toml")
    files = {"faults": FAULTS, "script": SCRIPT}
    for name, text in files.items():
        (place / f"{name}.toml").write_text(text)
    first, again = tmp_path / "first.pcapng", tmp_path / "again.pcapng"
    words = [word for name in files for word in (f"--{name}", place / f"{name}.toml")]
    words += ["--set", 'world.rest="law"', "--set", "mode.passive.F_s_Nm=2.0", "--record", first]
    call("simulate", "--rig", place / "rig.toml", "--mode", "passive", "--seed", 5, "--seconds", 0.4, *words, status=7)
    shutil.rmtree(place)
    call("simulate", "--like", first, "--record", again, status=7)
    assert first.read_bytes() == again.read_bytes()
    assert any("flip" in text for _, text in read_pcapng(again).comments)


def test_the_place_of_a_run_and_of_its_files_is_not_in_its_recording(tmp_path):
    recordings = []
    for name in ("here", "there"):
        place = tmp_path / name
        place.mkdir()
        (place / "faults.toml").write_text(FAULTS)
        recordings.append(place / f"{name}.pcapng")
        simulate("bench", "hybrid", 0.05, faults=place / "faults.toml", record=recordings[-1])
    assert recordings[0].read_bytes() == recordings[1].read_bytes()


def test_each_bus_of_a_rig_repeats_the_whole_run(tmp_path):
    buses = ('axis.left.bus.channel="a"', 'axis.right.bus.channel="b"')
    (tmp_path / "faults.toml").write_text('[[fault]]\nkind = "stuck_dominant"\nat_s = 0.4\nbus = "b"\n')
    script = '[[at]]\nt_s = 0.05\nnode = "right.brake"\naction = "power_off"\nafter = "enabled"\n'
    (tmp_path / "script.toml").write_text(script)
    given = {name: tmp_path / f"{name}.toml" for name in ("faults", "script")}
    assert simulate("two_axes", "hybrid", 0.5, record=tmp_path / "one.pcapng", overrides=buses, **given).trip
    call("simulate", "--like", tmp_path / "one.a.pcapng", "--record", tmp_path / "two.pcapng", status=7)
    for channel in "ab":
        one, two = (tmp_path / f"{name}.{channel}.pcapng" for name in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()


def test_a_true_rig_that_differs_from_the_hosts_is_kept(tmp_path):
    rig = load_rig("bench")
    run = Run(rig, "active", 0.2, 2, simulated=rig.variant("plant.coulomb_Nm=0.3"))
    paths = [tmp_path / name for name in ("one.pcapng", "two.pcapng", "other.pcapng")]
    virtual_run(Run(rig, "active", 0.2, 2, simulated=run.simulated, outputs=Outputs(record=paths[0])))
    assert coulombus.repeat(paths[0], record=paths[1]).recording == str(paths[1])
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert recorded_run(paths[1]).simulated == run.simulated != rig


@pytest.mark.thorough
@pytest.mark.parametrize("named", ["mine.py:mine", "mine.py", "there/mine.py:mine", "moved.py:mine"])
def test_a_laws_file_is_named_again(tmp_path, monkeypatch, named):
    monkeypatch.chdir(tmp_path)
    Path("there").mkdir()
    for name in ("mine.py", "there/mine.py", "moved.py"):
        Path(name).write_text(LAW)
    simulate("bench", "active", 0.1, record="one.pcapng", overrides=('law.function="mine.py:mine"',))
    assert "name it again: --law FILE.py:FUNCTION" in call("simulate", "--like", "one.pcapng", status=2)
    if named != "mine.py:mine":
        Path("mine.py").unlink(missing_ok=named == "mine.py")
    if named == "mine.py":
        Path("mine.py").write_text(LAW)
    call("simulate", "--like", "one.pcapng", "--law", named, "--record", "two.pcapng")
    one, two = (read_pcapng(f"{name}.pcapng") for name in ("one", "two"))
    assert (one.frames == two.frames).all()
    assert (Path("one.pcapng").read_bytes() == Path("two.pcapng").read_bytes()) is (named != "moved.py:mine")


def test_a_law_with_another_checksum_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(LAW)
    simulate("bench", "active", 0.05, record="one.pcapng", overrides=('law.function="mine.py:mine"',))
    Path("mine.py").write_text(LAW.replace("0.5", "0.6"))
    text = call("simulate", "--like", "one.pcapng", "--law", "mine.py:mine", "--record", "two.pcapng", status=2)
    assert "whose mine.py has another checksum" in text
    assert "it cannot be read" in call("simulate", "--like", "one.pcapng", "--law", "none.py:mine", status=2)
    assert not Path("two.pcapng").exists()


def test_a_built_in_law_cannot_be_replaced(plain):
    assert "its run has the law karnopp" in call("simulate", "--like", plain, "--law", "lugre", status=2)


def test_functions_of_a_run_are_named_again_and_compared(tmp_path):
    one, two = tmp_path / "one.pcapng", tmp_path / "two.pcapng"
    simulate("bench", "active", 0.4, record=one, world=wall, world_every=2, script=press)
    assert "a program: it is not taken from a recording" in call("simulate", "--like", one, status=2)
    with pytest.raises(NotRepeatable, match="name it again in Python"):
        coulombus.repeat(one, world=wall)
    with pytest.raises(NotRepeatable, match="its file is not that of the run"):
        coulombus.repeat(one, world=wall, script=shutil.rmtree)
    coulombus.repeat(one, record=two, world=wall, script=press)
    assert one.read_bytes() == two.read_bytes()
    assert json.loads(read_pcapng(two).attachments[RUN])["world_every"] == 2


def test_a_function_that_the_run_did_not_have_is_refused(plain):
    with pytest.raises(NotRepeatable, match="no world in Python"):
        coulombus.repeat(plain, world=wall)


@pytest.mark.parametrize(
    "option",
    ["--rig bench", "--set bus.period_s=0.001", "--mode active", "--seed 3", "--faults f.toml", "--script s.toml"],
)
def test_an_option_that_describes_a_run_is_refused_beside_like(plain, option):
    text = call("simulate", "--like", plain, *option.split(), status=2)
    assert f"{option.split()[0]}: --like repeats the run of a recording as it was" in text


def test_the_environments_rig_does_not_matter(plain, tmp_path, monkeypatch):
    monkeypatch.setenv("COULOMBUS_RIG", "paper")
    call("simulate", "--like", plain, "--record", tmp_path / "again.pcapng", "--json")
    assert plain.read_bytes() == (tmp_path / "again.pcapng").read_bytes()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "no run is attached"),
        (b"{", f"its attachment {RUN}: it:"),
        (b'{"virtual": true, "mode": "active", "seconds": 1.0, "later": 1}', "later: Extra inputs"),
        (b'{"virtual": true, "mode": "active", "seconds": -1.0}', "seconds: Input should be greater than 0"),
        (b'{"virtual": true, "mode": "turbo", "seconds": 1.0}', "mode 'turbo': the rig has"),
        (b'{"virtual": true, "mode": "active", "seconds": "1"}', "seconds: Input should be a valid number"),
        (b'{"virtual": true, "mode": "active", "seconds": 1.0, "world": {"code": "f"}}', "its checksum is not known"),
    ],
)
def test_a_recording_without_a_whole_run_is_refused(plain, tmp_path, content, text):
    place = rewritten(plain, tmp_path / "other.pcapng", **{RUN: content})
    assert text in call("simulate", "--like", place, status=2)


def test_a_run_that_lasted_until_it_was_stopped_needs_a_length(plain, tmp_path):
    content = b'{"virtual": false, "mode": "hybrid", "seconds": null}'
    place = rewritten(plain, tmp_path / "other.pcapng", **{RUN: content})
    assert "give --seconds" in call("simulate", "--like", place, status=2)
    call("simulate", "--like", place, "--seconds", 0.05, "--record", tmp_path / "again.pcapng")
    assert json.loads(read_pcapng(tmp_path / "again.pcapng").attachments[RUN])["seconds"] == 0.05
    assert "its run lasted 0.1 s" in call("simulate", "--like", plain, "--seconds", 0.2, status=2)


def test_a_run_in_real_time_is_attached_and_another_program_is_not_repeated(tmp_path):
    rig, path = load_rig("bench"), tmp_path / "real.pcapng"
    run = Run(rig, "hybrid", None, world=OUTSIDE, outputs=Outputs(record=path), virtual=False)
    begin_recording(run, Controllers(rig, "hybrid"), time.monotonic_ns()).close()
    expected = {"virtual": False, "mode": "hybrid", "seconds": None, "world": {"code": "another program"}}
    assert json.loads(read_pcapng(path).attachments[RUN]) == expected
    assert "another program, a program" in call("simulate", "--like", path, "--seconds", 1, status=2)


def test_a_run_is_not_recorded_over_its_own_recording(plain, tmp_path):
    own, link, folder = tmp_path / "own.pcapng", tmp_path / "link.pcapng", tmp_path / "segments"
    shutil.copy(plain, own)
    link.symlink_to(own)
    folder.mkdir()
    shutil.copy(plain, folder / "000001.pcapng")
    for like, option, place in (
        (own, "--record", own),
        (own, "--record", link),
        (own, "--truth", own),
        (folder, "--record", folder / "000001.pcapng"),
        (folder, "--record", folder / "new.pcapng"),
    ):
        text = call("simulate", "--like", like, option, place, "--overwrite", status=2)
        assert "that is the recording itself" in text
    with pytest.raises(NotRepeatable, match="choose another name"):
        coulombus.repeat(own, record=own, force=True)
    assert own.read_bytes() == plain.read_bytes()
    assert sorted(path.name for path in folder.iterdir()) == ["000001.pcapng"]


def test_a_rigs_file_of_another_bus_is_not_overwritten_either(tmp_path):
    buses = ('axis.left.bus.channel="a"', 'axis.right.bus.channel="b"')
    simulate("two_axes", "hybrid", 0.05, record=tmp_path / "one.pcapng", overrides=buses)
    with pytest.raises(NotRepeatable, match=r"one\.a\.pcapng: that is the recording itself"):
        coulombus.repeat(tmp_path / "one.a.pcapng", record=tmp_path / "one.pcapng", force=True)


class Pressed:
    """A script that is an object."""

    def __call__(self, world):
        press(world)


@pytest.mark.parametrize("function", [press, partial(press), Pressed(), Pressed().__call__, lambda world: press(world)])
def test_the_checksum_of_code_is_that_of_its_file(function):
    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    assert Code.from_function(function, "script", "").sha256 == own
    assert Code.from_function([].append, "script", "").sha256 is None


def test_a_run_is_checked_where_it_is_made():
    rig = load_rig("bench")
    for error, values in (
        (ValueError, ("turbo", 1.0)),
        (ValueError, ("active", 0.0)),
        (ValueError, ("active", None)),
        (WrongCall, ("active", "1.0")),
        (WrongCall, ("active", 1.0, 0.5)),
    ):
        with pytest.raises(error):
            Run(rig, *values)
    with pytest.raises(WrongCall, match="expected 1 or more"):
        Run(rig, "active", 1.0, world_every=0)
    assert Run(rig, "active", None, virtual=False).seconds is None
