#!/usr/bin/env python3
"""Mutation test of all that decides about torque, brake and arming: how well do the tests hold it?

Each mutant is one small edit of a module (`mutants.py` has the operators). The tests that are named
for the module have to fail with it. A survivor is a hole in the tests, or equivalent: then
`mutants_equivalent.toml` lists it with its proof.

    .venv/bin/python scripts/mutate.py                         # everything
    .venv/bin/python scripts/mutate.py --module host/cycle/monitors.py
    .venv/bin/python scripts/mutate.py --sample 100 --seed 3
    .venv/bin/python scripts/mutate.py --list --module host/cycle/step.py

`mutate_drawn.py` draws mutants of the whole product.

A run that was broken off goes on where it was: the results are in `out/mutants.jsonl`, and one is
used again while the module, and for a survivor the tests, are the same. Exit status: 0, all
survivors are listed; 1, one is not, or the list holds one that is none; 2, usage.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import time
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from mutant_runs import Tests, Verdict, run  # noqa: E402
from mutants import Mutant, Source  # noqa: E402

EQUIVALENTS = ROOT / "scripts" / "mutants_equivalent.toml"


@dataclass(frozen=True)
class Target:
    """A module's tests, the functions that are meant when not all are, and the mark of the tests that
    are left out: they simulate whole runs, which takes minutes in plain Python.
    """

    tests: tuple[str, ...]
    units: tuple[str, ...] = ()
    marks: str = ""


TARGETS = {
    "host/cycle/monitors.py": Target(("test_monitors", "test_cycle", "test_cycle_roles")),
    "host/cycle/plausibility.py": Target(("test_plausibility",)),
    "host/cycle/step.py": Target(
        ("test_cycle", "test_hand_over", "test_safety", "test_cycle_roles", "test_live_parameters")
    ),
    "host/cycle/phases.py": Target(
        (
            "test_hand_over",
            "test_safety",
            "test_phases",
            "test_joint_phases",
            "test_slow_velocity",
            "test_brake_model",
            "test_passivity",
            "test_mirrored",
            "test_cycle",
            "test_transitions",
            "test_cycle_roles",
            "test_study_delay",
        )
    ),
    "host/cycle/hand_over.py": Target(("test_hand_over", "test_safety")),
    "host/cycle/study_delay.py": Target(("test_study_delay",)),
    "host/cycle/telemetry.py": Target(("test_telemetry",)),
    "host/cycle/brake_model.py": Target(("test_brake_model",), ("seen_by_fluid", "coil_for", "magnetise")),
    "host/cycle/axes.py": Target(("test_host_axes",)),
    "eds/description.py": Target(("test_eds_reader",), ("Variable.admits", "Variable.largest")),
    "host/laws/wall.py": Target(("test_law_edges",), ("wall",)),
    "host/laws/karnopp.py": Target(("test_law_edges",), ("karnopp",)),
    "host/laws/coulomb.py": Target(("test_law_edges",), ("coulomb",)),
    "host/cycle/controller.py": Target(
        ("test_host_control", "test_cycle_roles"),
        ("_cycles", "Controller._new_control", "Controller.motor_limit_raw", "Controller.start", "Controller.stop"),
    ),
    "host/cycle/output_limits.py": Target(("test_output_limits", "test_cycle_roles")),
    "host/setup/law_demand.py": Target(
        ("test_law_demand_edges", "test_law_demand"),
        marks="slow",
    ),
    "host/cycle/live_parameters.py": Target(("test_live_parameters",)),
    "host/world/local_model.py": Target(("test_local_model", "test_local_model_edges", "test_softening")),
    "host/world/softening.py": Target(("test_softening",)),
    "host/plane/tip_model.py": Target(("test_tip_model",)),
    "host/run/run_sequence.py": Target(("test_run_sequence_edges",)),
    "host/run/control_socket.py": Target(("test_control_socket_edges", "test_control_socket")),
    "host/run/deadman.py": Target(("test_deadman_edges", "test_deadman", "test_keys")),
    "host/realtime/loop.py": Target(
        ("test_loop_edges",),
        ("_skip", "_look_after_parent", "_all_done", "_count", "_obey", "_goes_on", "run_plane"),
    ),
    "host/realtime/bus_sockets.py": Target(
        ("test_bus_sockets", "test_loop_edges"), ("stop", "failed", "watch", "lose", "transmit", "drain")
    ),
    "host/setup/host_loss.py": Target(("test_host_loss_edges",)),
    "host/run/realtime_sequence.py": Target(
        ("test_realtime_sequence_edges",),
        tuple(
            f"RealCourse.{name}"
            for name in (
                *("mark", "_why_no_change", "_apply", "_watch_keys", "drain", "_give_up_recording", "stop", "set_up"),
                *("_await_hand", "armed", "_arm", "display", "_fail", "_attempt", "make_safe", "advance", "_supervise"),
                *("_plane_gone", "_never_cycled", "end", "close", "trip", "_lost_share", "_exit_status", "figures"),
                "result",
            )
        ),
    ),
    "host/setup/device_plan.py": Target(("test_device_plan_edges", "test_position_scale", "test_marks")),
    "host/setup/bringup.py": Target(("test_bringup_edges",)),
    "host/realtime/data_plane.py": Target(
        ("test_data_plane_edges",),
        (
            "Spread.from_bins",
            "rig_filters",
            *(
                f"DataPlane.{name}"
                for name in (
                    *("pid", "wait_ready", "status", "cycles", "alive", "fate", "lost_text", "start_cycle", "stop"),
                    *(
                        "attend",
                        "hold_deadman",
                        "publish_order",
                        "end_cycle",
                        "await_end",
                        "take_frames",
                        "take_trace",
                        "close",
                    ),
                    *("wakeup", "latency", "cpu_us_per_cycle", "counters"),
                )
            ),
        ),
    ),
    "host/setup/settings.py": Target(("test_settings_edges",)),
    "sim_bus/server/bridge.py": Target(
        ("test_bridge_edges",),
        ("faults", "Result.exit_status", "_Way.__init__", "_Way.receive", "_Way.give", "_Way.next_ns"),
    ),
    "sim_bus/server/live_nodes.py": Target(
        ("test_live_nodes_edges",),
        (
            *(
                f"LiveNodes.{name}"
                for name in (
                    *("__post_init__", "_open", "_commission", "make_world", "_devices", "_heard", "_check_kind"),
                    "_report",
                )
            ),
            "serves",
        ),
    ),
    "sim_bus/server/admission.py": Target(
        ("test_server_edges",),
        tuple(f"Admission.{name}" for name in ("accept", "_turn_away", "_place", "admit", "greeted", "part")),
    ),
    "sim_bus/server/socket_file.py": Target(("test_server_edges",)),
    "sim_bus/server/sim_result.py": Target(("test_server_edges",)),
    "node/deadlines.py": Target(("test_node_watch_edges",)),
    "node/guarding.py": Target(("test_node_watch_edges",)),
    "node/reactions.py": Target(("test_node_behaviour",)),
    "node/states402.py": Target(("test_drive402_edges", "test_stand_in")),
    "node/motion402.py": Target(("test_motion402_edges", "test_stand_in")),
    "node/drive402.py": Target(
        ("test_node_behaviour", "test_stand_in"), ("_apply", "_connection_lost", "_react", "_supply")
    ),
    "node/brake404.py": Target(
        ("test_brake404_edges", "test_node_behaviour"),
        (
            *("start", "_torque", "_begin_ramp", "cut", "new_setpoint", "connection_lost", "host_lost", "actuate"),
            *("_input", "_odd_input", "sample", "next_deadline"),
            *("_actuate", "_apply", "_connection_lost", "_react"),
        ),
    ),
    "eds/codec.py": Target(("test_nearest_integer",), ("nearest_integer",)),
    "node/io401.py": Target(
        ("test_io401",),
        ("_within", "_allowed", "_sample", "_actuate", "_fail", "_apply", "_connection_lost", "_react"),
    ),
    "node/coil404.py": Target(("test_brake404_edges",)),
}
"""What decides about torque, brake or arming, and the tests that hold it."""


@dataclass
class Tally:
    """What became of one module's mutants."""

    name: str
    mutants: int = 0
    killed: int = 0
    timeouts: int = 0
    equivalent: int = 0
    cpu_s: float = 0.0

    @property
    def survived(self) -> int:
        """How many are neither killed nor listed."""
        return self.mutants - self.killed - self.timeouts - self.equivalent

    @property
    def score(self) -> float:
        """Share of the mutants that are not equivalent which a test kills."""
        real = self.mutants - self.equivalent
        return (self.killed + self.timeouts) / real if real else 1.0


