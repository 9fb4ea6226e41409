"""An EDS file of a device that has none, by its answers alone."""

from __future__ import annotations

import pytest

from coulombus.eds.cia301 import DATA_TYPES, CobId
from coulombus.eds.convert import eds_text_of
from coulombus.eds.eds_folder import EdsFiles
from coulombus.eds.pdo import layouts
from coulombus.eds.reader import parse_eds
from coulombus.host.devices.dictionary_scan import DictionaryScan, pdo_objects
from coulombus.host.errors import NodeMissing
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.recording.maps.known_bus import KnownBus
from devices_bench import DevicesLink, eds

RANGES = ((0x1000, 0x1FFF), (0x2000, 0x20FF), (0x6000, 0x65FF), (0x7000, 0x7300), (0x9000, 0x9300))


def scanned(name="motor", node_id=5, **options):
    """Return a device's own file, that made of its answers, the frames sent, and the remarks."""
    link, own = DevicesLink(), eds(name, vendor=0x99)
    link.add(own, node_id)
    scan = DictionaryScan(SdoClient(link, node_id), RANGES, **options)
    text = eds_text_of(scan.content())
    return own, parse_eds(text.encode(), "made.eds"), link.sent, scan.remarks


@pytest.mark.parametrize("name", [pytest.param("motor", marks=pytest.mark.thorough), "mr_brake"])
def test_objects_types_and_maps_are_the_devices(name):
    own, made, sent, remarks = scanned(name)
    assert made.diagnoses == ()
    missing = {
        index for index in own.objects if any(low <= index <= high for low, high in RANGES)
    } - made.objects.keys()
    assert {f"{index:04X}h" for index in missing} == {text[:5] for text in remarks}
    for index, entry in made.objects.items():
        for sub, variable in entry.variables.items():
            theirs = own.variable(index, sub)
            assert DATA_TYPES[variable.data_type].bits == DATA_TYPES[theirs.data_type].bits, (hex(index), sub)
            if index < 0x2000 or index >= 0x6000:
                assert (variable.data_type, variable.access) == (theirs.data_type, theirs.access), (hex(index), sub)
    assert [(pdo.cob_id, pdo.length) for pdo in layouts(made, 9)] == [
        (pdo.cob_id, pdo.length) for pdo in layouts(own, 9)
    ]
    assert not [frame for frame in sent if frame[1][0] >> 5 == 1], "a download"


@pytest.mark.thorough
def test_access_is_tried_only_where_asked():
    own, made, _, _ = scanned()
    assert {v.access for i, o in made.objects.items() if 0x2000 <= i < 0x6000 for v in o.variables.values()} == {"ro"}
    own, made, sent, _ = scanned(tries_access=True)
    for index, entry in made.objects.items():
        for sub, variable in entry.variables.items():
            can_write = own.variable(index, sub).access in ("rw", "rwr", "rww")
            assert (variable.access in ("rw", "rwr", "rww")) == can_write, (hex(index), sub)
    written = {int.from_bytes(frame[1][1:3], "little") for frame in sent if frame[1][0] >> 5 == 1}
    assert not written & {0x6040, 0x6071, 0x60FF, 0x1010, 0x1011, 0x1003}


def test_a_node_that_does_not_answer_is_missing():
    with pytest.raises(NodeMissing):
        DictionaryScan(SdoClient(DevicesLink(), 5, 0.1)).content()


def test_a_device_that_answers_otherwise_for_what_it_lacks():
    """General error instead of "no object"; a string, an odd size, a sparse record, a write-only object."""
    objects = {
        (0x1000, 0): b"\0\0\0\0",
        (0x1018, 0): b"\1",
        (0x1018, 1): b"\x34\x12\0\0",
        (0x2000, 0): b"abc",
        (0x2001, 0): b"\3",
        (0x2001, 3): b"\1\2",
        (0x2002, 0): b"\7",
    }
    link = DevicesLink()

    def answer(can_id, request):
        if can_id != CobId.SDO_RX + 5 or request[0] >> 5 != 2:
            return []
        place = int.from_bytes(request[1:3], "little"), request[3]
        head = request[1:4]
        if place in objects:
            data = objects[place]
            return [(CobId.SDO_TX + 5, bytes([0x43 | 4 - len(data) << 2]) + head + data.ljust(4, b"\0"))]
        code = 0x06010001 if place == (0x2003, 0) else 0x06090011 if place[0] == 0x2001 else 0x08000000
        return [(CobId.SDO_TX + 5, b"\x80" + head + code.to_bytes(4, "little"))]

    link.others.append(answer)
    scan = DictionaryScan(SdoClient(link, 5), ((0x1000, 0x1020), (0x2000, 0x2010)))
    made = parse_eds(eds_text_of(scan.content()).encode(), "made.eds")
    assert sorted(made.objects) == [0x1000, 0x1018, 0x2000, 0x2001, 0x2002]
    assert sorted(made.objects[0x2001].variables) == [0, 3]
    assert made.variable(0x2001, 3).data_type == 0x06
    assert made.variable(0x2000, 0).data_type == 0x16
    assert scan.remarks == ["2003h:00 can only be written, so its type is unknown: left out"]


def test_pdos_are_those_that_the_device_has_now():
    link, own = DevicesLink(), eds("motor")
    link.add(own, 5)
    client = SdoClient(link, 5)
    for index, sub, size, value in (
        *((0x1801, 1, 4, 0x80000285), (0x1A01, 0, 1, 0), (0x1A01, 1, 4, 0x60770010), (0x1A01, 2, 4, 0x60640020)),
        *((0x1A01, 0, 1, 2), (0x1801, 1, 4, 0x285), (0x1A00, 0, 1, 0)),
    ):
        if index == 0x1A00:
            client.download(0x1800, 1, (0x80000185).to_bytes(4, "little"))
        client.download(index, sub, value.to_bytes(size, "little"))
    known = KnownBus.of_device(5, pdo_objects(client), EdsFiles({5: own}))
    maps = {pdo.name: [(entry.index, entry.bits, entry.signed) for entry in pdo.layout.entries] for pdo in known.pdos}
    assert maps["TPDO2"] == [(0x6077, 16, True), (0x6064, 32, True)]
    assert "TPDO1" not in maps
    assert "RPDO1" in maps
