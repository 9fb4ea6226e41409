"""A device with its EDS file: objects by number or by name, typed values with units."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.data import READ_ONLY, decode, encode, without_fill
from coulombus.eds.eds_folder import fitting, read_folder
from coulombus.eds.own_devices import identity_from_1018h, packaged
from coulombus.eds.reader import Description, Value, Variable, parse_eds, read_eds
from coulombus.eds.sdo_frames import where
from coulombus.eds.units import BLOCK_UNITS, Unit, fixed_unit, unit_from_code
from coulombus.host.errors import DeviceMismatch, HostError, SdoAborted
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.host.sdo.transfers import MOST_BYTES, Progress

__all__ = ["KnownDevice", "ObjectUnknown", "Reading", "ValueRefused", "describe", "identity_of"]

Place = tuple[int, int]
STORED_EDS = (0x1021, 0)
BOOLEAN, UNSIGNED8, UNSIGNED16, UNSIGNED32, UNSIGNED64 = 0x0001, 0x0005, 0x0006, 0x0007, 0x001B
BY_WIDTH = {1: UNSIGNED8, 2: UNSIGNED16, 4: UNSIGNED32, 8: UNSIGNED64}
TYPE_CODES = {kind.name: code for code, kind in DATA_TYPES.items() if kind.kind not in ("record", "time")}
SHOWN_BYTES = 64
PLACE = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:[:.](?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE)
NUMBER = re.compile(r"([-+]?(?:0x[0-9a-f]+|[0-9][0-9a-f]*h|[0-9.]+(?:e[-+]?[0-9]+)?))\s*(.*)", re.IGNORECASE)
ROUNDED = 1e-9
LARGEST_REAL32 = (2 - 2**-23) * 2.0**127


class ObjectUnknown(HostError):
    """No object has this name; the text has the nearest names."""

    exit_status = 2


class ValueRefused(HostError):
    """The object cannot take this value; the text has the expected values."""

    exit_status = 2


@dataclass(frozen=True)
class Reading:
    """Value of an object.

    Attributes
    ----------
    raw : the transferred number; for other types the bytes in hexadecimal
    value : the number in `unit`; for a text the text
    remark : text if the object's length differs from its data type, else ""
    """

    variable: Variable
    data: bytes
    raw: int | float | str
    value: int | float | str
    unit: str
    remark: str = ""

    def as_dict(self, node_id: int) -> dict[str, Any]:
        """Return plain values for JSON; a REAL that is NaN or infinite becomes text."""
        kind = DATA_TYPES.get(self.variable.data_type)
        return {
            "node_id": node_id,
            "index": self.variable.index,
            "subindex": self.variable.subindex,
            "name": self.variable.name or None,
            "type": kind.name if kind else None,
            "raw": _finite(self.raw),
            "value": _finite(self.value),
            "unit": self.unit,
        }

    def __str__(self) -> str:
        if isinstance(self.value, str):
            return self.value
        text = f"{self.value:.12g}" if isinstance(self.value, float) else str(self.value)
        words = [f"{text} {self.unit}".rstrip()]
        if isinstance(self.raw, int):
            width = 2 * len(self.data)
            words.append(f"({self.raw & (1 << 4 * width) - 1:0{width}X}h)")
        return " ".join(words)


def _finite(value: float | str) -> float | str:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def identity_of(client: SdoClient) -> tuple[int, int, int]:
    """Return vendor id, product code and revision of a node; 0 for entries that it lacks.

    Raises
    ------
    SdoSilent
        (exit status 5) the node does not answer
    AnswerUntrusted
        (6, or 3) its answer is not valid, or two devices answer
    """
    numbers = []
    for part in (1, 2, 3):
        try:
            numbers.append(int.from_bytes(client.upload(0x1018, part, most=4), "little"))
        except SdoAborted:
            numbers.append(0)
    return numbers[0], numbers[1], numbers[2]


def describe(
    client: SdoClient, source: Path | str | None, progress: Progress = lambda done, total: None
) -> Description | None:
    """Return the EDS file of a node; None if there is none.

    Parameters
    ----------
    source : an EDS or DCF file; a folder of them, of which the file with the node's identity is used;
        "device": the file stored in the node (1021h); None: the packaged file of this project's device

    Raises
    ------
    EdsError
        (exit status 3) the file cannot be read
    DeviceMismatch
        (3) the file is for another device, or the folder has no file for this device
    """
    if source == "device":
        return parse_eds(
            client.upload(*STORED_EDS, most=MOST_BYTES, progress=progress), f"1021h of node {client.node_id}"
        )
    identity = identity_of(client)
    label = f"node {client.node_id} has 1018h {identity[0]:#010x} {identity[1]:#010x}"
    if source is None:
        return fitting(packaged(), identity[:2], identity[2])
    path = Path(source)
    if not path.is_dir():
        description = read_eds(path)
        expected = identity_from_1018h(description)
        if any(expected) and expected != identity[:2]:
            raise DeviceMismatch(f"{label}, and {path} is the file of {expected[0]:#010x} {expected[1]:#010x}")
        return description
    files, _ = read_folder(path)
    fitted = fitting(files, identity[:2], identity[2])
    if fitted is None:
        raise DeviceMismatch(f"{label}, and none of {len(files)} EDS files in {path} has it")
    return fitted


@dataclass
class KnownDevice:
    """A node with its EDS file; None without one.

    Attributes
    ----------
    units : units of objects from a rig file; they take precedence over CiA's
    """

    client: SdoClient
    description: Description | None = None
    units: Mapping[Place, Unit] = field(default_factory=dict)
    _blocks: dict[Place, Unit | None] = field(default_factory=dict)

    @property
    def node_id(self) -> int:
        """The node id."""
        return self.client.node_id

    # objects

    def variables(self) -> Iterator[Variable]:
        """Yield all variables in the EDS file, from 1000h on."""
        for index, entry in sorted((self.description.objects if self.description else {}).items()):
            if index >= 0x1000:
                yield from entry.variables.values()

    @cached_property
    def names(self) -> Mapping[str, Variable]:
        """Objects by name: "Heartbeat_time", "Identity.Vendor_ID"; blanks are underscores.

        A duplicate name gets its number appended: "Current_2003h00".
        """
        variables: dict[str, list[tuple[str, Variable]]] = {}
        for variable in self.variables():
            assert self.description is not None
            entry = self.description.objects[variable.index]
            single = len(entry.variables) == 1 and variable.subindex == 0
            name = _word(entry.name if single else f"{entry.name}.{variable.name}")
            variables.setdefault(name.lower(), []).append((name, variable))
        return {
            name if len(row) == 1 else f"{name}_{variable.index:04X}h{variable.subindex:02X}": variable
            for row in variables.values()
            for name, variable in row
        }

    def find(self, text: str) -> Variable:
        """Return the object named by a text: ``6041h``, ``0x6041``, ``6041:00`` (sub-indices are
        hexadecimal, too), or its name in the EDS file.

        Raises
        ------
        ObjectUnknown
            (exit status 2) there is no such object
        """
        small = {name.lower(): variable for name, variable in self.names.items()}
        if (word := _word(text).lower()) in small:
            return small[word]
        match = PLACE.fullmatch(text.strip())
        if match:
            return self.at(int(match[1], 16), int(match[2] or "0", 16))
        if self.description is None:
            raise ObjectUnknown(
                f"{text!r}: without an EDS file objects have numbers only, as 6041h or 1018h:01; name a file by --eds"
            )
        ends = [name for name in small if name.rpartition(".")[2] == word]
        if len(ends) == 1:
            return small[ends[0]]
        spelled = {name.rpartition(".")[2].lower(): name for name in self.names} | {n.lower(): n for n in self.names}
        near = ends or difflib.get_close_matches(word, spelled, 3, 0.5)
        names = ", ".join(dict.fromkeys(spelled.get(name, name) for name in near))
        hint = f"; did you mean {names}?" if names else "; `ls` in `coulombus sdo NODE` lists them"
        raise ObjectUnknown(f"{text!r}: {self.description.path} has no such object{hint}")

    def at(self, index: int, subindex: int) -> Variable:
        """Return the object with these indices; an object that is not in the EDS file has no type."""
        if self.description is not None and self.description.has(index, subindex):
            return self.description.variable(index, subindex)
        return Variable(index, subindex, "", 0, "rw", None, False, None, None, False, 0)

    # values

    def unit(self, variable: Variable) -> Unit | None:
        """Return the unit of an object: the rig file's, CiA's, or the device's (6131h)."""
        place = variable.index, variable.subindex
        unit = self.units.get(place) or fixed_unit(*place)
        if unit is None and variable.index in BLOCK_UNITS and variable.subindex:
            if place not in self._blocks:
                self._blocks[place] = self._block_unit(*BLOCK_UNITS[variable.index], variable.subindex)
            unit = self._blocks[place]
        return unit

    def _block_unit(self, unit: int, digits: int, subindex: int) -> Unit | None:
        try:
            code, count = (
                int.from_bytes(self.client.upload(index, subindex, most=4), "little") for index in (unit, digits)
            )
        except SdoAborted:
            return None
        return unit_from_code(code, count)

    def upload(
        self, variable: Variable, *, most: int = MOST_BYTES, progress: Progress = lambda done, total: None
    ) -> bytes:
        """Return an object's bytes, without fill bytes of a number.

        Raises as `host.sdo.sdo_client.SdoClient.upload`.
        """
        size = (variable.bits + 7) // 8
        data = self.client.upload(
            variable.index,
            variable.subindex,
            most=most,
            unsized=lambda data: data[: size or None],  # four bytes without a length: the type decides
            progress=progress,
        )
        return without_fill(variable, data)

    def read(self, variable: Variable, progress: Progress = lambda done, total: None) -> Reading:
        """Return the value of an object. Raises as `host.sdo.sdo_client.SdoClient.upload`."""
        max_bytes = (variable.bits + 7) // 8 + 8 if variable.bits else MOST_BYTES
        return self.reading(variable, self.upload(variable, most=max_bytes, progress=progress))

    def reading(self, variable: Variable, data: bytes) -> Reading:
        """Return the value of bytes; without a data type, 1, 2, 4 or 8 bytes are read as a number."""
        kind = variable
        if not variable.data_type and len(data) in BY_WIDTH:
            kind = Variable(**{**vars(variable), "data_type": BY_WIDTH[len(data)]})
        content = decode(kind, data)
        if isinstance(content, bytes):
            text = content.hex(" ") if len(content) <= SHOWN_BYTES else f"{len(content)} bytes"
            return Reading(variable, data, data.hex(), text, "", self._other_length(variable, data))
        if isinstance(content, str):
            return Reading(variable, data, data.hex(), content, "")
        unit = self.unit(variable)
        if unit is None:
            return Reading(kind, data, content, content, "")
        value = content if unit.scale == 1 and not unit.offset else content * unit.scale + unit.offset
        return Reading(kind, data, content, value, unit.unit)

    def _other_length(self, variable: Variable, data: bytes) -> str:
        kind, size = DATA_TYPES.get(variable.data_type), (variable.bits + 7) // 8
        if kind is None or not size or len(data) == size:
            return ""
        place = where(variable.index, variable.subindex)
        return f"{place} has {len(data)} bytes in the device; {kind.name} has {size} ({self._path})"

    def parse(self, variable: Variable, text: str, *, type_name: str = "") -> bytes:
        """Return the bytes of a value that a user enters, checked against type, limits and access.

        A number without a unit is raw; a number with the object's unit ("0.5 Nm") is converted. Bytes are
        hexadecimal, or those of a file: ``@FILE``.

        Parameters
        ----------
        type_name : data type of an object without an EDS file, as UNSIGNED16

        Raises
        ------
        ValueRefused
            (exit status 2) the text is not a valid value of the object
        """
        if type_name:
            code = TYPE_CODES.get(type_name.upper())
            if code is None:
                raise ValueRefused(f"{type_name}: expected one of {', '.join(TYPE_CODES)}")
            variable = Variable(**{**vars(variable), "data_type": code})
        what = f"{where(variable.index, variable.subindex)} {variable.name}".rstrip()
        if variable.access in READ_ONLY:
            raise ValueRefused(f"{what} can only be read, says {self._path}")
        kind = DATA_TYPES.get(variable.data_type)
        if kind is None:
            raise ValueRefused(
                f"{what}: its type is not known; name it by --type, as UNSIGNED16, or an EDS file by --eds"
            )
        if kind.kind in ("int", "bool", "real"):
            return encode(variable, self._number(variable, text, what))
        if text.startswith("@"):
            return Path(text[1:]).read_bytes()
        if kind.kind in ("text", "unicode"):
            return encode(variable, text)
        try:
            return bytes.fromhex(text.removeprefix("0x"))
        except ValueError:
            raise ValueRefused(f"{what}: {text!r} is not a row of hexadecimal bytes; a file is @FILE") from None

    @property
    def _path(self) -> str:
        return self.description.path if self.description else "its EDS file"

    def _number(self, variable: Variable, text: str, what: str) -> Value:
        kind = DATA_TYPES[variable.data_type]
        match = NUMBER.fullmatch(text.strip())
        if match is None:
            word = {"true": 1, "false": 0}.get(text.strip().lower())
            if kind.kind != "bool" or word is None:
                raise ValueRefused(f"{what}: {text!r} is not a number; expected {kind.name}")
            return word
        number = _spelled(match[1], text, what)
        if match[2]:
            unit = self.unit(variable)
            if unit is None or unit.unit != match[2]:
                unit_text = f"its unit is {unit.unit!r}" if unit else "it has no unit that is known"
                raise ValueRefused(f"{what}: {text!r}: {unit_text}; a number alone is raw")
            number = (number - unit.offset) / unit.scale
            if kind.kind != "real" and abs(number - round(number)) > ROUNDED * max(1.0, abs(number)):
                near = round(number) * unit.scale + unit.offset
                raise ValueRefused(
                    f"{what}: {text!r} lies between two counts; the nearest value is {near:.12g} {unit.unit}"
                )
            number = number if kind.kind == "real" else round(number)
        if not math.isfinite(number):
            raise ValueRefused(f"{what}: {text!r} is too large; expected {kind.name}")
        if kind.kind != "real":
            if number != int(number):
                raise ValueRefused(f"{what}: {text!r} is not a whole number; expected {kind.name}")
            number = int(number)
        widest = LARGEST_REAL32 if kind.bits == 32 else math.inf  # of a REAL
        low, high = variable.whole or (-widest, widest)
        low = low if variable.low is None else max(low, variable.low)
        high = min(high, variable.largest)
        if not low <= number <= high:
            raise ValueRefused(f"{what}: {text!r} is out of range; expected {low} to {high}")
        return number

    def write(self, variable: Variable, data: bytes, progress: Progress = lambda done, total: None) -> Reading | None:
        """Write an object and return the value read back; None for a write-only object.

        Raises as `host.sdo.sdo_client.SdoClient.upload`.
        """
        self.client.download(variable.index, variable.subindex, data, progress=progress)
        if variable.access == "wo":
            return None
        return self.read(variable)


def _word(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip())


def _spelled(number: str, text: str, what: str) -> float:
    try:
        if number.lower().endswith("h") and "0x" not in number.lower():
            return int(number[:-1], 16)
        if "0x" in number.lower():
            return int(number, 16)
        value = float(number)
        whole = re.fullmatch(r"[-+]?[0-9]+", number)
        return int(number) if whole else value
    except (ValueError, OverflowError):
        raise ValueRefused(f"{what}: {text!r} is not a number") from None
