"""Match a recording's buses with the rig's: an identifier is only meaningful on its bus.

A bus of the file has the name of its interface or channel, and matches the rig's bus of that name.
A recording made by coulombus names its bus in its attached rig. A single bus in both needs no name.
As many foreign names as the rig has buses are matched in the order of the names, with a remark.
Otherwise the user must name the bus: ``can0``, or ``a=can0`` for a rig with several buses.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from coulombus.recording.file_content import Capture
from coulombus.rigs.arguments import WrongCall
from coulombus.system.errors import CoulombusError

__all__ = ["BusMatch", "Channel", "ChannelError", "bus_names", "channel_texts", "recorded_channel"]

Channel: TypeAlias = str | Sequence[str] | None
"""A bus of the file, or several as ``RIG_BUS=BUS``."""
MOST_NAMED, LONGEST_NAME = 10, 64
"""Buses of a file, and characters of a bus, in a line: a hostile file has thousands."""


class ChannelError(CoulombusError):
    """The bus is ambiguous; the text names the buses of the file."""

    exit_status = 2


def channel_texts(channel: Channel) -> tuple[str, ...]:
    """Return the buses from a script or an option as strings.

    Raises
    ------
    coulombus.rigs.arguments.WrongCall
        It is something else.
    """
    texts = () if channel is None else (channel,) if isinstance(channel, str) else tuple(channel)
    if any(not isinstance(text, str) for text in texts):
        raise WrongCall(f'channel is {channel!r}: expected a bus of the file, as in channel="can0"')
    return texts


def bus_names(capture: Capture) -> tuple[str, ...]:
    """Return the names of a file's buses, each once; ("",) for one bus without a name."""
    return tuple(dict.fromkeys(name for name in capture.buses if name)) or ("",)


def recorded_channel(attachments: Mapping[str, bytes]) -> str:
    """Return the rig's bus of a coulombus recording; "" if it does not name it."""
    try:
        rig: dict[str, Any] = tomllib.loads(attachments.get("rig.toml", b"").decode())
        shared = rig.get("bus", {}).get("channel", "")
        axes = rig.get("axis", {}).values()
        channels = {axis.get("bus", {}).get("channel", shared) for axis in axes} or {shared}
    except (ValueError, AttributeError):
        return ""
    (channel, *others) = channels
    return channel if isinstance(channel, str) and not others else ""


