"""The folder of a study, after BIDS: what is kept of each subject, so that nothing is lost.

::

    DIR/dataset_description.json        name of the study, version, the study's sum
    DIR/study.toml                      a copy of the study file
    DIR/participants.tsv, .json         a row for each subject; what its columns mean
    DIR/README, .bidsignore             what made the folder; what BIDS has no name for
    DIR/sub-S01/sub-S01_task-NAME_events.tsv    a row for each answered trial
    DIR/sub-S01/sub-S01_task-NAME_events.json   what the columns mean; each session: consent, version, bus
    DIR/sub-S01/recordings/trial-0001_display-1.pcapng

BIDS's validator ends without an error. NAME is the study's name without `_`, `-`, `.` and `=`, which a
task's label may not have; `TaskName` in the JSON file has the whole name.

A row is on the disk before the next trial begins. A row that a crash cut in two is taken off, and
its trial shown again.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from coulombus.lab.study.study import Study
from coulombus.lab.study.trials import Trial, Trials
from coulombus.recording.recorder import project_version
from coulombus.system.errors import CoulombusError
from coulombus.system.file_lock import lock_file
from coulombus.system.unfinished_file import remove_unfinished, write_whole

__all__ = ["COLUMNS", "StudyFolderError", "SubjectFolder", "read_events", "subjects_of"]

SUBJECT = re.compile(r"[A-Za-z0-9]{1,32}")
COLUMNS: Mapping[str, str] = {
    "onset": "when the trial's first display began, in s of what was displayed to the subject before",
    "duration": "length of the trial's displays [s]",
    "trial": "its number, from 1",
    "block": "its block, from 1",
    "condition": "name of the condition",
    "training": "1: a training trial, which no analysis counts",
    "level": "the level shown",
    "reference": "the level that it was compared with; n/a: none",
    "first": "in which display the level was, 1 or 2; 0: there was one display",
    "answer": "what the subject answered; n/a: nothing was asked",
    "response_time": "from the end of the last display to the answer [s]; n/a: it was not measured",
    "right": "1: the answer is the display of the level; n/a: nothing was compared",
}
"""Column of events.tsv -> what it means."""


SECONDS = ("onset", "duration", "response_time")
"""Columns in seconds, as BIDS has them."""
IGNORED = "study.toml\n**/recordings\n"
"""BIDS has no name for a study file or for recordings of a bus."""
README = """{name}: trials of a study, kept by coulombus.

sub-*/*_events.tsv has a row for each answered trial; the JSON file beside it says what the columns mean.
sub-*/recordings has the CAN frames of each display (pcapng). study.toml says what was shown.
Thresholds: coulombus analyse study FOLDER
"""


HEADER = "\t".join(COLUMNS) + "\n"
PARTICIPANTS: Mapping[str, str] = {
    "participant_id": "the subject",
    "number": "in which order the subjects came, from 0; orders and seeds follow from it",
}


class StudyFolderError(CoulombusError, ValueError):
    """The folder holds something else, or is in use; the text says what to do."""

    exit_status = 2


def _write(path: Path, text: str) -> None:
    try:
        write_whole(path, text.encode())
    except OSError as error:
        raise _full(path, error) from error


def _full(path: Path, error: OSError) -> StudyFolderError:
    return StudyFolderError(
        f"{path}: cannot be written ({error.strerror or error}); answers so far are kept, the last one perhaps not: "
        "make room, and give the same command to continue"
    )


def _json(values: Mapping[str, Any]) -> str:
    return json.dumps(values, indent=2, sort_keys=True) + "\n"


def _begun(path: Path, study: str) -> bool:
    """Tell whether a file is what a session leaves that was cut off before its folder was whole."""
    if path.name == "study.toml":
        return path.read_bytes() == study.encode()
    return path.name.startswith(".") or path.name in ("participants.tsv", "participants.json", "README")


def task_label(name: str) -> str:
    """Return a study's name as BIDS labels a task: letters and digits."""
    return re.sub(r"[^0-9A-Za-z]", "", name)


