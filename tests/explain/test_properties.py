"""A verdict is a property of the frames: not of the blocks in which they are read, of what was before, or of others."""

from __future__ import annotations

import random

import numpy as np
import pytest

from benchmarks.explain_runs import outcome
from cases import thorough
from coulombus.eds.eds_folder import EdsFiles
from coulombus.explain.explained import Explainer
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_word
from coulombus.wire.frame import FRAME
from explain_log import MS, TYPE_402, Log, machine

NAMES = (
    *("node_off", "pair", "left_alone", "brown_out_and_back", "reset_in_vain", "master_gone", "set_points_stop"),
    *("second_master", "second_sync", "babble", "full_bus", "duplicate_node"),
)
"""What is done in runs of the generator: what is lost and comes back, two masters and SYNC producers, floods."""


def told(explanation):
    """Return the incidents with their clues, as a reader has them."""
    return [
        (
            (incident.root.kind, incident.node, incident.status, incident.begin_ns, incident.end_ns, incident.who),
            [(c.kind, c.node, c.begin_ns, c.end_ns, c.text, c.count, c.end_text, c.rows) for c in incident.clues],
        )
        for incident in explanation.incidents
    ]


def heads(explanation, shift_ms=0.0):
    """Return kind, node, state and begin of each incident, `shift_ms` earlier."""
    return sorted(
        (i.root.kind, str(i.node), i.status, i.begin_ns - round(shift_ms * MS)) for i in explanation.incidents
    )


def explained(frames, size=None, files=None, live=False):
    explainer = Explainer(KnownBus(eds=files or EdsFiles()))
    for start in range(0, len(frames), size or len(frames)):
        explainer.add_frames(frames[start : start + (size or len(frames))])
        if live:
            explainer.note_overdue()
    explainer.end()
    return explainer.explanation()


def run_of(name):
    """Return a run's frames, and a function that makes its EDS files anew."""
    run = outcome(NAMES.index(name) + 7, name)
    return run.frames, lambda: run.machine.files


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_blocks_in_which_a_log_is_read_change_nothing(name):
    frames, files = run_of(name)
    whole = told(explained(frames, files=files()))
    assert whole
    assert told(explained(frames, 37, files())) == whole
    assert told(explained(frames, 311, files(), live=True)) == whole


def drawn(seed, number=800):
    """Return frames of three nodes that follow no protocol: any service, any content, any time."""
    dice = random.Random(seed)
    frames, t_ns = np.zeros(number, FRAME), dice.choice((0, 10**18))
    services = (0x080, 0x180, 0x200, 0x280, 0x300, 0x580, 0x600, 0x700)
    ids = [0x000, 0x080, 0x100, 0x7E4, 0x7E5] + [base + n for n in dice.sample(range(1, 128), 3) for base in services]
    weights = [dice.random() ** 3 for _ in ids]
    period_ns = dice.choice((0, 0, 1_000_000, 10_000_000))
    for row in frames:
        steps = (100_000, 500_000, 1_000_000) if dice.random() < 0.7 else (0, 1000, 5 * 10**6, 50 * 10**6, 3 * 10**9)
        t_ns += period_ns if period_ns and dice.random() < 0.9 else dice.choice(steps)
        can_id = dice.choices(ids, weights)[0]
        data = dice.choice((dice.randbytes(dice.randrange(9)), b"\x37\x02", b"\x08\x02\1\0\0\0", bytes(8)))
        if can_id == 0:
            data = bytes((dice.choice((1, 2, 0x80, 0x81, 0x82, 7)), dice.choice((0, ids[-1] & 0x7F))))
        elif can_id & 0x780 == 0x700:
            data = bytes((dice.choice((0, 4, 5, 5, 5, 0x7F, 0x85)),))
        elif can_id & 0x780 in (0x580, 0x600):
            command = dice.choice(
                (0x40, 0x43, 0x4F, 0x60, 0x23, 0x2F, 0x80, 0x21, 0x00, 0xA0, 0xC0, dice.randrange(256))
            )
            at = bytes(
                (dice.choice((0x00, 0x16, 0x17, 0x41)), dice.choice((0x10, 0x18, 0x1A, 0x60)), dice.choice((0, 1)))
            )
            data = bytes((command,)) + at + dice.choice((b"\0\0\4\5", b"\2\0\0\0", dice.randbytes(4)))
        flags = dice.choices((0, CAN_RTR_FLAG, CAN_ERR_FLAG, CAN_EFF_FLAG), (96, 2, 1, 1))[0]
        can_id = dice.choice((0x04, 0x40, 0x88, 0x100)) if flags == CAN_ERR_FLAG else can_id
        row["t_ns"], row["can_id"], row["length"], row["word"] = t_ns, can_id | flags, len(data), data_word(data)
    return frames


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [*range(11), 246])
def test_of_any_frames_the_blocks_change_nothing(seed):
    frames = drawn(seed, 800 if seed == 246 else 300)
    whole = told(explained(frames))
    for size in (1, 13, 200):
        assert told(explained(frames, size)) == whole


