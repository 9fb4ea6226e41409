"""Checks of the installed software: versions, and other packages or commands named `coulombus`."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path

from coulombus.host.doctor.checks import Check, Outcome

__all__ = ["NAME", "checks", "compiled", "requirement_met"]

NAME = "coulombus"
_PLACE = "name a directory that this user can write: export NUMBA_CACHE_DIR=DIRECTORY"
_REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)\s*(\[[^]]*\])?\s*\(?([^;)]*)\)?\s*(;.*)?$")
_BOUND = re.compile(r"\s*(>=|<=|==|!=|~=|>|<)\s*([0-9][0-9a-zA-Z.*+!]*)\s*$")


def checks(
    path: Sequence[str] | None = None, programs: Sequence[str] | None = None, package: Path | None = None
) -> list[Check]:
    """Return the checks of the installed software.

    Parameters
    ----------
    path, programs : search paths of modules and programs; default are those of this process
    package : the package's folder; default is the folder of this package
    """
    modules = sys.path if path is None else path
    folders = os.environ.get("PATH", "").split(os.pathsep) if programs is None else programs
    here = Path(__file__).resolve().parents[2] / NAME if package is None else package
    return [
        ("software.versions", versions),
        ("software.import_name", partial(import_name, modules, here)),
        ("software.script_name", partial(script_name, folders, Path(sys.prefix))),
        ("software.compiled", compiled),
    ]


def _numbers(text: str) -> tuple[int, ...]:
    match = re.match(r"\d+(\.\d+)*", text)
    return tuple(map(int, match[0].split("."))) if match else ()


def requirement_met(bounds: str, version: str) -> bool:
    """Return whether a version is within bounds such as ``>=1.2,<3``; other kinds of bounds are ignored."""
    have = _numbers(version)
    for text in filter(None, bounds.split(",")):
        match = _BOUND.match(text)
        if match is None:
            continue
        kind, limit = match[1], _numbers(match[2])
        size = max(len(have), len(limit))
        a, b = (numbers + (0,) * (size - len(numbers)) for numbers in (have, limit))
        if (kind == ">=" and a < b) or (kind == "<" and a >= b) or (kind == "<=" and a > b) or (kind == ">" and a <= b):
            return False
    return True


def versions(
    requires: Callable[[str], list[str] | None] = metadata.requires, version: Callable[[str], str] = metadata.version
) -> Outcome:
    """Check that all dependencies are installed in a supported version."""
    try:
        needed = requires(NAME) or []
        names = [f"{NAME} {version(NAME)}", f"Python {platform.python_version()}"]
    except metadata.PackageNotFoundError:
        return Outcome(False, f"{NAME} is not installed, only found", f"{sys.executable} -m pip install . in the clone")
    mismatches = []
    for text in needed:
        match = _REQUIREMENT.match(text)
        if match is None or (match[4] and "extra" in match[4]):
            continue
        try:
            have = version(match[1])
        except metadata.PackageNotFoundError:
            mismatches.append(f"{match[1]} is missing")
            continue
        names.append(f"{match[1]} {have}")
        if not requirement_met(match[3], have):
            mismatches.append(f"{match[1]} is {have}, expected {match[3].strip()}")
    if mismatches:
        return Outcome(False, "; ".join(mismatches), f"{sys.executable} -m pip install --upgrade . in the clone")
    return Outcome(True, ", ".join(names))


def import_name(path: Sequence[str], package: Path) -> Outcome:
    """Check that the module path has no other `coulombus`.

    A folder `coulombus` without `__init__.py` in the current folder, such as a clone, hides a package in
    editable mode, which is not found through the module path.
    """
    others = []
    clone = Path.cwd() / NAME
    hidden = package.parent.resolve() not in {Path(entry).resolve() for entry in path}
    if hidden and clone.is_dir() and not (clone / "__init__.py").is_file():
        others.append(str(clone))
    for entry in dict.fromkeys(path):
        folder = Path(entry or ".")
        for candidate in (folder / NAME / "__init__.py", folder / f"{NAME}.py"):
            place = candidate.parent if candidate.name == "__init__.py" else candidate
            if candidate.is_file() and place.resolve() != package.resolve():
                others.append(str(place))
    if not others:
        return Outcome(True, f"only {package}")
    fix = "# rename it, work in another folder, or take its folder out of PYTHONPATH: " + ", ".join(others)
    return Outcome(False, f"another {NAME} can be imported: {', '.join(others)}", fix)


def script_name(folders: Sequence[str], prefix: Path) -> Outcome:
    """Check that the shell's command `coulombus` is that of this environment."""
    scripts: list[Path] = []
    for folder in dict.fromkeys(filter(None, folders)):
        script = Path(folder) / NAME
        if (
            script.is_file()
            and os.access(script, os.X_OK)
            and script.resolve() not in (place.resolve() for place in scripts)
        ):
            scripts.append(script)
    command = prefix / "bin" / NAME
    if not scripts:
        return Outcome(True, f"not on PATH; call it as {command}")
    if scripts[0].resolve() == command.resolve():
        return Outcome(True, str(scripts[0]))
    fix = f". {prefix}/bin/activate  # in each terminal, or: hash -r; export PATH={prefix}/bin:$PATH"
    return Outcome(False, f"the shell takes {scripts[0]}, not {command}", fix)


def compiled() -> Outcome:
    """Check that the host's code is compiled: otherwise the first start takes a minute."""
    from coulombus.kernels.decorator import CACHE_DIR, is_warm

    if is_warm():
        return Outcome(True, f"kept in {CACHE_DIR}")
    if is_warm("run"):
        what = "for an arm in the plane" if is_warm("simulate") else "for virtual time and an arm in the plane"
        return Outcome(True, f"kept in {CACHE_DIR}; {what}: {NAME} warm-up")
    if CACHE_DIR is None:
        return Outcome(False, "every start compiles: no directory for compiled code can be written", f"# {_PLACE}")
    return Outcome(False, f"not all code is in {CACHE_DIR}: the first start compiles", f"{NAME} warm-up")
