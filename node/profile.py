"""Definition of a kind of device: the objects that it acts on, its fields in the record, its behaviour.

A device's communication (NMT, PDO, SDO, EMCY ...) is the same for all kinds. A kind adds a
`Profile`, in the module of its behaviour; `node.kinds` lists them. An object that a file lacks
leaves its slot at `CoreObject.absent`, so that a kind works with any vendor's file as far as the
file's objects allow; `Profile.missing` lists the missing objects that the kind requires.

    n : the `NodeRecord`
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol, TypeAlias, get_type_hints

from coulombus.eds.cia301 import abort_text
from coulombus.kernels.decorator import constant, kernel
from coulombus.kernels.records import Record
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue

__all__ = [
    "BY_COMMAND",
    "BY_ITSELF",
    "BY_RESET",
    "SUPPLY_LOST",
    "SUPPLY_MISSING",
    "SUPPLY_THERE",
    "Behaviour",
    "CoreObject",
    "Key",
    "Objects",
    "Profile",
    "SdoAbort",
    "Terminal",
]


class SdoAbort(Exception):
    """An SDO service is aborted; the client receives `code`."""

    def __init__(self, code: int) -> None:
        super().__init__(abort_text(code))
        self.code = code


Key: TypeAlias = tuple[int, int]
"""Index and sub-index of an object."""


BY_COMMAND, BY_RESET, BY_ITSELF = constant(0), constant(1), constant(2)
"""Reason why NMT left OPERATIONAL: a command, a reset (safe output regardless of the option codes),
1029h.
"""

SUPPLY_THERE, SUPPLY_MISSING, SUPPLY_LOST = 0, 1, 2
"""Results of `Behaviour.supply`: present (or irrelevant), missing, missing while it is needed, which is a
fault.
"""


@dataclass(frozen=True)
class CoreObject:
    """An object that a kind's core reads or writes.

    Attributes
    ----------
    index, subindex : the object
    slot : its index in the record's `values`
    absent : the slot's value if the file has no such object
    acts : bit of the record's `rpdo_carries`: the core acts when the object is written; 0: it does not
    changing : whether it changes all the time, so that its change is no event for a TPDO with an
        event timer
    needed : whether the kind cannot act without it
    named : it is manufacturer-specific, 2000h to 5FFFh, and was named by a person who knows the
        device
    """

    index: int
    subindex: int
    slot: int
    absent: int = 0
    acts: int = 0
    changing: bool = False
    needed: bool = False
    named: bool = False

    @property
    def key(self) -> Key:
        """Index and sub-index of the object."""
        return self.index, self.subindex


@dataclass(frozen=True)
class Terminal:
    """Physical input or output of a kind's core, to which a simulated rig or hardware is connected.

    Attributes
    ----------
    index, subindex : its object on the bus
    field : of the record; a name that begins with ``out_`` is an output
    k : its index in the field; -1: the field is a single number
    low, high : fields that bound an output to the range of its hardware, "": none
    """

    index: int
    subindex: int
    field: str
    k: int = -1
    low: str = ""
    high: str = ""

    @property
    def key(self) -> Key:
        """Index and sub-index of the object."""
        return self.index, self.subindex

    @property
    def is_output(self) -> bool:
        """Whether the core writes the field."""
        return self.field.startswith("out_")


class Objects(Protocol):
    """A kind's view of the object dictionary (`node.dictionary`)."""

    def number(self, index: int, subindex: int = 0, fallback: int = 0) -> int:
        """Return an integer object, or `fallback` if the file does not have it."""

    def own_number(self, index: int, subindex: int, fallback: int) -> int:
        """Return an integer object of 2000h to 5FFFh of our own devices; `fallback` in another vendor's file."""

    def real(self, index: int, subindex: int, fallback: float) -> float:
        """Return a numeric object, or `fallback` if the file does not have it."""

    def high(self, index: int, subindex: int, fallback: int) -> int:
        """Return the largest value that the file allows for an object, `fallback` if it sets no limit."""

    def __contains__(self, key: Key) -> bool: ...

    def __setitem__(self, key: Key, value: float) -> None: ...


@kernel
def _nothing(n: NodeRecord) -> None:
    pass


@kernel
def _nothing_at(n: NodeRecord, t_ns: int) -> None:
    pass


@kernel
def _no_action(n: NodeRecord, t_ns: int, received_ns: int, carries: int, out: Queue) -> None:
    pass


@kernel
def _no_reaction(n: NodeRecord, t_ns: int, cause: int) -> None:
    pass


