"""Host and virtual bus together: simulate, sweep, replay, demo, commission and experiment.

Its public names are imported when they are first used; docs/api.md lists them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from coulombus.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from coulombus.host.commission.step import Given
    from coulombus.lab.commissioning import Commissioned, commission
    from coulombus.lab.study.observer import Faults
    from coulombus.lab.study.results.report import report as study_report
    from coulombus.lab.study.study import read_study
    from coulombus.lab.sweep.rates import clopper_pearson
    from coulombus.lab.sweep.sweep import run_sweep
    from coulombus.lab.sweep.sweep_file import read_sweep
    from coulombus.lab.virtual_experiment import experiment

__all__ = [
    "Commissioned",
    "Faults",
    "Given",
    "clopper_pearson",
    "commission",
    "experiment",
    "read_study",
    "read_sweep",
    "run_sweep",
    "study_report",
]

_PLACES = {
    "Commissioned": "coulombus.lab.commissioning",
    "Faults": "coulombus.lab.study.observer",
    "Given": "coulombus.host.commission.step",
    "clopper_pearson": "coulombus.lab.sweep.rates",
    "commission": "coulombus.lab.commissioning",
    "experiment": "coulombus.lab.virtual_experiment",
    "read_study": "coulombus.lab.study.study",
    "read_sweep": "coulombus.lab.sweep.sweep_file",
    "run_sweep": "coulombus.lab.sweep.sweep",
    "study_report": "coulombus.lab.study.results.report:report",
}

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
