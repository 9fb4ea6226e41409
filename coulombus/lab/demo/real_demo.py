"""The paper's experiment in real time: per mode a ``coulombus emulate`` process, and a host on its bus."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from coulombus.host.errors import HostError
from coulombus.host.run.real_run import real_run
from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Outputs, Run
from coulombus.host.setup.bringup import check_plan
from coulombus.lab.demo.demo import DEMO_MODES, Demo, judge
from coulombus.lab.warm_up import warm_up
from coulombus.rigs.plant import StrokePhase
from coulombus.rigs.rig import Rig
from coulombus.system.realtime import die_with_parent
from coulombus.system.stop_signals import Signals, Stopped
from coulombus.wire.address import BusAddress

__all__ = ["SimProcess", "run_real_demo", "shown_s"]

END_TIMEOUT_S = 10.0


class SimDied(HostError):
    """The simulation's process ended by itself."""

    exit_status = 4


class SimProcess:
    """A ``coulombus emulate`` process; call `wait_ready` before use. As a context manager it ends the process."""

    def __init__(self, rig: str, address: BusAddress, mode: str, seed: int, overrides: Sequence[str]) -> None:
        self.address, self._ready = address, False
        root = str(Path(__file__).parents[__name__.count(".")])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        sets = [part for override in overrides for part in ("--set", override)]
        arguments = ["--rig", rig, "--bus", str(address), "--mode", mode, "--seed", str(seed), "--json", *sets]
        parent, cpus = os.getpid(), sorted(os.sched_getaffinity(0))
        if len(cpus) > 1:  # the host's cycle uses the last CPU
            arguments += ["--cpu", str(cpus[0])]
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "coulombus", "emulate", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: die_with_parent(parent, signal.SIGTERM),
            env={**os.environ, "PYTHONPATH": path},
        )

    @property
    def alive(self) -> bool:
        """Whether the process exists."""
        return self.process.poll() is None

    def wait_ready(self) -> None:
        """Wait until the bus exists; raise SimDied if the process ends first."""
        assert self.process.stdout is not None
        if json.loads(self.process.stdout.readline() or "{}").get("event") != "ready":
            raise SimDied(f"coulombus emulate on {self.address} ended with status {self.process.wait()}")
        self._ready = True

    def __enter__(self) -> SimProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.send_signal(signal.SIGTERM if self._ready else signal.SIGKILL)  # a SIGTERM before would print
        try:
            self.process.communicate(timeout=END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()


def shown_s(rig: Rig) -> float:
    """Return the length of a display: the schedule, but of a stroke at its end once there and back [s]."""
    axis = rig.one_axis()
    last = axis.phases[-1] if axis.phases else None
    if not isinstance(last, StrokePhase):
        return rig.schedule_s
    return axis.phase_starts_s[-2] + min(last.duration_s, 2.0 * (last.move_s + last.dwell_s))


def run_real_demo(
    rig: Rig,
    rig_name: str,
    directory: Path,
    *,
    seed: int = 0,
    overrides: Sequence[str] = (),
    signals: Signals | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Demo:
    """Run both modes against the wall clock.

    Write the recordings and ``demo.json`` under `directory`.

    Parameters
    ----------
    rig : with `overrides`, for host and simulation
    rig_name : its name or path, for the simulation's process
    """
    check_plan(rig)
    directory.mkdir(parents=True, exist_ok=True)
    results: dict[str, RunResult] = {}
    warm_up(scope="run" if rig.kinematics is None else "arm")
    with ExitStack() as stack:
        sims = {}
        for mode in DEMO_MODES:  # all at once: the second is ready when the first run is over
            address = BusAddress("coulombus", f"demo-{os.getpid()}-{mode}")
            sims[mode] = stack.enter_context(SimProcess(rig_name, address, mode, seed, overrides))
        for sim in sims.values():
            sim.wait_ready()
        for mode, sim in sims.items():

            def report(t_s: float, _: object, mode: str = mode) -> None:
                if progress is not None:
                    progress(mode, t_s)

            picture = directory / f"{mode}-timing.png"
            outputs = Outputs(record=directory / f"{mode}.pcapng", histogram=picture, force=True)
            run = Run(rig, mode, shown_s(rig), outputs=outputs, virtual=False)
            results[mode] = real_run(run, bus=sim.address, signals=signals, progress=report)
            if signals is not None and signals.number:
                raise Stopped(signals.number, "before the demo was over")
    demo = Demo(judge(rig, results), results)
    (directory / "demo.json").write_text(json.dumps(demo.as_dict(), indent=2) + "\n")
    return demo
