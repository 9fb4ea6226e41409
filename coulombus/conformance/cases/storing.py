"""Cases 8.1 to 8.10, K.1 and K.2: storing, restoring, verify configuration, restricted identifiers.

Source: CiA 301, sections 7.5.2.13, 14, 23, 7.3.5.
"""

from __future__ import annotations

from coulombus.conformance.tester.objects import volatile
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.sdo_checks import shown, text_object
from coulombus.conformance.tester.unit import STORE_IS_LOST, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where

__all__: list[str] = []

LOAD = b"load"
_STORED = "after store and reset"
STORE, RESTORE = 0x1010, 0x1011

RESTRICTED = (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x77F, 0x780, 0x7FF)
"""Ends of the ranges of table 38."""


def change(unit: Unit) -> tuple[int, int, bytes, bytes]:
    """Change a harmless communication parameter.

    Return its place, its old value, and its new value.
    """
    index, subindex, value = volatile(unit)
    before = unit.read(index, subindex)
    data = encode(unit.variable(index, subindex), value)
    if data == before:
        data = encode(unit.variable(index, subindex), 1 - value if index == 0x1029 else value + 1)
    unit.put(index, subindex, data)
    return index, subindex, before, data


def command(unit: Unit, index: int, subindex: int) -> None:
    """Write the signature."""
    if index == STORE:
        unit.save(subindex)
        return
    unit.sign(index, subindex, LOAD)


def is_now(unit: Unit, index: int, subindex: int, expected: bytes, when: str) -> None:
    """Fail unless an object has a value."""
    data = unit.read(index, subindex)
    if data != expected:
        cause = STORE_IS_LOST if when == _STORED else ""
        raise CaseFailed(f"{where(index, subindex)} is {data.hex()} {when}, expected {expected.hex()}", cause=cause)


@case("8.1", defaults=True, index=STORE)
@case("8.3", defaults=True, index=RESTORE)
def signature(unit: Unit, index: int) -> None:
    """Read the capability, and write the signature; the capability is unchanged."""
    unit.need_ability(index)
    command(unit, index, 1)
    value = unit.number(index, 1)
    if value != unit.abilities[index, 1]:
        raise CaseFailed(
            f"{where(index, 1)} is {value:08X}h after the signature, {unit.abilities[index, 1]:08X}h before"
        )
    unit.reset()
    unit.read(0x1000, 0)


@case("8.2", defaults=True, index=STORE)
@case("8.4", defaults=True, index=RESTORE)
def wrong_signature(unit: Unit, index: int) -> str:
    """Write wrong signatures: refused, and nothing is stored."""
    unit.need_ability(index)
    place = change(unit) if index == STORE else None
    signatures = (b"SAVE", b"evas", b"load") if index == STORE else (b"LOAD", b"daol", b"save")
    unit.stored = unit.dirty = True
    codes = [f"{unit.refused(index, 1, signature):08X}h" for signature in signatures]
    if place is not None:
        unit.reset()
        is_now(unit, place[0], place[1], place[2], "after a reset, though nothing was stored")
    return ", ".join(dict.fromkeys(codes))


@case("8.5", defaults=True)
def store(unit: Unit) -> str:
    """Change a parameter, store, change it again, reset: the stored value is back."""
    unit.need_ability(STORE)
    index, subindex, before, data = change(unit)
    command(unit, STORE, 1)
    unit.put(index, subindex, before)
    unit.reset()
    is_now(unit, index, subindex, data, _STORED)
    return where(index, subindex)


@case("8.6", defaults=True)
def store_groups(unit: Unit) -> str:
    """The same for the communication group, 1010h:02.

    An unstored change is lost with a reset.
    """
    unit.need_ability(STORE, 2)
    index, subindex, before, data = change(unit)
    command(unit, STORE, 2)
    unit.put(index, subindex, before)
    unit.reset()
    is_now(unit, index, subindex, data, "after 1010h:02 and reset")
    unit.put(index, subindex, before)
    unit.reset()
    is_now(unit, index, subindex, data, "after a reset without a further store")
    for subindex in sorted(unit.description.objects[STORE].variables):
        if 2 < subindex < 0xFF and unit.able(STORE, subindex):
            command(unit, STORE, subindex)
    return "the communication group"


