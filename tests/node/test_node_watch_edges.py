"""A node's watchdogs, function by function: each deadline at its nanosecond, each loss told once
and released when it is over.
"""

from __future__ import annotations

import pytest

from coulombus.node import deadlines, emcy, guarding, slots
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import number
from coulombus.node.record import new_nodes
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import new_queue

KIND_BRAKE = number(BRAKE404)
KIND_DRIVE = number(DRIVE402)

T = 5_000_000_000
WAITING, ALIVE, LOST = 0, 1, 2
COMMUNICATION = [emcy.HEARTBEAT, emcy.LIFE_GUARDING, emcy.RPDO_DEADLINE, emcy.SYNC_LOST]
CODES = {emcy.HEARTBEAT: 0x8130, emcy.LIFE_GUARDING: 0x8130, emcy.RPDO_DEADLINE: 0x8250, emcy.SYNC_LOST: 0x8700}


class Node:
    """Node 9 in row 1 of two, OPERATIONAL, that watches nothing yet."""

    def __init__(self, kind=KIND_BRAKE):
        self.nodes = new_nodes(2)
        self.out = new_queue()
        n = self.n = self.nodes[1]
        n.node_id, n.kind, n.nmt, n.powered, n.emcy_id = 9, kind, 5, 1, 0x89
        n.next_ns = T + 10**9
        n.rpdo_used, n.consumers_used, n.sdo_used = 3, 3, 2

    def sent(self):
        rows = self.out.frames[: int(self.out["count"])]
        self.out["count"] = 0
        return [tuple(int(row[name]) for name in ("t_ns", "can_id", "length", "word")) for row in rows]

    def codes(self):
        return [word & 0xFFFF for _, can_id, _, word in self.sent() if can_id == 0x89]

    def lose(self, *causes):
        for cause in causes:
            emcy.come(self.n, T, cause, 0, self.out)
        self.sent()

    def settle(self):
        deadlines.settle(self.n, T, self.out)
        return {cause for cause in COMMUNICATION if not self.n.causes >> cause & 1}

    def expire(self, t_ns=T):
        return deadlines.expire(self.n, t_ns, self.out)

    def hear(self, k, t_ns, length=1, word=5):
        deadlines.heartbeat_received(self.n, k, t_ns, length, word, self.out)

    def deadline(self, before=NEVER_NS):
        return deadlines.next_deadline(self.n, before)


# a heartbeat that comes


@pytest.mark.parametrize("k", [0, 2])
def test_the_first_heartbeat_begins_the_watch(k):
    node = Node()
    n = node.n
    n.consumer_ns[k] = 30
    node.hear(k, T)
    assert (n.consumer_state[k], n.consumer_last_ns[k], n.next_ns) == (ALIVE, T, T + 30)
    assert (n.consumer_state[1], n.consumer_last_ns[1]) == (WAITING, 0)
    n.next_ns = T + 7
    n.consumer_state[k] = WAITING
    node.hear(k, T)
    assert n.next_ns == T + 7
    n.next_ns = T + 10**9
    node.hear(k, T + 20)
    assert (n.consumer_last_ns[k], n.next_ns) == (T + 20, T + 10**9)  # only its time is kept
    assert node.sent() == []


@pytest.mark.parametrize(("length", "word", "dropped"), [(0, 5, 1), (1, 0, 0), (1, 0x80, 0), (1, 0x8000, 0)])
def test_an_empty_frame_and_a_boot_up_are_no_heartbeat(length, word, dropped):
    node = Node()
    n = node.n
    n.consumer_last_ns[0], n.consumer_state[0] = 3, LOST
    node.hear(0, T, length, word)
    assert (n.consumer_last_ns[0], n.consumer_state[0], n.dropped_length) == (3, LOST, dropped)


@pytest.mark.parametrize("data", [1, 4, 5, 0x7F, 0x85, 0xC0])
def test_any_other_state_is_a_heartbeat_and_ends_the_loss(data):
    node = Node()
    node.lose(emcy.HEARTBEAT)
    node.n.consumer_state[2] = LOST
    node.hear(2, T, 1, data)
    assert node.n.causes == 0
    assert node.codes() == [0x0000]


