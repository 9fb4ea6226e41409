"""A second new device of a description begins with what was kept of the first."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.node.brake404 import BRAKE404
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.record import new_nodes
from coulombus.node.store import Store
from coulombus.rigs.rig import load_rig


@pytest.mark.parametrize(("node", "profile"), [("motor", DRIVE402), ("brake", BRAKE404)])
def test_a_new_device_of_the_same_description_is_the_same(node, profile):
    description = load_rig("bench").one_axis().description(node)
    records = [new_nodes(1)[0] for _ in range(3)]
    first, again = (Device(description, 5, profile, record) for record in records[:2])
    own = Device(description, 5, profile, records[2], store=Store())  # with a store: nothing is kept of it
    assert records[0].tobytes() == records[1].tobytes() == records[2].tobytes()
    assert first.state() == again.state() == own.state()
    again[0x1017, 0] = 777
    assert Device(description, 5, profile, new_nodes(1)[0])[0x1017, 0] == first[0x1017, 0] != 777
    other = Device(description, 6, profile, new_nodes(1)[0])
    assert not np.array_equal(other.record["tpdo"]["cob_id"], records[0]["tpdo"]["cob_id"])
