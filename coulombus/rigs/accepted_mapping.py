"""Objects that a device can map into PDOs although its EDS file denies it.

The rig file acknowledges each of them in ``host.accept``; the device's answer at bring-up decides.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from coulombus.eds.description import Description
from coulombus.rigs.signals import Node

__all__ = ["mapping_sentence", "with_accepted"]

SENTENCE = re.compile(r"(?P<node>[\w.]+): (?P<index>[0-9A-F]{4})h(?::(?P<sub>[0-9A-F]{1,2}))? can be mapped")


def mapping_sentence(name: str, index: int, subindex: int) -> str:
    """Return the sentence of ``host.accept`` that acknowledges a mapping; `name` is the device's."""
    place = f"{index:04X}h:{subindex:X}" if subindex else f"{index:04X}h"
    return f"{name}: {place} can be mapped"


def with_accepted(description: Description, name: Node, sentences: Iterable[str]) -> Description:
    """Return the EDS file of a device with PDOMapping=1 for the objects that `sentences` name."""
    objects = dict(description.objects)
    for sentence in sentences:
        match = SENTENCE.fullmatch(sentence)
        if match is None or match["node"] != name:
            continue
        index, subindex = int(match["index"], 16), int(match["sub"] or "0", 16)
        if not description.has(index, subindex):
            continue
        entry = objects[index]
        variable = replace(entry.variables[subindex], pdo_mappable=True)
        objects[index] = replace(entry, variables={**entry.variables, subindex: variable})
    return description if objects == description.objects else replace(description, objects=objects)
