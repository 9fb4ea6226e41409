"""CiA 301's NMT state machine as a table: every command in every state, what each state allows,
what an error leads to.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.eds.nmt import AFTER_ERROR, ALLOWED, AUTOMATIC, NEXT_STATE, STATES, TRANSITIONS, Service

INIT, PRE, OP, STOP = NmtState.INITIALISING, NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED
LED_TO = {
    NmtCommand.START: OP,
    NmtCommand.STOP: STOP,
    NmtCommand.ENTER_PRE_OPERATIONAL: PRE,
    NmtCommand.RESET_NODE: INIT,
    NmtCommand.RESET_COMMUNICATION: INIT,
}


@pytest.mark.parametrize("command", NmtCommand)
@pytest.mark.parametrize("state", NmtState)
def test_a_command_leads_to_its_state_from_every_state_after_the_boot_up(state, command):
    end = NEXT_STATE.get((state, command))
    assert end == (None if state == INIT or LED_TO[command] == state else LED_TO[command])


def test_the_transitions_have_the_numbers_of_cia_301_each_once():
    assert [row[0] for row in TRANSITIONS] == list(range(3, 15))
    assert [when for state, when, _, _ in AUTOMATIC if state in (None, INIT)] == ["power on (1)", "boot-up (2)"]


ALLOWED_IN = {
    Service.BOOT_UP: {INIT},
    Service.NMT: {PRE, OP, STOP},
    Service.ERROR_CONTROL: {PRE, OP, STOP},
    Service.SDO: {PRE, OP},
    Service.SYNC: {PRE, OP},
    Service.TIME: {PRE, OP},
    Service.EMCY: {PRE, OP},
    Service.PDO: {OP},
}


@pytest.mark.parametrize("service", Service)
def test_a_service_is_allowed_in_its_states_only(service):
    allowed = {NmtState(k) for k in np.flatnonzero(ALLOWED & service)}
    assert allowed == ALLOWED_IN[service]
    assert {row.state for row in STATES} == set(NmtState)


@pytest.mark.parametrize("state", NmtState)
def test_1029h_says_what_an_error_leads_to(state):
    assert AFTER_ERROR[0, state] == (PRE if state == OP else state)
    assert AFTER_ERROR[1, state] == state
    assert AFTER_ERROR[2, state] == (STOP if state in (OP, PRE) else state)
