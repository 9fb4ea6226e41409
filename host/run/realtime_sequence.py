"""Sequence of a real-time run on a bus with real or simulated nodes.

This process is the parent of the data plane (`host.realtime.data_plane`). It brings the nodes up over
SDO, starts the cycle, records the data plane's log, supervises the run, and ends it safely: when the
time is over, on a signal, on ``coulombus stop``, or on a trip.
"""

from __future__ import annotations

import signal
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.parameter_changes import Change, LiveParameters
from coulombus.host.cycle.records import Phase, Trip
from coulombus.host.errors import SafetyTrip
from coulombus.host.realtime.data_plane import PARENT_NS, DataPlane
from coulombus.host.realtime.shared_memory import PlaneStatus
from coulombus.host.run.changes import Changes, new_arm_key
from coulombus.host.run.client_requests import ClientAnswers, Progress, with_states
from coulombus.host.run.control_socket import HostSocket
from coulombus.host.run.deadman import Switch, deadman_of, switch_of
from coulombus.host.run.last_word import forget_word, leave_word, wall_time
from coulombus.host.run.markers import BitMarks, StruckKeys
from coulombus.host.run.preflight import place_of, refusing
from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Run
from coulombus.host.run.run_recording import StampOrder, begin_recording
from coulombus.host.run.run_sequence import SAFE_TIMEOUT_NS, Course, Figures
from coulombus.host.run.world_display import WorldDisplay
from coulombus.host.setup.bringup import bring_up, release, shut_down
from coulombus.host.setup.control_plane import RealControlPlane
from coulombus.recording.measures import Measures
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.segments import SegmentedRecorder
from coulombus.system.exit import say
from coulombus.system.keyboard import Keys, in_foreground
from coulombus.system.sd_notify import Notifier
from coulombus.system.stop_signals import Signals, status_of
from coulombus.wire.address import BusAddress, BusUnavailable

__all__ = ["LISTEN_S", "RealCourse"]

POLL_S = 0.01
LISTEN_S = 1.0
"""Time of listening for another host before this host counts as the only one on its bus."""
LEAD_NS = 20_000_000
FAILURES = 1000  # errors of this process at a safe end before it stops waiting; the data plane ends by itself
HAND_TIMEOUT_S, STUCK_S = 30.0, 2.0  # longest wait for the dead man's switch; longest time without a cycle


