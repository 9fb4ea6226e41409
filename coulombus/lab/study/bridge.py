"""A study for a program that has its own screen and keys, such as a PsychoPy script.

::

    from coulombus.lab.study.bridge import open_session

    with open_session("study.toml", "out/study", "S01", bus="socketcan:can0") as session:
        for trial in session:                        # those that are left
            for number in range(1, len(trial.levels) + 1):
                session.show(number)                 # returns when the display has safely ended
            session.answer("1", seconds=0.8)         # on the disk when it returns

The study's file has conditions, levels, method and order, and the folder is that of
``coulombus experiment``: a session may begin here and go on there.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from coulombus.lab.study.displays import BusDisplays, Displays, VirtualDisplays
from coulombus.lab.study.lsl import LslMarkers, LslSignals
from coulombus.lab.study.session import Ended, SubjectSession, WrongStep
from coulombus.lab.study.study import StudyError, read_study
from coulombus.lab.study.study_folder import StudyFolderError, SubjectFolder
from coulombus.lab.study.trials import Trial
from coulombus.wire.address import parse_address

__all__ = ["Ended", "StudyError", "StudyFolderError", "SubjectSession", "Trial", "WrongStep", "open_session"]


@contextmanager
def open_session(
    study: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    subject: str,
    *,
    bus: str | None = None,
    lsl: bool = False,
) -> Iterator[SubjectSession]:
    """Yield a subject's session, behind the last answer that is kept.

    Parameters
    ----------
    study : the study file
    folder : where the study is kept
    subject : letters and digits, as S01
    bus : where the rig is, as ``--bus`` takes it; None: in virtual time, on the simulated rig
    lsl : send markers and signals by the lab streaming layer

    Raises
    ------
    StudyError
        the study file has a mistake
    StudyFolderError
        the folder holds another study, or is in use
    """
    checked = read_study(Path(study))
    displays: Displays = VirtualDisplays() if bus is None else BusDisplays(parse_address(bus))
    meta = {"bus": "virtual time" if bus is None else bus, "observer": "a program"}
    with SubjectFolder(checked, Path(folder), subject, meta) as subject_folder:
        session = SubjectSession(
            subject_folder, displays, *((LslMarkers(subject_folder), LslSignals(subject_folder)) if lsl else ())
        )
        try:
            yield session
        finally:
            session.stop()
