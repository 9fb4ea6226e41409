r"""Loading and compilation of friction laws, which are functions with a fixed signature.

The rig file names a law: ``karnopp``, ``lugre`` or another of `BUILTIN_LAWS`, each in a file of this
folder; ``file.py:function``; or ``module:function``. A law is a plain function::

    def my_law(motion, law, state):
        state.brake_Nm = law.F_d                      # set-point of the brake, >= 0
        return law.F_d * motion.v_rad_s / (abs(motion.v_rad_s) + 0.1)

motion : `MotionRecord`
    measured: angle, speed, speed in encoder counts a cycle, cycle time, handle torque
law : `LawRecord`
    parameters of the mode: K_p, F_s, F_d, the velocity band, and the law's named parameters
    (`host.laws.law.friction_law`); for a law without named parameters ``user``, 16 numbers of the rig file
state : `LawStateRecord`
    the law's state, kept from cycle to cycle, and its second output ``brake_Nm``
returns
    :math:`\psi` [Nm], the friction to be displayed: :math:`\psi > 0` opposes :math:`v > 0`. A motor
    displays :math:`-\psi`; a brake cannot push and gets ``state.brake_Nm`` instead.

Numba must be able to compile the function, and the function must not import anything. The compiled law is
passed as a function pointer, so the host's kernels are not compiled again for it. A user's law, and the
functions that it calls, are compiled with bounds checks: an index beyond an array raises as in Python, and
a law that raises trips.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import importlib.util
import inspect
import math
import re
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import cache, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from coulombus.host.laws.bliman_sorine import bliman_sorine
from coulombus.host.laws.coulomb import COULOMB, coulomb
from coulombus.host.laws.dahl import dahl
from coulombus.host.laws.detent import detent
from coulombus.host.laws.elastoplastic import elastoplastic
from coulombus.host.laws.gms import gms
from coulombus.host.laws.inertia import inertia
from coulombus.host.laws.karnopp import KARNOPP, karnopp
from coulombus.host.laws.kikuuwe import kikuuwe
from coulombus.host.laws.law import (
    LAW,
    LAW_STATE,
    MOTION,
    ON_AXIS,
    Declaration,
    LawFunction,
    LawKind,
    declaration_of,
)
from coulombus.host.laws.leuven import leuven
from coulombus.host.laws.lugre import lugre
from coulombus.host.laws.regularised import regularised
from coulombus.host.laws.stribeck import stribeck
from coulombus.host.laws.texture import texture
from coulombus.host.laws.viscous import viscous
from coulombus.host.laws.wall import wall
from coulombus.kernels.decorator import JIT_DISABLED, cacheable
from coulombus.system.errors import CoulombusError

import numba  # isort: skip  (after compiled.decorator, which names the cache directory)
import numba.experimental.function_type  # isort: skip  (defines the type of a compiled law)

__all__ = [
    "BUILTIN_LAWS",
    "LAW",
    "LAW_STATE",
    "MOTION",
    "LawError",
    "LoadedLaw",
    "coulomb",
    "find_law",
    "karnopp",
    "load_declared",
    "load_law",
]

OLD_PLACE = "host.laws"
"""Module prefix of built-in laws in earlier rig files."""

COLOURS = re.compile(r"\x1b\[[\d;]*m")
"""Colour codes in numba's messages, present with colorama."""

EXERCISES = "coulombus.host.laws.exercises"
"""The module of the exercises of commissioning, which are built in, too."""


class LawError(CoulombusError):
    """A law cannot be loaded; the text has its name, the reason and the expected form."""

    exit_status = 3


LAWS = (
    *(stribeck, regularised, dahl, lugre, elastoplastic, gms, leuven, bliman_sorine, kikuuwe),
    *(wall, detent, texture, viscous, inertia),
)
"""The laws with named parameters, each in a file of this folder."""

ON_AXIS.built_in.update((law.name, law) for law in (KARNOPP, COULOMB, *filter(None, map(declaration_of, LAWS))))
BUILTIN_LAWS: Mapping[str, Declaration] = MappingProxyType(ON_AXIS.built_in)
"""The built-in laws by their names. Only these run from a recording without `--law`."""


