"""The compiled loops while calls of the C library fail: run by tests/host/realtime/test_libc_faults.py, with
tests/support/libc_shim.c preloaded.

``python libc_faults.py plane|sim NUMBERS`` prints a line of JSON for each fault: what it was,
whether the call came, and what is wrong with the end.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import faulthandler
import json
import math
import os
import socket
import struct
import sys
import tempfile
import threading
import time
from pathlib import Path

from coulombus.cli.errors import FAULT, Failure, errors
from coulombus.eds.cia402 import COMMAND_OF_CONTROLWORD, NEXT_STATE, STATUSWORD, VOLTAGE_ENABLED, PowerState
from coulombus.eds.codec import pack
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image, Phase
from coulombus.host.realtime.loop import run_plane
from coulombus.host.realtime.process import new_buffers
from coulombus.host.realtime.shared_memory import PlaneCommand, PlaneStatus, SharedPlane
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import BusAddress, socket_path
from coulombus.wire.handshake import connect

FRAME = struct.Struct("=IB3xq")
FUNCTIONS = (
    "read",
    "write",
    "recv",
    "send",
    "recvmsg",
    "ppoll",
    "clock_nanosleep",
    "accept4",
    "setsockopt",
    "getsockopt",
)
FUNCTIONS += ("mmap", "malloc", "calloc", "realloc")
MEMORY = ("mmap", "malloc", "calloc", "realloc")
ERRORS = (errno.EIO, errno.ENOBUFS, errno.ENOMEM, errno.EINTR, errno.EAGAIN)
PATIENCE_S = 20.0
shim = ctypes.CDLL(None)


def wait(condition, seconds=PATIENCE_S, meanwhile=lambda: None):
    """Wait for a condition; return whether it came."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        meanwhile()
        time.sleep(2e-4)
    return True


def arm(function, number, error):
    shim.fault_arm(FUNCTIONS.index(function), ctypes.c_long(number), error)


class Devices:
    """A bus on the other end of a socket pair, with a drive that obeys and a handle that moves
    evenly once the law runs.
    """

    def __init__(self, k, other):
        self.k, self.other = k, other
        self.state, self.counts, self.syncs = int(PowerState.SWITCH_ON_DISABLED), 0.0, 0
        self.sent = []
        self.thread = threading.Thread(target=self._live)
        self.thread.start()

    def _live(self):
        while message := self._message():
            for can_id, _, word in FRAME.iter_unpack(message):
                self.sent.append((can_id, word))
                if can_id == 0x201:
                    self.state = int(NEXT_STATE[self.state, int(COMMAND_OF_CONTROLWORD[word & 0xF])])
                elif can_id == 0x080:
                    with contextlib.suppress(OSError):
                        self.other.send(self._answers())

    def _message(self):
        """Return the next message; b"" at the end.

        That the other side went without reading all is told once, and in between.
        """
        try:
            return self.other.recv(1 << 16)
        except ConnectionResetError:
            return self.other.recv(1 << 16)

    def _answers(self):
        c, h = self.k.each[0].control[0], self.k.each[0].host[0]
        if h["phase"] == Phase.RUN:
            self.counts += 0.5 * c["period_ns"] * 1e-9 / c["rad_count"]  # 0.5 rad/s
        values = h["image"].copy()
        values[Image.STATUSWORD] = int(STATUSWORD[self.state]) | VOLTAGE_ENABLED
        values[Image.POSITION] = math.floor(self.counts)
        values[Image.TORQUE] = values[Image.HANDLE_TORQUE] = values[Image.COIL_CURRENT] = 0
        tpdos = self.k.each[0].tpdos
        frames = [(int(t["cob_id"]), int(t["length"]), int(pack(t, values))) for t in tpdos[: c["tpdos"]]]
        if self.syncs % 20 == 0:
            frames += [(0x700 + int(node), 1, 5) for node in c["node_id"][: c["nodes"]]]
        self.syncs += 1
        return b"".join(FRAME.pack(can_id, length, word) for can_id, length, word in frames)


