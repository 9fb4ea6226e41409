"""A signal that ends a verb while it still imports, reads its rig or loads its kernels: one line and
the signal's status, whatever becomes of the exception on its way.

Each test is a process of its own, which sends itself the signal when a module is asked for.
"""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.system.stop_signals import SIGNALS
from places import ROOT

BEGIN = """
import os, runpy, sys, weakref

class Asked:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            {act}

class Thing:
    pass

def kill(*_):
    os.kill(os.getpid(), {number})

def lost():
    thing = Thing()
    there = weakref.ref(thing, kill)
    del thing
    for _ in range(1 << 40):
        pass

def other():
    try:
        kill()
    except BaseException:
        raise SystemError("initialization of a module raised an unreported exception")

def half():
    try:
        kill()
    except BaseException:
        pass
    raise AttributeError("a module that was half made")

sys.meta_path.insert(0, Asked())
sys.argv = ["coulombus", *sys.argv[1:]]
runpy.run_module("coulombus", run_name="__main__", alter_sys=True)
"""
SIM = ("emulate", "--bus", "coulombus:stopped", "--seconds", "0.01")


def ended(words, module, number=signal.SIGINT, act="kill()"):
    """Return status and stderr of a verb that is stopped when it asks for a module."""
    text = BEGIN.format(module=module, act=act, number=int(number))
    done = subprocess.run([sys.executable, "-c", text, *words], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.stdout == ""
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("words", "module"),
    [
        pytest.param(("check",), "coulombus.cli", marks=pytest.mark.thorough),
        (("check",), "click"),
        pytest.param(("check",), "coulombus.cli.main", marks=pytest.mark.thorough),
        pytest.param(("check",), "coulombus.rigs.rig", marks=pytest.mark.thorough),
        pytest.param(("check",), "pydantic", marks=pytest.mark.thorough),
        pytest.param(("plan",), "numpy", marks=pytest.mark.thorough),
        (("simulate",), "numba"),
        pytest.param(("simulate",), "coulombus.sim_bus.network.network", marks=pytest.mark.thorough),
        (("simulate",), "coulombus.lab.simulate"),
        (("run", "--bus", "coulombus:none"), "coulombus.host.run.real_run"),
        pytest.param(("scan", "--bus", "coulombus:none"), "coulombus.host.devices.scan", marks=pytest.mark.thorough),
        pytest.param(("commission", "--virtual"), "coulombus.rigs.rig", marks=pytest.mark.thorough),
        pytest.param(("analyse",), "scipy", marks=pytest.mark.thorough),
        (SIM, "coulombus.sim_bus.server.rig_server"),
    ],
)
def test_ctrl_c_is_one_line_at_any_import(words, module):
    assert ended(words, module) == (130, "coulombus: interrupted\n")


@pytest.mark.thorough
@pytest.mark.parametrize("number", SIGNALS[1:])
@pytest.mark.parametrize("module", ["click", "coulombus.rigs.rig"])
def test_the_other_signals_are_told_by_their_names(module, number):
    assert ended(("check",), module, number) == (128 + number, f"coulombus: ended by {number.name}\n")


@pytest.mark.thorough
@pytest.mark.parametrize("act", ["lost()", "other()", "half()"])
@pytest.mark.parametrize("module", ["coulombus.cli.main", "coulombus.rigs.rig"])
def test_an_exception_that_is_lost_or_becomes_another_one_is_the_signal_all_the_same(module, act):
    assert ended(("check",), module, act=act) == (130, "coulombus: interrupted\n")
    assert ended(("check",), module, signal.SIGTERM, act) == (143, "coulombus: ended by SIGTERM\n")


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
@pytest.mark.parametrize(
    ("words", "told"), [(SIM, "ended by SIGINT before the bus was ready"), (("simulate",), "interrupted")]
)
def test_ctrl_c_while_a_kernel_is_loaded(words, told):
    assert ended(words, "numpy.ma") == (130, f"coulombus: {told}\n")


def test_a_mistake_without_a_signal_is_told_with_its_traceback():
    status, err = ended(("check",), "coulombus.rigs.rig", act='raise SystemError("of its own")')
    assert status == 70
    assert err.startswith("Traceback")
    assert err.endswith("coulombus: internal error, please report it: SystemError: of its own\n")