@lru_cache(64)
def _signature(kind: LawKind, declared: Declaration | None = None) -> Any:
    """Return the signature of a law of this kind; with a declaration, its names are in the records."""
    named = (kind.law, kind.state) if declared is None else (declared.law_dtype, declared.state_dtype)
    returned = numba.float64 if kind.returns == 1 else numba.types.UniTuple(numba.float64, kind.returns)
    return returned(*map(numba.from_dtype, (kind.motion, *named)))


class _Pointer(numba.types.CompileResultWAP):  # type: ignore[misc]  # mypy follows no import of numba
    """A compiled law as a function pointer with the common signature.

    A record is passed as a pointer, so its names do not matter.
    """

    def __init__(self, compiled: Any, kind: LawKind) -> None:
        self._kind = kind
        super().__init__(compiled)

    def signature(self) -> Any:
        """Return the common signature of all laws of this kind."""
        return _signature(self._kind)


_CHECKING = threading.Lock()


@contextmanager
def _bounds_checked() -> Iterator[None]:
    """Compile with bounds checks inside this context, also functions with a decorator of their own."""
    with _CHECKING:
        before = numba.config.BOUNDSCHECK
        numba.config.BOUNDSCHECK = 1
        try:
            yield
        finally:
            numba.config.BOUNDSCHECK = before


def compile_law(function: Callable[..., Any], cache: bool = False, kind: LawKind = ON_AXIS) -> Any:
    """Compile `function` with the signature of a law of `kind`; return a function pointer for kernels.

    A law that raises returns NaN, which trips; an index beyond an array's ends raises. Only built-in laws
    are cached, because the cache would not notice a change in a module that a law imports. They are
    compiled without these checks, which they do not need.
    """
    declared = declaration_of(function)
    if JIT_DISABLED:
        return _guarded(function if declared is None else declared.plain(), kind)
    signature = _signature(kind, declared)
    options = {"nogil": True, "error_model": "numpy"}
    if cache:
        dispatcher = numba.njit(cache=cacheable(function), **options)(function)
        dispatcher.compile(signature.args)
    else:
        with _bounds_checked():
            inner = numba.njit(**options)(function)
            inner.compile(signature.args)
            _check_returned(inner.nopython_signatures[0].return_type, kind)
            dispatcher = numba.njit(signature, **options)(_guarded(inner, kind))
    return _Pointer(dispatcher.overloads[dispatcher.signatures[0]], kind)


def _guarded(inner: Any, kind: LawKind) -> Any:
    """Return a law that returns NaN where `inner` raises."""

    def on_axis(motion: Any, law: Any, state: Any) -> float:
        try:
            psi_Nm: float = inner(motion, law, state)
            return psi_Nm
        except Exception:
            return math.nan

    def in_plane(motion: Any, law: Any, state: Any) -> tuple[float, float]:
        try:
            fx, fy = inner(motion, law, state)
            return float(fx), float(fy)
        except Exception:
            return math.nan, math.nan

    return on_axis if kind.returns == 1 else in_plane


def _check_returned(returned: Any, kind: LawKind) -> None:
    """Refuse a law whose compiled function returns a value of another type."""
    if kind.returns == 1:
        if not isinstance(returned, numba.types.Float | numba.types.Integer | numba.types.Boolean):
            name = str(returned).partition("(")[0]
            raise TypeError(f"a law returns a number, psi [Nm], on every path; what this one returns is {name}")
    elif not (isinstance(returned, numba.types.BaseTuple) and len(returned) == kind.returns):
        raise TypeError(f"a law in the plane returns two numbers, psi [N], on every path, not {returned}")


def _line(function: Any, line: int | None = None) -> str:
    """Return the place of `function`, or of a line of its file, as ``file:line``."""
    code = function.__code__
    return f"{code.co_filename}:{line or code.co_firstlineno}"


