"""Which descriptions become live nodes, and as what: node ids, bit rates, stores, kinds, and what is
told of them. No bus is opened.
"""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import pytest

from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.io401 import IO401
from coulombus.node.kinds import GENERIC
from coulombus.node.store import FileStore
from coulombus.sim_bus.rig.shaft_load import Load, switch_counts
from coulombus.sim_bus.server import live_nodes
from coulombus.sim_bus.server.live_nodes import LiveNodes, NodeError, serves
from coulombus.wire.address import BusAddress
from eds_edit import edit, gone
from foreign_eds import BRAKE, MOTOR, another, with_array

UNCONFIGURED = 255


@pytest.fixture(autouse=True)
def said(monkeypatch):
    """Return what is said on stderr."""
    found = []
    monkeypatch.setattr(live_nodes, "say", found.append)
    return found


@pytest.fixture(autouse=True)
def shown(monkeypatch):
    """Return what is shown on stdout."""
    found = []
    monkeypatch.setattr(live_nodes, "show", found.append)
    return found


def commissioned(text, node_id, bit_rate=0):
    """Make an EDS file a DCF."""
    rate = f"Baudrate={bit_rate // 1000}\n" if bit_rate else ""
    return text + f"\n\n[DeviceComissioning]\nNodeID={node_id}\n{rate}\n"


def nodes(folder, *texts, **options):
    """Return the nodes of these (text, node id), whose files are 0.eds, 1.eds ..."""
    files = []
    for k, (text, node_id) in enumerate(texts):
        (folder / f"{k}.eds").write_text(text)
        files.append((folder / f"{k}.eds", node_id))
    return LiveNodes(files, **options)


# node ids and bit rates


def test_a_node_id_that_is_given_wins_over_that_of_a_dcf(tmp_path, said):
    found = nodes(tmp_path, (commissioned(MOTOR, 7), 5), (commissioned(BRAKE, 8), None), (commissioned(BRAKE, 9), 9))
    assert found.node_ids == [5, 8, 9]
    path = tmp_path / "0.eds"
    assert said == [
        f"coulombus: {path}: is a DCF for the node id 7 and is served as 5; which identifiers go with it tells "
        f"`coulombus eds check {path}`"
    ]
    assert [device.node_id for device in found.make_world(1_000_000, True).devices] == [5, 8, 9]


def test_a_file_without_a_node_id_needs_one(tmp_path, said):
    text = rf"^{tmp_path / '0.eds'} has no node id \(\[DeviceComissioning\] of a DCF has one\); give --node-id$"
    with pytest.raises(NodeError, match=text) as refused:
        nodes(tmp_path, (MOTOR, None))
    assert refused.value.exit_status == 2
    assert said == []


@pytest.mark.parametrize(
    ("ids", "refused"),
    [((5, 6), False), ((5, 5), True), ((5, 6, 5), True), ((UNCONFIGURED, UNCONFIGURED), False), ((5, UNCONFIGURED), False),
     ((5, UNCONFIGURED, UNCONFIGURED, 5), True)],
)  # fmt: skip
def test_each_node_has_an_id_of_its_own_but_for_those_that_have_none_yet(tmp_path, ids, refused):
    files = [(BRAKE, one) for one in ids]
    if not refused:
        assert nodes(tmp_path, *files).node_ids == list(ids)
        return
    with pytest.raises(NodeError, match=f"^node ids {', '.join(map(str, ids))}: each node needs an id of its own$"):
        nodes(tmp_path, *files)


@pytest.mark.parametrize(
    ("rates", "given", "rate"),
    [
        ((0, 0), 0, 0),
        ((500_000, 0), 0, 500_000),
        ((500_000, 500_000), 0, 500_000),
        ((500_000, 250_000), 125_000, 125_000),
        ((500_000, 0), 250_000, 250_000),
        ((0, 0), 250_000, 250_000),
        ((500_000, 250_000), 0, None),
    ],
)
def test_a_bus_has_one_bit_rate(tmp_path, rates, given, rate):
    files = [(commissioned(BRAKE, 5 + k, one), None) for k, one in enumerate(rates)]
    if rate is not None:
        assert nodes(tmp_path, *files, bit_rate=given).bit_rate == rate
        return
    text = "^the DCFs tell of 250000 and 500000 bit/s, but a bus has one bit rate; give --bitrate$"
    with pytest.raises(NodeError, match=text):
        nodes(tmp_path, *files)


# files


def test_a_store_is_a_file_of_one_node(tmp_path):
    store = tmp_path / "store"
    assert nodes(tmp_path, (BRAKE, 5), store=store).store == store
    text = f"^--store {store}: one file keeps one node; start a `coulombus node` for each$"
    with pytest.raises(NodeError, match=text):
        nodes(tmp_path, (BRAKE, 5), (BRAKE, 6), store=store)
    for wrong in (tmp_path, tmp_path / "none" / "store"):
        with pytest.raises(NodeError, match=f"^--store {wrong}: expected a file in an existing directory$"):
            nodes(tmp_path, (BRAKE, 5), store=wrong)


