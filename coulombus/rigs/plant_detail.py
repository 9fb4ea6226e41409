"""Details of a simulated rig beyond one rigid body.

They are [plant.cable], [plant.handle], [plant.friction], [plant.fluid], [plant.ripple] and
[plant.heat]; [plant.iron] is in `rigs.devices`.

A rig file without these sections has one rigid body.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from coulombus.rigs.model import Section

__all__ = ["MOST_ELEMENTS", "Cable", "Fluid", "Friction", "Handle", "Heat", "Ripple"]

MOST_ELEMENTS = 8


class _Coupling(Section):
    stiffness_Nm_rad: float = Field(gt=0, le=1e9, description="its stiffness at the handle")
    damping_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="its damping, while it is tight")
    backlash_rad: float = Field(0.0, ge=0, le=10, description="its whole backlash, at the handle")


class Cable(_Coupling):
    """[plant.cable]: the elastic transmission between the motor and the brake's drum.

    The encoder is on the motor's side.
    """

    motor_inertia_kg_m2: float = Field(
        gt=0, le=1e3, description="what of plant.inertia_kg_m2 is on the motor's side, seen at the handle"
    )
    friction_share: float = Field(
        1.0, ge=0, le=1, description="share of coulomb_Nm, stribeck_Nm and viscous_Nms_rad on the motor's side"
    )


class Handle(_Coupling):
    """[plant.handle]: the elastic shaft between the drum and the handle that the hand holds."""

    inertia_kg_m2: float = Field(gt=0, le=1e3, description="what of plant.inertia_kg_m2 is the handle's")


class Friction(Section):
    """[plant.friction]: details of the device's own friction."""

    law: Literal["coulomb", "lugre", "gms", "leuven"] = Field(
        "coulomb",
        description="coulomb: a level, exactly stuck at rest; lugre: bristles; gms, leuven: elements that slip",
    )
    sigma_0_Nm_rad: float = Field(0.0, ge=0, le=1e9, description="stiffness of the bristles")
    sigma_1_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="damping of the bristles, of leuven, too")
    elements_Nm_rad: tuple[Annotated[float, Field(gt=0, le=1e9)], ...] = Field(
        (),
        strict=False,
        max_length=MOST_ELEMENTS,
        description="stiffness of each element",
        json_schema_extra={"expected": f"a list of 1 to {MOST_ELEMENTS} numbers above 0, in Nm/rad"},
    )
    shares: tuple[Annotated[float, Field(gt=0, le=1e6)], ...] = Field(
        (),
        strict=False,
        max_length=MOST_ELEMENTS,
        description="share of each element, relative to the sum of all shares",
        json_schema_extra={"expected": "a list of as many numbers above 0 as elements_Nm_rad has"},
    )
    C_Nm_s: float = Field(0.0, ge=0, le=1e9, description="how fast a slipping element of gms follows the level")
    stribeck_exponent: float = Field(2.0, gt=0, le=10, description="exponent of the Stribeck curve")
    angle_share: float = Field(0.0, ge=0, le=0.99, description="amplitude of the friction's change with the angle")
    angle_periods: int = Field(1, ge=1, le=10_000, description="its periods in one revolution of the handle")
    angle_phase_rad: float = Field(0.0, ge=-10, le=10, description="its phase at the angle 0")
    load_share: float = Field(
        0.0, ge=0, le=0.9, description="friction of a gear that grows with its load, as a share of the motor's torque"
    )
    share_1_K: float = Field(0.0, ge=-1, le=1, description="by which share it grows with each kelvin")
    drift_1_s: float = Field(0.0, ge=-1, le=1, description="by which share it grows each second")


class Fluid(Section):
    """[plant.fluid]: details of the brake's fluid."""

    viscous_Nms_rad: float = Field(0.0, ge=0, le=1e3, description="viscous friction of the fluid, on the drum")
    viscous_1_K: float = Field(0.0, ge=0, le=1, description="by which share that falls with each kelvin, at first")
    torque_1_K: float = Field(0.0, ge=0, le=1, description="by which share the torque falls with each kelvin")
    fall_lag_s: float | None = Field(
        None, ge=0, le=1, description="time constant where the torque falls; brake_fluid_lag_s where it is not given"
    )
    shear_s_rad: float = Field(
        0.0, ge=0, le=1e3, description="the fluid's lag is divided by 1 + this times the drum's speed"
    )


class Ripple(Section):
    """[plant.ripple]: the motor's torque ripple, in proportion to its torque."""

    share: float = Field(ge=0, le=0.99, description="amplitude, as a share of the torque")
    periods: int = Field(6, ge=1, le=1000, description="periods in one revolution of the motor")
    phase_rad: float = Field(0.0, ge=-10, le=10, description="phase at the angle 0")


class Heat(Section):
    """[plant.heat]: the device's temperature, raised by friction and the coil.

    It starts at plant.temperature_degC.
    """

    capacity_J_K: float = Field(gt=0, le=1e9, description="heat capacity of brake and bearings")
    resistance_K_W: float = Field(gt=0, le=1e6, description="thermal resistance to the ambient")
    reference_degC: float = Field(
        22.0, ge=-40, le=200, description="temperature at which friction and fluid are as their keys say"
    )
