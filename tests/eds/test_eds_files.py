"""Our two EDS files: no linter complains, canopen reads the same, and the contents are those that
were agreed.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import canopen
import pytest

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.reader import read_eds
from places import RIGS, ROOT

NODES = {"motor": 1, "mr_brake": 2}
BOTH = pytest.mark.parametrize("name", NODES)

CIA306_KEYS = {
    "ParameterName",
    "ObjectType",
    "SubNumber",
    "DataType",
    "LowLimit",
    "HighLimit",
    "AccessType",
    "DefaultValue",
    "PDOMapping",
}

COMMON = """
1000:0 UNSIGNED32 ro
1001:0 UNSIGNED8 ro 0
1003:0 UNSIGNED8 rw 0
1003:1 UNSIGNED32 ro 0
1003:8 UNSIGNED32 ro 0
1005:0 UNSIGNED32 rw 0x80
1006:0 UNSIGNED32 rw 0
1007:0 UNSIGNED32 rw 0
1008:0 VISIBLE_STRING const
1009:0 VISIBLE_STRING const
100A:0 VISIBLE_STRING const
100C:0 UNSIGNED16 rw 0
100D:0 UNSIGNED8 rw 0
1010:0 UNSIGNED8 const 4
1010:1 UNSIGNED32 rw 1
1010:4 UNSIGNED32 rw 1
1011:0 UNSIGNED8 const 4
1011:2 UNSIGNED32 rw 1
1011:3 UNSIGNED32 rw 1
1012:0 UNSIGNED32 rw 0x80000100
1014:0 UNSIGNED32 rw $80
1015:0 UNSIGNED16 rw 0
1016:0 UNSIGNED8 const 2
1016:1 UNSIGNED32 rw 0
1016:2 UNSIGNED32 rw 0
1017:0 UNSIGNED16 rw 0
1018:0 UNSIGNED8 const 4
1018:1 UNSIGNED32 ro 0x4C0
1018:3 UNSIGNED32 ro 0x10000
1019:0 UNSIGNED8 rw 0 0..240
1029:0 UNSIGNED8 const 2
1029:1 UNSIGNED8 rw 0 0..2
1029:2 UNSIGNED8 rw 1 0..2
1020:0 UNSIGNED8 const 2
1020:1 UNSIGNED32 rw 0
1020:2 UNSIGNED32 rw 0
1021:0 DOMAIN ro
1022:0 UNSIGNED16 ro 0
1200:0 UNSIGNED8 const 2
1200:1 UNSIGNED32 ro $600
1200:2 UNSIGNED32 ro $580
1201:0 UNSIGNED8 const 3
1201:1 UNSIGNED32 rw 0x80000000
1201:2 UNSIGNED32 rw 0x80000000
1201:3 UNSIGNED8 rw 1 1..127
1400:0 UNSIGNED8 const 5
1400:1 UNSIGNED32 rw $200
1400:2 UNSIGNED8 rw 1
1400:5 UNSIGNED16 rw 0
1402:1 UNSIGNED32 rw $80000400
1403:1 UNSIGNED32 rw $80000500
1602:0 UNSIGNED8 rw 0
1603:8 UNSIGNED32 rw 0
1800:0 UNSIGNED8 const 6
1800:1 UNSIGNED32 rw $180
1800:2 UNSIGNED8 rw 1
1800:3 UNSIGNED16 rw 0
1800:5 UNSIGNED16 rw 0
1800:6 UNSIGNED8 rw 0 0..240
1802:1 UNSIGNED32 rw $80000380
1803:1 UNSIGNED32 rw $80000480
1802:2 UNSIGNED8 rw 253
1803:2 UNSIGNED8 rw 252
1A02:0 UNSIGNED8 rw 1
1A02:1 UNSIGNED32 rw 0x10010008
1A03:0 UNSIGNED8 rw 1
1F80:0 UNSIGNED32 rw 4
1A03:8 UNSIGNED32 rw 0
2002:0 UNSIGNED32 rw 0
2003:0 UNSIGNED32 wo 0
2004:0 VISIBLE_STRING rw
"""
"""index:subindex, type, access, default ($: node id plus), limits.

The letter p: may be mapped into a PDO.
"""

CONTENTS = {
    "motor": """
