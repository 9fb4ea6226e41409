"""What is done to a `Machine`: each `Scenario` does one thing, and says what must come of it: which
kinds may name the first incident, of which node, in which state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from benchmarks.explain_bus import CLEAR, HEARTBEAT_MS, MS, Machine
from benchmarks.explain_truths import Truth, truth_of
from coulombus.eds.cia301 import NmtCommand

__all__ = ["PAIR", "SCENARIOS", "Scenario", "healthy", "pair"]

REST_MS = 900
BOOT_MS = 5500
"""Time after a reset until it is known that a node does not boot."""
TIMED_OUT = (0x05040000).to_bytes(4, "little")
"""Code of an abort because of a time-out."""

Scenario = Callable[[Machine, int], Truth]


def node_off(machine: Machine, node: int) -> Truth:
    """A node loses its supply for good."""
    machine.network.power_off(machine.row(node))
    machine.run(REST_MS)
    return truth_of("node_lost", node, "unresolved", "node")


def _again(machine: Machine, node: int) -> None:
    """Bring a node up again, as a master does."""
    machine.commanded.discard(node)
    machine.run(30)
    machine.configure(node)
    machine.words[node] = 0
    machine.send_nmt(NmtCommand.START, node)
    machine.commanded.add(node)
    for word in (CLEAR, 0x06, 0x07, 0x0F):
        machine.words[node] = word
        machine.run(40)


def node_off_and_back(machine: Machine, node: int) -> Truth:
    """A node loses its supply for some heartbeats, and is brought up again."""
    machine.network.power_off(machine.row(node))
    machine.run(machine.dice.randint(4, 8) * HEARTBEAT_MS)
    machine.network.power_on(machine.row(node))
    machine.run(40)
    _again(machine, node)
    machine.run(REST_MS / 2)
    return truth_of("node_lost restarted", node, "recovered", "node")


def brown_out(machine: Machine, node: int) -> Truth:
    """A short dip: the node restarts, and nobody brings it up."""
    machine.network.power_off(machine.row(node))
    machine.run(12)
    machine.network.power_on(machine.row(node))
    machine.run(REST_MS)
    return truth_of("restarted", node, "unresolved", "node")


def brown_out_and_back(machine: Machine, node: int) -> Truth:
    """A short dip, and the master brings the node up."""
    machine.network.power_off(machine.row(node))
    machine.run(12)
    machine.network.power_on(machine.row(node))
    machine.run(40)
    _again(machine, node)
    machine.run(REST_MS / 2)
    return truth_of("restarted", node, "recovered", "node")


def refused_write(machine: Machine, node: int) -> Truth:
    """The master writes what the node does not take."""
    index, subindex, value, size = machine.dice.choice(((0x1000, 0, 1, 4), (0x2FF0, 1, 5, 2), (0x1018, 1, 3, 4)))
    machine.write(node, index, subindex, value, size)
    machine.run(REST_MS / 2)
    return truth_of("sdo_abort", node, "unresolved", "client")


def absent_node(machine: Machine, node: int) -> Truth:
    """The master asks a node that is not there."""
    absent = machine.dice.choice([number for number in range(61, 120) if number not in machine.ids])
    for _ in range(3):
        machine.ask(absent, bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0)), 10)
    machine.run(REST_MS)
    return truth_of("node_missing", absent, "unresolved", "unknown")


def second_master(machine: Machine, node: int) -> Truth:
    """Another master sends set-points to one node, too."""
    other = machine.network.station(())

    def send(at: int) -> None:
        data = (0x0F).to_bytes(2, "little") + (300 + machine.cycle % 3).to_bytes(2, "little")
        other.send(0x200 + node, data, at_ns=at + machine.period_ns // 4)

    machine.extra.append(send)
    machine.run(REST_MS)
    return truth_of("second_master", node, "unresolved", "client")


def second_sync(machine: Machine, node: int) -> Truth:
    """Another node produces SYNC, too."""
    other = machine.network.station(())
    machine.extra.append(lambda at: other.send(0x080, at_ns=at + int(0.3 * machine.period_ns)))
    machine.run(REST_MS)
    return truth_of("two_sync", None, "unresolved", "configuration")


def duplicate_node(machine: Machine, node: int) -> Truth:
    """A second device with the node id of another sends heartbeats and TPDOs."""
    other = machine.network.station(())
    beat = [machine.network.t_ns + 17 * MS]

    def send(at: int) -> None:
        other.send(0x180 + node, machine.cycle.to_bytes(8, "little"), at_ns=at + machine.period_ns // 8)
        if at > beat[0]:
            other.send(0x700 + node, b"\x05", at_ns=at)
            beat[0] = at + HEARTBEAT_MS * MS

    machine.extra.append(send)
    machine.run(REST_MS)
    return truth_of("duplicate_node", node, "unresolved", "configuration")


def master_gone(machine: Machine, node: int) -> Truth:
    """The master's program ends: no SYNC, no set-points, no heartbeat."""
    machine.syncing = machine.beating = False
    machine.commanded = set()
    machine.run(REST_MS)
    return truth_of("sync_lost host_lost", None, "unresolved", "host")


