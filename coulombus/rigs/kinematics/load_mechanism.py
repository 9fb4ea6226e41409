"""Load and compile a rig's mechanism, built-in or user-defined.

A user-defined mechanism is a function of a Python file, ``kind = "arm.py:arm"``::

    def arm(m, pose):
        pose.x_m[0] = m.user[0] * pose.angle_rad[0]
        pose.x_m[1] = m.user[1] * pose.angle_rad[1]
        pose.jacobian[0, 0], pose.jacobian[0, 1] = m.user[0], 0.0
        pose.jacobian[1, 0], pose.jacobian[1, 1] = 0.0, m.user[1]

Numba must be able to compile it. The names of its fields are those of `MechanismRecord` and
`PoseRecord`.
"""

from __future__ import annotations

import importlib.util
import inspect
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.kernels.decorator import JIT_DISABLED, cacheable
from coulombus.kernels.records import RecordArray, dtype_of, new_records
from coulombus.rigs.kinematics.kinematics_section import Kinematics
from coulombus.rigs.kinematics.mechanisms import MECHANISMS, MechanismFunction, MechanismRecord, PoseRecord
from coulombus.rigs.kinematics.pose_kernels import locate

import numba  # isort: skip  (after kernels.decorator, which names the cache directory)
import numba.experimental.function_type  # isort: skip  (what the type of a compiled mechanism is)

__all__ = ["Mechanism", "MechanismMistake", "compile_mechanism", "load_mechanism"]

STEP_RAD = 1e-5
"""Half the step of the central differences that check a Jacobian."""
TOLERANCE = 1e-5
"""Allowed deviation of a Jacobian from its differences, relative to its largest entry."""
TRIES = 40
COLOURS = re.compile(r"\x1b\[[\d;]*m")
"""ANSI colours in numba's messages when colorama is installed."""


class MechanismMistake(Exception):
    """A user-defined mechanism cannot be used; the text has the line and the reason."""


@dataclass(frozen=True)
class Mechanism:
    """A compiled mechanism with its dimensions.

    Attributes
    ----------
    function : the compiled function, as kernels take it
    record : its dimensions, an array of one record
    """

    function: MechanismFunction
    record: RecordArray[MechanismRecord]

    def pose(self, q1_rad: float, q2_rad: float) -> PoseRecord:
        """Return the pose at two joint angles [rad]; NaN if unreachable."""
        pose = new_records(PoseRecord)[0]
        pose["q_rad"] = q1_rad, q2_rad
        locate(self.function, self.record[0], pose)
        return pose


class _MechanismPointer(numba.types.CompileResultWAP):  # type: ignore[misc]  # mypy follows no import of numba
    """A compiled mechanism as a function pointer of one signature."""

    def signature(self) -> Any:
        """Return the signature that every mechanism has."""
        return _signature()


@cache
def _signature() -> Any:
    return numba.void(numba.from_dtype(dtype_of(MechanismRecord)), numba.from_dtype(dtype_of(PoseRecord)))


def compile_mechanism(function: Callable[..., Any], *, guarded: bool) -> MechanismFunction:
    """Compile a mechanism's function, to be passed to kernels as a function pointer.

    With `guarded`, indices are checked, and a function that raises gives NaN.
    """

    def careful(m: MechanismRecord, pose: PoseRecord) -> None:
        try:
            inner(m, pose)
        except Exception:
            pose.x_m[0] = math.nan

    inner: Any = function
    if JIT_DISABLED:
        return careful if guarded else function
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    if guarded:
        inner = numba.njit(boundscheck=True, **options)(function)
        dispatcher = numba.njit(_signature(), **options)(careful)
    else:
        dispatcher = numba.njit(cache=cacheable(function), **options)(function)
        dispatcher.compile(_signature().args)
    pointer: MechanismFunction = _MechanismPointer(dispatcher.overloads[dispatcher.signatures[0]])
    return pointer


@cache
def _built_in(kind: str) -> MechanismFunction:
    return compile_mechanism(MECHANISMS[kind], guarded=False)


