"""What a server did for a world that nobody looked at is loaded: nothing waits for it later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from coulombus.compiled.decorator import JIT_DISABLED

ROOT = Path(__file__).resolve().parent.parent.parent
COURSE = """
from coulombus.compiled.kernel_files import KernelCache
from coulombus.eds.cia301 import NmtCommand
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.kernel import Exit
from coulombus.sim_bus.server import server
from coulombus.sim_bus.server.rig_server import PacedRig
from coulombus.wire.frame import data_word

rig = load_rig("bench")
server._warm_up(PacedRig(rig, "hybrid", 0, 1000000))
world, found = PacedRig(rig, "hybrid", 0, 1000000), []
load = KernelCache.load_overload
def told(self, signature, context):
    found.append(str(self._name if hasattr(self, "_name") else self.cache_path))
    return load(self, signature, context)
KernelCache.load_overload = told

world.power_on()
for row, device in enumerate(world.devices):
    for index in (0x1000, 0x1005, 0x1008, 0x1016, 0x1400, 0x1600, 0x1800, 0x1A00, 0x2002, 0x6041, 0x6064, 0x7130):
        for sub in (0, 1):
            for command in (0x40, 0x23, 0x2B, 0x2F, 0x60, 0x80):
                word = data_word(bytes((command, index & 0xFF, index >> 8, sub, 1, 0, 0, 0)))
                device.service(0, 0x600 + device.node_id, 8, word, world._out)
    for command in (NmtCommand.START, NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
        world.nmt_command(row, command)
world.answer(Exit.ENABLED)
world.answer(Exit.FORCE)
print(sorted(set(found)))
"""


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_after_the_trial_no_service_and_no_schedule_loads_a_kernel():
    done = subprocess.run([sys.executable, "-c", COURSE], cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.stderr == ""
    assert done.stdout == "[]\n"