def _unknown_field(function: Any, name: str, kind: LawKind) -> str | None:
    """Return the place at which a law uses a field that its records lack; None if it is not found."""
    try:
        tree = ast.parse(Path(function.__code__.co_filename).read_text(encoding="utf-8"))
    except (OSError, ValueError, SyntaxError):
        return None
    declared = declaration_of(function)
    named = (kind.law, kind.state) if declared is None else (declared.law_dtype, declared.state_dtype)
    arguments = dict(zip(inspect.signature(function).parameters, (kind.motion, *named), strict=False))
    uses = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == name]
    if not uses:
        return None
    first = function.__code__.co_firstlineno
    use = min(uses, key=lambda node: (node.lineno < first, node.lineno))
    record = ast.unparse(use.value)
    fields = (arguments[record].names if record in arguments else None) or ()
    near = difflib.get_close_matches(name, fields, 1)
    has = f"; it has {', '.join(fields)}" if fields else ""
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"{_line(function, use.lineno)}: {record} has no field '{name}'{has}{hint}"


def _why_not(function: Any, error: Exception, kind: LawKind) -> str:
    """Return the reason why `function` does not compile: the user's ``file:line``, and a sentence."""
    if (
        isinstance(error, KeyError) and error.args and isinstance(error.args[0], str)
    ):  # numba: no such field in a record
        unknown = _unknown_field(function, error.args[0], kind)
        if unknown:
            return unknown
    text = COLOURS.sub("", str(error))
    lines = [line.strip() for line in text.splitlines()]
    first = next((i for i, line in enumerate(lines) if line and "pipeline" not in line), 0)
    sentence: list[str] = []
    for line in lines[first:]:
        if line.startswith(("There are", "During:", "File ")) or (
            sentence and not line and not sentence[-1].endswith(":")
        ):
            break
        if line:
            sentence.append(line.removeprefix(">>> "))
    reason = " ".join(sentence).partition(" Raised from ")[0].rstrip(".") or type(error).__name__
    if "<class 'function'>" in reason:
        reason += " (a function that a law calls needs numba.njit's decorator)"
    place = getattr(error, "loc", None)
    if place is not None and place.filename == function.__code__.co_filename:
        return f"{_line(function, place.line)}: {reason}"
    return f"{place.filename}:{place.line}: {reason}" if place is not None else f"{_line(function)}: {reason}"


def _import_error(error: Exception, place: str) -> str:
    """Return the text of an error in a law's file: its type, its message, and the file's line."""
    if isinstance(error, SyntaxError):
        return str(error)  # its text has file and line
    reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.endswith(Path(place).name)]
    return f"{reason} ({place}, line {frames[-1].lineno})" if frames else reason


def find_law(place: str, directory: Path | None) -> Path:
    """Return the law's file in the rig file's folder, else in the current folder, as for EDS files."""
    tried = [folder / place for folder in (directory, Path()) if folder is not None]
    path = next((candidate for candidate in tried if candidate.is_file()), None)
    if path is None:
        raise LawError(f"there is no file {place}; looked for {', '.join(map(str, tried))}")
    return path


class LoadedLaw(NamedTuple):
    """A compiled law with its declaration."""

    pointer: Callable[..., Any]
    """The compiled function for kernels."""
    declaration: Declaration | None
    """Its named parameters; None for a law without any."""


def load_law(name: str, directory: Path | None = None) -> LawFunction:
    """Return the compiled law called `name`: one of `BUILTIN_LAWS`, ``file.py:function`` in `directory`
    or the current folder, or ``module:function``.

    Raises
    ------
    LawError
        the module, file or function does not exist, or it does not compile with a law's signature
    """
    return load_declared(name, directory).pointer


