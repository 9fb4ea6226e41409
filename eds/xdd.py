"""XDD and XDC files (CiA 311, a profile container of ISO 15745) as the sections of an EDS or DCF.

An XDD has the same objects and attributes as an EDS, in XML. So its elements become the sections
from which the EDS reader builds its objects, each with its line:

    <CANopenObject index="1018" ...>         [1018]
    <CANopenSubObject subIndex="0A" ...>     [1018subA]
    defaultValue, actualValue                DefaultValue, ParameterValue

An object may refer to a parameter of the application process by `uniqueIDRef`: the parameter then
has its access, its IEC 61131-3 type, its default and its range.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from coulombus.eds.description import EdsError
from coulombus.eds.sections import EdsSection, SectionReader, cut, number_of

if TYPE_CHECKING:
    from coulombus.eds.xml_elements import XmlElement

__all__ = ["XddReader", "is_xml"]

CONTAINER = "ISO15745ProfileContainer"
OTHER_ROOTS: Mapping[str, tuple[str, str]] = {
    "ethercatinfo": (
        "an EtherCAT slave information file (ESI)",
        "its objects are those of the EtherCAT device: ask the maker for the EDS or XDD of the CANopen device",
    ),
    "html": ("a web page", "it was saved instead of the file: download the file itself"),
    "iso15745profile": ("a profile of ISO 15745 without a container", "a GSDML file, as it seems: take the EDS or XDD"),
    "device": ("an editor's project", "export an EDS or XDD file with that editor"),
    "iodevice": ("an IO-Link description (IODD)", "expected an EDS, DCF, XDD or XDC file of the CANopen device"),
    "devicedescription": ("a device description of CODESYS", "expected the EDS or XDD file that it was made from"),
}
"""Other XML files that describe devices, by their root element in lower case: kind of file and remedy."""

KEYS: Mapping[str, str] = {
    "name": "ParameterName",
    "objectType": "ObjectType",
    "dataType": "DataType",
    "accessType": "AccessType",
    "defaultValue": "DefaultValue",
    "lowLimit": "LowLimit",
    "highLimit": "HighLimit",
    "PDOmapping": "PDOMapping",
    "actualValue": "ParameterValue",
    "denotation": "Denotation",
    "subNumber": "SubNumber",
    "objFlags": "ObjFlags",
    "uniqueIDRef": "UniqueIDRef",
}
"""Attributes of CANopenObject and CANopenSubObject, and the equivalent keys of CiA 306."""
VALUES = ("DefaultValue", "ParameterValue")
IN_HEXADECIMAL = ("dataType", "objFlags")
MAPPINGS = {"no": "0", "default": "1", "optional": "1", "tpdo": "1", "rpdo": "1"}
ONE_WAY = {"tpdo": "rwr", "rpdo": "rww"}
"""CiA 306's access types of objects that are read and written, but mapped in one direction only."""
ACCESS = {
    "read": "ro",
    "write": "wo",
    "readwrite": "rw",
    "readwriteinput": "rwr",
    "readwriteoutput": "rww",
    "const": "const",
}
"""Access types of a parameter."""
DEFAULT_ACCESS = "read"
"""Of a parameter without `access`, by the schema of CiA 311."""
IEC_TYPES: Mapping[str, int] = {
    "BOOL": 0x01,
    "SINT": 0x02,
    "INT": 0x03,
    "DINT": 0x04,
    "LINT": 0x15,
    "USINT": 0x05,
    "UINT": 0x06,
    "UDINT": 0x07,
    "ULINT": 0x1B,
    "BYTE": 0x05,
    "WORD": 0x06,
    "DWORD": 0x07,
    "LWORD": 0x1B,
    "REAL": 0x08,
    "LREAL": 0x11,
    "STRING": 0x09,
    "WSTRING": 0x0B,
    "BITSTRING": 0x0A,
}
IDENTITY = {
    "vendorName": "VendorName",
    "vendorID": "VendorNumber",
    "productName": "ProductName",
    "productID": "ProductNumber",
    "orderNumber": "OrderCode",
}
FEATURES = {
    "granularity": "Granularity",
    "nrOfRxPDO": "NrOfRXPDO",
    "nrOfTxPDO": "NrOfTXPDO",
    "layerSettingServiceSlave": "LSS_Supported",
    "bootUpSlave": "SimpleBootUpSlave",
    "groupMessaging": "GroupMessaging",
    "dynamicChannels": "DynamicChannelsSupported",
}
FILE = {
    "fileName": "FileName",
    "fileVersion": "FileVersion",
    "fileCreator": "CreatedBy",
    "fileCreationDate": "CreationDate",
    "fileCreationTime": "CreationTime",
    "fileModifiedBy": "ModifiedBy",
    "fileModificationDate": "ModificationDate",
    "fileModificationTime": "ModificationTime",
}
"""Attributes of a ProfileBody, and the keys of [FileInfo]."""
COMMISSIONING = {
    "nodeName": "NodeName",
    "networkNumber": "NetNumber",
    "networkName": "NetworkName",
    "CANopenManager": "CANopenManager",
}
"""Further attributes of deviceCommissioning, and the keys of [DeviceComissioning]."""
TRUTH = {"true": "1", "false": "0"}
MANDATORY, MANUFACTURER = (0x1000, 0x1001, 0x1018), range(0x2000, 0x6000)

