"""The loop and the bus against the wall clock: ratios to cyclictest and to C, in rounds that take
turns on one bus.

Medians are over rounds; shares are of all rounds together. What cannot be measured here is skipped
with its reason.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import contestants as c
from benchmarks.contestants import Bus, Run, quantile, together
from benchmarks.report import show
from benchmarks.size import size

RATES = (
    # period [s], bit rate [bit/s], window for TPDOs [s]
    (5e-4, 2_000_000, 4.5e-4),
    (2e-4, 5_000_000, 1.8e-4),
    (1e-4, 20_000_000, 0.9e-4),
)
CROWD_ROUNDS = size(2000, 50)
CYCLICTEST, TWIN, PLANE, CLASSIC = "cyclictest", "the loop's twin in C", "the compiled loop", "canopen, Notifier"
LOADED = ", disturbed"
COLOURS = {CYCLICTEST: "0.7", TWIN: "#009E73", PLANE: "#0072B2", "canopen": "#D55E00"}


def skipped(what: str, reason: str) -> None:
    show(what, "skipped", reason)


def compiled(directory: Path) -> Path | str:
    """Return the twin's program, or why there is none."""
    compiler = shutil.which("cc")
    if compiler is None:
        return "no C compiler (Debian: apt install gcc)"
    program = directory / "twin"
    source = Path(__file__).with_name("twin.c")
    done = subprocess.run([compiler, "-O2", "-o", program, source, "-lm"], capture_output=True, text=True)
    return program if done.returncode == 0 else f"cc failed: {done.stderr.strip()[:100]}"


def take_turns(contestants: dict[str, Callable[[], Any]], rounds: int) -> dict[str, list[Any]]:
    """Let each run once a round, every second round in the opposite order."""
    results: dict[str, list[Any]] = {name: [] for name in contestants}
    for number in range(rounds):
        names = list(contestants)
        for name in names if number % 2 == 0 else reversed(names):
            results[name].append(contestants[name]())
    return results


def ratio(ours: Sequence[float], theirs: Sequence[float]) -> str:
    return f"{median(a / b for a, b in zip(ours, theirs, strict=True)):.2f} x"


def percentage(count: int, total: int) -> str:
    return f"{100 * count / max(total, 1):.3f} %"


def table(runs: dict[str, list[Run]]) -> None:
    """Print one line for each contestant, in units of the references of its round."""
    unit = [run.p(0.99) for run in runs[CYCLICTEST]] if CYCLICTEST in runs else None
    cpu = [run.cpu_us or 0.0 for run in runs[TWIN]] if TWIN in runs else None
    print(f"\n{'1 kHz':<32}{'wake-up p50':>12}{'p99':>8}{'CPU':>8}{'late':>11}{'periods lost':>14}{'PDO set late':>14}")
    for name, some in runs.items():
        all_of = together(some)
        row = f"{name:<32}"
        for share, width in ((0.5, 12), (0.99, 8)):
            ratios = [r.p(share) / u for r, u in zip(some, unit or (), strict=unit is not None)]
            row += f"{median(ratios):>{width}.2f}" if ratios else f"{'-':>{width}}"
        has_cpu = cpu is not None and all_of.cpu_us is not None
        row += (
            f"{median((r.cpu_us or 0) / t for r, t in zip(some, cpu or (), strict=True)):>8.2f}"
            if has_cpu
            else f"{'':>8}"
        )
        row += f"{percentage(all_of.late_cycles, all_of.cycles):>11}{percentage(all_of.missed, all_of.cycles + all_of.missed):>14}"
        row += f"{percentage(all_of.incomplete, all_of.cycles):>14}" if all_of.latency.any() else ""
        print(row)
    print(
        "wake-ups in units of cyclictest's p99, CPU in units of the twin's; 'late' cycles were not done in their period\n"
    )


