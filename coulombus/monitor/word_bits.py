"""Texts for status- and controlwords: the state or command, and the other bits."""

from __future__ import annotations

from coulombus.eds.cia402 import (
    COMMAND_OF_CONTROLWORD,
    CONTROLWORD_FIELDS,
    STATE_OF_STATUSWORD,
    STATUSWORD_FIELDS,
    Command,
    PowerState,
)
from coulombus.monitor.snapshot import Value

__all__ = ["WORDS", "bits_set", "meaning"]

WORDS = {"statusword": STATUSWORD_FIELDS, "controlword": CONTROLWORD_FIELDS}


def meaning(value: Value) -> str:
    """Return the power state of a statusword, or the command of a controlword; "" for other values."""
    if value.value is None:
        return ""
    name, word = value.name.rpartition(".")[2], int(value.value)
    if name == "statusword":
        state = int(STATE_OF_STATUSWORD[word & 0x7F])
        return PowerState(state).name.lower().replace("_", " ") if state >= 0 else "unknown state"
    if name == "controlword":
        command = Command.FAULT_RESET if word & 0x80 else Command(COMMAND_OF_CONTROLWORD[word & 0x0F])
        return command.name.lower().replace("_", " ")
    return ""


def bits_set(value: Value) -> str:
    """Return the names of set bits other than the state or command."""
    fields = WORDS.get(value.name.rpartition(".")[2], ())
    word = 0 if value.value is None else int(value.value)
    return ", ".join(field.name.replace("_", " ") for field in fields[1:] if word & field.mask)
