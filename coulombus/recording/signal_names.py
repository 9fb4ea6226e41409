"""Find a signal by name; the error names the nearest ones."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from coulombus.rigs.signals import RigPdo, Signal
from coulombus.system.errors import CoulombusError

__all__ = ["UnknownSignal", "are_texts", "one_signal", "signal_of"]

MOST_NAMED = 6
"""Number of signals in an error if none is similar to the requested name."""


class UnknownSignal(CoulombusError, KeyError):
    """A recording has no signal of this name; the text names the nearest ones."""

    exit_status = 2

    def __str__(self) -> str:
        return str(self.args[0])


def signal_of(pdos: Iterable[RigPdo], name: str, where: str) -> Signal:
    """Return the definition of a signal in a rig's PDOs; `UnknownSignal` says that there is none
    `where`, and names the nearest ones.
    """
    signals = {signal.name: signal for pdo in pdos for signal in pdo.signals}
    if name not in signals:
        near = difflib.get_close_matches(name, signals, 3, 0.4)
        some = near or list(signals)[:MOST_NAMED]
        more = 0 if near else len(signals) - len(some)
        others = f" and {more} others; coulombus pdo lists those of a bus" if more else ""
        raise UnknownSignal(f"no signal {name!r} in {where}; there is {', '.join(some)}{others}")
    return signals[name]


def one_signal(name: Any) -> str:
    """Return the correct indexing of a recording, for an invalid `name`."""
    several = f"; of several: series(recording, {', '.join(map(repr, name))})" if are_texts(name) else ""
    return f"recording[{name!r}]: expected a signal's name, as in recording['motor.position_rad']{several}"


def are_texts(names: Any) -> bool:
    """Return whether `names` is a non-empty list of strings."""
    return isinstance(names, (list, tuple)) and bool(names) and all(isinstance(name, str) for name in names)