1000:0 UNSIGNED32 ro 0x00020192
1018:2 UNSIGNED32 ro 0x402
1018:4 UNSIGNED32 ro 1
1600:0 UNSIGNED8 rw 2
1600:1 UNSIGNED32 rw 0x60400010
1600:2 UNSIGNED32 rw 0x60710010
1A00:0 UNSIGNED8 rw 3
1A00:1 UNSIGNED32 rw 0x60410010
1A00:2 UNSIGNED32 rw 0x60640020
1A00:3 UNSIGNED32 rw 0x60770010
1801:1 UNSIGNED32 rw $280
1A01:0 UNSIGNED8 rw 1
1A01:1 UNSIGNED32 rw 0x606C0020
2001:0 UNSIGNED32 rw 0
6007:0 INTEGER16 rw 2
603F:0 UNSIGNED16 ro 0 p
6040:0 UNSIGNED16 rww 0 p
6041:0 UNSIGNED16 ro 0 p
605A:0 INTEGER16 rw 2
605B:0 INTEGER16 rw 0
605C:0 INTEGER16 rw 1
605D:0 INTEGER16 rw 1
605E:0 INTEGER16 rw 0
6060:0 INTEGER8 rww 10 p
6061:0 INTEGER8 ro 10 p
6064:0 INTEGER32 ro 0 p
606C:0 INTEGER32 ro 0 p
6071:0 INTEGER16 rww 0 -10000..10000 p
6072:0 UNSIGNED16 rww 0 0..10000 p
6073:0 UNSIGNED16 rw
6074:0 INTEGER16 ro 0 p
6075:0 UNSIGNED32 rw
6076:0 UNSIGNED32 rw 180
6077:0 INTEGER16 ro 0 p
6078:0 INTEGER16 ro 0 p
6079:0 UNSIGNED32 ro 24000 p
6080:0 UNSIGNED32 rw
6087:0 UNSIGNED32 rww
608F:0 UNSIGNED8 const 2
608F:1 UNSIGNED32 rw 8192
608F:2 UNSIGNED32 rw 1
60E0:0 UNSIGNED16 rww 10000 0..10000 p
60E1:0 UNSIGNED16 rww 10000 0..10000 p
6502:0 UNSIGNED32 ro 0x30C
""",
    "mr_brake": """
