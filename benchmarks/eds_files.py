"""Reading a large EDS file, beside canopen's reader: processor time of both for the same file.

Ours says what is wrong with the file, by line, and keeps what canopen's leaves out; both make an
object dictionary of it.
"""

from __future__ import annotations

import io
import statistics
import time
from collections.abc import Callable

from benchmarks.size import size

__all__ = ["eds_files", "large_file"]

SUBINDICES = 250
ROUNDS = size(3, 1)
SECTIONS = 100_000


def large_file(sections: int) -> str:
    """Return an EDS file without a defect, of so many sections of sub-indices."""
    count = -(-sections // SUBINDICES)
    lines = ["[FileInfo]", "FileName=large.eds", "[DeviceInfo]", "VendorName=Nobody"]
    for name in ("MandatoryObjects", "ManufacturerObjects"):
        lines += [f"[{name}]", "SupportedObjects=0"]
    lines += ["[OptionalObjects]", f"SupportedObjects={count}"]
    lines += [f"{k + 1}=0x{0x6000 + k:04X}" for k in range(count)]
    for k in range(count):
        lines += [f"[{0x6000 + k:04X}]", "ParameterName=Part", "ObjectType=0x8", f"SubNumber={SUBINDICES}"]
        for sub in range(SUBINDICES):
            first = SUBINDICES - 1 if sub == 0 else sub
            lines += [f"[{0x6000 + k:04X}sub{sub:X}]", f"ParameterName=Entry {sub}", "ObjectType=0x7"]
            lines += [f"DataType=0x{5 if sub == 0 else 7:04X}", f"AccessType={'ro' if sub == 0 else 'rw'}"]
            lines += [f"DefaultValue={first}", "PDOMapping=0"]
    return "\n".join(lines) + "\n"


def eds_files(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    from canopen.objectdictionary.eds import import_eds

    from coulombus.eds.reader import parse_eds

    text = large_file(SECTIONS)

    def ours(k: int) -> None:
        description = parse_eds(text.encode(), f"large-{k}.eds")  # another name: the same file is read once
        assert not description.diagnoses

    def theirs(k: int) -> None:
        import_eds(io.StringIO(text), 1)

    spent: list[list[float]] = [[], []]
    for k in range(ROUNDS):
        for row, read in zip(spent, (ours, theirs), strict=True):
            begin = time.process_time()
            read(k)
            row.append(time.process_time() - begin)
    mine, other = map(statistics.median, spent)
    show(
        f"EDS file of {SECTIONS:,} sections, canopen's reader beside ours",
        f"{other / mine:.1f} x",
        f"ours {mine:.1f} s",
    )