def test_a_first_heartbeat_releases_nothing_else():
    node = Node()
    node.lose(emcy.RPDO_DEADLINE)  # would be released by settle
    node.hear(0, T)
    assert node.n.causes == 1 << emcy.RPDO_DEADLINE


# what is over is released


HOLD = {
    emcy.HEARTBEAT: lambda n: n.consumer_state.__setitem__(2, LOST),
    emcy.LIFE_GUARDING: lambda n: setattr(n, "guard_state", guarding.LOST),
    emcy.RPDO_DEADLINE: lambda n: n.rpdo_lost.__setitem__(2, 1),
    emcy.SYNC_LOST: lambda n: setattr(n, "sync_armed", 1),
}


@pytest.mark.parametrize("present", [(), *((cause,) for cause in COMMUNICATION), tuple(COMMUNICATION)])
def test_a_loss_that_is_over_is_released_and_one_that_lasts_is_not(present):
    node = Node()
    node.lose(*COMMUNICATION)
    for cause in present:
        HOLD[cause](node.n)
    released = node.settle()
    assert released == set(COMMUNICATION) - set(present)
    assert node.codes() == [0x0000] * len(released)
    assert node.n.latched == sum(1 << cause for cause in present)
    assert node.settle() == released
    assert node.codes() == []  # told once


@pytest.mark.parametrize("state", [WAITING, ALIVE])
def test_a_life_guarding_that_is_no_longer_lost_is_released_in_either_state(state):
    node = Node()
    node.lose(emcy.LIFE_GUARDING)
    node.n.guard_state = state
    assert emcy.LIFE_GUARDING in node.settle()
    assert node.codes() == [0x0000]


@pytest.mark.parametrize("cause", [*COMMUNICATION, emcy.SUPPLY, emcy.ERROR_PASSIVE])
def test_only_what_is_present_is_released(cause):
    """Of a latch without its cause nothing is told, whatever else is present."""
    node = Node()
    node.lose(*COMMUNICATION)
    node.n.causes = 1 << cause
    node.settle()
    assert node.codes() == [0x0000] * (cause in COMMUNICATION)
    assert node.n.latched == sum(1 << other for other in COMMUNICATION if other != cause)


def test_what_is_not_in_use_is_not_lost():
    node = Node()
    node.lose(*COMMUNICATION)
    node.n.consumer_state[3], node.n.rpdo_lost[3] = LOST, 1
    assert node.settle() == set(COMMUNICATION)


def test_outside_operational_neither_sync_nor_rpdos_are_expected():
    node = Node()
    n = node.n
    node.lose(*COMMUNICATION)
    n.sync_armed, n.guard_state, n.consumer_state[1] = 1, guarding.LOST, LOST
    n.rpdo_armed[:4], n.rpdo_lost[:4] = 1, 1
    deadlines.stop(n, T, node.out)
    assert n.sync_armed == 0
    assert n.rpdo_armed[:4].tolist() == n.rpdo_lost[:4].tolist() == [0, 0, 0, 1]
    assert n.causes == 1 << emcy.HEARTBEAT | 1 << emcy.LIFE_GUARDING
    assert node.codes() == [0x0000] * 2


# what is late


@pytest.mark.parametrize("late_ns", [-1, 0, 1, 999, 1000, 1001, 5000])
def test_the_nodes_own_heartbeat_goes_out_at_its_time_without_a_burst(late_ns):
    node = Node()
    n = node.n
    n.heartbeat_ns, n.heartbeat_next_ns, n.nmt = 1000, T - late_ns, 127
    assert node.expire() == 0
    assert node.sent() == ([(T, 0x709, 1, 127)] if late_ns >= 0 else [])
    following = {-1: T + 1, 0: T + 1000, 1: T + 999, 999: T + 1}.get(late_ns, T + 1000)
    assert n.heartbeat_next_ns == following
    assert int(node.out.frames[0].source) == (1 if late_ns >= 0 else 0)


