r"""Effect of CANopen: section 4's limit cycle through bus, nodes and PDOs, measured from the recording.

The loop of the paper acts at the sampling instant. Over a bus this is impossible: 6064h is sampled
at SYNC and sent in a TPDO, and the resulting set-point is sent in an RPDO, which acts on the next
SYNC (`next_sync`: one cycle, exactly) or on arrival (`on_reception`: the frames' time on the wire).
The recording's stamps give the delay :math:`\tau` and the frequency.

Two rigs run. `coulombus/rigs/paper.toml` is section 4's plant with 0.1 um per count and no lag: its
limit cycle must equal the sampled loop's with that delay. The second is the same plant with the
bench's encoder (80 urad per count) and the bench's motor lag (1 ms). It is *not* on that curve, for
two reasons:

- a lag :math:`\tau_m` adds the phase :math:`-\arctan(\omega\tau_m)`, so the crossing of
  :math:`-1/\Psi` moves to :math:`\omega(T + \tau) + \arctan(\omega\tau_m) \approx \pi/2`: a slower
  and a larger cycle;
- with a coarse encoder v^ is a whole number of counts per cycle, and it is 0 for many successive
  cycles if the cycle's amplitude :math:`a T` is only a few counts. Then sgn(0) = 0 removes the
  torque: the relay has a dead zone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.analysis.rig.maps import LoopParameters, simulate_point
from coulombus.analysis.rig.runs import displayed, need_modes
from coulombus.eds.cia301 import CobId
from coulombus.recording.measures import velocity
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig, load_rig

__all__ = [
    "ACTUATIONS",
    "BENCH_HARDWARE",
    "BusCycle",
    "MeasuredDelay",
    "bus_cycle",
    "loop_delay",
    "through_bus",
    "with_bench_hardware",
]

Floats: TypeAlias = npt.NDArray[np.float64]

ACTUATIONS = ("next_sync", "on_reception")
BENCH_HARDWARE = "bench encoder and motor lag"
SETTLE_S, WINDOW_S = 2.5, 2.0
"""Omitted time at the beginning (gain ramp, transient), and length of the measured window."""

COULOMB = "coulomb"
TAP_M_S = 0.05


@dataclass(frozen=True)
class MeasuredDelay:
    """Delay from sampling (SYNC has ended) to actuation [s], over the cycles of a recording."""

    median_s: float
    smallest_s: float
    largest_s: float


@dataclass(frozen=True)
class BusCycle:
    """The limit cycle of one run, from decoded TPDOs, with f_h = 0."""

    hardware: str
    actuation: str
    delay_s: float
    """Median, from sampling to actuation."""
    delay_range_s: tuple[float, float]
    frequency_Hz: float
    """Half the sign changes of the non-zero v^ per second; 0 if quiet."""
    loop_frequency_Hz: float
    """Frequency of `analysis.theory.sampled_loop`: no bus, but the same delay, encoder and lag."""
    amplitude_m_s: float
    """sqrt(2) std of v^: the amplitude of a sine."""
    count_m: float
    """Encoder resolution at the handle [m]."""
    motor_lag_s: float
    t_s: Floats
    v_m_s: Floats
    """v^ over the measured window."""
    force_N: Floats
    """Motor's force from the drive (6077h), at the same samples."""

    def row(self) -> dict[str, Any]:
        """Return the row of `coulombus analyse --json`."""
        return {
            "actuation": self.actuation,
            "delay_s": self.delay_s,
            "frequency_Hz": self.frequency_Hz,
            "amplitude_m_s": self.amplitude_m_s,
            "delay_range_s": list(self.delay_range_s),
            "loop_frequency_Hz": self.loop_frequency_Hz,
            "hardware": self.hardware,
        }


def loop_delay(recording: Recording, begin_s: float = 0.0, end_s: float = float("inf")) -> MeasuredDelay:
    """Return the delay from sampling to actuation, from the frames' stamps alone.

    The nodes sample when a SYNC has ended on the wire. The response is the next RPDO to the motor;
    it acts at its end (transmission type 254, 255) or at the end of the following SYNC (types 0 to
    240). The host's additional delay (`bus.delay_cycles`) is added.

    Raises
    ------
    ValueError
        there is no SYNC with a response in the span
    """
    pdo = next(p for p in recording.rig.pdos() if p.node == "motor" and p.layout.direction == "rpdo")
    t_ns = recording.frames["t_ns"] - recording.epoch_ns
    inside = (t_ns >= begin_s * 1e9) & (t_ns <= end_s * 1e9)
    can_ids = np.asarray(recording.frames["can_id"])
    syncs = np.asarray(t_ns[inside & (can_ids == CobId.SYNC)], np.int64)
    answers = np.asarray(t_ns[inside & (can_ids == pdo.layout.cob_id)], np.int64)
    if len(syncs) < 3 or not len(answers):
        raise ValueError(
            f"{recording.path}: no SYNC frame with an answering set-point from {begin_s:g} s to {end_s:g} s"
        )
    answers = answers[answers > syncs[0]]
    sampled = np.searchsorted(syncs, answers) - 1  # the SYNC before each response
    if pdo.layout.transmission <= 240:
        followed = sampled + 1 < len(syncs)
        delays = syncs[sampled[followed] + 1] - syncs[sampled[followed]]
    else:
        delays = answers - syncs[sampled]
    delays = delays + (recording.rig.bus.cycles_to_actuation - 1) * recording.rig.bus.period_ns
    return MeasuredDelay(float(np.median(delays)) * 1e-9, float(np.min(delays)) * 1e-9, float(np.max(delays)) * 1e-9)


