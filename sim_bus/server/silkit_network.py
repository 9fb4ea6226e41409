"""Network simulator of a SIL Kit CAN network: controllers of other participants on our bit-true bus.

::

    participant --request at its step T--> SilKitNetwork --ready at T--> VirtualNetwork
    participant <--frame, transmit event, error state, stamped-- SilKitNetwork <--log-- T .. T + step

A step begins when all other participants have ended theirs at that time, so no request comes late.
The bus runs to just before the next step: a participant has, at its step, all frames that ended
before it. SIL Kit's threads only append to `_work`; the bus runs in the thread of `run`.
"""

from __future__ import annotations

import ctypes as ct
from collections import deque
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from coulombus.kernels.records import Records
from coulombus.sim_bus.can_bus.fault_confinement import MANUAL
from coulombus.sim_bus.can_bus.stations import attach, detach, restart
from coulombus.sim_bus.network.network import TAP, VirtualNetwork
from coulombus.sim_bus.network.python_stations import Station
from coulombus.sim_bus.server.silkit_interface import (
    CAN_NETWORK,
    COORDINATED,
    HANDLER,
    STEP_HANDLER,
    ControllerFunctions,
    ErrorStateEvent,
    FrameEvent,
    Head,
    LifecycleConfiguration,
    NetworkFunctions,
    Receivers,
    SilKit,
    SilKitError,
    SilKitFrame,
    StateEvent,
    TransmitEvent,
)
from coulombus.wire.error_frames import BUS_OFF, CONTROLLER, RX_PASSIVE, TX_PASSIVE
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, data_bytes

__all__ = ["SilKitNetwork"]

MOST_PENDING = 512
"""Frames that all controllers together may have pending; the bus has room for 1024."""
ID_BITS = CAN_EFF_FLAG - 1 & ~(CAN_RTR_FLAG | CAN_ERR_FLAG)


@dataclass
class SimulatedController:
    """A controller of another participant, and its station on the bus."""

    descriptor: int
    station: Station
    state: int = 0
    error_state: int = ErrorStateEvent.NONE
    bit_s: int = 0
    on: bool = False
    contexts: dict[int, deque[int | None]] = field(default_factory=dict)
    """By identifier: the senders' pointers of the pending frames, in the order of the requests."""


