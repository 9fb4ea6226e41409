"""The device of CHAI3D: it compiles against a stub of the interface, and turns forces into walls."""

import shutil
import subprocess

import pytest

from places import ROOT
from world_bench import Bench

COMPILER = shutil.which("g++")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler `g++` here")
# What the example uses of CHAI3D 3.2: names and signatures alone.
STUB = """
#include <string>
namespace chai3d {
class cVector3d {
public:
    cVector3d(double x = 0, double y = 0, double z = 0) { set(x, y, z); }
    void set(double x, double y, double z) { at[0] = x; at[1] = y; at[2] = z; }
    double y() const { return at[1]; }
private:
    double at[3];
};
enum cHapticDeviceModel { C_HAPTIC_DEVICE_VIRTUAL, C_HAPTIC_DEVICE_CUSTOM };
struct cHapticDeviceInfo {
    cHapticDeviceModel m_model;
    std::string m_modelName, m_manufacturerName;
    double m_maxLinearStiffness, m_workspaceRadius;
    bool m_sensedPosition, m_sensedRotation, m_sensedGripper;
    bool m_actuatedPosition, m_actuatedRotation, m_actuatedGripper, m_leftHand, m_rightHand;
};
class cGenericHapticDevice {
public:
    virtual ~cGenericHapticDevice() {}
    virtual bool open() { return false; }
    virtual bool close() { return false; }
    virtual bool calibrate(bool = false) { return false; }
    virtual bool getPosition(cVector3d &) { return false; }
    virtual bool getLinearVelocity(cVector3d &) { return false; }
    virtual bool setForceAndTorqueAndGripperForce(const cVector3d &, const cVector3d &, const double) { return false; }
    bool setForce(const cVector3d &force) { return setForceAndTorqueAndGripperForce(force, cVector3d(), 0.0); }
    cHapticDeviceInfo m_specifications;
protected:
    cVector3d m_prevForce, m_prevTorque;
    double m_prevGripperForce;
    bool m_deviceAvailable, m_deviceReady;
};
}
"""
# An object with 200 N/m beyond (sign 1) or before (sign -1) y = 0.225 m.
PROGRAM = """
#include "chai3d_device.h"
int main(int, char **words) {
    const double sign = atof(words[1]);
    cCoulombusDevice display("x", 0.1, 200.0);
    chai3d::cGenericHapticDevice &device = display;
    chai3d::cVector3d position, velocity;
    if (!device.open()) return 1;
    while (device.getPosition(position)) {
        const double depth = sign * (position.y() - 0.225);
        device.setForce(chai3d::cVector3d(7.0, depth > 0.0 ? -sign * 200.0 * depth : 0.0, 7.0));
    }
    device.getLinearVelocity(velocity);
    printf("%g %g %d\\n", position.y(), velocity.y(), device.m_specifications.m_actuatedPosition);
    return device.open() ? 1 : 0;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chai3d")
    (folder / "chai3d.h").write_text(STUB)
    (folder / "program.cpp").write_text(PROGRAM)
    options = "-std=c++17", "-Wall", "-Wextra", "-Werror", f"-I{folder}", f"-I{ROOT / 'examples/worlds'}"
    subprocess.run([COMPILER, *options, "-o", folder / "program", folder / "program.cpp"], check=True, timeout=120)
    return folder / "program"


@pytest.mark.usefixtures("private_sockets")
@pytest.mark.parametrize("sign", [1, -1])
def test_a_force_becomes_the_wall_that_exerts_it(program, sign):
    with Bench() as bench:
        process = subprocess.Popen([program, str(sign)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        bench.until(lambda: bench.server.readers == 1)
        for count in range(1, 9):
            bench.cycle()
            bench.until(lambda count=count: len(bench.display.models) == count)
        bench.server.close()
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert out.splitlines() == ["0 0 1"]
    models = bench.display.models[::sign]
    assert [int(model["parts"]) for model in models] == [0] * 4 + [1] * 4
    for model in models[4:]:
        assert (model["wall_x_rad"], model["wall_K_Nm_rad"]) == pytest.approx((2.25, 2.0))
        assert (model["wall_side"], model["law"]) == (sign, 0.0)


@pytest.mark.usefixtures("private_sockets")
def test_the_device_does_not_open_without_a_host(program):
    result = subprocess.run([program, "1"], capture_output=True, text=True, timeout=60)
    assert (result.returncode, result.stderr) == (1, "x: No such file or directory\n")
