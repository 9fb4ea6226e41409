"""[kinematics] and [plane] of the rig file: two axes move a tip in the plane; its links and hand."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from pydantic import Field
from pydantic.config import JsonDict

from coulombus.kernels.records import RecordArray, new_records
from coulombus.rigs.kinematics.mechanisms import MechanismRecord
from coulombus.rigs.model import Section

__all__ = ["KINDS", "LENGTHS", "Kinematics", "PlanePlant", "TrueKinematics"]

KIND = r"^\s*(serial_2r|five_bar|cartesian|[^:]+\.py:[A-Za-z_]\w*)\s*$"

LENGTHS: MappingProxyType[str, tuple[str, ...]] = MappingProxyType(
    {
        "serial_2r": ("l1_m", "l2_m"),
        "five_bar": ("l1_m", "l2_m", "l3_m", "l4_m", "base_m"),
        "cartesian": ("radii_m_rad",),
    }
)
"""Kind -> the keys that it needs. A kind that is a file needs none of them."""
KINDS = tuple(LENGTHS)


def _length(description: str) -> Any:
    extra: JsonDict = {"range": "above 0, at most 100", "expected": "a number above 0, at most 100, in m"}
    return Field(None, gt=0, le=100, description=description, json_schema_extra=extra)


def _pair(default: tuple[float, float] | None, description: str, unit: str, words: str = "two numbers") -> Any:
    expected = words + (f", in {unit}" if unit else "")
    return Field(default, strict=False, description=description, json_schema_extra={"expected": expected})


class Kinematics(Section):
    """[kinematics]: map from the joints to the tip in the plane; the joints are the rig's two axes, in the file's
    order.
    """

    kind: str = Field(
        pattern=KIND,
        description="the mechanism",
        json_schema_extra={"expected": '"serial_2r", "five_bar", "cartesian" or "file.py:function"'},
    )
    l1_m: float | None = _length("first link; of a five-bar from the fixed joint of axis 1 to its elbow")
    l2_m: float | None = _length("second link; of a five-bar from that elbow to the tip")
    l3_m: float | None = _length("five-bar: from the fixed joint of axis 2 to its elbow")
    l4_m: float | None = _length("five-bar: from that elbow to the tip")
    base_m: float | None = Field(
        None,
        ge=0,
        le=100,
        description="five-bar: distance of the two fixed joints",
        json_schema_extra={"range": "0 to 100", "expected": "a number from 0 to 100, in m"},
    )
    radii_m_rad: tuple[float, float] | None = _pair(None, "cartesian: way of x and y per angle", "m/rad")
    offsets_rad: tuple[float, float] = _pair((0.0, 0.0), "the mechanism's angles where the axes' are 0", "rad")
    signs: tuple[int, int] = Field(
        (1, 1),
        strict=False,
        description="sense of each joint in the mechanism",
        json_schema_extra={"expected": "two numbers, each 1 or -1"},
    )
    start_rad: tuple[float, float] = _pair((0.0, 1.5707963267948966), "the joints' angles when the host starts", "rad")
    x_m: tuple[float, float] | None = _pair(None, "workspace: the tip's x is between", "m", "two numbers that grow")
    y_m: tuple[float, float] | None = _pair(None, "workspace: the tip's y is between", "m", "two numbers that grow")
    least_condition: float = Field(
        0.15,
        ge=0,
        lt=1,
        description="least condition of the Jacobian, its smallest singular value over its largest",
        json_schema_extra={"range": "at least 0, below 1", "expected": "a number from 0 to below 1"},
    )
    link_mass_kg: tuple[float, float] = _pair((0.0, 0.0), "serial_2r: mass of each link", "kg")
    link_centre_m: tuple[float, float] = _pair((0.0, 0.0), "serial_2r: from a link's joint to its centre of mass", "m")
    link_inertia_kg_m2: tuple[float, float] = _pair(
        (0.0, 0.0), "serial_2r: inertia of each link about its centre", "kg m2"
    )
    user: tuple[float, ...] = Field((), strict=False, max_length=16, description="numbers for a mechanism of your own")

    @property
    def function(self) -> tuple[str, str] | None:
        """File and function name of a user-defined mechanism; None for a built-in one."""
        place, _, name = self.kind.strip().rpartition(":")
        return (place, name) if place else None

    def record(self) -> RecordArray[MechanismRecord]:
        """Return the dimensions for the kernels, as an array of one record."""
        record = new_records(MechanismRecord)
        m = record[0]
        if self.radii_m_rad is not None:
            m["link_m"][:2] = self.radii_m_rad
        else:
            m["link_m"] = [length or 0.0 for length in (self.l1_m, self.l2_m, self.l3_m, self.l4_m)]
        m["base_m"] = self.base_m or 0.0
        m["offset_rad"], m["sign"] = self.offsets_rad, self.signs
        m["user"][: len(self.user)] = self.user
        return record

    def contains(self, x_m: float, y_m: float) -> bool:
        """Return whether a point is in the rig file's workspace."""
        return all(
            limits is None or limits[0] <= value <= limits[1] for value, limits in ((x_m, self.x_m), (y_m, self.y_m))
        )


class TrueKinematics(Section):
    """[plane.kinematics]: the true dimensions of two links where they differ from those of [kinematics]."""

    l1_m: float | None = _length("first link")
    l2_m: float | None = _length("second link")
    offsets_rad: tuple[float, float] | None = _pair(None, "the mechanism's angles where the axes' are 0", "rad")
    signs: tuple[int, int] | None = Field(
        None,
        strict=False,
        description="sense of each joint in the mechanism",
        json_schema_extra={"expected": "two numbers, each 1 or -1"},
    )
    start_rad: tuple[float, float] | None = _pair(None, "the joints' angles when the host starts", "rad")


class PlanePlant(Section):
    """[plane]: true links and hand in the plane, for the simulation only."""

    kinematics: TrueKinematics | None = Field(None, description="true dimensions that differ from [kinematics]")
    link_mass_kg: tuple[float, float] = _pair((0.0, 0.0), "mass of each link", "kg")
    link_centre_m: tuple[float, float] = _pair((0.0, 0.0), "from a link's joint to its centre of mass", "m")
    link_inertia_kg_m2: tuple[float, float] = _pair((0.0, 0.0), "inertia of each link about its centre", "kg m2")
    hand_mass_kg: float = Field(ge=0, le=1e3, description="mass of the hand at the tip")
    hand_damping_Ns_m: tuple[float, float] = _pair((0.0, 0.0), "the hand's damping along x and y", "N s/m")
    hand_stiffness_N_m: tuple[float, float] = _pair((0.0, 0.0), "the hand's stiffness along x and y", "N/m")
    hand_tremor_N: float = Field(0.0, ge=0, le=1e3, description="amplitude of the hand's tremor, in each direction")
    hand_tremor_Hz: float = Field(9.0, ge=0, le=1e3, description="frequency of the tremor")
    hand_population: float = Field(
        0.0, ge=0, le=1, description="spread of hands: 0: every seed has this hand; else each seed is a subject"
    )
