"""The files of ``coulombus tools``, as other people's tools read them: the numbers of
`coulombus.read`, for our own rigs and for one with other makers' devices.
"""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import warnings
from pathlib import Path
from xml.etree import ElementTree

import can
import cantools
import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.cia402 import CONTROLWORD_FIELDS, STATUSWORD_FIELDS, word_fields
from coulombus.kernels.records import new_records
from coulombus.monitor.tools.tool_files import tool_files
from coulombus.recording.logs.mf4 import ready
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame, data_word
from foreign_rigs import brake, drive, rig_of

RIGS = {
    "bench": lambda: load_rig("bench"),
    "two axes": lambda: load_rig("two_axes"),
    "foreign": lambda: rig_of(drive("B"), brake("401")),
}
FRAMES = 40
needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")


@pytest.fixture(params=RIGS)
def rig(request):
    return RIGS[request.param]()


@pytest.fixture
def folder(rig, tmp_path):
    for name, text in tool_files(KnownBus(rig)).items():
        path = tmp_path / "tools" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path / "tools"


@pytest.fixture
def recording(rig, tmp_path):
    """Write a recording of every PDO with any content but one: positions stay on their side of the
    counter's end.
    """
    random = np.random.default_rng(7)
    rows = []
    for i in range(FRAMES):
        for pdo in rig.pdos():
            word = 0
            for _, entry, start in pdo.fields():
                raw = int(random.integers(1, 1 << min(entry.bits, 20))) & ((1 << entry.bits) - 1)
                negative = entry.signed and i % 2
                raw = -raw & ((1 << entry.bits) - 1) if negative and raw < 1 << entry.bits - 2 else raw
                word |= raw << start
            rows.append((pdo.layout.cob_id, word.to_bytes(8, "little")[: pdo.layout.length]))
    rows += [(0x080, b""), (0x701, b"\x05"), (0x081, bytes.fromhex("5082110102030405")), (0x000, b"\x01\x00")]
    frames = new_records(Frame, len(rows))
    for i, (frame, (can_id, data)) in enumerate(zip(frames, rows, strict=True)):
        frame["t_ns"], frame["can_id"], frame["length"] = 1_000_000 * (i + 1), can_id, len(data)
        frame["word"] = data_word(data)
    path = tmp_path / "run.pcapng"
    with PcapngWriter(path, attachments={}) as writer:
        writer.write(frames)
    return path


def test_fields_of_a_word_cover_it_without_overlap():
    for all_fields, reserved in ((STATUSWORD_FIELDS, 0), (CONTROLWORD_FIELDS, 0x0400)):
        masks = [field.mask for field in all_fields]
        assert sum(masks) == 0xFFFF - reserved
        assert sum(mask.bit_count() for mask in masks) == 16 - reserved.bit_count()
    assert word_fields(0x6841) is STATUSWORD_FIELDS
    assert word_fields(0x6064) == word_fields(0x2041) == ()
    assert STATUSWORD_FIELDS[0].values[0x37] == "operation enabled"


@pytest.mark.parametrize("form", ["dbc", "kcd", "sym"])
def test_cantools_decodes_what_read_decodes(rig, folder, recording, form):
    databases = {p.stem: cantools.database.load_file(p, strict=True) for p in folder.glob(f"*.{form}")}
    seen = read(recording, rig)
    split = databases[f"{rig.name}-bits" if form == "dbc" else rig.name]
    for pdo in rig.pdos():
        raws = [
            row["word"].item().to_bytes(8, "little", signed=True)
            for row in seen.frames
            if row["can_id"] == pdo.layout.cob_id
        ]
        for signal, entry, start in pdo.fields():
            name, values = signal.identifier, seen[signal.name].values
            for raw, value in zip(raws, values, strict=True):
                data = raw[: pdo.layout.length]
                decoded = split.decode_message(pdo.layout.cob_id, data, decode_choices=False)
                if not word_fields(entry.index):
                    assert decoded[name] == pytest.approx(value, rel=1e-9, abs=1e-12)
                    continue
                parts = word_fields(entry.index)
                assert sum(decoded[f"{name}_{part.name}"] << part.start for part in parts) == value & sum(
                    p.mask for p in parts
                )
            if form == "dbc":
                whole = databases[rig.name].get_message_by_frame_id(pdo.layout.cob_id).get_signal_by_name(name)
                assert (whole.start, whole.length, whole.scale, whole.offset) == (
                    start,
                    entry.bits,
                    signal.scale,
                    signal.offset,
                )
                assert entry.kind == "real" or whole.minimum < whole.maximum


