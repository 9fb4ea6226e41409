"""The object dictionary of a device without an EDS file, by its own answers to SDO.

An object exists if a read is not aborted with "object does not exist" (0602 0000h). Types come from
the sizes; names, and types of the same size, from CiA 301 and the profile, as far as the EDS files
of this project's devices have them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import MappingProxyType

from coulombus.eds.cia301 import ARRAY, DATA_TYPES, DOMAIN, DUMMY_TYPES, RECORD, VAR, Abort, predefined
from coulombus.eds.data import decode
from coulombus.eds.description import Object, Variable
from coulombus.eds.drive_axis import first_axis_object
from coulombus.eds.eds_keys import FileContent, Row, spelled
from coulombus.eds.own_devices import packaged
from coulombus.eds.pdo import COMMUNICATION_RANGES, MAPPING_RANGES
from coulombus.host.devices.configuration import acts
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.host.sdo.transfers import DuplicateNodeId, SdoProtocolError, SdoRefused

__all__ = ["EVERYWHERE", "DictionaryScan", "pdo_objects", "read_object"]

EVERYWHERE = ((0x1000, 0x1FFF), (0x2000, 0x5FFF), (0x6000, 0x9FFF))
ABSENT = (Abort.NO_OBJECT, Abort.NO_SUBINDEX)
UNKNOWN = (Abort.GENERAL, Abort.NO_DICTIONARY)
"""Answers of some devices for objects that they do not have."""
STATE = (0x1001, 0x1002, 0x1003)
"""Objects of the communication area whose values are no settings."""
PROFILES = MappingProxyType({402: 0, 404: 1})
"""Place of the profile's device among `packaged`."""
UNSIGNED = {1: 0x05, 2: 0x06, 3: 0x16, 4: 0x07, 5: 0x18, 6: 0x19, 7: 0x1A, 8: 0x1B}
TEXT, OCTETS, DOMAIN_TYPE = 0x09, 0x0A, 0x0F
IDENTIFIER = 0x1FFFFFFF
"""Mask of the identifier in a COB-ID."""
MOST_BYTES = 4096
MOST_MAPPED = 64
GAP = 4
"""PDOs of a direction that are missing in a row where no more are looked for."""


def pdo_objects(client: SdoClient) -> dict[tuple[int, int], int]:
    """Read what determines a node's PDOs now: device type, identity, communication and mapping parameters.

    A direction ends with `GAP` missing PDOs in a row. Raises as `DictionaryScan.content`.
    """
    values: dict[tuple[int, int], int] = {}

    def read(index: int, sub: int) -> int | None:
        answer = read_object(client, index, sub)
        if isinstance(answer, bytes):
            values[index, sub] = int.from_bytes(answer, "little")
        return values.get((index, sub))

    for place in ((0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3)):
        read(*place)
    for communication in (0x1400, 0x1800):
        missing = 0
        for index in range(communication, communication + 0x200):
            missing = 0 if read(index, 1) is not None else missing + 1
            if missing == GAP:
                break
            for sub in (2, 3, 5) if not missing else ():
                read(index, sub)
            for sub in range(1, min(read(index + 0x200, 0) or 0, MOST_MAPPED) + 1) if not missing else ():
                read(index + 0x200, sub)
    return values


def read_object(client: SdoClient, index: int, subindex: int) -> bytes | int | None:
    """Return an object's bytes; None if it does not exist, else the code of the abort."""
    try:
        return client.upload(index, subindex, most=MOST_BYTES)
    except SdoRefused as refused:
        return None if refused.code in (*ABSENT, *UNKNOWN) else refused.code
    except DuplicateNodeId:
        raise
    except SdoProtocolError as error:
        if error.code != Abort.MEMORY:
            raise
        return int(Abort.MEMORY)  # longer than `MOST_BYTES`


def _is_map(index: int) -> bool:
    return any(index in part for part in MAPPING_RANGES)