class SilKitNetwork:
    """The CAN network `can_network` of the simulation at `registry`, simulated by `network`.

    `network` may have devices and stations of its own; it must be at time 0, and have one bus with a
    bit rate. Its station that acknowledges every frame is removed.

    Parameters
    ----------
    registry : as ``silkit://127.0.0.1:8500``
    name : of this participant; the system controller must require it
    host : this PC's address for connections of the other participants; SIL Kit has no password
    step_ns : time between two steps; the other participants' steps are multiples of it

    Raises
    ------
    MissingExtra
        the package silkit-py is not installed
    ValueError
        `network` or `step_ns` do not fit
    """

    def __init__(
        self,
        network: VirtualNetwork,
        registry: str,
        can_network: str = "CAN1",
        *,
        name: str = "Coulombus",
        host: str = "127.0.0.1",
        step_ns: int = 1_000_000,
    ) -> None:
        self._bit_s = int(network.bus[0]["bit_rate"])
        if step_ns < 1 or self._bit_s == 0 or network.bus[0]["cut"] or network.t_ns:
            raise ValueError("expected step_ns of 1 or more, and a network at time 0 with one bus and a bit rate")
        self._network, self._step_ns, self._bus = network, step_ns, network.bus[0]
        detach(self._bus, TAP)
        self._record, network.on_frames = network.on_frames, self._on_frames
        self._controllers: dict[int, SimulatedController] = {}  # by descriptor
        self._of_station: dict[int, SimulatedController] = {}
        self._work: SimpleQueue[tuple[Any, ...] | None] = SimpleQueue()
        self._producer = ct.c_void_p()
        self._begun_ns: int | None = None
        self._called: Any = None
        self._t_ns = 0
        """Time of the step that comes next on the bus."""
        self._silkit, self._host = SilKit(), host
        self._name, self._registry, self._can_network = name, registry, can_network

    def run(self, patience_s: float = 60.0) -> None:
        """Join the simulation, simulate until it is stopped or aborted, and leave it.

        Raises
        ------
        SilKitError
            the registry is not reached, or no step came for `patience_s`
        """
        silkit, name, registry = self._silkit, self._name.encode(), self._registry.encode()
        text = f'{{"Middleware": {{"AcceptorUris": ["tcp://{self._host}:0"]}}}}'
        configuration = silkit.make("ParticipantConfiguration_FromString", text.encode())
        try:
            participant = silkit.make("Participant_Create", configuration, name, registry)
        except SilKitError as error:
            raise SilKitError(f"{self._registry}: {error}") from None
        finally:
            silkit.call("ParticipantConfiguration_Destroy", configuration)
        try:
            self._simulate(participant, patience_s)
        except Empty:
            raise SilKitError(f"no step of the simulation for {patience_s:g} s; are all participants there?") from None
        finally:
            silkit.call("Participant_Destroy", participant)

    def _simulate(self, participant: ct.c_void_p, patience_s: float) -> None:
        """Announce the network, and act on SIL Kit's calls until the end."""
        silkit, work = self._silkit, self._work
        functions = self._called = self._network_functions(self._controller_functions())
        simulator = silkit.make("Experimental_NetworkSimulator_Create", participant)
        announce = "Experimental_NetworkSimulator_SimulateNetwork"
        silkit.call(announce, simulator, self._can_network.encode(), CAN_NETWORK, ct.c_void_p(1), functions)
        silkit.call("Experimental_NetworkSimulator_Start", simulator)
        lifecycle = silkit.make("LifecycleService_Create", participant, LifecycleConfiguration(COORDINATED))
        clock = silkit.make("TimeSyncService_Create", lifecycle)
        begun, agreed, ended = STEP_HANDLER(self._begin), HANDLER(self._agreed), HANDLER(lambda *_: work.put(None))
        self._called = functions, begun, agreed, ended  # SIL Kit may call them until the participant is destroyed
        agree = "Experimental_TimeSyncService_AddOtherSimulationStepsCompletedHandler"
        silkit.call("TimeSyncService_SetSimulationStepHandlerAsync", clock, None, begun, ct.c_uint64(self._step_ns))
        silkit.call(agree, clock, None, agreed, ct.byref(ct.c_uint64()))
        silkit.call("LifecycleService_SetShutdownHandler", lifecycle, None, ended)
        silkit.call("LifecycleService_SetAbortHandler", lifecycle, None, ended)
        silkit.call("LifecycleService_StartLifecycle", lifecycle)
        while (action := work.get(timeout=patience_s)) is not None:
            act, *arguments = action
            act(*arguments)
            if act == self._step:
                silkit.call("TimeSyncService_CompleteSimulationStep", clock)
        silkit.call("LifecycleService_WaitForLifecycleToComplete", lifecycle, ct.byref(ct.c_int16()))

    # SIL Kit's threads

    def _begin(self, _context: Any, _service: Any, now_ns: int, _duration_ns: int) -> None:
        self._begun_ns = now_ns

    def _agreed(self, *_: Any) -> None:
        if self._begun_ns is not None:
            self._work.put((self._step, self._begun_ns))
            self._begun_ns = None

    def _controller_functions(self) -> ControllerFunctions:
        def on_frame(descriptor: int, request: Any) -> None:
            frame = request[0].frame[0]
            data = ct.string_at(frame.data, frame.size) if frame.size else b""
            work.put((self._request, descriptor, frame.can_id, frame.flags, frame.dlc, data, request[0].context))

        work = self._work
        return ControllerFunctions(
            ControllerFunctions.RATE(lambda descriptor, rate: work.put((self._set, descriptor, None, rate[0].bit_s))),
            ControllerFunctions.FRAME(on_frame),
            ControllerFunctions.MODE(lambda descriptor, mode: work.put((self._set, descriptor, mode[0].state, None))),
        )

    def _network_functions(self, of_controller: ControllerFunctions) -> NetworkFunctions:
        def appears(controller: Any, functions: Any, descriptor: int, _: Any) -> None:
            controller[0], functions[0] = descriptor, ct.addressof(of_controller)
            work.put((self._add, descriptor))

        def producer(address: int, _: Any) -> None:
            self._producer = ct.c_void_p(address)

        work = self._work
        return NetworkFunctions(
            NetworkFunctions.APPEARS(appears),
            NetworkFunctions.LEAVES(lambda descriptor, _: work.put((self._leave, descriptor))),
            NetworkFunctions.PRODUCER(producer),
        )

    # the thread of `run`

    def _add(self, descriptor: int) -> None:
        """Give a controller a station, which is off."""
        station = self._network.station(())
        self._bus["stations"][station.number]["restart_ns"] = MANUAL
        detach(self._bus, station.number)
        self._controllers[descriptor] = self._of_station[station.number] = SimulatedController(descriptor, station)

    def _set(self, descriptor: int, state: int | None, bit_s: int | None) -> None:
        """Switch a controller on or off; one with another bit rate than the bus's stays off."""
        c = self._controllers[descriptor]
        c.state = c.state if state is None else state
        c.bit_s = c.bit_s if bit_s is None else bit_s
        on, number = c.state == StateEvent.STARTED and c.bit_s in (0, self._bit_s), c.station.number
        if on and not c.on:
            attach(self._bus, number)
            c.error_state = ErrorStateEvent.ACTIVE
        elif on:
            restart(self._bus, number, self._t_ns)
        elif c.on:
            self._switch_off(c)
            self._cancel(c, self._t_ns)
        c.on = on
        self._report(c, self._t_ns)

    def _leave(self, descriptor: int) -> None:
        """Forget a controller whose participant has left."""
        c = self._controllers.pop(descriptor)
        self._switch_off(c)
        c.on = False
        c.contexts.clear()

    def _switch_off(self, c: SimulatedController) -> None:
        self._network.withdraw(c.station.number)
        detach(self._bus, c.station.number)
        c.error_state = ErrorStateEvent.NONE

    def _request(self, descriptor: int, can_id: int, flags: int, dlc: int, data: bytes, context: int | None) -> None:
        """Queue a frame of a controller, or report why it is not sent."""
        c, t_ns = self._controllers[descriptor], self._t_ns
        if len(data) > 8 or flags & SilKitFrame.OTHER_FORMATS or not c.on or c.error_state == ErrorStateEvent.BUS_OFF:
            self._produce(TransmitEvent(context, t_ns, TransmitEvent.CANCELED, can_id), c)
        elif self._network.out["count"] + self._bus["held"] >= MOST_PENDING:
            self._produce(TransmitEvent(context, t_ns, TransmitEvent.QUEUE_FULL, can_id), c)
        else:
            remote = bool(flags & SilKitFrame.REMOTE)
            full_id = can_id | (CAN_EFF_FLAG if flags & SilKitFrame.EXTENDED else 0) | (CAN_RTR_FLAG if remote else 0)
            c.contexts.setdefault(full_id, deque()).append(context)
            c.station.send(full_id, b"" if remote else data, at_ns=t_ns, length=min(dlc, 8) if remote else None)

    def _step(self, t_ns: int) -> None:
        """Run the bus from `t_ns` to just before the next step; `_on_frames` sends its events."""
        self._t_ns = t_ns + self._step_ns
        self._network.run_until(self._t_ns - 1)
        self._network.flush()

    def _on_frames(self, log: Records) -> None:
        """Send the frames and the controllers' changes of state to the participants."""
        if self._record is not None:
            self._record(log)
        for t_ns, can_id, length, word, source in log.tolist():
            c = self._of_station.get(source)
            if not can_id & CAN_ERR_FLAG:
                self._deliver(c, t_ns, can_id, length, data_bytes(word, length))
            elif c is not None and c.on and can_id & (CONTROLLER | BUS_OFF):
                passive = word >> 8 & (RX_PASSIVE | TX_PASSIVE)
                c.error_state = ErrorStateEvent.PASSIVE if passive else ErrorStateEvent.ACTIVE
                if can_id & BUS_OFF:
                    c.error_state = ErrorStateEvent.BUS_OFF
                    self._cancel(c, t_ns)
                self._report(c, t_ns)

    def _deliver(self, sender: SimulatedController | None, t_ns: int, can_id: int, length: int, data: bytes) -> None:
        """Send a frame to its receivers, and to its sender with its own pointer."""
        remote = bool(can_id & CAN_RTR_FLAG)
        flags = (SilKitFrame.EXTENDED if can_id & CAN_EFF_FLAG else 0) | (SilKitFrame.REMOTE if remote else 0)
        payload, size = ct.create_string_buffer(data, 8), 0 if remote else length
        frame = SilKitFrame(can_id & ID_BITS, flags, length, 0, 0, 0, ct.addressof(payload), size)
        receivers = [
            c
            for c in self._controllers.values()
            if c.on and c is not sender and c.error_state != ErrorStateEvent.BUS_OFF
        ]
        self._produce(FrameEvent(t_ns, ct.pointer(frame), FrameEvent.RECEIVED, None), *receivers)
        if sender is not None and sender.contexts.get(can_id):
            context = sender.contexts[can_id].popleft()
            self._produce(FrameEvent(t_ns, ct.pointer(frame), FrameEvent.SENT, context), sender)
            self._produce(TransmitEvent(context, t_ns, TransmitEvent.TRANSMITTED, can_id & ID_BITS), sender)

    def _cancel(self, c: SimulatedController, t_ns: int) -> None:
        """Report a controller's pending frames as cancelled."""
        for can_id, contexts in c.contexts.items():
            for context in contexts:
                self._produce(TransmitEvent(context, t_ns, TransmitEvent.CANCELED, can_id & ID_BITS), c)
        c.contexts.clear()

    def _report(self, c: SimulatedController, t_ns: int) -> None:
        """Send a controller its state and error state.

        SIL Kit sends an error state together with the last produced state, whosever that was. So
        the state is produced first, for nobody.
        """
        self._produce(StateEvent(t_ns, c.state))
        self._produce(ErrorStateEvent(t_ns, c.error_state), c)

    def _produce(self, event: Head, *receivers: SimulatedController) -> None:
        descriptors = (ct.c_uint64 * max(1, len(receivers)))(*(c.descriptor for c in receivers))
        to = Receivers(len(receivers), descriptors)
        self._silkit.call("Experimental_CanEventProducer_Produce", self._producer, event, to)
