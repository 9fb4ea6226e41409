"""PDO layouts from EDS defaults: read right or refused with file and line, never shifted."""

import struct

import numpy as np
import pytest

from coulombus.eds.codec import MAX_FIELDS, PDO, pack, real_bits, real_value, unpack
from coulombus.eds.pdo import Entry, PdoLayout, entry_of, fill, layouts, read_layout
from coulombus.eds.reader import EdsError, read_eds
from places import CORPUS, ROOT, beside

TYPES = {"BOOLEAN": 1, "INTEGER8": 2, "INTEGER16": 3, "INTEGER32": 4, "UNSIGNED8": 5, "UNSIGNED16": 6, "UNSIGNED32": 7}
TYPES |= {"REAL32": 8, "VISIBLE_STRING": 9, "INTEGER24": 0x10, "INTEGER40": 0x12, "INTEGER56": 0x14, "UNSIGNED64": 0x1B}
OBJECTS = {0x2000 + i: name for i, name in enumerate(TYPES)}
INDEX = {name: index for index, name in OBJECTS.items()}


def var(head, data_type, default=None):
    text = f"[{head}]\nParameterName=p{head}\nDataType={data_type}\nAccessType=rw\n"
    return text + (f"DefaultValue={default}\n" if default is not None else "")


def pdo(direction, words, *, number=1, count=None, **parameters):
    """Sections of one PDO; parameters sub1, sub2 ... as they stand in the file."""
    communication = {"rpdo": 0x1400, "tpdo": 0x1800}[direction] + number - 1
    text = f"[{communication:X}]\nParameterName=C\nObjectType=9\n" + var(f"{communication:X}sub0", 5, 6)
    for sub, default in parameters.items():
        text += var(f"{communication:X}{sub}", {"1": 7, "2": 5, "3": 6, "5": 6, "6": 5}[sub[3:]], default)
    mapping = communication + 0x200
    text += f"[{mapping:X}]\nParameterName=M\nObjectType=9\n"
    text += var(f"{mapping:X}sub0", 5, len(words) if count is None else count)
    for k, word in enumerate(words, 1):
        text += var(f"{mapping:X}sub{k:X}", 7, f"0x{word:08X}" if isinstance(word, int) else word)
    return text


@pytest.fixture
def describe(tmp_path):
    def make(text):
        path = tmp_path / "device.eds"
        path.write_text("".join(var(f"{i:X}", TYPES[name]) for i, name in OBJECTS.items()) + text)
        return read_eds(path)

    return make


def word(name, bits, sub=0):
    return INDEX[name] << 16 | sub << 8 | bits


def test_the_motor_s_pdos_as_the_agreement_has_them():
    pdos = {(p.direction, p.number): p for p in layouts(read_eds(ROOT / "eds" / "motor.eds"), 3)}
    assert sorted(pdos) == [(d, n) for d in ("rpdo", "tpdo") for n in (1, 2, 3, 4)]
    rpdo, tpdo = pdos["rpdo", 1], pdos["tpdo", 1]
    assert (rpdo.cob_id, rpdo.transmission, rpdo.length) == (0x203, 1, 4)
    assert [(e.index, e.subindex, e.bits, e.signed) for e in rpdo.entries] == [
        (0x6040, 0, 16, False),
        (0x6071, 0, 16, True),
    ]
    assert (tpdo.cob_id, tpdo.transmission, tpdo.length) == (0x183, 1, 8)
    assert [(e.index, e.subindex, e.bits, e.signed) for e in tpdo.entries] == [
        (0x6041, 0, 16, False),
        (0x6064, 0, 32, True),
        (0x6077, 0, 16, True),
    ]
    assert tpdo.starts == (0, 16, 48)
    assert [e.index for e in pdos["tpdo", 2].entries] == [0x606C]
    assert pdos["tpdo", 2].cob_id == 0x283
    for key in (("rpdo", 2), ("rpdo", 3), ("rpdo", 4), ("tpdo", 3), ("tpdo", 4)):
        rtr_only = {("tpdo", 3): [0x1001], ("tpdo", 4): [0x6077]}.get(key, [])
        assert (pdos[key].cob_id, [e.index for e in pdos[key].entries]) == (-1, rtr_only)


def test_communication_parameters_and_their_units(describe):
    d = describe(pdo("tpdo", [], sub1="$NODEID+0x40000380", sub2="0x3", sub3="15", sub5="200", sub6="7", number=3))
    (p,) = layouts(d, 9)
    assert (p.number, p.direction, p.cob_id, p.rtr_allowed) == (3, "tpdo", 0x389, False)
    assert (p.transmission, p.inhibit_ns, p.event_ns, p.sync_start) == (3, 1_500_000, 200_000_000, 7)


