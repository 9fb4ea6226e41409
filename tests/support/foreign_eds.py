"""Our own two EDS files as another maker would have them, and parts to put into them."""

from __future__ import annotations

import re

from node_bench import EDS

MOTOR = (EDS / "motor.eds").read_text()
BRAKE = (EDS / "mr_brake.eds").read_text()

U8, U16, U32, U64 = "0x0005", "0x0006", "0x0007", "0x001B"
I8, I16, I32, REAL32 = "0x0002", "0x0003", "0x0004", "0x0008"


def another(text):
    """Make a file of ours another maker's."""
    return edited(text, "1018sub1", DefaultValue="0x99")


def edited(text, section, **keys):
    head, mark, rest = text.partition(f"[{section}]\n")
    assert mark, section
    body, _, tail = rest.partition("\n\n")
    lines = [line for line in body.splitlines() if line.partition("=")[0] not in keys]
    return head + mark + "\n".join((*lines, *(f"{key}={value}" for key, value in keys.items()))) + "\n\n" + tail


def without(text, *indices):
    parts = text.split("\n\n")
    return "\n\n".join(p for p in parts if not p.lstrip().startswith(tuple(f"[{i}" for i in indices)))


def with_variable(text, section, data_type, default="", access="rww"):
    keys = {"ParameterName": "X", "ObjectType": "0x7", "DataType": data_type, "AccessType": access}
    keys |= {"DefaultValue": default, "PDOMapping": 1}
    return text + f"\n\n[{section}]\n" + "".join(f"{key}={value}\n" for key, value in keys.items()) + "\n"


def with_array(text, index, data_type, count, access="rww"):
    text += f"\n\n[{index}]\nParameterName=X\nObjectType=0x8\nSubNumber={count + 1}\n\n[{index}sub0]\nParameterName=N\n"
    text += f"ObjectType=0x7\nDataType={U8}\nAccessType=const\nDefaultValue={count}\n"
    for k in range(1, count + 1):
        text = with_variable(text, f"{index}sub{k}", data_type, 0, access)
    return text


def with_record(text, index, *defaults):
    """Add a record of UNSIGNED32, as the factor group's are."""
    text = with_array(text, index, U32, len(defaults), "rw")
    for sub, default in enumerate(defaults, 1):
        text = edited(text, f"{index}sub{sub}", DefaultValue=default, PDOMapping=0)
    return text


def geared(text):
    """Give a drive of 8192 increments 3,600 units a turn of a shaft behind a gear of 10 to 1."""
    return with_record(with_record(text, "6091", 10, 1), "6092", 3600, 1)


def dual(text, pdos=0x40):
    """Give a drive a second axis: objects 800h higher, and PDOs `pdos` higher, without identifiers;
    0: none.
    """
    return text + "\n" + "\n\n".join(filter(None, (_second(part.strip("\n"), pdos) for part in text.split("\n\n"))))


def _second(section, pdos):
    head = re.match(r"\[(6[05]|1[468A])(..)(sub[0-9A-F]+)?\]", section)
    if head is None or (head[1].startswith("1") and not pdos):
        return ""
    step = 0x800 if head[1].startswith("6") else pdos
    body = section[head.end() :]
    if head[1] in ("16", "1A") and head[3] not in (None, "sub0"):
        word = re.compile(r"(?m)^DefaultValue=0x(6[0-7][0-9A-Fa-f]{6})$")
        body = word.sub(lambda found: f"DefaultValue=0x{int(found[1], 16) + 0x8000000:08X}", body)
    if head[1] in ("14", "18") and head[3] == "sub1":
        body = re.sub("(?m)^DefaultValue=.*$", "DefaultValue=0x80000000", body)
    return f"[{int(head[1] + head[2], 16) + step:04X}{head[3] or ''}]{body}\n"