def load_mechanism(kinematics: Kinematics, directory: Path) -> Mechanism:
    """Return the compiled mechanism of a rig; its file is searched in `directory`, then in the current folder.

    Raises
    ------
    MechanismMistake
        a user-defined function is missing, does not compile, or has a Jacobian that does not match its kinematics
    """
    if kinematics.function is None:
        return Mechanism(_built_in(kinematics.kind.strip()), kinematics.record())
    plain = _function_of_file(*kinematics.function, directory)
    place = f"{plain.__code__.co_filename}:{plain.__code__.co_firstlineno}"
    try:
        mechanism = Mechanism(compile_mechanism(plain, guarded=True), kinematics.record())
    except Exception as error:  # numba raises many kinds
        raise MechanismMistake(f"{place}: it does not compile: {_first_sentence(error)}") from error
    mistake = _wrong_entry(mechanism, kinematics.start_rad)
    if mistake:
        raise MechanismMistake(f"{place}: {mistake}")
    return mechanism


def _first_sentence(error: Exception) -> str:
    lines = [line.strip() for line in COLOURS.sub("", str(error)).splitlines() if line.strip()]
    return next((line for line in lines if "pipeline" not in line), type(error).__name__)[:200]


def _function_of_file(file: str, name: str, directory: Path) -> Any:
    """Return the plain function `name` of a Python file."""
    tried = [directory / file, Path(file)]
    path = next((candidate for candidate in tried if candidate.is_file()), None)
    if path is None:
        raise MechanismMistake(f"there is no file {file}; looked for {', '.join(map(str, dict.fromkeys(tried)))}")
    spec = importlib.util.spec_from_file_location(f"coulombus_mechanism_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise MechanismMistake(f"{path}: cannot be imported: {type(error).__name__}: {error}") from error
    function = getattr(getattr(module, name, None), "py_func", getattr(module, name, None))
    if not inspect.isfunction(function):
        functions = [key for key, value in vars(module).items() if inspect.isfunction(value) and key[0] != "_"]
        raise MechanismMistake(f"{path} has no function '{name}'; it has {', '.join(functions) or 'none'}")
    if len(inspect.signature(function).parameters) != 2:
        place = f"{path}:{function.__code__.co_firstlineno}"
        raise MechanismMistake(f"{place}: a mechanism takes two arguments, (m, pose)")
    return function


def _wrong_entry(mechanism: Mechanism, start_rad: tuple[float, float]) -> str:
    """Return the entry of the Jacobian that does not match the kinematics, or ""."""
    random, names = np.random.default_rng(1), "xy"
    angles = [np.array(start_rad), *(np.array(start_rad) + random.uniform(-1.0, 1.0, (TRIES, 2)))]
    for k, q in enumerate(angles):
        pose = mechanism.pose(*q)
        if not (np.isfinite(pose["x_m"]).all() and np.isfinite(pose["jacobian"]).all()):
            if k == 0:
                return f"at kinematics.start_rad it gives no finite tip and Jacobian: x_m = {pose['x_m'].tolist()}"
            continue
        jacobian, scale = pose["jacobian"].copy(), float(np.abs(pose["jacobian"]).max())
        for i in range(2):
            step = STEP_RAD * np.eye(2)[i]
            difference = (mechanism.pose(*(q + step))["x_m"] - mechanism.pose(*(q - step))["x_m"]) / (2 * STEP_RAD)
            for row in range(2):
                off = abs(jacobian[row, i] - difference[row])
                if off > TOLERANCE * max(scale, float(np.abs(difference).max())):
                    return (
                        f"the Jacobian is not that of the kinematics: at q = ({q[0]:.3f}, {q[1]:.3f}) rad "
                        f"d{names[row]}/dq{i + 1} is {difference[row]:.6g} m/rad by central differences, "
                        f"and jacobian[{row}, {i}] gives {jacobian[row, i]:.6g}"
                    )
    return ""
