"""Compiled CiA 401 input and output module: digital ports of 8 bits, analogue channels of 16 bits.

    digital in    6000h = in_digital xor 6002h
    digital out   out_digital = chosen xor 6202h,
                  chosen = 6200h, after a failure (6207h and 6206h) or (chosen and not 6206h)
    analogue in   6401h = in_analogue, within INTEGER16
    analogue out  out_analogue = 6411h, after a failure 6444h where 6443h is 1, else unchanged

A failure is a device fault, a lost connection (heartbeat, guarding, RPDO deadline, SYNC, bus-off),
an NMT state change by 1029h, or the NMT command "stop". After power-on or a reset every output is
0. An output leaves its failure value when it is written and the device has no fault; an output that
was never written stays 0. PRE-OPERATIONAL by command leaves the outputs unchanged. A file has as
many ports and channels as it has sub-indices. The triggers of analogue inputs (6421h to 6428h) and
the filters (6003h, 6208h) are not implemented.

A CiA 404 module of any vendor behaves the same with other objects: inputs 7130h (and 9130h, the
same in 32 bits), outputs 7300h (9300h), fault mode 6340h, fault value 7341h (9341h). Both sides are
raw counts, whose unit depends on the module. Our own brake driver is `node.brake404`.

In the kernels: `n` the node's record (`node.record`), `k` the number
of a port or channel from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.eds.cia301 import Abort, NmtState
from coulombus.kernels.decorator import kernel
from coulombus.node import emcy
from coulombus.node.profile import BY_COMMAND, BY_RESET, Behaviour, CoreObject, Objects, Profile, SdoAbort, Terminal
from coulombus.node.record import INPUTS, OUTPUTS, PORTS, InputOutputFields, NodeRecord
from coulombus.node.slots import FIRST_OF_KIND, REGISTER
from coulombus.wire.frame import Queue

__all__ = ["ANALOGUE_IN", "ANALOGUE_OUT", "IO401", "IO404"]

DIGITAL_IN = FIRST_OF_KIND
DIGITAL_IN_POLARITY = DIGITAL_IN + PORTS
DIGITAL_OUT = DIGITAL_IN_POLARITY + PORTS
DIGITAL_OUT_POLARITY = DIGITAL_OUT + PORTS
DIGITAL_ERROR_MODE = DIGITAL_OUT_POLARITY + PORTS
DIGITAL_ERROR_VALUE = DIGITAL_ERROR_MODE + PORTS
ANALOGUE_IN = DIGITAL_ERROR_VALUE + PORTS
ANALOGUE_OUT = ANALOGUE_IN + INPUTS
ANALOGUE_ERROR_MODE = ANALOGUE_OUT + OUTPUTS
ANALOGUE_ERROR_VALUE = ANALOGUE_ERROR_MODE + OUTPUTS

_ACTS_ANALOGUE = PORTS  # analogue outputs have the bits after those of the ports
_ALL = (1 << PORTS + OUTPUTS) - 1


@kernel
def _within(n: NodeRecord, value: int) -> int:
    return int(min(max(value, -n.analogue_most - 1), n.analogue_most))


@kernel
def _allowed(n: NodeRecord, k: int, value: int) -> int:
    """Return `value`, clipped to the range of the analogue output's hardware."""
    if n.board_high[k] > n.board_low[k]:
        return int(min(max(value, n.board_low[k]), n.board_high[k]))
    return value


@kernel
def _sample(n: NodeRecord) -> None:
    values = n.values
    for k in range(PORTS):
        values[DIGITAL_IN + k] = (n.in_digital[k] ^ values[DIGITAL_IN_POLARITY + k]) & 0xFF
    for k in range(INPUTS):
        values[ANALOGUE_IN + k] = _within(n, n.in_analogue[k])


@kernel
def _actuate(n: NodeRecord, t_ns: int) -> None:
    """Write the commanded values to the outputs that have not failed."""
    values = n.values
    for k in range(PORTS):
        if n.failed >> k & 1 == 0:
            n.out_digital[k] = (values[DIGITAL_OUT + k] ^ values[DIGITAL_OUT_POLARITY + k]) & 0xFF
    for k in range(OUTPUTS):
        if n.failed >> (_ACTS_ANALOGUE + k) & 1 == 0:
            n.out_analogue[k] = _allowed(n, k, values[ANALOGUE_OUT + k])


@kernel
def _fail(n: NodeRecord) -> None:
    """Apply the error values as the error modes say; an output that has already failed keeps its value."""
    values = n.values
    for k in range(PORTS):
        if n.failed >> k & 1 == 0:
            mode = values[DIGITAL_ERROR_MODE + k]
            bits = values[DIGITAL_ERROR_VALUE + k] & mode | values[DIGITAL_OUT + k] & ~mode
            n.out_digital[k] = (bits ^ values[DIGITAL_OUT_POLARITY + k]) & 0xFF
    for k in range(OUTPUTS):
        if n.failed >> (_ACTS_ANALOGUE + k) & 1 == 0 and values[ANALOGUE_ERROR_MODE + k] == 1:
            n.out_analogue[k] = _allowed(n, k, _within(n, values[ANALOGUE_ERROR_VALUE + k]))
    n.failed = _ALL