1000:0 UNSIGNED32 ro 0x000A0194
1018:2 UNSIGNED32 ro 0x404
1018:4 UNSIGNED32 ro 2
1600:0 UNSIGNED8 rw 1
1600:1 UNSIGNED32 rw 0x73000110
1A00:0 UNSIGNED8 rw 3
1A00:1 UNSIGNED32 rw 0x71300110
1A00:2 UNSIGNED32 rw 0x71300210
1A00:3 UNSIGNED32 rw 0x71300310
1401:1 UNSIGNED32 rw $80000300
1801:1 UNSIGNED32 rw $80000280
2001:0 UNSIGNED32 rw 100000
2005:0 UNSIGNED32 rw 500000
6110:0 UNSIGNED8 const 3
6110:1 UNSIGNED16 ro
6126:1 REAL32 rw 1
6126:3 REAL32 rw 1
6127:1 REAL32 rw 0
6127:3 REAL32 rw 0
6131:1 UNSIGNED32 ro 0x00560000
6131:2 UNSIGNED32 ro 0x00040000
6131:3 UNSIGNED32 ro 0x002D0000
6132:1 UNSIGNED8 ro 3
6132:2 UNSIGNED8 ro 3
6132:3 UNSIGNED8 ro 1
6301:0 UNSIGNED8 const 1
6301:1 UNSIGNED32 ro 0x00560000
6302:1 UNSIGNED8 ro 3
6310:1 UNSIGNED16 ro
6340:1 UNSIGNED8 rw 1
7130:0 UNSIGNED8 const 3
7130:1 INTEGER16 ro 0 p
7130:2 INTEGER16 ro 0 p
7130:3 INTEGER16 ro 0 p
7300:0 UNSIGNED8 const 1
7300:1 INTEGER16 rww 0 0..5000 p
7341:1 INTEGER16 rw 0 0..5000
""",
}


def description(name):
    return read_eds(ROOT / "eds" / f"{name}.eds")


def sections(name):
    """The file as it stands: [(section, {key: value})], by no reader of EDS files."""
    names = []
    for line in (ROOT / "eds" / f"{name}.eds").read_text("ascii").splitlines():
        if line.startswith("["):
            names.append((line[1:-1], {}))
        elif line:
            key, _, value = line.partition("=")
            assert key not in names[-1][1], f"{names[-1][0]}: {key} twice"
            names[-1][1][key] = value
    return names


@BOTH
@pytest.mark.parametrize("tool", [("dcfchk", "-n"), ("eds-validate",)], ids=lambda tool: tool[0])
def test_the_field_s_linters_have_no_complaint(name, tool):
    program = Path(sys.executable).parent / tool[0]
    if not program.exists():
        pytest.skip(f"{tool[0]} is not installed (pip install dcf-tools eds-utils)")
    options = [*tool[1:], str(NODES[name])] if len(tool) > 1 else []
    run = subprocess.run([program, *options, ROOT / "eds" / f"{name}.eds"], capture_output=True, text=True, timeout=60)
    assert (run.stdout, run.stderr, run.returncode) == ("", "", 0)


@BOTH
def test_our_reader_has_no_complaint(name):
    d = description(name)
    assert d.diagnoses == ()
    assert d.dummies == set(range(1, 8))


@BOTH
def test_canopen_agrees_with_our_reader_on_everything(name):
    d, node_id = description(name), NODES[name]
    dictionary = canopen.import_od(str(ROOT / "eds" / f"{name}.eds"), node_id)
    assert {i for i in dictionary if i >= 0x1000} == set(d.objects)
    for index, entry in d.objects.items():
        theirs = dictionary[index]
        single = isinstance(theirs, canopen.objectdictionary.ODVariable)
        assert entry.name == theirs.name
        assert set(entry.variables) == ({0} if single else set(theirs.subindices))
        for subindex, x in entry.variables.items():
            other = theirs if single else theirs[subindex]
            assert d.default(index, subindex, node_id) == other.default, f"{index:04X}:{subindex}"
            assert (x.name, x.data_type, x.access, x.pdo_mappable) == (
                other.name,
                other.data_type,
                other.access_type,
                other.pdo_mappable,
            )
            assert (x.low, x.high) == (other.min, other.max)


def rows():
    for name in NODES:
        for line in (COMMON + CONTENTS[name]).split("\n"):
            if line:
                yield pytest.param(name, line, id=f"{name}-{line.split()[0]}")


@pytest.mark.parametrize(("name", "row"), list(rows()))
def test_contents(name, row):
    place, type_name, access, *rest = row.split()
    index, subindex = (int(part, 16) for part in place.split(":"))
    x = description(name).variable(index, subindex)
    assert (DATA_TYPES[x.data_type].name, x.access) == (type_name, access)
    if rest and re.fullmatch(r"\$?[-0-9a-fA-Fx]+", rest[0]):
        default = rest.pop(0)
        number = int(default[1:], 16) if default[0] == "$" else int(default, 0)
        assert (x.default, x.node_relative) == (number, default[0] == "$")
    if rest and ".." in rest[0]:
        assert [x.low, x.high] == [int(limit) for limit in rest.pop(0).split("..")]
    assert x.pdo_mappable == bool(rest) or access == "rww" or index == 0x1001


@BOTH
def test_pdo_parameters_have_all_their_sub_indices(name):
    d = description(name)
    for n in range(4):
        assert list(d.objects[0x1400 + n].variables) == [0, 1, 2, 5]
        assert list(d.objects[0x1800 + n].variables) == [0, 1, 2, 3, 5, 6]
        assert list(d.objects[0x1600 + n].variables) == list(range(9))
        assert list(d.objects[0x1A00 + n].variables) == list(range(9))
    assert not d.has(0x1404)
    assert not d.has(0x1804)


@BOTH
def test_only_keys_that_cia_306_knows(name):
    objects = [keys for section, keys in sections(name) if re.match(r"[0-9A-F]{4}(sub[0-9A-F]+)?$", section)]
    assert len(objects) > 150
    assert set().union(*objects) <= CIA306_KEYS
    heads = [section for section, _ in sections(name)]
    assert len(heads) == len(set(heads))


@BOTH
def test_the_highest_sub_index_is_told(name):
    for entry in description(name).objects.values():
        counts = entry.index == 0x1003 or 0x16 <= entry.index >> 8 < 0x18 or 0x1A <= entry.index >> 8 < 0x1C
        if len(entry.variables) > 1 and not counts:
            assert entry.variables[0].default == max(entry.variables), f"{entry.index:04X}"


@BOTH
def test_every_default_that_may_be_mapped_or_read_exists(name):
    """An object without a default would answer an SDO upload with an abort."""
    for entry in description(name).objects.values():
        for x in entry.variables.values():
            # a DOMAIN is the device's own to fill: 1021h answers with the file itself
            assert (x.default is None) == (x.index == 0x1021), f"{x.index:04X}:{x.subindex}"
            if x.pdo_mappable:
                assert x.bits in (8, 16, 32)


@BOTH
def test_the_device_information_matches_1018_and_the_rig_file(name):
    d = description(name)
    rig = tomllib.loads((RIGS / "bench.toml").read_text())[{"mr_brake": "brake"}.get(name, name)]
    assert rig["eds"] == f"{name}.eds"
    assert rig["node_id"] == NODES[name]
    assert int(d.info["VendorNumber"], 0) == d.variable(0x1018, 1).default == rig["vendor_id"]
    assert int(d.info["ProductNumber"], 0) == d.variable(0x1018, 2).default == rig["product_code"]
    assert int(d.info["RevisionNumber"], 0) == d.variable(0x1018, 3).default
    assert (d.info["NrOfRXPDO"], d.info["NrOfTXPDO"]) == ("4", "4")
    assert dict(sections(name))["FileInfo"]["FileName"] == f"{name}.eds"


def test_the_rig_s_numbers_stand_in_the_motor_s_objects():
    rig = tomllib.loads((RIGS / "bench.toml").read_text())
    d = description("motor")
    assert d.variable(0x608F, 1).default == rig["motor"]["encoder_counts_rev"]
    assert d.variable(0x6076, 0).default == round(1000 * rig["motor"]["rated_torque_Nm"])
    brake = description("mr_brake")
    assert brake.variable(0x2001, 0).default == round(1e6 * rig["brake"]["hold_s"])
    assert brake.variable(0x2005, 0).default == round(1e6 * rig["brake"]["ramp_s"])


def test_labels_need_a_segmented_transfer():
    for name in NODES:
        assert len(description(name).variable(0x2004, 0).default) > 4
