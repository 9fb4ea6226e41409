"""The whole rig in virtual time: bus, two nodes, plant and hand, the host's cycle, and `canopen` as its control plane.

`VirtualRig` owns the compiled kernel's arrays and answers its exits. Time is virtual: nothing sleeps, and the same seed gives the same bytes.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from typing import Any

import canopen
import numpy as np

from eds.compiled import JIT_DISABLED
from eds.rig import Rig
from host.bringup import bring_up
from host.controller import Controller, arguments
from host.step import SOURCE_HOST
from lab.kernel import BRAKE, CONTROL_PLANE, MOTOR, WORLD, Exit, run
from node.device import Device
from node.records import KIND_BRAKE, KIND_DRIVE, new_nodes
from sim_bus.arbiter import FAR_NS, new_bus
from sim_bus.operator import KNOT_S, Operator
from sim_bus.plant import TRUTH_COLUMNS, new_plant
from wire.frame import Records, data_bytes, data_word, frames, new_queue, push

__all__ = ["VirtualNetwork", "VirtualRig"]

BLOCK_KNOTS = 8000
TRUTH_BLOCK_KNOTS = 500  # less memory for the block of the true course
LOG_FRAMES = 1 << 15
BOOT_NS = 1_000_000  # power-on to the first SDO: both boot-ups are on the bus
SDO_REQUEST, SDO_RESPONSE = 0x600, 0x580


class VirtualNetwork(canopen.Network):  # type: ignore[misc]  # canopen has no types
    """A `canopen` network without threads: what it sends goes into the virtual bus, and an SDO request lets time pass."""

    def __init__(self, world: VirtualRig) -> None:
        super().__init__()
        self._world = world

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Queue a frame; when it is an SDO request, run the bus until the node's response or the time-out."""
        world = self._world
        world.send(can_id, bytes(data))
        if can_id & 0x780 == SDO_REQUEST and data[0] != 0x80:  # nobody answers an abort
            world.run_until_heard(SDO_RESPONSE + (can_id & 0x7F), round(world.rig.host.sdo_timeout_s * 1e9))

    def send_periodic(self, can_id: int, data: bytes, period: float, remote: bool = False) -> Any:
        """Refused: periodic frames are the kernel's."""
        raise NotImplementedError("periodic frames belong to the kernel: see lab.kernel")


