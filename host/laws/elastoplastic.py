"""Elasto-plastic friction: LuGre's bristles, which do not yield below break-away."""

from __future__ import annotations

import math
from types import MappingProxyType

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law
from coulombus.host.laws.stribeck import stribeck_level

__all__ = ["elastoplastic"]

STEPS = 16
"""Steps over the width in which the bristles begin to yield."""
MOST_STEPS = 512


class ElastoPlasticParameters(Parameters):
    """[law.elastoplastic]."""

    at_least = MappingProxyType({"F_s_Nm": "F_c_Nm"})
    above = MappingProxyType({"F_c_Nm": "F_ba_Nm"})

    F_c_Nm: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction")
    F_s_Nm: float = Field(1.2, gt=0, le=1e4, description="static friction")
    F_ba_Nm: float = Field(0.7, gt=0, le=1e4, description="below this the bristles are elastic: no drift")
    v_s_rad_s: float = Field(0.5, gt=0, le=1e4, description="Stribeck speed")
    sigma_0_Nm_rad: float = Field(100.0, gt=0, le=1e9, description="stiffness of the bristles")
    sigma_1_Nms_rad: float = Field(0.1, ge=0, le=1e6, description="damping of the bristles")
    sigma_2_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="viscous friction")


class ElastoPlasticState(LawStateRecord):
    """What it keeps."""

    z_rad: float


@friction_law(ElastoPlasticParameters, state=ElastoPlasticState, extremes=("F_s_Nm",))
def elastoplastic(motion: MotionRecord, law: ElastoPlasticParameters, state: ElastoPlasticState) -> float:
    r"""Elasto-plastic friction: LuGre's bristles, which do not yield below break-away.

    .. math::

        \dot z = v \left(1 - \alpha(z, v)\,\frac{\sigma_0 z}{g(v)}\,\mathrm{sgn}(v)\right), \quad
        \psi = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v

    with LuGre's g(v). :math:`\alpha = 0` while z is wound against the motion or
    :math:`|\sigma_0 z| \le F_{ba}`: a load below F_ba does not let the handle drift, however it
    shakes. :math:`\alpha = 1` from :math:`z_{ss} = g/\sigma_0` on, and half a sine between.

    Within a cycle v is one number, and z depends on the path alone. The elastic part and that beyond
    z_ss are solved exactly, the part between by the classical Runge-Kutta method in 16 steps over its
    width; after 32 widths it is a parabola, which is solved, too. The brake bears :math:`g(v) + \sigma_2 |v|`.

    Source: P. Dupont, V. Hayward, B. Armstrong, F. Altpeter, Single state elastoplastic friction
    models, IEEE Trans. Automat. Control 47(5), 2002, doi:10.1109/TAC.2002.1000274.
    """
    v = motion.v_rad_s
    g = stribeck_level(v, law.F_c_Nm, law.F_s_Nm, law.v_s_rad_s)
    state.brake_Nm = g + law.sigma_2_Nms_rad * abs(v)
    if v == 0.0:
        return float(law.sigma_0_Nm_rad * state.z_rad)
    sense = 1.0 if v > 0.0 else -1.0
    z_ss, z_ba = g / law.sigma_0_Nm_rad, law.F_ba_Nm / law.sigma_0_Nm_rad
    y, left = sense * state.z_rad, abs(v) * motion.dt_s  # how far they are bent in the sense of the motion
    if y < z_ba:
        elastic = min(left, z_ba - y)
        y += elastic
        left -= elastic
    width = z_ss - z_ba
    scale, middle = math.pi / width, 0.5 * (z_ss + z_ba)
    if left > 0.0 and y < z_ss:
        steps = math.ceil(min(left * STEPS / width, MOST_STEPS))
        h = min(left / steps, width / STEPS)
        for _ in range(steps):
            k_1 = 1.0 - 0.5 * (math.sin(scale * (y - middle)) + 1.0) * y / z_ss
            u = min(y + 0.5 * h * k_1, z_ss)
            k_2 = 1.0 - 0.5 * (math.sin(scale * (u - middle)) + 1.0) * u / z_ss
            u = min(y + 0.5 * h * k_2, z_ss)
            k_3 = 1.0 - 0.5 * (math.sin(scale * (u - middle)) + 1.0) * u / z_ss
            u = min(y + h * k_3, z_ss)
            k_4 = 1.0 - 0.5 * (math.sin(scale * (u - middle)) + 1.0) * u / z_ss
            y = min(y + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4), z_ss)
        left -= steps * h
    if left > 0.0 and y > z_ss:
        y = z_ss + (y - z_ss) * math.exp(-left / z_ss)
    elif left > 0.0 and y < z_ss:  # so near to z_ss that the sine is a parabola: Bernoulli's equation
        bend = 0.25 * scale * scale * z_ss
        y = z_ss - 1.0 / ((1.0 / (z_ss - y) + bend) * math.exp(min(left / z_ss, 700.0)) - bend)
    state.z_rad = sense * y
    share = 0.0
    if y >= z_ss:
        share = 1.0
    elif y > z_ba:
        share = 0.5 * (math.sin(scale * (y - middle)) + 1.0)
    z_rate = v * (1.0 - share * y / z_ss)
    return float(law.sigma_0_Nm_rad * state.z_rad + law.sigma_1_Nms_rad * z_rate + law.sigma_2_Nms_rad * v)