class Plane:
    """The loop in a thread that the shim watches, on one end of a socket pair."""

    def __init__(self):
        self.k = Controllers(load_rig("bench"), "hybrid")
        self.shared = SharedPlane.create(1)
        self.k.adopt(self.shared.axes)
        self.shared.owner[:] = self.k.owner
        control = self.shared.axes["control"]
        control["sign_check"], control["still_cycles"], control["gain_step"] = 0, 3, 1.0
        control["safe_longest_cycles"], control["release_Nm"] = 20, 0.25
        control["missed_cycles"] = 200  # of a machine that others use, too
        control["heartbeat_timeout_ns"] = 0
        self.plane = self.shared.plane
        self.plane["packed"] = 1
        self.mine, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.devices = Devices(self.k, self.other)
        self.buffers = new_buffers([self.mine.fileno()], self.shared)
        self.status = None
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self):
        shim.fault_watch(1)
        try:
            self.status = run_plane(self.buffers, self.k.law_function)
        finally:
            shim.fault_watch(0)

    @property
    def ended(self):
        return not self.thread.is_alive()

    def arrive(self):
        """Arm; return whether motor and brake have something to hold."""
        at = time.monotonic_ns() + 2_000_000
        self.k.start(at)
        self.plane["start_ns"] = at
        self.plane["command"] = PlaneCommand.CYCLE
        h = self.shared.axes["host"]
        return wait(
            lambda: (
                (h["phase"][0] == Phase.RUN and h["image"][0][Image.BRAKE_SETPOINT] > 0) or self.k.ending or self.ended
            )
        )

    def cycles(self, count):
        """Let the loop go on for so many cycles; return whether it did."""
        goal = int(self.plane["cycles"][0]) + count
        return wait(lambda: self.plane["cycles"][0] >= goal or self.ended)

    def close(self):
        self.plane["command"] = PlaneCommand.QUIT
        self.thread.join(PATIENCE_S)
        assert self.ended, "the loop does not end"
        self.mine.close()
        self.devices.thread.join(PATIENCE_S)
        self.other.close()
        self.shared.close()


def plane_case(moment, function, number, error):
    """Let a call fail in a moment of a run, end it, and return what is wrong."""
    arm(function, 0, error)
    plane, wrong = Plane(), []
    try:
        if moment == "listening":
            arm(function, number, error)
            wait(lambda: shim.fault_failed() or plane.ended, 1.0)
        if not plane.ended and not plane.arrive():
            wrong.append("never armed")
        if plane.k.trip and moment != "listening":
            return [f"not armed: {plane.k.trip}"]
        if moment == "energised":
            arm(function, number, error)
            plane.cycles(number + 3)  # each call comes at least once a cycle
        elif moment == "stopping":
            arm(function, number, error)
        trip = plane.k.trip
        if (
            moment == "ended"
        ):  # as by a parent that waits no longer: the set-points after the loop are the only safe ones
            arm(function, number, error)
        elif not plane.ended:
            plane.plane["stop"] = 1
            if not wait(lambda: plane.k.done or plane.ended):
                wrong.append(f"the safe state does not end: {plane.k.phase.name}")
        if not plane.ended:
            plane.plane["command"] = PlaneCommand.LISTEN
            wait(lambda: plane.plane["status"][0] != PlaneStatus.CYCLING)
        transient = error in (errno.EINTR, errno.EAGAIN) and function != "clock_nanosleep"
        transient |= error == errno.EINTR or (function == "send" and error == errno.ENOBUFS)
        if shim.fault_failed() and not transient and moment in ("listening", "energised"):
            if plane.plane["status"][0] != PlaneStatus.LOST:
                wrong.append(f"not a lost bus: {PlaneStatus(int(plane.plane['status'][0])).name}")
            if plane.plane["error"][0] != error:
                wrong.append(f"the reason is {plane.plane['error'][0]}")
            if moment == "energised" and not str(plane.k.trip).startswith("BUS_LOST"):
                wrong.append(f"trip {plane.k.trip}")
        elif trip is not None:
            wrong.append(f"a trip where there is none: {trip}")
    finally:
        plane.close()
    if plane.status not in (PlaneStatus.LOST, PlaneStatus.ENDED):
        wrong.append(f"status {plane.status}")
    last = dict(plane.devices.sent)  # of each identifier
    if last.get(0x201, 0) != 0:
        wrong.append(f"the motor's last set-point is {last[0x201]:#x}")
    c = plane.k.each[0].control[0]
    if (
        last.get(0x202, 0) > math.ceil(c["brake_limit_Nm"] / c["brake_Nm_raw"])
        or plane.shared.axes["host"]["torque_Nm"].any()
    ):
        wrong.append(f"the brake's last set-point is {last.get(0x202):#x}")
    return wrong