@pytest.mark.parametrize(("period", "sent"), [(0, 0), (1, 1), (-1, 0)])
def test_a_heartbeat_of_no_period_is_none(period, sent):
    node = Node()
    node.n.heartbeat_ns, node.n.heartbeat_next_ns = period, T - 5
    node.expire()
    assert len(node.sent()) == sent
    assert node.deadline() == (T + 1 if period == 1 else NEVER_NS)
    assert node.deadline(T - 3) == T - 3


@pytest.mark.parametrize("waiting", [0, 1])
def test_an_emcy_that_waits_goes_out_when_the_inhibit_time_is_over(waiting):
    node = Node()
    n = node.n
    n.emcy_waiting, n.emcy_word[0], n.emcy_ready_ns = waiting, 0x8130, T
    assert node.deadline() == (T if waiting else NEVER_NS)
    assert node.deadline(T - 3) == T - 3
    node.expire(T - 1)
    assert node.codes() == []
    node.expire()
    assert node.codes() == [0x8130] * waiting


@pytest.mark.parametrize("k", [0, 2])
@pytest.mark.parametrize("period", [1, 100])
def test_a_heartbeat_is_lost_at_its_time_and_told_with_its_producer(k, period):
    node = Node()
    n = node.n
    n.consumer_state[k], n.consumer_ns[k], n.consumer_last_ns[k], n.consumer_id[k] = ALIVE, period, T - period, 0x7F
    assert node.deadline() == T
    assert node.deadline(T - 3) == T - 3
    assert node.expire(T - 1) == 0
    assert (n.consumer_state[k], n.causes) == (ALIVE, 0)
    assert node.expire() == 1
    assert (n.consumer_state[k], n.causes) == (LOST, 1 << emcy.HEARTBEAT)
    ((_, _, _, word),) = node.sent()
    assert (word & 0xFFFF, word >> 24) == (0x8130, 0x7F)
    assert node.deadline() == NEVER_NS
    assert node.expire(T + 10**9) == 0
    assert node.codes() == []


@pytest.mark.parametrize("state", [WAITING, LOST])
def test_a_producer_that_waits_or_is_lost_is_not_lost_again(state):
    node = Node()
    node.n.consumer_state[0], node.n.consumer_ns[0] = state, 10
    assert node.expire() == 0
    assert node.n.causes == 0
    assert node.deadline() == NEVER_NS


def test_each_producer_that_is_lost_is_told_of_and_other_latches_stay():
    node = Node()
    n = node.n
    node.lose(emcy.RPDO_SHORT, emcy.HEARTBEAT, emcy.SYNC_LOST)
    n.consumer_state[1], n.consumer_ns[1], n.consumer_last_ns[1] = ALIVE, 10, T - 10
    assert node.expire() == 1
    assert node.codes() == [0x8130]
    assert n.latched == 1 << emcy.RPDO_SHORT | 1 << emcy.HEARTBEAT | 1 << emcy.SYNC_LOST


def test_an_entry_beyond_those_in_use_is_not_watched():
    node = Node()
    n = node.n
    n.consumer_state[3], n.consumer_ns[3] = ALIVE, 10
    n.rpdo_armed[3], node.n.rpdo[3].cob_id, node.n.rpdo[3].event_ns = 1, 0x209, 10
    n.sdo_deadline_ns[2] = T - 1
    assert node.expire() == 0
    assert node.sent() == []
    assert node.deadline() == NEVER_NS


def test_guarding_is_lost_at_its_time():
    node = Node()
    n = node.n
    n.guard_state, n.guard_life_ns, n.guard_last_ns = ALIVE, 300, T - 300
    assert node.deadline() == T
    assert node.deadline(T - 3) == T - 3
    assert node.expire(T - 1) == 0
    assert node.expire() == 1
    assert (n.guard_state, n.causes) == (guarding.LOST, 1 << emcy.LIFE_GUARDING)
    ((_, _, _, word),) = node.sent()
    assert (word & 0xFFFF, word >> 24) == (0x8130, 0)
    assert node.expire(T + 1) == 0
    assert node.codes() == []


