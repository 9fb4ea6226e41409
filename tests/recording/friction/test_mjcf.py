"""What is identified as a MuJoCo model: what MuJoCo makes of it, and what comes back of its motion."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.rig.law_fit import fit_law
from coulombus.analysis.rig.law_search import Stretch
from coulombus.cli.main import main
from coulombus.host.laws.along import given_law
from coulombus.recording.friction.columns import TorqueTable
from coulombus.recording.friction.friction_fit import Fit
from coulombus.recording.friction.mjcf import friction_mjcf, lugre_mjcf
from coulombus.recording.friction.regression import Estimate
from coulombus.recording.friction.table_identify import identify_table

LUGRE = {
    "F_c_Nm": 0.12,
    "F_s_Nm": 0.2,
    "v_s_rad_s": 0.3,
    "sigma_0_Nm_rad": 150.0,
    "sigma_1_Nms_rad": 0.3,
    "sigma_2_Nms_rad": 0.02,
}
STEPS = 10
"""MuJoCo's steps of a sample."""
T = 1e-3


@pytest.fixture
def mujoco():
    return pytest.importorskip("mujoco", reason="mujoco is not installed: pip install -e '.[worlds]'")


def near(value):
    return Estimate(value, 0.99 * value, 1.01 * value)


def fit(**changes):
    figures = {"coulomb_Nm": near(0.12), "viscous_Nms_rad": near(0.01), "inertia_kg_m2": near(0.004)}
    return Fit(
        **(figures | {"offset_Nm": None, "stribeck_Nm": None, "stribeck_rad_s": None} | changes), residual_rms_Nm=0.0
    )


def comments(text):
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(text, parser)
    return [child.text for child in root if child.tag is ElementTree.Comment]


def test_a_hinge_has_coulomb_viscous_and_inertia():
    text = friction_mjcf(fit(), "strokes.csv")
    joint = ElementTree.fromstring(text).find(".//joint")
    figures = {name: float(joint.get(name)) for name in ("frictionloss", "damping", "armature")}
    assert figures == {"frictionloss": 0.12, "damping": 0.01, "armature": 0.004}
    assert comments(text)[:2] == [
        " from strokes.csv; 95 % confidence intervals: ",
        " frictionloss: 0.1200 [0.1188, 0.1212] ",
    ]


def test_what_the_data_do_not_tell_is_left_out_and_said():
    text = friction_mjcf(fit(inertia_kg_m2=None, stribeck_Nm=near(0.05), stribeck_rad_s=0.1), "a--b.csv")
    assert ElementTree.fromstring(text).find(".//joint").get("armature") is None
    notes = "\n".join(comments(text))
    assert "armature: the data do not tell it" in notes
    assert "at rest 0.05000 [0.04950, 0.05050] Nm more" in notes
    assert "a- -b.csv" in notes


def test_a_friction_below_nothing_is_none():
    text = friction_mjcf(fit(viscous_Nms_rad=Estimate(-0.001, -0.002, 0.0)), "f")
    assert ElementTree.fromstring(text).find(".//joint").get("damping") == "0"


