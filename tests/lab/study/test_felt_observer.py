"""A simulated observer that judges what its hand felt, from the recordings."""

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.simulate import simulate
from coulombus.lab.study.felt_torque import FeltError, felt_Nm
from coulombus.lab.study.observer import Observer
from coulombus.lab.study.trials import Trial
from study_text import TEXT

MOVES = (
    "phase=[{kind='rest',duration_s=0.8},"
    "{kind='stroke',duration_s=0.4,speed_rad_s=4.0,move_s=0.4,dwell_s=0.1}]"
)  # fmt: skip


def displayed(path, level, *more):
    overrides = (f"mode.hybrid.F_s_Nm={level}", f"mode.hybrid.F_d_Nm={level}", *more)
    simulate("bench", "hybrid", 1.2, record=path, seed=3, overrides=overrides)
    return path


def test_what_is_felt_is_the_friction_that_was_displayed(tmp_path):
    low, high = (felt_Nm(displayed(tmp_path / f"{level}.pcapng", level, MOVES)) for level in (1.6, 2.4))
    assert high - low == pytest.approx(0.8, rel=0.02)
    assert low == pytest.approx(1.6, abs=0.05)  # the handle still moves at the end: its energy is in it


def test_a_hand_that_did_not_turn_the_handle_felt_nothing(tmp_path):
    path = displayed(tmp_path / "still.pcapng", 2.0, "phase=[{kind='rest',duration_s=1.2}]")
    with pytest.raises(FeltError, match=r"the handle turned by .* take --felt out"):
        felt_Nm(path)


@pytest.mark.parametrize("first", [1, 2])
def test_an_observer_judges_what_it_is_given_and_not_the_level(first):
    trial = Trial(1, 1, None, False, 9.9, 2.0, first)
    own, other = (1.0, 1.5) if first == 1 else (1.5, 1.0)
    observer = Observer(1e-6, 3, 0, lambda trial: (own, other))
    assert observer.answer(trial) == str(3 - first)  # the level is larger, and was felt as smaller
    assert Observer(1e-6, 3, 0).answer(trial) == str(first)
    assert Observer(1e-6, 3, 0, lambda trial: [1.25]).answer(Trial(1, 1, None, False, 9.9, None, 0)) == "12.5"


def test_an_observer_that_feels_answers_a_study(tmp_path):
    moves = f'set = ["""{MOVES}"""]\n'
    short = TEXT.replace("seconds = 0.05", "seconds = 1.2").replace("repeats = 2", "repeats = 1")
    (tmp_path / "study.toml").write_text(short + moves)
    words = ["experiment", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--subject", "S01", "--virtual"]
    refused = CliRunner().invoke(main, [*words, "--felt"])
    assert (refused.exit_code, "add --observer JND" in refused.stderr) == (2, True)
    came = CliRunner().invoke(main, [*words, "--observer", "0.001", "--felt"])
    assert came.exit_code == 0, came.output
    rows = (tmp_path / "out" / "sub-S01" / "sub-S01_task-jnd_events.tsv").read_text().splitlines()[1:]
    right = {float(row.split("\t")[6]): row.split("\t")[-1] for row in rows}
    assert right == {1.6: "0", 2.4: "1"}  # "more" is the level above the reference alone
    assert "JND 0.001 Nm felt" in (tmp_path / "out" / "sub-S01" / "sub-S01_task-jnd_events.json").read_text()
