"""`make bench`: the project's figures of speed, each with what it is measured against.

``python -m benchmarks`` runs those of `benchmarks.catalogue`, each in a process of its own, in at most
15 minutes; ``python -m benchmarks WHAT`` runs one, and ``python -m benchmarks compare A B`` says what
became slower between two results in ``out/bench``.

This machine's clock is not yours: every figure is a ratio (simulated to real time, or to a
reference that ran in between in the same process). Each is the median of several rounds; the
references are interleaved with what they are held against.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.catalogue import BESIDE, SENTENCES
from benchmarks.compare import compare
from benchmarks.report import keep, show, take_lines
from benchmarks.size import SMALLEST

MOST_S = 15 * 60.0
TERMINATE_S = 10.0


def observers_of(options: argparse.Namespace) -> None:
    """Run the simulated observers that the options name."""
    from benchmarks.observer_displays import observer_displays
    from benchmarks.observer_groups import observer_groups
    from benchmarks.observers import observers

    if options.displays:
        observer_displays(show, 1 if options.smallest else options.observers, options.document)
    elif options.groups:
        observer_groups(show, 2 if options.smallest else options.groups, options.document)
    else:
        observers(show, 8 if options.smallest else options.observers, options.document)


def run(what: str, options: argparse.Namespace) -> None:
    """Run one benchmark; its module is imported only now."""
    if what == "virtual":
        from benchmarks.virtual import virtual

        virtual()
    elif what == "first":
        from benchmarks.first_minute import first_minute

        first_minute(show)
    elif what == "bus":
        from benchmarks.bus import bus

        bus(show, options.hours)
    elif what == "nodes":
        from benchmarks.nodes import nodes

        nodes(show)
    elif what == "eds":
        from benchmarks.eds_files import eds_files

        eds_files(show)
    elif what == "exports":
        from benchmarks.exports import exports

        exports(show)
    elif what == "clients":
        from benchmarks.clients import clients

        clients(show)
    elif what == "bits":
        from benchmarks.virtual import million_frames

        million_frames()
    elif what == "coverage":
        from benchmarks.coverage import coverage

        coverage(options.rigs, options.seed)
    elif what == "worlds":
        from benchmarks.random_worlds import random_worlds

        random_worlds(options.rigs, options.seed, options.modes, options.hands)
    elif what == "loss":
        from benchmarks.loss import loss

        loss(show, options.minutes)
    elif what == "network":
        from benchmarks.network import network

        network(show)
    elif what == "page":
        from benchmarks.page import page

        page(show)
    elif what == "detail":
        from benchmarks.detail import detail

        detail(show)
    elif what == "sweep":
        from benchmarks.sweep import sweep

        sweep(show)
    elif what == "observers":
        observers_of(options)
    elif what == "releases":
        from benchmarks.releases import releases

        releases(show, options.ends)
    else:
        run_real_time(what, options)


def run_real_time(what: str, options: argparse.Namespace) -> None:
    """Run one of the benchmarks against the wall clock."""
    if what == "lost":
        from benchmarks.realtime import lost

        lost(options.minutes)
    elif what == "disturbed":
        from benchmarks.realtime import disturbed

        disturbed(options.seconds, options.rounds)
    elif what == "faulty":
        from benchmarks.faulty import faulty

        faulty(options.seconds, options.rounds)
    elif what == "world":
        from benchmarks.world import world

        world(show, options.seconds, options.rounds, options.minutes)
    elif what == "realtime":
        from benchmarks.realtime import realtime

        realtime(seconds=options.seconds, rounds=options.rounds, minutes=options.minutes, figure=options.figure)


def run_all(arguments: list[str]) -> int:
    """Run those of the catalogue, each in a process, until `MOST_S` are over; return 1 if one failed."""
    end, failed = time.monotonic() + MOST_S, []
    for name, sentence in SENTENCES.items():
        left = end - time.monotonic()
        print(f"\n{name}: {sentence}", flush=True)
        if left <= 0:
            show(name, "skipped", f"the {MOST_S / 60:.0f} minutes are over; python -m benchmarks {name} runs it")
            continue
        process = subprocess.Popen([sys.executable, "-m", "benchmarks", name, *arguments])
        try:
            status = process.wait(left)
        except subprocess.TimeoutExpired:
            show(name, "cut off", f"the {MOST_S / 60:.0f} minutes are over; python -m benchmarks {name} runs it")
            status = 0
        finally:
            _end(process)
        if status:
            failed.append(name)
            show(name, "failed", f"exit status {status}")
    if failed:
        print(f"benchmarks: failed: {', '.join(failed)}", file=sys.stderr)
    return int(bool(failed))


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(TERMINATE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def main() -> None:
    """Run what the arguments ask for."""
    if sys.argv[1:2] == ["compare"]:
        pair = argparse.ArgumentParser(
            prog="python -m benchmarks compare", description="What became slower from A to B."
        )
        pair.add_argument("a", type=Path, help="a file of out/bench, or a folder of them")
        pair.add_argument("b", type=Path)
        arguments = pair.parse_args(sys.argv[2:])
        sys.exit(compare(arguments.a, arguments.b))
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Figures of speed, as ratios.")
    parser.add_argument("what", nargs="?", choices=("all", *SENTENCES, *BESIDE), default="all")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each contestant in each round, in real time")
    parser.add_argument("--rounds", type=int, default=3, help="in real time")
    parser.add_argument("--minutes", type=float, default=0.5, help="of the runs that look for what is lost")
    parser.add_argument("--hours", type=float, default=0.0, help="of bus time in one run, in virtual time")
    parser.add_argument("--observers", type=int, default=200, help="of each method and kind")
    parser.add_argument("--displays", action="store_true", help="observers judge what they feel of simulated displays")
    parser.add_argument("--groups", type=int, default=0, help="of observers, for the hierarchical fit")
    parser.add_argument("--document", type=Path, help="write the table of the observers there, between its marks")
    parser.add_argument("--rigs", type=int, default=10, help="random rigs that are commissioned, or worlds")
    parser.add_argument("--modes", type=int, choices=(1, 2, 3), default=1, help="in which each world is displayed")
    parser.add_argument("--hands", type=int, choices=(1, 2, 3, 4, 5), default=1, help="which each world meets")
    parser.add_argument("--ends", type=int, default=0, help="random ends and trips of each mode, instead of the table")
    parser.add_argument("--seed", type=int, default=1, help="of the random rigs")
    parser.add_argument("--figure", type=Path, help="draw the histograms of the wake-ups there")
    parser.add_argument("--smallest", action="store_true", help="as little as shows that it runs; no figure means much")
    options = parser.parse_args()
    if options.smallest:
        os.environ[SMALLEST] = "1"
        options.seconds, options.rounds, options.minutes = 0.3, 1, 0.01
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # by way of the context managers that end the bus
    if options.what == "all":
        sys.exit(run_all([word for word in sys.argv[1:] if word != "all"]))
    begin = time.monotonic()
    try:
        run(options.what, options)
    finally:
        keep(options.what, take_lines(), time.monotonic() - begin)


if __name__ == "__main__":
    main()
