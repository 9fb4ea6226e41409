"""Names of signals in other tools."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from coulombus.eds.pdo import Entry
from coulombus.rigs.signals import RigPdo, Signal

__all__ = ["fields", "identifier", "plain", "signals"]


def fields(pdo: RigPdo) -> Iterator[tuple[Signal, Entry, int]]:
    """Yield signal, entry and first bit of a PDO's content, without gaps."""
    layout = pdo.layout
    for signal, entry, start in zip(pdo.signals, layout.entries, layout.starts, strict=True):
        if not entry.dummy:
            yield signal, entry, start


def signals(pdos: Iterable[RigPdo]) -> Iterator[tuple[RigPdo, Signal]]:
    """Yield every signal with its PDO."""
    for pdo in pdos:
        for signal, _, _ in fields(pdo):
            yield pdo, signal


def identifier(signal: Signal) -> str:
    """Return the last part of a signal's name as an identifier for any tool; an object without a
    role, "6060h:0", becomes "object_6060h_0".
    """
    word = re.sub(r"\W", "_", signal.name.rpartition(".")[2])
    return f"object_{word}" if word[:1].isdigit() else word


def plain(signal: Signal) -> str:
    """Return a signal's name as words, without its unit: "motor.position" of
    "motor.position_rad".
    """
    unit = "_" + signal.unit.replace("/", "_").replace(" ", "_")
    word = identifier(signal)
    head, dot, _ = signal.name.rpartition(".")
    return head + dot + (word.removesuffix(unit) if signal.unit else word)