def test_a_file_that_is_no_store_is_not_replaced(tmp_path, said):
    store = tmp_path / "store"
    store.write_text("my thesis")
    with pytest.raises(NodeError, match=r"^--store .*; choose another file; this one is not overwritten$"):
        nodes(tmp_path, (BRAKE, 5), store=store)
    assert store.read_text() == "my thesis"
    assert said == []


def test_a_store_is_kept_and_read_again_and_one_of_another_device_is_told_once(tmp_path, said):
    store = tmp_path / "store"
    found = nodes(tmp_path, (BRAKE, 5), store=store)
    device = found.make_world(1_000_000, False).devices[0]
    kept = FileStore(store)
    kept.attach(device.store._identity)
    kept.put({"1": {"1017:00": b"\x32\0"}})
    said.clear()
    assert nodes(tmp_path, (BRAKE, 5), store=store).make_world(1_000_000, False)
    assert said == []
    other = nodes(tmp_path, (MOTOR, 5), store=store)
    assert said == []  # it is tried first, and told when it is served
    other.make_world(1_000_000, True)
    assert said == []
    other.make_world(1_000_000, False)
    assert len(said) == 1
    assert said[0].startswith(f"coulombus: {store}")


def test_the_converters_are_behind_one_node(tmp_path):
    (tmp_path / "io.toml").write_text("")
    text = f"^--io {tmp_path / 'io.toml'}: one file is for one node; start a `coulombus node` for each$"
    with pytest.raises(NodeError, match=text):
        nodes(tmp_path, (BRAKE, 5), (BRAKE, 6), io=tmp_path / "io.toml")


def test_the_converters_of_the_one_node_are_read_with_its_file_and_its_kind(tmp_path, monkeypatch):
    plans, pumps = [], []
    monkeypatch.setattr(live_nodes, "read_io_file", lambda *what: plans.append(what) or "plan")
    monkeypatch.setattr(live_nodes, "Pump", lambda *what: pumps.append(what) or "pump")
    assert nodes(tmp_path, (BRAKE, 5)).pump is None
    assert (plans, pumps) == ([], [])
    found = nodes(tmp_path, (BRAKE, 5), io=tmp_path / "io.toml")
    assert plans == [(tmp_path / "io.toml", found.descriptions[0], BRAKE404)]
    assert pumps == [("plan", live_nodes.Guard, found._report_hardware)]
    assert found.pump == "pump"


@pytest.mark.parametrize(("broken", "count"), [(("1017",), "1 diagnosis"), (("1017", "1014"), "2 diagnoses")])
def test_what_a_file_lacks_is_told(tmp_path, said, broken, count):
    text = BRAKE
    for section in broken:
        text = edit(text, section, AccessType="x")
    nodes(tmp_path, (text, 5))
    path = tmp_path / "0.eds"
    assert said == [f"coulombus: {path}: {count}, read tolerantly; see `coulombus eds check {path}`"]


def test_a_pdo_that_cannot_be_read_is_told(tmp_path, said):
    nodes(tmp_path, (edit(BRAKE, "1A00sub1", DefaultValue="x"), 5))
    assert said[-1].endswith("; the PDO is not valid at start, everything else is served")


# kinds


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        (MOTOR, None, DRIVE402),
        (BRAKE, None, BRAKE404),
        (another(MOTOR), None, GENERIC),
        (MOTOR, GENERIC, GENERIC),
        (another(MOTOR), DRIVE402, DRIVE402),
        (MOTOR, "auto", DRIVE402),
        (another(MOTOR), "auto", DRIVE402),
        (gone(another(MOTOR), "6040"), "auto", GENERIC),
    ],
)
def test_what_lives_behind_a_file(tmp_path, text, kind, expected):
    found = nodes(tmp_path, (text, 5), kind=kind)
    assert [one.name for one in found.kinds] == [expected.name]
    assert [device.profile.name for device in found.make_world(1_000_000, True).devices] == [expected.name]


def test_what_is_opened_is_told_and_served_where_the_kind_is_the_file_s(tmp_path, said):
    closed = edit(another(MOTOR), "6072", DefaultValue=0)
    found = nodes(tmp_path, (closed, 5), (BRAKE, 6), kind="auto")
    assert found.opened[1] == ()
    assert len(found.opened[0]) == 1
    assert "6072h" in found.opened[0][0]
    assert said == [f"coulombus: {found.opened[0][0]}"]
    assert found.descriptions[0].default(0x6072, 0, 5) == 3000
    assert nodes(tmp_path, (BRAKE, 6), (closed, 5), kind="auto").opened[1] == (
        found.opened[0][0].replace("0.eds", "1.eds"),
    )
    said.clear()
    left = nodes(tmp_path, (closed, 5), kind=DRIVE402)
    assert (left.opened, said) == ([()], [])
    assert left.descriptions[0].default(0x6072, 0, 5) == 0


