"""Text logs of other tools, as each tool writes the same frames."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from datetime import UTC, datetime

KINDS = ("data", "remote", "error")


@dataclass(frozen=True)
class Sent:
    """A frame: microseconds from the start, channel from 1, kind, identifier, its width, and data (`length` if remote)."""

    t_us: int
    channel: int
    kind: str
    can_id: int
    extended: bool
    data: bytes = b""
    length: int = 0


def sent_frames(count=20):
    """Frames of all kinds on two channels, 10 ms and more apart: every format's clock tells them apart."""
    frames = []
    for k in range(count):
        kind = ("data", "data", "remote", "data", "error")[k % 5]
        extended = k % 3 == 1 and kind != "error"
        can_id = 0x18FEF100 + k if extended else 0x181 + 16 * k
        data = bytes((k * 37 + n * 11) % 256 for n in range(k % 9)) if kind == "data" else b""
        t_us = 1_000_000 + k * 20_000 + (k * k) % 7 * 1000 * (k > 0)
        frames.append(Sent(t_us, 1 + k % 2, kind, can_id, extended, data, k % 8 if kind == "remote" else len(data)))
    return frames


def pairs(data, separator=" "):
    return separator.join(f"{byte:02X}" for byte in data)


def candump(frames, stamp=lambda f, last: f"{f.t_us / 1e6:017.6f}"):
    lines, last = [], None
    for f in frames:
        can_id = "20000080" if f.kind == "error" else f"{f.can_id:08X}" if f.extended else f"{f.can_id:03X}"
        data = f"R{f.length}" if f.kind == "remote" else f.data.hex().upper()
        lines.append(f"({stamp(f, last)}) can{f.channel} {can_id}#{data}\n")
        last = f
    return "".join(lines)


def console(frames, stamp=lambda f, last: f"{f.t_us / 1e6:017.6f}"):
    lines, last = [], None
    for f in frames:
        can_id = "20000080" if f.kind == "error" else f"{f.can_id:08X}" if f.extended else f"{f.can_id:03X}"
        data = " remote request" if f.kind == "remote" else f" {pairs(f.data)}"
        at = stamp(f, last)
        lines.append(f" {'' if at is None else f'({at})'}  can{f.channel}  {can_id}   [{f.length}] {data}\n")
        last = f
    return "".join(lines)


def date_stamp(f, last):
    return f"{datetime.fromtimestamp(1_700_000_000 + f.t_us / 1e6, UTC):%Y-%m-%d %H:%M:%S.%f}"


def zero_stamp(f, last):
    return f"{(f.t_us - 1_000_000) / 1e6:010.6f}"


def step_stamp(f, last):
    return f"{0 if last is None else (f.t_us - last.t_us) / 1e6:010.6f}"


def asc(frames):
    head = "date Mon Jan 15 10:00:00.000 am 2024\nbase hex  timestamps absolute\nno internal events logged\n"
    lines = [head]
    for f in frames:
        at = f"{f.t_us / 1e6:11.6f} {f.channel}  "
        can_id = f"{f.can_id:X}{'x' if f.extended else ''}"
        tail = f"d {f.length} {pairs(f.data)}" if f.kind == "data" else f"r {f.length}"
        lines.append(f"{at}ErrorFrame\n" if f.kind == "error" else f"{at}{can_id:<15} Rx   {tail}\n")
    return "".join(lines)


def trc(frames):
    lines = [";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n"]
    for n, f in enumerate(frames, 1):
        kind = {"data": "DT", "remote": "RR", "error": "ER"}[f.kind]
        can_id = "-" if f.kind == "error" else f"{f.can_id:08X}" if f.extended else f"{f.can_id:04X}"
        lines.append(f"{n:7} {f.t_us / 1e3:13.3f} {kind} {f.channel} {can_id:>8} Rx -  {f.length}    {pairs(f.data)}\n")
    return "".join(lines)