def subjects_of(folder: Path) -> list[str]:
    """Return the subjects of a folder in the order in which they came.

    Raises
    ------
    StudyFolderError
        it is the folder of no study
    """
    try:
        lines = (folder / "participants.tsv").read_text(encoding="utf-8").splitlines()[1:]
    except (OSError, UnicodeDecodeError):
        raise StudyFolderError(
            f"{folder}: holds no study (participants.tsv); expected a folder of coulombus experiment"
        ) from None
    return [line.split("\t")[0].removeprefix("sub-") for line in lines if line]


def read_events(path: Path) -> list[dict[str, str]]:
    """Return the whole rows of an events.tsv; a last line without its end is none.

    Raises
    ------
    StudyFolderError
        it has other columns
    """
    text = path.read_bytes().decode("utf-8", "replace")
    lines = text.split("\n")[:-1]
    if lines and lines[0].split("\t") != list(COLUMNS):
        raise StudyFolderError(
            f"{path}:1: other columns than {' '.join(COLUMNS)}; expected a file of coulombus experiment"
        )
    rows = []
    for number, line in enumerate(lines[1:], 2):
        cells = line.split("\t")
        if len(cells) != len(COLUMNS):
            raise StudyFolderError(
                f"{path}:{number}: {len(cells)} columns; expected {len(COLUMNS)}; correct or remove the row"
            )
        rows.append(dict(zip(COLUMNS, cells, strict=True)))
    return rows