@kernel
def _no_loss(n: NodeRecord, t_ns: int, why: int) -> int:
    return 0


@kernel
def _no_supply(n: NodeRecord) -> int:
    return SUPPLY_THERE


@kernel
def _no_deadline(n: NodeRecord, t_ns: int, next_ns: int) -> int:
    return next_ns


class Behaviour(NamedTuple):
    """The compiled part of a kind: kernels, which `node.reactions`
    calls. By default each does nothing.

    Attributes
    ----------
    sample : (n) write the measurements to the slots
    actuate : (n, t_ns) compute the output at `t_ns`
    apply : (n, t_ns, received_ns, carries, out) act on written slots; `carries`: the bits `acts` of
        their objects
    connection_lost : (n, t_ns, why) make the output safe after NMT left OPERATIONAL; return 1 to
        report it as a fault
    react : (n, t_ns, cause) make the output safe if a cause of `node.emcy` requires it
    detect : (n, t_ns) update `detected`, the faults that the device detects itself, from its inputs
    supply : (n) -> SUPPLY_...
    next_deadline : (n, t_ns, next_ns) -> the earlier of `next_ns` and the kind's own next deadline
    number : of the kind, as in the record's `kind`; `node.kinds` assigns it
    """

    sample: Callable[[NodeRecord], None] = _nothing
    actuate: Callable[[NodeRecord, int], None] = _nothing_at
    apply: Callable[[NodeRecord, int, int, int, Queue], None] = _no_action
    connection_lost: Callable[[NodeRecord, int, int], int] = _no_loss
    react: Callable[[NodeRecord, int, int], None] = _no_reaction
    detect: Callable[[NodeRecord, int], None] = _nothing_at
    supply: Callable[[NodeRecord], int] = _no_supply
    next_deadline: Callable[[NodeRecord, int, int], int] = _no_deadline
    number: int = 0


_NO_BEHAVIOUR = Behaviour()


def _not_started(record: NodeRecord, objects: Objects, t_ns: int) -> None:
    pass


def _not_changed(record: NodeRecord, objects: Objects, index: int, subindex: int) -> None:
    pass


def _allowed(objects: Objects, index: int, subindex: int, value: int) -> None:
    pass


@dataclass(frozen=True)
class Profile:
    """A kind of device.

    Attributes
    ----------
    name : in the command line and in messages
    objects : used by its core
    behaviour : its kernels
    fields : its fields in the record, in addition to those of every node: a base class of
        `NodeRecord`. Inputs begin with ``in_``, outputs, which are 0 while the device is off, with ``out_``
    terminals : physical inputs and outputs
    product : 1018h:02 of this project's own device of that kind
    held : causes of `node.emcy` (bits) that stay latched until the kind's own fault reset
    started : (record, objects, t_ns) begin with the present values of the objects: at power-on and
        after "reset node"
    powered_on : (record, t_ns) after `started`, at power-on only
    changed : (record, objects, index, subindex) an object from 2000h on was written: update the
        quantities computed from it
    check : (objects, index, subindex, value) raise `SdoAbort` unless a client may write an integer
    """

    name: str
    objects: tuple[CoreObject, ...] = ()
    behaviour: Behaviour = _NO_BEHAVIOUR
    fields: type[Record] = Record
    terminals: tuple[Terminal, ...] = ()
    product: int | None = None
    held: int = 0
    started: Callable[[NodeRecord, Objects, int], None] = _not_started
    powered_on: Callable[[NodeRecord, int], None] = _nothing_at
    changed: Callable[[NodeRecord, Objects, int, int], None] = _not_changed
    check: Callable[[Objects, int, int, int], None] = _allowed

    @cached_property
    def acts(self) -> Mapping[Key, int]:
        """Objects on whose writing the core acts, with their bits of `rpdo_carries`."""
        return {row.key: row.acts for row in self.objects if row.acts}

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Fields that are 0 while the device is off."""
        return tuple(name for name in get_type_hints(self.fields) if name.startswith("out_"))

    def fitted(self, *rows: CoreObject, without: Collection[Key] = ()) -> Profile:
        """Return the kind fitted to a device: with further objects, and without those in `without`."""
        keys = {*without, *(row.key for row in rows)}
        return replace(self, objects=(*(row for row in self.objects if row.key not in keys), *rows))

    def missing(self, objects: Objects) -> tuple[Key, ...]:
        """Return the objects that the kind requires and a file does not have."""
        return tuple(row.key for row in self.objects if row.needed and row.key not in objects)