def can_csv(frames):
    lines = ["timestamp,arbitration_id,extended,remote,error,dlc,data\n"]
    for f in frames:
        flags = f"{int(f.extended)},{int(f.kind == 'remote')},{int(f.kind == 'error')}"
        can_id = 0x80 if f.kind == "error" else f.can_id
        lines.append(f"{f.t_us / 1e6},0x{can_id:x},{flags},{f.length},{b64encode(f.data).decode()}\n")
    return "".join(lines)


def gvret(frames):
    lines = ["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"]
    for f in frames:
        data = ",".join([f"{byte:02X}" for byte in f.data] + [""] * (8 - len(f.data)))
        lines.append(f"{f.t_us},{f.can_id:08X},{str(f.extended).lower()},Rx,{f.channel},{f.length},{data},\n")
    return "".join(lines)


def ixxat(frames, separator=";"):
    lines = ["ASCII Trace IXXAT MiniMon V3  Version: 1.2\nDate: 5/9/2024\nStart time: 2:37:37 PM\n"]
    lines.append("Stop time: 2:37:38 PM\nOverruns: 0\nBaudrate: 500 kbit/s\n")
    lines.append(separator.join(('"Time"', '"Identifier (hex)"', '"Format"', '"Flags"', '"Data (hex)"\n')))
    for f in frames:
        flags, data = ("Rtr", f"Remote request DLC = {f.length}") if f.kind == "remote" else ("", f"{pairs(f.data)} ")
        columns = (f"00:00:{f.t_us / 1e6:06.3f}", f"{f.can_id:X}", "Ext" if f.extended else "Std", flags, data)
        lines.append(separator.join(f'"{column}"' for column in columns) + "\n")
    return "".join(lines)


def canhacker(frames):
    lines = ["@ TEXT @ 3 @ 64 @ 0 @ 84 @ 2399 @ 00:00:02.399 @\n"]
    for f in frames:
        can_id = f"{f.can_id:08X}" if f.extended else f"{f.can_id:03X}"
        at = f"{f.t_us / 1e6:09.6f}".replace(".", ",")
        lines.append(f"{at}\t{f.channel}\t0004\t{can_id}\t{f.length}\t{pairs(f.data):<23}\t00000000\t.......\t\n")
    return "".join(lines)


def canking(frames):
    lines = ["Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"]
    for f in frames:
        if f.kind == "error":
            lines.append(f" {f.channel}    00000000            ErrorFrame                    {f.t_us / 1e6:13.6f} R\n")
            continue
        flags = f"{'X' if f.extended else ' '}{'R' if f.kind == 'remote' else ' '}"
        lines.append(
            f" {f.channel}    {f.can_id:08X} {flags}     {f.length:2}  {pairs(f.data, '  '):<32}{f.t_us / 1e6:13.6f} R\n"
        )
    return "".join(lines) + "Logging stopped.\n"


def kvaser_text(frames):
    lines = ["                 Kvaser Memorator Log\n                 ====================\n\nSettings:\n"]
    lines.append("   Format of data field: HEX\n   Format of id field:   HEX\n   Timestamp Offset:     0.000000 s\n\n")
    lines.append("        Time Chan   Identifier Flags        DLC  Data                           Counter\n======\n")
    for n, f in enumerate(frames):
        at = f"{f.t_us / 1e6:12.6f}  {f.channel}  "
        if f.kind == "error":
            lines.append(f"{at}ErrorFrame    Rx               ERROR FRAME            {n:12}\n")
            continue
        mark = "R" if f.kind == "remote" else " "
        data = "RTR" if f.kind == "remote" else pairs(f.data)
        can_id = f"{f.can_id:10X}{'x' if f.extended else ' '}"
        lines.append(f"{at}{can_id}   Rx       {mark}  {f.length:3}  {data:<24} {n:12}\n")
    return "".join(lines)


