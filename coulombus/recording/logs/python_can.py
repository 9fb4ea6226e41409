"""Formats that python-can reads, including those of its plug-ins."""

from __future__ import annotations

from pathlib import Path

from coulombus.recording.logs.log import FD, Log, clock_us, stamp_ns

__all__ = ["take"]


def take(path: str | Path, log: Log) -> str:
    """Read a file into `log` with python-can's reader for its name; return the final error, or ""."""
    import can

    from coulombus.wire.python_can_messages import can_id_of, data_of, is_classical

    try:
        with can.LogReader(path) as reader:
            for message in reader:
                if not is_classical(message):
                    log.lose(FD)
                    continue
                bus = "" if message.channel is None else str(message.channel)
                t_ns = clock_us(stamp_ns(repr(message.timestamp)))
                log.add((t_ns, can_id_of(message), message.dlc, data_of(message), bus))
    except Exception as error:  # python-can's readers raise any exception of their parsing
        return f"{type(error).__name__}: {error}"
    return ""
