"""The text formats of other tools' CAN logs, in one table: `FORMATS`.

A format is a row: its name, an example, the beginnings of its head lines, and the patterns of its
lines. A pattern names the columns of a row; a column that a format lacks is empty:

========  ==================================================================
stamp     time, as the format writes it (`Format.stamp` converts it to ns)
bus       channel or interface
id        identifier, in the log's base
extended  present for an identifier of 29 bits
length    number of data bytes, one hexadecimal digit
data      data bytes
end       text behind the data, by which a row without a line end is complete
========  ==================================================================
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

from coulombus.recording.logs.log import EVENT, FD, SHORT
from coulombus.recording.logs.stamps import (
    DAY_NS,
    bus_clock_ns,
    busmaster_start_ns,
    candump_ns,
    clock_ns,
    float_ns,
    hex_ms_ns,
    ms_ns,
    stamp_ns,
    trc_start_ns,
    us_ns,
)

__all__ = ["DATA", "ERROR", "FORMATS", "GROUPS", "REMOTE", "TRC_VERSIONS", "Format", "LineForm", "trc_lines"]

GROUPS = ("stamp", "bus", "id", "extended", "length", "data", "end")
DATA, REMOTE, ERROR = "data frame", "remote frame", "error frame"


@dataclass(frozen=True)
class LineForm:
    """A form of line.

    Attributes
    ----------
    kind : str or None
        DATA, REMOTE or ERROR for a frame; else the reason for its omission, or None for a line that is no row.
    pattern : re.Pattern
        Matches the whole line; has all `GROUPS`.
    is_open : bool
        Without its line end such a row may be truncated, unless there is an `end`.
    """

    kind: str | None
    pattern: re.Pattern[str]
    is_open: bool = False


@dataclass(frozen=True)
class Format:
    """A format of text logs.

    Attributes
    ----------
    name, suffix, example : str
        The usual ending of its files, and a row of it.
    lines : tuple of LineForm
        Tried in this order.
    stamp : callable
        Converts a stamp to ns.
    heads : tuple of str
        Beginnings of lines without rows, in lower case.
    settings : re.Pattern
        Searched in head lines: ``base`` (hex, dec), ``mode`` (relative, system), ``start``, and the
        ``version`` or ``columns`` of a .trc.
    start : callable
        Converts ``start`` to ns since 1970.
    opening : tuple of str
        A head line, and the head line that always follows it (its time looks like that of a row).
    base : int
        Base of identifiers and data where no head line has it.
    separator : str or None
        Between data bytes; "": none, None: spaces.
    wrap_ns, least_drop_ns : int
        The clock begins again after `wrap_ns` (0: never): a stamp is lower than the last one by more than
        `least_drop_ns`.
    differences : re.Pattern or None
        Stamps of this form may be times since the previous row.
    """

    name: str
    suffix: str
    example: str
    lines: tuple[LineForm, ...]
    stamp: Callable[[str], int] = stamp_ns
    heads: tuple[str, ...] = ()
    settings: re.Pattern[str] = re.compile("(?!)")
    start: Callable[[str], int] = field(default=int)
    opening: tuple[str, str] = ("", "")
    base: int = 16
    separator: str | None = None
    wrap_ns: int = 0
    least_drop_ns: int = 0
    differences: re.Pattern[str] | None = None


def _line(kind: str | None, pattern: str, is_open: bool = False) -> LineForm:
    """Return a line; columns that it lacks become empty groups."""
    lacking = "".join(f"(?P<{name}>)" for name in GROUPS if f"(?P<{name}>" not in pattern)
    return LineForm(kind, re.compile(pattern + lacking, re.ASCII), is_open)


def _settings(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.ASCII | re.IGNORECASE)


H = "[0-9A-Fa-f]"
PAIRS = rf"(?P<data>(?:\s+{H}{{2}})*)"
BYTES = rf"(?P<data>(?:\s+{H}{{1,3}})*)"
"""Data bytes in either base."""
END = r"(?P<end>\s.*)?"
DIGIT = rf"(?P<length>{H})"
CLASSICAL = "(?P<length>[0-8])"
DECIMAL = r"(?P<length>\d{1,2})"

# candump: ID#DATA after a stamp, or columns on a console; error frames have 20000000h in the identifier
BITS_11_29 = rf"(?P<id>{H}{{3}}|(?P<extended>[01]{H}{{7}}))"
ERROR_ID = rf"(?P<id>[2367ABEFabef]{H}{{7}})"
LOG = r"\s*\((?P<stamp>[^()]*)\)\s+(?P<bus>\S+)\s+"
DIRECTION = r"(?P<end>\s+[RTrt])?\s*"
LOG_DATA = rf"#(?P<data>[0-9A-Fa-f.]*)(?:_{H})?{DIRECTION}"
CONSOLE = r"\s*(?:\((?P<stamp>[^()]*)\)\s+)?(?P<bus>\S+)\s+(?:[RT]X\s+\S+\s+\S+\s+)?"
CONSOLE_DATA = rf"\s+\[(?P<length>\d)\]{PAIRS}(?P<end>\s+(?!r)\S.*)?\s*"
CANDUMP = Format(
    "candump",
    ".log",
    "(1436509052.249713) can0 123#DEADBEEF",
    (
        _line(DATA, LOG + BITS_11_29 + LOG_DATA, is_open=True),
        _line(REMOTE, LOG + BITS_11_29 + rf"#[Rr](?P<length>\d?)(?:_{H})?{DIRECTION}", is_open=True),
        _line(ERROR, LOG + ERROR_ID + LOG_DATA, is_open=True),
        _line(FD, rf"{LOG}(?:{H}{{3}}|{H}{{8}})##.*"),
        _line(DATA, CONSOLE + BITS_11_29 + CONSOLE_DATA),
        _line(REMOTE, CONSOLE + BITS_11_29 + r"\s+\[(?P<length>\d)\]\s+remote request\s*"),
        _line(ERROR, CONSOLE + ERROR_ID + CONSOLE_DATA),
        _line(FD, rf"{CONSOLE}(?:{H}{{3}}|{H}{{8}})\s+\[\d\d+\].*"),  # console: a CAN FD length has two digits
        _line(None, r"\t.*"),  # candump -e explains an error frame there
    ),
    stamp=candump_ns,
    separator=".",
    differences=re.compile(r"\d{3}\.\d{6}"),
)

# Vector's .asc: rows of CAN FD controllers are classical frames unless a flag behind the data says CAN FD
EVEN, ODD = "[02468ACEace]", "[13579BDFbdf]"
AT = r"\s*(?P<stamp>\d+[.,]\d+)\s+"
ASC_ID = rf"(?P<id>{H}+)(?P<extended>[xX])?\s+"
ASC_ROW = rf"{AT}(?P<bus>\d+)\s+{ASC_ID}[RT]x\s+"
FD_ROW = rf"{AT}CANFD\s+(?P<bus>\d+)\s+[RT]x\s+{ASC_ID}(?:(?![01]\s)\S+\s+)?[01]\s+[01]\s+"
COUNTED = "|".join(rf"(?<=\s{n})(?:\s+{H}{{1,3}}){{{n}}}" for n in range(9))
FD_DATA = rf"{CLASSICAL}(?P<data>{COUNTED})\s+\S+\s+\S+\s+"
FD_FLAG = rf"{H}*{ODD}{H}{{3}}"
NO_FLAG = rf"(?:(?:{H}*{EVEN})?{H}{EVEN}{H}|{EVEN}{H}|{H})"
REMOTE_FLAG = rf"(?:(?:{H}*{EVEN})?{H}{ODD}{H}|{ODD}{H})"
ASC = Format(
    "Vector's .asc",
    ".asc",
    "0.001200 1  181             Rx   d 8 50 02 00 00 00 00 00 00",
    (
        _line(DATA, rf"{ASC_ROW}d\s+{DIGIT}{BYTES}{END}"),
        _line(REMOTE, rf"{ASC_ROW}r\s+{DIGIT}{END}"),
        _line(REMOTE, rf"{ASC_ROW}r\s*", is_open=True),
        _line(ERROR, rf"{AT}(?:CANFD\s+)?(?P<bus>\d+)\s+(?:[RT]x\s+)?(?i:errorframe)\b.*"),
        _line(DATA, rf"{FD_ROW}{H}\s+{FD_DATA}{NO_FLAG}{END}", is_open=True),
        _line(REMOTE, rf"{FD_ROW}{H}\s+{FD_DATA}{REMOTE_FLAG}{END}", is_open=True),
        _line(REMOTE, rf"{FD_ROW}(?!0){DIGIT}\s+0\s+\S+\s+\S+\s+(?:{NO_FLAG}|{REMOTE_FLAG}){END}", is_open=True),
        _line(FD, rf"{FD_ROW}{H}+\s+(?:\d\d\s.*|{FD_DATA}{FD_FLAG}{END})"),
        _line(SHORT, rf"{AT}\d+(?:\s+{H}+[xX]?(?:\s+[RT]x?(?:\s+[dr](?:\s.*)?)?)?)?\s*"),
        _line(SHORT, rf"{AT}CANFD\s.*"),
        _line(SHORT, r"\s*(?P<stamp>\d+[.,]\d+)\s*"),
        _line(None, rf"{AT}(?i:start of measurement)\s*"),
        _line(EVENT, rf"{AT}\S.*"),
    ),
    heads=(
        *("date ", "base ", "internal events logged", "no internal events logged", "//"),
        *("begin triggerblock", "end triggerblock", "previous log file", "measurement uuid"),
    ),
    settings=_settings(r"^base (?P<base>hex|dec)(?:.*\b(?P<mode>relative))?"),
    opening=("begin triggerblock", "0.000000 start of measurement"),
)

# PEAK's .trc: N number, O offset [ms], T type, B bus, I identifier, d direction, R reserved, l length, L DLC, D data
TRC_VERSIONS = {"1.0": "NOILD", "1.1": "NOTILD", "1.2": "NOBTILD", "1.3": "NOBTIRLD"}
"""Columns of the versions whose files do not name them."""


@cache
def trc_lines(columns: str, number: str = r"\d+\)?") -> tuple[LineForm, ...]:
    """Return the lines of a .trc file with these columns; `number` is the pattern of the first."""
    length = "l" if "l" in columns else "L"
    forms = {"N": number, "O": r"(?P<stamp>\d+(?:[.,]\d+)?)", "B": r"(?P<bus>\S+)", length: DIGIT}
    forms["I"] = rf"(?!FFFFFFFF\s)(?P<id>{H}{{1,4}}|(?P<extended>{H}{{5,8}}))"
    typed = "T" in columns

    def row(types: str, until: str = columns.partition("D")[0]) -> str:
        return r"\s*" + r"\s+".join({**forms, "T": f"(?:{types})"}.get(column, r"\S+") for column in until)

    begin = columns[: max(columns.find(column) for column in "OTB") + 1]
    frames = "DT|Rx|Tx"
    lines = [
        _line(DATA, row(frames) + r"(?!\s+RTR)" + PAIRS + END),
        _line(REMOTE, row(frames) + r"\s+RTR\s*"),
    ]
    if typed:
        lines += [
            _line(REMOTE, row("RR") + END),
            _line(ERROR, row("ER|Error", begin) + r"(?:\s.*)?"),
            _line(FD, row("FD|FB|FE|BI", begin) + r"(?:\s.*)?"),
            _line(SHORT, row(f"{frames}|RR", begin) + r"(?:\s.*)?"),
            _line(EVENT, row(r"\S+", columns[: columns.find("T") + 1]) + r"(?:\s.*)?"),
        ]
    else:
        lines += [_line(EVENT, row("", begin) + r"\s+FFFFFFFF\s.*"), _line(SHORT, row("", begin) + r"(?:\s.*)?")]
    return tuple(lines)


TRC = Format(
    "PEAK's .trc",
    ".trc",
    "     1)    1000      0181  2  37 06",
    trc_lines(TRC_VERSIONS["1.0"], r"\d+\)"),
    stamp=ms_ns,
    heads=(";",),
    settings=_settings(r";\$(?:FILEVERSION=(?P<version>[\d.]+)|COLUMNS=(?P<columns>.*)|STARTTIME=(?P<start>.*))"),
    start=trc_start_ns,
)

# python-can's .csv: the data in base64
CSV_BEGIN = rf"(?P<stamp>[^,]*),(?:0[xX])?(?P<id>{H}+),(?:(?P<extended>1)|[^,]*),"
CSV_END = r",(?P<length>\d+),(?P<data>[^,]*)"
CAN_CSV = Format(
    "python-can's .csv",
    ".csv",
    "1436509052.249713,0x181,0,0,0,2,NwY=",
    (
        _line(DATA, f"{CSV_BEGIN}0,0{CSV_END}"),
        _line(REMOTE, f"{CSV_BEGIN}1,[^,]*{CSV_END}"),
        _line(ERROR, f"{CSV_BEGIN}0,1{CSV_END}"),
    ),
    stamp=float_ns,
    heads=("timestamp,arbitration_id,extended,remote,error,dlc,data",),
    separator="base64",
)

# SavvyCAN's csv (GVRET): stamps in microseconds, one column per byte
GVRET = Format(
    "SavvyCAN's .csv (GVRET)",
    ".csv",
    "166064000,00000181,false,Rx,0,2,37,06,,,,,,,",
    tuple(
        _line(
            kind,
            rf"\s*(?P<stamp>\d+),(?:0[xX])?(?P<id>{H}+),(?:(?P<extended>(?i:true))|(?i:false)),(?:[RT]x,)?"
            rf"(?P<bus>\d+),{rest}",
        )
        for kind, rest in ((DATA, rf"{CLASSICAL}(?P<data>(?:,{H}{{0,2}})*)"), (FD, r"\d\d+,.*"))
    ),
    stamp=us_ns,
    heads=("time stamp,id,extended",),
    separator=",",
)

# IXXAT's trace in ASCII (MiniMon, canAnalyser): quoted columns; stamps count from the start
IXXAT_BEGIN = (
    rf'\s*"(?P<stamp>\d+:\d\d:\d\d(?:[.,]\d+)?)"[;,\t]"(?P<id>{H}+)"[;,\t]"(?:(?i:std)|(?P<extended>(?i:ext)))"[;,\t]'
)
IXXAT = Format(
    "IXXAT's ASCII trace",
    ".csv",
    '"00:00:01.10";"181";"Std";"";"37 06 "',
    (
        _line(DATA, rf'{IXXAT_BEGIN}"(?i:self|srr)?"[;,\t]"(?P<data>[0-9A-Fa-f\s]*)(?P<end>")\s*', is_open=True),
        _line(
            REMOTE, rf'{IXXAT_BEGIN}"[^"]*(?i:rtr)[^"]*"[;,\t]"(?:[^"]*=\s*{DIGIT})?[^"]*(?P<end>")\s*', is_open=True
        ),
        _line(FD, rf'{IXXAT_BEGIN}"[^"]*(?i:fd|edl)[^"]*"[;,\t].*'),
    ),
    stamp=clock_ns,
    heads=("ascii trace ", "date:", "start time:", "stop time:", "overruns:", "baudrate:", '"time"'),
    settings=_settings(r'"identifier \((?P<base>hex|dec)\)"'),
    wrap_ns=DAY_NS,
    least_drop_ns=DAY_NS // 2,
)

# CANHacker's trace: columns between tabulators, a comma in the stamp
CANHACKER = Format(
    "CANHacker's trace",
    ".trc",
    "17,439466\t1\t0004\t181\t2\t37 06                  \t00000000\t7       \t",
    (
        _line(
            DATA,
            rf"\s*(?P<stamp>\d+[.,]\d+)\t(?P<bus>\d+)\t{H}+\t(?P<id>{H}{{3}}|(?P<extended>{H}{{8}}))\t"
            rf"{CLASSICAL}\t(?P<data>(?: ?{H}{{2}})*) *(?P<end>\t.*)?",
        ),
    ),
    heads=("@ ", "# "),
)

# Kvaser: the list of CANKing's output window, the plain text and the csv of its converters
CANKING_BEGIN = rf"\s*(?P<bus>\d+)\s+(?P<id>{H}{{8}})\s+"
CANKING_END = r"\s+(?P<stamp>\d+[.,]\d+)(?P<end>\s+[RT])\s*"
CANKING = Format(
    "Kvaser CANKing's list",
    ".txt",
    " 0    00000181         2  37  06                            154.266550 R",
    (
        _line(DATA, rf"{CANKING_BEGIN}(?:(?P<extended>X)\s+)?{DECIMAL}{PAIRS}{CANKING_END}", is_open=True),
        _line(
            REMOTE,
            rf"{CANKING_BEGIN}(?=.*(?:\bX?R\s+\d|(?i:remote)|RTR))(?:(?P<extended>X)\s*)?(?:R\s+)?{DECIMAL}"
            rf"(?:\s+(?i:remote ?frame|RTR))?{CANKING_END}",
            is_open=True,
        ),
        _line(ERROR, rf"\s*(?P<bus>\d+)\s+{H}{{8}}\s+(?:\w\s+)?(?i:errorframe){CANKING_END}", is_open=True),
    ),
    heads=("chn identifier", "logging started", "logging stopped"),
)
KVASER_HEADS = (
    "kvaser memorator",
    "logging started",
    "memorator ",
    "settings:",
    "format of ",
    "timestamp offset",
    "can channel",
)
KVASER_BASE = _settings(r"format of id field\W+(?P<base>hex|dec)")
KVASER_BEGIN = rf"{AT}(?P<bus>\d+)\s+(?P<id>{H}+)(?P<extended>x)?\s+(?:TxRq|Tx|Rx)\s+"
KVASER_TEXT = Format(
    "Kvaser's plain text",
    ".txt",
    "    1.002000  1         181    Rx          2  37 06                              1",
    (
        _line(DATA, rf"{KVASER_BEGIN}(?:[EW#]\s*)*{DECIMAL}{BYTES}(?P<end>\s+\d+)\s*", is_open=True),
        _line(REMOTE, rf"{KVASER_BEGIN}(?:[EW#]\s*)*R\s*[W#]?\s*{DECIMAL}\s+RTR(?P<end>\s+\d+)\s*", is_open=True),
        _line(ERROR, rf"{AT}(?P<bus>\d+)\s+ErrorFrame\s.*"),
        _line(FD, rf"{KVASER_BEGIN}E?\s*F.*"),
        _line(EVENT, rf"{AT}Trigger\s.*"),
    ),
    heads=(*KVASER_HEADS, "time chan", "===", "datetime:"),
    settings=KVASER_BASE,
)
RTR_BIT, EXTENDED_BIT, ERROR_BIT = 1, 4, 32


def _flags(present: int, absent: int) -> str:
    """Return a pattern of the numbers of a byte with some bits set and others clear."""
    numbers = (n for n in range(256) if n & present == present and not n & absent)
    return "|".join(map(str, numbers))


def _kvaser_row(kind: str, present: int, absent: int, data: str) -> LineForm:
    long, short = _flags(present | EXTENDED_BIT, absent), _flags(present, absent | EXTENDED_BIT)
    return _line(
        kind,
        rf"\s*(?P<stamp>\d+\.\d+),(?P<bus>\d+),(?P<id>{H}+),(?:(?P<extended>{long})|(?:{short})),{DECIMAL}{data}",
        is_open=True,
    )


KVASER_CSV = Format(
    "Kvaser's .csv",
    ".csv",
    "1.002000,1,385,2,2,55,6,,,,,,,1",
    (
        _kvaser_row(DATA, 0, RTR_BIT | ERROR_BIT, rf"(?P<data>(?:,{H}{{0,3}}){{8}})(?P<end>,.*)"),
        _kvaser_row(REMOTE, RTR_BIT, ERROR_BIT, rf"(?:,{H}{{0,3}}){{8}}(?P<end>,.*)"),
        _line(ERROR, rf"\s*(?P<stamp>\d+\.\d+),(?P<bus>\d+),{H}*,(?:{_flags(ERROR_BIT, 0)}),.*"),
        _line(FD, rf"\s*\d+\.\d+,\d+,{H}+,\d{{5,}},.*"),
    ),
    heads=(*KVASER_HEADS, "time,channel,id,flags,dlc"),
    settings=KVASER_BASE,
    base=10,
    separator=",",
)

# BUSMASTER's .log: stamps as h:m:s and tenths of a millisecond
BUSMASTER_BEGIN = rf"\s*(?P<stamp>\d+:\d+:\d+:\d+)\s+[RT]x\s+(?P<bus>\d+)\s+(?:0[xX])?(?P<id>{H}+)\s+"
BUSMASTER = Format(
    "BUSMASTER's .log",
    ".log",
    "11:49:12:9420 Rx 1 0x181 s 2 37 06",
    (
        _line(DATA, rf"{BUSMASTER_BEGIN}(?:s|(?P<extended>x))\s+{CLASSICAL}{BYTES}{END}"),
        _line(REMOTE, rf"{BUSMASTER_BEGIN}(?:s|(?P<extended>x))r\s+{CLASSICAL}{END}"),
        _line(ERROR, rf"{BUSMASTER_BEGIN.replace('(?P<id>', '(?:')}ERR.*"),
        _line(FD, rf"{BUSMASTER_BEGIN}[sx]-fd\s.*"),
    ),
    stamp=bus_clock_ns,
    heads=("***",),
    settings=_settings(
        r"^\*\*\*(?:(?P<base>hex|dec)\*\*\*|(?P<mode>relative|system) mode|start date and time\s+(?P<start>\d[\d: ]*))"
    ),
    start=busmaster_start_ns,
    wrap_ns=DAY_NS,
    least_drop_ns=DAY_NS // 2,
)

# slcan (LAWICEL): stamps of four hexadecimal digits in milliseconds, which begin again after a minute
SLCAN_COUNTED = "|".join(rf"(?<={n})(?:{H}{{2}}){{{n}}}" for n in range(9))
SLCAN_STAMP = rf"(?P<stamp>{H}{{4}})?\s*"
STANDARD_ID, EXTENDED_ID = rf"(?P<id>[0-7]{H}{{2}})", rf"(?P<extended>(?P<id>[01]{H}{{7}}))"
SLCAN = Format(
    "slcan",
    ".log",
    "t18123706EA5F",
    (
        *(
            _line(DATA, rf"[zZ\a]*{letter}{can_id}{CLASSICAL}(?P<data>{SLCAN_COUNTED}){SLCAN_STAMP}", is_open=True)
            for letter, can_id in (("t", STANDARD_ID), ("T", EXTENDED_ID))
        ),
        *(
            _line(REMOTE, rf"[zZ\a]*{letter}{can_id}{CLASSICAL}{SLCAN_STAMP}", is_open=True)
            for letter, can_id in (("r", STANDARD_ID), ("R", EXTENDED_ID))
        ),
        _line(EVENT, rf"[zZ\a]+|\a*(?:[Vv]{H}{{4}}|N\w{{4}}|F{H}{{2}})"),  # the adapter's answers
    ),
    stamp=hex_ms_ns,
    separator="",
    wrap_ns=60 * 10**9,
)

FORMATS = (CANDUMP, ASC, TRC, CAN_CSV, GVRET, IXXAT, CANHACKER, CANKING, KVASER_TEXT, KVASER_CSV, BUSMASTER, SLCAN)
"""Text formats; where a file fits several, the first."""
