"""Where EMCYs come: the host listens where 1014h of the EDS file says, and tells of a device that has none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import coulombus.eds
import coulombus.rigs
from coulombus.cli.main import main
from coulombus.eds.check import check
from coulombus.eds.reader import read_eds
from coulombus.lab.simulate import simulate
from coulombus.rigs.device_services import emcy_identifier, is_mute
from coulombus.sim_bus.network.event_loop import BRAKE

MS = 1_000_000
EDS, RIGS = (Path(next(iter(package.__path__))) for package in (coulombus.eds, coulombus.rigs))
OBJECT = (
    "[1014]\nParameterName=COB-ID EMCY\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\nDefaultValue=$NODEID+0x80\n"
)
KINDS = {
    "usual": ("rw", "$NODEID+0x80", 0x82, False),
    "elsewhere": ("rw", "$NODEID+0xA0", 0xA2, False),
    "elsewhere, read-only": ("ro", "$NODEID+0xA0", 0xA2, False),
    "off": ("rw", "0x80000082", 0x82, False),
    "off, read-only": ("ro", "0x80000082", 0x82, True),
    "off, constant": ("const", "0", 0x82, True),
    "that of SYNC": ("rw", "0x80", 0x82, False),
    "a reserved one": ("rw", "0x701", 0x82, False),
    "of 29 bits": ("rw", "0x20000082", 0x82, False),
    "no default": ("rw", "", 0x82, False),
}
"""Access, default, the identifier that the host wants, and whether there is none to be had."""


def brake_file(folder, kind):
    text = (EDS / "mr_brake.eds").read_text()
    assert text.count(OBJECT) == 1
    if kind == "absent":
        text = text.replace(OBJECT + "PDOMapping=0\n", "").replace("13=0x1014\n", "13=0x1015\n", 1)
    else:
        access, default = KINDS[kind][:2]
        changed = OBJECT.replace("AccessType=rw", f"AccessType={access}").replace("$NODEID+0x80", default)
        text = text.replace(OBJECT, changed)
    path = folder / "brake.eds"
    path.write_text(text)
    return path


@pytest.fixture
def rig(tmp_path):
    """Write bench.toml beside a brake's file of a kind, without a handle torque; return its path."""

    def written(kind):
        brake_file(tmp_path, kind)
        text = (RIGS / "bench.toml").read_text().replace('eds = "mr_brake.eds"', 'eds = "brake.eds"')
        path = tmp_path / "rig.toml"
        path.write_text(f'{text}\n[role.handle_torque]\nobject = "none"\n')
        return str(path)

    return written


@pytest.mark.parametrize("kind", KINDS)
def test_the_identifier_is_the_files_where_it_can_be_one(tmp_path, kind):
    description = read_eds(brake_file(tmp_path, kind))
    assert (emcy_identifier(description, 2), is_mute(description, 2)) == KINDS[kind][2:]


def shorted(world):
    """Short the brake's coil 2.5 s after the drive was enabled."""
    if world.enabled_ns is None:
        world.at(world.t_ns + MS, shorted)
    else:
        world.at(world.enabled_ns + 2500 * MS, lambda world: world.inject(BRAKE, "coil_short", True))


@pytest.mark.parametrize("kind", ["usual", "elsewhere", "elsewhere, read-only", "off", "off, read-only"])
def test_a_shorted_coil_trips_wherever_it_is_told(rig, kind):
    result = simulate(rig(kind), "hybrid", 3.0, script=lambda world: world.at(MS, shorted))
    if KINDS[kind][3]:  # it tells nothing, and nothing else notices in this rig
        assert (result.exit_status, result.trip) == (0, None)
        assert any("reports no fault to the host by EMCY" in text for text in result.losses)
    else:
        assert result.exit_status == 7
        assert result.trip.startswith("EMCY_BRAKE")
        assert result.trip.endswith("(error code 2320h)")


@pytest.mark.parametrize(
    ("kind", "status", "told"),
    [
        ("off", 0, "its EMCY is switched off in 1014h (bit 31); bring-up switches it on"),
        ("off, read-only", 0, "it reports no fault to the host by EMCY"),
        ("usual", 0, None),
        ("elsewhere", 0, None),
    ],
)
def test_check_names_a_device_whose_emcy_is_off(rig, kind, status, told):
    done = CliRunner().invoke(main, ["check", "--rig", rig(kind), "--json"])
    losses = [text for text in json.loads(done.stdout)["losses"] if "EMCY" in text]
    assert done.exit_code == status
    assert [told in text for text in losses] == [True] if told else losses == []


def test_an_emcy_that_comes_as_sync_for_ever_is_refused(rig, tmp_path):
    path = rig("that of SYNC")
    eds = tmp_path / "brake.eds"
    eds.write_text(eds.read_text().replace("AccessType=rw\nDefaultValue=0x80\n", "AccessType=ro\nDefaultValue=0x80\n"))
    done = CliRunner().invoke(main, ["check", "--rig", path, "--json"])
    problems = [one["text"] for one in json.loads(done.stdout)["problems"]]
    assert done.exit_code == 1
    assert len(problems) == 1
    assert "1014h:00 is 80h, the identifier of SYNC, and read-only" in problems[0]


@pytest.mark.parametrize(
    ("kind", "told"), [("that of SYNC", "the identifier of SYNC"), ("off", "bit 31 switches EMCY off")]
)
def test_eds_check_tells_of_it(tmp_path, kind, told):
    report = check(read_eds(brake_file(tmp_path, kind)), 2)
    assert [told in str(one) for one in report.diagnoses if "1014h" in str(one)] == [True]