class SubjectFolder:
    """What is kept of one subject; entered by one session at a time."""

    def __init__(self, study: Study, folder: Path, subject: str, meta: Mapping[str, str]) -> None:
        if not SUBJECT.fullmatch(subject):
            raise StudyFolderError(f"--subject {subject!r}: expected letters and digits, such as S01")
        self.study, self.folder, self.subject, self._meta = study, folder, subject, dict(meta)
        self.own = folder / f"sub-{subject}"
        self.events = self.own / f"sub-{subject}_task-{task_label(study.file.name)}_events.tsv"
        self.number = 0
        self.answered = 0
        self.onset_s = 0.0

    def __enter__(self) -> Self:
        """Make the folder, or open it again; nobody else writes into it meanwhile."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise StudyFolderError(
                f"{self.folder}: cannot be written ({error.strerror}); name another folder"
            ) from error
        try:
            try:
                lock_file(self._lock)
            except BlockingIOError:
                raise StudyFolderError(f"{self.folder}: another session writes there; wait for its end") from None
            for folder in (self.folder, self.own):
                remove_unfinished(folder)
            self._describe()
            self._take_part()
            (self.own / "recordings").mkdir(parents=True, exist_ok=True)
            self._sessions = [*self._earlier(), {**self._meta, "version": project_version()}]
            self._write_sidecar()
            if not self.events.exists():
                _write(self.events, HEADER)
        except BaseException:
            os.close(self._lock)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._lock)

    def _earlier(self) -> list[dict[str, str]]:
        try:
            sessions = json.loads(self.events.with_suffix(".json").read_text(encoding="utf-8"))["sessions"]
        except (OSError, ValueError, KeyError, TypeError):
            return []
        return [session for session in sessions if isinstance(session, dict)] if isinstance(sessions, list) else []

    def _write_sidecar(self) -> None:
        units = {column: {"Units": "s"} for column in SECONDS}
        sidecar: dict[str, Any] = {name: {"Description": text, **units.get(name, {})} for name, text in COLUMNS.items()}
        sidecar["TaskName"] = self.study.file.name
        sidecar["StimulusPresentation"] = {"SoftwareName": "coulombus", "SoftwareVersion": project_version()}
        sidecar["sessions"] = self._sessions
        _write(self.events.with_suffix(".json"), _json(sidecar))

    def note(self, key: str, text: str) -> None:
        """Keep something of this session: whether the consent was given."""
        self._sessions[-1][key] = text
        self._write_sidecar()

    def _describe(self) -> None:
        path = self.folder / "dataset_description.json"
        fingerprint = self.study.fingerprint()
        if path.exists():
            try:
                recorded = json.loads(path.read_text(encoding="utf-8"))["StudySHA256"]
            except (ValueError, KeyError, TypeError):
                recorded = None
            if recorded != fingerprint:
                raise StudyFolderError(
                    f"{self.folder}: holds another study (another file or rig); choose another folder"
                )
            return
        if any(not _begun(entry, self.study.text) for entry in self.folder.iterdir()):
            raise StudyFolderError(f"{self.folder}: holds something else; choose an empty folder")
        _write(self.folder / ".bidsignore", IGNORED)
        _write(self.folder / "README", README.format(name=self.study.file.name))
        _write(self.folder / "study.toml", self.study.text)
        _write(self.folder / "participants.tsv", "participant_id\tnumber\n")
        sidecar = {name: {"Description": text} for name, text in PARTICIPANTS.items()}
        _write(self.folder / "participants.json", _json(sidecar))
        values = {
            "Name": self.study.file.name,
            "BIDSVersion": "1.9.0",
            "DatasetType": "raw",
            "StudySHA256": fingerprint,
        }
        _write(path, _json({**values, "GeneratedBy": [{"Name": "coulombus", "Version": project_version()}]}))

    def _take_part(self) -> None:
        subjects = subjects_of(self.folder)
        if self.subject not in subjects:
            subjects.append(self.subject)
            rows = "".join(f"sub-{subject}\t{number}\n" for number, subject in enumerate(subjects))
            _write(self.folder / "participants.tsv", f"participant_id\tnumber\n{rows}")
        self.number = subjects.index(self.subject)

    def resumed(self) -> Trials:
        """Return the trials, those that are answered behind them.

        Raises
        ------
        StudyFolderError
            a row is not what the study shows there
        """
        rows = read_events(self.events)
        whole = self.events.read_bytes()
        if not whole.endswith(b"\n"):  # a power cut in the midst of a row, or of the head
            _write(self.events, (whole[: whole.rfind(b"\n") + 1] or HEADER.encode()).decode())
        trials = Trials(self.study, self.number)
        for number, row in enumerate(rows, 2):
            trial = trials.next()
            if trial is None or self._row(trial, row["answer"], row["response_time"]) != row:
                raise StudyFolderError(
                    f"{self.events}:{number}: is not the trial that the study shows there; restore the file"
                )
            self._next(trial)
            trials.answer(row["answer"])
        self.answered = len(rows)
        return trials

    def _next(self, trial: Trial) -> None:
        self.onset_s += len(trial.levels) * self.study.file.seconds

    def _row(self, trial: Trial, answer: str, response_time: str) -> dict[str, str]:
        return {
            "onset": f"{self.onset_s:g}",
            "duration": f"{len(trial.levels) * self.study.file.seconds:g}",
            "trial": str(trial.number),
            "block": str(trial.block),
            "condition": trial.condition.name,
            "training": str(int(trial.training)),
            "level": f"{trial.level!r}",
            "reference": "n/a" if trial.reference is None else f"{trial.reference!r}",
            "first": str(trial.first),
            "answer": answer,
            "response_time": response_time,
            "right": str(int(trial.right(answer))) if trial.first else "n/a",
        }

    def keep(self, trial: Trial, answer: str, seconds: float | None = None) -> None:
        """Append an answered trial; it is on the disk when this returns, or not there at all.

        Raises
        ------
        StudyFolderError
            the disk is full
        """
        row = self._row(trial, answer, "n/a" if seconds is None else f"{seconds:.3f}")
        before = self.events.stat().st_size
        try:
            with self.events.open("ab", buffering=0) as file:
                content = memoryview(("\t".join(row.values()) + "\n").encode())
                while content:
                    content = content[file.write(content) :]
                os.fsync(file.fileno())
        except OSError as error:
            with suppress(OSError):
                os.truncate(self.events, before)
            raise _full(self.events, error) from error
        self.answered = trial.number
        self._next(trial)

    def recording(self, trial: Trial, display: int) -> Path:
        """Return where a display is recorded."""
        return self.own / "recordings" / f"trial-{trial.number:04d}_display-{display}.pcapng"
