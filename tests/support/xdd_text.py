"""XDD and XDC files (CiA 311), made of what a description says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.sax.saxutils import escape, quoteattr

from coulombus.eds.cia301 import ARRAY, RECORD
from coulombus.eds.description import Description, Object, Value, Variable

SPACE = "http://www.canopen.org/xml/1.1"
CONTAINER = (
    '<?xml version="1.0" encoding="{encoding}"?>\n'
    '<ISO15745ProfileContainer xmlns="{space}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xmlns:v="urn:maker">\n'
    '<ISO15745Profile><ProfileHeader/><ProfileBody xsi:type="ProfileBody_Device_CANopen" fileName="nobody.xdd" fileVersion="1">\n'
    "{device}\n</ProfileBody></ISO15745Profile>\n"
    '<ISO15745Profile><ProfileHeader/><ProfileBody xsi:type="ProfileBody_CommunicationNetwork_CANopen">\n'
    "<ApplicationLayers><CANopenObjectList>\n{objects}\n</CANopenObjectList>{dummies}</ApplicationLayers>\n"
    "{management}\n</ProfileBody></ISO15745Profile></ISO15745ProfileContainer>\n"
)
DEVICE = "<DeviceIdentity><vendorName>Nobody</vendorName><vendorID>0x4C0</vendorID></DeviceIdentity>"
ACCESS = {
    "ro": "read",
    "wo": "write",
    "rw": "readWrite",
    "rwr": "readWriteInput",
    "rww": "readWriteOutput",
    "const": "const",
}
ONE_WAY = {"rwr": ("rw", "TPDO"), "rww": ("rw", "RPDO")}
TYPES = {
    1: "BOOL",
    2: "SINT",
    3: "INT",
    4: "DINT",
    5: "USINT",
    6: "UINT",
    7: "UDINT",
    8: "REAL",
    9: "STRING",
    0x15: "LINT",
    0x1B: "ULINT",
}


def container(objects="", device=DEVICE, parameters="", management="", dummies="", encoding="UTF-8", space=SPACE):
    """A whole file around the elements that are given."""
    process = (
        f"<ApplicationProcess><parameterList>{parameters}</parameterList></ApplicationProcess>" if parameters else ""
    )
    return CONTAINER.format(
        objects=objects, device=device + process, management=management, dummies=dummies, encoding=encoding, space=space
    )


def number(value: Value, relative: bool = False) -> str:
    """A value as both kinds of file spell it."""
    if relative:
        return f"$NODEID+0x{value:X}"
    return value.hex(" ") if isinstance(value, bytes) else repr(value) if isinstance(value, float) else str(value)


def attributes(pairs: Mapping[str, object]) -> str:
    return "".join(f" {name}={quoteattr(str(value))}" for name, value in pairs.items() if value is not None)


def _of(variable: Variable, referred: bool) -> tuple[dict[str, object], str]:
    """The attributes of a variable, and the parameter to which it leaves what it can leave."""
    access, mapping = variable.access, "optional" if variable.pdo_mappable else "no"
    default = None if variable.default is None else number(variable.default, variable.node_relative)
    limits = [None if limit is None else number(limit) for limit in (variable.low, variable.high)]
    pairs: dict[str, object] = {"name": variable.name, "objectType": 7, "PDOmapping": mapping}
    if not referred:
        if variable.pdo_mappable and access in ONE_WAY:
            access, pairs["PDOmapping"] = ONE_WAY[access]
        pairs |= {"dataType": f"{variable.data_type:04X}", "accessType": access, "defaultValue": default}
        return pairs | {"lowLimit": limits[0], "highLimit": limits[1]}, ""
    name = f"P_{variable.index:04X}{variable.subindex:02X}"
    pairs["uniqueIDRef"] = name
    if variable.data_type not in TYPES:
        pairs["dataType"] = f"{variable.data_type:04X}"
    ends = "".join(
        f'<{end} value="{limit}"/>' for end, limit in zip(("minValue", "maxValue"), limits, strict=True) if limit
    )
    inside = f"<{TYPES[variable.data_type]}/>" if variable.data_type in TYPES else ""
    inside += f"<defaultValue{attributes({'value': default})}/>" if default else ""
    inside += f"<allowedValues><range>{ends}</range></allowedValues>" if ends else ""
    label = f"<label lang='de'>X</label><label lang='en'>{escape(variable.name)}</label>"
    return pairs, f'<parameter uniqueID="{name}" access="{ACCESS[variable.access]}">{label}{inside}</parameter>'


def elements(entries: Iterable[Object], referred=lambda variable: False) -> tuple[str, str]:
    """Objects as elements, and the parameters of those that are `referred`."""
    objects, parameters = [], []
    for entry in entries:
        head: dict[str, object] = {"index": f"{entry.index:04X}", "name": entry.name, "objectType": entry.object_type}
        rows = []
        for variable in entry.variables.values():
            pairs, parameter = _of(variable, referred(variable))
            parameters.append(parameter)
            rows.append({"subIndex": f"{variable.subindex:02X}"} | pairs)
        if entry.object_type in (ARRAY, RECORD):
            subs = "\n".join(f"<CANopenSubObject{attributes(row)}/>" for row in rows)
            objects.append(f"<CANopenObject{attributes(head | {'subNumber': len(rows)})}>\n{subs}\n</CANopenObject>")
        else:
            objects.append(f"<CANopenObject{attributes(rows[0] | {'subIndex': None} | head)}/>")
    return "\n".join(objects), "\n".join(filter(None, parameters))


def as_xdd(description: Description, referred=lambda variable: False) -> str:
    """A description as an XDD file."""
    objects, parameters = elements(description.objects.values(), referred)
    said = {key.lower(): text for key, text in description.info.items()}
    counts = {"granularity": said["granularity"], "nrOfRxPDO": said["nrofrxpdo"], "nrOfTxPDO": said["nroftxpdo"]}
    features = f"<NetworkManagement><CANopenGeneralFeatures{attributes(counts)}/></NetworkManagement>"
    dummies = "".join(f'<dummy entry="Dummy{code:04X}=1"/>' for code in sorted(description.dummies))
    return container(objects, parameters=parameters, management=features, dummies=f"<dummyUsage>{dummies}</dummyUsage>")
