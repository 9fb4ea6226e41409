"""The report of a study's folder: each subject, each condition, and all subjects."""

from __future__ import annotations

import importlib
import math
import os
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from coulombus.lab.study.felt_torque import felt_Nm
from coulombus.lab.study.results.exploration import Exploration, explored, mean_of
from coulombus.lab.study.results.felt_fit import fit_felt
from coulombus.lab.study.results.fit import LEAST_TRIALS, fit_answers, fit_magnitudes
from coulombus.lab.study.results.hierarchy import hierarchical
from coulombus.lab.study.results.posterior import Posterior
from coulombus.lab.study.results.staircase import staircases
from coulombus.lab.study.study_folder import StudyFolderError, read_events, subjects_of
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.rigs.field_help import unit_of, without_unit

__all__ = ["report"]

BAND_LEVELS = 41
"""Levels at which the band of a psychometric function is computed."""
OPTIMISERS = ("bfgs", "lbfgs", "powell")
"""One after the other, until one converges; the last needs no slope."""


def report(folder: str | os.PathLike[str], *, exploration: bool = False, felt: bool = False) -> dict[str, Any]:
    """Return what the answers of a folder come to, as plain values for JSON.

    How the hands explored is read from the recordings where nothing was asked, and everywhere where
    `exploration` is set. With `felt` each fit is made of the torque that was felt, too.

    Training is left out. Fewer than `LEAST_TRIALS` answers are not fitted. Thresholds over the subjects
    are a geometric mean with the interval of Student's t of their logarithms; a subject without a fit,
    or whose answers bound its JND on one side only, is left out of it and named. The hierarchical fit
    is of the answers of all that have a fit. Of two subjects and two conditions or more there is a
    mixed model, log JND by condition with a random intercept for each subject, where statsmodels is
    installed; it has the subjects of the mean.

    Raises
    ------
    StudyFolderError
        it is the folder of no study, or a file of it cannot be used
    coulombus.lab.study.felt_torque.FeltError
        with `felt`: a recording does not tell what the hand felt
    """
    folder = Path(folder)
    study = _study_of(folder)
    posteriors: dict[tuple[str, str], Posterior] = {}
    subjects = {
        subject: _subject(folder, subject, study["kind"], (exploration, felt), posteriors)
        for subject in subjects_of(folder)
    }
    names = list(dict.fromkeys(name for subject in subjects.values() for name in subject))
    conditions = {name: _over(name, subjects, posteriors) for name in names}
    model, why_not = _mixed(subjects)
    return {
        "study": study["name"],
        "level": study["level"],
        "subjects": subjects,
        "conditions": conditions,
        "mixed_model": model,
        "no_mixed_model": why_not,
    }


def _subject(
    folder: Path,
    subject: str,
    kind: str | None,
    from_recordings: tuple[bool, bool],
    posteriors: dict[tuple[str, str], Posterior],
) -> dict[str, Any]:
    """Return the conditions of a subject; `from_recordings`: how the hand explored, what it felt."""
    exploration, felt = from_recordings
    recordings = folder / f"sub-{subject}" / "recordings"
    paths = sorted((folder / f"sub-{subject}").glob(f"sub-{subject}_task-*_events.tsv"))
    rows: list[dict[str, str]] = []
    for path in paths:
        rows += read_events(path)
        try:
            for row in rows:
                _check_numbers(row)
        except ValueError as error:
            raise StudyFolderError(f"{path}: a cell is not a number ({error}); correct or remove the row") from None
    counted = [row for row in rows if row["training"] == "0"]
    names = dict.fromkeys(row["condition"] for row in counted)
    conditions = {}
    for name in names:
        of_condition = [row for row in counted if row["condition"] == name]
        conditions[name], posterior = _condition(of_condition, kind)
        if posterior is not None:
            posteriors[subject, name] = posterior
        if exploration or all(row["answer"] == "n/a" for row in of_condition):
            conditions[name]["exploration"] = _explored(recordings, of_condition)
        if felt and conditions[name]["fit"] is not None:
            conditions[name]["felt"] = _felt(recordings, of_condition)
    return conditions


