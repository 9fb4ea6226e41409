"""A device's configuration as a DCF: dump, comparison with the device, restore.

Objects that act when written are not configuration: set-points, controlwords, objects in the device's
RPDOs, and commands such as store and restore. They are neither dumped nor restored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.data import decode, encode
from coulombus.eds.dcf_text import configured
from coulombus.eds.drive_axis import first_axis_object
from coulombus.eds.own_devices import identity_from_1018h
from coulombus.eds.reader import Description, Value, Variable
from coulombus.eds.sdo_frames import where
from coulombus.host.devices.device import KnownDevice, identity_of
from coulombus.host.errors import DeviceMismatch, SdoAborted

__all__ = ["Dump", "ObjectDifference", "acts", "check_file", "differences", "dump", "restore"]

Place = tuple[int, int]
Show = Callable[[int, int], None]
WRITABLE = ("rw", "rwr")
SETPOINTS = (0x6040, 0x6042, 0x6071, 0x607A, 0x60FF, 0x60B0, 0x60B1, 0x60B2, 0x60FE)
"""Set-points of CiA 402, of a drive's first axis."""
OUTPUTS = (0x6200, 0x6300, 0x6400, 0x6411, 0x7300, 0x9300)
"""Outputs of CiA 401 and 404."""
COMMANDS = (0x1003, 0x1010, 0x1011, 0x1020, 0x1021, 0x1022, 0x1023, 0x1024, 0x1F50, 0x1F51, 0x1F80)
RPDO_MAPS = range(0x1600, 0x1800)
INVALID = 1 << 31
MOST_BYTES = 4096
"""Largest size of a setting."""


def acts(variable: Variable, mapped: Iterable[Place] = ()) -> bool:
    """Return whether a write of the object has an immediate effect.

    Parameters
    ----------
    mapped : objects in the device's RPDOs
    """
    index = variable.index
    return (
        first_axis_object(index) in SETPOINTS
        or index in (*OUTPUTS, *COMMANDS)
        or variable.access == "rww"
        or (index, variable.subindex) in set(mapped)
    )


def _mapped(values: Mapping[Place, Value]) -> set[Place]:
    """Return the objects in RPDO mappings."""
    entries = (value for (index, sub), value in values.items() if index in RPDO_MAPS and sub and isinstance(value, int))
    return {(entry >> 16, entry >> 8 & 0xFF) for entry in entries}


@dataclass(frozen=True)
class Dump:
    """Configuration of a device.

    Attributes
    ----------
    aborted : objects that cannot be read, with the abort's text, or whose value does not fit into a file
    left_out : objects that act when written
    """

    values: Mapping[Place, Value]
    aborted: tuple[str, ...]
    left_out: tuple[Place, ...]


def dump(device: KnownDevice, show: Show = lambda done, total: None) -> Dump:
    """Read the configuration of a device.

    Raises
    ------
    SdoSilent
        (exit status 5) the device does not answer, or no longer answers
    AnswerUntrusted
        (6, or 3 for two devices) an answer is not valid: earlier values may be another device's
    """
    variables = [
        variable
        for variable in device.variables()
        if variable.access in (*WRITABLE, "rww") and variable.subindex <= 0xFE
    ]
    values: dict[Place, Value] = {}
    aborted = []
    for number, variable in enumerate(variables):
        show(number, len(variables))
        kind = DATA_TYPES.get(variable.data_type)
        if kind is None or kind.kind in ("domain", "record", "time"):
            continue
        try:
            data = device.upload(variable, most=MOST_BYTES)
        except SdoAborted as error:
            aborted.append(str(error))
            continue
        value = decode(variable, data)
        if isinstance(value, bytes) and kind.kind != "bytes":
            aborted.append(f"{where(variable.index, variable.subindex)}: {len(data)} bytes are no {kind.name}")
        elif isinstance(value, str) and not _fits_a_line(value):
            aborted.append(f"{where(variable.index, variable.subindex)}: its text does not fit into a file of lines")
        elif isinstance(value, int | float) and not variable.admits(value):
            limits = f"{'no limit' if variable.low is None else variable.low} to {variable.largest}"
            aborted.append(
                f"{where(variable.index, variable.subindex)}: it holds {value}; the EDS file admits {limits}"
            )
        else:
            values[variable.index, variable.subindex] = value
    mapped = _mapped(values)
    left_out = tuple(p for p in values if acts(device.at(*p), mapped))
    return Dump({p: v for p, v in values.items() if p not in left_out}, tuple(aborted), left_out)