class Equivalents:
    """The list of equivalent mutants: `[[equivalent]]` with module, line, changes, proof.

    Where that is not enough, function and nth of it.
    """

    def __init__(self, path: Path) -> None:
        self.proofs: dict[tuple[str | int, ...], str] = {}
        entries = tomllib.loads(path.read_text(encoding="utf-8")).get("equivalent", []) if path.exists() else []
        for entry in entries:
            if not entry["proof"].strip():
                raise SystemExit(f"{path.name}: {entry['module']}: {entry['line']}: a proof is missing")
            for change in entry["changes"]:
                key = (entry["module"], entry.get("function", ""), entry["line"], change, entry.get("nth", 0))
                self.proofs[key] = entry["proof"]
        self.met: set[tuple[str | int, ...]] = set()

    def lists(self, name: str, mutant: Mutant, nth: int) -> bool:
        """Whether the mutant is listed."""
        here = [(unit, mutant.text, mutant.change, n) for unit in ("", mutant.unit) for n in (0, nth)]
        keys = {(name, *place) for place in here} & self.proofs.keys()
        self.met |= keys
        return bool(keys)

    def unmet(self, name: str) -> list[str]:
        """Return the entries of a module that no mutant fits."""
        return [f"{line}: {change}" for module, _, line, change, _ in self.proofs.keys() - self.met if module == name]


