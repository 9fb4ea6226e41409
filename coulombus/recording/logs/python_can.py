"""Formats that python-can reads, including those of its plug-ins."""

from __future__ import annotations

from pathlib import Path

from coulombus.recording.logs.log import FD, Log
from coulombus.recording.logs.stamps import float_ns

__all__ = ["read_log"]


def read_log(path: str | Path, log: Log, suffix: str) -> str:
    """Read a file into `log` with python-can's reader for a format, by its usual ending ("": that of the file's name);
    return the final error, or "".
    """
    import can
    from can.io.player import MESSAGE_READERS

    from coulombus.wire.python_can_messages import can_id_of, data_of, is_classical

    try:
        with MESSAGE_READERS.get(suffix, can.LogReader)(path) as reader:
            for message in reader:
                if not is_classical(message):
                    log.lose(FD)
                    continue
                bus = "" if message.channel is None else str(message.channel)
                t_ns = float_ns(repr(message.timestamp))
                log.add((t_ns, can_id_of(message), message.dlc, data_of(message), bus))
    except Exception as error:  # python-can's readers raise any exception of their parsing
        return f"{type(error).__name__}: {error}"
    return ""
