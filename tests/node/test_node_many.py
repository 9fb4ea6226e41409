"""What the core does by itself equals what Python does; and a device with as many PDOs as there is
room for.
"""

from __future__ import annotations

import pytest

from coulombus.eds.reader import parse_eds
from coulombus.node.kinds import GENERIC
from coulombus.node.record import MAX_PDOS
from coulombus.wire.frame import data_word
from node_bench import Bench, description


@pytest.mark.parametrize(("name", "node_id"), [("motor", 1), ("mr_brake", 2)])
def test_the_core_answers_expedited_uploads_as_python_does(name, node_id):
    bench = Bench(name, node_id)
    bench.power_on()
    bench.take()
    by_core = 0
    for index, entry in description(name).objects.items():
        for subindex in (*entry.variables, 0xFE):
            data = b"\x40" + index.to_bytes(2, "little") + bytes((subindex,)) + bytes(4)
            arguments = (bench.t, 0x600 + node_id, 8, data_word(data), bench.out)
            bench.device.service(*arguments)
            bench.frame(0x7FF)
            (python,) = bench.take(0x580 + node_id)
            bench.frame(0x600 + node_id, b"\x80" + bytes(7))  # ends what may be a segmented transfer
            count = int(bench.out["count"])
            served = []
            original = bench.device.service
            bench.device.service = lambda *a, served=served, original=original: (served.append(a), original(*a))
            bench.frame(0x600 + node_id, data)
            bench.device.service = original
            (core,) = bench.take(0x580 + node_id)
            assert core == python
            assert count == 0
            by_core += not served
            bench.frame(0x600 + node_id, b"\x80" + bytes(7))
    assert by_core > 150


def many_pdos() -> bytes:
    """An EDS of one byte for each of `MAX_PDOS` RPDOs and TPDOs, and of one PDO more than there is
    room for.
    """
    text = "[DeviceInfo]\nVendorName=test\n\n"

    def variable(name: str, data_type: int, default: int, mappable: int = 0, access: str = "rw") -> str:
        head = f"[{name}]\nParameterName=X\nObjectType=7\nDataType={data_type}\nAccessType={access}\n"
        return head + f"DefaultValue={default}\nPDOMapping={mappable}\n\n"

    text += variable("1000", 7, 0, access="ro") + variable("1001", 5, 0, access="ro")
    for k in range(MAX_PDOS + 1):
        text += variable(f"{0x2000 + k:04X}", 5, 0, 1)
        for first, can_id in ((0x1400, 0x200 + k), (0x1800, 0x280 + k)):
            text += f"[{first + k:04X}]\nParameterName=PDO\nObjectType=9\nSubNumber=3\n\n"
            text += variable(f"{first + k:04X}sub0", 5, 2, access="const")
            text += variable(f"{first + k:04X}sub1", 7, can_id) + variable(f"{first + k:04X}sub2", 5, 1)
            text += f"[{first + 0x200 + k:04X}]\nParameterName=Map\nObjectType=9\nSubNumber=2\n\n"
            text += variable(f"{first + 0x200 + k:04X}sub0", 5, 1)
            text += variable(f"{first + 0x200 + k:04X}sub1", 7, (0x2000 + k) << 16 | 8)
    return text.encode()


def test_as_many_pdos_as_there_is_room_for_act_on_one_sync():
    bench = Bench("many", 3, kind=GENERIC, eds=parse_eds(many_pdos(), "many.eds"))
    bench.power_on()
    bench.nmt(1)
    bench.take()
    for k in range(MAX_PDOS + 1):
        bench.frame(0x200 + k, bytes((k + 1,)))
    assert [bench.device[0x2000 + k, 0] for k in range(MAX_PDOS)] == [0] * MAX_PDOS
    assert bench.node.rpdo_pending == MAX_PDOS
    bench.sync()
    sent = bench.take()
    assert [frame.can_id for frame in sent] == [0x280 + k for k in range(MAX_PDOS)]
    assert [frame.data for frame in sent] == [bytes((k + 1,)) for k in range(MAX_PDOS)]
    assert bench.node.rpdo_pending == 0
    assert bench.number(0x1400 + MAX_PDOS, 1) >> 31 == 1  # the one too many is not valid
    bench.nmt(2)
    bench.nmt(1)
    bench.sync()
    assert len(bench.take()) == MAX_PDOS
