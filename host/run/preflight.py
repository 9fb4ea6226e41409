"""Checks of a live run before anything is armed, and the texts of refusals."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from coulombus.host.errors import SafetyTrip
from coulombus.rigs.draft.draft_text import CHECK, REHEARSAL, rehearsal_marks
from coulombus.rigs.draft.marks import guesses
from coulombus.rigs.rig import Rig, RigError
from coulombus.system.errors import CoulombusError
from coulombus.wire.address import BusAddress

__all__ = ["check_no_delay", "check_no_guess", "check_no_rehearsal", "place_of", "refusing"]

PROJECT = Path(__file__).parents[__name__.count(".") - 1]
"""Folder of the package."""


def check_no_rehearsal(rig: Rig, address: BusAddress) -> None:
    """Refuse a rig file for simulated devices on a real bus.

    Raises
    ------
    RigError
        the file has marks of `coulombus init --rehearse`; the text names each line
    """
    marks = rehearsal_marks(rig.origin.text) if address.moves_hardware else ()
    if marks:
        expected = f"enter the value of the device on {address}, and delete the mark"
        raise RigError([f"{rig.path}:{line}: still marked '# {REHEARSAL}': {expected}" for line in marks])


def check_no_guess(rig: Rig, address: BusAddress) -> None:
    """Refuse a rig file on a real bus with a guess that could move the hand.

    Raises
    ------
    RigError
        the file still marks guesses of `coulombus init` about the drive's torque, scale or sign; the
        text names each
    """
    left = [guess for guess in guesses(rig.origin.text) if guess.moves_hand] if address.moves_hardware else []
    if left:
        expected = "prove it on the device, and delete the mark: a wrong guess moves the hand"
        raise RigError([f"{rig.path}:{guess.line}: {guess.key} is marked '# {CHECK}'; {expected}" for guess in left])


def check_no_delay(rig: Rig, address: BusAddress) -> None:
    """Refuse an artificial delay on a live bus, where a hand may be on the handle.

    Raises
    ------
    RigError
        `bus.delay_cycles` is above 1
    """
    if rig.bus.cycles_to_actuation > 1:
        expected = f"1 or no such key on {address}: a longer delay is for study in virtual time (coulombus simulate)"
        raise rig.axes[0].mistake("bus.delay_cycles", expected)


@contextmanager
def refusing() -> Iterator[None]:
    """Turn an unexpected error before arming into a refusal (status 7). After arming it is a trip.

    Raises
    ------
    SafetyTrip
        an error that is not a `CoulombusError`
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, CoulombusError):
            raise
        text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise SafetyTrip(f"arming refused: {text} ({place_of(error.__traceback__)})") from error


def place_of(trace: TracebackType | None) -> str:
    """Return the file and line of an error's origin: the innermost of this project, not of a library."""
    place = ""
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if file.is_relative_to(PROJECT):
            place = f"{file.name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place
