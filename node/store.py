"""Persistent storage of a device: in memory, or in a file that survives a power cut at any instant.

The content is sections of named byte strings: the parameter groups of 1010h
(`StoredParameters`) and LSS's settings.

The file is JSON after a line with its length and its CRC-32. It is replaced as a whole: the new
file is written next to the old one, synced, renamed over it, and the directory synced, so that
after a power cut the file is the old one or the new one. A file that is torn, or of another device,
is not used: `FileStore.diagnosis` says why, and the device starts with its defaults.
"""

from __future__ import annotations

import errno
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from coulombus.eds.cia301 import Abort
from coulombus.eds.data import encode
from coulombus.eds.regular_file import read_regular
from coulombus.node.dictionary import Dictionary, decode
from coulombus.node.profile import SdoAbort

__all__ = ["LOAD", "SAVE", "FileStore", "Sections", "Store", "StoredParameters"]

Sections = dict[str, dict[str, bytes]]

_MAGIC = "coulombus-store 1"
MOST_BYTES = 1 << 28
"""Largest size of a store."""


class Store:
    """Sections that live as long as this object: a device's memory that resets do not clear."""

    def __init__(self) -> None:
        self._sections: Sections = {}

    def section(self, name: str) -> Mapping[str, bytes]:
        """Return a section; empty if nothing is stored."""
        return self._sections.get(name, {})

    def put(self, sections: Mapping[str, Mapping[str, bytes]]) -> None:
        """Replace these sections, all or none; an empty one is removed.

        Raises
        ------
        OSError
            The sections cannot be stored; the earlier content remains.
        """
        after = {**self._sections, **{name: dict(content) for name, content in sections.items()}}
        after = {name: content for name, content in after.items() if content}
        self._write(after)
        self._sections = after

    def _write(self, sections: Sections) -> None:
        """Write the sections to a storage that outlives the process."""

    def attach(self, identity: str) -> None:
        """Begin to serve the device `identity`; the content of another device is not used."""


