"""What a client that was not written here does with our nodes: `canopen`'s classes, on whatever bus
the network is connected to.

Each function takes a connected network and leaves the nodes as it found them. Nothing is timed: all
waits are far longer than needed.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager

import canopen

from places import EDS

MOTOR, FREE_ID, ABSENT = 1, 11, 100
WAIT_S = 120.0
TEXT = "".join(f"{k:04d}" for k in range(500))


def until(condition, step=lambda: None):
    """Take steps until the condition holds."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline
        step()


@contextmanager
def node_of(network, kind=canopen.RemoteNode, name="motor", node_id=MOTOR):
    """A node of `canopen`; its own watchers are taken off the network afterwards."""
    node = network.add_node(kind(node_id, str(EDS / f"{name}.eds")))
    node.sdo.RESPONSE_TIMEOUT = WAIT_S
    try:
        yield node
    finally:
        del network[node_id]


def booted(network, node_id, act):
    """Act, and wait for the node's boot-up. canopen's `wait_for_bootup` misses one that comes
    before it waits.
    """
    came = threading.Event()

    def hear(can_id, data, stamp):
        if bytes(data) == b"\0":
            came.set()

    network.subscribe(0x700 + node_id, hear)
    act()
    assert came.wait(WAIT_S)
    network.unsubscribe(0x700 + node_id, hear)


def transfers(network):
    """SDO: expedited, segmented and block transfers, both ways, and an abort."""
    with node_of(network) as node:
        node.sdo[0x1017].raw = 0
        assert (node.sdo[0x1000].raw, node.sdo[0x1017].raw) == (0x00020192, 0)
        label = node.sdo[0x2004]
        before = label.raw
        label.raw = "a label that goes by segments"
        assert label.raw == "a label that goes by segments"
        with label.open("wb", size=len(TEXT), block_transfer=True) as stream:
            stream.write(TEXT.encode())
        assert label.raw == TEXT
        with label.open("rb", block_transfer=True) as stream:
            assert stream.read() == TEXT.encode()
        label.raw = before
        with node.sdo[0x1021].open("rb", block_transfer=True) as stream:
            assert stream.read() == (EDS / "motor.eds").read_bytes()
        try:
            node.sdo[0x1000].raw = 1
        except canopen.SdoAbortedError as aborted:
            code = aborted.code
        assert code == 0x06010002


def pdos(network):
    """PDO: read the configuration, map a TPDO anew, subscribe, receive; a RPDO out."""
    with node_of(network, name="mr_brake", node_id=2) as node:
        node.nmt.state = "PRE-OPERATIONAL"
        node.tpdo.read()
        node.rpdo.read()
        inputs = node.tpdo[1]
        before = [(x.index, x.subindex) for x in inputs.map]
        assert (0x7130, 1) in before
        inputs.clear()
        for subindex in (3, 2):
            inputs.add_variable(0x7130, subindex)
        inputs.trans_type, inputs.enabled = 1, True
        inputs.save()
        inputs.subscribe()
        output = node.rpdo[1]
        output.trans_type = 255
        output.save()
        network.nmt.state = "OPERATIONAL"
        network.sync.start(0.05)
        try:
            assert inputs.wait_for_reception(WAIT_S) is not None
            until(lambda: inputs.map[0].raw != 0, lambda: inputs.wait_for_reception(WAIT_S))
            assert 180 <= inputs.map[0].raw <= 1000  # 0.1 degC
            output.map[0].raw = 500
            output.transmit()
            until(lambda: node.sdo[0x7300][1].raw == 500)
        finally:
            network.sync.stop()
        node.nmt.state = "PRE-OPERATIONAL"
        booted(network, node.id, lambda: setattr(node.nmt, "state", "RESET COMMUNICATION"))
        node.tpdo.read()
        assert [(e.index, e.subindex) for e in node.tpdo[1].map] == before


def drive(network):
    """BaseNode402: enable, torque, quick stop, a fault and its reset."""
    with node_of(network, canopen.BaseNode402) as node:
        for name in (
            "TIMEOUT_SWITCH_OP_MODE",
            "TIMEOUT_SWITCH_STATE_FINAL",
            "TIMEOUT_SWITCH_STATE_SINGLE",
            "TIMEOUT_CHECK_TPDO",
        ):
            setattr(node, name, WAIT_S)
        node.nmt.state = "PRE-OPERATIONAL"
        node.rpdo.read()
        node.rpdo[1].trans_type = 255
        node.rpdo[1].save()
        node.sdo[0x6072].raw = 1000
        node.sdo[0x605A].raw = 6  # stay in Quick Stop Active
        node.sdo[0x1029][1].raw = 1  # a lost heartbeat is the drive's fault, NMT stays
        network.sync.start(0.05)
        try:
            node.nmt.state = "OPERATIONAL"
            node.setup_402_state_machine()
            node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
            assert node.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
            node.state = "OPERATION ENABLED"
            torque = node.rpdo_pointers[0x6071]
            torque.raw = 60
            torque.pdo_parent.transmit()
            until(lambda: node.tpdo_values[0x6077] >= 50, node.check_statusword)
            torque.raw = 0
            torque.pdo_parent.transmit()
            until(lambda: abs(node.tpdo_values[0x6077]) <= 5, node.check_statusword)
            node.state = "QUICK STOP ACTIVE"
            assert node.state == "QUICK STOP ACTIVE"
            node.state = "SWITCH ON DISABLED"
            node.state = "OPERATION ENABLED"

            node.sdo[0x1016][1].raw = ABSENT << 16 | 200
            network.send_message(0x700 + ABSENT, [5])
            until(node.is_faulted, node.check_statusword)
            assert 0x8130 in [emergency.code for emergency in node.emcy.log]  # it was sent before the statusword
            node.sdo[0x1016][1].raw = 0
            node.reset_from_fault()
            assert node.state == "OPERATION ENABLED"
            node.state = "SWITCH ON DISABLED"
        finally:
            network.sync.stop()
        booted(network, MOTOR, lambda: setattr(node.nmt, "state", "RESET"))


def layer_setting(network):
    """LssMaster: select by identity, inquire, another node id, and the old one again."""
    lss = network.lss
    lss.RESPONSE_TIMEOUT = WAIT_S
    with node_of(network) as node:
        identity = [node.sdo[0x1018][k].raw for k in range(1, 5)]
    for old, new in ((MOTOR, FREE_ID), (FREE_ID, MOTOR)):
        assert lss.send_switch_state_selective(*identity)
        assert [lss.inquire_lss_address(code) for code in range(0x5A, 0x5E)] == identity
        assert lss.inquire_node_id() == old
        lss.configure_node_id(new)
        lss.configure_bit_timing(0)
        with node_of(network, node_id=new) as node:
            booted(network, new, lambda old=old: network.send_message(0x000, [130, old]))
            assert node.sdo[0x1000].raw == 0x00020192
            assert node.sdo[0x1014].raw & 0x7FF == 0x80 + new
