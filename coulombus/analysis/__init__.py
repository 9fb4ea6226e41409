"""Computations of the paper, equation by equation and figure by figure, and beyond it.

Each part computes a dataclass; plots are separate.

Its public names are imported when they are first used; docs/api.md lists them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from coulombus.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from coulombus.analysis.figures.frequency import write_frequency_figures
    from coulombus.analysis.figures.law import draw_law, write_literature_figures
    from coulombus.analysis.figures.rig import write_identification
    from coulombus.analysis.figures.time import write_fig10, write_orbit_figure
    from coulombus.analysis.rig.display_errors import felt_study
    from coulombus.analysis.rig.friction_study import friction_study
    from coulombus.analysis.rig.hold import hold_study
    from coulombus.analysis.rig.law_fit import fit_law, stretches_of
    from coulombus.analysis.rig.law_search import Stretch
    from coulombus.analysis.rig.maps import oscillation_map
    from coulombus.analysis.theory.absolute import absolute_stability
    from coulombus.analysis.theory.bounds import bounds
    from coulombus.analysis.theory.brake_lag import BrakeLag, ripple_limit
    from coulombus.analysis.theory.crossings import crossings
    from coulombus.analysis.theory.delay import delay_table
    from coulombus.analysis.theory.describing import LawParameters, coulomb_psi, jenkins_psi, karnopp_psi, stribeck_psi
    from coulombus.analysis.theory.fig10 import figure_10
    from coulombus.analysis.theory.law_benchmarks import benchmarks as law_benchmarks
    from coulombus.analysis.theory.law_benchmarks import describing_function
    from coulombus.analysis.theory.linear import frequency_response, passive_disk
    from coulombus.analysis.theory.operators import Operator, ParameterError
    from coulombus.analysis.theory.orbits import orbits
    from coulombus.analysis.theory.parameters import Parameters
    from coulombus.analysis.theory.peak import l1_bound
    from coulombus.analysis.theory.published_curves import literature_curves
    from coulombus.analysis.theory.relay_loop import settle
    from coulombus.analysis.theory.stuck_spring import largest_stiffness_damped, spectral_radius, stuck_spring
    from coulombus.analysis.theory.z_width import Handle, hulin_stiffness, z_width

__all__ = [
    "BrakeLag",
    "Handle",
    "LawParameters",
    "Operator",
    "ParameterError",
    "Parameters",
    "Stretch",
    "absolute_stability",
    "bounds",
    "coulomb_psi",
    "crossings",
    "delay_table",
    "describing_function",
    "draw_law",
    "felt_study",
    "figure_10",
    "fit_law",
    "frequency_response",
    "friction_study",
    "hold_study",
    "hulin_stiffness",
    "jenkins_psi",
    "karnopp_psi",
    "l1_bound",
    "largest_stiffness_damped",
    "law_benchmarks",
    "literature_curves",
    "orbits",
    "oscillation_map",
    "passive_disk",
    "ripple_limit",
    "settle",
    "spectral_radius",
    "stretches_of",
    "stribeck_psi",
    "stuck_spring",
    "write_fig10",
    "write_frequency_figures",
    "write_identification",
    "write_literature_figures",
    "write_orbit_figure",
    "z_width",
]

_PLACES = {
    "BrakeLag": "coulombus.analysis.theory.brake_lag",
    "Handle": "coulombus.analysis.theory.z_width",
    "LawParameters": "coulombus.analysis.theory.describing",
    "Operator": "coulombus.analysis.theory.operators",
    "ParameterError": "coulombus.analysis.theory.operators",
    "Parameters": "coulombus.analysis.theory.parameters",
    "Stretch": "coulombus.analysis.rig.law_search",
    "absolute_stability": "coulombus.analysis.theory.absolute",
    "bounds": "coulombus.analysis.theory.bounds",
    "coulomb_psi": "coulombus.analysis.theory.describing",
    "crossings": "coulombus.analysis.theory.crossings",
    "delay_table": "coulombus.analysis.theory.delay",
    "describing_function": "coulombus.analysis.theory.law_benchmarks",
    "draw_law": "coulombus.analysis.figures.law",
    "felt_study": "coulombus.analysis.rig.display_errors",
    "figure_10": "coulombus.analysis.theory.fig10",
    "fit_law": "coulombus.analysis.rig.law_fit",
    "frequency_response": "coulombus.analysis.theory.linear",
    "friction_study": "coulombus.analysis.rig.friction_study",
    "hold_study": "coulombus.analysis.rig.hold",
    "hulin_stiffness": "coulombus.analysis.theory.z_width",
    "jenkins_psi": "coulombus.analysis.theory.describing",
    "karnopp_psi": "coulombus.analysis.theory.describing",
    "l1_bound": "coulombus.analysis.theory.peak",
    "largest_stiffness_damped": "coulombus.analysis.theory.stuck_spring",
    "law_benchmarks": "coulombus.analysis.theory.law_benchmarks:benchmarks",
    "literature_curves": "coulombus.analysis.theory.published_curves",
    "orbits": "coulombus.analysis.theory.orbits",
    "oscillation_map": "coulombus.analysis.rig.maps",
    "passive_disk": "coulombus.analysis.theory.linear",
    "ripple_limit": "coulombus.analysis.theory.brake_lag",
    "settle": "coulombus.analysis.theory.relay_loop",
    "spectral_radius": "coulombus.analysis.theory.stuck_spring",
    "stretches_of": "coulombus.analysis.rig.law_fit",
    "stribeck_psi": "coulombus.analysis.theory.describing",
    "stuck_spring": "coulombus.analysis.theory.stuck_spring",
    "write_fig10": "coulombus.analysis.figures.time",
    "write_frequency_figures": "coulombus.analysis.figures.frequency",
    "write_identification": "coulombus.analysis.figures.rig",
    "write_literature_figures": "coulombus.analysis.figures.law",
    "write_orbit_figure": "coulombus.analysis.figures.time",
    "z_width": "coulombus.analysis.theory.z_width",
}

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
