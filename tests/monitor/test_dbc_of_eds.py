"""A DBC, KCD or SYM file of EDS files: cantools decodes every PDO to the very numbers of `decode --eds`."""

from __future__ import annotations

import json
import math
import random

import cantools
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from places import CORPUS

MAKERS = sorted(path for path in CORPUS.glob("*") if path.suffix.lower() in (".eds", ".dcf", ".xdd", ".xdc"))
FILES = 100
TYPES = {
    0x01: 1,
    0x02: 8,
    0x03: 16,
    0x04: 32,
    0x05: 8,
    0x06: 16,
    0x07: 32,
    0x08: 32,
    0x0C: 48,
    0x10: 24,
    0x11: 64,
    0x12: 40,
    0x13: 48,
    0x14: 56,
    0x15: 64,
    0x16: 24,
    0x18: 40,
    0x19: 48,
    0x1A: 56,
    0x1B: 64,
}
NAMES = (
    *(
        "Position actual value",
        "Drehzahl größer 0",
        "Größe",
        "same",
        "same",
        "SAME",
        "SG_",
        "BO_ 12",
        '"quoted"',
        "a;b",
    ),
    *("温度", "3rd stage [°C]", "x" * 70, "x" * 69 + "y", "\\ back", "VAL_", "Vector__XXX", "NS_", "-", "tab\there"),
)
UNITS = ("", "", "rpm", "°C", "m/s²", "%", '"', "a b", "-m", "/f:2", "µm", "Ω", "//x", "x" * 40)
DUMMIES = {1: 1, 2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}


def own_file(seed):
    """Return an EDS file of odd types and maps, the same for the same seed."""
    rng = random.Random(seed)
    sections = ["[FileInfo]\nFileName=own.eds\n[DeviceInfo]\nVendorName=own\n[DummyUsage]"]
    sections += [f"Dummy{code:04X}=1" for code in DUMMIES]
    sections.append("[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0\n")
    objects = []
    for k in range(24):
        code = rng.choice(list(TYPES))
        name, index, unit = rng.choice(NAMES), 0x2000 + 0x100 * k, rng.choice(UNITS)
        if rng.random() < 0.3:
            sections.append(
                f"[{index:X}]\nParameterName={name}\nObjectType=9\nSubNumber=2\n"
                f"[{index:X}sub0]\nParameterName=count\nObjectType=7\nDataType=5\nAccessType=ro\nDefaultValue=0x1F\n"
                f"[{index:X}sub1F]\nParameterName={name}\nObjectType=7\nDataType=0x{code:04X}\nAccessType=rw\nPDOMapping=1\nUnit={unit}\n"
            )
            objects.append((index, 0x1F, code))
        else:
            sections.append(
                f"[{index:X}]\nParameterName={name}\nObjectType=7\nDataType=0x{code:04X}\nAccessType=rw\nPDOMapping=1\nUnit={unit}\n"
            )
            objects.append((index, 0, code))
    for first, base in ((0x1400, 0x200), (0x1800, 0x180)):
        for number in rng.sample([*range(1, 5), 5, 9, 12, 33, 300, 512], 7):
            sections.append(pdo(rng, first + number - 1, base + 0x100 * ((number - 1) % 4), objects))
    return "\n".join(sections)