def test_states_bits_and_emergencies_have_names():
    rig = load_rig("bench")
    text = tool_files(KnownBus(rig))["bench-bits.dbc"]
    database = cantools.database.load_string(text, "dbc")
    values = database.decode_message("motor_TPDO1", bytes.fromhex("371200000000 0000"))
    assert values["statusword_state"] == "operation enabled"
    assert (values["statusword_remote"], values["statusword_mode_12"], values["statusword_warning"]) == (1, 1, 0)
    assert (
        database.decode_message("motor_RPDO1", bytes.fromhex("0f000000"))["controlword_command"] == "enable operation"
    )
    assert "RPDO time-out" in text


def test_canmatrix_reads_the_dbc(rig, folder):
    canmatrix = pytest.importorskip("canmatrix.formats")
    matrix = canmatrix.loadp_flat(str(folder / f"{rig.name}.dbc"))
    for pdo, signal in KnownBus(rig).signals():
        frame = next(candidate for candidate in matrix.frames if candidate.arbitration_id.id == pdo.layout.cob_id)
        field = frame.signal_by_name(signal.identifier)
        assert (float(field.factor), float(field.offset), field.unit) == (signal.scale, signal.offset, signal.unit)


def test_asammdf_with_the_dbc_has_the_numbers_of_read(rig, folder, recording, tmp_path):
    asammdf = pytest.importorskip("asammdf")
    ready()  # a verb that ran in this process has left asammdf out
    path = tmp_path / "run.mf4"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of asammdf's own calls
        with can.LogReader(recording) as reader, can.Logger(str(path)) as writer:
            for message in reader:
                writer(message)
        measurement = asammdf.MDF(path).extract_bus_logging({"CAN": [(str(folder / f"{rig.name}.dbc"), 0)]})
        seen = read(recording, rig)
        for pdo, signal in KnownBus(rig).signals():
            message = f"{pdo.node.replace('.', '_')}_{pdo.name}"
            samples = measurement.get(f"{message}.{signal.identifier}").samples
            np.testing.assert_allclose(samples.astype(float), seen[signal.name].values, rtol=1e-12, atol=1e-12)