@pytest.mark.slow
@pytest.mark.parametrize("name", [NAMES[0], *thorough(*NAMES[1:4])])
def test_a_cut_log_tells_what_was_known_then(name):
    frames, files = run_of(name)
    whole = {clue[:3] for _, clues in told(explained(frames, files=files())) for clue in clues}
    for cut in np.linspace(200, len(frames) - 1, 12).astype(int):
        known = {clue[:3] for _, clues in told(explained(frames[:cut], files=files())) for clue in clues}
        assert known <= whole


def lost_and_commanded(at, until):
    """Return a machine of which node 4 falls silent, and is commanded to reset in vain."""
    log = machine(3, until=until).boot(4, 2).beats(4, 63, at)
    for order in (0.5, 3.5, 28):
        log.order(at + 1000 * order, 0x81, 4)
    return log


def fell_and_told(at, until):
    """Return a machine of which node 4 tells of an error between two of its PDOs, and stops them."""
    log = machine(3, until=until).boot(4, 2).beats(4, 63, at).beats(4, at + 40, until, state=0x7F)
    for ms in np.arange(70, at - 300, 500):
        log.add(ms, 0x184, b"\1\2")
    return log.add(at, 0x084, bytes.fromhex("3081010000000000"))


def restarted(at, until):
    """Return a machine of which node 4 boots by itself, and is started again."""
    log = machine(3, until=until).boot(4, 2).beats(4, 63, at).boot(4, at + 300).beats(4, at + 320, at + 900, state=0x7F)
    return log.order(at + 910, 1, 4).beats(4, at + 1000, until)


@pytest.mark.parametrize("event", [lost_and_commanded, fell_and_told, restarted])
@pytest.mark.parametrize("before_s", [60, 200, 460])
def test_what_was_before_changes_nothing(event, before_s):
    early, late = event(20e3, 60e3).explained(), event(20e3 + 1e3 * before_s, 60e3 + 1e3 * before_s).explained()
    assert heads(early)
    assert heads(late, 1e3 * before_s) == heads(early)
    assert {i.who for i in late.incidents} == {i.who for i in early.incidents}


def test_a_healthy_machine_beside_it_changes_nothing():
    alone = lost_and_commanded(20e3, 60e3)
    beside = lost_and_commanded(20e3, 60e3)
    for node in (11, 12):
        beside.boot(node, node).beats(node, 60.5 + node, 60e3).order(55, 1, node)
        for ms in np.arange(71, 60e3, 50):
            beside.add(ms + node / 10, 0x180 + node, bytes((int(ms) % 7, node)))
    assert heads(beside.explained()) == heads(alone.explained()) != []


def test_two_machines_in_one_log_have_the_incidents_of_both():
    one, other = lost_and_commanded(20e3, 60e3), Log()
    other.boot(21, 3).order(52, 1, 21).beats(21, 80.3, 60e3)
    other.ask(21, 30e3, "2b17100102000000", "8017100111000906")
    both = lost_and_commanded(20e3, 60e3)
    both.rows += other.rows
    assert heads(both.explained()) == sorted(heads(one.explained()) + heads(other.explained()))


def test_two_absences_of_a_node_are_two_incidents():
    log = machine(3, until=8000).boot(4, 2).beats(4, 63, 4000).beats(4, 4700, 5400)
    lost = sorted((i.begin_ns, i.status) for i in log.explained().incidents)
    assert [status for _, status in lost] == ["recovered", "unresolved"]
    assert [round(begin / 1e9, 1) for begin, _ in lost] == [4.0, 5.3]


def test_maps_hold_from_the_frame_that_shows_them():
    log = machine(4, until=6000).ask(4, 20, "4000100000000000", TYPE_402)
    settings = (("23001a0110006c60", 1), ("23001a0210004160", 2), ("2f001a0002000000", 0))
    for number, (write, sub) in enumerate(settings):
        log.ask(4, 22 + number, write, f"60001a0{sub}00000000")
    for cycle, ms in enumerate(np.arange(70, 6000, 10)):  # the velocity's low word is no statusword
        log.add(ms, 0x184, (100 * cycle % 0x7FFF).to_bytes(2, "little") + (0x0637).to_bytes(2, "little"))
    assert log.explained().verdict == "ok"
    log.order(5950, 0x81, 4).boot(4, 5990)
    assert log.explained().verdict == "ok"


def test_an_assumed_map_that_its_frames_contradict_is_dropped():
    log = machine(4, until=3000).ask(4, 20, "4000100000000000", TYPE_402)
    for cycle, ms in enumerate(np.arange(70, 3000, 10)):
        log.add(ms, 0x184, (37 * cycle % 0x7FFF).to_bytes(2, "little"))
    told_of = log.explained()
    assert (told_of.verdict, told_of.nodes[0].maps) == ("ok", "")
