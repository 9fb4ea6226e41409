"""The page of ``watch --web``, ``run --web`` and ``emulate --web``: options and server process."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.options import option, words
from coulombus.cli.rig_options import BusesOptions, mark_host
from coulombus.cli.tables import echo
from coulombus.system.exit import say

if TYPE_CHECKING:
    from pathlib import Path

    from coulombus.eds.eds_folder import EdsFiles
    from coulombus.monitor.web.page_state import FaultDoor
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = [
    "LOOPBACK",
    "PORT",
    "PageOptions",
    "serve_last_page",
    "serve_page",
    "serve_recording_page",
    "tornado_needed",
]

LOOPBACK = "127.0.0.1"
PORT = 8642
END_S = 5.0


@dataclass(frozen=True)
class PageOptions:
    """The given options of the page."""

    web: Annotated[bool, option("Serve a page to a browser; its address is printed.")]
    web_port: Annotated[
        int, option("Port of the page; 0: a free one.", type=click.IntRange(0, 65535), metavar="N", default=PORT)
    ]
    web_host: Annotated[
        str,
        option(
            "Serve the page at this address of the machine, for others of its network.", metavar="H", default=LOOPBACK
        ),
    ]

    def refuse_several(self) -> None:
        """Refuse a page of several buses.

        Raises
        ------
        click.UsageError
            A page is requested.
        """
        if self.web:
            raise click.UsageError("--web is of one bus: serve each bus' page with `coulombus watch --web --channel C`")

    @contextmanager
    def beside(
        self, bus_options: BusesOptions, address: BusAddress, view: str = "plots"
    ) -> Iterator[Callable[[float], None]]:
        """Serve the page of a bus in a separate process during the block, if requested.

        The process always ends with this one; its errors do not affect this one. Its address is printed to stderr.
        What is yielded waits for some seconds, in which the page is served. `view` is what the page opens with: the
        plots, or the bus.
        """
        if not self.web:
            yield lambda seconds: None
            return
        options = ["--bus", str(address), *words(bus_options, BusesOptions, without=["bus_names"])]
        options += words(self, PageOptions)
        command = [sys.executable, "-m", "coulombus", "watch", "--beside", view, *options]
        child = None
        try:
            child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=sys.stderr.fileno(), start_new_session=True)
        except OSError as error:
            say(f"coulombus: the page cannot be served: {error.strerror or error}")
        try:
            yield lambda seconds: None if child is None else _stay(child, seconds)
        finally:
            if child is not None:
                _end(child)


def _stay(child: subprocess.Popen[bytes], seconds: float) -> None:
    """Wait while the page is served, until its process ends or Ctrl-C."""
    if seconds <= 0.0 or child.poll() is not None:
        return
    say(f"coulombus: the page stays for {seconds:g} s; Ctrl-C ends it; a trip's again: coulombus watch --web --last")
    with suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
        child.wait(seconds)


def _end(child: subprocess.Popen[bytes]) -> None:
    """End the page's process by closing its stdin, else by a signal."""
    assert child.stdin is not None
    child.stdin.close()
    try:
        child.wait(END_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def serve_page(
    rig: Rig,
    address: BusAddress,
    page: PageOptions,
    *,
    rig_name: str,
    seconds: float | None,
    as_json: bool,
    beside: str | None,
) -> None:
    """Serve the page of a bus until a signal; its address is printed when it is ready.

    Parameters
    ----------
    rig_name : the rig's name on the command line
    beside : another verb started this process, and holds the other end of stdin; the view that the page opens with
    """
    from coulombus.host.run.control_socket import ask_change, ask_mark, ask_status, stop_host
    from coulombus.host.run.last_word import keep_page, last_word
    from coulombus.host.run.law_curve import law_curve, law_ring
    from coulombus.host.run.runbook import entry
    from coulombus.wire.address import socket_path

    with tornado_needed():
        from coulombus.monitor.web.access import kept_token
        from coulombus.monitor.web.page_state import HostDoor
        from coulombus.monitor.web.server import Shown, serve

    token_file = f"{address.kind}-{address.name}".replace("/", "_") + ".web-token"
    door = HostDoor(
        status=lambda: ask_status(address, 1.0),
        stop=lambda: stop_host(address),
        change=lambda request: ask_change(address, request, 1.0),
        mark=lambda text: ask_mark(address, text, 1.0),
        curve=law_curve,
        ring=law_ring,
        last=lambda: last_word(address),
        entry=entry,
        keep=lambda content: keep_page(address, content),
        start=shlex.join(["coulombus", "run", "--bus", str(address), "--rig", rig_name]),
    )
    serve(
        Shown(
            rig, address, door, kept_token(socket_path(address.kind).parent / token_file), _fault_door(address, page)
        ),
        lambda url: _ready(url + ("#bus" if beside == "bus" else ""), as_json),
        host=page.web_host,
        port=page.web_port,
        seconds=seconds,
        parent=sys.stdin.fileno() if beside else None,
    )


def _fault_door(address: BusAddress, page: PageOptions) -> FaultDoor | None:
    """Return the faults of a virtual bus, for a page that only this machine can open."""
    if not address.is_virtual or page.web_host not in (LOOPBACK, "localhost", "::1"):
        return None
    from coulombus.monitor.web.page_state import FaultDoor
    from coulombus.sim_bus.faults.fault_kinds import KINDS, effect_of
    from coulombus.sim_bus.server.fault_socket import BusFaults

    bus = BusFaults(address)

    def inject(fault: str, where: str) -> str:
        text = bus.inject(fault, where)
        mark_host(address, [text])
        return text

    def clear(fault: str, where: str) -> str:
        texts = bus.clear(fault, where)
        mark_host(address, texts)
        return ", ".join(texts) or "clear: nothing acts"

    return FaultDoor(bus.state, inject, clear, {kind: effect_of(kind) for kind in KINDS})


def serve_recording_page(
    file: Path,
    page: PageOptions,
    eds: EdsFiles,
    *,
    rig_name: str | None,
    channel: str | None,
    seconds: float | None,
    as_json: bool,
) -> None:
    """Serve the page of a recording until a signal; its address is printed when it is ready.

    Parameters
    ----------
    eds : EDS files for decoding; with them the attached rig is not used
    rig_name : rig for decoding; None: the attached one
    """
    from coulombus.cli.errors import remark
    from coulombus.explain.explained import explain
    from coulombus.recording.reading import read

    with tornado_needed():
        from coulombus.monitor.web.access import new_token
        from coulombus.monitor.web.recording_page import serve_recording

    recording = read(file, rig_name, channel, eds=eds)
    remark(recording.remarks)
    explanation = explain(file, rig=recording.known_rig, eds=eds, channel=channel)
    serve_recording(
        *(recording, explanation, new_token(), lambda url: _ready(url, as_json)),
        host=page.web_host,
        port=page.web_port,
        seconds=seconds,
    )


def serve_last_page(address: BusAddress | None, page: PageOptions, *, seconds: float | None, as_json: bool) -> None:
    """Serve the page that was open at the last trip until a signal.

    Parameters
    ----------
    address : the bus; None: that of the host that ended last

    Raises
    ------
    coulombus.host.run.control_socket.NoHost
        no host has tripped there, or no page was open; the text says what is left of it
    """
    from coulombus.host.run.control_socket import NoHost, host_runs, hosts_here
    from coulombus.host.run.last_word import ending, last_page, last_word, newest_word

    with tornado_needed():
        from coulombus.monitor.web.access import new_token
        from coulombus.monitor.web.last_page import LastPage
        from coulombus.monitor.web.server import serve_last

    if address is None:
        address = (newest_word() or (None, None))[0]
    word = None if address is None else last_word(address)
    if address is None or word is None:
        place = f"on bus {address}" if address else "of this user on this machine"
        running = [bus for bus in ([address] if address else hosts_here()) if host_runs(bus)]
        live = f"; one runs: coulombus watch --web --bus {running[0]}" if running else ""
        raise NoHost(f"no host {place} has left a word of its end{live}")
    content = last_page(address)
    if content is None:
        if not word["trip"]:
            raise NoHost(f"no page was kept: the last host on bus {address} did not trip; it ended {ending(word)}")
        file = word.get("recording")
        where = f"its recording: coulombus watch {shlex.quote(file)} --web" if file else "it made no recording"
        raise NoHost(f"no page was open at the end of the last host on bus {address}, {ending(word)}; {where}")
    serve_last(
        *(LastPage.from_file(content, new_token()), lambda url: _ready(url, as_json)),
        host=page.web_host,
        port=page.web_port,
        seconds=seconds,
    )


def _ready(url: str, as_json: bool) -> None:
    """Print the address of the page."""
    echo(json.dumps({"event": "ready", "url": url}) if as_json else f"page: {url}")


@contextmanager
def tornado_needed() -> Iterator[None]:
    """Explain how to install Tornado if its import fails."""
    from coulombus.monitor.web import WebError

    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "tornado":
            raise
        raise WebError("the page needs Tornado: pip install -e '.[web]' in the clone") from None