def kvaser_csv(frames, base="DEC"):
    number = (lambda value, digits: f"{value:0{digits}X}") if base == "HEX" else (lambda value, digits: str(value))
    lines = [f"Kvaser Memorator Log\nSettings:\n   Format of data field: {base}\n   Format of id field:   {base}\n"]
    lines.append("Time,Channel,ID,Flags,DLC,Data0,Data1,Data2,Data3,Data4,Data5,Data6,Data7,Counter\n")
    for n, f in enumerate(frames):
        flags = (4 if f.extended else 2) | (f.kind == "remote") | 32 * (f.kind == "error")
        data = ",".join([number(byte, 2) for byte in f.data] + [""] * (8 - len(f.data)))
        lines.append(f"{f.t_us / 1e6:.6f},{f.channel},{number(f.can_id, 1)},{flags},{f.length},{data},{n}\n")
    return "".join(lines)


def busmaster(frames, base="HEX", mode="SYSTEM"):
    lines = ["***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***\n"]
    lines.append("***[START LOGGING SESSION]***\n***START DATE AND TIME 8:8:2024 11:49:7:965***\n")
    lines.append(f"***{base}***\n***{mode} MODE***\n***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n")
    last = 0
    for f in frames:
        t_us = f.t_us - last if mode == "RELATIVE" else f.t_us
        last = f.t_us
        at = f"00:00:{t_us // 1_000_000:02}:{t_us % 1_000_000 // 100:04} Rx {f.channel} "
        can_id = f"0x{f.can_id:03X}" if base == "HEX" else f"{f.can_id:04}"
        data = pairs(f.data) if base == "HEX" else " ".join(f"{byte:03}" for byte in f.data)
        kind = f"{'x' if f.extended else 's'}{'r' if f.kind == 'remote' else ''}"
        lines.append(
            f"{at}0x000 ERR Stuff Error\n" if f.kind == "error" else f"{at}{can_id} {kind} {f.length} {data}\n"
        )
    return "".join(lines) + "***END DATE AND TIME 8:8:2024 11:49:9:0***\n***[STOP LOGGING SESSION]***\n"


def slcan(frames, end="\n", stamped=True):
    lines = []
    for f in frames:
        letter = {"data": "t", "remote": "r"}[f.kind]
        can_id = f"{letter.upper()}{f.can_id:08X}" if f.extended else f"{letter}{f.can_id:03X}"
        stamp = f"{f.t_us // 1000 % 60000:04X}" if stamped else ""
        lines.append(f"{can_id}{f.length}{f.data.hex().upper()}{stamp}{end}")
    return "".join(lines)


TEXTS = {
    "candump.log": (candump, KINDS),
    "console.log": (console, KINDS),
    "dates.log": (lambda frames: console(frames, date_stamp), KINDS),
    "zero.log": (lambda frames: console(frames, zero_stamp), KINDS),
    "steps.log": (lambda frames: console(frames, step_stamp), KINDS),
    "steps_L.log": (lambda frames: candump(frames, step_stamp), KINDS),
    "vector.asc": (asc, KINDS),
    "peak.trc": (trc, KINDS),
    "can.csv": (can_csv, KINDS),
    "gvret.csv": (gvret, ("data",)),
    "ixxat.csv": (ixxat, ("data", "remote")),
    "ixxat_comma.csv": (lambda frames: ixxat(frames, ","), ("data", "remote")),
    "canhacker.trc": (canhacker, ("data",)),
    "canking.txt": (canking, KINDS),
    "kvaser.txt": (kvaser_text, KINDS),
    "kvaser.csv": (kvaser_csv, KINDS),
    "kvaser_hex.csv": (lambda frames: kvaser_csv(frames, "HEX"), KINDS),
    "busmaster.log": (busmaster, KINDS),
    "busmaster_dec.log": (lambda frames: busmaster(frames, "DEC", "ABSOLUTE"), KINDS),
    "busmaster_steps.log": (lambda frames: busmaster(frames, "HEX", "RELATIVE"), KINDS),
    "slcan.log": (slcan, ("data", "remote")),
    "slcan_cr.log": (lambda frames: slcan(frames, "\r"), ("data", "remote")),
}
"""File name -> the text of some frames, and the kinds of frames that the format has."""
NO_CHANNEL = ("can.csv", "ixxat.csv", "ixxat_comma.csv", "slcan.log", "slcan_cr.log")


def frames_of(name):
    """The frames that a format can hold."""
    return [f for f in sent_frames() if f.kind in TEXTS[name][1]]