@pytest.mark.parametrize(
    ("written", "cob_id"),
    [
        ("0x123", 0x123),
        ("$NODEID+0x200", 0x205),
        ("0x200+$NODEID", 0x205),
        ("0x80000000", -1),
        ("$NODEID+0x80000200", -1),
        ("0", -1),
        ("", 0x205),
    ],
)
def test_identifiers(describe, written, cob_id):
    (p,) = layouts(describe(pdo("rpdo", [], sub1=written)), 5)
    assert p.cob_id == cob_id


def test_without_parameters_the_predefined_connection_set_holds(describe):
    text = "".join(pdo(direction, [], number=n) for direction in ("rpdo", "tpdo") for n in (1, 2, 3, 4, 5, 512))
    ids = {(p.direction, p.number): p.cob_id for p in layouts(describe(text), 5)}
    assert [ids["rpdo", n] for n in (1, 2, 3, 4, 5, 512)] == [0x205, 0x305, 0x405, 0x505, -1, -1]
    assert [ids["tpdo", n] for n in (1, 2, 3, 4, 5, 512)] == [0x185, 0x285, 0x385, 0x485, -1, -1]
    p = read_layout(describe(text), 5, "tpdo", 2)
    assert (p.transmission, p.inhibit_ns, p.event_ns, p.sync_start, p.rtr_allowed) == (255, 0, 0, 0, True)


def test_a_bit_granular_map_with_gaps_and_odd_widths(describe):
    """Packed by the codec, compared with a string of bits that is written out by hand."""
    words = [word("BOOLEAN", 1), 0x00010001, word("BOOLEAN", 1), word("INTEGER24", 24), 0x00050008]
    words += [word("UNSIGNED8", 8), word("INTEGER16", 16)]
    (p,) = layouts(describe(pdo("rpdo", words)), 1)
    assert p.starts == (0, 1, 2, 3, 27, 35, 43)
    assert [e.dummy for e in p.entries] == [False, True, False, False, True, False, False]
    assert p.length == 8  # 59 bits
    record = np.zeros(1, PDO).view(np.recarray)[0]
    widths = []

    def slot_of(index, subindex):
        widths.append((index, subindex))
        return len(widths) - 1

    fill(record, p, slot_of)
    assert widths == [(INDEX[n], 0) for n in ("BOOLEAN", "BOOLEAN", "INTEGER24", "UNSIGNED8", "INTEGER16")]
    values = np.array([1, 0, -2, 0xA5, -30000], np.int64)
    bits = ["1", "0", "0", f"{2**24 - 2:024b}", "0" * 8, f"{0xA5:08b}", f"{2**16 - 30000:016b}", "0" * 5]
    expected = int("".join(reversed(bits)), 2)
    assert pack(record, values) == expected
    back = np.zeros(5, np.int64)
    unpack(record, expected, back)
    assert back.tolist() == values.tolist()


def test_real32_and_integer40_side_by_side(describe):
    (p,) = layouts(describe(pdo("tpdo", [word("REAL32", 32), word("INTEGER24", 24), word("INTEGER8", 8)])), 1)
    assert [(e.kind, e.signed) for e in p.entries] == [("real", False), ("int", True), ("int", True)]
    record = np.zeros(1, PDO).view(np.recarray)[0]
    fill(record, p, lambda index, subindex: [INDEX[n] for n in ("REAL32", "INTEGER24", "INTEGER8")].index(index))
    data = struct.pack("<f", -0.3) + (-77777).to_bytes(3, "little", signed=True) + struct.pack("<b", -8)
    values = np.zeros(3, np.int64)
    unpack(record, int.from_bytes(data, "little", signed=True), values)
    assert real_value(values[0], 32) == struct.unpack("<f", struct.pack("<f", -0.3))[0]
    assert values[0] == real_bits(-0.3, 32)
    assert values[1:].tolist() == [-77777, -8]