@pytest.mark.parametrize(
    ("arguments", "mistake"),
    [
        (["--json"], "--to goes with none of --iron, --json and --figure"),
        (["--iron"], "--to goes with none"),
        (["--law", "dahl"], "MuJoCo has no law dahl: give --law lugre, or leave it out"),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path, arguments, mistake):
    path = tmp_path / "t.csv"
    path.write_text("t,angle,torque\n0,0,0\n")
    result = CliRunner().invoke(main, ["identify", str(path), "--to", "mjcf", *arguments])
    assert (result.exit_code, mistake in " ".join(result.output.split())) == (2, True)


def moved(mujoco, joint, actuator=""):
    """Return t, angle, torque of a hinge that a spring drags to and fro, sampled as a bench does."""
    xml = (
        f'<mujoco><option timestep="{T / STEPS}"/><worldbody><body><inertial pos="0 0 0" mass="1e-6" '
        f'diaginertia="1e-9 1e-9 1e-9"/><joint name="j" type="hinge" axis="0 0 1" {joint}/></body></worldbody>'
        f'<actuator><motor joint="j"/>{actuator}</actuator></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(xml)
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(1), []
    for k in range(12_000 * STEPS):
        t = k * T / STEPS
        goal = 0.3 * np.sin(2 * np.pi * 0.4 * t) * (1 + 0.5 * np.sin(0.7 * t)) + 0.05 * np.sin(2 * np.pi * 1.7 * t)
        x, v = data.qpos[0], data.qvel[0]
        torque = data.ctrl[0] = 20 * (goal - x) - 0.3 * v
        if k % STEPS == 0:
            rows.append((t, np.rint(x / 1e-5) * 1e-5, torque + 1e-3 * rng.standard_normal()))
        mujoco.mj_step(model, data)
    return np.array(rows).T


def test_mujocos_joint_comes_back_from_its_motion(mujoco):
    t, x, torque = moved(mujoco, 'frictionloss="0.12" damping="0.01" armature="0.004"')
    device = identify_table(TorqueTable("mujoco", t, x, torque, None)).identification.device
    for estimate, truth in (
        (device.coulomb_Nm, 0.12), (device.viscous_Nms_rad, 0.01), (device.inertia_kg_m2, 0.004),
    ):  # fmt: skip
        assert estimate.low <= truth <= estimate.high
    assert mujoco.MjModel.from_xml_string(friction_mjcf(device, "mujoco")).dof_frictionloss[0] == pytest.approx(
        0.12, rel=2e-3
    )


def test_mujocos_dcmotor_comes_back_from_its_motion(mujoco):
    lugre = '<dcmotor joint="j" motorconst="1e-6" resistance="1" lugre="150 0.3 0.12 0.2 0.3"/>'
    found = fit_law("lugre", [Stretch(*moved(mujoco, 'damping="0.02" armature="0.004"', lugre))], rig=None)
    for name, rel in {"F_c_Nm": 2e-3, "F_s_Nm": 2e-3, "v_s_rad_s": 5e-3, "sigma_0_Nm_rad": 5e-3}.items():
        assert found.values[name] == pytest.approx(LUGRE[name], rel=rel)
    assert found.values["sigma_1_Nms_rad"] == pytest.approx(0.3, rel=0.1)
    assert found.inertia_kg_m2 == pytest.approx(0.004, rel=0.01)


def speeds(k, n=3000):
    t = np.arange(n) * T
    return (
        0.3 * np.sin(2 * np.pi * t),
        0.02 * np.sin(2 * np.pi * 5 * t),
        np.where(t < 1, 0.001, 2.0),
        np.sin(2 * np.pi * 0.5 * t) ** 3,
        np.cumsum(np.random.default_rng(3).standard_normal(n)) * 0.01,
        np.where(np.sin(2 * np.pi * 2 * t) > 0.5, 0.2, 0.0),
    )[k]


@pytest.mark.parametrize("motion", range(6))
def test_mujocos_dcmotor_is_our_law(mujoco, motion):
    """The force at the end of each step, with the joint's damping for sigma_2."""
    text = lugre_mjcf(LUGRE, {}, 1e9, "test")  # a step hardly changes the speed of such an inertia
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = T
    data, theirs, v = mujoco.MjData(model), [], speeds(motion)
    for speed in v:
        data.qvel[0] = speed
        mujoco.mj_step(model, data)
        data.qvel[0] = speed
        mujoco.mj_forward(model, data)
        theirs.append(-data.actuator_force[0] - data.qfrc_passive[0])
    law = given_law("lugre", [f"{name}={value!r}" for name, value in LUGRE.items()])
    x = np.concatenate(([0.0], np.cumsum(v) * T))
    ours = law.along(np.arange(len(x)) * T, x).samples["torque_Nm"][1:]
    assert np.max(np.abs(ours - theirs)) < 1e-6
