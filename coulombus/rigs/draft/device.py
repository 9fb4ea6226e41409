"""One device of a draft: its EDS file, and the live device's answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from coulombus.eds.drive_axis import of_axis
from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.eds.pdo import Entry
from coulombus.eds.reader import Description, Variable
from coulombus.eds.sections import number_of
from coulombus.rigs.roles import checked_entry
from coulombus.rigs.signals import Direction, Node

__all__ = ["DraftDevice", "Place", "label"]

Place = tuple[int, int]


def label(place: Place) -> str:
    """Return an object in the usual notation: ``6071h``, ``7300h:1``."""
    index, subindex = place
    return f"{index:04X}h:{subindex:X}" if subindex else f"{index:04X}h"


@dataclass(frozen=True)
class DraftDevice:
    """A device of a draft.

    Attributes
    ----------
    node : "motor", "brake", or a sensor's name
    eds : the EDS file's name for the rig file
    answers : the live device's values by object; empty if none was read
    axis : number of the drive's axis; methods take the indices of the first axis
    """

    node: Node
    description: Description
    eds: str
    node_id: int
    answers: Mapping[Place, int] = field(default_factory=dict)
    axis: int = 1

    @property
    def is_own(self) -> bool:
        """Whether it is the project's own device."""
        return is_own(self.node, identity_from_1018h(self.description))

    def at(self, index: int) -> int:
        """Return this axis' object for `index` of the first axis."""
        return of_axis(index, self.axis)

    def has(self, index: int, subindex: int | None = None) -> bool:
        """Return whether the EDS file describes an object of this axis."""
        return self.description.has(self.at(index), subindex)

    def variable(self, index: int, subindex: int = 0) -> Variable:
        """Return the EDS entry of an object of this axis."""
        return self.description.variable(self.at(index), subindex)

    def label(self, place: Place) -> str:
        """Return an object of this axis in the usual notation."""
        return label((self.at(place[0]), place[1]))

    def value(self, index: int, subindex: int = 0) -> int | None:
        """Return an object's value: the device's answer, else the EDS file's default, else None."""
        index = self.at(index)
        answer = self.answers.get((index, subindex))
        if answer is not None or not self.description.has(index, subindex):
            return answer
        default = self.description.default(index, subindex, self.node_id)
        return default if isinstance(default, int) else None

    def source(self, index: int, subindex: int = 0) -> str:
        """Return the source of `value`'s result."""
        return "the device" if (self.at(index), subindex) in self.answers else "the EDS file"

    def entry(self, place: Place, direction: Direction) -> Entry | None:
        """Return the entry that maps an object; None if no PDO of this direction can carry it."""
        try:
            return checked_entry(self.description, self.at(place[0]), place[1], direction)
        except ValueError:
            return None

    def identity(self, subindex: int) -> tuple[int | None, str]:
        """Return 1018h:1 (vendor) or :2 (product) and why it is a guess, "" if it is not; None without the object."""
        if not self.description.has(0x1018, subindex):
            return None, ""
        identity_number = self.value(0x1018, subindex)
        if identity_number:
            return identity_number, ""
        key = ("vendornumber", "productnumber")[subindex - 1]
        number = number_of({name.lower(): text for name, text in self.description.info.items()}.get(key, ""))
        where = f"the EDS file does not tell 1018h:{subindex}"
        if number is not None and 0 < number.value <= 0xFFFFFFFF:
            return number.value, f"{where}; [DeviceInfo] has this number. Read the device's own"
        return 0, f"{where}. Read the device's own"