class RealCourse(Course):
    """The course of a real-time run: times are those of CLOCK_MONOTONIC; supervises the data plane."""

    def __init__(
        self,
        run: Run,
        addresses: Sequence[BusAddress],
        *,
        signals: Signals,
        progress: Progress | None,
        cpu: int | None,
    ) -> None:
        rig, outputs, self.signals = run.rig, run.outputs, signals
        self.rig = rig
        self.buses, self.address = ", ".join(map(str, addresses)), max(addresses, key=lambda bus: bus.moves_hardware)
        self.deadman = deadman_of(rig, run.mode, self.address)
        self.zero_ns = time.monotonic_ns()
        controllers = Controllers(rig, run.mode)
        super().__init__(controllers, outputs.record, with_states(progress, controllers))
        self.error: str | None = None  # error of this process while the rig was armed
        self._fate = ""  # how the data plane's process ended
        self.stopped_by: str | None = None
        self._order = StampOrder(self.zero_ns)
        self._keys = StruckKeys(time.monotonic_ns)
        self._touched = False  # whether this host has sent anything
        self._seen = (0, time.monotonic())
        self._outcome: dict[str, Any] | None = None  # result for the clients that requested a stop
        self._stack = ExitStack()
        self.notifier = Notifier()  # before any process starts that would inherit its variables
        try:
            self.door = HostSocket(*addresses)
            self._stack.callback(lambda: self.door.close(self._outcome))
            forget_word(addresses)
            self._stack.callback(lambda: leave_word(addresses, self._outcome, self.path))
            self.plane = DataPlane(controllers, *addresses, cpu=cpu)
            self._stack.callback(self.plane.close)
            parameters = LiveParameters(controllers)  # the controllers are in shared memory by now
            self.changes = Changes(parameters, new_arm_key(self.address), self._apply, self._why_no_change)
            outside = self.address if run.world else None
            self.world = WorldDisplay(controllers, self.plane, parameters, self.changes, outside)
            self._stack.callback(self.world.close)
            self.answers = ClientAnswers(self, self.plane, self.changes, self.buses, outputs)
            self._stack.callback(self.answers.close)
            self.door.status, self.door.mark = self.answers.state, self.answers.mark
            self.door.change = self.answers.change
            self.control = RealControlPlane(rig, *addresses)
            self._stack.callback(self.control.close)
            self._bits = BitMarks(outputs.mark_on, rig)
            self.recorder = begin_recording(run, controllers, self.zero_ns)
            if isinstance(self.recorder, SegmentedRecorder):
                self.path = self.recorder.run
            self.plane.tell_recording(self.path, self.zero_ns)
            self._stack.callback(self._give_up_recording)
        except BaseException:
            self._stack.close()
            raise

    # markers, changes, recording

    def mark(self, t_ns: int, text: str) -> None:
        """Set a marker in the recording, whose time 0 is the start of the run."""
        super().mark(t_ns - self.zero_ns, text)

    def _why_no_change(self) -> str | None:
        if self.plane.status is not PlaneStatus.CYCLING:
            return "the host is not in its cycle yet: it is starting, or it has stopped"
        if self.world.controlled:
            return "a program outside has control (coulombus run --world): its models set the parameters"
        return "the host ends: it is in its safe state" if self.controllers.ending else None

    def _apply(self, change: Change) -> None:
        """Publish a change, which the step takes in the next cycle; set its marker."""
        self.plane.publish_order(change.index, change.number)
        self.mark(self.now_ns, change.marker)

    def _watch_keys(self) -> None:
        """Read the terminal's keys, if there is one: 1 to 9 set markers, q and Escape stop."""
        if in_foreground():
            with suppress(OSError, termios.error):
                self._stack.enter_context(Keys(self._keys.strike, earlier=self._keys.strike_early))

    def drain(self, seen_ns: int | None = None) -> None:
        """Write the data plane's log to the recording, in the order of the stamps.

        With `seen_ns`, later frames wait for the next batch. All markers up to `seen_ns` are set by then:
        a frame that could still get a marker is not written.
        """
        rows, frames, models = self.plane.take_trace(), self.plane.take_frames(), self.world.models.take_rows()
        if self.recorder is None or self.failure is not None:
            return
        self.record(lambda recorder: recorder.keep_models(models))
        batch = self._order.batch(frames, rows, seen_ns)
        self.record(lambda recorder: batch.write(recorder, self._bits))

    def _give_up_recording(self) -> None:
        """Close the recording, with the marker of a trip, if it is still open; its content stays readable."""
        for what in () if self.recorder is None else (self.mark_trip, self.recorder.close):
            self._attempt(what, RecordingError)

    # the course

    @property
    def now_ns(self) -> int:
        """CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Request the safe state from the data plane."""
        self.plane.stop(trip)

    @refusing()
    def set_up(self) -> tuple[str, ...]:
        """Load the data plane, check that no other host is on the bus, bring the nodes up."""
        alone_at = time.monotonic() + LISTEN_S
        self.plane.wait_ready()
        self.drain(time.monotonic_ns())  # compiles its functions now, not while the rig is armed
        self.control.check_alone(alone_at)
        for right in self.plane.real_time:
            if not right["granted"]:
                say(f"coulombus: {right['name']}: refused ({right['detail']}); to have it: {right['remedy']}")
        if self.deadman != "none":
            say(f"coulombus: dead man's switch: {self.deadman}")
        elif self.address.moves_hardware:
            say("coulombus: no dead man's switch: host.deadman is none")
        self._touched = True
        losses = bring_up(self.controllers, self.control)
        for text in losses:
            say(f"coulombus: {text}")
        now = time.monotonic_ns()
        self.mark(now, f"run {self.controllers.mode}")
        self.mark(now, f"deadman {self.deadman}")
        return losses

    def _await_hand(self, switch: Switch) -> None:
        """Wait until the dead man's switch is held; for a switch that is not an object of a device."""
        self.controllers.control["deadman_key"] = 1
        self._stack.enter_context(switch)
        say(f"coulombus: {switch.invitation}")
        deadline = time.monotonic() + HAND_TIMEOUT_S
        while not switch.held:
            if time.monotonic() > deadline:
                raise SafetyTrip(f"arming refused: {switch.name} was not held within {HAND_TIMEOUT_S:g} s")
            time.sleep(POLL_S)

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm; an error in the context is a trip, and in every case the rig is made safe first."""
        self._arm()
        try:
            yield
        except Exception as error:
            self._fail(error)
        finally:
            self.make_safe()

    @refusing()
    def _arm(self) -> None:
        """Wait for the dead man's switch, and begin the cycle."""
        switch = switch_of(self.deadman, self.plane.hold_deadman, self._keys.strike)
        if self.deadman != "key":
            self._watch_keys()
        if switch is not None:
            self._await_hand(switch)
        if self.changes.arm_key:
            need = "which coulombus set and the page need to change a parameter"
            say(f"coulombus: arm key, {need}: {self.changes.arm_key}")
        self.signals.defer()
        self.signals.stop()
        if not self.plane.alive or self.plane.status in (PlaneStatus.LOST, PlaneStatus.ENDED):
            raise BusUnavailable(f"bus {self.buses}: lost before anything was armed: {self.plane.lost_text}")
        period = int(self.controllers.control["period_ns"][0])
        self.plane.attend()
        self.plane.start_cycle((time.monotonic_ns() + LEAD_NS) // period * period)
        self._seen = (0, time.monotonic())

    def display(self, seconds: float | None) -> None:
        """Tell the service manager that the host is ready, and display."""
        self.notifier.send(READY=1, STATUS=f"cycling on {self.buses} in mode {self.controllers.mode}")
        super().display(seconds)

    def _fail(self, error: Exception) -> None:
        """Trip with `Trip.HOST` for an error of this process; the first error counts.

        Never raises, not even out of memory.
        """
        first, self.error = self.error is None, self.error or "an error"
        with suppress(Exception):
            self.plane.stop(Trip.HOST)
            if first:
                self.error = f"{type(error).__name__}: {error} ({place_of(error.__traceback__)})"

    def _attempt(self, what: Callable[[], object], *expected: type[Exception]) -> None:
        """Call `what`; ignore errors of `expected`, and trip for others. Never raises."""
        try:
            what()
        except expected:
            pass
        except Exception as error:
            self._fail(error)

    def make_safe(self) -> None:
        """Request the safe state and wait for its end.

        The data plane reaches it by itself: an error here interrupts supervision, and the wait goes on.
        """
        deadline, failures = 0, 0
        self._attempt(lambda: self.notifier.send(STOPPING=1, STATUS="ending safely"))
        while failures < FAILURES:
            try:
                self.plane.stop()
                self._attempt(self.door.stop_wanted, OSError)  # a page shows the trip while the brake is ramped off
                deadline = deadline or self.now_ns + SAFE_TIMEOUT_NS + round(1e9 * self.controllers.ending_s)
                over = self.plane.status is PlaneStatus.LOST or self.controllers.done or self.now_ns >= deadline
                if over or not self._supervise():
                    break
            except Exception as error:
                failures += 1
                self._fail(error)
        for last in (self._supervise, self._never_cycled, self.mark_end):
            self._attempt(last)

    def advance(self, until_ns: int, done: Callable[[], bool]) -> bool:
        """Advance the run by one supervision step.

        Return False if the run must end: after a signal, a stop request, a key, or a trip.
        """
        if not self._supervise() or self.controllers.ending or self.plane.status is PlaneStatus.LOST:
            return False
        if self.signals.number:
            self.stopped_by = signal.Signals(self.signals.number).name
            return False
        if self.door.stop_wanted():
            self.stopped_by = "coulombus stop"
            return False
        if self._keys.stop:
            self.stopped_by = "a key"
            return False
        return True

    def _supervise(self) -> bool:
        """Set due markers, drain the log, serve status readers, check that the data plane is alive.

        Return False if it is not.
        """
        time.sleep(POLL_S)
        self.plane.attend()
        seen_ns = time.monotonic_ns()
        cycles, now = self.plane.cycles, time.monotonic()
        if cycles != self._seen[0]:
            self._seen = cycles, now
            self.notifier.alive(cycles)
        self.mark_course(self.now_ns + 1)
        for t_ns, text in self._keys.read_markers():
            self.mark(t_ns, text)
            say(f"coulombus: {text}" if self.recorder is not None else f"coulombus: {text}: nothing is recorded")
        enabled = self.enabled_ns
        if enabled is not None and self.progress is not None:
            with suppress(OSError):  # the terminal was closed
                self.progress((time.monotonic_ns() - enabled) * 1e-9)
        self.drain(seen_ns)
        self.answers.serve_status(seen_ns)
        with suppress(BusUnavailable):  # the data plane notices
            self.control.wait_ns(0)  # unread heartbeats would fill the socket's queue
        stuck = now - self._seen[1] > STUCK_S
        if (stuck or not self.plane.alive) and self.plane.status not in (PlaneStatus.LOST, PlaneStatus.ENDED):
            self._plane_gone()
            return False
        return True

    def _plane_gone(self) -> None:
        """Set `Trip.DATA_PLANE`: the nodes' own watchdogs make the rig safe."""
        h = self.controllers.host
        running = h["phase"] < Phase.SAFE
        h["trip"][running], h["trip_ns"][running] = Trip.DATA_PLANE, time.monotonic_ns()
        h["phase"] = Phase.DONE
        self._fate = self._fate or self.plane.fate

    def _never_cycled(self) -> None:
        """Set `Trip.BUS_LOST` if the bus was lost after the last check and before the first cycle."""
        h = self.controllers.host
        running = h["phase"] < Phase.SAFE
        if self.plane.status is PlaneStatus.LOST and running.any():
            h["trip"][running], h["trip_ns"][running] = Trip.BUS_LOST, time.monotonic_ns()
            h["phase"] = Phase.DONE

    def end(self) -> None:
        """Leave the nodes in PRE-OPERATIONAL, end the data plane, close the recording.

        An error in one of these steps does not prevent the others.
        """
        cycling = self.plane.status is PlaneStatus.CYCLING and self.plane.alive
        if cycling and not self.controllers.done:  # a brake that only the host can ramp off, before NMT ends the PDOs
            self.plane.end_cycle()
            self._attempt(self.plane.await_end)
        if cycling:  # before the cycle ends: a node that misses SYNC or the heartbeat would report a fault
            self._attempt(lambda: release(self.controllers, self.control), BusUnavailable)  # the bus may be gone
            self.plane.end_cycle()
        if self._touched:
            self._attempt(lambda: shut_down(self.control), BusUnavailable)
        self._attempt(self.mark_trip)
        self._attempt(self.drain)
        self._attempt(self.world.close)
        self._give_up_recording()
        self._attempt(self.plane.close)

    def close(self) -> None:
        """Release all resources."""
        try:
            self._stack.close()
        except Exception as error:  # the run's result exists already
            say(f"coulombus: something is left behind: {error}")

    # the result

    @property
    def trip(self) -> str | None:
        """Text of the trip, with details from this process and the bus, or None."""
        trip, first = super().trip, self.controllers.tripped
        if self.failure is not None:
            return trip
        number = Trip.NONE if first is None else first.host["trip"][0]
        if self.error is not None and number in (Trip.NONE, Trip.HOST):
            return f"HOST: {self.error}"
        details = {
            Trip.HOST: f"it hung for {PARENT_NS // 1_000_000_000} s",  # it has neither failed nor ended
            Trip.DATA_PLANE: f"it {self._fate or 'is not there'}",
            Trip.BUS_LOST: self.plane.lost_text,
        }
        return f"{trip} ({details[number]})" if number in details else trip

    def _lost_share(self) -> float:
        cycles = self.plane.cycles
        lost = int(self.plane.shared.plane["missed_deadlines"][0]) + int(self.controllers.host["lost_pdos"].max())
        return lost / cycles if cycles else 0.0

    def _exit_status(self) -> int:
        if self.trip is not None:
            return 7
        if self.signals.number:
            return status_of(self.signals.number)
        return 8 if self._lost_share() > self.rig.host.loss_limit else 0

    def figures(self) -> Figures:
        """Return the display's figures; an error in computing them is a trip."""
        try:
            return super().figures()
        except Exception as error:
            self._fail(error)
        return Figures([Measures() for _ in self.controllers], None)

    def _result(self) -> RunResult:
        k, plane, figures = self.controllers, self.plane, self.figures()
        wakeup, latency, skew = plane.wakeup(), plane.latency(), plane.skew()
        counters = k.counters() | plane.counters()
        cycles, exit_status = int(k.host["display_cycles"].max()), self._exit_status()
        self._outcome = {"mode": k.mode, "cycles": cycles, "trip": self.trip, "exit_status": exit_status}
        self._outcome |= {"stopped_by": self.stopped_by, "lost_pdos": int(k.host["lost_pdos"].sum())}
        self._outcome |= {"missed_deadlines": int(counters["missed_deadlines"]), "tripped": wall_time(k.trip_ns)}
        return self.result_of(
            figures,
            missed_deadlines=counters["missed_deadlines"],
            wakeup_us=wakeup.as_dict() if wakeup else None,
            cpu_us_per_cycle=plane.cpu_us_per_cycle(),
            simulated_s=cycles * int(k.control["period_ns"][0]) * 1e-9,
            counters=counters,
            exit_status=exit_status,
            bus=self.buses,
            sync_to_rpdo_us=latency.as_dict() if latency else None,
            sync_skew_us=skew.as_dict() if skew else None,
            real_time=plane.real_time,
            deadman=self.deadman,
            stopped_by=self.stopped_by,
            plane=k.plane_figures(),
            trip_ns=k.trip_ns - self.zero_ns if k.trip_ns else None,
        )

    def result(self) -> RunResult:
        """Return the result of the run; a first error becomes a trip, and the result is computed again.

        Raises
        ------
        SafetyTrip
            the second attempt failed, too
        """
        try:
            return self._result()
        except Exception as error:
            self._fail(error)
        try:
            return self._result()
        except Exception as error:
            raise SafetyTrip(f"HOST: {self.error}") from error