def cycle(program: Path | str, bus: Bus, seconds: float, rounds: int) -> dict[str, list[Run]]:
    """Wake-ups, CPU time, and what a disturbed interpreter does to them."""
    here: dict[str, Callable[[], Run]] = {}
    reason = c.has_cyclictest()
    if reason is None:
        here[CYCLICTEST] = lambda: c.cyclictest(seconds)
    if isinstance(program, Path):
        here[TWIN] = lambda: c.twin(program, bus, seconds)
    here[PLANE] = lambda: c.data_plane(bus, seconds)
    here[CLASSIC] = lambda: c.classic(bus, seconds)
    here[PLANE + LOADED] = lambda: c.data_plane(bus, seconds, loaded=True)
    here[CLASSIC + LOADED] = lambda: c.classic(bus, seconds, loaded=True)
    if reason is None:
        here[CYCLICTEST + ", beside the disturbance"] = lambda: c.cyclictest(seconds, loaded=True)
    runs = take_turns(here, rounds)
    table(runs)
    plane, loaded = runs[PLANE], together(runs[PLANE + LOADED])
    if plane[0].refused:
        show("real-time rights that were refused", ", ".join(plane[0].refused), "docs/realtime.md")
    for trip in {run.trip for some in runs.values() for run in some if run.trip}:
        show("a run tripped", trip)
    if reason is None:
        reference = [run.p(0.99) for run in runs[CYCLICTEST]]
        show("wake-up p99 against cyclictest's", ratio([r.p(0.99) for r in plane], reference), "at most 1.25 x")
    else:
        skipped("wake-up p99 against cyclictest's", reason)
    if isinstance(program, Path):
        ours, theirs = ([run.cpu_us or 0.0 for run in runs[name]] for name in (PLANE, TWIN))
        show("CPU time of a cycle against its twin's in C", ratio(ours, theirs), "at most 1.1 x")
    else:
        skipped("CPU time of a cycle against its twin's in C", program)
    if reason is None:
        against_cyclictest(loaded, together(runs[CYCLICTEST]))
    show(
        "disturbed: periods lost to the classic canopen loop",
        f"{100 * together(runs[CLASSIC + LOADED]).gone:.1f} % lost",
        "nearly all",
    )
    return runs


def against_cyclictest(loop: Run, reference: Run) -> None:
    """Late cycles of the disturbed loop, and what the machine itself makes late."""
    counts = f"{loop.late_cycles} of {loop.cycles}, {reference.late_cycles} of {reference.cycles}"
    text = f"{loop.late / reference.late:.2f} x" if reference.late else "no reference"
    show("disturbed: late cycles against cyclictest's wake-ups over 1 ms", text, f"at most 3 x; {counts}")
    counts = f"{loop.missed} and {reference.missed}"
    text = f"{loop.gone / reference.gone:.2f} x" if reference.gone else "no reference"
    show("disturbed: lost periods against those that cyclictest slept through", text, counts)


def disturbed(seconds: float, rounds: int) -> None:
    """Only the figure that matters: the loop beside busy threads, and cyclictest, in turns.

    Long, for late cycles are few.
    """
    reason = c.has_cyclictest()
    if reason is not None:
        skipped("disturbed: late cycles", reason)
        return
    with Bus() as bus:
        c.data_plane(bus, 0.5, loaded=True)
        here = {
            CYCLICTEST: lambda: c.cyclictest(seconds),
            PLANE + LOADED: lambda: c.data_plane(bus, seconds, loaded=True),
        }
        runs = take_turns(here, rounds)
    table(runs)
    against_cyclictest(together(runs[PLANE + LOADED]), together(runs[CYCLICTEST]))


def bus_delivery(program: Path | str, bus: Bus, seconds: float, rounds: int) -> None:
    """When frames are handed out, against their ends of frame."""
    what = "delivery after end of frame, p99 against cyclictest's at the bus's priority and CPU"
    reason = program if isinstance(program, str) else c.has_cyclictest()
    if reason is not None:
        skipped(what, reason)
        return
    assert isinstance(program, Path)
    runs = take_turns(
        {
            "bus": lambda: quantile(c.delivery(program, bus, seconds)[0], 0.99),
            "reference": lambda: c.cyclictest(seconds, priority=c.BUS_PRIORITY, cpu=c.BUS_CPU).p(0.99),
        },
        rounds,
    )
    show(what, ratio(runs["bus"], runs["reference"]), "at most 2 x")


def throughput(program: Path | str, rounds: int) -> None:
    """Eight clients that all send and all listen, on a bus whose frames take no time."""
    what = f"unpaced throughput among {c.CROWD} clients against a fan-out in C"
    if isinstance(program, str):
        skipped(what, program)
        return
    with Bus(unpaced=True) as bus:
        runs = take_turns(
            {
                "bus": lambda: c.crowd_on_bus(program, bus, CROWD_ROUNDS),
                "twin": lambda: c.crowd_on_twin(program, CROWD_ROUNDS),
            },
            rounds,
        )
        lost = bus.end()["lost"]
    show(what, ratio(runs["bus"], runs["twin"]), f"{lost} frames lost")


