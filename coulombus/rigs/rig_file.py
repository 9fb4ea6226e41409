"""Find a rig file by packaged name or path, and read its text."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from coulombus.eds.regular_file import read_regular
from coulombus.rigs.errors import RigError, nearest
from coulombus.rigs.toml_lines import MOST_CHARACTERS
from coulombus.system.quoting import shell

__all__ = ["known_rigs", "named_rig", "packaged_rig", "read_rig_file"]


def packaged_rig(name: str) -> Path:
    """Return the file of a rig of the package."""
    return Path(str(resources.files("coulombus.rigs") / f"{name}.toml"))


def known_rigs() -> tuple[str, ...]:
    """Return the names of the package's rigs."""
    return tuple(
        sorted(entry.name[:-5] for entry in resources.files("coulombus.rigs").iterdir() if entry.name.endswith(".toml"))
    )


def named_rig(name: str) -> Path:
    """Return the file of the package's rig `name`.

    Raises
    ------
    RigError
        There is no such rig.
    """
    names = known_rigs()
    if name not in names:
        expected = f"expected one of {', '.join(names)}, or a path such as ./{Path(name).stem or 'my-rig'}.toml"
        raise RigError([f"--rig {name or chr(39) * 2}: no rig of this name; {expected}{_meant(Path(name), names)}"])
    return packaged_rig(name)


def _meant(path: Path, names: Sequence[str]) -> str:
    """Return the remedy if `path` exists but is not a rig file."""
    if path.suffix.lower() in (".eds", ".dcf", ".xdd", ".xdc"):
        return f"; an EDS file becomes a rig file by coulombus init --drive {shell(str(path))} --brake bench -o my-rig.toml"
    if path.name.removesuffix(".zst").removesuffix(".gz").endswith(".pcapng"):
        return "; this is the name of a recording, and its rig is attached to it"
    return f"; {path} is a folder" if path.is_dir() else nearest(str(path), names)


def read_rig_file(path: Path) -> tuple[str, list[tuple[float, str]]]:
    """Return a rig file's text, and its encoding errors: lines and texts.

    Raises
    ------
    RigError
        The file cannot be read, or is UTF-16.
    """
    try:
        raw = read_regular(path, MOST_CHARACTERS)
    except OSError as error:
        known_names = ", ".join(known_rigs())
        reason = f"cannot be read ({error.strerror}); expected a rig file, or one of the rigs {known_names}"
        raise RigError([f"{path}: {reason}"]) from error
    try:
        return raw.decode("utf-8-sig"), []
    except UnicodeDecodeError as error:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise RigError([f"{path}:1: the file is UTF-16; save it as UTF-8"]) from None
        line = raw[: error.start].count(b"\n") + 1
        text = raw.decode("utf-8", "replace").removeprefix("\ufeff")
        return text, [(line, f"{path}:{line}: the byte 0x{raw[error.start]:02X} is not UTF-8; save the file as UTF-8")]