def test_a_kind_that_is_asked_for_needs_its_objects(tmp_path):
    text = gone(another(MOTOR), "6040")
    name = DRIVE402.name
    with pytest.raises(NodeError, match=rf"0\.eds: got no 6040h:00, which kind {name} acts on; take --kind generic$"):
        nodes(tmp_path, (text, 5), kind=DRIVE402)
    with pytest.raises(NodeError, match=r"1\.eds: got no 6040h:00"):
        nodes(tmp_path, (MOTOR, 6), (text, 5), kind=DRIVE402)
    assert nodes(tmp_path, (gone(MOTOR, "6040"), 5)).kinds == [DRIVE402]  # it is ours, and nobody asked


def test_a_kind_with_terminals_needs_one_of_them(tmp_path):
    with pytest.raises(NodeError, match=r"0\.eds: got no 6000h, 6200h, 6401h, 6411h, which kind io acts on"):
        nodes(tmp_path, (MOTOR, 5), kind=IO401)
    outputs = with_array(another(MOTOR), "6200", "0x0005", 1)
    assert nodes(tmp_path, (outputs, 5), kind=IO401).kinds == [IO401]


# what drives drive


def test_each_drive_has_its_own_shaft_and_nothing_else_has_one(tmp_path):
    coarse = edit(MOTOR, "608Fsub1", DefaultValue=4096)
    live = nodes(tmp_path, (BRAKE, 5), (MOTOR, 6), (BRAKE, 7), (coarse, 8))
    world = live.make_world(1_000_000, True)
    assert world.axis_of[:4].tolist() == [-1, 0, -1, 1]
    assert world.plant["counts_rad"].tolist() == [8192 / math.tau, 4096 / math.tau]
    brake, fine, second_brake, halved = (tuple(device.record["switch_counts"]) for device in world.devices)
    assert brake == second_brake == (-math.inf, math.inf, math.inf, math.inf)
    assert fine == tuple(2 * count for count in halved) == switch_counts(world.devices[1].dictionary)


def test_switches_that_are_placed_are_on_every_axis(tmp_path):
    live = nodes(tmp_path, (MOTOR, 6), (MOTOR, 8))
    live.place_switches((-1.0, 0.0, 1.0, 2.0))
    devices = live.make_world(1_000_000, True).devices
    assert [device.record["switch_counts"].tolist() for device in devices] == [[-1.0, 0.0, 1.0, 2.0]] * 2


def test_a_load_is_for_a_drive(tmp_path):
    load = Load(friction_Nm=0.5)
    with pytest.raises(NodeError, match=r"^a load is for a drive without --io, and got kind brake, generic; take"):
        nodes(tmp_path, (BRAKE, 5), (another(MOTOR), 6), load=load)
    assert nodes(tmp_path, (BRAKE, 5), load=Load()).kinds == [BRAKE404]
    live = nodes(tmp_path, (BRAKE, 5), (MOTOR, 6), load=load)
    assert live.make_world(1_000_000, True).plant["coulomb"].tolist() == [0.5]


def test_a_drive_behind_converters_has_no_load(tmp_path, monkeypatch):
    monkeypatch.setattr(live_nodes, "read_io_file", lambda *what: "plan")
    monkeypatch.setattr(live_nodes, "Pump", lambda *what: "pump")
    live = nodes(tmp_path, (MOTOR, 6), io=tmp_path / "io.toml")
    assert live.make_world(1_000_000, True).axis_of[:1].tolist() == [-1]
    with pytest.raises(NodeError, match=r"^a load is for a drive without --io"):
        nodes(tmp_path, (MOTOR, 6), io=tmp_path / "io.toml", load=Load(friction_Nm=0.5))


def test_a_node_takes_its_time_for_a_request(tmp_path):
    found = nodes(tmp_path, (BRAKE, 5), (MOTOR, 6), processing_us=37.0006)
    devices = found.make_world(1_000_000, False).devices
    assert [device.record["processing_ns"] for device in devices] == [37_001] * 2


# what is told of the nodes


def server_of(found, kind="coulombus", joined=False):
    address = BusAddress(kind, "bus")
    return SimpleNamespace(address=address, joined=joined, bit_rate=500_000, world=found)


@pytest.mark.parametrize(
    ("kind", "joined", "expected"),
    [("coulombus", False, True), ("coulombus", True, False), ("socketcan", False, False), ("socketcan", True, False)],
)
def test_a_bus_is_served_here_where_it_is_virtual_and_nobody_else_s(kind, joined, expected):
    assert serves(server_of(None, kind, joined)) is expected


