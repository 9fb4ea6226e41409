"""Rules of [kinematics] beyond the ranges of its keys: joints, lengths, start."""

from __future__ import annotations

import math
from pathlib import Path

from pydantic import Field, ValidationError

from coulombus.kernels.records import new_records
from coulombus.rigs.errors import Source
from coulombus.rigs.field_help import expected, explain, fields_of
from coulombus.rigs.kinematics.kinematics_section import LENGTHS, Kinematics, PlanePlant
from coulombus.rigs.kinematics.mechanisms import JOINTS, MECHANISMS, PoseRecord, condition, locate
from coulombus.rigs.model import Section
from coulombus.rigs.plant import PLANE_KINDS
from coulombus.rigs.toml_lines import Table

__all__ = ["PLANE_SECTIONS", "SIMULATED", "PlaneSections", "check_kinematics", "check_phases", "read_plane"]

PLANE_SECTIONS = frozenset(("kinematics", "plane"))
"""The sections that describe all axes as the joints of one mechanism."""
SIMULATED = "serial_2r"
"""The mechanism that is simulated."""
SINGULAR = 0.005
"""A start whose Jacobian's condition is below this is singular: with equal links, an elbow of 1.4 degrees.
kinematics.least_condition decides whether a pose is far enough from singular for a display.
"""


class PlaneSections(Section):
    """The sections of a rig whose axes are the joints of one mechanism."""

    kinematics: Kinematics = Field(description="how the joints move the tip in the plane")
    plane: PlanePlant | None = Field(None, description="links and hand, for the simulation")

    @property
    def true_kinematics(self) -> Kinematics:
        """[kinematics] with the values of [plane.kinematics], for the simulation."""
        truth = None if self.plane is None else self.plane.kinematics
        return (
            self.kinematics if truth is None else self.kinematics.model_copy(update=truth.model_dump(exclude_none=True))
        )


def read_plane(values: Table, axes: tuple[str, ...], source: Source, *, attached: bool) -> PlaneSections | None:
    """Return [kinematics] and [plane] of a rig file's values; None if it has neither.

    Errors are noted in `source`.

    Parameters
    ----------
    values : the rig file's
    axes : the names of the rig's axes, the joints
    attached : the text comes from a recording: a user-defined mechanism is not run
    """
    file: Table = {name: values[name] for name in sorted(PLANE_SECTIONS & set(values))}
    if not file:
        return None
    sections: PlaneSections | None = None
    try:
        sections = PlaneSections.model_validate(file)
    except ValidationError as error:
        explain(error, file, PlaneSections, source)
    if len(axes) != JOINTS:
        has = f"has the axes {', '.join(axes)}" if axes else "has one axis without a name"
        source.say(("kinematics",), f"the rig {has}; expected {JOINTS} joints: [axis.NAME], once for each")
    if isinstance(file.get("kinematics"), dict):
        _check_lengths(file["kinematics"], source)
    if sections is not None:
        check_kinematics(sections.kinematics, source, attached=attached)
        _check_truth(sections, source)
    return sections


def check_phases(values: Table, source: Source, *, in_plane: bool) -> None:
    """Note phases that move a tip in a rig of independent axes, and phases of one axis in a rig in the plane."""
    phases = values.get("phase")
    for i, phase in enumerate(phases if isinstance(phases, list) else ()):
        kind = phase.get("kind") if isinstance(phase, dict) else None
        if not isinstance(kind, str) or kind == "rest" or source.is_wrong(("phase", i)):
            continue
        if in_plane and kind not in PLANE_KINDS:
            expected = f"rest, {', '.join(PLANE_KINDS)}: the hand of a rig with [kinematics] moves the tip"
            source.stands(("phase", i, "kind"), kind, expected)
        elif not in_plane and kind in PLANE_KINDS:
            source.stands(("phase", i, "kind"), kind, "a phase of one axis: only a rig with [kinematics] has a tip")


def _check_lengths(values: Table, source: Source) -> None:
    """Note dimensions that the kind lacks, and those that it does not use."""
    kind = values.get("kind")
    if not isinstance(kind, str) or kind.strip() not in (*LENGTHS, kind.strip() if ":" in kind else ""):
        return
    needed = LENGTHS.get(kind.strip(), ())
    fields = fields_of(Kinematics)
    for name in dict.fromkeys(name for names in LENGTHS.values() for name in names):
        key = ("kinematics", name)
        if name in needed and name not in values:
            source.lacks(key, expected(name, fields[name]))
        elif name not in needed and name in values and ":" not in kind and not source.is_wrong(key):
            source.say(key, f'no key of kind = "{kind.strip()}"; expected {", ".join(needed)}')


