"""Which source files a kernel depends on: its own, and those that it imports from this project, and
so on.

Numba's disk cache looks at the file of the function that it compiles, not at the files of the
functions which that one calls: an edited callee would be served stale. So what is kept of a kernel
carries the hash of all these files (`stamp`), and all of a state of the sources stands in a
directory of its own (`source_key`). Imports are read from the text, wherever they stand: a
docstring that shows one costs a compilation too many, never one too few.
"""

from __future__ import annotations

import hashlib
import re
import sys
from functools import cache
from pathlib import Path

import numpy as np

__all__ = ["KERNEL_PACKAGES", "ROOT", "ours", "source_key", "stamp"]

KERNEL_PACKAGES = ("compiled", "wire", "eds", "rigs", "recording", "node", "host", "sim_bus", "lab", "analysis")

ROOT = Path(__file__).resolve().parent.parent
"""The folder of the packages."""

_VERSIONS = f"{sys.version}, NumPy {np.__version__}".encode()
"""Where a record's address stands is NumPy's own (`compiled.record_pointer`)."""

_NAME = "coulombus"
_FROM = re.compile(rf"^[ \t]*from[ \t]+{_NAME}([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(rf"^[ \t]*import[ \t]+{_NAME}\.([\w.]+)", re.MULTILINE)
_WORD = re.compile(r"\w+")


def source_key(root: Path) -> str:
    """Hash of all Python sources under `root` that may hold or feed a kernel, with
    the versions of interpreter and NumPy.

    A file that is edited from here on is, for this process, what it was: so nothing that was
    compiled of the old text carries the stamp of the new one.
    """
    digest = hashlib.sha256(_VERSIONS)
    for package in KERNEL_PACKAGES:
        folder = root / package
        for path in sorted(folder.rglob("*.py")):
            _hashes[path] = _digest(path)
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + _hashes[path])
    return digest.hexdigest()[:16]


@cache
def ours(file: str) -> bool:
    """Tell whether a source file is one of this project's."""
    return ROOT in Path(file).resolve().parents


@cache
def stamp(file: str, root: Path = ROOT) -> str:
    """Hash of the source `file` and of all that it imports from the packages under `root`, with
    the versions of interpreter and NumPy.
    """
    digest = hashlib.sha256(_VERSIONS)
    for one in sorted(_closure(Path(file).resolve(), root)):
        digest.update(str(one.relative_to(root)).encode() + b"\0" + _hash(one))
    return digest.hexdigest()


_hashes: dict[Path, bytes] = {}
"""Of the files, as this process first saw them."""


def _digest(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


def _hash(path: Path) -> bytes:
    if path not in _hashes:
        _hashes[path] = _digest(path)
    return _hashes[path]


def _closure(path: Path, root: Path) -> set[Path]:
    found: set[Path] = set()
    waiting = [path]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting += _imports(one, root)
    return found


@cache
def _imports(path: Path, root: Path) -> tuple[Path, ...]:
    """Return the files that `path` imports, those of the packages around them included."""
    text = path.read_text(errors="replace")
    modules = [match[1] for match in _IMPORT.finditer(text)]
    for match in _FROM.finditer(text):
        base = match[1].lstrip(".")
        modules += [base, *(f"{base}.{name}".lstrip(".") for name in _WORD.findall(match[2]))]
    found: dict[Path, None] = {}
    for module in modules:
        parts = module.split(".") if module else []
        for depth in range(len(parts) + 1):
            place = root.joinpath(*parts[:depth])
            for file in (place / "__init__.py", place.with_name(f"{place.name}.py")):
                if depth and file.is_file():
                    found[file.resolve()] = None
    return tuple(found)