def sync_pause(machine: Machine, node: int) -> Truth:
    """The master stands still for some time."""
    commanded, machine.commanded = machine.commanded, set()
    machine.syncing = machine.beating = False
    pause_ms = max(15 * machine.period_ns / MS, 90)
    machine.run(pause_ms)
    machine.syncing = machine.beating = True
    machine.commanded = commanded
    machine.run(REST_MS)
    watched = machine.watches and (machine.drives or pause_ms > 2 * HEARTBEAT_MS + 30)
    return truth_of("sync_lost host_lost", None, "unresolved" if watched else "recovered")


def set_points_stop(machine: Machine, node: int) -> Truth:
    """The master stops commanding one node."""
    machine.commanded.discard(node)
    machine.run(REST_MS)
    return truth_of("rpdo_missing", node, "unresolved", "host")


def set_points_pause(machine: Machine, node: int) -> Truth:
    """The master leaves out some set-points of one node, fewer than its watch allows."""
    machine.commanded.discard(node)
    machine.run(3 * machine.period_ns / MS)
    machine.commanded.add(node)
    machine.run(REST_MS / 2)
    return truth_of("rpdo_missing", node, "recovered", "host")


def babble(machine: Machine, node: int) -> Truth:
    """A station floods the bus with a low identifier for some time."""
    other = machine.network.station(())
    identifier = machine.dice.choice((0x005, 0x010, 0x07F))
    for k in range(machine.dice.randint(500, 900)):
        other.send(identifier, b"\x55" * 8, at_ns=machine.network.t_ns + k * 160_000)
        if k % 200 == 199:
            machine.run(200 * 0.16)
    machine.run(REST_MS / 2)
    return truth_of("babble", None, "warning recovered unresolved")


