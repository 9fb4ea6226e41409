"""Text of an XDD or XDC (CiA 311) of the keys of an EDS or DCF; `eds.xdd` reads it back."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from coulombus.eds.eds_keys import FileContent, Keys, Row
from coulombus.eds.sections import number_of
from coulombus.eds.xdd import ACCESS as XDD_ACCESS
from coulombus.eds.xdd import COMMISSIONING, FEATURES, FILE, IDENTITY, IEC_TYPES, KEYS, MANDATORY, MANUFACTURER
from coulombus.system.quoting import xml

__all__ = ["xdd_text_of"]

SPACE = "http://www.canopen.org/xml/1.1"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
TRUTH = {"SimpleBootUpSlave", "GroupMessaging", "LSS_Supported", "SimpleBootUpMaster", "CANopenManager"}
"""Keys that are true or false in an XDD."""
REQUIRED = {
    "fileName": "device.xdd",
    "fileCreator": "unknown",
    "fileCreationDate": "1970-01-01",
    "fileVersion": "1",
}
"""Attributes that a ProfileBody must have, and their values where the file has none."""
HEAD = (
    ("ProfileIdentification", "CANopen device profile"),
    ("ProfileRevision", "1.1"),
    ("ProfileName", ""),
    ("ProfileSource", ""),
)
ATTRIBUTES = {key: name for name, key in KEYS.items()}
PARAMETER_KEYS = {"Description", "Unit", "Factor"}
ACCESS = {word: name for name, word in XDD_ACCESS.items()}
IEC_NAMES = {code: name for name, code in reversed(list(IEC_TYPES.items()))}
KNOWN = ("FileInfo", "DeviceInfo", "DummyUsage", "Comments", "DeviceComissioning")
DIRECTIONS = {
    "rwr": ("rw", "TPDO"),
    "rww": ("rw", "RPDO"),
    "ro": ("ro", "TPDO"),
    "wo": ("wo", "RPDO"),
    "const": ("const", "TPDO"),
}


def xdd_text_of(content: FileContent) -> str:
    """Return the XML; what CiA 311 has no place for is counted in `content.left_out`."""
    lost, sections = content.left_out, content.sections
    root = Element("ISO15745ProfileContainer", {"xmlns": SPACE, "xmlns:xsi": XSI})
    root.set("xsi:schemaLocation", f"{SPACE} CANopen.xsd")
    device = _body(root, "Device", sections.get("FileInfo", {}), lost)
    _identity(SubElement(device, "DeviceIdentity"), sections, content.revision, lost)
    network = _body(root, "CommunicationNetwork", sections.get("FileInfo", {}), Counter())
    layers = SubElement(network, "ApplicationLayers")
    heads = [row.index for row in content.rows if row.subindex < 0]
    mandatory, manufacturer = (sum(index in part for index in heads) for part in (MANDATORY, MANUFACTURER))
    counts = {
        "mandatoryObjects": mandatory,
        "optionalObjects": len(heads) - mandatory - manufacturer,
        "manufacturerObjects": manufacturer,
    }
    listed, top = SubElement(layers, "CANopenObjectList", {key: str(count) for key, count in counts.items()}), None
    _parameters(device, content)
    lost.update(f"[{name}]" for name in sections if name not in KNOWN)
    for row in content.rows:
        if row.subindex < 0 or top is None:
            top = SubElement(listed, "CANopenObject", {"index": f"{row.index:04X}", **_attributes(row, lost)})
        else:
            SubElement(top, "CANopenSubObject", {"subIndex": f"{row.subindex:02X}", **_attributes(row, lost)})
    dummies = sections.get("DummyUsage", {})
    if dummies:
        usage = SubElement(layers, "dummyUsage")
        for key, text in dummies.items():
            SubElement(usage, "dummy", {"entry": xml(f"{key}={text}")})
    _management(network, sections)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _parameters(device: Element, content: FileContent) -> None:
    """Add a parameter for each row with a unit, a description or an access of one direction that is not
    mapped, and refer to it from the row.
    """
    rows = [row for row in content.rows if row.keys.keys() & PARAMETER_KEYS or _is_unmapped_one_way(row)]
    if not rows:
        return
    listed = SubElement(SubElement(device, "ApplicationProcess"), "parameterList")
    for row in rows:
        name = f"UID_PARAM_{row.name}"
        attributes = {"uniqueID": name, "access": ACCESS.get(row.keys.get("AccessType", ""), "noAccess")}
        parameter = SubElement(listed, "parameter", attributes)
        SubElement(parameter, "label", {"lang": "en"}).text = xml(row.keys["ParameterName"])
        code = number_of(row.keys.get("DataType", ""))
        kind = IEC_NAMES.get(0 if code is None else code.value, "BITSTRING")
        keys = {key: xml(row.keys.pop(key, "")) for key in ("Description", "Unit", "Factor")}
        if keys["Description"]:
            SubElement(parameter, "description", {"lang": "en"}).text = keys["Description"]
        if code is not None:
            SubElement(parameter, kind)
        if keys["Unit"] or keys["Factor"]:
            unit = SubElement(parameter, "unit", {"multiplier": keys["Factor"] or "1", "unitURI": ""})
            SubElement(unit, "label", {"lang": "en"}).text = keys["Unit"]
        row.keys["UniqueIDRef"] = name


def _is_unmapped_one_way(row: Row) -> bool:
    """Return whether only a parameter can tell the access type."""
    return row.keys.get("AccessType") in ("rwr", "rww") and row.keys.get("PDOMapping") != "1"


def _body(root: Element, kind: str, file: Mapping[str, str], lost: Counter[str]) -> Element:
    profile = SubElement(root, "ISO15745Profile")
    header = SubElement(profile, "ProfileHeader")
    for name, text in HEAD:
        SubElement(header, name).text = text
    SubElement(header, "ProfileClassID").text = kind
    reference = SubElement(header, "ISO15745Reference")
    for name, text in (("ISO15745Part", "1"), ("ISO15745Edition", "1"), ("ProfileTechnology", "CANopen")):
        SubElement(reference, name).text = text
    remaining = {key.lower(): text for key, text in file.items() if text}
    attributes = REQUIRED | {
        name: xml(_moment(remaining.pop(key.lower()))) for name, key in FILE.items() if key.lower() in remaining
    }
    for key in remaining:
        lost[f"[FileInfo] {next(spelled for spelled in file if spelled.lower() == key)}"] += 1
    return SubElement(profile, "ProfileBody", {"xsi:type": f"ProfileBody_{kind}_CANopen", **attributes})


def _moment(text: str) -> str:
    """Return a date or a time of CiA 306 as XML has it; other texts unchanged."""
    if date := re.fullmatch(r"(\d\d)-(\d\d)-(\d{4})", text):
        return f"{date[3]}-{date[1]}-{date[2]}"
    if time := re.fullmatch(r"(\d\d?):(\d\d) ?([AP])M", text, re.IGNORECASE):
        return f"{int(time[1]) % 12 + 12 * (time[3].upper() == 'P'):02}:{time[2]}:00"
    return text


def _identity(identity: Element, sections: Mapping[str, Keys], revision: str, lost: Counter[str]) -> None:
    entries = {key.lower(): text for key, text in sections.get("DeviceInfo", {}).items()}
    for name, key in IDENTITY.items():
        text = entries.pop(key.lower(), "")
        if text:
            SubElement(identity, name).text = xml(text)
        if name == "productID":
            _comments(identity, sections.get("Comments", {}))
    taken = {key.lower() for key in FEATURES.values()} | {"simplebootupmaster", "compactpdo"}
    for key in entries.keys() - taken:
        if key == "revisionnumber" and _number(entries[key]) == _number(revision):
            continue
        if entries[key] not in ("", "0") and not key.startswith("baudrate_"):
            spelled = next(spelled for spelled in sections["DeviceInfo"] if spelled.lower() == key)
            lost[f"[DeviceInfo] {spelled}"] += 1


def _comments(identity: Element, comments: Mapping[str, str]) -> None:
    rows = {int(key[4:]): text for key, text in comments.items() if re.fullmatch(r"(?i)line\d{1,9}", key)}
    if rows:
        product = SubElement(identity, "productText")
        SubElement(product, "description", {"lang": "en"}).text = xml("\n".join(rows[k] for k in sorted(rows)))


def _attributes(row: Row, lost: Counter[str]) -> dict[str, str]:
    """Return the attributes of an object or sub-object."""
    keys = dict(row.keys)
    kind = number_of(keys.get("ObjectType", ""))
    attributes = {"name": keys.pop("ParameterName"), "objectType": str(7 if kind is None else kind.value)}
    keys.pop("ObjectType", None)
    for key in ("DataType", "ObjFlags"):
        number = number_of(keys.pop(key, ""))
        if number is not None and number.value >= 0:
            attributes[ATTRIBUTES[key]] = f"{number.value:04X}"
    sub_number = number_of(keys.pop("SubNumber", ""))
    if sub_number is not None:
        attributes["subNumber"] = str(sub_number.value)
    if "AccessType" in keys:
        attributes |= _access(keys.pop("AccessType"), keys.pop("PDOMapping", "0") == "1")
    for key in list(keys):
        name = ATTRIBUTES.get(key)
        if name is None:
            lost[f"key {key}"] += 1
        else:
            attributes[name] = keys[key]
    return {name: xml(text) for name, text in attributes.items()}


def _access(access: str, mappable: bool) -> dict[str, str]:
    """Return access and mapping; CiA 311 states the direction in the mapping."""
    word, mapping = DIRECTIONS.get(access, (access, "optional"))
    return {"accessType": word, "PDOmapping": mapping if mappable else "no"}


def _management(network: Element, sections: Mapping[str, Keys]) -> None:
    device = {key.lower(): text for key, text in sections.get("DeviceInfo", {}).items()}
    rates = [key.partition("_")[2] for key, text in device.items() if key.startswith("baudrate_") and text == "1"]
    if rates:
        transport = SubElement(SubElement(network, "TransportLayers"), "PhysicalLayer")
        listed = SubElement(transport, "baudRate")
        for rate in rates:
            SubElement(listed, "supportedBaudRate", {"value": f"{rate} Kbps"})
    management = SubElement(network, "NetworkManagement")
    features = {name: _xml_value(key, device[key.lower()]) for name, key in FEATURES.items() if device.get(key.lower())}
    SubElement(management, "CANopenGeneralFeatures", features)
    if device.get("simplebootupmaster"):
        text = _xml_value("SimpleBootUpMaster", device["simplebootupmaster"])
        SubElement(management, "CANopenMasterFeatures", {"bootUpMaster": text})
    entries = {key.lower(): text for key, text in sections.get("DeviceComissioning", {}).items() if text}
    if entries:
        attributes = {
            name: _xml_value(key, entries[key.lower()]) for name, key in COMMISSIONING.items() if key.lower() in entries
        }
        attributes["nodeID"] = xml(_number(entries.get("nodeid", "0")))
        if "baudrate" in entries:
            attributes["actualBaudRate"] = xml(f"{_number(entries['baudrate'])} Kbps")
        SubElement(management, "deviceCommissioning", attributes)


def _number(text: str) -> str:
    number = number_of(text)
    return text if number is None else str(number.value)


def _xml_value(key: str, text: str) -> str:
    number = number_of(text)
    if key in TRUTH and number is not None:
        return "true" if number.value else "false"
    return xml(text)
