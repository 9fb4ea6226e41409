"""Complete rig in virtual time: bus, nodes, plants, hands, the host's cycle and its control-plane link.

`VirtualRig` is a `VirtualNetwork` of the devices of each axis, with the rig's mechanics between
them. Nothing sleeps, and the same seed gives the same bytes. The rows of the devices are motor and
brake of each axis, then the sensors.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from coulombus.eds.cia305 import UNCONFIGURED
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.models import Models
from coulombus.host.cycle.parameter_changes import OVER_S, Change, LiveParameters
from coulombus.host.cycle.records import Trip
from coulombus.kernels.records import RecordArray, Records, new_records
from coulombus.node.device import Device
from coulombus.recording.trace import EVENT, Event
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.can_bus.cable_cut import assign
from coulombus.sim_bus.network import device_faults
from coulombus.sim_bus.network.attached_axes import AttachedAxes
from coulombus.sim_bus.network.event_loop import BRAKE, MOTOR, TOLD_FRAMES, Exit, HostCycle
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.rig.arm_plant import PLANE_COLUMNS, new_plane_plant
from coulombus.sim_bus.rig.operator import KNOT_S, Operator
from coulombus.sim_bus.rig.plane_hand import PlaneHand
from coulombus.sim_bus.rig.plant import TRUTH_COLUMNS, new_plant, truth_columns
from coulombus.sim_bus.rig.plant_step import course_of
from coulombus.sim_bus.rig.records import AXIS, NOT_BEGUN, PlantRecord, RigAxis
from coulombus.sim_bus.rig.stand_ins import couple, stand_ins
from coulombus.wire.bus_link import BusFrame
from coulombus.wire.clock import own_ns, set_clock
from coulombus.wire.frame import Frame

__all__ = ["VirtualRig"]

BLOCK_KNOTS = 8000
TRUTH_BLOCK_KNOTS = 500  # a smaller block of the true course saves memory
SEED_STEP = 1_000_003  # difference of the noise seeds of two axes
BOOT_NS = 1_000_000  # power-on to the first SDO: both boot-ups have been sent


class Planned(Protocol):
    """A scheduled action on the rig (`sim_bus.network.script.Entry`)."""

    @property
    def t_ns(self) -> int:
        """Time of the action, counted from `after`."""

    @property
    def after(self) -> str:
        """Reference of the time: "start" or "enabled"."""

    def act(self, world: Any) -> None:
        """Perform the action now."""


class VirtualRig(VirtualNetwork):
    """Bus, nodes, plant, hand and host of `rig` in mode `mode`.

    Parameters
    ----------
    believed : rig file of the host, if different from `rig`: same bus and nodes, other assumed values
    seed : starts the transducer's noise
    on_frames : called with each batch of sent frames (FRAME records, end-of-frame stamps)
    truth : store the plant's true course (`truth()` returns it)
    tip : store the true course of an arm's tip (`tip_course()` returns it), a row for each millisecond
    numbered : the devices have the rig's node ids; otherwise none, and wait for an LSS master
    """

    def __init__(
        self,
        rig: Rig,
        mode: str,
        *,
        believed: Rig | None = None,
        seed: int = 0,
        on_frames: Callable[[Records], None] | None = None,
        truth: bool = False,
        tip: bool = False,
        numbered: bool = True,
    ) -> None:
        self.mode = mode
        host_rig = believed or rig
        self.sdo_timeout_s = host_rig.host.sdo_timeout_s
        self.controllers = Controllers(host_rig, mode)
        self.controller = self.controllers.each[0]
        self._heard: deque[BusFrame] = deque()  # SDO responses
        self._events = list[tuple[int, ...]]()
        self.on_host: Callable[[Records, Records, Records], None] | None = None
        """Called with each batch, after `on_frames`: which of its frames the host received, rows of
        `recording.trace.EVENT`, frames that the host requested.
        """
        self.parameters = LiveParameters(self.controllers)
        self.models = Models(self.controllers, self.parameters)
        self.on_change: Callable[[Change], None] | None = None
        """Called with each change of a parameter."""
        self._waiting: list[Planned] = []

        n = len(rig.axes)
        tip = tip and rig.in_plane is not None
        knots = TRUTH_BLOCK_KNOTS if truth or tip else BLOCK_KNOTS
        axes, plant = new_records(RigAxis, n), new_records(PlantRecord, n)
        self._axes = axes.view(np.ndarray)  # read often in Python: a recarray looks each field up in Python
        self._f_h = np.zeros((n, knots + 1))
        self._initialise(rig, plant, seed)
        self._axes["truth_on"] = truth or tip
        self._every = 1 if truth or not tip else int(self._axes["steps_per_knot"][0])
        """Steps of the plant for each stored row of its true course."""
        steps = knots * int(self._axes["steps_per_knot"].max())
        self._columns = [
            truth_columns(axis.simulation.plant) if rig.in_plane is None else (*TRUTH_COLUMNS, *PLANE_COLUMNS)
            for axis in rig.axes
        ]
        self._truth_block = np.zeros((n, steps if truth or tip else 1, max(map(len, self._columns))))
        self._truth: list[list[Any]] = [[] for _ in range(n)]
        k = self.controllers
        self._told = new_records(Frame, TOLD_FRAMES)
        devices = [stand_ins(axis) for axis in rig.axes]
        # axes may share a sensor
        sensors = {sensor.node_id: (a, sensor) for a, group in enumerate(devices) for sensor in group[2:]}
        axis_of = np.array([*(np.arange(2 * n) // 2), *(a for a, _ in sensors.values())], np.int64)
        super().__init__(
            tuple(bus.bitrate_bit_s for bus in rig.buses),
            capacity=len(axis_of),
            on_frames=on_frames,
            mechanics=AttachedAxes(
                *(axes, axis_of, plant, self._f_h, self._truth_block),
                *(HostCycle(k.axes, k.owner, self._told), k.law_function, k.arm),
            ),
        )
        self.nodes["coil_A_Nm"][self._axes["brake"]] = [axis.brake.coil_A_Nm for axis in rig.axes]
        rows: dict[int, tuple[int, Device]] = {}
        actuators = [stand_in for group in devices for stand_in in group[:2]]
        for device in (*actuators, *(stand_in for _, stand_in in sensors.values())):
            added = self.add(device.served.description, device.node_id if numbered else UNCONFIGURED, device.profile)
            rows[device.node_id] = (len(rows), added)
            self.opened = (*self.opened, *(text for text in device.served.remarks if text not in self.opened))
        self._rows = [{stand_in.node: rows[stand_in.node_id] for stand_in in group} for group in devices]
        self.rows = {
            axis.prefix + node: row
            for axis, by_node in zip(rig.axes, self._rows, strict=True)
            for node, (row, _) in by_node.items()
        }
        """Row of each device by its name: ``motor``, ``brake``, a sensor's (``AXIS.motor`` with several axes)."""
        if len(rig.buses) > 1:
            assign(self.bus, k.bus_of, [rig.channels.index(rig.axes[a].bus.channel) for a in axis_of])
        self.motor, self.brake = self.devices[MOTOR], self.devices[BRAKE]
        self._couple()

    def _initialise(self, rig: Rig, plant: RecordArray[PlantRecord], seed: int) -> None:
        """Initialise `plant` and the hands from `rig`."""
        n = len(rig.axes)
        self.rig = rig
        if rig.in_plane is None:
            self.operators: list[Operator | PlaneHand] = [
                Operator(axis, self.mode, seed + a * SEED_STEP) for a, axis in enumerate(rig.axes)
            ]
        else:
            model = self.controllers.plane_model
            static_N = 0.0 if model is None else model.peak_N
            self.operators = [PlaneHand(rig, static_N, direction, seed) for direction in range(n)]
        self._left: list[tuple[float, float] | None] = [None] * n
        """Schedules that ended early: start and end [s]."""
        self._had, self._truth_from = 0, [0] * n
        self._axes[:] = np.zeros(n, AXIS)
        self._axes["motor"], self._axes["brake"] = MOTOR + 2 * np.arange(n), BRAKE + 2 * np.arange(n)
        self._axes["operator_start_ns"] = NOT_BEGUN
        self._axes["steps_per_knot"] = [max(1, round(KNOT_S / axis.simulation.plant.step_s)) for axis in rig.axes]
        for a, axis in enumerate(rig.axes):
            plant[a : a + 1] = new_plant(axis, seed + a * SEED_STEP)
        if rig.in_plane is not None:
            plant["plane"][:1] = new_plane_plant(rig, seed)

    def _couple(self) -> None:
        """Connect the devices with the plants, and the hands with the plants."""
        for a, rows in enumerate(self._rows):
            couple(self.rig.axes[a], self._axes[a], self.plant[a], rows)
            self._new_force_block(a)

    def renew(self, rig: Rig, seed: int) -> None:
        """Restart at time 0 with the plants and hands of a `rig` that has the same devices.

        Bus, nodes and host are unchanged: `sim_bus.network.world_state.adopt` then sets their state.
        """
        self._world["t_ns"] = 0
        self._events = []
        self.controllers.rename(rig)
        self._initialise(rig, self.plant, seed)
        self._arguments = (*self._arguments[:3], course_of(self.plant), self._arguments[4])
        self._couple()

    # time

    @property
    def starts_ns(self) -> tuple[int | None, ...]:
        """Time at which each axis's drive entered Operation Enabled, which began its operator's schedule; None
        before. One hand that holds an arm begins with the last joint.
        """
        starts = tuple(None if start < 0 else start for start in self._axes["operator_start_ns"].tolist())
        return starts if self.rig.in_plane is None else (self.enabled_ns,) * len(starts)

    @property
    def enabled_ns(self) -> int | None:
        """Time at which the last axis's drive entered Operation Enabled, which began its operator's schedule; None
        before.
        """
        starts = self._axes["operator_start_ns"]
        return None if starts.min() < 0 else int(starts.max())

    @property
    def plain(self) -> bool:
        """Whether the rig has only devices and a host, and no frames were delivered yet."""
        return super().plain and not (self._waiting or self._events or self._had)

    # the kernel's exits

    def answer(self, why: int) -> None:
        """Handle an exit of the kernel (`sim_bus.network.event_loop.Exit`), at the present time."""
        if why in (Exit.FORCE, Exit.ENABLED):
            for a in self._together(int(self._world["axis"][0])):
                self._new_force_block(a)
            if why == Exit.ENABLED:
                for entry in self._waiting:
                    self.at(self.t_ns + entry.t_ns, entry.act)
                self._waiting = []
                if self.injection is not None:
                    self.injection.enabled(self.t_ns)
            self._actuate()
        else:
            super().answer(why)

    def _control_plane(self, t_ns: int, can_id: int, data: bytes) -> None:
        self._heard.append(BusFrame(t_ns, can_id, data, len(data)))

    def _together(self, a: int) -> Sequence[int]:
        """Return the axes whose hand is that of axis `a`: in the plane one hand holds the tip of all joints."""
        return range(len(self.operators)) if self.rig.in_plane is not None else (a,)

    def _new_force_block(self, a: int) -> None:
        """Compute the next block of the hand's force on axis `a`, from now on."""
        axis, plant, f_h = self._axes[a], self.plant[a], self._f_h[a]
        self._keep_truth(a)
        step = int(plant["t_ns"]) // int(plant["step_ns"])
        axis["force_step"] = step
        axis["force_end_ns"] = (step + (len(f_h) - 1) * int(axis["steps_per_knot"])) * int(plant["step_ns"])
        self._truth_from[a] = step
        knots = step + np.arange(len(f_h)) * int(axis["steps_per_knot"])
        t = np.asarray(knots * float(plant["h"]), np.float64)
        starts = self._axes["operator_start_ns"][list(self._together(a))]
        start = -1 if starts.min() < 0 else int(starts.max())
        if start >= 0:
            self._left[a] = None
        f_h[:] = self.operators[a].torque_Nm(t, *(self._left[a] or (None if start < 0 else start * 1e-9, None)))

    # data for a replay of the host besides the frames

    def record_messages(self) -> None:
        """Store the host's telemetry of each cycle from now on (`host.cycle.telemetry`)."""
        self._world["tells"] = 1

    def recorded_messages(self) -> Records:
        """Return the host's telemetry since the last call, valid until time passes."""
        count = int(self._world["told_count"][0])
        self._world["told_count"] = 0
        return self._told[:count].view(np.ndarray)

    def _note(self, event: Event, t_ns: int, value: int = 0) -> None:
        w = self._world[0]
        received = self._had + int(np.count_nonzero(w["had"][: w["log_count"]]))
        next_ns = min(int(h["next_ns"]) for controller in self.controllers for h in controller.host)
        self._events.append((t_ns, received, next_ns if w["host_on"] else 0, event, value))

    def flush(self) -> None:
        """Deliver the frames sent since the last call, and the host's actions meanwhile."""
        w = self._world[0]
        had = w["had"][: w["log_count"]].astype(bool)
        super().flush()
        if self.on_host is not None:
            self.on_host(had, np.array(self._events, EVENT), w["sent"][: w["sent_count"]])
        self._had += int(np.count_nonzero(had))
        w["had"][: len(had)] = w["sent_count"] = 0
        self._events = []

    # the control plane

    def now_ns(self) -> int:
        """Return the present time."""
        return self.t_ns

    def receive(self, until_ns: int) -> BusFrame | None:
        """Return the next SDO response to the host; time passes until it comes, or to `until_ns`."""
        if not self._heard and until_ns > self.t_ns:
            self.run_until(until_ns, lambda: bool(self._heard))
        return self._heard.popleft() if self._heard else None

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state in the node's last heartbeat."""
        for controller in self.controllers:
            for k, node in enumerate(controller.axis.devices):
                if controller.axis.part(node).node_id == node_id:
                    state = int(controller.host["nmt"][0, k])
                    return None if state < 0 else state
        return None

    # the rig

    def plan(self, script: Sequence[Planned]) -> None:
        """Schedule the entries of a script file; entries after Operation Enabled wait for it."""
        self._waiting = [entry for entry in script if entry.after == "enabled"]
        for entry in script:
            if entry.after == "start":
                self.at(entry.t_ns, entry.act)

    def inject(self, node: int, fault: str, present: bool) -> None:
        """Begin or end a fault of `sim_bus.network.device_faults.EFFECTS` in the node of a row."""
        device_faults.inject(self, node, fault, present)

    def boot(self) -> None:
        """Switch the nodes on, and wait until both boot-ups have been sent."""
        self.power_on()
        self.wait_ns(BOOT_NS)

    def start_host(self) -> None:
        """Begin the host's cycle at the next period boundary."""
        period = int(self.controller.control["period_ns"][0])
        start_ns = (int(own_ns(self.host_clock, self.t_ns)) // period + 1) * period
        self._note(Event.START, start_ns)
        self.controllers.start(start_ns)
        self._world["host_on"] = 1

    def ask_to_stop(self, trip: Trip = Trip.NONE) -> None:
        """Request the safe state from the host: the normal end, or for the reason `trip`."""
        self._note(Event.STOP, self.t_ns, trip)
        self.controllers.stop(trip)

    def set_parameters(self, values: Mapping[str, float], axis: str = "", over_s: float = OVER_S) -> Change:
        """Change parameters of the host's law and compensation, like ``coulombus set``.

        Raises
        ------
        coulombus.host.cycle.parameter_changes.ChangeRefused
            nothing has changed; the text says why
        """
        return self._want(self.parameters.change(values, axis, over_s))

    def undo_parameters(self, over_s: float = OVER_S) -> Change:
        """Undo the last change, like ``coulombus set --undo``."""
        return self._want(self.parameters.undo(over_s))

    def _want(self, change: Change) -> Change:
        self._note(Event.SET, self.t_ns, change.number)
        self.controllers.axes["live"]["wanted"][change.index] = change.number
        if self.on_change is not None:
            self.on_change(change)
        return change

    def render(self, model: Any) -> None:
        """Let the host render a `ModelRecord` from its next cycle on, like a program outside.

        Raises
        ------
        coulombus.host.world.model_check.ModelRefused
            the host never sees it; the text says why
        """
        axis = int(model["axis"])
        self._note(Event.MODEL, self.t_ns, self.models.publish_now(axis, self.models.write(model)))

    def set_host_clock(self, ppb: int) -> None:
        """Let the host's clock run fast by `ppb` (1e-9) from now on."""
        self._note(Event.CLOCK, self.t_ns, ppb)
        set_clock(self.host_clock, self.t_ns, ppb)

    @property
    def has_host(self) -> bool:
        """Whether the host is part of this world, and not a separate process."""
        return not self._world["host_elsewhere"][0]

    @property
    def host_clock(self) -> Any:
        """The record with the host's clock (`wire.clock`)."""
        return self._world.view(np.recarray)[0]

    def stop_host(self) -> None:
        """End the host's cycle at once, as if it had crashed: no safe set-points, no SYNC, no heartbeat."""
        self._world["host_on"] = 0

    # the true course

    def _keep_truth(self, a: int) -> None:
        if self._axes[a]["truth_on"]:
            begin = int(self._axes[a]["force_step"])  # first row of the block
            step = int(self.plant["t_ns"][a]) // int(self.plant["step_ns"][a])
            first = self._truth_from[a] + -self._truth_from[a] % self._every  # a row is the end of a step
            self._truth[a].append(self._truth_block[a, first - begin : step - begin : self._every].copy())
            self._truth_from[a] = step

    def truth(self, a: int = 0) -> Mapping[str, Any]:
        """Return the true course of the plant of axis `a` so far, an array for each of `plant.TRUTH_COLUMNS`, and
        of `detail.DETAIL_COLUMNS` if the plant has them.
        """
        self._keep_truth(a)
        table = np.concatenate(self._truth[a]) if self._truth[a] else np.zeros((0, self._truth_block.shape[2]))
        self._truth[a] = [table]
        return dict(zip(self._columns[a], table.T, strict=False))  # another axis may have more columns

    def tip_course(self) -> Mapping[str, Any]:
        """Return the true course of an arm's tip so far: time and `arm_plant.PLANE_COLUMNS`, a row for each millisecond."""
        every = max(1, int(self._axes["steps_per_knot"][0]) // self._every)
        return {name: column[::every] for name, column in self.truth(0).items() if name in ("t_s", *PLANE_COLUMNS)}
