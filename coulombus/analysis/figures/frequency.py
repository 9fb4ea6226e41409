"""Figures of the frequency domain: the paper's corrected Figs. 2, 6 and 7, and the certificates."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coulombus.analysis.theory.absolute import AbsoluteStability
from coulombus.analysis.theory.crossings import Crossings, frequency_grid
from coulombus.analysis.theory.linear import Disk, frequency_response, passive_disk, plant
from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.zames_falb import multiplier_response
from coulombus.recording.pictures.style import BLACK, BLUE, GREY, ORANGE, VERMILION, figure, label, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "Loci",
    "draw_certificate",
    "draw_friction",
    "draw_passive_region",
    "draw_sampled_disks",
    "draw_zoom",
    "loci",
    "write_frequency_figures",
]

SHOWN_DISKS = 9


@dataclass(frozen=True)
class Loci:
    """Nyquist data: the passive set's disks, the concrete operator's curve with and without
    sampling.
    """

    frequency_Hz: Floats
    sampled: Complexes
    """H*(jw)."""
    continuous: Complexes
    """H(jw) of the brake, eq. (15)."""
    continuous_Hz: Floats
    disks: Disk | None
    """None for b = 0."""
    delay_s: float


def loci(parameters: Parameters) -> Loci:
    """Return the data of Figs. 6 and 7."""
    grid = frequency_grid(parameters)
    wide = np.geomspace(1e-3, 1e4, 3000)
    disks = None
    if parameters.damping_Ns_m > 0:
        disks = passive_disk(np.linspace(0, parameters.nyquist_Hz, SHOWN_DISKS), parameters)
    s = 2j * np.pi * wide
    return Loci(
        grid,
        frequency_response(grid, parameters),
        plant(s.astype(np.complex128), parameters),
        wide,
        disks,
        parameters.delay_s,
    )


def _circle(center: complex, radius: float) -> tuple[Floats, Floats]:
    turn = np.linspace(0, 2 * np.pi, 361)
    return center.real + radius * np.cos(turn), center.imag + radius * np.sin(turn)


def draw_friction(axes: Axes, friction_N: float, slope_Ns_m: float | None) -> None:
    """Draw the friction of Fig. 2: ideal (a set at v = 0), and the steepest certified one."""
    reach = 3 * friction_N / slope_Ns_m if slope_Ns_m else 1.0
    axes.plot(
        [-reach, 0, 0, reach],
        np.array([-1, -1, 1, 1]) * friction_N,
        color=BLUE,
        lw=1.8,
        label=r"Coulomb: $c\,$Sgn$(v)$, a set at $v = 0$",
    )
    if slope_Ns_m:
        v = np.linspace(-reach, reach, 301)
        psi = np.clip(slope_Ns_m * v, -friction_N, friction_N)
        axes.plot(v, psi, color=VERMILION, ls="--", label=f"steepest certified: {slope_Ns_m:.4g} Ns/m")
    axes.plot(0, 0, "o", ms=4, color=BLACK, label=r"the sampled law's sgn$(0) = 0$")
    label(axes, "velocity v [m/s]", r"friction $\psi$ [N]", r"Fig. 2  The friction: $\psi > 0$ opposes $v > 0$")
    axes.legend(loc="lower right")


def draw_passive_region(axes: Axes, data: Loci, b: float) -> None:
    """Draw Fig. 6: the region of (m jw + b + Z_o)^-1, and the paper's operator."""
    x, y = _circle(complex(0.5 / b, 0), 0.5 / b)
    axes.fill(x, y, color="0.92", zorder=0)
    axes.plot(x, y, color=GREY, label=f"any passive operator: centre and radius 1/2b = {0.5 / b:.3g}")
    h = data.continuous
    axes.plot(h.real, h.imag, color=BLUE, lw=2, label="this operator")
    axes.axvline(0, color=BLACK, lw=0.6)
    axes.set_aspect("equal")
    label(
        axes,
        "real part [m/(Ns)]",
        "imaginary part [m/(Ns)]",
        "Fig. 6  Passive: the disk stays in the closed right half plane",
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    inset = axes.inset_axes((0.37, 0.36, 0.26, 0.28))
    inset.plot(h.real, h.imag, color=BLUE)
    inset.axvline(0, color=BLACK, lw=0.6)
    inset.set_title("this operator", fontsize=7, loc="center")
    inset.tick_params(labelsize=6)


def draw_sampled_disks(axes: Axes, data: Loci) -> None:
    """Draw Fig. 7 as corrected: the disk turns by r(jw), once clockwise over all frequencies for
    each two cycles of lag.
    """
    if data.disks is not None:
        last = len(data.disks.frequency_Hz) - 1
        for i, (f, center, radius) in enumerate(
            zip(data.disks.frequency_Hz, data.disks.center, data.disks.radius, strict=True)
        ):
            shade = str(0.8 - 0.6 * i / last)
            x, y = _circle(complex(center), float(radius))
            axes.plot(x, y, color=shade, lw=0.9)
            axes.plot(center.real, center.imag, ".", color=shade)
            away = complex(center) * (2.06 - 0.16j) if abs(center) else complex(radius, 0)
            axes.annotate(
                f"{f:.4g} Hz",
                (away.real, away.imag),
                fontsize=7,
                ha="center",
                va="center",
                color="0.15",
                bbox={"fc": "w", "ec": "none", "pad": 0.6},
            )
        edge = 2.25 * float(np.max(data.disks.radius))
        axes.plot([-edge, 0], [0, 0], color=VERMILION, lw=2.2, label=r"$-1/\Psi(a)$, $a$ grows to the left")
        axes.set_xlim(-edge, edge)
        axes.set_ylim(-edge, edge)
    axes.axvline(0, color=BLACK, lw=0.6)
    axes.set_aspect("equal")
    label(
        axes,
        "real part [m/(Ns)]",
        "imaginary part [m/(Ns)]",
        r"Fig. 7  Active: $\mathbf{R}_{H^*}(\omega)$ for any passive operator",
    )
    axes.legend(loc="upper right")


def draw_zoom(axes: Axes, data: Loci, intersections: Crossings) -> None:
    """Draw the same near the origin for the concrete operator, with the crossings."""
    h = data.sampled
    axes.plot(h.real, h.imag, color=BLUE, label=r"$H^*(j\omega)$, this operator")
    if intersections.largest is None:
        reach = float(np.max(np.abs(h))) * 0.1
        axes.annotate("no crossing", (0.05, 0.9), xycoords="axes fraction")
    else:
        reach = 2.4 * abs(intersections.largest.h_real)
    axes.plot([-3 * reach, 0], [0, 0], color=VERMILION, lw=2.2, label=r"$-1/\Psi(a)$")
    for crossing in intersections.found:
        axes.plot(crossing.h_real, 0, "o", ms=6, mfc=ORANGE if crossing.stable else "w", mec=BLACK, zorder=5)
        axes.annotate(
            f"{crossing.frequency_Hz:.1f} Hz\n{crossing.amplitude_m_s * 1e3:.2f} mm/s\n{'stable' if crossing.stable else 'unstable'}",
            (crossing.h_real, 0),
            xytext=(-6, 10),
            textcoords="offset points",
            fontsize=8,
            ha="right",
        )
    axes.axvline(0, color=BLACK, lw=0.6)
    axes.set_xlim(-reach, 0.6 * reach)
    axes.set_ylim(-0.9 * reach, 0.7 * reach)
    label(axes, "real part [m/(Ns)]", "imaginary part [m/(Ns)]", "near the origin: this operator's crossing")
    axes.legend(loc="lower right")


def draw_certificate(axes: Axes, data: Loci, absolute: AbsoluteStability, period_s: float) -> None:
    """Draw Re{M (1 + k H*)} over frequency: without and with the multiplier, at the slope that the
    multiplier certifies.
    """
    certificate = absolute.certificate
    if certificate is None:
        axes.annotate(absolute.text, (0.05, 0.5), xycoords="axes fraction")
        return
    k, f = certificate.slope_Ns_m, data.frequency_Hz
    plain = 1 + k * data.sampled
    turned = multiplier_response(np.array(certificate.taps), 2 * np.pi * f * period_s) * plain
    axes.plot(f, plain.real, color=VERMILION, ls="--", label="without a multiplier (Tsypkin): negative, not certified")
    axes.plot(f, turned.real, color=BLUE, label="with the Zames-Falb multiplier: positive, certified")
    axes.axhline(0, color=BLACK, lw=0.8)
    axes.set_ylim(-1, 3)
    title = f"Slope {k:.5g} Ns/m; Tsypkin alone {absolute.tsypkin:.5g}, Nyquist's limit {absolute.nyquist:.5g}"
    label(axes, "frequency [Hz]", r"Re$\{M\,(1 + k\,H^*)\}$ [1]", title)
    axes.legend(loc="upper right")


def write_frequency_figures(
    directory: str | os.PathLike[str], parameters: Parameters, intersections: Crossings, absolute: AbsoluteStability
) -> list[Path]:
    """Write fig02, fig06, fig07 and certificate as PNG and SVG; return their paths."""
    data = loci(parameters)
    paths: list[Path] = []
    with figure(5.4, 3.6) as (fig, axes):
        draw_friction(axes, parameters.friction_N, absolute.zames_falb or absolute.tsypkin)
        paths += save(fig, directory, "fig02-friction")
    if parameters.damping_Ns_m > 0:
        with figure(5.4, 5.2) as (fig, axes):
            draw_passive_region(axes, data, parameters.damping_Ns_m)
            paths += save(fig, directory, "fig06-passive")
    with figure(10.4, 5.0, 1, 2) as (fig, axes):
        draw_sampled_disks(axes[0], data)
        draw_zoom(axes[1], data, intersections)
        paths += save(fig, directory, "fig07-active")
    with figure(7.0, 3.6) as (fig, axes):
        draw_certificate(axes, data, absolute, parameters.period_s)
        paths += save(fig, directory, "certificate")
    return paths