def _fits_a_line(text: str) -> bool:
    return bool(text) and text.isprintable() and text == text.strip() and not (text[0] == text[-1] == '"')


def check_file(device: KnownDevice, description: Description) -> dict[Place, Value]:
    """Return the values of a DCF for this device.

    Raises
    ------
    DeviceMismatch
        (exit status 3) the file is for another device, has no values, or has an unreadable value
    """
    expected, identity = identity_from_1018h(description), identity_of(device.client)
    if any(expected) and expected != identity[:2]:
        label = f"{expected[0]:#010x} {expected[1]:#010x}"
        raise DeviceMismatch(
            f"{description.path} is of the device 1018h {label}; node {device.node_id} has {identity[0]:#010x} {identity[1]:#010x}"
        )
    bad = [diagnosis for diagnosis in description.diagnoses if diagnosis.assumed == "the default"]
    if bad:
        raise DeviceMismatch(f"{bad[0]}; correct the file first ({len(bad)} such values)")
    node_id = device.node_id
    values = {place: description.default(*place, node_id) for place in configured(description)}
    if not values:
        raise DeviceMismatch(f"{description.path} gives no values (ParameterValue): it is not a DCF")
    mapped = _mapped(values)
    return {
        place: value
        for place, value in values.items()
        if value is not None
        and description.variable(*place).access in WRITABLE
        and not acts(description.variable(*place), mapped)
    }


@dataclass(frozen=True)
class ObjectDifference:
    """An object whose value in the device differs from the file; `held` None: it cannot be read."""

    variable: Variable
    held: Value
    wanted: Value

    @property
    def place(self) -> Place:
        """Index and sub-index."""
        return self.variable.index, self.variable.subindex

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; bytes in hexadecimal."""
        held, file_value = (value.hex() if isinstance(value, bytes) else value for value in (self.held, self.wanted))
        return {
            "index": self.variable.index,
            "subindex": self.variable.subindex,
            "name": self.variable.name,
            "device": held,
            "file": file_value,
        }


def differences(
    device: KnownDevice, description: Description, values: Mapping[Place, Value], show: Show = lambda done, total: None
) -> list[ObjectDifference]:
    """Return the differences of the device from `values`.

    Raises
    ------
    SdoSilent
        (exit status 5) the device does not answer
    """
    rows = []
    for number, (place, value) in enumerate(values.items()):
        show(number, len(values))
        variable = description.variable(*place)
        held: Value
        try:
            data = device.upload(variable, most=MOST_BYTES)
            held = decode(variable, data)
            same = _same(variable, data, value)
        except SdoAborted:
            held, same = None, False
        if not same:
            rows.append(ObjectDifference(variable, held, value))
    return rows


@dataclass
class Restored:
    """Result of a restore.

    Attributes
    ----------
    written : objects that now have the file's value
    failed : error of each object that does not
    """

    written: list[Place] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)


def restore(
    device: KnownDevice,
    values: Mapping[Place, Value],
    changes: Sequence[ObjectDifference],
    show: Show = lambda done, total: None,
    result: Restored | None = None,
) -> Restored:
    """Write the differences, and read them back.

    A PDO is made invalid before its mapping is changed, and valid at its end (CiA 301, section 7.5.2.36).

    Parameters
    ----------
    values : all values of the file: for a PDO with a different mapping, all entries are written
    result : filled during the restore, for callers that are interrupted

    Raises
    ------
    SdoSilent
        (exit status 5) the device no longer answers
    """
    result = result or Restored()
    of_pdos: dict[int, list[ObjectDifference]] = {}
    plain = []
    for row in changes:
        pdo = _pdo_of(row.variable.index)
        if pdo is None:
            plain.append(row)
        else:
            of_pdos.setdefault(pdo, []).append(row)
    done = 0
    for row in plain:
        show(done, len(changes))
        _write(device, row.variable, row.wanted, result)
        done += 1
    for pdo, rows in of_pdos.items():
        show(done, len(changes))
        _write_pdo(device, pdo, values, {row.place for row in rows}, result)
        done += len(rows)
    return result


def _pdo_of(index: int) -> int | None:
    """Return the communication parameter (14xxh, 18xxh) of a PDO's object; None for other objects."""
    for first in (0x1400, 0x1800):
        if first <= index < first + 0x400:
            return first + (index & 0x1FF)
    return None