@pytest.mark.parametrize("name", ["INTEGER40", "INTEGER56", "UNSIGNED64"])
def test_wide_integers(describe, name):
    bits = int(name[-2:])
    (p,) = layouts(describe(pdo("tpdo", [word(name, bits)])), 1)
    assert (p.length, p.entries[0].bits, p.entries[0].signed) == (bits // 8, bits, name.startswith("INT"))


def test_fill_leaves_nothing_of_the_former_layout(describe):
    d = describe(pdo("tpdo", [word("INTEGER8", 8)] * 8, sub1="0x181") + pdo("rpdo", [word("UNSIGNED16", 16)]))
    rpdo, tpdo = layouts(d, 1)
    record, fresh = np.zeros(2, PDO).view(np.recarray)
    fill(record, tpdo, lambda index, subindex: 7)
    assert record["slot"][:8].tolist() == [7] * 8
    fill(record, rpdo, lambda index, subindex: 3)
    fill(fresh, rpdo, lambda index, subindex: 3)
    assert record == fresh
    assert record["slot"].tolist() == [3] + [-1] * (MAX_FIELDS - 1)
    assert (record["length"], record["count"], record["cob_id"], record["rtr_allowed"]) == (2, 1, 0x201, 1)


def test_fill_refuses_more_fields_than_bits():
    entries = (Entry(0x2000, 0, 1, False, "int", "bit"),) * 65
    with pytest.raises(ValueError, match="65 fields in a PDO; at most 64 fit into 64 bits"):
        fill(np.zeros(1, PDO)[0], PdoLayout(1, "rpdo", 0x201, 1, 0, 0, 0, True, entries), lambda i, s: 0)


def test_64_bits_one_by_one(describe):
    (p,) = layouts(describe(pdo("tpdo", [word("BOOLEAN", 1)] * 64)), 1)
    assert (len(p.entries), p.length, p.starts[-1]) == (64, 8, 63)


def test_entries_beyond_the_count_are_not_mapped(describe):
    (p,) = layouts(describe(pdo("tpdo", [word("INTEGER8", 8), word("INTEGER16", 16)], count=1)), 1)
    assert [e.index for e in p.entries] == [INDEX["INTEGER8"]]
    (p,) = layouts(describe(pdo("tpdo", [word("INTEGER8", 8), 0], count=0)), 1)
    assert p.entries == ()
    (p,) = layouts(describe(pdo("tpdo", [0, 0], count="")), 1)
    assert p.entries == ()


def test_a_boolean_may_take_a_byte_and_a_string_any_width(describe):
    (p,) = layouts(describe(pdo("tpdo", [word("BOOLEAN", 8), word("VISIBLE_STRING", 32)])), 1)
    assert [(e.bits, e.signed) for e in p.entries] == [(8, False), (32, False)]


REFUSED = {
    "absent object": ([0x60640020], None, "sub1", r"maps 6064h:0 in 32 bits, which the file does not describe"),
    "absent sub-index": (
        [word("INTEGER8", 8, sub=2)],
        None,
        "sub1",
        r"maps 2001h:2 in 8 bits, which the file does not",
    ),
    "another width": (
        [word("INTEGER16", 8)],
        None,
        "sub1",
        r"in 8 bits, but INTEGER16 has 16; expected the same width",
    ),
    "dummy's width": ([0x00060008], None, "sub1", r"maps 0006h:0 in 8 bits, but UNSIGNED16 has 16"),
    "no bits": ([word("INTEGER8", 8), word("VISIBLE_STRING", 0)], None, "sub2", r"in 0 bits; expected 1 to 64 bits"),
    "too wide": ([word("VISIBLE_STRING", 72)], None, "sub1", r"in 72 bits; expected 1 to 64 bits"),
    "65 bits": ([word("UNSIGNED64", 64), word("BOOLEAN", 1)], None, "sub0", r"maps 65 bits; at most 64"),
    "a gap": ([word("INTEGER8", 8), 0], None, "sub0", r"says 2 entries, but entry 2 has no default"),
    "an entry too few": ([word("INTEGER8", 8)], 2, "sub0", r"says 2 entries, but entry 2 has no default"),
    "no count": ([word("INTEGER8", 8)], "", "sub0", r"1A00h:0 has no default, yet entries are mapped"),
    "multiplexed": (
        [word("INTEGER8", 8)],
        254,
        "sub0",
        r"1A00h:0 is 254; expected 0 to 64 entries \(no multiplexed PDO\)",
    ),
    "no number": (["6064"], None, "sub1", r"maps 0000h:23 in 176 bits; expected 1 to 64 bits"),
    "unreadable": (["position"], None, "sub1", r"DefaultValue=position is not a number; correct it"),
    "octal?": (["0123"], None, "sub1", r"may mean octal; correct it, a PDO parameter is never guessed"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_map_that_cannot_be_read_right_is_refused(describe, case):
    words, count, section, match = REFUSED[case]
    d = describe(pdo("tpdo", words, count=count))
    with pytest.raises(EdsError, match=match) as error:
        layouts(d, 1)
    line = d.text.split("\n").index(f"[1A00{section}]") + 1
    assert str(error.value).startswith(f"{d.path}:{line}: ")
    assert "; " in str(error.value)


def test_a_doubled_entry_is_refused_and_an_equal_one_is_not(describe):
    text = pdo("tpdo", [word("INTEGER8", 8)])
    with pytest.raises(EdsError, match="DefaultValue is given twice with different values"):
        layouts(describe(text + f"[1A00sub1]\nDefaultValue=0x{word('UNSIGNED8', 8):X}\n"), 1)
    (p,) = layouts(describe(text + f"[1A00sub1]\nDefaultValue={word('INTEGER8', 8)}\n"), 1)
    assert p.entries[0].index == INDEX["INTEGER8"]


def test_a_mapped_object_of_doubtful_type_is_refused(describe):
    text = pdo("tpdo", [0x60640020])
    with pytest.raises(EdsError, match="maps 6064h:0 in 32 bits, whose DataType is not known; give its DataType"):
        layouts(describe(text + "[6064]\nParameterName=P\nAccessType=ro\n"), 1)
    with pytest.raises(EdsError, match="whose DataType is not known"):
        layouts(describe(text + var("6064", 4) + "DataType=7\n"), 1)


@pytest.mark.parametrize("written", ["0x20000181", "0x800", "$NODEID+0x7FF"])
def test_identifiers_beyond_11_bits_are_refused(describe, written):
    with pytest.raises(EdsError, match=r"device\.eds:\d+: 1800h:1 has the identifier 0x\w+; expected 0x001 to 0x7FF"):
        layouts(describe(pdo("tpdo", [], sub1=written)), 5)


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_node_ids_beyond_their_range_are_refused(describe, node_id):
    with pytest.raises(ValueError, match="expected 1 to 127"):
        layouts(describe(pdo("tpdo", [])), node_id)


def test_a_device_without_pdos_has_none(describe):
    assert layouts(describe(""), 1) == ()


def test_an_entry_of_a_variable(describe):
    d = describe("")
    assert entry_of(d.variable(INDEX["INTEGER24"], 0)) == Entry(INDEX["INTEGER24"], 0, 24, True, "int", "p2009")
    assert entry_of(d.variable(INDEX["REAL32"], 0)) == Entry(INDEX["REAL32"], 0, 32, False, "real", "p2007")
    assert entry_of(d.variable(INDEX["VISIBLE_STRING"], 0), 16).bits == 16


def test_the_diagram_of_a_pdo():
    tpdo = read_layout(read_eds(ROOT / "eds" / "motor.eds"), 1, "tpdo", 1)
    assert tpdo.diagram().split("\n") == [
        "bit  63                 48 47                            16 15             0",
        "    +---------------------+--------------------------------+----------------+",
        "    | 6077:00             | 6064:00                        | 6041:00        |",
        "    | Torque actual value | Position actual value          | Statusword     |",
        "    +---------------------+--------------------------------+----------------+",
    ]


def test_the_diagram_of_bits_gaps_and_nothing(describe):
    text = pdo("rpdo", [word("BOOLEAN", 1), 0x00050008, word("BOOLEAN", 1)]) + pdo("tpdo", [])
    rpdo, tpdo = layouts(describe(text), 1)
    assert rpdo.diagram().split("\n") == [
        "bit  9         8      1 0",
        "    +---------+--------+---------+",
        "    | 2000:00 | -      | 2000:00 |",
        "    | p2000   | dummy  | p2000   |",
        "    +---------+--------+---------+",
    ]
    assert tpdo.diagram() == "(nothing is mapped)"


def test_a_wide_diagram_is_folded(describe):
    (p,) = layouts(describe(pdo("tpdo", [word("BOOLEAN", 1)] * 64)), 1)
    lines = p.diagram().split("\n")
    assert max(map(len, lines)) <= 120
    heads = " ".join(line[4:] for line in lines if line.startswith("bit"))
    assert [int(number) for number in heads.split()] == list(range(63, -1, -1))


corpus = beside(CORPUS)


@pytest.mark.slow
@corpus
def test_real_files_are_read_right_or_refused_with_a_line():
    read, refused = 0, []
    for path in sorted(CORPUS.glob("*.eds")) + sorted(CORPUS.glob("*.dcf")):
        d = read_eds(path)
        try:
            pdos = layouts(d, 5)
        except EdsError as error:
            refused.append((path, str(error)))
            continue
        read += 1
        for p in pdos:
            assert sum(entry.bits for entry in p.entries) <= 64
            base = {"rpdo": 0x1600, "tpdo": 0x1A00}[p.direction] + p.number - 1
            mapped = [e.index << 16 | e.subindex << 8 | e.bits for e in p.entries]
            assert mapped == [d.default(base, k, 5) for k in range(1, len(mapped) + 1)]
    assert read >= 25
    assert len(refused) <= 6
    for path, text in refused:
        assert text.startswith(f"{path}:")
        assert text.removeprefix(f"{path}:").split(":")[0].isdecimal()