@kernel
def _apply(n: NodeRecord, t_ns: int, received_ns: int, carries: int, out: Queue) -> None:
    if n.causes & emcy.DEVICE_MASK == 0:
        n.failed &= ~carries


@kernel
def _connection_lost(n: NodeRecord, t_ns: int, why: int) -> int:
    if why == BY_RESET:
        n.failed = _ALL
        n.out_digital[:] = 0
        n.out_analogue[:] = 0
    elif why != BY_COMMAND or n.nmt == NmtState.STOPPED:
        _fail(n)
    return 0


@kernel
def _react(n: NodeRecord, t_ns: int, cause: int) -> None:
    if emcy.FAULT_MASK >> cause & 1:
        _fail(n)


def _started(record: NodeRecord, objects: Objects, t_ns: int) -> None:
    wide = any((index, k + 1) in objects for index in (0x9130, 0x9300) for k in range(INPUTS))
    record["analogue_most"] = 0x7FFFFFFF if wide else 0x7FFF
    record["failed"] = _ALL
    for name in ("out_digital", "out_analogue"):
        record[name] = 0


def _check(objects: Objects, index: int, subindex: int, value: int) -> None:
    """Require 0 or 1 in 6443h and 6340h."""
    if index in (0x6443, 0x6340) and subindex and value not in (0, 1):
        raise SdoAbort(Abort.VALUE)


def _rows(
    index: int, slot: int, count: int, absent: int = 0, *, acts: int = -1, changing: bool = False
) -> list[CoreObject]:
    """Return the rows of sub-indices 1 to `count`; `acts`: number of the first sub-index's bit, -1: none."""
    return [
        CoreObject(index, k + 1, slot + k, absent, acts=1 << acts + k if acts >= 0 else 0, changing=changing)
        for k in range(count)
    ]


def _wires(index: int, field: str, count: int) -> list[Terminal]:
    limits = ("board_low", "board_high") if field == "out_analogue" else ("", "")
    return [Terminal(index, k + 1, field, k, *limits) for k in range(count)]


IO401 = Profile(
    "io",
    objects=(
        REGISTER,
        *_rows(0x6000, DIGITAL_IN, PORTS),
        *_rows(0x6002, DIGITAL_IN_POLARITY, PORTS),
        *_rows(0x6200, DIGITAL_OUT, PORTS, acts=0),
        *_rows(0x6202, DIGITAL_OUT_POLARITY, PORTS),
        *_rows(0x6206, DIGITAL_ERROR_MODE, PORTS, 0xFF),
        *_rows(0x6207, DIGITAL_ERROR_VALUE, PORTS),
        *_rows(0x6401, ANALOGUE_IN, INPUTS, changing=True),
        *_rows(0x6411, ANALOGUE_OUT, OUTPUTS, acts=_ACTS_ANALOGUE),
        *_rows(0x6443, ANALOGUE_ERROR_MODE, OUTPUTS, 1),
        *_rows(0x6444, ANALOGUE_ERROR_VALUE, OUTPUTS),
    ),
    fields=InputOutputFields,
    terminals=(
        *_wires(0x6000, "in_digital", PORTS),
        *_wires(0x6200, "out_digital", PORTS),
        *_wires(0x6401, "in_analogue", INPUTS),
        *_wires(0x6411, "out_analogue", OUTPUTS),
    ),
    behaviour=Behaviour(sample=_sample, actuate=_actuate, apply=_apply, connection_lost=_connection_lost, react=_react),
    started=_started,
    check=_check,
)
"""A CiA 401 module."""

IO404 = Profile(
    "io404",
    objects=(
        REGISTER,
        *_rows(0x7130, ANALOGUE_IN, INPUTS, changing=True),
        *_rows(0x9130, ANALOGUE_IN, INPUTS, changing=True),
        *_rows(0x7300, ANALOGUE_OUT, OUTPUTS, acts=_ACTS_ANALOGUE),
        *_rows(0x9300, ANALOGUE_OUT, OUTPUTS, acts=_ACTS_ANALOGUE),
        *_rows(0x6340, ANALOGUE_ERROR_MODE, OUTPUTS, 1),
        *_rows(0x7341, ANALOGUE_ERROR_VALUE, OUTPUTS),
        *_rows(0x9341, ANALOGUE_ERROR_VALUE, OUTPUTS),
    ),
    terminals=(
        *_wires(0x7130, "in_analogue", INPUTS),
        *_wires(0x9130, "in_analogue", INPUTS),
        *_wires(0x7300, "out_analogue", OUTPUTS),
        *_wires(0x9300, "out_analogue", OUTPUTS),
    ),
    behaviour=IO401.behaviour,
    started=_started,
    check=_check,
)
"""A CiA 404 module: analogue inputs and outputs in counts."""
