"""``coulombus watch --pcapng F``: a bus as a pcapng stream while it runs, for ``wireshark -k -i -`` or a named pipe.

The frames of `COLLECT_S` are written with one system call. Nothing is ever sent. A slow reader
delays only this client; the bus counts its lost frames.
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.rig import Rig
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress
from coulombus.wire.client import BusDown, BusFull, OpenBus
from coulombus.wire.frame_batches import block_reader
from coulombus.wire.handshake import Flags, Hello

__all__ = ["stream"]

ASK_S = 1.0
COLLECT_S = 0.01
"""The buffer of a SocketCAN socket holds some 270 frames."""
STDOUT = "/dev/stdout"


def stream(
    rig: Rig,
    address: BusAddress,
    path: str,
    *,
    seconds: float | None = None,
    say: Callable[[str], None] = lambda text: None,
    force: bool = False,
) -> int:
    """Write the bus traffic until a signal, for `seconds`, or until the reader of a pipe closes it;
    return the number of frames.

    Parameters
    ----------
    path : a file, a named pipe, or ``-`` for the standard output; rig and EDS files are attached first
    force : overwrite an existing file

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it closed meanwhile.
    coulombus.recording.pcapng_blocks.RecordingError
        The file cannot be written.
    """
    attachments = {"rig.toml": rig.effective().encode()}
    attachments |= {name: text.encode() for name, text in rig.eds_texts.items()}
    with open_bus(address, Hello(Flags.LISTEN_ONLY | Flags.ERRORS)) as client:
        place, force = (STDOUT, True) if path == "-" else (path, force)
        try:
            with (
                PcapngWriter(place, attachments=attachments, interface=str(address), force=force) as writer,
                StopSignals() as stop,
            ):
                _copy(client, writer, stop, None if seconds is None else time.monotonic() + seconds)
                frames = writer.frames
        except RecordingError as error:
            if not isinstance(error.__cause__, BrokenPipeError):
                raise
            if path == "-":  # avoids an error of the interpreter at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            return 0
    if client.lost:
        say(f"{client.lost} frames were lost: the reader of {Path(place).name} is slower than the bus")
    return frames


def _copy(client: OpenBus, writer: PcapngWriter, stop: StopSignals, end: float | None) -> None:
    last_question_s = time.monotonic()
    frames = block_reader(client)
    both = stop.fileno(), client.fileno()
    while not stop.number:
        now = time.monotonic()
        if end is not None and now >= end:
            return
        select.select(both, [], [], min(ASK_S, ASK_S if end is None else end - now))
        select.select([stop], [], [], COLLECT_S)
        with suppress(BusDown, BusFull):
            if len(block := frames.receive()):
                writer.write(block.records)
            if now - last_question_s > ASK_S:
                last_question_s = now
                client.ask()
