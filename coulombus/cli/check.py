"""``coulombus check``: check a rig file and its consequences."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import JsonOption, RigOption, SetOption, option, with_options
from coulombus.cli.rig_options import load_with_law
from coulombus.cli.tables import PROSE, echo, on_terminal
from coulombus.system.exit import verdict
from coulombus.system.wrap_text import columns_of

if TYPE_CHECKING:
    from coulombus.host.setup.device_plan import DevicePlan
    from coulombus.host.setup.host_loss import Reaction
    from coulombus.rigs.errors import RigError
    from coulombus.rigs.plan.rig_plan import RigPlan
    from coulombus.rigs.rig import Rig

__all__ = ["check"]


@click.command(epilog=EXIT_STATUS)
@with_options
def check(
    rig_name: RigOption,
    overrides: SetOption,
    steps: Annotated[bool, option("List every object that bring-up writes, in its order, and why.")],
    bus_name: Annotated[
        str | None,
        option("--bus", "Compare the position scale of the drives on this bus with the rig file.", metavar="B"),
    ],
    as_json: JsonOption,
) -> None:
    """Check a rig file, its EDS files, its PDO layout, what bring-up will set, and whether a cycle
    fits on the bus; nothing is run.

    With --bus the drives on it are asked for the scale of their position; nothing is written. One
    that counts otherwise than the rig file ends with 3 and both numbers.

    A line "FAIL" is what bring-up would refuse: an object that is missing, read-only or too narrow
    for its value, another identity, a limit that would cut the law off, a device that does not
    notice the host's loss. "lost" is what bring-up leaves out, as the device is not ours or has no
    such object; "open" is what only the device itself can answer.

    \b
    Examples:
      coulombus check --rig my-rig.toml
      coulombus check --rig my-rig.toml --steps
      coulombus check --rig bench --set bus.bitrate_bit_s=500000
      coulombus check --rig my-rig.toml --bus socketcan:can0
    """
    with errors():
        from coulombus.rigs.errors import RigError

        try:
            findings = _Findings(load_with_law(rig_name, overrides))
        except RigError as error:
            if as_json:
                failure = {"event": "error", "error": str(error), "exit_status": error.exit_status}
                print_json(failure | {"ok": False, "problems": _refused(error), "losses": [], "reactions": []})
            raise
        if bus_name is not None:
            _hold_against(findings, bus_name)
        with verdict(0 if findings.ok else 1):
            if as_json:
                print_json(findings.document(steps))
            else:
                findings.show(steps)


def _hold_against(findings: _Findings, bus_name: str) -> None:
    """Refuse a rig file whose position scale differs from the drives on a bus (DeviceMismatch)."""
    from coulombus.host.devices.scan import survey
    from coulombus.host.errors import DeviceMismatch, NodeMissing
    from coulombus.wire.address import WITH_ADAPTERS, parse_address

    answered = {answers.node_id: answers.numbers for answers in survey(parse_address(bus_name, WITH_ADAPTERS))}
    differences: dict[str, None] = {}
    for plan in (plan for plans in findings.by_mode.values() for plan in plans):
        if plan.position is None or plan.position.accepted:
            continue
        if plan.node_id not in answered:
            look = "check power, cable, bit rate and node id"
            raise NodeMissing(f"{plan.position.who} does not answer SDO on {bus_name}: {look}")
        written = {(setting.index, setting.subindex): setting.value for setting in plan.writes}
        values = {**answered[plan.node_id], **written}
        if difference := plan.position.difference(_reader(values)):
            differences[difference] = None
    if differences:
        raise DeviceMismatch("; ".join(differences))


def _reader(values: Mapping[tuple[int, int], int]) -> Callable[[int, int], int | None]:
    return lambda index, subindex: values.get((index, subindex))


def _refused(error: RigError) -> list[dict[str, str]]:
    """Return the errors of a rig file as problems: those of roles with their role, the others as their text."""
    from coulombus.rigs.errors import Problem

    problems = [problem._asdict() for problem in error.problems]
    texts = [text for text in error.errors if not any(problem["text"] in text for problem in problems)]
    return problems + [Problem("", "", "", text, "correct the rig file")._asdict() for text in texts]


GENTLER = "give limits.safe_ramp_s more time, up to 1.8 s"


def _once(texts: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(texts))


def _tip_lines(rig: Rig) -> list[str]:
    """Return what an arm in the plane can display at its start, and how finely it measures its tip."""
    if rig.kinematics is None:
        return []
    from coulombus.analysis.rig.plane_display import plane_display

    pose = plane_display(rig, grid=0).poses[0]
    counts = " and ".join(f"{1e6 * way:.3g} um" for way in pose.resolution_m)
    return [*pose.lines(), f"  a count of the encoders moves the tip by {counts}"]


class _Findings:
    """Findings on a rig: its PDOs, its plan, its bring-up in each mode."""

    def __init__(self, rig: Rig) -> None:
        from coulombus.eds.drive_axis import axis_of
        from coulombus.eds.own_devices import identity_from_1018h, is_own
        from coulombus.host.cycle.controller import Controller
        from coulombus.host.cycle.output_limits import brake_limit
        from coulombus.host.setup.device_plan import device_plans
        from coulombus.host.setup.law_demand import cut_off, meanings_of
        from coulombus.host.setup.release import failure_of, release_of
        from coulombus.host.setup.settings import torque_limits
        from coulombus.rigs.devices import drive_axis_of
        from coulombus.rigs.draft.marks import guesses
        from coulombus.rigs.plan.rig_plan import plans

        self.rig = rig
        self.buses: dict[str, RigPlan] = plans(rig)
        self.fits = all(planned.fits for planned in self.buses.values())
        unfit = (planned for planned in self.buses.values() if not planned.fits)
        self.planned = next(unfit, self.buses[rig.channels[0]])
        self.limits: dict[str, int] = {}
        self.limited_by: dict[str, str] = {}
        devices: list[DevicePlan] = []
        self.by_mode: dict[str, list[DevicePlan]] = {}
        for axis in rig.axes:
            for mode in axis.mode:
                controller = Controller(axis, mode)
                self.limits[axis.prefix + mode] = controller.drive_limit_pm()
                number = drive_axis_of(axis.motor)
                further = axis_of(axis.allocation.bound["torque_setpoint"].entry.index) not in (0, number)
                limits = () if further else torque_limits(axis.description("motor"), number)
                named = [f"{index:04X}h" for index in limits]
                self.limited_by[axis.prefix + mode] = " and ".join(named) or "(of the host alone)"
                bring_up = device_plans(controller)
                self.by_mode.setdefault(mode, []).extend(bring_up)
                devices += bring_up
        # each mode has its own limit
        self.problems = _once(problem for device in devices for problem in device.problems)
        self.questions: list[str] = _once(text for device in devices for text in device.questions)
        self.losses: list[str] = _once(text for device in devices for text in device.losses)
        self.reactions: list[Reaction] = _once(reaction for device in devices for reaction in device.reactions)
        self.releases = [
            release_of(
                axis,
                brake_limit(axis)[0],
                axis.brake.ramp_s if is_own("brake", identity_from_1018h(axis.description("brake"))) else 0.0,
            )
            for axis in rig.axes
        ]
        self.failures = [failure_of(axis) for axis in rig.axes if "active" in axis.mode and not axis.joint]
        self.meanings: list[str] = _once(
            text for axis in rig.axes for mode in axis.mode for text in meanings_of(axis, mode)
        )
        self.cut: list[str] = _once(text for mode in rig.modes for text in cut_off(rig, mode))
        self.tip = _tip_lines(rig)
        self.guesses = guesses(rig.origin.text)
        self.diagnoses = [str(d) for node in rig.nodes for d in node.description.diagnoses]
        self.ok = self.fits and not self.problems and not self.cut

    def _steps(self) -> list[dict[str, Any]]:
        from coulombus.host.setup.device_plan import steps_of

        mode = self.rig.modes[-1]
        return [
            {
                "device": plan.name,
                "object": f"{step.index:04X}h:{step.subindex:02X}",
                "value": step.value,
                "bits": step.variable(plan.description).bits,
                "why": step.why,
                "only_if_different": step.unless_equal,
                "verified": step.verify,
            }
            for plan, step in steps_of(self.by_mode[mode])
        ]

    def document(self, steps: bool) -> dict[str, Any]:
        """Return everything for ``--json``."""
        planned = self.planned
        document = {
            "rig": self.rig.name,
            "ok": self.ok,
            "cut_off": self.cut,
            "diagnoses": self.diagnoses,
            "bitrate_bit_s": planned.timing.bitrate_bit_s,
            "period_s": planned.timing.period_ns * 1e-9,
            "busy_s": planned.busy_ns * 1e-9,
            "utilisation": planned.busy_ns / planned.timing.period_ns,
            "fits": self.fits,
            "late": list(planned.reasons),
            "latest_rpdo_s": planned.latest_rpdo_ns * 1e-9,
            "motor_limit_per_mille": self.limits,
            "problems": [problem._asdict() for problem in self.problems],
            "questions": self.questions,
            "guesses": [
                guess._asdict() | {"file": self.rig.path, "moves_hand": guess.moves_hand} for guess in self.guesses
            ],
            "losses": self.losses,
            "reactions": [reaction._asdict() for reaction in self.reactions],
            "releases": [release._asdict() | {"gentle": release.is_gentle} for release in self.releases],
            "motor_failures": [failure._asdict() for failure in self.failures],
            "limits": self.meanings,
            "accepted": list(self.rig.host.accept),
            "roles": [
                {
                    "role": binding.kind.name,
                    "node": axis.prefix + binding.node,
                    "object": f"{binding.entry.index:04X}h:{binding.entry.subindex:02X}",
                    "bits": binding.entry.bits,
                    "scale": binding.scale,
                    "unit": binding.kind.unit,
                    "decided_by": binding.decided,
                }
                for axis in self.rig.axes
                for binding in axis.allocation.bound.bindings
            ],
            "frames": [
                {"name": m.name, "can_id": m.can_id, "bytes": m.length, "bits": m.bits}
                for bus in self.buses.values()
                for m in bus.cyclic
            ],
        }
        return document | ({"steps": self._steps()} if steps else {})

    def show(self, steps: bool) -> None:
        """Print everything as text."""
        from coulombus.host.laws.plane.plane_laws import builtin_laws
        from coulombus.rigs.draft.draft_text import CHECK

        for text in self.diagnoses:
            echo(text)
        self._tell_pdos()
        self._tell_buses()
        if steps:
            echo(f"\nbring-up in mode {self.rig.modes[-1]}:")
            for step in self._steps():
                when = " if it differs" if step["only_if_different"] else ""
                value = f"{step['value']:#x} ({step['bits']} bits){when}"
                echo(on_terminal(f"  {step['device']:<12} {step['object']} := {value}  {step['why']}", 15))
        self._tell_reactions()
        echo("")
        for release in self.releases:
            echo(on_terminal(f"release: {release}", 4, PROSE))
            if not release.is_gentle:
                echo(on_terminal(f"  that throws the hand: {GENTLER}", 4, PROSE))
        for failure in self.failures:
            echo(on_terminal(f"release: {failure}", 4, PROSE))
        for text in self.meanings:
            echo(on_terminal(f"limit: {text}", 4, PROSE))
        for text in self.tip:
            echo(on_terminal(text, 4))
        for mode, limit in self.limits.items():
            echo(f"mode {mode}: drive torque limit {self.limited_by[mode]} = {limit} per mille")
        if self.rig.law_function.strip() not in builtin_laws(self.rig):
            unknown = "what a limit cuts off of it is not known before it runs; the run tells"
            echo(on_terminal(f"law {self.rig.law_function}: {unknown}", 4))
        for text in self.rig.host.accept:
            echo(on_terminal(f"accepted: {text}", 4))
        for text in self.losses:
            echo(on_terminal(f"lost: {text}", 4))
        for text in self.questions:
            echo(on_terminal(f"open: {text}", 4))
        for problem in (*self.problems, *self.cut):
            echo(on_terminal(f"FAIL: {problem}", 4))
        for planned in self.buses.values():
            if not planned.fits:
                echo(on_terminal(f"FAIL: {planned.verdict()}", 4))
        for guess in self.guesses:
            refused = "; `run` refuses a real bus until it is gone" if guess.moves_hand else ""
            echo(on_terminal(f"{CHECK}: {self.rig.path}:{guess.line}: {guess}{refused}", 4, PROSE))
        if self.ok:
            echo(on_terminal(self._verdict(), 4, PROSE))

    def _verdict(self) -> str:
        """Return "ok", or items that permit a rehearsal but not a real run yet: guesses, losses, questions."""
        if not self.guesses and not self.losses:
            return "ok, if the devices answer what is open above" if self.questions else "ok"
        lines = ("line " if len(self.guesses) == 1 else "lines ") + ", ".join(str(guess.line) for guess in self.guesses)
        parts = (
            (len(self.guesses), "guess", "guesses", f" unproved ({lines})"),
            (len(self.losses), "protection", "protections", " lost"),
            (len(self.questions), "question", "questions", " to the devices open"),
        )
        return "ok to rehearse: " + ", ".join(
            f"{count} {single if count == 1 else several}{state}" for count, single, several, state in parts if count
        )

    def _tell_pdos(self) -> None:
        decided = {
            axis.prefix + binding.kind.signal: binding.decided
            for axis in self.rig.axes
            for binding in axis.allocation.bound.bindings
            if binding.decided
        }
        columns = columns_of(sys.stdout) or PROSE
        for pdo in self.rig.pdos():
            echo(
                f"\n{pdo.node} {pdo.name}, COB-ID {pdo.layout.cob_id:03X}h, transmission type {pdo.layout.transmission}"
                + (", its map is fixed" if pdo.fixed else "")
            )
            echo(pdo.layout.diagram(columns))
            for signal in pdo.signals:
                unit = f" {signal.unit}" if signal.unit else ""
                by = f"  by {decided[signal.name]}" if signal.name in decided else ""
                echo(on_terminal(f"  {signal.name:<28} = raw x {signal.scale:.9g}{unit}{by}", 6, PROSE))

    def _tell_buses(self) -> None:
        for planned in self.buses.values():
            echo(f"\nworst case on the wire at {planned.timing.bitrate_bit_s / 1e6:g} Mbit/s:")
            for m in planned.cyclic:
                echo(f"  {m.can_id:03X}h  {m.name:<14} {m.length} bytes  {m.bits:>4} bits")
            busy, period = planned.busy_ns, planned.timing.period_ns
            echo(f"  together {busy / 1e3:.0f} us of each {period / 1e3:.0f} us: {busy / period:.1%}")
            echo(f"  the latest RPDO is through {planned.latest_rpdo_ns / 1e3:.0f} us after SYNC (coulombus plan)")

    def _tell_reactions(self) -> None:
        if self.reactions:
            echo("\nwhen the host is lost:")
        for reaction in self.reactions:
            within = f"within {reaction.within_s:g} s by {reaction.who}" if reaction.who else "nobody notices"
            off = "" if reaction.safe_s is None else f" within {reaction.safe_s:g} s"
            echo(on_terminal(f"  {reaction.device:<12} {reaction.fault:<10} {within}: {reaction.what}{off}", 26, PROSE))
