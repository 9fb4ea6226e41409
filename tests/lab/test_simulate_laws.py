"""Laws with named parameters on the virtual rig: they hold, they are replayed, and what is wrong of
them trips.
"""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.lab.replay.host_replay import host_replay
from coulombus.lab.replay.virtual_replay import virtual_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig

pytestmark = pytest.mark.slow

STRONG = ("law.lugre.F_c_Nm=3.0", "law.lugre.F_s_Nm=3.5")


@pytest.mark.thorough
def test_lugre_holds_on_the_brake_and_is_replayed_bit_for_bit(tmp_path):
    path = tmp_path / "lugre.pcapng"
    overrides = (arg for text in STRONG for arg in ("--set", text))
    words = (
        "simulate",
        "--law",
        "lugre",
        "--mode",
        "hybrid",
        "--seconds",
        "4",
        "--record",
        str(path),
        "--json",
        *overrides,
    )
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1]) if done.stdout.startswith('{"') else json.loads(done.stdout)
    assert told["trip"] is None
    assert told["hold_velocity_rms_rad_s"] <= 0.005
    assert read(path).rig.one_axis().law.tables == {"lugre": {"F_c_Nm": 3.0, "F_s_Nm": 3.5}}
    assert host_replay(path).difference is None
    assert virtual_replay(path).identical
    other = host_replay(path, ["law.lugre.F_s_Nm=3.1"])
    assert other.rms is not None
    assert other.rms["brake.setpoint_Nm"] > 0.01


def test_lugre_is_quieter_than_karnopp_on_the_motor():
    """The limit cycle that Karnopp's law has with this hand does not come; taps let it creep."""
    karnopp, lugre = (
        simulate("bench", "active", 4.0, measured=True, overrides=(f"law.function={name}",))
        for name in ("karnopp", "lugre")
    )
    assert karnopp.trip is None
    assert lugre.trip is None
    assert lugre.torque_flips_per_s < 0.1 * karnopp.torque_flips_per_s
    assert lugre.hold_counts_p2p < 0.2 * karnopp.hold_counts_p2p


@pytest.mark.parametrize("name", BUILTIN_LAWS)
def test_every_law_runs_on_the_rig_with_its_defaults(name):
    result = simulate("bench", "active", 0.8, overrides=(f"law.function={name}",))
    assert result.trip is None


OWN = """from coulombus.host.laws.law import Field, Parameters, friction_law

class Mine(Parameters):
    scale: float = Field(1.0, ge=0, le=10, description="scale")

@friction_law(Mine, state=["calls"])
def mine(motion, law, state):
    state.calls += 1.0
    {body}
    return law.scale
"""


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (
            "if state.calls > 100.0: return law.scale * float('nan')",
            "LAW: the friction law own.py:mine returned nan Nm",
        ),
        ("if state.calls > 100.0: state.brake_Nm = float('inf')", "returned inf Nm for the brake"),
        ("if state.calls > 100.0: raise ValueError", "LAW: the friction law own.py:mine returned nan Nm"),
    ],
)
def test_a_named_law_without_a_number_trips(body, told, tmp_path):
    (tmp_path / "own.py").write_text(OWN.replace("{body}", body))
    (tmp_path / "rig.toml").write_text(load_rig("bench").effective())
    result = simulate(tmp_path / "rig.toml", "active", 0.5, overrides=("law.function=own.py:mine",))
    assert result.trip is not None
    assert told in result.trip


def test_a_law_that_asks_for_much_is_bounded_by_the_step(tmp_path):
    path = tmp_path / "detent.pcapng"
    overrides = ("law.function=detent", "law.detent.A_Nm=1000", "mode.active.motor_limit_Nm=0.75")
    simulate("bench", "active", 1.5, record=path, overrides=overrides)
    torque = read(path)["motor.target_torque_Nm"].values
    assert 0.7 < abs(torque).max() <= 0.75