class Results:
    """The JSON lines of earlier runs, to which each verdict is appended."""

    def __init__(self, path: Path, fresh: bool) -> None:
        self.path = path
        self.known: dict[str, dict[str, Any]] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        if fresh:
            path.unlink(missing_ok=True)
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    row = json.loads(line)
                except ValueError:
                    continue  # a run was broken off in the middle of a line
                self.known[row["key"]] = row

    def verdict(self, key: str, source: str, tests: str) -> Verdict | None:
        """Return what is known of a mutant, as far as it still holds."""
        row = self.known.get(key)
        if row is None or row["source"] != source or row["status"] == "not made":
            return None
        if row["status"] == "survived" and row["tests"] != tests:
            return None
        return Verdict(row["status"], row["by"], row["cpu_s"])

    def add(self, row: dict[str, Any]) -> None:
        """Append a verdict."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def _file(test: str) -> str:
    """Return the path of the tests that are called so, with a folder where two files are."""
    paths = [str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob(f"{test}.py")]
    if len(paths) != 1:
        raise SystemExit(f"{test}: expected the name of one file of tests, there are {sorted(paths)}")
    return paths[0]


def _digest(paths: list[Path]) -> str:
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()[:12]


def _keys(name: str, mutants: list[Mutant]) -> tuple[list[str], list[int]]:
    """Return a name for each mutant that lasts while its line does, and the how many-th such one it
    is.
    """
    met: Counter[str] = Counter()
    keys, nths = [], []
    for mutant in mutants:
        key = f"{name}|{mutant.unit}|{mutant.text}|{mutant.operator}|{mutant.short}"
        met[key] += 1
        keys.append(f"{key}|{met[key]}")
        nths.append(met[key])
    return keys, nths


def mutate(name: str, options: argparse.Namespace, listed: Equivalents, results: Results) -> tuple[Tally, list[str]]:
    """Run the mutants of one module; return the tally, and what is wrong."""
    target, path = TARGETS[name], ROOT / name
    tests = [_file(test) for test in target.tests]
    source = Source(name, path.read_text(encoding="utf-8"), target.units)
    if source.lacking:
        raise SystemExit(f"{name}: expected the names of its functions, it has no {', '.join(source.lacking)}")
    mutants = source.mutants()
    keys, nths = _keys(name, mutants)
    numbers = list(range(len(mutants)))
    if options.sample:
        numbers = sorted(random.Random(f"{options.seed} {name}").sample(numbers, min(options.sample, len(numbers))))
    if options.unit:
        numbers = [k for k in numbers if mutants[k].unit == options.unit]
    tally, failures = Tally(name, len(numbers)), []
    if options.list:
        for k in numbers:
            print(f"{name}:{mutants[k].line}: {mutants[k].operator}: {mutants[k].change}")
        return tally, []
    digests = _digest([path]), _digest([ROOT / test for test in tests])
    verdicts: dict[int, Verdict] = {}
    for k in numbers:
        recorded = results.verdict(keys[k], *digests)
        if recorded is not None:
            verdicts[k] = recorded
        elif listed.lists(name, mutants[k], nths[k]) and not options.check_equivalents:
            verdicts[k] = Verdict("survived", "listed", 0.0)
    missing = [k for k in numbers if k not in verdicts]
    began = time.monotonic()

    def tell(n: int, verdict: Verdict) -> None:
        k = missing[n]
        verdicts[k] = verdict
        mutant = mutants[k]
        row = {"key": keys[k], "module": name, "line": mutant.line, "text": mutant.text, "operator": mutant.operator}
        row |= {"change": mutant.change, "source": digests[0], "tests": digests[1]}
        results.add(row | {"status": verdict.status, "by": verdict.by, "cpu_s": verdict.cpu_s})
        if sys.stderr.isatty():
            print(
                f"\r{name}: {len(verdicts)} of {len(numbers)}, {time.monotonic() - began:.0f} s ",
                end="",
                file=sys.stderr,
            )

    if missing:
        error = run(
            source,
            [mutants[k] for k in missing],
            Tests(tuple(tests), target.marks),
            options.jobs,
            options.timeout,
            tell,
        )
        if error:
            raise SystemExit(f"{name}: {error}")
    for k in numbers:
        verdict, mutant = verdicts[k], mutants[k]
        tally.cpu_s += verdict.cpu_s
        equivalent = listed.lists(name, mutant, nths[k])
        where = f"{name}:{mutant.line}: {mutant.operator}: {mutant.change}"
        if verdict.status in ("survived", "not made"):
            tally.equivalent += equivalent
            if not equivalent:
                failures.append(f"{verdict.status.upper()} {where}" + (f" ({verdict.by})" if verdict.by else ""))
        else:
            tally.killed += verdict.status == "killed"
            tally.timeouts += verdict.status == "timeout"
            if equivalent:
                failures.append(f"LISTED, BUT KILLED {where} ({verdict.by})")
    if not options.sample and not options.unit:
        failures += [f"LISTED, BUT NO MUTANT {name}: {entry}" for entry in listed.unmet(name)]
    return tally, failures


def _table(tallies: list[Tally]) -> str:
    rows = ["| module | mutants | killed | equivalent | survived | score |", "|---|---|---|---|---|---|"]
    total = Tally("all")
    for tally in tallies:
        for field in ("mutants", "killed", "timeouts", "equivalent", "cpu_s"):
            setattr(total, field, getattr(total, field) + getattr(tally, field))
    for t in [*tallies, total]:
        killed = t.killed + t.timeouts
        rows.append(f"| `{t.name}` | {t.mutants} | {killed} | {t.equivalent} | {t.survived} | {100 * t.score:.1f} % |")
    return "\n".join(
        [*rows, "", f"{total.timeouts} of the killed by their time; {total.cpu_s:.0f} s of processor time."]
    )


def main() -> int:
    """Read the options, run the modules, print what survives and the scores."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("--module", action="append", choices=sorted(TARGETS), help="only this module (may be given again)")
    add("--unit", default="", help="only this function of it")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="mutants at the same time")
    add("--sample", type=int, default=0, help="only so many mutants of each module, drawn with --seed")
    add("--seed", type=int, default=0)
    add("--timeout", type=float, default=10.0, help="processor time of a mutant, in multiples of its tests' own")
    add("--results", type=Path, default=ROOT / "out" / "mutants.jsonl", help="where the verdicts are kept")
    add("--fresh", action="store_true", help="forget the verdicts of earlier runs")
    add("--check-equivalents", action="store_true", help="run the listed mutants too")
    add("--list", action="store_true", help="list the mutants and run none")
    add("--tests", action="store_true", help="name the files of tests, and run none")
    options = parser.parse_args()
    os.chdir(ROOT)
    if options.tests:
        print(*sorted({_file(test) for target in TARGETS.values() for test in target.tests}), sep="\n")
        return 0
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # before anything imports numba
    listed, results = Equivalents(EQUIVALENTS), Results(options.results, options.fresh)
    tallies, failures = [], []
    for name in options.module or TARGETS:
        if len(options.module or TARGETS) > 1 and not options.list:
            tally, of_module = _in_child(name, options, listed, results)
        else:
            tally, of_module = mutate(name, options, listed, results)
        tallies.append(tally)
        failures += of_module
        print(*of_module, sep="\n", end="\n" if of_module else "", flush=True)
    if not options.list:
        print(_table(tallies))
    return 1 if failures else 0


def _in_child(name: str, options: argparse.Namespace, listed: Equivalents, results: Results) -> tuple[Tally, list[str]]:
    """Run one module in a process of its own: pytest is started once in a process."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        status = 2
        try:
            os.close(reading)
            tally, failures = mutate(name, options, listed, results)
            with os.fdopen(writing, "w", encoding="utf-8") as file:
                json.dump([vars(tally), failures], file)
            status = 0
        except SystemExit as error:
            print(error, file=sys.stderr)
        finally:
            os._exit(status)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as file:
        answer = file.read()
    os.waitpid(pid, 0)
    if not answer:
        raise SystemExit(2)
    tally, failures = json.loads(answer)
    return Tally(**tally), failures


if __name__ == "__main__":
    sys.exit(main())