class VirtualRig:
    """Bus, nodes, plant, hand and host of `rig` in mode `mode`.

    Parameters
    ----------
    seed : starts the transducer's noise
    on_frames : called with each batch of frames (FRAME records, end-of-frame stamps) as the bus has carried them
    truth : keep the plant's true course (`truth()` returns it)
    """

    def __init__(
        self,
        rig: Rig,
        mode: str,
        *,
        seed: int = 0,
        on_frames: Callable[[Records], None] | None = None,
        truth: bool = False,
    ) -> None:
        self.rig, self.mode = rig, mode
        self.controller = Controller(rig, mode)
        self.operator = Operator(rig, mode)
        self.network = VirtualNetwork(self)
        self.exits = dict.fromkeys(Exit, 0)
        self._on_frames = on_frames
        self._heard: set[int] = set()
        self._script: list[tuple[int, int, Callable[[VirtualRig], None]]] = []

        self.nodes, self.rpdo, self.tpdo = new_nodes(2)
        self.motor = Device(
            rig.description("motor"), rig.motor.node_id, KIND_DRIVE, self.nodes, self.rpdo, self.tpdo, MOTOR
        )
        self.brake = Device(
            rig.description("brake"), rig.brake.node_id, KIND_BRAKE, self.nodes, self.rpdo, self.tpdo, BRAKE
        )
        self.bus = new_bus(rig.bus.bitrate_bit_s)
        self.plant = new_plant(rig, seed)
        self._queue, self._header = new_queue()
        self._log = frames(LOG_FRAMES)
        self._world = np.zeros(1, WORLD)  # Python looks at it often: a plain array answers faster than a recarray
        w = self._world[0]
        w["script_ns"], w["operator_start_ns"] = FAR_NS, -1
        w["steps_per_knot"] = max(1, round(KNOT_S / rig.plant.step_s))
        w["truth_on"] = truth
        knots = TRUTH_BLOCK_KNOTS if truth else BLOCK_KNOTS
        self._f_h = np.zeros(knots + 1)
        steps = knots * int(w["steps_per_knot"])
        self._truth_block = np.zeros((steps if truth else 1, len(TRUTH_COLUMNS)))
        self._truth: list[Any] = []
        self._truth_from = 0
        self._new_force_block()
        self._arguments = (
            *(
                self._world.view(np.recarray),
                self.bus,
                self._queue,
                self._header,
                self._log,
                self.nodes,
                self.rpdo,
                self.tpdo,
            ),
            *(self.plant, self._f_h, self._truth_block),
            *arguments(self.controller),
        )

        self._run = self._compiled_run()

    def _compiled_run(self) -> Callable[..., int]:
        """Return the kernel without the dispatcher, which would look at each argument's type at each call (40 us)."""
        if JIT_DISABLED:
            return run
        self._world["until_ns"] = 0  # nothing is due: the call only compiles, or loads what was compiled
        run(*self._arguments)
        entry: Callable[..., int] = run.overloads[run.nopython_signatures[-1].args].entry_point  # type: ignore[attr-defined]
        return entry

    # time

    @property
    def t_ns(self) -> int:
        """Present time."""
        return int(self._world["t_ns"][0])

    @property
    def enabled_ns(self) -> int | None:
        """When the drive entered Operation Enabled, which began the operator's schedule."""
        start = int(self._world["operator_start_ns"][0])
        return None if start < 0 else start

    def wait_ns(self, duration_ns: int) -> None:
        """Let time pass."""
        self.run_until(self.t_ns + duration_ns)

    def run_until(self, t_ns: int, condition: Callable[[], bool] | None = None) -> None:
        """Run to `t_ns`, or until `condition` holds after an exit of the kernel."""
        self._world["until_ns"] = t_ns
        while True:
            reason = Exit(self._run(*self._arguments))
            self.exits[reason] += 1
            self._answer(reason)
            self._actuate()
            if reason is Exit.UNTIL or (condition is not None and condition()):
                return

    def run_until_heard(self, can_id: int, timeout_ns: int) -> None:
        """Run until the control plane has heard a frame `can_id`, or for `timeout_ns`."""
        self._heard.clear()
        self.run_until(self.t_ns + timeout_ns, lambda: can_id in self._heard)

    def at(self, t_ns: int, action: Callable[[VirtualRig], None]) -> None:
        """Call `action(world)` at the virtual time `t_ns`: a script's entry."""
        heapq.heappush(self._script, (t_ns, len(self._script), action))
        self._world["script_ns"] = self._script[0][0]

    def _actuate(self) -> None:
        """What a service or a script made of the devices' outputs acts from now on: the plant was advanced to the present."""
        w = self._world[0]
        w["torque_pm"] = self.nodes[MOTOR]["out_torque_pm"]
        w["brake_Nm"] = self.nodes[BRAKE]["out_brake_Nm"]

    # the kernel's exits

    def _answer(self, reason: Exit) -> None:
        if reason is Exit.SERVICE:
            self._serve()
        elif reason in (Exit.FORCE, Exit.ENABLED):
            self._new_force_block()
        elif reason is Exit.LOG:
            self.flush()
        elif reason is Exit.SCRIPT:
            _, _, action = heapq.heappop(self._script)
            self._world["script_ns"] = self._script[0][0] if self._script else FAR_NS
            action(self)

    def _serve(self) -> None:
        w = self._world[0]
        frame = self._log[int(w["log_count"]) - 1]
        service, t_ns, can_id = int(w["service"]), int(frame["t_ns"]), int(frame["can_id"])
        length, data = int(frame["length"]), int(frame["word"])
        for i, device in enumerate((self.motor, self.brake)):
            if service >> i & 1:
                device.service(t_ns, can_id, length, data, self._queue, self._header)
        if service & CONTROL_PLANE:
            self._heard.add(can_id)
            self.network.notify(can_id, bytearray(data_bytes(data, length)), t_ns * 1e-9)

    def _new_force_block(self) -> None:
        w, plant = self._world[0], self.plant[0]
        self._keep_truth()
        step = int(plant["t_ns"]) // int(plant["step_ns"])
        w["force_step"] = step
        w["force_end_ns"] = (step + (len(self._f_h) - 1) * int(w["steps_per_knot"])) * int(plant["step_ns"])
        self._truth_from = step
        knots = step + np.arange(len(self._f_h)) * int(w["steps_per_knot"])
        t = np.asarray(knots * float(plant["h"]), np.float64)
        start = self.enabled_ns
        self._f_h[:] = self.operator.torque_Nm(t, None if start is None else start * 1e-9)

    def flush(self) -> None:
        """Hand over the frames that the bus has carried since the last time."""
        count = int(self._world["log_count"][0])
        self._world["log_count"] = 0
        if self._on_frames is not None and count:
            self._on_frames(self._log[:count])

    # the control plane

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state that the node's last heartbeat told."""
        name = "motor_nmt" if node_id == self.rig.motor.node_id else "brake_nmt"
        state = int(self.controller.host[name][0])
        return None if state < 0 else state

    def send(self, can_id: int, data: bytes) -> None:
        """Queue a frame of the host's control plane."""
        push(self._queue, self._header, SOURCE_HOST, self.t_ns, can_id, len(data), data_word(data))

    # the rig

    def power_on(self) -> None:
        """Switch both nodes on."""
        for device in (self.motor, self.brake):
            device.power_on(self.t_ns, self._queue, self._header)

    def bring_up(self) -> None:
        """Switch the nodes on and bring them up over SDO, as `host.bringup` does on a rig."""
        self.power_on()
        self.wait_ns(BOOT_NS)
        bring_up(self.rig, self, int(self.controller.control["motor_limit_pm"][0]))

    def power_off(self, node: int) -> None:
        """Switch the node `MOTOR` or `BRAKE` off; what it had waiting to be sent is gone."""
        (self.motor, self.brake)[node].power_off()
        count = int(self._header["count"][0])
        keep = self._queue[:count][self._queue["source"][:count] != node].copy()
        self._queue[: len(keep)] = keep
        self._header["count"] = len(keep)

    def start_host(self) -> None:
        """Begin the host's cycle on the next whole period."""
        period = int(self.controller.control["period_ns"][0])
        self.controller.start((self.t_ns // period + 1) * period)
        self._world["host_on"] = 1

    def stop_host(self) -> None:
        """End the host's cycle at once, as if it had died: no safe set-points, no SYNC, no heartbeat."""
        self._world["host_on"] = 0

    # the true course

    def _keep_truth(self) -> None:
        if self._world["truth_on"][0]:
            begin = int(self._world["force_step"][0])  # the block's first row
            step = int(self.plant["t_ns"][0]) // int(self.plant["step_ns"][0])
            self._truth.append(self._truth_block[self._truth_from - begin : step - begin].copy())
            self._truth_from = step

    def truth(self) -> Mapping[str, Any]:
        """Return the plant's true course so far, one array for each of TRUTH_COLUMNS."""
        self._keep_truth()
        table = np.concatenate(self._truth) if self._truth else np.zeros((0, len(TRUTH_COLUMNS)))
        self._truth = [table]
        return dict(zip(TRUTH_COLUMNS, table.T, strict=True))
