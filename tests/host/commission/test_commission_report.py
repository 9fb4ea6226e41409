"""The report's head, and the digits of its figures."""

import hashlib
import re
from importlib.metadata import version

import pytest

from coulombus.host.commission.report import Signature, report, signature, value_texts
from coulombus.host.commission.session import Progress
from coulombus.rigs.rig import load_rig, packaged_rig

TITLES = {"zero": "zero", "friction": "friction"}


def outcome(value, reach):
    finding = {"key": "mechanics.friction_Nm", "name": "friction", "old": 0.1, "new": value, "unit": "Nm"}
    finding |= {"uncertainty": reach, "basis": "samples", "changed": True}
    return {"at": "2026-01-02T03:04:05Z", "findings": [finding], "remarks": ["a"], "curves": [], "recordings": []}


def head_of(page):
    return page.partition("<h2>")[0]


@pytest.mark.parametrize(
    ("value", "reach", "shown"),
    [
        (0.139871, 0.00364, ("0.1399", "0.0036")),
        (-0.0000057, 0.0000312, ("-0.000006", "0.000031")),
        (1234.6, 120.0, ("1230", "120")),
        (2.0, 0.0996, ("2.00", "0.10")),
        (12.345, None, ("12.345", "")),
        (3, 0.5, ("3", "0.5")),
        (1.5, 0.0, ("1.5", "0")),
        (1.25e-12, 3e-14, ("1.25e-12", "3e-14")),
    ],
)
def test_a_figure_has_the_digits_of_its_interval(value, reach, shown):
    assert value_texts(value, reach) == shown


def test_verdict_operator_version_and_hash_stand_before_the_first_step(tmp_path):
    state = Progress(tmp_path, {"zero": outcome(0.139871, 0.00364)})
    path = packaged_rig("bench")
    signed = signature(path, "A. <Smith>")
    page = report(load_rig("bench"), state, TITLES, signed)
    head = head_of(page)
    assert "Not complete: 1 of 2 steps done, values written: 1, notes: 1" in head
    assert "A. &lt;Smith&gt;" in head
    assert hashlib.sha256(path.read_bytes()).hexdigest() in head
    assert f"coulombus {version('coulombus')}" in head
    assert '<td class="n">0.1399</td><td class="n">0.0036</td>' in page


def test_the_verdict_is_complete_with_the_last_step(tmp_path):
    state = Progress(tmp_path, {name: outcome(1.0, None) for name in TITLES})
    page = report(load_rig("bench"), state, TITLES, Signature("a", "1", "0"))
    assert re.search(r'<p class="verdict">Complete: 2 of 2 steps done', page)
    assert "Not done" not in page


def test_the_page_is_for_dark_screens_and_for_paper(tmp_path):
    page = report(load_rig("bench"), Progress(tmp_path, {}), TITLES, Signature("a", "1", "0"))
    dark, paper = (page.partition(f"@media {kind}")[2] for kind in ("(prefers-color-scheme: dark)", "print"))
    assert "--ink: #e6e6e6" in dark.partition("}")[0]
    assert "--paper: #fff" in paper.partition("}")[0]