def plane_cases(numbers):
    plane = Plane()  # compiles
    wait(lambda: plane.plane["status"][0] == PlaneStatus.LISTENING, 300.0)
    plane.arrive()
    plane.close()
    for moment in ("energised", "ended", "stopping", "listening"):
        for function in ("recvmsg", "send", "ppoll", "clock_nanosleep"):
            if moment == "listening" and function in ("send", "clock_nanosleep"):
                continue
            for number in range(1, numbers + 1):
                for error in ERRORS:
                    if function == "clock_nanosleep" and error == errno.EAGAIN:
                        continue
                    yield (moment, function, number, error)


def main(which, numbers):
    faulthandler.dump_traceback_later(3600, exit=True)
    course = {"plane": (plane_cases, plane_case), "sim": (sim_cases, sim_case)}[which]
    for case in course[0](numbers):
        begin = time.monotonic()
        try:
            wrong = course[1](*case)
        except Exception as error:
            wrong = [repr(error)]
        shim.fault_watch(0)
        *words, error = case
        line = {"case": [*words, errno.errorcode[error]], "came": int(shim.fault_failed()), "wrong": wrong}
        print(json.dumps({**line, "seconds": round(time.monotonic() - begin, 3)}), flush=True)


# the bus


def sim_case(function, number, error):
    """Serve a bus for two clients, one call failing in the server's thread.

    Return what is wrong with the end.
    """
    wrong, raised = [], []
    before = len(os.listdir("/proc/self/fd"))
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "r.pcapng"
        address = BusAddress("coulombus", "f")
        server = SimServer(load_rig("bench"), address, record=record)
        ready = threading.Event()

        def course():
            try:
                server.run(5.0, ready=lambda: (ready.set(), shim.fault_watch(1)))
            except BaseException as failure:
                raised.append(failure)
            finally:
                shim.fault_watch(0)
                ready.set()

        arm(function, number, error)
        thread = threading.Thread(target=course)
        thread.start()
        ready.wait(PATIENCE_S)
        try:
            for _ in range(2):
                _talk(address)
        except OSError:  # whom the fault has hit
            pass
        server.stop()
        thread.join(PATIENCE_S)
        if thread.is_alive():
            return ["it does not end"]
        try:
            shim.fault_watch(1)
            server.close()
        except Exception as failure:
            raised.append(failure)
        finally:
            shim.fault_watch(0)
        wrong += [f"no documented status: {one!r}" for one in raised if not _documented(one, function)]
        if socket_path("f").exists():
            wrong.append("the socket is left")
        try:
            read(record)
        except Exception as failure:
            wrong.append(f"the recording cannot be read: {failure!r}")
        raised.clear()
        server = None
    left = len(os.listdir("/proc/self/fd")) - before
    if left > 0:
        wrong.append(f"{left} descriptors are left")
    return wrong


def _documented(error, function):
    """Tell whether a verb that ends by this error has a status of its own for it.

    Where memory runs out inside of numba's entry into a kernel, numba raises what it happens to:
    SystemError without a text, TypeError.
    """
    try:
        with errors():
            raise error
    except Failure as failure:
        return failure.status != FAULT or (function in MEMORY and isinstance(error, SystemError | TypeError))
    except SystemExit:
        return True


def _talk(address):
    """Greet, upload an object, send some frames, go."""
    with contextlib.closing(connect(address)) as client:
        client.settimeout(0.2)
        client.send(FRAME.pack(0x601, 8, 0x0000_0000_0010_0040))
        client.send(FRAME.pack(0x000, 2, 0x0001) + FRAME.pack(0x080, 0, 0))
        answered = False
        while not answered:
            message = client.recv(1 << 16)
            answered = not message or any(f[0] == 0x581 for f in FRAME.iter_unpack(message))


def sim_cases(numbers):
    sim_case("read", 0, errno.EIO)  # the reference: how often each is called
    calls = {name: shim.fault_calls(FUNCTIONS.index(name)) for name in FUNCTIONS}
    print(json.dumps({"calls": calls}), flush=True)
    for function in FUNCTIONS:
        step = max(1, calls[function] // numbers)
        for number in range(1, calls[function] + 1, step):
            for error in (errno.ENOMEM,) if function in MEMORY else ERRORS:
                yield (function, number, error)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
