"""The controllers of all axes of one cycle, on one array of AXIS records.

`host.cycle.axes` and the data plane work on this array.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.hand_over import end_together
from coulombus.host.cycle.records import AxisRecord, AxisRecords, Phase, SignResult, Trip
from coulombus.host.laws.law import LawFunction
from coulombus.host.laws.laws import load_law
from coulombus.host.plane.plane_host import load_plane, new_plane_host
from coulombus.kernels.records import Records, new_records
from coulombus.rigs.rig import Rig

__all__ = ["EVERY_BUS", "Controllers", "unused_law"]

EVERY_BUS = -1
"""Bus of an identifier that the host sends on each of its buses."""


def unused_law() -> LawFunction:
    """Return a compiled law as an argument for kernels that are called without a host."""
    return load_law("coulomb")


class Controllers:
    """One `Controller` for each axis of `rig`, which one host serves in one cycle (`Rig.one_cycle`).

    Attributes
    ----------
    each : tuple of Controller
        Each works on a row of `axes`.
    axes : array of AXIS; `control`, `host` and `rpdos` are views of its parts, whose first index is
        the axis
    owner : int64 array of 2048, the axis of each identifier
    bus_of : int64 array of 2048, the bus of each identifier, in the order of `Rig.channels`; `EVERY_BUS` for what the
        host sends on all of them: SYNC, NMT commands, its heartbeat
    law_function : the compiled law, one for all axes
    plane_model, arm : law and mechanism of a rig whose axes are the joints of one arm, and their compiled
        functions; else None

    Raises
    ------
    coulombus.rigs.rig.RigError
        the law cannot be loaded, or the drive cannot take a limit
    """

    def __init__(self, rig: Rig, mode: str) -> None:
        if not rig.one_cycle:
            raise ValueError(f"the axes hang on the buses {', '.join(rig.channels)}; take those of one with Rig.on")
        self.rig, self.mode = rig, mode
        self.plane_model = model = load_plane(rig, mode)
        self.arm = None if model is None else model.functions
        law = None if model is None else model.law
        self.each = tuple(Controller(axis, mode, law if k == 0 else None) for k, axis in enumerate(rig.axes))
        self.law_function = self.each[0].law_function
        for controller in self.each[1:]:  # the first axis sends SYNC and the heartbeat
            controller.control["sync_cob_id"] = -1
            controller.control["heartbeat_ns"] = 0
        end_together([controller.control for controller in self.each])
        self.owner = np.zeros(2048, np.int64)
        self.bus_of = np.full(2048, EVERY_BUS, np.int64)
        for k, controller in enumerate(self.each):
            identifiers = list(controller.can_ids())
            self.owner[identifiers] = k
            self.bus_of[identifiers] = rig.channels.index(rig.axes[k].bus.channel)
        if model is not None:
            self.each[0].records["plane"] = new_plane_host(rig, mode, model)
        self.adopt(new_records(AxisRecord, len(self.each)))

    def adopt(self, axes: AxisRecords) -> None:
        """Move to another array of the same shape, such as shared memory; the present state is copied."""
        for k, controller in enumerate(self.each):
            axes[k : k + 1] = controller.records
            controller.records = axes[k : k + 1]
        self.axes = axes

    def rename(self, rig: Rig) -> None:
        """Replace the rig by `rig`, which may differ only in `rigs.axis.NO_DEVICES`."""
        self.rig = rig
        for controller, axis in zip(self.each, rig.axes, strict=True):
            controller.axis = axis

    @property
    def control(self) -> Records:
        """Limits and scales of all axes."""
        return self.axes["control"]

    @property
    def host(self) -> Records:
        """State of the cycle of all axes."""
        return self.axes["host"]

    @property
    def rpdos(self) -> Records:
        """PDOs that the host sends for all axes; the second index is the PDO."""
        return self.axes["rpdos"]

    @property
    def own_identifiers(self) -> tuple[int, ...]:
        """Identifiers of the frames that the cycle sends: SYNC, the host's heartbeat, the RPDOs."""
        c = self.control[0]
        rpdos = (int(pdo["cob_id"]) for controller in self.each for pdo in controller.rpdos if pdo["cob_id"] >= 0)
        return (int(c["sync_cob_id"]), CobId.HEARTBEAT + int(c["host_id"]), *rpdos)

    def __iter__(self) -> Iterator[Controller]:
        return iter(self.each)

    def start(self, t_ns: int) -> None:
        """Begin with the first cycle at `t_ns`."""
        for controller in self.each:
            controller.start(t_ns)

    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Request the safe state for all axes."""
        for controller in self.each:
            controller.stop(trip)

    @property
    def ending(self) -> bool:
        """Whether an axis is in its safe state or a later phase."""
        return any(controller.phase >= Phase.SAFE for controller in self.each)

    @property
    def safe(self) -> bool:
        """Whether all axes are in their safe state or a later phase."""
        return all(controller.phase >= Phase.SAFE for controller in self.each)

    @property
    def safe_ns(self) -> int | None:
        """Time at which the first axis entered its safe state; None before."""
        return min((int(k.host["trip_ns"][0]) for k in self if k.phase >= Phase.SAFE), default=None)

    @property
    def done(self) -> bool:
        """Whether all axes are disabled."""
        return all(controller.phase is Phase.DONE for controller in self.each)

    @property
    def enabled_ns(self) -> int | None:
        """Time at which the last axis entered Operation Enabled; None before."""
        at = [int(controller.host["enabled_ns"][0]) for controller in self.each]
        return None if min(at) < 0 else max(at)

    @property
    def arming_s(self) -> float:
        """Longest time of any axis from the first cycle to Operation Enabled [s].

        An axis that takes longer trips.
        """
        return max(self._seconds(k, "still_timeout_cycles", "enable_timeout_cycles") for k in self)

    @property
    def ending_s(self) -> float:
        """Longest time of any axis from the request to end, or its trip, to the end of its brake's ramp [s]."""
        return max(self._seconds(k, "rise_cycles", "fade_cycles", "safe_longest_cycles") for k in self)

    @staticmethod
    def _seconds(controller: Controller, *cycles: str) -> float:
        return float(
            sum(int(controller.control[name][0]) for name in cycles) * controller.control["period_ns"][0] * 1e-9
        )

    @property
    def sign_result(self) -> SignResult:
        """Outcome of the sign check: of several axes, the worst."""
        return max(controller.sign_result for controller in self.each)

    @property
    def tripped(self) -> Controller | None:
        """The axis that tripped first; None if none did.

        An axis that tripped because of another axis (`Trip.OTHER_AXIS`) is returned only if no axis of this
        bus has a reason of its own.
        """
        tripped = [k for k in self.each if k.host["trip"][0] != Trip.NONE]
        return min(
            tripped, key=lambda k: (k.host["trip"][0] == Trip.OTHER_AXIS, int(k.host["trip_ns"][0])), default=None
        )

    @property
    def trip(self) -> str | None:
        """Text of the reason for the safe state, with the axis' name in a rig of several axes, or None."""
        first = self.tripped
        if first is None:
            return None
        return f"axis {first.axis.name}: {first.trip}" if first.axis.name else first.trip

    def plane_figures(self) -> dict[str, Any] | None:
        """Return the figures of an arm in the plane: each motor's net work on its joint [J], the energy that motors,
        brakes and friction absorbed together [J], the cycles in which the motors were held back to stay passive, and
        the smallest condition of the Jacobian; None for independent axes.
        """
        if self.arm is None:
            return None
        h = self.axes["plane"][0]
        names = self.rig.axis_names
        return {
            "motor_work_J": {name: float(work) for name, work in zip(names, h["split"]["motor_J"], strict=True)},
            "absorbed_J": float(h["split"]["taken_J"]),
            "withheld_cycles": int(h["split"]["withheld"]),
            "smallest_condition": float(h["smallest_condition"]),
        }

    @property
    def trip_ns(self) -> int:
        """Time of the first trip; 0 without a trip."""
        first = self.tripped
        return 0 if first is None else int(first.host["trip_ns"][0])

    def counters(self) -> dict[str, int]:
        """Return the cycles' counters, summed over all axes."""
        each = [controller.counters() for controller in self.each]
        return {name: sum(counters[name] for counters in each) for name in each[0]}