def deadline(node, k=2, period=1000, cob_id=0x209):
    p = node.n.rpdo[k]
    p.cob_id, p.event_ns = cob_id, period
    node.n.rpdo_armed[k], node.n.rpdo_ns[k] = 1, T - period
    return p


@pytest.mark.parametrize("k", [0, 2])
@pytest.mark.parametrize(("cob_id", "period"), [(0x209, 1000), (0, 1000), (0x209, 1)])
def test_an_rpdo_is_late_at_its_time_and_told_with_its_number(k, cob_id, period):
    node = Node()
    n = node.n
    deadline(node, k, period, cob_id)
    assert node.deadline() == T
    assert node.deadline(T - 3) == T - 3
    assert node.expire(T - 1) == 0
    assert n.rpdo_lost[k] == 0
    assert node.expire() == 0  # 1029h:01 is not asked
    assert (n.rpdo_lost[k], n.causes) == (1, 1 << emcy.RPDO_DEADLINE)
    ((_, _, _, word),) = node.sent()
    assert (word & 0xFFFF, word >> 24) == (0x8250, k + 1)
    assert node.deadline() == NEVER_NS
    n.latched = 0
    node.expire(T + 10**9)
    assert node.codes() == []


@pytest.mark.parametrize("nmt", [0, 4, 127])
@pytest.mark.parametrize("watched", ["rpdo", "sync"])
def test_rpdos_and_syncs_are_expected_in_operational_only(nmt, watched):
    node = Node()
    n = node.n
    if watched == "rpdo":
        deadline(node)
    else:
        n.sync_armed, n.sync_ns, n.values[slots.SYNC_TIMEOUT_US] = 1, T - 10**8, 20_000
    n.nmt = nmt
    assert node.deadline() == NEVER_NS
    node.expire()
    assert n.causes == 0


@pytest.mark.parametrize("off", ["armed", "cob_id", "event_ns", "lost"])
def test_an_rpdo_that_is_not_watched_is_not_late(off):
    node = Node()
    p, n = deadline(node), node.n
    if off == "armed":
        n.rpdo_armed[2] = 0
    elif off == "cob_id":
        p.cob_id = -1
    elif off == "event_ns":
        p.event_ns = 0
    else:
        n.rpdo_lost[2] = 1
    assert node.deadline() == NEVER_NS
    node.expire(T + 10**9)
    assert n.causes == 0


@pytest.mark.parametrize("timeout_us", [1, 20_000])
@pytest.mark.parametrize("other", [0, 1 << emcy.SUPPLY])
def test_sync_is_lost_at_its_time_and_told_once(timeout_us, other):
    node = Node()
    n = node.n
    n.causes = other
    n.sync_armed, n.sync_ns, n.values[slots.SYNC_TIMEOUT_US] = 1, T - 1000 * timeout_us, timeout_us
    assert node.deadline() == T
    assert node.deadline(T - 3) == T - 3
    assert node.expire(T - 1) == 0
    assert n.causes == other
    assert node.expire() == 0
    assert n.causes == other | 1 << emcy.SYNC_LOST
    ((_, _, _, word),) = node.sent()
    assert (word & 0xFFFF, word >> 24) == (0x8700, 0)
    assert node.deadline() == NEVER_NS
    n.latched = 0
    node.expire(T + 10**9)
    assert node.codes() == []


@pytest.mark.parametrize(("armed", "timeout_us"), [(0, 20_000), (1, 0)])
def test_sync_is_not_expected_before_the_first_nor_without_a_time(armed, timeout_us):
    node = Node()
    n = node.n
    n.sync_armed, n.sync_ns, n.values[slots.SYNC_TIMEOUT_US] = armed, T - 10**9, timeout_us
    assert node.deadline() == NEVER_NS
    node.expire()
    assert n.causes == 0


def test_a_drives_losses_are_faults():
    node = Node(KIND_DRIVE)
    n = node.n
    deadline(node)
    n.power_state = 4
    node.expire()
    assert n.power_state == 7