def rates(program: Path | str, seconds: float, rounds: int) -> None:
    """Faster than a real bus: a raised bit rate."""
    for period_s, bitrate, window_s in RATES:
        overrides = [f"bus.period_s={period_s}", f"bus.bitrate_bit_s={bitrate}", f"bus.tpdo_window_s={window_s}"]
        period_us = round(period_s * 1e6)
        with Bus(overrides) as bus:
            here: dict[str, Callable[[], Run]] = {PLANE: lambda bus=bus: c.data_plane(bus, seconds)}  # type: ignore[misc]
            if isinstance(program, Path):
                here[TWIN] = lambda bus=bus: c.twin(program, bus, seconds)  # type: ignore[misc]
            if c.has_cyclictest() is None:
                here[CYCLICTEST] = lambda period_us=period_us: c.cyclictest(seconds, period_us=period_us)  # type: ignore[misc]
            by_name = {name: together(runs) for name, runs in take_turns(here, rounds).items()}
        run = by_name[PLANE]
        text = f"{1000 / period_us:g} kHz at {bitrate // 1_000_000} Mbit/s"
        others = "; ".join(f"{name} {100 * other.gone:.2f} %" for name, other in by_name.items() if name != PLANE)
        show(f"{text}: lost periods", f"{100 * run.gone:.2f} %", others)
        show(
            f"{text}: PDOs that never came; sets later than their window",
            f"{run.never}; {run.incomplete} of {run.cycles}",
        )


def long_run(bus: Bus, minutes: float) -> None:
    """Lost PDOs."""
    run = c.data_plane(bus, 60 * minutes)
    cycles = run.cycles + run.missed
    show(f"PDOs that never came in {minutes:g} minutes at 1 kHz", f"{run.never}", f"none, of {3 * run.cycles}")
    show("... sets of TPDOs later than their window", f"{run.incomplete}", f"of {run.cycles} cycles")
    show(
        "... lost periods, skipped and counted",
        f"{run.missed}",
        f"of {cycles} periods{'; ' + run.trip if run.trip else ''}",
    )


def draw(runs: dict[str, list[Run]], path: Path) -> None:
    """Draw how late each woke, in units of cyclictest's p99."""
    import numpy as np

    from coulombus.host.run.histogram import coarse
    from coulombus.recording.pictures.style import figure, label

    unit = together(runs[CYCLICTEST]).p(0.99) if CYCLICTEST in runs else 1.0
    titles = "alone in its process", "beside a busy and a garbage-making Python thread"
    with figure(8.0, 5.5, 2, 1, sharex=True, sharey=True) as (fig, panels):
        for ax, disturbed, title in zip(panels, (False, True), titles, strict=True):
            for name, some in runs.items():
                plain = name.split(",")[0]
                if ("disturb" in name) != disturbed:
                    continue
                edges, counts = coarse(together(some).wakeup)
                style = {"color": COLOURS[plain], "fill": plain == CYCLICTEST, "linewidth": 1.6}
                ax.stairs(np.maximum(counts / counts.sum(), 1e-9), edges / unit, label=plain, **style)
            ax.set(xscale="log", yscale="log", ylim=(1e-6, 1))
            label(ax, "", "share of cycles", title)
            ax.legend(loc="upper left")
        text = "in units of cyclictest's p99" if CYCLICTEST in runs else "[us]"
        panels[1].set_xlabel(f"woke after its deadline, {text}; the last bin holds all that is later")
        fig.savefig(path, metadata={"Software": None})


def lost(minutes: float) -> None:
    """Only look for lost PDOs, for so many minutes."""
    with Bus() as bus:
        long_run(bus, minutes)


def realtime(*, seconds: float = 5.0, rounds: int = 3, minutes: float = 0.5, figure: Path | None = None) -> None:
    """Run all benchmarks against the wall clock."""
    with ExitStack() as stack:
        program = compiled(Path(stack.enter_context(tempfile.TemporaryDirectory())))
        bus = stack.enter_context(Bus())
        c.data_plane(bus, 0.5)  # what is compiled or loaded for the first time
        runs = cycle(program, bus, seconds, rounds)
        if figure is not None:
            draw(runs, figure)
        bus_delivery(program, bus, seconds, rounds)
        long_run(bus, minutes)
        bus.end()
        throughput(program, max(rounds, 5))
        rates(program, seconds, rounds)
