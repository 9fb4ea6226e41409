"""Steps "zero" and "weight": zero, noise, sign and scale of the torque transducer.

Zero and noise are measured with a free handle, sign and scale with a known weight. The signal is the raw
counts times a scale plus an offset, both signed by the polarity. The step zero gives the offset; the step
weight gives scale and polarity. The motor has no torque in either step. While the weight hangs, the brake
holds the handle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from coulombus.host.commission.friction import FREE_HAND
from coulombus.host.commission.samples import handle_torque, mean_in, span_of, thinned
from coulombus.host.commission.step import (
    SCALE,
    CommissionError,
    Curve,
    Exercise,
    ExerciseResult,
    Finding,
    Given,
    Outcome,
    Risk,
    Step,
    exercise,
    lacks_roles,
    rounded,
)
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig
from coulombus.rigs.roles import Binding

__all__ = ["WeightStep", "ZeroStep"]

OFFSET, POLARITY = "role.handle_torque.offset_Nm", "mechanics.transducer_polarity"
ZERO_S = 4.0
REST_S, HANG_S, TAIL_S = 3.0, 9.0, 3.0
HANGING = "a weight that hangs still"
SETTLED_S = 3.0
"""Evaluated time at the end of a phase, when the operator has finished its action."""
HOLDS = 1.5
"""Factor from the weight's torque to the brake's set-point."""
HOLDS_NM = 0.5
"""Torque that is added to the brake's set-point [Nm]."""
LEAST_SHARE = 0.1


def _binding(axis: Axis) -> Binding:
    binding = axis.allocation.bound.get("handle_torque")
    assert binding is not None  # checked by `lacks`
    return binding


class ZeroStep(Step):
    """Zero and noise of the transducer."""

    name = "zero"
    title = "torque transducer: zero and noise"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role that the rig lacks, or None."""
        return lacks_roles(axis, "handle_torque")

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the risk: nothing moves."""
        return Risk("Nothing moves: the transducer is read.", seconds=ZERO_S)

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return a run without torque.

        With a large zero offset arming is refused (HANDLE_LOADED); the signal is recorded nevertheless.
        """
        rest = f'{{kind="rest", duration_s={ZERO_S}}}'
        return (exercise(self.name, rig, "hold", [0.0], [rest], hand=FREE_HAND, may_trip=("HANDLE_LOADED",)),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the offset that brings the mean to zero, and the noise."""
        series = handle_torque(runs[0].recording)
        binding, turned = _binding(axis), axis.mechanics.transducer_polarity
        span = float(series.t_s[0]), float(series.t_s[-1])
        mean = mean_in(series, *span, "the transducer's zero", abs(binding.scale))
        new = rounded((binding.offset - mean.value) * turned, mean.reach) + 0.0  # no -0
        reach = mean.reach
        basis = f"mean of {len(series)} samples without a hand at the handle"
        old = binding.offset * turned
        findings = (
            Finding(OFFSET, "transducer's zero", old, new, "Nm", reach, basis, changed=abs(new - old) > reach),
            Finding("", "transducer's noise, RMS", None, float(f"{mean.deviation:.3g}"), "Nm", None, basis),
        )
        curve = Curve(
            "Transducer at rest", "time [s]", "[Nm]", {"as it reads": (*thinned(series.t_s, series.values), "-")}
        )
        return Outcome(findings, curves=(curve,))


class WeightStep(Step):
    """Sign and scale of the transducer."""

    name = "weight"
    title = "torque transducer: sign and scale by a known weight"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role or the input that is missing, or None."""
        if inputs.weight_Nm is None:
            return "give --weight-Nm: the torque of a known weight at the handle, in its positive sense"
        if not 0 < inputs.weight_Nm <= axis.limits.brake_torque_Nm / HOLDS:
            largest_Nm = axis.limits.brake_torque_Nm / HOLDS
            bounds = f"expected above 0, at most {largest_Nm:.3g}, which the brake holds with a margin"
            return f"--weight-Nm {inputs.weight_Nm:g}: {bounds}"
        return lacks_roles(axis, "handle_torque")

    def _brake(self, axis: Axis, inputs: Given) -> float:
        return min(HOLDS * (inputs.weight_Nm or 0.0) + HOLDS_NM, axis.limits.brake_torque_Nm)

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the brake's torque and the operator's actions."""
        return Risk(
            "The brake holds the handle while the weight hangs on it.",
            brake_Nm=self._brake(axis, inputs),
            seconds=REST_S + HANG_S + TAIL_S,
            operator=f"Leave the handle free for {REST_S:g} s; then hang {inputs.weight_Nm or 0:g} Nm on it, "
            f"in the positive sense, and let it hang still for {HANG_S:g} s; take it off.",
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the run with the weight."""
        weight = inputs.weight_Nm or 0.0
        times, torques = [0.0, 1.0, HANG_S - 0.5, HANG_S], [0.0, weight, weight, 0.0]
        phases = (
            f'{{kind="rest", duration_s={REST_S}}}',
            f'{{kind="file", duration_s={HANG_S}, t_s={times}, torque_Nm={torques}}}',
            f'{{kind="rest", duration_s={TAIL_S}}}',
        )
        return (exercise(self.name, rig, "hold", [self._brake(rig.one_axis(), inputs)], phases, hand=FREE_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the scale and polarity with which the transducer reads the weight's torque."""
        recording, weight = runs[0].recording, inputs.weight_Nm or 0.0
        series = handle_torque(recording)
        rest, hang = span_of(recording, "rest"), span_of(recording, "file")
        binding, turned = _binding(axis), axis.mechanics.transducer_polarity
        count = abs(binding.scale)
        zero = mean_in(series, rest.begin_s + 1.0, rest.end_s, "the free handle", count)
        end = hang.end_s - 1.0
        loaded = mean_in(series, end - SETTLED_S, end, HANGING, count)
        difference = loaded.value - zero.value
        if abs(difference) < LEAST_SHARE * weight:
            raise CommissionError(
                f"the transducer shows {difference:.4f} Nm of the {weight:g} Nm: did the weight hang?"
            )
        factor = weight / abs(difference)
        polarity = turned if difference > 0 else -turned
        share = math.hypot(math.hypot(loaded.reach, zero.reach) / abs(difference), inputs.weight_reach_Nm / weight)
        reach = share * count * factor
        new = rounded(count * factor, reach)
        other = abs(factor - 1) > share
        basis = f"{weight:g} Nm reads {difference:.4f} Nm"
        findings = [
            Finding(POLARITY, "transducer's sign", turned, polarity, "", None, basis, changed=polarity != turned),
            Finding(SCALE, "transducer's scale", count, new, "Nm/count", reach, basis, changed=other),
        ]
        if other and binding.offset:
            offset = binding.offset * turned
            zero_reach = abs(offset) * factor * math.hypot(inputs.share(OFFSET), share)
            moved = rounded(offset * factor, zero_reach)
            stated = zero_reach if OFFSET in inputs.shares else None  # an offset of no step has no interval
            findings.append(Finding(OFFSET, "transducer's zero", offset, moved, "Nm", stated, "with the new scale"))
        curve = Curve("Weight", "time [s]", "[Nm]", {"as it read": (*thinned(series.t_s, series.values), "-")})
        return Outcome(tuple(findings), curves=(curve,))
