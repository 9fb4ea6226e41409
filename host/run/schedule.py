"""The operator's schedule in a run: markers of its phases for each axis, and remarks on the display."""

from __future__ import annotations

from collections.abc import Iterator

from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.controllers import Controllers
from coulombus.rigs.rig import Rig

__all__ = ["PhaseMarks", "display_remarks", "full_gain_s"]

CLIPPED = {
    "clipped_torque": "the law asked more of the motor than its limit (mode.{mode}.motor_limit_Nm, the drive's 6072h)",
    "slowed_torque": "the law asked more of the motor than limits.torque_rate_Nm_s, or than it may near limits.speed_rad_s",
    "limited_by_drive": "the drive told of a limit of its own (statusword bit 11: 6072h, 6073h, 60E0h, 60E1h)",
    "withheld_compensation": "the motor gave less than its compensation, because the hand and the stored energy did not pay for it: "
    "there is less friction than mechanics.friction_Nm, a weaker brake than its scale says, or an elastic transmission; "
    "coulombus commission --step friction and --step brake tell which",
    "implausible_torque": "the hand felt another torque than the displayed one, by more than 0.3 of it: is the motor's or the brake's "
    "scale or sign wrong, or the transducer's? coulombus commission measures them",
    "clipped_setpoints": "the law asked more of the brake than its limit (limits.brake_torque_Nm, or 7300h:01 in its EDS file)",
    "slowed_setpoints": "the law let the brake go faster than limits.brake_fall_Nm_s",
}
"""Texts of the counters of cycles in which a limit changed the law's output."""


class PhaseMarks:
    """The markers "phase KIND" and "phase end" of every axis whose schedule has begun.

    With several axes the axis comes first, as in "left.phase hold".
    """

    def __init__(self, rig: Rig) -> None:
        self._axes = rig.axes
        self._waiting: list[tuple[int, str]] = []
        self._begun: set[int] = set()
        self._over = False
        self._open: set[str] = set()
        """Prefixes of the axes whose schedule has begun and not ended."""

    @property
    def begun(self) -> int:
        """Number of axes whose schedule has begun."""
        return len(self._begun)

    def begin(self, number: int, start_ns: int) -> None:
        """Begin the schedule of an axis at `start_ns`; further calls have no effect."""
        if number in self._begun or self._over:
            return
        self._begun.add(number)
        axis = self._axes[number]
        names = [phase.kind for phase in axis.phases] + ["end"]
        self._waiting += [
            (start_ns + round(start * 1e9), f"{axis.prefix}phase {name}")
            for start, name in zip(axis.phase_starts_s, names, strict=True)
        ]
        self._waiting.sort(key=lambda item: item[0])
        self._open.add(axis.prefix)

    def due(self, until_ns: int) -> Iterator[tuple[int, str]]:
        """Yield each marker before `until_ns`, once."""
        while self._waiting and self._waiting[0][0] < until_ns:
            t_ns, text = self._waiting.pop(0)
            if text.endswith("phase end"):
                self._open.discard(text.removesuffix("phase end"))
            yield t_ns, text

    def stop(self) -> None:
        """End the markers: the display is over."""
        self._over = True
        self._waiting.clear()
        self._open.clear()

    def end(self, t_ns: int) -> Iterator[tuple[int, str]]:
        """Yield "phase end" at `t_ns` for each schedule that has not ended."""
        still_open = [axis.prefix for axis in self._axes if axis.prefix in self._open]
        self.stop()
        for prefix in still_open:
            yield t_ns, f"{prefix}phase end"


def full_gain_s(controllers: Controllers) -> float | None:
    """Return the time from the start of an axis' schedule to the law's gain 1 [s], the largest of all axes;
    None: an axis never reached it.
    """
    times_s = [_full_gain_s(k) for k in controllers]
    return None if None in times_s else max(time_s for time_s in times_s if time_s is not None)


def _full_gain_s(controller: Controller) -> float | None:
    at, enabled = (int(controller.host[name][0]) for name in ("full_gain_ns", "enabled_ns"))
    return None if at < 0 or enabled < 0 else (at - enabled) * 1e-9


def display_remarks(controllers: Controllers) -> tuple[str, ...]:
    """Return the texts of deviations of the display from the rig file: a clipped law, a hand that began
    too early.
    """
    return tuple(text for k in controllers for text in (*_clipped(k), *_too_early(k)))


def _clipped(k: Controller) -> Iterator[str]:
    for name, what in CLIPPED.items():
        count = int(k.host[name][0])
        if count:
            cycles = "1 cycle" if count == 1 else f"{count} cycles"
            yield f"{_axis(k)}in {cycles} {k.axis.spell_keys(what.format(mode=k.mode))}: {name}"


def _too_early(k: Controller) -> Iterator[str]:
    """Yield a remark if the hand's first motion began before the law's gain was 1.

    The hand's schedule counts from Operation Enabled; the sign check and the ramp of the law's gain come
    after that.
    """
    moves = [
        (at, phase) for at, phase in zip(k.axis.phase_starts_s, k.axis.phases, strict=False) if phase.kind != "rest"
    ]
    if not moves or int(k.host["enabled_ns"][0]) < 0:
        return
    begins_s, phase = moves[0]
    full_s = _full_gain_s(k)
    displayed_s = int(k.host["display_cycles"][0]) * int(k.control["period_ns"][0]) * 1e-9
    if begins_s < displayed_s and (full_s is None or full_s > begins_s) and k.trip is None:
        when = "never" if full_s is None else f"after {full_s:.3f} s"
        yield (
            f"{_axis(k)}the law was shown whole {when}, and the schedule's phase {phase.kind} began after {begins_s:g} s: "
            + k.axis.spell_keys("a longer rest before it, or less of law.gain_ramp_s, shows all of it")
        )


def _axis(k: Controller) -> str:
    return f"axis {k.axis.name}: " if k.axis.name else ""
