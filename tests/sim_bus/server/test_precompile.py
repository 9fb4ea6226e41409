"""What a server did for a world that nobody looked at is loaded: nothing waits for it later."""

from __future__ import annotations

import subprocess
import sys

import pytest

from coulombus.kernels.decorator import JIT_DISABLED
from places import ROOT

pytestmark = pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")

BEGIN = """
import gc
import sys
from pathlib import Path

from coulombus.eds.cia301 import NmtCommand
from coulombus.eds.cia305 import LssService
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import read_faults
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.event_loop import Exit
from coulombus.sim_bus.server.precompile import warm_up
from coulombus.sim_bus.server.live_nodes import LiveNodes
from coulombus.sim_bus.server.rig_server import PacedRig
from coulombus.wire.frame import data_word

before = set()

def kernels():
    # what is compiled, or loaded: functions with their types
    ours = (one for one in gc.get_objects() if type(one).__name__ == "CPUDispatcher" and one.py_func.__module__.startswith("coulombus"))
    return {f"{one.py_func.__module__}.{one.py_func.__qualname__}{types}"[:200] for one in ours for types in one.signatures}

def listen():
    before.update(kernels())

def say(device, can_id, *content):
    device.service(0, can_id, 8, data_word(bytes(content).ljust(8, b"\\0")), world.out)

def number(device, node_id):
    say(device, 0x7E5, LssService.FASTSCAN, 0, 0, 0, 0, 128, 0, 0)
    say(device, 0x7E5, LssService.IDENTIFY_NON_CONFIGURED)
    say(device, 0x7E5, LssService.SWITCH_STATE_GLOBAL, 1)
    for service in (*LssService, LssService.CONFIGURE_NODE_ID, LssService.STORE_CONFIGURATION):
        if service != LssService.SWITCH_STATE_GLOBAL:
            say(device, 0x7E5, service, node_id)
    say(device, 0x7E5, LssService.SWITCH_STATE_GLOBAL, 0)
    assert device.node_id == node_id

def transfer(device):
    rx = 0x600 + device.node_id
    for index in (0x1000, 0x1005, 0x1008, 0x1016, 0x1400, 0x1600, 0x1800, 0x1A00, 0x2002, 0x6041, 0x6064, 0x7130):
        for sub in (0, 1):
            for command in (0x40, 0x23, 0x2B, 0x2F, 0x60, 0x80):
                say(device, rx, command, index & 0xFF, index >> 8, sub, 1)
    for request in ((0xA0, 8, 0x10, 0, 127), (0xA3,), (0xA2, 127, 127), (0xA1,)):  # a block upload of 1008h
        say(device, rx, *request)

def command(row):
    for one in (NmtCommand.START, NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
        world.nmt_command(row, one)
"""
RIG = """
rig = load_rig("bench")
warm_up(PacedRig(rig, "hybrid", 0, 1000000))
world = PacedRig(rig, "hybrid", 0, 1000000, None, False)
listen()
world.power_on()
for row, device in enumerate(world.devices):
    number(device, 10 + row)
    transfer(device)
    command(row)
    world.inject(row, "supply_low", True)
    world.power_off(row)
    world.power_on(row)
world.answer(Exit.ENABLED)
world.answer(Exit.FORCE)
"""
FAULTS = """
rig = load_rig("bench")
warm_up(PacedRig(rig, "hybrid", 0, 1000000))
world = PacedRig(rig, "hybrid", 0, 1000000)
Injection(world, read_faults(Path(sys.argv[1])), 0)
world.power_on()
world.wait_ns(1_000_000)
listen()
world.wait_ns(150_000_000)
assert [one["times"] for one in world.injection.results()] == [1, 1, 1]
"""
NODE = """
nodes = LiveNodes([(Path("eds/motor.eds"), int(sys.argv[1]))])
warm_up(nodes.make_world(1000000, True))
world = nodes.make_world(1000000, False)
listen()
world.power_on()
device, = world.devices
if device.node_id == 255:
    number(device, 5)
transfer(device)
command(0)
"""


def loaded(course: str, *arguments: str) -> str:
    """Return the kernels that a course loads after the trial."""
    text = BEGIN + course + "print(*sorted(kernels() - before), sep='\\n', end='')"
    done = subprocess.run(
        [sys.executable, "-c", text, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=900
    )
    assert done.stderr == ""
    return done.stdout


def test_after_the_trial_no_service_and_no_schedule_loads_a_kernel():
    assert loaded(RIG) == ""


@pytest.mark.thorough
@pytest.mark.parametrize(
    "node_id", [pytest.param("5", marks=pytest.mark.long), "255"], ids=["numbered", "for an LSS master"]
)
def test_after_the_trial_a_live_node_loads_no_kernel(node_id):
    assert loaded(NODE, node_id) == ""


def test_after_the_trial_no_fault_of_a_file_loads_a_kernel(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text(
        "\n".join(
            (
                '[[fault]]\nkind = "cut"\nat_s = 0.05\nduration_s = 0.05\nhalves = [["motor", "host"], ["brake"]]',
                '[[fault]]\nkind = "drift"\nnode = "motor"\nppm = 20\nat_s = 0.01\nduration_s = 0.02',
                '[[fault]]\nkind = "reset"\nnode = "motor"\nat_s = 0.02',
            )
        )
    )
    assert loaded(FAULTS, str(path)) == ""