def load_declared(name: str, directory: Path | None = None, kind: LawKind = ON_AXIS) -> LoadedLaw:
    """Return the compiled law of `kind` called `name`, as `load_law` does, with its declaration."""
    place, _, attribute = name.rpartition(":")
    alike = difflib.get_close_matches(attribute, kind.built_in, 1)
    if place == OLD_PLACE and alike:
        raise LawError(f"law {name!r} is an old name; the law is called {alike[0]!r} now")
    if not place and attribute in kind.built_in:
        declared: Declaration | None = kind.built_in[attribute]
        return LoadedLaw(_built_in(kind.built_in[attribute]), declared)
    if name.endswith(".py"):
        raise LawError(f"law {name!r}: name the function: {name}:NAME")
    if not place or not attribute:
        hint = f"; did you mean {alike[0]!r}?" if alike else ""
        names = ", ".join(map(repr, kind.built_in))
        raise LawError(f"law {name!r}: expected {names}, 'file.py:function' or 'module:function'{hint}")
    own_law = place in (__name__, EXERCISES)
    plain = _plain_function(name, place, attribute, directory, own_law=own_law)
    declared = next((law for law in kind.built_in.values() if law.function is plain), declaration_of(plain))
    if declared is not None and declared.kind is not kind:
        raise LawError(f"law {name!r} is declared for {declared.kind.place}; expected the decorator {kind.decorator}")
    return LoadedLaw(_compiled(name, plain, kind, own_law=own_law), declared)


@cache
def _built_in(law: Declaration) -> LawFunction:
    """Return a built-in law, compiled; it has no state of its own, so a process loads it once."""
    return _compiled(law.name, law.function, law.kind, own_law=True)


def _plain_function(name: str, place: str, attribute: str, directory: Path | None, *, own_law: bool) -> Any:
    """Return the plain Python function of the law `name`."""
    checked = (
        nullcontext() if own_law or JIT_DISABLED else _bounds_checked()
    )  # a decorator with a signature compiles at once
    try:
        if place.endswith(".py"):
            path = find_law(place, directory)
            spec = importlib.util.spec_from_file_location(f"coulombus_law_{path.stem}", path)
            if spec is None or spec.loader is None:
                raise LawError(f"law {name!r}: {path} is not a Python file")
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module
            with checked:
                spec.loader.exec_module(module)
        else:
            with checked:
                module = importlib.import_module(place)
    except LawError as error:
        raise LawError(f"law {name!r}: {error}") from None
    except Exception as error:
        if isinstance(error, (CoulombusError, MemoryError)):  # an interruption, not an error of the law
            raise
        if isinstance(error, ModuleNotFoundError) and place.startswith(error.name or place):
            text = "there is no module of that name; expected FILE.py:FUNCTION or MODULE:FUNCTION"
            raise LawError(f"law {name!r}: {place} cannot be imported: {text}") from error
        raise LawError(f"law {name!r}: {place} cannot be imported: {_import_error(error, place)}") from error
    functions = {
        n: f for n, f in vars(module).items() if callable(f) and getattr(f, "__module__", "") == module.__name__
    }
    function = functions.get(attribute, getattr(module, attribute, None))
    if not callable(function):
        public = [n for n, f in functions.items() if not n.startswith("_") and not isinstance(f, type)]
        near = difflib.get_close_matches(attribute, public, 1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise LawError(
            f"law {name!r}: {place} has no function {attribute!r}; it has {', '.join(public) or 'none'}{hint}"
        )
    plain = getattr(function, "py_func", function)
    try:
        accepts = list(inspect.signature(plain).parameters.values())
    except (TypeError, ValueError):
        accepts = []
    if len(accepts) != 3 or not hasattr(plain, "__code__"):
        where = f"{_line(plain)}: " if hasattr(plain, "__code__") else ""
        arguments = ", ".join(map(str, accepts))
        raise LawError(
            f"law {name!r}: {where}a law takes three arguments, (motion, law, state); this one takes ({arguments})"
        )
    return plain


def _compiled(name: str, plain: Any, kind: LawKind, *, own_law: bool) -> LawFunction:
    try:
        law: LawFunction = compile_law(plain, own_law, kind)
        return law
    except Exception as error:  # numba raises many kinds
        if isinstance(error, (CoulombusError, MemoryError)):
            raise
        raise LawError(f"law {name!r} does not compile: {_why_not(plain, error, kind)}; see {kind.page}") from error
