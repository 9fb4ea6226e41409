"""pytest's plugin in projects of its users: each run is a process of its own, as theirs are."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from places import ROOT

pytest_plugins = "pytester"
pytestmark = [pytest.mark.real_time, pytest.mark.patient]

ENVIRONMENT = {name: os.environ.get(name) for name in ("HOME", "PYTEST_ADDOPTS")}
HEAD = """
import can, canopen, os, pytest

@pytest.fixture
def network(can_bus):
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.02
    network.connect(interface="coulombus", channel=can_bus.channel)
    yield network
    network.disconnect()
"""


@pytest.fixture
def project(pytester, private_sockets, short_path, monkeypatch):
    """A folder with a drive's EDS; the compiled kernels are those of the other tests."""
    for name, value in ENVIRONMENT.items():  # pytester has changed them
        if value is not None:
            monkeypatch.setenv(name, value)
    pytester.path.joinpath("drive.eds").write_bytes((ROOT / "examples/ci/drive.eds").read_bytes())

    def run(tests, *options):
        pytester.makepyfile(HEAD + tests)
        result = pytester.runpytest_subprocess("-p", "no:cacheprovider", *options, timeout=500)
        folder = short_path / "coulombus"
        assert not folder.exists() or not list(folder.iterdir()), "a socket is left"
        assert not children(str(short_path)), "a process is left"
        return result

    return run


def children(mark):
    """Processes whose environment has the folder of this test's sockets."""
    pids = []
    for name in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/environ", "rb") as file:
                if mark.encode() in file.read():
                    pids.append(int(name))
        except OSError:
            pass
    return [pid for pid in pids if pid != os.getpid()]


@pytest.mark.thorough
def test_two_tests_with_a_drive_pass_and_leave_nothing(project):
    result = project(
        """
def test_heartbeat(network, canopen_node, can_bus):
    drive = canopen_node("drive.eds", node_id=5, kind="drive")
    network.add_node(5, "drive.eds").sdo[0x1017].raw = 10
    network.nmt.state = "OPERATIONAL"
    can_bus.log.assert_before("SDO write of 1017h", "NMT start")
    can_bus.log.assert_said("NMT start", "heartbeat operational node 5")
    assert drive["1017"] == drive["Producer heartbeat time"] == 10
    with pytest.raises(KeyError, match="9999"):
        drive["9999"]

def test_another_bus(network, canopen_node, can_bus):
    assert not can_bus.log.lines()
    drive = canopen_node("drive.eds", node_id=5, kind="drive")
    drive["60FF"] = -7
    node = network.add_node(5, "drive.eds")
    assert node.sdo[0x60FF].raw == -7
    with pytest.raises(ValueError, match="taken"):
        canopen_node("drive.eds", node_id=5)
    with pytest.raises(ValueError, match="drive"):
        canopen_node("drive.eds", node_id=6, kind="motor")
    drive.power_off()
    drive.power_on()
    can_bus.log.assert_said(*["heartbeat boot-up node 5"] * 2)
"""
    )
    result.assert_outcomes(passed=2)


def test_a_failure_has_the_decoded_log_and_the_others_run_on(project):
    result = project(
        """
def test_fails(network, canopen_node, can_bus):
    canopen_node("drive.eds", node_id=5, kind="drive")
    network.nmt.state = "OPERATIONAL"
    can_bus.log.assert_said("NMT start", "NMT stop")

def test_passes(can_bus):
    pass

@pytest.fixture
def broken(can_bus, canopen_node):
    canopen_node("drive.eds", node_id=7)
    raise OSError("no interface")

def test_error(broken):
    pass

def test_virtual(virtual_network):
    virtual_network.add("drive.eds", 9)
    virtual_network.power_on()
    virtual_network.wait_ns(1_000_000)
    virtual_network.log.assert_said("NMT start")
"""
    )
    result.assert_outcomes(failed=2, passed=1, errors=1)
    result.stdout.fnmatch_lines(
        [
            "*ERROR at setup of test_error*",
            "*CAN bus coulombus:test-*",
            "*707  7 *heartbeat *state=boot-up",
            "*AssertionError: 'NMT stop' was not on the bus after 'NMT start'",
            "*CAN bus coulombus:test-*",
            "*705  5 *heartbeat *state=boot-up",
            "*000  all *nmt *command=start",
            "*CAN bus in virtual time*",
            "*709  9 *heartbeat *state=boot-up",
        ]
    )
    assert result.stdout.str().count("CAN bus ") == 3