MOST_CHARACTERS = 1 << 24
"""Largest size; an XDD has some 2,000 characters per object."""
MOST_DECLARED = 200
"""Largest length of the XML declaration in characters."""

_START = re.compile(r"\s*<[?!\w]")
_DECLARED = re.compile(r"\A(\s*<\?xml\b[^>]*?\bencoding\s*=\s*)([\"'])([\w.-]+)\2")
_CODE_PAGES = re.compile(r"(iso-?8859|windows|cp|latin|koi8|gb|big|euc|shift)[\w-]*", re.IGNORECASE)


def is_xml(raw: bytes | str) -> bool:
    """Tell whether a file is XML (or HTML) by its first characters: no EDS begins with ``<``."""
    head = raw[:400].decode("latin-1") if isinstance(raw, bytes) else raw[:400]
    return _START.match(head.lstrip("\xef\xbb\xbf\xfe\xff\ufeff").replace("\0", "")) is not None


class XddReader(SectionReader):
    """Reads the sections of an XDD or XDC; reports its assumptions as for an EDS."""

    kind = "an XDC"

    def decode(self, raw: bytes) -> str:
        """Return the text: UTF-16 by its byte order mark, UTF-8, or the encoding of the XML declaration;
        otherwise as for an EDS. The returned declaration says UTF-8, the encoding of recordings.
        """
        declared = _DECLARED.match(raw[:MOST_DECLARED].decode("latin-1"))
        page = declared[3] if declared and _CODE_PAGES.fullmatch(declared[3]) else "ascii"
        wide = raw[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        for name in ("utf-16",) if wide else ("utf-8-sig", page):
            try:
                text = raw.decode(name)
                break
            except (LookupError, UnicodeError):
                continue
        else:
            text = super().decode(raw)
        return _DECLARED.sub(r"\1\2UTF-8\2", text[:MOST_DECLARED], count=1) + text[MOST_DECLARED:]

    def split(self) -> None:
        """Make sections of the elements.

        Raises
        ------
        EdsError
            The text is not well-formed XML, no XDD, or describes no object.
        """
        # imported here: the import takes 0.1 s, and no EDS needs it
        from coulombus.eds.xml_elements import read_elements

        if len(self.text) > MOST_CHARACTERS:
            raise EdsError(f"{self.path}:1: has more than 16 MiB; expected the XDD or XDC file of one device")
        if re.match(r"\s*<(!doctype\s+)?html\b", self.text[:400], re.IGNORECASE):
            raise EdsError(f"{self.path}:1: is {OTHER_ROOTS['html'][0]}; {OTHER_ROOTS['html'][1]}")
        root = read_elements(self.path, self.text)
        self.require_container(root)
        for index, element in self.objects(root):
            self.enter_object(index, element)
        if not self.sections:
            what = "describes no object in a CANopenObjectList"
            raise EdsError(f"{self.path}:{root.line}: {what}; expected CANopenObject elements, is it an XDD file?")
        parameters = {
            element.attributes["uniqueID"]: element
            for kind in ("parameterTemplate", "parameter")
            for element in root.all(kind)
            if "uniqueID" in element.attributes
        }
        for section in list(self.sections.values()):
            self.enter_parameter(section, parameters)
        for section in self.sections.values():
            self.direct(section)
        self.enter_device(root)

    def require_container(self, root: XmlElement) -> None:
        """Raise EdsError for XML that is no XDD."""
        if root.name == CONTAINER and "powerlink" not in root.space.lower():
            return
        what, remedy = OTHER_ROOTS.get(
            root.name.lower(),
            (
                f"XML with the root element <{cut(root.name)}>, no device description of CiA 311",
                f"expected <{CONTAINER}>, or an EDS or DCF file: ask the device's maker for one",
            ),
        )
        if root.name == CONTAINER:
            what, remedy = "a device description of Ethernet POWERLINK", OTHER_ROOTS["iodevice"][1]
        raise EdsError(f"{self.path}:{root.line}: is {what}; {remedy}")

    def objects(self, root: XmlElement) -> Iterator[tuple[int, XmlElement]]:
        """Yield the elements of the device's own objects with their indices, without those of modules, which
        depend on the plugged-in hardware.
        """
        for layers in root.all("ApplicationLayers"):
            for listed in layers.children_named("CANopenObjectList"):
                for element in listed.children_named("CANopenObject"):
                    index = self.hexadecimal(element, "index", 4)
                    if index is not None:
                        yield index, element
        modules = [layers for layers in root.all("moduleManagement") if layers.first("CANopenObject")]
        if modules:
            text = "<moduleManagement> describes modules, whose objects depend on the device"
            self.say(modules[0].line, text, "none")

    def hexadecimal(self, element: XmlElement, name: str, digits: int) -> int | None:
        """Return an index or sub-index; None (reported) if it is invalid."""
        text = element.attributes.get(name, "").strip()
        if re.fullmatch(rf"(?:0[xX])?0*[0-9a-fA-F]{{1,{digits}}}", text):
            return int(text, 16)
        shown = f"{name}={cut(text)}" if text else f"no {name}"
        self.say(element.line, f"<{element.name}> has {shown}", "no such object", "error")
        return None

    def enter_object(self, index: int, element: XmlElement) -> None:
        """Add a section for an object, and one for each of its sub-objects."""
        self.enter(self.section(element, f"{index:04X}", index), element)
        for sub in element.children_named("CANopenSubObject"):
            subindex = self.hexadecimal(sub, "subIndex", 2)
            if subindex is not None:
                self.enter(self.section(sub, f"{index:04X}sub{subindex:X}", index, subindex), sub)

    def section(self, element: XmlElement, name: str, index: int, subindex: int = -1) -> EdsSection:
        """Return a new section, or the earlier section of the same object."""
        earlier = self.sections.get(name.lower())
        if earlier is not None:
            self.say(
                element.line, f"the object [{name}] is in line {earlier.line} already", "one object, the first values"
            )
            earlier.reopened = True
            return earlier
        return self.sections.setdefault(name.lower(), EdsSection(name, element.line, index=index, subindex=subindex))

    def enter(self, section: EdsSection, element: XmlElement) -> None:
        """Add an element's attributes; XDD notation is converted to EDS notation."""
        for spelled, text in element.attributes.items():
            key = KEYS.get(spelled)
            if key is not None:
                digits = spelled in IN_HEXADECIMAL and re.fullmatch(r"[0-9a-fA-F]{1,8}", text.strip())
                self.put(section, key, spelled, f"0x{text.strip()}" if digits else text, element.line)

    def put(self, section: EdsSection, key: str, spelled: str, text: str, line: int) -> None:
        """Add a key on one line: the first value counts, and a different one is reported."""
        text = " ".join(text.splitlines()).strip()
        if key.lower() in section.entries:
            self.enter_again(section, key.lower(), spelled, text, line)
        else:
            section.entries[key.lower()] = (text, line)
            section.spelled[key.lower()] = spelled

    def enter_parameter(self, section: EdsSection, parameters: Mapping[str, XmlElement]) -> None:
        """Add the attributes of the parameter to which an object refers, and then those of its template."""
        name, line = section.entries.pop("uniqueidref", ("", section.line))
        if not name:
            return
        parameter = parameters.get(name)
        if parameter is None:
            self.say(line, f"[{section.name}] uniqueIDRef={cut(name)} names no parameter", "no more than the object")
            return
        template = parameters.get(parameter.attributes.get("templateIDRef", ""))
        structured = section.subindex < 0 and f"{section.index:04x}sub0" in self.sections
        for source in (parameter, *((template,) if template is not None else ())):
            for key, spelled, text, at in _of_parameter(source):
                if structured and key not in ("ParameterName", "Description"):
                    continue  # an array's or record's value belongs to its sub-indices
                if not section.get(key.lower()):
                    section.entries.pop(key.lower(), None)
                    self.put(section, key, spelled, text, at)
                elif key == "AccessType" and section.get("accesstype").lower() == "rw" and text in ONE_WAY.values():
                    section.entries["accesstype"] = (text, at)  # the parameter tells more than accessType can
                elif key in VALUES and source is parameter:
                    self.enter_again(section, key.lower(), spelled, text, at)
        if not structured and not section.get("accesstype"):
            section.entries.pop("accesstype", None)
            self.put(section, "AccessType", "access", ACCESS[DEFAULT_ACCESS], parameter.line)

    def direct(self, section: EdsSection) -> None:
        """Translate PDOmapping; CiA 306 states the direction in the access type."""
        direction, line = section.entries.get("pdomapping", ("", section.line))
        if direction.lower() not in MAPPINGS:
            return
        section.entries["pdomapping"] = (MAPPINGS[direction.lower()], line)
        access, at = section.entries.get("accesstype", ("", line))
        if access.lower() == "rw" and direction.lower() in ONE_WAY:
            section.entries["accesstype"] = (ONE_WAY[direction.lower()], at)

    def enter_device(self, root: XmlElement) -> None:
        """Add the data of the file, of the device and of its commissioning."""
        profile = root.first("ProfileBody")
        file = self.other("FileInfo", profile or root)
        for spelled, key in FILE.items():
            if profile is not None and spelled in profile.attributes:
                self.put(file, key, key, _moment(profile.attributes[spelled].strip()), profile.line)
        identity, features = root.first("DeviceIdentity"), root.first("CANopenGeneralFeatures")
        device = self.other("DeviceInfo", identity or features or root)
        for spelled, key in IDENTITY.items():
            element = identity.first(spelled) if identity is not None else None
            if element is not None and (not key.endswith("Number") or number_of(element.text.strip())):
                self.put(device, key, key, element.text, element.line)
        for spelled, key in FEATURES.items():
            if features is not None and spelled in features.attributes:
                text = features.attributes[spelled].strip()
                self.put(device, key, key, TRUTH.get(text.lower(), text), features.line)
        master = root.first("CANopenMasterFeatures")
        if master is not None and "bootUpMaster" in master.attributes:
            text = master.attributes["bootUpMaster"].strip()
            self.put(device, "SimpleBootUpMaster", "SimpleBootUpMaster", TRUTH.get(text.lower(), text), master.line)
        self.enter_comments(identity)
        rates = root.first("baudRate")
        for rate in rates.children_named("supportedBaudRate") if rates is not None else ():
            if number := re.match(r"\s*(\d{1,4})\b", rate.attributes.get("value", "")):
                self.put(device, f"BaudRate_{number[1]}", f"BaudRate_{number[1]}", "1", rate.line)
        for dummy in root.all("dummy"):
            if entry := re.fullmatch(r"\s*(Dummy[0-9a-fA-F]{4})\s*=\s*(\w+)\s*", dummy.attributes.get("entry", "")):
                self.put(self.other("DummyUsage", dummy), entry[1], entry[1], entry[2], dummy.line)
        channels = list(root.all("dynamicChannel"))
        if channels:
            section = self.other("DynamicChannels", channels[0])
            self.put(section, "NrOfSeg", "NrOfSeg", str(len(channels)), section.line)
        self.enter_commissioning(root)

    def enter_comments(self, identity: XmlElement | None) -> None:
        """Add the product's description as [Comments], line by line."""
        product = identity.first("productText") if identity is not None else None
        text = product.first("description") if product is not None else None
        rows = text.text.strip().splitlines() if text is not None else []
        if text is not None and rows:
            section = self.other("Comments", text)
            self.put(section, "Lines", "Lines", str(len(rows)), text.line)
            for number, row in enumerate(rows, 1):
                self.put(section, f"Line{number}", f"Line{number}", row, text.line)

    def enter_commissioning(self, root: XmlElement) -> None:
        """Add node id and bit rate of an XDC; node id 0 means none."""
        element = root.first("deviceCommissioning")
        if element is None:
            return
        section = self.other("DeviceComissioning", element)
        if element.attributes.get("nodeID", "0").strip() not in ("", "0", "0x00", "0x0"):
            self.put(section, "NodeID", "nodeID", element.attributes["nodeID"], element.line)
        if rate := re.match(r"\s*(\d{1,4})\b", element.attributes.get("actualBaudRate", "")):
            self.put(section, "Baudrate", "actualBaudRate", rate[1], element.line)
        for spelled, key in COMMISSIONING.items():
            if spelled in element.attributes:
                text = element.attributes[spelled].strip()
                self.put(section, key, key, TRUTH.get(text.lower(), text), element.line)

    def other(self, name: str, element: XmlElement) -> EdsSection:
        """Return a section that belongs to no object."""
        return self.sections.setdefault(name.lower(), EdsSection(name, element.line))

    def check_lists(self, objects: object, heads: object) -> None:
        """Do nothing: an XDD has no lists of objects; the elements themselves are the list."""


def _moment(text: str) -> str:
    """Return a date as MM-DD-YYYY and a time as hh:mmAM (CiA 306); other texts unchanged."""
    if date := re.fullmatch(r"(\d{4})-(\d\d)-(\d\d)\S*", text):
        return f"{date[2]}-{date[3]}-{date[1]}"
    if time := re.fullmatch(r"(\d\d):(\d\d)(?::\d\d)?(?:[.Z+-]\S*)?", text):
        hour = int(time[1])
        return f"{(hour - 1) % 12 + 1:02}:{time[2]}{'AM' if hour < 12 else 'PM'}"
    return text


def _of_parameter(parameter: XmlElement) -> Iterator[tuple[str, str, str, int]]:
    """Yield key, its XML name, value and line of each attribute of a parameter."""
    labels = sorted(
        parameter.children_named("label"), key=lambda label: not label.attributes.get("lang", "").startswith("en")
    )
    for label in labels[:1]:
        yield "ParameterName", "label", " ".join(label.text.split()), label.line
    for description in parameter.children_named("description")[:1]:
        yield "Description", "description", " ".join(description.text.split()), description.line
    for unit in parameter.children_named("unit")[:1]:
        symbol = unit.first("label")
        yield "Unit", "unit", "" if symbol is None else " ".join(symbol.text.split()), unit.line
        yield "Factor", "multiplier", unit.attributes.get("multiplier", "").strip(), unit.line
    access = parameter.attributes.get("access", "").strip()
    if access:
        yield "AccessType", "access", ACCESS.get(access.lower(), access), parameter.line
    for child in parameter.children:
        if child.name in IEC_TYPES:
            yield "DataType", child.name, f"0x{IEC_TYPES[child.name]:04X}", child.line
        text = child.attributes.get("value", "").strip()
        if child.name in ("defaultValue", "actualValue") and text:
            yield KEYS[child.name], child.name, text, child.line
    for element, key in (("minValue", "LowLimit"), ("maxValue", "HighLimit")):
        ends = list(parameter.all(element))
        if len(ends) == 1:  # several ranges give no limits
            yield key, element, ends[0].attributes.get("value", ""), ends[0].line