@dataclass
class DictionaryScan:
    """Reads objects of a node (`content`).

    Parameters
    ----------
    ranges : first and last index of each stretch that is read
    show : called with an index now and then
    tries_access : write each readable object's own value back, but those that act; without it an
        object that no table has is read-only

    Attributes
    ----------
    remarks : objects that are left out, and why
    """

    client: SdoClient
    ranges: Iterable[tuple[int, int]] = EVERYWHERE
    show: Callable[[int], None] = lambda index: None
    tries_access: bool = False
    remarks: list[str] = field(default_factory=list)

    def content(self) -> FileContent:
        """Read the objects; return them as an EDS file has them.

        Raises
        ------
        SdoSilent
            (exit status 5) the node does not answer
        AnswerUntrusted
            (6, or 3) its answer is not valid, or two devices answer
        """
        files = packaged()
        device_type = self._read(0x1000, 0)
        profile = int.from_bytes(device_type[:2], "little") if isinstance(device_type, bytes) else 0
        self._common, self._profile = files[0], files[PROFILES[profile]] if profile in PROFILES else None
        self._mapped = set(self._mapped_places(MAPPING_RANGES))
        self._set_points = set(self._mapped_places(MAPPING_RANGES[:1]))
        content = FileContent([])
        for first, last in self.ranges:
            for index in range(first, last + 1):
                if index % 16 == 0:
                    self.show(index)
                content.rows += self._object(index)
        content.sections |= self._head(content.rows)
        return content

    def _mapped_places(self, maps: Iterable[range]) -> Iterator[tuple[int, int]]:
        for index in (index for part in maps for index in part[:MOST_MAPPED]):
            count = self._read(index, 0)
            if isinstance(count, bytes):
                for sub in range(1, min(int.from_bytes(count[:1], "little"), MOST_MAPPED) + 1):
                    entry = self._read(index, sub)
                    if isinstance(entry, bytes) and len(entry) == 4:
                        yield int.from_bytes(entry[2:], "little"), entry[1]

    def _read(self, index: int, subindex: int) -> bytes | int | None:
        return read_object(self.client, index, subindex)

    def _template(self, index: int) -> Object | None:
        """Return the object of CiA 301 or the profile from our own files."""
        if index < 0x2000:
            usual = next((part.start for part in (*COMMUNICATION_RANGES, *MAPPING_RANGES) if index in part), index)
            return self._common.objects.get(usual)
        if index < 0x6000 or self._profile is None:
            return None
        return self._profile.objects.get(index) or self._profile.objects.get(first_axis_object(index))

    def _object(self, index: int) -> Iterator[Row]:
        top = self._read(index, 0)
        template = self._template(index)
        if top is None and (template is None or self._read(index, 1) is None):
            return
        variables = {} if template is None else template.variables
        name = f"Object {index:04X}h" if template is None else template.name
        if template is not None and template.index != index < 0x2000:  # that of another PDO
            name = f"{name.rstrip('0123456789 ')} {(index & 0x1FF) + 1}"
        if not self._has_subs(index, top, template):
            keys = self._keys(index, 0, top, variables.get(0))
            if keys is not None:
                kind = DOMAIN if keys["DataType"] == f"0x{DOMAIN_TYPE:04X}" else VAR
                yield Row(index, -1, {"ParameterName": name, "ObjectType": f"0x{kind:X}", **keys})
            return
        rows = []
        for sub, answer in self._subs(index, top):
            described = variables.get(sub) or (variables.get(1) if sub and _is_map(index) else None)
            keys = self._keys(index, sub, answer, described)
            if keys is not None:
                usual = "Highest sub-index supported" if sub == 0 else f"{name} {sub}"
                parameter_name = described.name if described is not None and described.subindex == sub else usual
                rows.append(Row(index, sub, {"ParameterName": parameter_name, "ObjectType": f"0x{VAR:X}", **keys}))
        types = {row.keys["DataType"] for row in rows if row.subindex}
        kind = template.object_type if template is not None else ARRAY if len(types) == 1 else RECORD
        head = {"ParameterName": name, "ObjectType": f"0x{kind:X}", "SubNumber": f"0x{len(rows):X}"}
        yield from (Row(index, -1, head), *rows) if rows else ()

    def _has_subs(self, index: int, top: bytes | int | None, template: Object | None) -> bool:
        if template is not None and template.object_type in (ARRAY, RECORD):
            return True
        if top is None or self._read(index, 1) is not None:
            return True
        last = top[0] if isinstance(top, bytes) and len(top) == 1 else 0
        return 2 <= last <= 0xFE and self._read(index, last) is not None

    def _subs(self, index: int, top: bytes | int | None) -> Iterator[tuple[int, bytes | int]]:
        """Yield the sub-indices that answer; a PDO's map may have more than are mapped."""
        if top is not None:
            yield 0, top
        count = top[0] if isinstance(top, bytes) and len(top) == 1 else 0xFE if top is None else 1
        for sub in range(1, (MOST_MAPPED if _is_map(index) else max(count, 1)) + 1):
            answer = self._read(index, sub)
            if answer is not None:
                yield sub, answer
            elif sub > count or top is None:
                return

    def _keys(
        self, index: int, sub: int, answer: bytes | int | None, described: Variable | None
    ) -> dict[str, str] | None:
        """Return type, access and value; None (a remark) if nothing tells the type."""
        code = self._type(answer, described, is_count=sub == 0 and described is not None and described.subindex == 0)
        if code is None:
            what = "can only be written" if answer == Abort.WRITE_ONLY else "cannot be read"
            self.remarks.append(f"{index:04X}h:{sub:02X} {what}, so its type is unknown: left out")
            return None
        kind = DATA_TYPES[code]
        variable = Variable(index, sub, "", code, "ro", None, False, None, None, False, 0)
        access = "wo" if answer == Abort.WRITE_ONLY else "ro" if described is None else described.access
        if self.tries_access and isinstance(answer, bytes) and index >= 0x1000:
            access = self._tried(variable, answer, described, access)
        keys = {"DataType": f"0x{code:04X}", "AccessType": access}
        is_setting = index < 0x2000 and index not in STATE
        if isinstance(answer, bytes) and (is_setting or (sub == 0 and described is None and len(answer) == 1)):
            value = decode(variable, answer)
            node_id = self.client.node_id
            usual = (predefined(index, sub, node_id) or 0) & IDENTIFIER
            if isinstance(value, int) and usual > node_id == usual & 0x7F and value & IDENTIFIER == usual:
                keys["DefaultValue"] = spelled(variable, value - node_id, relative=True) or ""
            elif not isinstance(value, bytes):
                keys["DefaultValue"] = (spelled(variable, value) or "").splitlines()[0] if value != "" else ""
        mappable = (index, sub) in self._mapped or (described is not None and described.pdo_mappable)
        return keys | {"PDOMapping": str(int(mappable and kind.bits > 0))}

    @staticmethod
    def _type(answer: bytes | int | None, described: Variable | None, *, is_count: bool) -> int | None:
        usual = None if described is None else DATA_TYPES.get(described.data_type)
        if answer == Abort.MEMORY:
            return DOMAIN_TYPE
        if not isinstance(answer, bytes):
            return None if usual is None else usual.code
        fits = usual is not None and (usual.bits == 0 or (usual.bits + 7) // 8 == len(answer))
        if usual is not None and (fits or is_count):
            return usual.code
        if len(answer) in UNSIGNED:
            return UNSIGNED[len(answer)]
        return TEXT if all(32 <= byte < 127 for byte in answer.rstrip(b"\0")) else OCTETS

    def _tried(self, variable: Variable, data: bytes, described: Variable | None, access: str) -> str:
        """Write an object's own value back, unless that acts; return its access."""
        if described is not None and described.access in ("rwr", "rww"):
            return access
        if acts(variable, self._set_points):
            return access
        try:
            self.client.download(variable.index, variable.subindex, data)
        except SdoRefused as refused:
            if refused.code in (Abort.READ_ONLY, Abort.ACCESS):
                return access if access == "const" else "ro"
        return "rw"

    def _head(self, rows: list[Row]) -> dict[str, dict[str, str]]:
        """Return the sections besides the objects."""
        numbers = {
            row.subindex: row.keys.get("DefaultValue", "0") for row in rows if row.index == 0x1018 and row.subindex > 0
        }
        names = {row.index: row.keys.get("DefaultValue", "") for row in rows if row.subindex < 0}
        heads = [row.index for row in rows if row.subindex < 0]
        device = {
            "VendorName": "",
            "VendorNumber": numbers.get(1, "0"),
            "ProductName": names.get(0x1008, ""),
            "ProductNumber": numbers.get(2, "0"),
            "RevisionNumber": numbers.get(3, "0"),
            "Granularity": "8",
            "SimpleBootUpSlave": "1",
            "NrOfRXPDO": str(sum(0x1400 <= index < 0x1600 for index in heads)),
            "NrOfTXPDO": str(sum(0x1800 <= index < 0x1A00 for index in heads)),
        }
        used = {index for index, _ in self._mapped}
        tried = "Access was tried" if self.tries_access else "Access was not tried: where no table has it, it is ro"
        lines = (
            f"Made of the answers of node {self.client.node_id}, which has no file of its maker here.",
            "Types are those of the sizes where no table has them: a signed number looks unsigned.",
            f"{tried}. Values of 1000h to 1FFFh are those that the device had.",
        )
        return {
            "FileInfo": {"FileVersion": "1", "FileRevision": "0", "EDSVersion": "4.0", "CreatedBy": "coulombus"},
            "DeviceInfo": device,
            "DummyUsage": {f"Dummy{code:04X}": str(int(code in used)) for code in DUMMY_TYPES},
            "Comments": {"Lines": str(len(lines)), **{f"Line{k}": text for k, text in enumerate(lines, 1)}},
        }
