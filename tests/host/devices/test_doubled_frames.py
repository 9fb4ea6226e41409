"""CAN delivers a frame twice when the last bit of its end is disturbed: every service of host and
node, with each of its frames doubled.
"""

from __future__ import annotations

import pytest

from coulombus.host.devices.configuration import differences, dump, restore
from coulombus.host.devices.device import KnownDevice
from coulombus.host.devices.lss import LssMaster
from coulombus.host.devices.nmt import command
from coulombus.host.devices.numbering import give
from coulombus.host.devices.scan import scan
from coulombus.host.sdo.sdo_client import SdoClient, store_parameters
from coulombus.host.sdo.transfers import SdoRefused
from devices_bench import UNCONFIGURED, DevicesLink, eds

LABEL = (0x2004, 0)
MOTOR = eds("motor")
AGAIN_NS = (0, 150_000)
"""The doubled frame comes before what the client sends next, or behind it."""


def text(length):
    return bytes(32 + k % 90 for k in range(length))


def client_of(link):
    link.add(MOTOR, 1)
    return SdoClient(link, 1)


def write_and_read(length):
    def act(link):
        client = client_of(link)
        client.download(*LABEL, text(length))
        return client.upload(*LABEL), client.upload(0x1000, 0), client.upload(*LABEL)

    return act


def constant_blocks(link):
    """All segments alike, but for their numbers; the last block is a whole one."""
    client = client_of(link)
    client.download(*LABEL, bytes(b"x" * 7 * 254))
    return client.upload(*LABEL)


def refusals(link):
    client, told = client_of(link), []
    for act in (
        lambda: client.upload(0x5FFF, 0),
        lambda: client.download(0x1000, 0, bytes(4)),
        lambda: client.download(0x1000, 0, bytes(20)),
        lambda: client.upload(0x1000, 7),
    ):
        with pytest.raises(SdoRefused) as caught:
            act()
        told.append(str(caught.value))
    return told


def without_blocks(link):
    client, original = client_of(link), link.send

    def send(can_id, data=b"", length=None):
        if can_id == 0x601 and data[0] in (0xA4, 0xC6):
            for _ in range(link._times()):
                link.put(0x581, b"\x80" + data[1:4] + b"\x01\x00\x04\x05")
        else:
            original(can_id, data, length)

    link.send = send
    client.download(*LABEL, text(900))
    return client.upload(*LABEL)


def identities(link):
    client = client_of(link)
    store_parameters(link, 1)
    return [client.upload(0x1018, part) for part in (1, 2, 3, 4)]


def scanned(link):
    link.add(MOTOR, 1)
    link.add(eds("mr_brake"), 2)
    return scan(link)


def numbered(link):
    """LSS: list, select, inquire, configure, store; then the boot-up."""
    link.add(MOTOR, 1)
    for serial in (5, 0x12345678):
        link.add(eds("motor", vendor=0x77, serial=serial), UNCONFIGURED)
    with LssMaster(link) as master:
        found = master.unconfigured()
        told = [give(master, link, one, 10 + k, store=True) for k, one in enumerate(found)]
    return sorted(one.serial for one in found), [(one.node_id, one.booted, one.stored) for one in told]


def restored(link):
    """A PDO's mapping is written anew, whose parameters a device takes in one order only."""
    device = KnownDevice(client_of(link), MOTOR)
    values = {(0x1017, 0): 70, (0x1A02, 0): 1, (0x1A02, 1): 0x60640020, (0x1802, 2): 1}
    found = differences(device, MOTOR, values)
    told = restore(device, values, found)
    return sorted(told.written), told.failed, differences(device, MOTOR, values)


def commanded(link):
    """NMT: a node boots once, whether its boot-up or the command is doubled."""
    link.add(MOTOR, 1)
    while link.receive(link.now_ns() + 1_000_000):  # it has booted
        pass
    return [command(link, word, 1, 2.0) for word in ("start", "stop", "reset")]


def dumped(link):
    device = KnownDevice(client_of(link), MOTOR)
    found = dump(device)
    return len(found.values), found.aborted, check_values(found)


def check_values(found):
    return {place: value for place, value in found.values.items() if place[0] < 0x2000}


SERVICES = {
    "expedited": write_and_read(4),
    "segments": write_and_read(30),
    "one segment": write_and_read(5),
    "blocks": write_and_read(1000),
    "constant blocks": constant_blocks,
    "refusals": refusals,
    "no blocks": without_blocks,
    "identities": identities,
    "scan": scanned,
    "lss": numbered,
    "restore": restored,
    "dump": dumped,
    "nmt": commanded,
}
MOST = 20, 60
"""Frames of one service that are doubled, one after the other: the first, and those at even distances."""
BEGINNING = 12


def bus(doubled=(), again_ns=0):
    link = DevicesLink()
    link.doubled, link.again_ns = frozenset(doubled), again_ns
    return link


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("most", [MOST[0], pytest.param(MOST[1], marks=pytest.mark.long)])
@pytest.mark.parametrize("again_ns", AGAIN_NS)
@pytest.mark.parametrize("service", SERVICES)
def test_a_service_with_any_frame_doubled_is_what_it_is(service, again_ns, most):
    act, plain = SERVICES[service], bus()
    wanted, wrong = act(plain), {}
    for number in {*range(BEGINNING), *range(0, plain.count, max(1, plain.count // most))}:
        try:
            found = act(bus([number], again_ns))
        except Exception as error:
            found = error
        if found != wanted:
            wrong[number] = found
    assert wrong == {}
