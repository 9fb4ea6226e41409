"""Conversion between EDS, DCF, XDD and XDC: the same objects in CiA 306's form and in CiA 311's.

`eds.eds_keys` reads a file, `eds.xdd_writer` writes XML.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from coulombus.eds.description import Description
from coulombus.eds.eds_keys import COMMISSIONED, HEADS, OF_DCF, FileContent, content_of
from coulombus.eds.file_info import OBJECT_LISTS
from coulombus.eds.reader import read_eds
from coulombus.eds.xdd import is_xml

__all__ = ["SUFFIXES", "converted", "eds_text", "eds_text_of"]

SUFFIXES = (".eds", ".dcf", ".xdd", ".xdc")
CONFIGURED = (".dcf", ".xdc")
"""Files of a configured device."""


def converted(path: str | Path, suffix: str) -> tuple[str, tuple[str, ...]]:
    """Return the text of a file in the form of a suffix of `SUFFIXES`, and what that form cannot say.

    Raises
    ------
    EdsError
        The file cannot be read.
    """
    content = content_of(read_eds(path))
    if suffix not in CONFIGURED and Path(path).suffix.lower() in CONFIGURED:
        _without_configuration(content)
    if suffix in (".xdd", ".xdc"):
        from coulombus.eds.xdd_writer import xdd_text_of

        text = xdd_text_of(content)
    else:
        text = eds_text_of(content)
    return text, tuple(f"{what}" + (f" ({count})" if count > 1 else "") for what, count in content.left_out.items())


def _without_configuration(content: FileContent) -> None:
    """Remove a DCF's additions."""
    for row in content.rows:
        for key in OF_DCF:
            if row.keys.pop(key, ""):
                content.left_out[f"{key}: the file is of no configured device"] += 1
    if content.sections.pop(COMMISSIONED, None) is not None:
        content.left_out[f"[{COMMISSIONED}]: the file is of no configured device"] += 1


def eds_text(description: Description) -> str:
    """Return a description's text in CiA 306's form: an EDS or DCF unchanged."""
    return eds_text_of(content_of(description)) if is_xml(description.text) else description.text


def eds_text_of(content: FileContent) -> str:
    """Return the text of an EDS or DCF."""
    lines: list[str] = []

    def add(name: str, keys: Mapping[str, str]) -> None:
        lines.extend((f"[{name}]", *(f"{key}={text}" for key, text in keys.items()), ""))

    for name in (*HEADS, *(name for name in content.sections if name not in HEADS)):
        if name in content.sections:
            add(name, content.sections[name])
    indices = [row.index for row in content.rows if row.subindex < 0 and row.index >= 0x1000]
    listed = set[int]()
    for name, ranges in OBJECT_LISTS.items():
        group = [i for i in indices if i not in listed and any(low <= i <= high for low, high in ranges)]
        listed.update(group)
        numbers = {str(number): f"0x{index:04X}" for number, index in enumerate(group, 1)}
        add(name, {"SupportedObjects": str(len(group)), **numbers})
    for row in content.rows:
        add(row.name, row.keys)
    return "\n".join(lines)