def _same(variable: Variable, data: bytes, value: Value) -> bool:
    """Return whether `data` encodes `value`; a text may have trailing zeros."""
    return data == encode(variable, value) or decode(variable, data) == value


def _write(device: KnownDevice, variable: Variable, value: Value, result: Restored) -> bool:
    place = variable.index, variable.subindex
    data = encode(variable, value)
    try:
        device.client.download(*place, data)
        back = device.upload(variable, most=MOST_BYTES)
        if not _same(variable, back, value):
            result.failed.append(f"{where(*place)} {variable.name}: written, and reads back as {back.hex(' ')}")
            return False
    except SdoAborted as error:
        result.failed.append(f"{variable.name}: {error}")
        return False
    result.written.append(place)
    return True


def _write_pdo(
    device: KnownDevice, pdo: int, values: Mapping[Place, Value], differing: set[Place], result: Restored
) -> None:
    """Write the parameters of one PDO in the order that devices require."""
    steps = Restored()
    cob, mapping = device.at(pdo, 1), pdo + 0x200

    def write(place: Place, value: Value) -> bool:
        """Write one object; objects without a difference are part of the mapping, and are not counted."""
        step = Restored()
        well = _write(device, device.at(*place), value, step)
        steps.failed += step.failed
        steps.written += [place for place in step.written if place in differing]
        return well

    try:
        held = int.from_bytes(device.client.upload(pdo, 1, most=4), "little")
    except SdoAborted as error:
        result.failed.append(f"PDO {pdo:04X}h: {error}")
        return
    cob_id = values.get((pdo, 1), held)
    data = encode(cob, held | INVALID)
    try:
        if not held & INVALID:
            device.client.download(pdo, 1, data)
    except SdoAborted as error:
        result.failed.append(f"PDO {pdo:04X}h cannot be made invalid: {error}")
        return
    whole = True
    if any(index == mapping for index, _ in differing):
        count = values.get((mapping, 0))
        if not isinstance(count, int):
            count = int.from_bytes(device.client.upload(mapping, 0, most=1), "little")
        whole = write((mapping, 0), 0)
        steps.written.clear()
        for sub in range(1, count + 1):
            entry = values.get((mapping, sub))
            if whole and entry is not None:
                whole = write((mapping, sub), entry)
        for index, sub in sorted(differing):  # entries beyond the count are stored, and have no effect
            if whole and index == mapping and sub > count:
                whole = write((index, sub), values[index, sub])
        whole = whole and write((mapping, 0), count)
    for index, sub in sorted(differing):
        if index == pdo and sub > 1:
            write((index, sub), values[index, sub])
    if whole:
        if not write((pdo, 1), cob_id):
            steps.failed.append(f"PDO {pdo:04X}h stays invalid")
    else:
        steps.failed.append(f"PDO {pdo:04X}h stays invalid: its mapping was refused")
    result.written += steps.written
    result.failed += steps.failed