def reversal_frequency_Hz(t_s: Floats, values: Floats) -> float:
    """Return half the sign changes of the non-zero values per second, from the first change to the
    last; 0 with fewer than two.
    """
    moving = values != 0
    changed = np.flatnonzero(np.diff(np.sign(values[moving])))
    if len(changed) < 2:
        return 0.0
    at = t_s[moving][changed + 1]
    return float(0.5 * (len(changed) - 1) / (at[-1] - at[0]))


def loop_frequency_Hz(axis: Axis, delay_s: float) -> float:
    """Return the frequency of the same loop without a bus, with the measured delay of the bus."""
    base = LoopParameters.of_axis(axis, "active", relay=axis.law.function == COULOMB)
    point = replace(base, delay_s=delay_s, tap_rad_s=TAP_M_S, settle_s=SETTLE_S, window_s=WINDOW_S)
    return simulate_point(point).frequency_Hz


def bus_cycle(
    rig: Rig, hardware: str, *, settle_s: float = SETTLE_S, window_s: float = WINDOW_S, seed: int = 0
) -> BusCycle:
    """Run `rig` in mode active with a resting hand (f_h = 0) and measure the limit cycle from its
    recording.

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        the run tripped; the reason is in the text
    coulombus.rigs.rig.RigError
        the rig has no mode active
    """
    need_modes(rig, "active")
    at_rest = rig.variant(f'phase=[{{kind="rest", duration_s={settle_s + window_s + 0.5}}}]')
    with tempfile.TemporaryDirectory(prefix="coulombus-") as directory:
        what = f"limit cycle ({hardware}, {rig.bus.actuation})"
        recording = read(displayed(at_rest, "active", Path(directory) / "run.pcapng", what, seed=seed))
    start = next(t for t, text in recording.markers if text.startswith("phase "))
    begin, end = start + settle_s, start + settle_s + window_s
    delay = loop_delay(recording, begin, end)
    angle = recording["motor.position_rad"]
    torque = recording["motor.torque_Nm" if recording.has("motor.torque_Nm") else "motor.target_torque_Nm"]
    t, v = velocity(angle.t_s, angle.values, rig.bus.period_s)
    inside = (t >= begin) & (t < end)
    return BusCycle(
        hardware=hardware,
        actuation=rig.bus.actuation,
        delay_s=delay.median_s,
        delay_range_s=(delay.smallest_s, delay.largest_s),
        frequency_Hz=reversal_frequency_Hz(t[inside], v[inside]),
        loop_frequency_Hz=loop_frequency_Hz(rig.one_axis(), delay.median_s),
        amplitude_m_s=float(np.sqrt(2) * np.std(v[inside])),
        count_m=abs(recording.scale("motor.position_rad")),
        motor_lag_s=rig.one_axis().simulation.plant.motor_lag_s,
        t_s=t[inside] - begin,
        v_m_s=v[inside],
        force_N=np.interp(t[inside], torque.t_s, torque.values),
    )


def with_bench_hardware(rig: Rig, bench: Rig | None = None) -> Rig:
    """Return `rig` with the encoder resolution at the handle and the motor lag of the bench rig."""
    bench_plant = (load_rig("bench") if bench is None else bench).one_axis().simulation.plant
    counts = round(bench_plant.encoder_counts_rev * bench_plant.ratio / rig.one_axis().simulation.plant.ratio)
    return rig.variant(
        f"plant.encoder_counts_rev={counts}",
        f"motor.encoder_counts_rev={counts}",
        f"plant.motor_lag_s={bench_plant.motor_lag_s}",
        "limits.sign_check_counts=20",
    )


def through_bus(
    rig: Rig | None = None,
    *,
    actuations: Sequence[str] = ACTUATIONS,
    bench: bool = True,
    progress: Callable[[float], None] | None = None,
) -> tuple[BusCycle, ...]:
    """Return the limit cycle through bus and PDOs for each actuation, then the same with the
    bench's encoder and motor lag.

    Parameters
    ----------
    rig : the plant; default `coulombus/rigs/paper.toml`
    bench : also run the second curve, with `BENCH_HARDWARE`
    progress : called with the finished share, 0 to 1
    """
    rig = load_rig("paper") if rig is None else rig
    if rig.bus.cycles_to_actuation > 1:  # whole cycles, which need actuation on the next SYNC
        actuations = [actuation for actuation in actuations if actuation == "next_sync"]
    plants = [(f"rig {rig.name}", rig)] + ([(BENCH_HARDWARE, with_bench_hardware(rig))] if bench else [])
    cycles: list[BusCycle] = []
    for hardware, plant in plants:
        for actuation in actuations:
            cycles.append(bus_cycle(plant.variant(f"bus.actuation={actuation}"), hardware))
            if progress is not None:
                progress(len(cycles) / (len(plants) * len(actuations)))
    return tuple(cycles)
