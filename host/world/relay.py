"""Messages of a WebSocket client on one side, the records of the host's socket on the other.

`Relay` does no input or output; `monitor.web.world_gateway` does. The client's first message decides its
form: text is JSON, bytes are the records of `host.world.protocol`. docs/worlds.md has each message.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from coulombus.host.errors import HostError
from coulombus.host.world.model_parts import NAMES, PLANE_NAMES, Model
from coulombus.host.world.protocol import (
    SIZES,
    WITH_STATES,
    Greeting,
    Kind,
    Named,
    Refusal,
    Welcome,
    read_named,
    read_refusal,
    read_welcome,
    records_in,
)
from coulombus.host.world.records import MODEL, STATE
from coulombus.host.world.state import State
from coulombus.rigs.arguments import WrongCall

__all__ = ["MalformedMessage", "Relay"]

MOST_STATES = 2000
"""States that wait for a slow client: two seconds of an axis at 1 kHz. Beyond them the oldest are lost."""
MOST_REFUSALS = 64
MOST_SEQUENCE = 1 << 62
AT_ONCE = 1 << 16
HELLO_KEYS = {"type", "states", "key"}
IN_PLANE = {"point_m", "normal", "K_N_m", "N", "N_m", "Ns_m", "force_N", "direction"}
"""Fields by which a part is one of the plane."""
MODEL_KEYS = {"type", "sequence", "t_ns", "axis", "profile", "parameters", *NAMES.values(), "law", "life_s"}


class MalformedMessage(HostError):
    """A message of a WebSocket client has no documented form; the text gives the reason."""

    exit_status = 2


class Relay:
    """One client's side and the host's side, until either ends.

    Attributes
    ----------
    malformed : messages of the client so far that had no documented form
    lost : states so far that this client did not get because it was slow
    """

    def __init__(self) -> None:
        self.malformed = self.lost = 0
        self._is_json: bool | None = None
        self._stream = bytearray()
        self._welcome: list[bytes] = []
        self._is_welcomed = False
        self._slots: dict[int, dict[str, int]] = {}
        self._sequence = 0
        self._states: deque[bytes] = deque()
        self._refusals: deque[Refusal] = deque(maxlen=MOST_REFUSALS)

    # from the client to the host

    def translate(self, message: str | bytes) -> bytes:
        """Return the records of a client's message; a malformed one is counted, and refused in `batch`.

        Raises
        ------
        MalformedMessage
            the message has no documented form
        """
        try:
            return self._records(message)
        except (MalformedMessage, WrongCall, ValueError, TypeError, OverflowError, RecursionError) as error:
            self.malformed += 1
            what = "it is nested too deeply" if isinstance(error, RecursionError) else error
            reason = f"malformed message {self.malformed}: {what}"
            self._refusals.append(Refusal(0, 0, reason))
            raise MalformedMessage(reason) from None

    def _records(self, message: str | bytes) -> bytes:
        is_json = isinstance(message, str)
        if self._is_json is None:
            expected = (Kind.HELLO,)
            self._is_json = is_json
        else:
            expected = (Kind.MODEL,)
        if is_json != self._is_json:
            raise MalformedMessage("text and bytes are mixed: the first message decides")
        try:
            if isinstance(message, str):
                return self._from_json(message, expected)
            return _whole_records(message, expected)
        except Exception:
            if expected == (Kind.HELLO,):
                self._is_json = None
            raise

    def _from_json(self, text: str, expected: tuple[Kind, ...]) -> bytes:
        fields = json.loads(text, parse_constant=_no_constant)
        if not isinstance(fields, dict):
            raise MalformedMessage("expected a JSON object")
        name = expected[0].name.lower()
        if fields.get("type") != name:
            raise MalformedMessage(f'expected "type": "{name}"')
        _check_keys(fields, HELLO_KEYS if name == "hello" else MODEL_KEYS)
        if name == "hello":
            return Greeting(WITH_STATES if fields.get("states", True) else 0, str(fields.get("key", ""))).record()
        return self._model(fields)

    def _model(self, fields: Mapping[str, Any]) -> bytes:
        """Return the record of a JSON model."""
        values: dict[str, Any] = {key: fields[key] for key in ("law", "life_s", "parameters") if key in fields}
        for name in (*NAMES.values(), "parameters"):
            value = fields.get(name, {})
            if not isinstance(value, dict) and (value is not None or name == "parameters"):
                raise MalformedMessage(f"{name}: expected an object")
        profile = dict(fields.get("profile") or {})
        number = profile.pop("number", 0)
        for (kind, name), of_plane in zip(NAMES.items(), PLANE_NAMES, strict=True):
            part = profile if name == "profile" else fields.get(name)
            if part is not None and (part or name != "profile"):
                values[name] = (of_plane if IN_PLANE & {**part}.keys() else kind)(**part)
        axis, sequence, t_ns = (fields.get(key, 0) for key in ("axis", "sequence", "t_ns"))
        if not all(type(value) is int and abs(value) < 1 << 63 for value in (axis, sequence, t_ns, number)):
            raise MalformedMessage("axis, sequence, t_ns and number of the profile: expected whole numbers of 64 bits")
        if not 0 <= sequence < MOST_SEQUENCE:
            raise MalformedMessage(f"sequence is {sequence}: expected a number above 0, and below 2^62; 0 for the next")
        record = Model(**values).record(self._slots.get(axis, {}), profile=number)
        record["axis"], record["t_ns"] = axis, t_ns
        record["sequence"] = sequence or self._sequence + 1
        self._sequence = max(self._sequence, int(record["sequence"]))
        data: bytes = record.tobytes()
        return data

    # from the host to the client

    def receive(self, data: bytes) -> None:
        """Take bytes of the host's socket.

        Raises
        ------
        MalformedMessage
            they are no records
        """
        self._stream += data
        records = records_in(self._stream, AT_ONCE)
        if records is None:
            raise MalformedMessage("the host sends no records of this protocol")
        for kind, record in records:
            if kind == Kind.STATE:
                self._states.append(record)
            elif kind == Kind.REFUSED:
                self._refusals.append(read_refusal(record))
            else:
                self._begin(kind, record)
        while len(self._states) > MOST_STATES:
            self._states.popleft()
            self.lost += 1

    def _begin(self, kind: Kind, record: bytes) -> None:
        self._welcome.append(record)
        if kind == Kind.PARAMETER:
            named = read_named(record)
            if named.slot >= 0:
                self._slots.setdefault(named.axis, {})[named.name] = named.slot
        self._is_welcomed = len(self._welcome) == read_welcome(self._welcome[0]).parameters + 1

    @property
    def is_pending(self) -> bool:
        """Whether `batch` has something to send."""
        return bool(self._states or self._refusals or self._is_welcomed)

    def batch(self) -> list[str | bytes]:
        """Return the messages for the client: welcome, refusals, then all states that wait."""
        messages: list[str | bytes] = []
        if self._is_welcomed:
            messages.append(_welcome_text(self._welcome) if self._is_json else b"".join(self._welcome))
            self._is_welcomed = False
        refusals, self._refusals = list(self._refusals), deque(maxlen=MOST_REFUSALS)
        messages += [
            refusal.record() if self._is_json is False else json.dumps({"type": "refused", **refusal._asdict()})
            for refusal in refusals
        ]
        if self._states:
            states = np.frombuffer(b"".join(self._states), STATE).copy()
            self._states.clear()
            states["lost"] += self.lost
            messages.append(_states_text(states) if self._is_json else states.tobytes())
        return messages


def _no_constant(name: str) -> Any:
    raise MalformedMessage(f"{name} is no JSON number")


def _check_keys(fields: Mapping[str, Any], allowed: set[str]) -> None:
    unknown = sorted(fields.keys() - allowed)
    if unknown:
        raise MalformedMessage(f"{unknown[0]}: expected one of {', '.join(sorted(allowed))}")


def _whole_records(message: bytes, expected: tuple[Kind, ...]) -> bytes:
    """Return a binary message if it holds whole records of the expected kind."""
    rest = bytearray(message)
    records = records_in(rest, AT_ONCE)
    if not records or rest or any(kind not in expected for kind, _ in records):
        name, size = expected[0].name, SIZES[expected[0]]
        raise MalformedMessage(f"expected whole {name} records of {size} bytes")
    return message


def _welcome_text(records: list[bytes]) -> str:
    """Return WELCOME and its PARAMETER records as JSON."""
    welcome: Welcome = read_welcome(records[0])
    parameters: list[Named] = [read_named(record) for record in records[1:]]
    fields = {**welcome._asdict(), "parameters": [named._asdict() for named in parameters]}
    return json.dumps({"type": "welcome", **fields})


def _states_text(states: Any) -> str:
    """Return states as JSON: a list of each field; null for what is no finite number."""
    columns: dict[str, Any] = {"type": "states"}
    for name in State._fields:
        column = states[name]
        values = column.tolist()
        if not np.isfinite(column).all():
            values = [value if np.isfinite(value) else None for value in values]
        columns[name] = values
    return json.dumps(columns, allow_nan=False)


assert MODEL.itemsize == SIZES[Kind.MODEL]