def check_kinematics(kinematics: Kinematics, source: Source, *, attached: bool = False) -> None:
    """Note conflicts between values: limits that do not increase, signs, a start that is singular or outside, a
    Jacobian that does not match its kinematics.
    """
    for name in ("x_m", "y_m"):
        limits = getattr(kinematics, name)
        if limits is not None and not limits[0] < limits[1]:
            source.stands(("kinematics", name), limits, "two numbers that grow, in m")
    _check_signs(("kinematics", "signs"), kinematics.signs, source)
    _check_links(kinematics, source)
    if kinematics.radii_m_rad is not None and 0.0 in kinematics.radii_m_rad:
        source.stands(("kinematics", "radii_m_rad"), kinematics.radii_m_rad, "two numbers that are not 0, in m/rad")
    if any(key[0] == "kinematics" for key in source.wrong):
        return
    if kinematics.function is None:
        pose = _start_pose(kinematics)
    elif attached:
        return
    else:
        from coulombus.rigs.kinematics.load_mechanism import MechanismMistake, load_mechanism

        try:
            pose = load_mechanism(kinematics, Path(source.path).parent).pose(*kinematics.start_rad)
        except MechanismMistake as mistake:
            source.say(("kinematics", "kind"), f"got '{kinematics.kind}', but {mistake}")
            return
    _check_start(("kinematics",), kinematics.start_rad, pose, source)
    x_m, y_m = (float(value) for value in pose["x_m"])
    if not source.is_wrong(("kinematics", "start_rad")) and not kinematics.contains(x_m, y_m):
        expected = f"a start in the workspace x_m, y_m: the tip is at ({x_m:.3g}, {y_m:.3g}) m"
        source.stands(("kinematics", "start_rad"), kinematics.start_rad, expected)


def _check_truth(sections: PlaneSections, source: Source) -> None:
    """Note true dimensions of another mechanism than the simulated one, and those in which it cannot start."""
    if sections.plane is None or sections.plane.kinematics is None or source.wrong:
        return
    section, truth = ("plane", "kinematics"), sections.true_kinematics
    if truth.kind.strip() != SIMULATED:
        source.say(section, f'got kinematics.kind = "{truth.kind}", expected "{SIMULATED}": no other is simulated')
        return
    _check_signs((*section, "signs"), truth.signs, source)
    if not source.is_wrong((*section, "signs")):
        _check_start(section, truth.start_rad, _start_pose(truth), source)


def _check_signs(key: tuple[str, ...], signs: tuple[int, int], source: Source) -> None:
    if not set(signs) <= {1, -1}:
        source.stands(key, signs, "two numbers, each 1 or -1")


def _check_links(kinematics: Kinematics, source: Source) -> None:
    """Note masses and inertias below 0, and those of a mechanism other than two links in series."""
    for name in ("link_mass_kg", "link_centre_m", "link_inertia_kg_m2"):
        values = getattr(kinematics, name)
        if kinematics.kind.strip() != SIMULATED and any(values):
            source.stands(("kinematics", name), values, f'no such key: only kind = "{SIMULATED}" has it')
        elif name != "link_centre_m" and min(values) < 0.0:
            source.stands(("kinematics", name), values, "two numbers from 0 on")


def _start_pose(kinematics: Kinematics) -> PoseRecord:
    """Return the pose of a built-in mechanism at its start."""
    pose = new_records(PoseRecord)[0]
    pose["q_rad"] = kinematics.start_rad
    locate(MECHANISMS[kinematics.kind.strip()], kinematics.record()[0], pose)
    return pose


def _check_start(section: tuple[str, ...], start: tuple[float, float], pose: PoseRecord, source: Source) -> None:
    """Note a start that is unreachable or singular."""
    key = (*section, "start_rad")
    condition_number = condition(pose)
    if not all(math.isfinite(value) for value in pose["x_m"]):
        source.stands(key, start, "angles that the mechanism can take: its links do not meet there")
    elif condition_number < SINGULAR:
        source.stands(
            key, start, f"a start that is not singular: the Jacobian's condition is {condition_number:.2g} there"
        )
