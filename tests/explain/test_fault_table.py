"""The table of docs/bus.md: the incident that `explain` finds within 2 s of each fault."""

from __future__ import annotations

import re

import pytest

from benchmarks.explain_truths import explained
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.sim_bus.faults.fault_file import faults_of
from coulombus.sim_bus.faults.fault_kinds import KINDS, NodeFault
from coulombus.sim_bus.faults.live_faults import plan_of
from coulombus.sim_bus.network.device_faults import EFFECTS
from places import ROOT

AT_S, WITHIN_S = 0.5, 2.0
PAGE = (ROOT / "docs" / "bus.md").read_text()
ROWS = re.findall(r"^\| `(\w+)` \| (\w+) \| `?([\w-]+)`? \| ([^|]*)\|$", PAGE, re.M)


def test_the_table_of_kinds_has_each_fault():
    table = PAGE.partition("| kind | effect | keys |")[2].partition("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\|([^|]*)\|", table, re.M)))) == set(KINDS)


def test_each_fault_of_a_device_is_a_kind_for_a_fault_file():
    assert {kind for kind, model in KINDS.items() if model is NodeFault} == set(EFFECTS)


def test_the_table_has_each_fault_and_a_reason_where_none_is_named():
    assert {row[0] for row in ROWS} == set(KINDS)
    assert all(reason.strip() for _, _, incident, reason in ROWS if incident == "-")


@pytest.mark.thorough
@pytest.mark.parametrize(("fault", "place", "incident"), [row[:3] for row in ROWS])
def test_explain_names_it(fault, place, incident, tmp_path):
    text = plan_of(fault, place, None, {}).text
    plan = faults_of(f'{text.rstrip()}\nafter = "enabled"\nat_s = {AT_S}\n', "late.toml")
    path = tmp_path / "run.pcapng"
    result = simulate("bench", "hybrid", AT_S + WITHIN_S + 0.2, record=path, seed=1, faults=plan)
    recording = read(path)
    frames = recording.frames
    first_s = result.faults[0]["first_s"]
    shown = explained(frames[frames["t_ns"] <= (first_s + WITHIN_S) * 1e9], recording.rig)
    named = {clue.kind for incident in shown.incidents[:1] for clue in incident.clues}
    if incident == "-":
        assert not shown.incidents or fault == "drop"
    else:
        assert incident in named
