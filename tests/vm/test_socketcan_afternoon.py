"""The afternoon of docs/deploy.md at 1 kHz on Linux's own CAN, in a machine whose clock is steady."""

from __future__ import annotations

import pytest

from afternoon import Afternoon
from vm_host import NO_SWITCH, STEADY

pytestmark = [pytest.mark.real_time, STEADY]


def test_the_afternoon_as_it_is_printed(interface, tmp_path):
    with Afternoon(tmp_path, f"socketcan:{interface}", NO_SWITCH) as day:
        day.perform()