def tshark(*words, home: Path) -> str:
    done = subprocess.run(
        ["tshark", *words], capture_output=True, text=True, timeout=120, check=False,
        env={"HOME": str(home), "PATH": "/usr/bin:/bin", "WIRESHARK_CONFIG_DIR": str(home / ".config" / "wireshark")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "lua" not in done.stderr.lower(), done.stderr
    return done.stdout


@needs_tshark
def test_tshark_with_the_dissector_has_the_numbers_of_read(rig, folder, recording, tmp_path):
    seen = read(recording, rig)
    lua = f"lua_script:{folder / f'{rig.name}.lua'}"
    keys = {signal.name: f"coulombus.{signal.plain_name}" for _, signal in KnownBus(rig).signals()}
    out = tshark(
        "-X", lua, "-r", str(recording), "-T", "fields", "-E", "separator=,", *(w for k in keys.values() for w in ("-e", k)),
        home=tmp_path,
    )  # fmt: skip
    columns = list(zip(*csv.reader(out.splitlines()), strict=True))
    for name, column in zip(keys, columns, strict=True):
        values = [float(int(text, 0)) if text.startswith("0x") else float(text) for text in column if text]
        np.testing.assert_allclose(values, seen[name].values, rtol=1e-12, atol=1e-12)


@pytest.mark.thorough
@needs_tshark
def test_tshark_filters_and_tells_in_words(tmp_path):
    rig = load_rig("bench")
    home = tmp_path / "home"
    for name, text in tool_files(KnownBus(rig)).items():
        place = home / ".config" / "wireshark" / "profiles" / name.removeprefix("wireshark/")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
    rows = [
        (0x080, b""),
        (0x181, bytes.fromhex("3712 a0860100 0000")),
        (0x181, bytes.fromhex("3712 00000000 0000")),
        (0x181, bytes.fromhex("3712")),
        (0x082, bytes.fromhex("5082 11 0102030405")),
        (0x601, bytes.fromhex("4000100000000000")),
        (0x000, b"\x80\x02"),
        (0x701, b"\x7f"),
    ]
    frames = new_records(Frame, len(rows))
    for i, (frame, (can_id, data)) in enumerate(zip(frames, rows, strict=True)):
        frame["t_ns"], frame["can_id"], frame["length"] = 1_000_000_000 + 250_000 * i, can_id, len(data)
        frame["word"] = data_word(data)
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        writer.write(frames)
    base = (
        "-X",
        f"lua_script:{home}/.config/wireshark/profiles/bench.lua",
        "-C",
        "bench",
        "-r",
        str(tmp_path / "a.pcapng"),
    )
    lines = tshark(*base, home=home).splitlines()
    for line, text in zip(
        lines,
        ("sync", "motor TPDO1  operation enabled, position +8.0003 rad, torque +0 Nm", "position +0 rad", "wrong length 2",
         "brake emcy  0x8250: RPDO time-out, register 11h", "ID: 1537", "nmt  enter pre operational, to brake",
         "motor heartbeat  pre-operational"),
        strict=True,
    ):  # fmt: skip
        assert text in line
    for rule, numbers in (
        ("coulombus.motor.position > 1", [2]),
        ('coulombus.motor.statusword.state == "operation enabled"', [2, 3]),
        ("coulombus.motor.statusword.remote == 1", [2, 3]),
        ("coulombus.emcy.code == 0x8250", [5]),
        ("coulombus.sync_delay > 0.0003", [3, 4]),
        ("coulombus.length.expert", [4]),
    ):
        out = tshark(*base, "-Y", rule, "-T", "fields", "-e", "frame.number", home=home)
        assert [int(text) for text in out.split()] == numbers, rule
    field = "coulombus.motor.position"
    assert "8.000317" in tshark(*base, "-q", "-z", f"io,stat,1,MAX({field}){field}", home=home)
    colours = tshark(*base, "-T", "fields", "-e", "frame.coloring_rule.name", "--color", home=home)
    assert "Coulombus: emergency" in colours


def test_layouts_name_every_signal(rig, folder):
    names = {signal.name for _, signal in KnownBus(rig).signals()}
    root = ElementTree.fromstring((folder / f"{rig.name}-plotjuggler.xml").read_text())
    assert {curve.get("name") for curve in root.iter("curve")} == names
    layout = json.loads((folder / f"{rig.name}-foxglove.json").read_text())
    paths = [path for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert {path["label"] for path in paths} == names
    assert {path["value"] for path in paths} == {
        f"/{pdo.node}/{pdo.name}.{signal.name}" for pdo, signal in KnownBus(rig).signals()
    }


def _panels(layout):
    return [layout] if isinstance(layout, str) else _panels(layout["first"]) + _panels(layout["second"])


def test_the_foxglove_layout_has_each_panel_once(rig, folder):
    layout = json.loads((folder / f"{rig.name}-foxglove.json").read_text())
    assert sorted(_panels(layout["layout"])) == sorted(layout["configById"])


def test_command_writes_the_folder_and_replaces_nothing_unasked(tmp_path):
    def call(*more):
        return CliRunner().invoke(main, ["tools", str(tmp_path / "t"), *more])

    done = call("--json")
    assert done.exit_code == 0, done.output
    assert all(Path(path).is_file() for path in json.loads(done.stdout)["files"])
    (tmp_path / "t" / "bench.lua").write_text("mine")
    refused = call()
    assert refused.exit_code == 2
    assert "--overwrite" in refused.output
    assert (tmp_path / "t" / "bench.lua").read_text() == "mine"
    assert call("--force").exit_code == 0
    assert (tmp_path / "t" / "bench.lua").read_text() != "mine"
