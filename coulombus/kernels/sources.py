"""Hash of the sources, by which the kernels are cached.

Numba's disk cache checks the file of the function that it compiles, not the files of its callees:
after a change of a callee the cache would be stale. So the cache folder is named by the hash of all
sources that may hold a kernel, or feed one.
"""

from __future__ import annotations

import hashlib
import os
import sys
from importlib.metadata import version
from pathlib import Path

__all__ = ["KERNEL_PACKAGES", "ROOT", "source_key", "source_stamp"]

KERNEL_PACKAGES = (
    "kernels",
    "system",
    "wire",
    "eds",
    "rigs",
    "recording",
    "node",
    "host",
    "sim_bus",
    "lab",
    "analysis",
)

ROOT = Path(__file__).resolve().parent.parent
"""The folder of the packages."""


def source_key(root: Path = ROOT) -> str:
    """Hash of all Python sources under `root` that may hold or feed a kernel, and of the other inputs of
    the machine code that numba ignores: the versions, and Python's ``-O``, which removes assertions.
    """
    versions = (sys.version, sys.flags.optimize, *map(version, ("numpy", "numba", "llvmlite")))
    digest = hashlib.sha256(repr(versions).encode())
    for package in KERNEL_PACKAGES:
        folder = root / package
        for path in sorted(folder.rglob("*.py")):
            content = path.read_bytes()
            digest.update(f"{path.relative_to(folder)}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


def source_stamp(root: Path = ROOT) -> str:
    """Hash of the places and times of the same sources, and of the processor that is named.

    Numba compiles a function again if its file was written again or is in another place, or for another
    processor, even if no source has changed.
    """
    digest = hashlib.sha256(os.environ.get("NUMBA_CPU_NAME", "").encode())
    for package in KERNEL_PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(f"{path}\0{path.stat().st_mtime_ns}\0".encode())
    return digest.hexdigest()[:16]