def short_rpdo(machine: Machine, node: int) -> Truth:
    """The master sends an RPDO that is shorter than the node's map."""
    machine.commanded.discard(node)

    def send(at: int) -> None:
        machine.master.send(0x200 + node, machine.words[node].to_bytes(2, "little"), at_ns=at + machine.period_ns // 2)

    machine.extra.append(send)
    machine.run(REST_MS)
    return truth_of("pdo_length emcy", node, "unresolved")


def heartbeat_off(machine: Machine, node: int) -> Truth:
    """Somebody writes 0 to 1017h: the heartbeat ends, the PDOs go on."""
    machine.write(node, 0x1017, 0, 0, 2)
    machine.run(REST_MS)
    return truth_of("heartbeat_lost", node, "unresolved", "client node")


def drive_fault(machine: Machine, node: int) -> Truth:
    """A drive sees a fault that stays."""
    machine.inject(node, machine.dice.choice(("over_current", "over_temperature")), True)
    machine.run(REST_MS)
    return truth_of("emcy drive_fault", node, "unresolved")


def drive_fault_and_reset(machine: Machine, node: int) -> Truth:
    """A drive sees a fault that goes, and is reset and enabled again."""
    fault = machine.dice.choice(("over_current", "over_temperature"))
    machine.inject(node, fault, True)
    machine.run(60)
    machine.inject(node, fault, False)
    machine.run(30)
    for word in (0x00, CLEAR, 0x06, 0x07, 0x0F):
        machine.words[node] = word
        machine.run(max(40, 3 * machine.period_ns / MS))
    machine.run(REST_MS / 2)
    return truth_of("emcy drive_fault", node, "recovered")


def left_alone(machine: Machine, node: int) -> Truth:
    """A node goes to PRE-OPERATIONAL without an order that the bus saw."""
    machine.network.nmt_command(machine.row(node), NmtCommand.ENTER_PRE_OPERATIONAL)
    machine.run(REST_MS)
    return truth_of("left_operational", node, "unresolved", "node")


def full_bus(machine: Machine, node: int) -> Truth:
    """A station sends so much, with a priority below all PDOs, that nearly nothing is left."""
    other = machine.network.station(())
    load = len(machine.ids) * 2 * 115_000 / machine.period_ns + 0.06
    every_ns = round(128_000 / max(1.12 - load, 0.2))
    for _ in range(700 * MS // machine.period_ns):
        for k in range(machine.period_ns // every_ns):
            other.send(0x6E0 + k % 8, bytes(8), at_ns=machine.network.t_ns + k * every_ns)
        machine.run(machine.period_ns / MS)
    machine.run(REST_MS / 2)
    return truth_of("bus_load", None, "warning recovered unresolved")


def reset_in_vain(machine: Machine, node: int) -> Truth:
    """A node loses its supply, and the master commands it to reset, again and again."""
    machine.network.power_off(machine.row(node))
    machine.commanded.discard(node)
    for _ in range(machine.dice.randint(1, 4)):
        machine.run(machine.dice.choice((15, 60, 300)))
        machine.send_nmt(NmtCommand.RESET_NODE, node)
    machine.run(BOOT_MS)
    return truth_of("node_lost", node, "unresolved", "node")


def deaf_client(machine: Machine, node: int) -> Truth:
    """The master asks, does not take the answer, and gives up."""
    request = bytes((0x40, 0x18, 0x10, machine.dice.randint(1, 4), 0, 0, 0, 0))
    machine.ask(node, request)
    machine.run(machine.dice.choice((50, 200, 400)))
    machine.master.send(0x600 + node, b"\x80" + request[1:4] + TIMED_OUT)
    machine.run(REST_MS)
    return truth_of("sdo_not_taken", node, "unresolved", "client")


SCENARIOS: dict[str, tuple[Scenario, bool]] = {
    function.__name__: (function, drives)
    for function, drives in (
        (node_off, False), (node_off_and_back, False), (brown_out, False), (brown_out_and_back, False),
        (refused_write, False), (absent_node, False), (second_master, False), (second_sync, False),
        (duplicate_node, False), (master_gone, False), (sync_pause, False), (set_points_stop, False),
        (set_points_pause, False), (babble, False), (short_rpdo, False), (heartbeat_off, False),
        (drive_fault, True), (drive_fault_and_reset, True), (left_alone, False),
        (full_bus, False), (reset_in_vain, False), (deaf_client, False),
    )
}  # fmt: skip
"""What may be done, and whether it needs drives."""


PAIR = "pair"
AT_NODE = (node_off, node_off_and_back, brown_out, brown_out_and_back, refused_write, set_points_stop, set_points_pause,
           short_rpdo, heartbeat_off, left_alone, second_master, duplicate_node, absent_node)  # fmt: skip
"""What concerns one node, so that a second thing can be told beside it."""
AT_DRIVE = (drive_fault, drive_fault_and_reset)
FOR_ALL = (master_gone, sync_pause, second_sync, babble)
"""What concerns all nodes: as the second thing only."""


def pair(machine: Machine) -> Truth:
    """Do two things to two nodes, the second one after the first has come to rest."""
    drives = AT_DRIVE if machine.drives else ()
    first = machine.dice.choice((*AT_NODE, *drives))
    second = machine.dice.choice([other for other in (*AT_NODE, *drives, *FOR_ALL) if other is not first])
    nodes = machine.dice.sample(machine.ids, 2)
    truth = first(machine, nodes[0])
    machine.run(1200)
    return replace(truth, also=(second(machine, nodes[1]),))


def healthy(machine: Machine) -> None:
    """Run, and now and then look into a node as a person does; at times beside other healthy things."""
    dice = machine.dice
    extra = dice.choice(("", "inputs", "timer", "poll", "lss", "late boot"))
    other = machine.network.station(())
    alone = next(number for number in range(60, 120) if number not in machine.ids)
    period_ns = round(machine.period_ns * dice.choice((1.0005, 1.005, 1.3)))
    due = [machine.network.t_ns + 2 * machine.period_ns]

    def send(at: int) -> None:
        if extra == "inputs" and dice.random() < 0.3:  # event-driven
            other.send(0x380 + alone, dice.randbytes(2), at_ns=at + round(dice.uniform(0.1, 0.9) * machine.period_ns))
        while extra == "timer" and due[0] < at + machine.period_ns:  # by a clock of its own
            other.send(0x280 + alone, b"\1\2", at_ns=max(due[0], machine.network.t_ns))
            due[0] += period_ns
        if extra == "poll" and machine.cycle % 10 == 0:
            other.send(0x600 + machine.ids[0], bytes((0x40, 0x01, 0x10, 0, 0, 0, 0, 0)), at_ns=at)

    machine.extra.append(send)
    if extra == "lss":
        for data in (b"\x04\1", b"\x04\0"):
            other.send(0x7E5, data.ljust(8, b"\0"))
    if extra == "late boot":
        other.send(0x700 + alone, b"\0")
    for _ in range(3):
        machine.run(REST_MS / 3)
        if extra != "poll":
            machine.read(dice.choice(machine.ids), 0x1001, 0)
