"""Build an `Axis` from the rig file's values: sections, EDS files of its devices, their PDOs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from coulombus.eds.reader import Description
from coulombus.rigs.axis import Axis, Origin, Sections
from coulombus.rigs.errors import Source
from coulombus.rigs.field_help import explain, misspelt_sections
from coulombus.rigs.files import read_descriptions, read_schedules
from coulombus.rigs.pdo_maps import AxisPdos, allocate
from coulombus.rigs.rules import check, check_roles
from coulombus.rigs.signals import Node

__all__ = ["AxisParts"]


class _Unnamed:
    """An axis under check: its sections and the EDS files of its devices (`rigs.signals.Parts`)."""

    def __init__(self, sections: Sections, descriptions: Mapping[Node, Description]) -> None:
        self._sections, self._descriptions = sections, descriptions

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sections, name)

    def description(self, node: Node) -> Description:
        """Return the EDS file of a device."""
        return self._descriptions[node]


@dataclass(frozen=True)
class AxisParts:
    """The parts of an axis; `sections` is None if they are refused."""

    sections: Sections | None
    descriptions: Mapping[Node, Description]
    allocation: AxisPdos | None = None

    @classmethod
    def from_values(
        cls,
        name: str,
        values: dict[str, Any],
        source: Source,
        eds_texts: Mapping[str, str] | None,
        *,
        attached: bool,
        earlier: Axis | None,
    ) -> AxisParts:
        """Validate the values of one axis; errors are noted in `source`."""
        read_schedules(values, source, attached=attached)
        misspelt_sections(values, Sections, source)
        sections: Sections | None = None
        try:
            sections = Sections.model_validate(values)
        except ValidationError as error:
            explain(error, values, Sections, source)
        check(values, source)
        descriptions = read_descriptions(values, source, eds_texts, f"{name}." if name else "")
        allocation = None
        if sections is not None and len(descriptions) == len(sections.devices):
            if earlier is not None and earlier.has_devices_of(sections, descriptions):
                allocation = earlier.allocation
            else:
                parts = _Unnamed(sections, descriptions)
                allocation = allocate(parts, f"{name}." if name else "")
                check_roles(allocation.problems, parts, values, source)
        if sections is None and not source.found:
            raise AssertionError("an axis that pydantic refuses has a mistake that is explained")
        return cls(sections, descriptions, allocation)

    def axis(self, name: str, origin: Origin, *, joint: bool) -> Axis:
        """Return the axis; call only if nothing was refused."""
        assert self.sections is not None
        return Axis.from_sections(self.sections, name, self.descriptions, origin, self.allocation, joint=joint)
