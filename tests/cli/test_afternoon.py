"""The afternoon of docs/deploy.md on a bus with devices that have no node id."""

from __future__ import annotations

import os
import shlex

import pytest

from afternoon import Afternoon, blocks

pytestmark = [pytest.mark.real_time, pytest.mark.slow]


def test_the_document_has_the_whole_afternoon():
    verbs = [shlex.split(line)[1] for kind, line in blocks() if kind == "command"]
    wanted = (
        "emulate scan lss lss sdo init check measure doctor commission commission run status stop run nmt nmt decode"
    )
    assert verbs == wanted.split()


@pytest.mark.thorough
def test_the_afternoon_as_it_is_printed(tmp_path):
    with Afternoon(tmp_path, f"coulombus:lab-{os.getpid()}") as day:
        day.perform()