def test_a_world_tells_of_each_boot_up_and_each_twin_once(tmp_path, said, shown):
    found = nodes(tmp_path, (MOTOR, 5), (BRAKE, 6), as_json=True)
    world = found.make_world(500_000, False)
    found.begin(SimpleNamespace(address="bus", joined=False, bit_rate=500_000, world=world, now_ns=lambda: world.t_ns))
    found.server.address = BusAddress("coulombus", "bus")
    world.power_on()
    world.wait_ns(2_000_000_000)
    lines = [json.loads(line) for line in shown]
    assert [(line["event"], line["node_id"]) for line in lines] == [("ready", 5), ("ready", 6)]
    assert [line["eds"] for line in lines] == [str(tmp_path / "0.eds"), str(tmp_path / "1.eds")]
    assert [line["kind"] for line in lines] == [DRIVE402.name, BRAKE404.name]
    assert [(line["bitrate_bit_s"], line["serves_bus"], line["opened"]) for line in lines] == [(500_000, True, [])] * 2
    assert said == []
    twin = world.station(set(), lambda frame: None)
    for can_id in (0x706, 0x706, 0x585):
        twin.send(can_id, b"\x05")
        world.wait_ns(10_000_000)
    lines = [json.loads(line) for line in shown[2:]]
    assert [(line["event"], line["node_id"], line["can_id"], line["data"]) for line in lines] == [
        ("duplicate", 6, 0x706, "05"),
        ("duplicate", 5, 0x585, "05"),
    ]
    assert [text.rpartition(" has the ")[2] for text in said] == [
        "node id 6: it sent 706h 05; give one of them another id",
        "node id 5: it sent 585h 05; give one of them another id",
    ]


def test_nothing_is_told_before_the_server_is_there_nor_of_a_trial(tmp_path, said, shown):
    found = nodes(tmp_path, (MOTOR, 5))
    for trial in (True, False):
        world = found.make_world(500_000, trial)
        world.power_on()
        world.wait_ns(2_000_000_000)
    assert (shown, said) == ([], [])


def test_a_node_that_is_there_is_told_in_words(tmp_path, shown):
    found = nodes(tmp_path, (MOTOR, 5))
    world = found.make_world(500_000, False)
    begun = []
    found.on_begin = begun.append
    server = SimpleNamespace(
        address="coulombus:x", joined=False, bit_rate=500_000, world=world, now_ns=lambda: world.t_ns
    )
    found.begin(server)
    assert begun == [server]
    world.power_on()
    world.wait_ns(2_000_000_000)
    assert shown == [f"node 5 ({tmp_path / '0.eds'}) is on bus coulombus:x; Ctrl-C ends it"]
    twin = world.station(set(), lambda frame: None)
    twin.send(0x705, b"\x05")
    world.wait_ns(10_000_000)
    assert len(shown) == 1


def test_an_answer_is_no_boot_up(tmp_path, shown, said):
    found = nodes(tmp_path, (MOTOR, 5))
    world = found.make_world(500_000, False)
    world.power_on()
    world.wait_ns(2_000_000_000)
    found.begin(SimpleNamespace(address="bus", joined=False, bit_rate=500_000, world=world, now_ns=lambda: world.t_ns))
    answers = []
    tester = world.station({0x585}, answers.append)
    tester.send(0x605, b"\x40\x18\x10\x01\0\0\0\0")
    world.wait_ns(10_000_000)
    assert len(answers) == 1
    assert (shown, said) == ([], [])


def test_a_node_without_an_id_is_told_when_a_master_has_given_it_one(tmp_path, shown, said):
    found = nodes(tmp_path, (BRAKE, UNCONFIGURED))
    world = found.make_world(500_000, False)
    found.begin(SimpleNamespace(address="bus", joined=False, bit_rate=500_000, world=world, now_ns=lambda: world.t_ns))
    world.power_on()
    world.wait_ns(2_000_000_000)
    assert shown == []
    master = world.station(set(), lambda frame: None)
    for can_id, data in (
        (0x67F, b"\x40\x18\x10\x01\0\0\0\0"),  # a request to node 127
        (0x7FF, b"\0"),
        (0x70A, b"\x05"),  # node 10 is somebody else's
    ):
        master.send(can_id, data)
        world.wait_ns(10_000_000)
    assert (shown, said) == ([], [])
    for data in (b"\x04\x01", b"\x11\x09", b"\x04\0"):
        master.send(0x7E5, data.ljust(8, b"\0"))
        world.wait_ns(100_000_000)
    world.wait_ns(2_000_000_000)
    assert shown == [f"node 9 ({tmp_path / '0.eds'}) is on bus bus; Ctrl-C ends it"]