@pytest.mark.parametrize("k", [0, 1])
@pytest.mark.parametrize("nmt", [4, 5, 127])
def test_a_stale_sdo_transfer_is_aborted_at_its_time_unless_stopped(k, nmt):
    node = Node()
    n = node.n
    n.nmt, n.processing_ns = nmt, 20
    n.sdo_deadline_ns[k], n.sdo_abort_id[k], n.sdo_abort_word[k] = T, 0x589, 0x0504_0000 << 32
    assert node.deadline() == T
    assert node.deadline(T - 3) == T - 3
    node.expire(T - 1)
    assert node.sent() == []
    node.expire()
    assert node.sent() == ([] if nmt == 4 else [(T + 20, 0x589, 8, 0x0504_0000 << 32)])
    assert n.sdo_deadline_ns[k] == NEVER_NS
    assert node.deadline() == NEVER_NS


# node guarding


def answered(node, t_ns=T):
    guarding.answer(node.n, t_ns, node.out)
    return node.sent()


@pytest.mark.parametrize("nmt", [4, 5, 127])
def test_the_answer_tells_the_state_and_a_bit_that_alternates(nmt):
    node = Node()
    node.n.guard_on, node.n.nmt, node.n.processing_ns = 1, nmt, 20
    assert answered(node) == [(T + 20, 0x709, 1, nmt)]
    assert answered(node) == [(T + 20, 0x709, 1, 0x80 | nmt)]
    assert answered(node) == [(T + 20, 0x709, 1, nmt)]
    assert int(node.out.frames[0].source) == 1
    assert node.n.guard_state == WAITING  # there is no life time


@pytest.mark.parametrize(("on", "nmt"), [(0, 5), (1, 0)])
def test_nothing_is_answered_without_guarding_or_before_the_boot_up(on, nmt):
    node = Node()
    node.n.guard_on, node.n.nmt, node.n.guard_life_ns = on, nmt, 300
    assert answered(node) == []
    assert (node.n.guard_toggle, node.n.guard_state) == (0, WAITING)


@pytest.mark.parametrize("life_ns", [1, 300])
@pytest.mark.parametrize("next_ns", [T, T + 10**9])
@pytest.mark.parametrize("state", [WAITING, ALIVE, LOST])
def test_a_remote_frame_begins_the_life_time_and_ends_the_loss(state, life_ns, next_ns):
    node = Node()
    n = node.n
    node.lose(emcy.LIFE_GUARDING)
    n.guard_on, n.guard_life_ns, n.guard_state, n.next_ns = 1, life_ns, state, next_ns
    frames = answered(node)
    assert (n.guard_state, n.guard_last_ns) == (ALIVE, T)
    assert n.next_ns == (next_ns if state == ALIVE else min(next_ns, T + life_ns))
    assert [word & 0xFFFF for _, can_id, _, word in frames if can_id == 0x89] == [0] * (state == LOST)
    assert (n.causes == 0) == (state == LOST)


@pytest.mark.parametrize(("state", "life_ns"), [(WAITING, 300), (LOST, 300), (ALIVE, 0)])
def test_guarding_that_is_not_watched_is_never_late(state, life_ns):
    node = Node()
    n = node.n
    n.guard_state, n.guard_life_ns, n.guard_last_ns = state, life_ns, T - 10**9
    assert not guarding.late(n, T)
    assert guarding.next_deadline(n, T + 7) == T + 7


@pytest.mark.parametrize("life_ns", [1, 300])
def test_guarding_is_late_when_its_life_time_is_over(life_ns):
    n = Node().n
    n.guard_state, n.guard_life_ns, n.guard_last_ns = ALIVE, life_ns, T - life_ns
    assert guarding.late(n, T)
    assert not guarding.late(n, T - 1)
    assert guarding.next_deadline(n, T + 7) == T
    assert guarding.next_deadline(n, T - 7) == T - 7


def test_guarding_begins_anew_with_toggle_0_and_waits():
    n = Node().n
    n.guard_toggle, n.guard_state = 1, LOST
    guarding.restart(n)
    assert (n.guard_toggle, n.guard_state) == (0, WAITING)