class FileStore(Store):
    """Sections in the file `path`.

    Attributes
    ----------
    diagnosis
        Why the file is not used, else None.
    foreign
        Whether the path is unreadable, or is no device's store: it is not replaced.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self._path = Path(path)
        self._identity = ""
        self.foreign = False
        self.diagnosis: str | None = None

    def attach(self, identity: str) -> None:
        """Read the file, and use it if it is whole and was written by the device `identity`."""
        self._identity, self._sections, self.diagnosis, self.foreign = identity, {}, None, False
        try:
            raw = read_regular(self._path, MOST_BYTES)
            self.foreign = bool(raw.strip(b"\0\n")) and not _MAGIC.encode().startswith(raw[: len(_MAGIC)])
            self._sections = _parse(raw, identity)
        except FileNotFoundError:
            pass
        except OSError as error:
            self.foreign = True
            self.diagnosis = f"{self._path}: cannot be read ({error.strerror}); the device starts with its defaults"
        except ValueError as error:
            self.diagnosis = f"{self._path}: {error}; the device starts with its defaults"

    def _write(self, sections: Sections) -> None:
        if self.foreign:
            raise OSError(errno.EEXIST, "is not the store of a device, and is not replaced", str(self._path))
        beside = self._path.with_name(self._path.name + ".new")
        with suppress(FileNotFoundError):
            os.unlink(beside)  # remnant of a power cut; a link is not followed
        file = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644)
        try:
            content = memoryview(_spell(sections, self._identity))
            while content:
                content = content[os.write(file, content) :]
            os.fsync(file)
        finally:
            os.close(file)
        os.replace(beside, self._path)
        directory = os.open(self._path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


def _spell(sections: Sections, identity: str) -> bytes:
    text = {name: {key: value.hex() for key, value in content.items()} for name, content in sections.items()}
    body = json.dumps({"device": identity, "sections": text}, indent=1, sort_keys=True).encode()
    return f"{_MAGIC} {len(body)} {zlib.crc32(body):08x}\n".encode() + body


def _parse(raw: bytes, identity: str) -> Sections:
    """Return the sections of a file; ValueError says why it is not usable."""
    head, _, body = raw.partition(b"\n")
    if not head.startswith(_MAGIC.encode() + b" "):
        raise ValueError("is not the store of a device")
    if head != f"{_MAGIC} {len(body)} {zlib.crc32(body):08x}".encode():
        raise ValueError("is torn or was changed (length or CRC differ)")
    try:
        content = json.loads(body)
        device, sections = content["device"], content["sections"]
        result = {n: {k: bytes.fromhex(v) for k, v in section.items()} for n, section in sections.items()}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"has invalid content ({error})") from error
    if device != identity:
        raise ValueError(f"was written by another device ({device}), this one is {identity}")
    return result


SAVE, LOAD = 0x65766173, 0x64616F6C
"""Signatures "save" and "load"."""

STORE, RESTORE, VERIFY = 0x1010, 0x1011, 0x1020

_ALL = 1
_GROUP: Mapping[int, str] = {
    2: "communication",
    3: "application",
}  # by sub-index of 1010h and 1011h; others are manufacturer-specific
_RANGES: Mapping[str, range] = {
    "communication": range(0x1000, 0x2000),
    "manufacturer": range(0x2000, 0x6000),
    "application": range(0x6000, 0x10000),
}
_WRITABLE = ("rw", "rwr", "rww")
_NO_PARAMETERS = frozenset((0x1003, STORE, RESTORE))


class StoredParameters:
    """Stored parameters of a device; `commands` are objects that make it act (controlword, set-points).

    CiA 301, 7.5.2.13, 14 and 24: 1010h store, 1011h restore, 1020h verify configuration. A group is a range
    of objects. Store saves the present values of the group's writable objects; every reset that would set
    these objects to their defaults loads them. Restore deletes the group's stored values, so the defaults
    return with the next such reset, not before. Set-points and controlwords are never stored: a device that
    is switched on must not move.
    """

    def __init__(self, dictionary: Dictionary, store: Store, commands: Mapping[tuple[int, int], int]) -> None:
        self._dictionary, self._store, self._commands = dictionary, store, commands
        self.ignored = 0
        """Number of stored values that did not fit their objects when they were loaded."""
        number, text = dictionary.number, dictionary.description.text.encode()
        product = f"{number(0x1018, 1):08X}-{number(0x1018, 2):08X}"
        store.attach(f"{number(0x1000):08X}-{product}-eds {zlib.crc32(text):08x}")

    def is_parameter(self, index: int, subindex: int) -> bool:
        """Tell whether an object is stored, and verified by 1020h."""
        if index in _NO_PARAMETERS or (index, subindex) in self._commands:
            return False
        return self._dictionary.description.variable(index, subindex).access in _WRITABLE

    def load(self, first: int, last: int) -> None:
        """Set the objects from `first` to `last` to their stored values; an object whose value does not fit keeps
        its default.
        """
        for name in _RANGES:
            for key, data in self._store.section(name).items():
                try:
                    index, subindex = (int(part, 16) for part in key.split(":"))
                    if first <= index <= last and self.is_parameter(index, subindex):
                        variable = self._dictionary.find(index, subindex)
                        self._dictionary.check_write(index, subindex, len(data))
                        self._dictionary[index, subindex] = decode(variable, data)
                except (ValueError, KeyError, SdoAbort):
                    self.ignored += 1

    def command(self, index: int, subindex: int, value: int) -> None:
        """Serve a write to 1010h or 1011h, sub-index 1 or more; nothing changes when it aborts."""
        if value != (SAVE if index == STORE else LOAD):
            raise SdoAbort(Abort.CANNOT_STORE)
        names = list(_RANGES) if subindex == _ALL else [_GROUP.get(subindex, "manufacturer")]
        try:
            self._store.put({name: dict(self._present(name)) if index == STORE else {} for name in names})
        except OSError as error:
            raise SdoAbort(Abort.HARDWARE) from error

    def _present(self, name: str) -> Iterator[tuple[str, bytes]]:
        for index, entry in self._dictionary.description.objects.items():
            if index in _RANGES[name]:
                for subindex, variable in entry.variables.items():
                    if self.is_parameter(index, subindex):
                        yield f"{index:04X}:{subindex:02X}", encode(variable, self._dictionary[index, subindex])

    def changed(self, index: int, subindex: int) -> None:
        """Invalidate 1020h after a client has changed an object."""
        if index != VERIFY and (VERIFY, 1) in self._dictionary and self.is_parameter(index, subindex):
            for k in (1, 2):
                if (VERIFY, k) in self._dictionary:
                    self._dictionary[VERIFY, k] = 0