def _study_of(folder: Path) -> dict[str, Any]:
    """Return of the study's copy its name, its method, and what the level is: a quantity and its
    unit. What cannot be read is None, of the level "".
    """
    head: dict[str, Any] = {"name": None, "kind": None, "level": {"quantity": "", "unit": ""}}
    try:
        study = tomllib.loads((folder / "study.toml").read_text(encoding="utf-8"))
        shares = {key: abs(float(share)) for key, share in study["level"].items()}
        # the level itself, if it is set
        level_key = max(shares, key=lambda key: -abs(shares[key] - 1.0)).rpartition(".")[2]
        head |= {"name": str(study["name"]), "kind": str(study["method"]["kind"])}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return head
    return head | {"level": {"quantity": without_unit(level_key), "unit": unit_of(level_key)}}


def _explored(recordings: Path, rows: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    """Return the mean figures of the displays of each level."""
    by_level: dict[str, list[Exploration]] = {}
    for row in rows:
        path = _recording(recordings, row, max(int(row["first"]), 1))
        try:
            display = explored(path)
        except (OSError, RecordingError) as error:
            raise StudyFolderError(
                f"{path}: cannot be read ({error}); restore it, or leave --exploration out"
            ) from None
        if display is not None:
            by_level.setdefault(f"{float(row['level']):g}", []).append(display)
    levels = sorted(by_level, key=float)
    return {level: {"displays": len(by_level[level]), **mean_of(by_level[level]).as_dict()} for level in levels}


def _recording(recordings: Path, row: Mapping[str, str], display: int) -> Path:
    return recordings / f"trial-{int(row['trial']):04d}_display-{display}.pcapng"


def _felt(recordings: Path, rows: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    """Return the fit of comparisons in the torque that was felt."""
    answered = [row for row in rows if row["answer"] != "n/a"]
    felt = []
    for row in answered:
        first = int(row["first"])
        for display in (first, 3 - first):
            path = _recording(recordings, row, display)
            try:
                felt.append(felt_Nm(path))
            except (OSError, RecordingError) as error:
                raise StudyFolderError(f"{path}: cannot be read ({error}); restore it, or leave --felt out") from None
    levels, reference = [float(row["level"]) for row in answered], float(answered[0]["reference"])
    larger = [row["answer"] == row["first"] for row in answered]
    return fit_felt(levels, felt, larger, reference, [row["first"] == "2" for row in answered]).as_dict()


def _check_numbers(row: Mapping[str, str]) -> None:
    _ = float(row["level"]), int(row["first"]), int(row["trial"])
    if row["reference"] != "n/a":
        float(row["reference"])
    elif row["answer"] != "n/a":
        float(row["answer"])


def _condition(rows: Sequence[Mapping[str, str]], kind: str | None) -> tuple[dict[str, Any], Posterior | None]:
    """Return the fit of one subject in one condition, with the answers that it is of, and its posterior."""
    result: dict[str, Any] = {"trials": len(rows), "fit": None, "no_fit": None, "magnitudes": None, "levels": {}}
    result |= {"staircase": None, "exploration": None, "track": None, "band_95": None, "felt": None}
    answered = [row for row in rows if row["answer"] != "n/a"]
    if not answered:
        return result | {"no_fit": "nothing was asked"}, None
    levels = [float(row["level"]) for row in answered]
    if answered[0]["reference"] == "n/a":
        magnitudes = fit_magnitudes(levels, [float(row["answer"]) for row in answered])
        track = [[x, float(row["answer"])] for x, row in zip(levels, answered, strict=True)]
        result |= {"magnitudes": None if magnitudes is None else magnitudes.as_dict(), "track": track}
        return result | {"no_fit": "nothing was compared"}, None
    reference = float(answered[0]["reference"])
    larger = [row["answer"] == row["first"] for row in answered]
    if kind in ("staircase", "quest"):
        right = [took if x >= reference else not took for x, took in zip(levels, larger, strict=True)]
        result["track"] = [[x, int(answer)] for x, answer in zip(levels, right, strict=True)]
        result["staircase"] = staircases(levels, larger, reference) if kind == "staircase" else None
    for level in sorted(set(levels)):
        took = [answer for x, answer in zip(levels, larger, strict=True) if x == level]
        result["levels"][f"{level:g}"] = [sum(took), len(took)]
    if len(answered) < LEAST_TRIALS:
        return result | {"no_fit": f"{len(answered)} answers; a fit needs {LEAST_TRIALS}"}, None
    try:
        fit, posterior = fit_answers(levels, larger, reference, [row["first"] == "2" for row in answered])
    except ValueError as error:
        return result | {"no_fit": str(error)}, None
    x = np.linspace(min(levels), max(levels), BAND_LEVELS)
    low_high = posterior.chance_at(x - reference, (0.025, 0.975))
    band = {"level": x.tolist(), "low": low_high[:, 0].tolist(), "high": low_high[:, 1].tolist()}
    return result | {"fit": fit.as_dict(), "band_95": band}, posterior


def _out_of_mean(condition: Mapping[str, Any] | None) -> str | None:
    """Return why a subject's threshold does not enter a mean; None: it does."""
    if condition is None:
        return "no trial"
    if condition["fit"] is None:
        return str(condition.get("no_fit"))
    if None in condition["fit"].get("jnd_95", ()):
        return "its answers bound the JND on one side only, or on none"
    return None


def _over(
    name: str, subjects: Mapping[str, Mapping[str, Any]], posteriors: Mapping[tuple[str, str], Posterior]
) -> dict[str, Any]:
    """Return the thresholds of a condition over its subjects; `subjects` counts those of the mean."""
    why = {subject: _out_of_mean(conditions.get(name)) for subject, conditions in subjects.items()}
    jnds = [subjects[subject][name]["fit"]["jnd"] for subject, reason in why.items() if reason is None]
    summary: dict[str, Any] = {"subjects": len(jnds), "jnd": None, "jnd_95": None}
    summary["left_out"] = {subject: reason for subject, reason in why.items() if reason is not None}
    if jnds:
        logs = np.log(jnds)
        summary["jnd"] = float(np.exp(logs.mean()))
        if len(jnds) > 1:
            half = float(student.ppf(0.975, len(jnds) - 1) * logs.std(ddof=1)) / math.sqrt(len(jnds))
            summary["jnd_95"] = [float(np.exp(logs.mean() - half)), float(np.exp(logs.mean() + half))]
    group = hierarchical({subject: posteriors[subject, name] for subject in subjects if (subject, name) in posteriors})
    return summary | {"hierarchical": None if group is None else group.as_dict()}


def _mixed(subjects: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, Any] | None, str | None]:
    """Return the mixed model's effects against the first condition, or why there is none.

    The intervals are Student's t of what is left within the subjects: statsmodels' normal ones hold
    the truth in 86 of 100 studies of six subjects.
    """
    rows = [
        (subject, name, math.log(condition["fit"]["jnd"]))
        for subject, conditions in subjects.items()
        for name, condition in conditions.items()
        if _out_of_mean(condition) is None
    ]
    names = list(dict.fromkeys(name for _, name, _ in rows))
    count = len({subject for subject, _, _ in rows})
    free = len(rows) - count - (len(names) - 1)
    if count < 2 or len(names) < 2 or free < 1 or len(rows) < len(names) + 3:
        return None, "a mixed model needs two subjects and two conditions, and three thresholds more than conditions"
    try:
        models: Any = importlib.import_module("statsmodels.regression.mixed_linear_model")
    except ImportError:
        return None, "a mixed model needs statsmodels: pip install -e '.[study]' in the clone"
    design = np.array([[1.0, *(float(name == other) for other in names[1:])] for _, name, _ in rows])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of subjects that are all alike their variance is 0, an end of its range
            fitted = models.MixedLM(
                np.array([jnd for _, _, jnd in rows]), design, groups=np.array([subject for subject, _, _ in rows])
            ).fit(reml=True, method=OPTIMISERS)
            half = float(student.ppf(0.975, free)) * np.asarray(fitted.bse_fe)
    except (np.linalg.LinAlgError, ValueError) as error:
        return None, f"the mixed model cannot be fitted: {error}"
    if not np.all(np.isfinite(half)):
        return None, "the mixed model cannot be fitted: the thresholds tell no variance"
    effects = {
        name: {
            "ratio": float(np.exp(fitted.params[k])),
            "ratio_95": [float(np.exp(fitted.params[k] + side * half[k])) for side in (-1, 1)],
        }
        for k, name in enumerate(names)
        if k
    }
    return {"against": names[0], "subjects": count, "jnd_ratio": effects}, None
