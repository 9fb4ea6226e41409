"""Check that a live drive displays the mode of operation that bring-up wrote (6061h).

A drive may accept 6060h without an abort and keep its mode, for example if an option is not enabled. Its
EDS file does not say so, and a rehearsal does not show it. So bring-up reads 6061h when the nodes are
OPERATIONAL. A drive may need time for the change. A drive that displays 0 until it is enabled is reported
as a loss.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from coulombus.eds.cia402 import MODE_NAMES
from coulombus.eds.drive_axis import of_axis
from coulombus.host.errors import DeviceMismatch, SdoAborted
from coulombus.host.setup.device_plan import MODE_DISPLAY, NOT_SHOWN, SUPPORTED_MODES, DevicePlan
from coulombus.rigs.devices import drive_axis_of

__all__ = ["check_shown_mode", "mode_remedy", "mode_words"]

LONGEST_NS, STEP_NS = 500_000_000, 20_000_000
"""Longest time until a drive displays a mode, and period of the reads."""

Upload = Callable[[int, int], bytes]


def mode_words(mode: int) -> str:
    """Return a mode of operation with its name."""
    name = MODE_NAMES.get(mode, "the maker's own" if mode < 0 else "reserved")
    return f"{mode} ({name})"


def mode_remedy(plan: DevicePlan, upload: Upload) -> str:
    """Return the modes that the drive supports (6502h), and the remedy, as text."""
    number = drive_axis_of(plan.part)
    supported = of_axis(SUPPORTED_MODES, number)
    offered: Sequence[str] = ()
    if plan.description.has(supported):
        try:
            modes = int.from_bytes(upload(supported, 0), "little")
        except SdoAborted:
            modes = 0
        offered = [mode_words(bit + 1) for bit in range(16) if modes >> bit & 1]
    says = f"{supported:04X}h of the drive offers {', '.join(offered)}; " if offered else ""
    return f"{says}enable the mode in the drive, or name one that it takes ({plan.role}.mode)"


def check_shown_mode(plan: DevicePlan, upload: Upload, wait_ns: Callable[[int], None]) -> str:
    """Wait until a drive displays the mode that was written to it; return the loss, or "".

    Raises
    ------
    DeviceMismatch
        the drive displays another mode
    """
    if plan.mode is None or not plan.shows_mode:
        return ""
    index = of_axis(MODE_DISPLAY, drive_axis_of(plan.part))
    shown, waited_ns = _shown(upload, index), 0
    while shown is not None and shown != plan.mode and waited_ns < LONGEST_NS:
        wait_ns(STEP_NS)
        waited_ns += STEP_NS
        shown = _shown(upload, index)
    if shown is None or shown == plan.mode:
        return ""
    who = f"{plan.name} (node {plan.node_id})"
    if shown == 0:
        return f"{who}: {index:04X}h shows no mode before the drive is enabled; whether it takes {mode_words(plan.mode)} is not known"
    raise DeviceMismatch(
        f"{who}: {index:04X}h shows mode {mode_words(shown)}, {LONGEST_NS / 1e9:g} s after {mode_words(plan.mode)} was written; "
        f'{mode_remedy(plan, upload)}; host.accept = ["{plan.name}: {NOT_SHOWN}"] where {index:04X}h is wrong'
    )


def _shown(upload: Upload, index: int) -> int | None:
    """Return the mode that the drive displays; None if it has no such object."""
    try:
        return int.from_bytes(upload(index, 0), "little", signed=True)
    except SdoAborted:
        return None