@dataclass
class BusMatch:
    """The match for one pass through a recording.

    Parameters
    ----------
    path : the recording
    channels : the rig's buses
    selected : the user's choice, see `Channel`
    recorded : the rig's bus of a coulombus recording
    single : why there may be no more than one bus, where `channels` has one
    """

    path: str
    channels: tuple[str, ...]
    selected: tuple[str, ...] = ()
    recorded: str = ""
    single: str = "the rig has one"
    left_out: Counter[str] = field(default_factory=Counter)
    _names: tuple[str, ...] = ()
    _channel_of: dict[str, str] = field(default_factory=dict)
    _in_order: bool = False

    @classmethod
    def without_rig(cls, path: str, selected: tuple[str, ...]) -> BusMatch:
        """Return the match of a recording without a rig: to one bus."""
        return cls(path, ("",), tuple(text.rpartition("=")[2] for text in selected), single="they are of one bus each")

    def select(self, capture: Capture) -> Capture:
        """Return a stretch with only the frames of the rig's buses.

        Raises
        ------
        ChannelError
            The buses are ambiguous.
        """
        names = bus_names(capture)
        if names != self._names:
            self._match(names)
        channels = tuple(self._channel_of.get(name) for name in capture.buses)
        if any(channel is None and name for channel, name in zip(channels, capture.buses, strict=True)):
            capture = self._without(capture, np.array([channel is not None for channel in channels]))
        if len(self.channels) == 1:
            return capture
        return replace(capture, channels=tuple(channel or "" for channel in channels))

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on frames left out so far, and on buses matched by order."""
        counts = list(self.left_out.items())
        texts = [
            f"{self.path}: {count} frames of the bus {_shown(name)} were left out"
            for name, count in counts[:MOST_NAMED]
        ]
        further = counts[MOST_NAMED:]
        if further:
            count = sum(count for _, count in further)
            texts.append(f"{self.path}: {count} frames of {len(further)} further buses were left out")
        if self._in_order:
            pairs = ", ".join(f"{_shown(name)} is {channel}" for name, channel in self._channel_of.items())
            texts.append(
                f"{self.path}: of its buses, in the order of their names, {pairs} of the rig; else say it with --channel"
            )
        return tuple(texts)

    def _match(self, names: tuple[str, ...]) -> None:
        before = self._channel_of
        self._channel_of = self._by_hand(names) if self.selected else self._by_name(names)
        if any(self._channel_of.get(name) != channel for name, channel in before.items()):
            raise self._unknown(names)
        self._names = names

    def _by_hand(self, names: tuple[str, ...]) -> dict[str, str]:
        channel_of: dict[str, str] = {}
        for text in self.selected:
            channel, _, name = text.rpartition("=")
            if len(names) == 1 and name == self.recorded:
                name = names[0]
            if name not in names:
                raise ChannelError(f"{self.path}: --channel {text}: {_has(names)}")
            if not channel:
                alone = len(self.channels) == 1
                channel = self.channels[0] if alone else self.recorded if self.recorded in self.channels else name
            if channel not in self.channels:
                listed = ", ".join(self.channels)
                remedy = f"say which: --channel {self.channels[0] or 'RIG_BUS'}={name}"
                raise ChannelError(f"{self.path}: --channel {text}: the rig has the buses {listed}; {remedy}")
            if name in channel_of or channel in channel_of.values():
                raise ChannelError(f"{self.path}: --channel {text}: a bus is given twice")
            channel_of[name] = channel
        return channel_of

    def _by_name(self, names: tuple[str, ...]) -> dict[str, str]:
        if len(names) == 1 and self.recorded in self.channels:
            return {names[0]: self.recorded}
        same = {name: name for name in names if name and name in self.channels}
        if same:
            return same
        if len(names) != len(self.channels):
            raise self._unknown(names)
        self._in_order = len(names) > 1
        return dict(zip(sorted(names, key=_by_number), self.channels, strict=True))

    def _unknown(self, names: tuple[str, ...]) -> ChannelError:
        if len(self.channels) == 1:
            return _several(self.path, names, self.single)
        listed = ", ".join(self.channels)
        remedy = f"say which is which: --channel {self.channels[0]}={_shown(names[0]) or 'NAME'}"
        return ChannelError(f"{self.path}: {_has(names)}, and the rig has the buses {listed}; {remedy}")

    def _without(self, capture: Capture, is_matched: Any) -> Capture:
        frames = capture.frames
        remains = is_matched[frames["source"]]
        for source, count in Counter(frames["source"][~remains].tolist()).items():
            self.left_out[capture.buses[source]] += count
        rows = np.concatenate(([0], np.cumsum(remains)))
        last = int(rows[-1]) - 1  # a comment moves to the next remaining frame
        comments = [(min(int(rows[row]), last), text) for row, text in capture.comments if last >= 0]
        return replace(capture, frames=frames[remains], comments=comments)


def _by_number(name: str) -> tuple[list[str], list[int]]:
    """Return a sort key that puts can2 before can10."""
    return re.split(r"\d+", name), [int(digits) for digits in re.findall(r"\d+", name)]


def _several(path: str, names: tuple[str, ...], why: str) -> ChannelError:
    return ChannelError(f"{path}: {_has(names)}, and {why}; name one with --channel {_shown(names[0])}")


def _shown(name: str) -> str:
    """Return the begin of a name."""
    return name[:LONGEST_NAME]


def _has(names: tuple[str, ...]) -> str:
    named = [_shown(name) for name in names if name]
    if len(named) > 1:
        more = f" and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
        return f"the file has the buses {', '.join(named[:MOST_NAMED])}{more}"
    return f"the file has the bus {named[0]}" if named else "the file has one bus, without a name"