@pytest.mark.thorough
def test_faults_and_a_rig(project):
    result = project(
        """
DROP = '[[fault]]\\nkind = "drop"\\non = "1st SDO RESPONSE of node {}"'

def test_lost(network, canopen_node, can_bus, faults):
    canopen_node("drive.eds", node_id=5)
    faults(DROP.format(5))
    sdo = network.add_node(5, "drive.eds").sdo
    sdo.RESPONSE_TIMEOUT, sdo.MAX_RETRIES = 0.2, 20
    assert sdo[0x1017].raw == 0
    assert len(can_bus.log.said("SDO read 1017h")) >= 2
    assert len(can_bus.log.said("fault drop")) == 1
    with pytest.raises(RuntimeError, match="has faults already"):
        faults(DROP.format(5))

def test_wrong_fault(can_bus, faults):
    with pytest.raises(ValueError, match="faults:4: .*no node 'motor'"):
        faults(DROP.format(5) + '\\nlost_for = "motor"')
    with pytest.raises(ValueError, match="no rig whose drive is enabled"):
        faults('[[fault]]\\nkind = "noise"\\nrate = 0.1\\nafter = "enabled"')

def test_rig(rig, faults):
    bus = rig("bench")
    faults('[[fault]]\\nkind = "reset"\\nnode = "brake"', bus)
    bus.log.assert_said("heartbeat boot-up node 1", "heartbeat boot-up node 2", "heartbeat boot-up node 2")
    with can.Bus(interface="coulombus", channel=bus.channel) as other:
        other.send(can.Message(arbitration_id=0, data=(1, 0), is_extended_id=False))
        bus.log.assert_said("NMT start")
"""
    )
    result.assert_outcomes(passed=3)


@pytest.mark.thorough
def test_an_interrupt_leaves_nothing(project):
    result = project(
        """
def test_interrupted(network, canopen_node):
    canopen_node("drive.eds", node_id=5)
    raise KeyboardInterrupt
"""
    )
    assert result.ret == pytest.ExitCode.INTERRUPTED


@pytest.mark.thorough
def test_several_workers_have_buses_of_their_own(project):
    pytest.importorskip("xdist")
    result = project(
        """
@pytest.mark.parametrize("n", range(6))
def test_alone(network, canopen_node, can_bus, n):
    assert str(os.getpid()) in can_bus.channel
    canopen_node("drive.eds", node_id=5)
    assert len(can_bus.log.said("heartbeat boot-up")) == 1
""",
        "-n2",
    )
    result.assert_outcomes(passed=6)


@pytest.mark.thorough
def test_the_socket_of_a_killed_process_is_removed(project, short_path):
    folder = short_path / "coulombus"
    folder.mkdir(mode=0o700)
    for name in ("test-1-00000000", "bench"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stale:
            stale.bind(str(folder / name))
    (folder / "bench").rename(short_path / "bench")
    project("def test_one(can_bus): pass").assert_outcomes(passed=1)


@pytest.mark.thorough
def test_without_linux_virtual_time_works_and_a_live_bus_is_an_error(tmp_path):
    (tmp_path / "test_both.py").write_text(
        "def test_virtual(virtual_network): virtual_network.wait_ns(1)\ndef test_live(can_bus): pass\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT / 'tests/support')!r}); import pytest, elsewhere; elsewhere.hide(); "
    )
    code += "pytest.main(['-p', 'no:cacheprovider', '-p', 'no:faulthandler'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=500, cwd=tmp_path)
    assert "1 passed, 1 error" in done.stdout, done.stdout + done.stderr
    assert "NeedsLinux: this needs Linux" in done.stdout


def test_projects_without_a_bus_do_not_load_it(tmp_path):
    code = "import sys, pytest; pytest.main(['--version']); sys.exit(bool({'numba', 'canopen'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60, cwd=tmp_path)
