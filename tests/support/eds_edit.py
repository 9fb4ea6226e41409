"""Edits of an EDS file's text: keys, sections that go, maps that are read-only or another; and a
rig file's sensor.
"""

from __future__ import annotations

import re

SENSOR = """
[sensor.cell]
node_id = 3
eds = "cell.eds"
vendor_id = 0x4C0
product_code = 0x404
heartbeat_s = 0.05
heartbeat_timeout_s = 0.15

[role.handle_torque]
node = "cell"
"""
"""The handle torque on a device of its own, for the end of a rig file."""


def edit(text, section, **keys):
    """Set keys of a section of an EDS file."""
    head, mark, rest = text.partition(f"[{section}]\n")
    assert mark, section
    body, gap, tail = rest.partition("\n\n")
    for key, value in keys.items():
        line = f"{key}={value}"
        body = re.sub(f"(?m)^{key}=.*$", line, body) if re.search(f"(?m)^{key}=", body) else f"{body}\n{line}"
    return head + mark + body + gap + tail


def gone(text, *sections):
    for section in sections:
        head, mark, rest = text.partition(f"[{section}]\n")
        assert mark, section
        text = head + rest.partition("\n\n")[2]
    return text


def fixed(text, *numbers):
    """Make the maps of PDOs (1600h ..., 1A00h ...) read-only."""
    for number in numbers:
        for sub in range(9):
            text = edit(text, f"{number:04X}sub{sub}", AccessType="ro")
    return text


def mapped(text, number, *words):
    text = edit(text, f"{number:04X}sub0", DefaultValue=len(words))
    for sub, word in enumerate(words, start=1):
        text = edit(text, f"{number:04X}sub{sub}", DefaultValue=f"0x{word:08X}")
    return text