def _restore(unit: Unit, group: int) -> str:
    unit.need_ability(STORE)
    unit.need_ability(RESTORE, group)
    index, subindex, before, data = change(unit)
    command(unit, STORE, 1)
    unit.reset()
    is_now(unit, index, subindex, data, _STORED)
    command(unit, RESTORE, group)
    is_now(unit, index, subindex, data, "after restore, before the reset")
    unit.reset()
    is_now(unit, index, subindex, before, "after restore and reset")
    return where(index, subindex)


@case("8.7", defaults=True)
def restore(unit: Unit) -> str:
    """Change and store a parameter, restore: it stays until the reset, and then has its default."""
    return _restore(unit, 1)


@case("8.8", defaults=True)
def restore_groups(unit: Unit) -> str:
    """The same for the communication group, 1011h:02."""
    return _restore(unit, 2)


@case("8.9", defaults=True)
def verify_configuration(unit: Unit) -> None:
    """Write date and time to 1020h, store, write others, reset: the stored ones are back."""
    unit.need_ability(STORE)
    unit.need_writable(0x1020, 1)
    expected = {1: (14_000).to_bytes(4, "little"), 2: (43_200_000).to_bytes(4, "little")}
    for subindex, data in expected.items():
        unit.put(0x1020, subindex, data)
    command(unit, STORE, 1)
    for subindex in expected:
        unit.put(0x1020, subindex, b"\1\0\0\0")
    unit.reset()
    for subindex, data in expected.items():
        is_now(unit, 0x1020, subindex, data, _STORED)


@case("8.10")
def restricted(unit: Unit) -> str:
    """Write every end of a restricted range to each identifier that can be configured, made invalid
    first: refused.
    """
    places = []
    for index, subindex in ((0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1400, 1), (0x1800, 1)):
        if unit.has(index, subindex) and unit.variable(index, subindex).access == "rw":
            places.append((index, subindex))
    if not places:
        raise NotApplicable("the EDS has no identifier that can be configured")
    done = []
    for index, subindex in places:
        cob_id = unit.number(index, subindex)
        if index in (0x1014, 0x1400, 0x1800):
            unit.write(index, subindex, cob_id | 1 << 31)
        try:
            unit.write(index, subindex, 0x6DF if index in (0x1005, 0x1012) else 0x80000000 | 0x6DF)
        except TransferAborted:
            continue  # it is not configurable after all
        for can_id in RESTRICTED:
            unit.refused(index, subindex, can_id)
        done.append(where(index, subindex))
    if not done:
        raise NotApplicable("no identifier can be configured")
    return ", ".join(done)


@case("K.1", defaults=True)
def verification_is_lost(unit: Unit) -> str:
    """Write date and time to 1020h, and change a parameter: both are 0, or stay, as the boot-up
    configuration has not changed yet.

    If they stay: store them, load the defaults and reset. That changes the boot-up configuration, and both are 0.
    """

    def date_and_time() -> list[int]:
        return [unit.number(0x1020, sub) for sub in (1, 2)]

    def tell() -> None:
        for sub in (1, 2):
            unit.put(0x1020, sub, (14_000).to_bytes(4, "little"))

    for sub in (1, 2):
        unit.need_writable(0x1020, sub)
    tell()
    index, subindex, value = volatile(unit)
    unit.put(index, subindex, encode(unit.variable(index, subindex), value))
    if not any(date_and_time()):
        return f"0 after {where(index, subindex)} was changed"
    for index in (0x1010, 0x1011):
        unit.need_ability(index)
    tell()
    unit.save()
    unit.sign(0x1011, 1, LOAD)
    unit.reset()
    left = date_and_time()
    if any(left):
        raise CaseFailed(f"1020h is {left[0]} and {left[1]} after the defaults were loaded, expected 0")
    return "0 after the defaults were loaded"


@case("K.2", defaults=True)
def only_the_group(unit: Unit) -> str:
    """Change a manufacturer-specific text, and store only the communication group: the text is lost with a reset."""
    unit.need_ability(0x1010, 2)
    index, subindex, before, text = text_object(unit)
    unit.put(index, subindex, text)
    unit.save(2)
    unit.reset()
    if shown(unit.read(index, subindex)) != shown(before):
        raise CaseFailed(f"{where(index, subindex)} has been stored with the communication group")
    return where(index, subindex)