def pdo(rng, index, base, objects):
    words, bits = [], 0
    most = 64 if rng.random() < 0.9 else 200  # at times more than fits
    while rng.random() < 0.85:
        if rng.random() < 0.15:
            code = rng.choice(list(DUMMIES))
            word = code << 16 | DUMMIES[code]
        else:
            place, sub, code = rng.choice(objects)
            word = place << 16 | sub << 8 | TYPES[code]
        if bits + (word & 0xFF) > most:
            break
        words.append(word)
        bits += word & 0xFF
    cob_id = rng.choice(
        (
            *(f"$NODEID+0x{base:X}", f"0x{base:X}+$NODEID", f"$NODEID+0x{base | 1 << 30:X}"),
            *(f"0x{base + rng.randint(1, 127):X}", f"$NODEID+0x{base | 1 << 31:X}", "0x1FF", "", "0x80000000"),
        )
    )
    text = (
        f"[{index:X}]\nParameterName=PDO\nObjectType=9\nSubNumber=3\n"
        f"[{index:X}sub0]\nParameterName=n\nObjectType=7\nDataType=5\nAccessType=ro\nDefaultValue=2\n"
        f"[{index:X}sub1]\nParameterName=id\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue={cob_id}\n"
        f"[{index:X}sub2]\nParameterName=type\nObjectType=7\nDataType=5\nAccessType=rw\nDefaultValue=255\n"
    )
    index += 0x200
    text += f"[{index:X}]\nParameterName=map\nObjectType=9\nSubNumber={len(words) + 1}\n"
    text += f"[{index:X}sub0]\nParameterName=n\nObjectType=7\nDataType=5\nAccessType=rw\nDefaultValue={len(words)}\n"
    for sub, word in enumerate(words, 1):
        text += f"[{index:X}sub{sub:X}]\nParameterName=m\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue=0x{word:08X}\n"
    return text


def run(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result


def same(ours, theirs):
    if isinstance(theirs, float) and not math.isfinite(theirs):
        return str(theirs).lower() in str(ours).lower() or (math.isnan(theirs) and "nan" in str(ours).lower())
    return ours == theirs and isinstance(ours, float) == isinstance(theirs, float)


def compared(files, folder, suffix, seed=1):
    """Compare all PDOs of nodes' files with random data; return the number of compared values."""
    rng = random.Random(seed)
    options = [word for node, path in files.items() for word in ("--eds", f"{node}={path}")]
    out, log = folder / f"out{suffix}", folder / "frames.log"
    run("dbc", *options, "-o", out, "--overwrite")
    database = cantools.database.load_file(out, strict=True)
    identifiers = [can_id for base in range(0x180, 0x580, 0x80) for can_id in range(base, base + 0x80)] + [0x1FF]
    frames = [(can_id, rng.randbytes(8)) for can_id in identifiers]
    log.write_text("".join(f"({k / 1e3:.6f}) can0 {c:03X}#{data.hex()}\n" for k, (c, data) in enumerate(frames)))
    rows = [json.loads(line) for line in run("decode", log, *options, "--json").stdout.splitlines()]
    values = 0
    for (can_id, data), row in zip(frames, rows, strict=True):
        objects = {key: value for key, value in row.items() if "h:" in key}
        try:
            message = database.get_message_by_frame_id(can_id)
        except KeyError:
            assert not objects, (can_id, row)
            continue
        signals = sorted(message.signals, key=lambda signal: signal.start)
        decoded = message.decode(data[: message.length], decode_choices=False)
        assert len(signals) == len(objects), (can_id, row, signals)
        for signal, (key, value) in zip(signals, objects.items(), strict=True):
            assert (signal.comment or "").startswith(key[:8]), (signal.comment, key)
            assert same(value, decoded[signal.name]), (hex(can_id), key, value, decoded[signal.name])
            values += 1
    return values


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".dbc", ".kcd", ".sym"])
def test_cantools_decodes_files_of_odd_types_and_maps_to_the_same_bits(tmp_path, suffix):
    values = 0
    for seed in range(FILES if suffix == ".dbc" else 12):
        path = tmp_path / "own.eds"
        path.write_text(own_file(seed), encoding="utf-8")
        values += compared({1 + seed % 127: path}, tmp_path, suffix, seed)
    assert values > (500 if suffix == ".dbc" else 50)


def test_several_nodes_share_identifiers(tmp_path):
    files = {}
    for node in (5, 6, 7):
        files[node] = tmp_path / f"{node}.eds"
        files[node].write_text(own_file(node), encoding="utf-8")
    assert compared(files, tmp_path, ".dbc") > 10


@pytest.mark.thorough
@pytest.mark.skipif(not MAKERS, reason="the makers' files are not here")
@pytest.mark.parametrize("suffix", [".dbc", ".kcd", ".sym"])
def test_cantools_decodes_makers_files_to_the_same_bits(tmp_path, suffix):
    assert sum(compared({7: path}, tmp_path, suffix) for path in MAKERS) > 100
