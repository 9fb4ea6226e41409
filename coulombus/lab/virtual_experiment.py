"""An experiment in one call: a study in virtual time, answered by a simulated observer."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from coulombus.lab.study.displays import VirtualDisplays
from coulombus.lab.study.felt_torque import felt_of
from coulombus.lab.study.observer import Faults, Observer, levels
from coulombus.lab.study.session import People, Session, SubjectSession, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import SubjectFolder
from coulombus.rigs.arguments import path_text

__all__ = ["experiment"]


def experiment(
    study: str | os.PathLike[str],
    out: str | os.PathLike[str],
    subject: str,
    jnd: float,
    *,
    felt: bool = False,
    faults: Faults | None = None,
) -> Session:
    """Run a subject's session in virtual time, with a simulated observer.

    The same call continues a session that was interrupted.

    Parameters
    ----------
    study : the study's file
    out : the study's folder
    subject : letters and digits, as ``S01``
    jnd : the observer's just noticeable difference, in the unit of the level, in Nm with `felt`
    felt : the observer judges the recorded torque, and not the level
    faults : how the observer differs from an ideal one; None: not at all

    Raises
    ------
    coulombus.lab.study.study.StudyError
        the file has a mistake
    coulombus.lab.study.study_folder.StudyFolderError
        the folder is another study's, or cannot be written
    """
    plan = read_study(Path(path_text(study, "study", 'experiment("study.toml", "out", "S01", 0.15)')))
    place = Path(path_text(out, "out", 'experiment("study.toml", "out", "S01", 0.15)'))
    observer_text = f"simulated, JND {jnd:g}" + " Nm felt" * felt
    with SubjectFolder(plan, place, subject, {"observer": observer_text, "bus": "virtual time"}) as folder:
        judged = partial(felt_of, folder) if felt else levels
        observer = Observer(jnd, plan.file.seed, folder.number, judged, faults or Faults())
        return run_session(SubjectSession(folder, VirtualDisplays()), People.simulated(observer.answer))
