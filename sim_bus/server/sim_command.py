"""Course of ``coulombus emulate``: signals in the main thread, the bus in its own thread, and the reports."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import asdict
from types import FrameType

from coulombus.sim_bus.faults.fault_file import injected_lines
from coulombus.sim_bus.server.fault_socket import fault_sockets
from coulombus.sim_bus.server.server import BusServer
from coulombus.sim_bus.server.sim_result import SimResult
from coulombus.system.exit import printed, say, show, verdict
from coulombus.system.sd_notify import Notifier
from coulombus.system.stop_signals import end_at_once, taken

__all__ = ["PRIORITY", "run_sim"]

PRIORITY = 79
"""SCHED_FIFO priority of the bus: just below the host's."""


def run_sim(
    make: Callable[[], BusServer],
    seconds: float | None,
    *,
    priority: int | None,
    cpu: int | None,
    as_json: bool,
    report_ready: Callable[[BusServer, bool], None] | None = None,
) -> None:
    """Serve until the time is over, or a signal of `system.stop_signals`.

    Report readiness and the result; end with the exit status.

    A compiled loop does not notice a signal, so it runs in its own thread and the main thread's
    handlers stop it. Until `make` has created the server (the first compilation takes half a
    minute) a signal ends the process at once, with the signal's status: the interrupted code might
    swallow an exception, and there is nothing to clean up yet. `report_ready` is called before the
    nodes are switched on; by default it reports the bus.
    """
    live_servers: list[BusServer] = []
    notifier = Notifier()
    over = threading.Event()
    failure: list[BaseException] = []

    def ready() -> None:
        with printed():  # the bus is ready, even if nobody reads this
            (report_ready or _report_ready)(server, as_json)
        notifier.send(READY=1, STATUS=f"bus {server.name}")

    def course() -> None:
        try:
            server.run(seconds, priority=priority, cpu=cpu, ready=ready)
        except BaseException as error:
            failure.append(error)
        finally:
            over.set()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if not live_servers:
            end_at_once(number, "before the bus was ready")
        live_servers[0].stop()

    try:
        with taken(on_signal):
            server = make()
            live_servers.append(server)
            thread = threading.Thread(target=course, name="bus")
            thread.start()
            with fault_sockets(server):
                while not over.wait(1.0):
                    notifier.alive(server.wakeups)
            thread.join()
    finally:
        notifier.send(STOPPING=1)
        for open_server in live_servers:
            open_server.close()
    if failure:
        raise failure[0]
    with verdict(server.result.exit_status):
        _report_end(server.result, as_json)


def _report_ready(server: BusServer, as_json: bool) -> None:
    for right in server.real_time.refused:
        say(f"coulombus: {right}")
    for text in server.world.opened:
        say(f"coulombus: {text}")
    if as_json:
        line = {"event": "ready", "bus": server.name, "bitrate_bit_s": server.bit_rate}
        line |= {"opened": server.world.opened}
        show(json.dumps({**line, "real_time": server.real_time.as_dict()}))
    else:
        rate = f" at {server.bit_rate / 1e6:g} Mbit/s" if server.bit_rate else ""
        show(f"bus {server.name} is ready{rate}; Ctrl-C ends it")


def _report_end(result: SimResult, as_json: bool) -> None:
    for loser in result.losers:
        text = "a client (process {pid}) did not read fast enough: {lost} frames lost to it, {delivered} delivered"
        say("coulombus: " + text.format(**loser))
    if result.gone:
        say(f"coulombus: {result.gone}")
    if as_json:
        show(json.dumps({"event": "end", **asdict(result)}))
    else:
        lines = [f"{result.frames} frames in {result.seconds:.1f} s, {result.clients} clients"]
        show("\n".join((*lines, *injected_lines(result.faults, result.controllers))))
