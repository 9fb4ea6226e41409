"""Exports, each read back with another library and held against `read`."""

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

from bench_recording import CYCLES, MS, STRANGE, record
from coulombus.recording.export.errors import ExportError
from coulombus.recording.export.export import FRAMES, KINDS, SIGNALS, export
from coulombus.recording.export.hdf import _Place
from coulombus.recording.export.mcap import JSON_TEXTS
from coulombus.recording.export.text_rows import texts_of
from coulombus.recording.extras import MissingExtra
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording, UnknownSignal
from coulombus.rigs.arguments import WrongCall
from coulombus.system.unfinished_file import unfinished
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG

LIBRARIES = {"parquet": "pyarrow", "mf4": "asammdf", "mcap": "zstandard", "hdf5": "h5py"}


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("export") / "run.pcapng")


@pytest.fixture(scope="module")
def recording(source: Path) -> Recording:
    return read(source)


def exported(source: Path, out: Path, kind: str, **options) -> Path:
    if kind in LIBRARIES:
        pytest.importorskip(LIBRARIES[kind], reason=f"{kind} needs the extra 'export'")
    return export(source, out / f"run{KINDS[kind]}", kind, **options).path


def held(recording: Recording, name: str, instants_s: np.ndarray) -> np.ndarray:
    """Return the last value at each instant, worked out one by one."""
    series = recording[name]
    past = [np.flatnonzero(series.t_s <= t) for t in instants_s]
    return np.array([series.values[rows[-1]] if len(rows) else np.nan for rows in past], float)


def read_csv(path: Path):
    pandas = pytest.importorskip("pandas", reason="read back with pandas")
    table = pandas.read_csv(path, comment="#")
    assert next(iter(table.columns)) == "t_s"
    units = dict(
        line[len("# unit of ") :].rsplit(": ", 1) for line in path.read_text().splitlines() if "# unit" in line
    )
    columns = {name: table[["t_s", name]].dropna() for name in table.columns[1:]}
    return {n: (c["t_s"], c[n], units[n].replace("1, a word of bits", "")) for n, c in columns.items()}


def read_parquet(path: Path):
    table = pytest.importorskip("pyarrow.parquet").read_table(path)
    columns = {}
    for field in list(table.schema)[1:]:
        there = table.column(field.name).is_valid()
        t_s, values = (table.column(name).filter(there).to_numpy() for name in ("t_s", field.name))
        columns[field.name] = t_s, values, field.metadata[b"unit"].decode()
    return columns


def read_mf4(path: Path):
    with pytest.importorskip("asammdf").MDF(path) as mdf:
        names = {c.name for group in mdf.groups for c in group.channels} - {"t_s", "markers"}
        assert all(group.channels[0].name == "t_s" for group in mdf.groups)
        return {name: (mdf.get(name).timestamps, mdf.get(name).samples, mdf.get(name).unit) for name in names}


def read_hdf5(path: Path):
    with pytest.importorskip("h5py").File(path) as file:
        names = set(file) - {"markers"}
        return {n: (file[n]["t_s"][:], file[n]["values"][:], file[n]["values"].attrs["unit"]) for n in names}


def read_mat(path: Path):
    from scipy.io import loadmat

    content = loadmat(path, squeeze_me=True, struct_as_record=False)
    structs = {name: s for name, s in content.items() if hasattr(s, "values")}
    return {n.replace("_", ".", 1): (s.t_s, s.values, s.unit if len(s.unit) else "") for n, s in structs.items()}


def read_mcap(path: Path):
    make_reader = pytest.importorskip("mcap.reader").make_reader
    rows: dict[str, list[tuple[float, float]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        units = {name: unit for channel in summary.channels.values() for name, unit in channel.metadata.items()}
        for _, channel, message in reader.iter_messages():
            if channel.topic == "/markers":
                continue
            for node, signals in json.loads(message.data).items():
                for key, value in signals.items():
                    rows.setdefault(f"{node}.{key}", []).append((message.log_time / 1e9, value))
    assert summary.statistics.message_count == sum(summary.statistics.channel_message_counts.values())
    return {
        name: (*np.array([(t, v) for t, v in pairs if v is not None]).T, units[name]) for name, pairs in rows.items()
    }


READERS = {
    "csv": read_csv,
    "parquet": read_parquet,
    "mf4": read_mf4,
    "hdf5": read_hdf5,
    "mat": read_mat,
    "mcap": read_mcap,
}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the libraries' own
@pytest.mark.parametrize("kind", SIGNALS)
def test_what_another_library_reads_is_what_read_has(source, recording, tmp_path, kind):
    exported_signals = READERS[kind](exported(source, tmp_path, kind))
    assert set(exported_signals) == set(recording.signals)
    for name, (t_s, values, unit) in exported_signals.items():
        assert np.array_equal(t_s, recording[name].t_s), name
        assert np.array_equal(values, recording[name].values), name
        assert unit == recording[name].unit


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("kind", SIGNALS)
def test_on_a_grid_each_instant_has_the_last_value(source, recording, tmp_path, kind):
    names = ["brake.setpoint_Nm", "motor.statusword"]
    exported_signals = READERS[kind](exported(source, tmp_path, kind, signals=names, grid_ns=500_000))
    assert set(exported_signals) == set(names)
    instants = np.arange(6, 806) * 0.0005  # from the first frame at 3 ms to the last one at 402.4 ms
    for name, (t_s, values, _) in exported_signals.items():
        expected = held(recording, name, instants)
        there = np.isfinite(np.asarray(values, float))
        assert np.allclose(np.asarray(t_s)[there], instants[np.isfinite(expected)][: there.sum()], rtol=0, atol=1e-12)
        assert np.array_equal(np.asarray(values, float)[there], expected[np.isfinite(expected)][: there.sum()])
        assert there.sum() == np.isfinite(expected).sum() - 1  # 402.5 ms is behind the last frame


def test_the_columns_of_csv_and_their_empty_cells(source, recording, tmp_path):
    lines = exported(source, tmp_path, "csv").read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    assert lines[head].split(",") == ["t_s", *recording.signals]
    torque, actual = (float(recording[f"motor.{name}_Nm"].values[0]) for name in ("target_torque", "torque"))
    assert lines[head + 1 : head + 5] == [
        f"0.003100001,15,{torque!r},,,,,,,",
        "0.003200007,,,,,,0.0,,,",
        "# 0.0033 run hybrid",
        f"0.0033,,,567,0.0,{actual!r},,,,",
    ]
    assert "# 0.005100001 phase hold" in lines
    assert "# 0.005100001 said by hand" in lines


def test_markers_are_in_every_kind_of_table(source, tmp_path):
    texts = ["run hybrid", "phase hold", "said by hand"]
    markers = [(0.0033, texts[0]), (0.005100001, texts[1]), (0.005100001, texts[2])]
    path = exported(source, tmp_path, "parquet")
    metadata = pytest.importorskip("pyarrow.parquet").read_metadata(path).metadata
    assert [tuple(marker) for marker in json.loads(metadata[b"markers"])] == markers
    with pytest.importorskip("h5py").File(exported(source, tmp_path, "hdf5")) as file:
        assert [text.decode() for text in file["markers/text"][:]] == texts
    with pytest.importorskip("asammdf").MDF(exported(source, tmp_path, "mf4")) as mdf:
        assert [text.rstrip(b"\0").decode() for text in mdf.get("markers").samples] == texts
    with exported(source, tmp_path, "mcap").open("rb") as file:
        messages = pytest.importorskip("mcap.reader").make_reader(file).iter_messages(topics=["/markers"])
        assert [json.loads(message.data)["text"] for _, _, message in messages] == texts


@pytest.mark.parametrize("kind", FRAMES)
def test_python_can_reads_the_frames_of_a_log(source, recording, tmp_path, kind):
    with can.LogReader(exported(source, tmp_path, kind)) as reader:
        messages = list(reader)
    frames = recording.frames
    assert len(messages) == len(frames)
    for message, frame in zip(messages, frames, strict=True):
        can_id, length = int(frame["can_id"]), int(frame["length"])
        if kind != "candump":  # of which python-can takes one class of errors for errors
            assert message.is_error_frame == bool(can_id & CAN_ERR_FLAG)
        assert message.timestamp == pytest.approx((frame["t_ns"] - (3 * MS if kind == "asc" else 0)) / 1e9, abs=1.1e-6)
        if can_id & CAN_ERR_FLAG:
            continue
        assert (message.arbitration_id, message.dlc) == (can_id & 0x1FFFFFFF, length)
        assert message.is_extended_id == bool(can_id & CAN_EFF_FLAG)
        assert message.is_remote_frame == bool(can_id & CAN_RTR_FLAG)
        if not message.is_remote_frame:
            assert bytes(message.data) == int(frame["word"]).to_bytes(8, "little", signed=True)[:length]


def test_lines_of_candump(source, tmp_path):
    lines = exported(source, tmp_path, "candump").read_text().splitlines()
    assert lines[:4] == [
        "(0000000000.003000) can0 080#",
        "(0000000000.003100) can0 201#0F00F9FF",
        "(0000000000.003200) can0 202#0000",
        "(0000000000.003300) can0 181#3702000000004D00",
    ]
    strange = [line.split(" ", 2)[2] for line in lines if line.startswith("(0000000000.2035")]
    assert strange == ["18FF1234#010203", "123#R4", "7FF#", "20000004#0004000000006000"]


@pytest.mark.skipif(shutil.which("tshark") is None, reason="no tshark")
def test_tshark_reads_candump_logs(source, recording, tmp_path):
    path = exported(source, tmp_path, "candump")
    words = ["tshark", "-r", str(path), "-T", "fields", "-e", "can.id", "-e", "can.len"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    rows = [line.split("\t")[:2] for line in done.stdout.splitlines()]
    frames = [f for f in recording.frames if not int(f["can_id"]) & CAN_ERR_FLAG]
    expected = [[str(int(f["can_id"]) & 0x1FFFFFFF), str(int(f["length"]))] for f in frames]
    assert [row for row in rows if row[0]] == expected


def test_stamps_are_the_wall_clocks_where_the_recording_knows_it(tmp_path):
    start_ns = 1_795_377_852 * 10**9
    source = record(tmp_path / "real.pcapng", 3, start_ns)
    assert exported(source, tmp_path, "candump").read_text().startswith("(1795377852.003000) can0 080#\n")
    with can.LogReader(exported(source, tmp_path, "blf")) as reader:
        assert next(iter(reader)).timestamp == pytest.approx(1_795_377_852.003, abs=1e-6)
    text = exported(source, tmp_path, "csv").read_text()
    assert "# start_utc: 2026-11-22T20:04:12.000000Z\n" in text
    assert "# meta subject: S01\n" in text


def test_a_torn_recording_is_exported_to_its_end_and_that_is_said(source, tmp_path):
    torn = tmp_path / "torn.pcapng"
    torn.write_bytes(source.read_bytes()[:-20])
    for kind in ("csv", "candump"):
        result = export(torn, tmp_path / kind, kind)
        assert "the last block is unfinished" in result.remarks[0]
    assert len((tmp_path / "candump").read_text().splitlines()) == 5 * CYCLES + len(STRANGE) - 1


@pytest.mark.parametrize("kind", ["csv", "blf"])
def test_nothing_recorded_is_an_error_and_leaves_no_file(tmp_path, kind):
    with pytest.raises(ExportError, match="it has no frame"):
        export(record(tmp_path / "empty.pcapng", 0), tmp_path / "out", kind)
    assert [path.name for path in tmp_path.iterdir()] == ["empty.pcapng"]


def test_an_unknown_signal_is_told_with_the_nearest(source, tmp_path):
    with pytest.raises(UnknownSignal, match=r"no signal 'motor.positon_rad' .* there is motor.position_rad") as error:
        export(source, tmp_path / "out.csv", "csv", signals=["motor.positon_rad"])
    assert error.value.exit_status == 2
    assert not (tmp_path / "out.csv").exists()


def test_a_text_where_names_are_meant_is_told(source, tmp_path):
    with pytest.raises(WrongCall, match=r"signals=\['motor.position_rad'\]"):
        export(source, tmp_path / "out.csv", "csv", signals="motor.position_rad")


def test_an_existing_file_stays(source, tmp_path):
    (tmp_path / "run.csv").write_text("mine")
    with pytest.raises(FileExistsError):
        exported(source, tmp_path, "csv")
    assert (tmp_path / "run.csv").read_text() == "mine"
    assert exported(source, tmp_path, "csv", force=True).read_text().startswith("# recording")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
def test_a_full_disk_leaves_no_file(source, tmp_path, kind):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    if kind in LIBRARIES:
        pytest.importorskip(LIBRARIES[kind])
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        with pytest.raises((OSError, ExportError)):
            exported(source, tmp_path, kind)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_hdf5_reads_back_what_a_full_disk_has_not_taken(tmp_path):
    """It believed whatever stood in memory there, and ended the process now and then."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with _Place(tmp_path / "f") as place:
        resource.setrlimit(resource.RLIMIT_FSIZE, (6, limits[1]))
        try:
            place.write(b"abcdefgh")
            place.seek(2)
            place.write(b"XY")
            place.seek(7)
            place.write(b"HIJ")
            place.truncate(12)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        place.seek(0)
        assert place.read(20) == b"abXYefgHIJ\0\0"
        assert place.seek(0, 2) == 12
        with pytest.raises(OSError, match="File too large"):
            place.check()


FULL = """
import resource, sys
from coulombus.recording.export.export import export
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), -1))
try:
    export(sys.argv[1], sys.argv[2], "hdf5")
except OSError as error:
    print(error.errno)
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    "limit", [pytest.param(500, marks=pytest.mark.long), 2000, pytest.param(20000, marks=pytest.mark.long)]
)
def test_hdf5_outlives_a_full_disk_whatever_stands_in_memory(source, tmp_path, limit):
    pytest.importorskip("h5py")
    words = [sys.executable, "-c", FULL, source, tmp_path / "run.h5", str(limit)]
    dirty = {**os.environ, "MALLOC_PERTURB_": "165"}
    done = subprocess.run(words, capture_output=True, text=True, env=dirty, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (0, f"{errno.EFBIG}\n"), done.stderr
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, sys
from coulombus.recording.export import text_table
from coulombus.cli.main import main
text_table.CsvWriter.close = lambda writer: os.kill(os.getpid(), int(sys.argv[3]))
main(["export", sys.argv[1], "--to", "csv", "-o", sys.argv[2]])
"""


def killed(source: Path, out: Path, number: int) -> int:
    words = [sys.executable, "-c", KILLED, source, out, str(int(number))]
    return subprocess.run(words, capture_output=True, timeout=300, check=False).returncode


@pytest.mark.thorough
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGINT,
        signal.SIGHUP,
        pytest.param(signal.SIGTERM, marks=pytest.mark.long),
        pytest.param(signal.SIGQUIT, marks=pytest.mark.long),
    ],
)
def test_an_export_that_a_signal_ends_leaves_nothing(source, tmp_path, number):
    assert killed(source, tmp_path / "x.csv", number) == 128 + number
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
def test_what_a_killed_export_leaves_the_next_one_removes(source, tmp_path):
    for _ in range(2):
        assert killed(source, tmp_path / "x.csv", signal.SIGKILL) == -signal.SIGKILL
        (left,) = tmp_path.iterdir()  # the first one's is gone
        assert left.name.startswith(".x-")
    machine, pid = left.name.split("-")[1:3]
    kept = [
        unfinished(tmp_path / "y.csv").name,  # of a process that lives
        f".x-{pid}-0a1b2c3d.csv",
        f".x-{int(machine, 16) ^ 1:08x}-{pid}-0a1b2c3d.csv",  # of another machine that has the folder, too
        left.name + ".bak",
        left.name[1:],
    ]
    for name in kept:
        (tmp_path / name).touch()
    (tmp_path / left.name.replace(".x-", ".folder-")).mkdir()
    (tmp_path / left.name.replace(".x-", ".link-")).symlink_to("nowhere")
    export(source, tmp_path / "z.csv", "csv")
    names = {path.name for path in tmp_path.iterdir()}
    assert left.name not in names
    assert names > {*kept, "z.csv"}
    assert len(names) == len(kept) + 3


def test_a_library_that_is_absent_is_named_with_its_extra(source, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MissingExtra, match=r"parquet needs pyarrow.*'\.\[export\]'"):
        export(source, tmp_path / "run.parquet", "parquet")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["csv", "candump"])
def test_nothing_is_written_over_the_recording_itself(source, tmp_path, kind):
    copied = tmp_path / "run.pcapng"
    shutil.copy(source, copied)
    link = tmp_path / "link.csv"
    link.symlink_to(copied)
    for out in (copied, link):
        with pytest.raises(ExportError, match="that is the recording itself"):
            export(copied, out, kind, force=True)
    assert copied.read_bytes() == source.read_bytes()


@pytest.mark.parametrize("kind", list(SIGNALS))
@pytest.mark.parametrize("grid_ns", [None, MS])
def test_a_log_without_a_known_map_is_refused_with_what_to_do(tmp_path, kind, grid_ns):
    if kind in LIBRARIES:
        pytest.importorskip(LIBRARIES[kind], reason=f"{kind} needs the extra 'export'")
    log = tmp_path / "log.log"
    log.write_text("(1.0) can0 123#00\n")
    with pytest.raises(ExportError, match=r"no PDO map of it is known; .*--rig.* candump"):
        export(log, tmp_path / f"x{KINDS[kind]}", kind, grid_ns=grid_ns)
    assert [path.name for path in tmp_path.iterdir()] == ["log.log"]


def test_an_unknown_kind_is_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(ExportError, match=r"'xlsx': expected one of .*csv.*parquet"):
        export(tmp_path / "a.pcapng", tmp_path / "a.xlsx", "xlsx")


def test_mcap_has_no_time_below_0_and_infinite_numbers_as_json(tmp_path):
    pytest.importorskip("zstandard", reason="mcap needs the extra 'export'")
    log = tmp_path / "log.log"
    lines = [f"({t:.6f}) can0 181#3712000000000000\n" for t in (1_700_000_005, 1_700_000_001)]
    log.write_text("".join(lines))
    with pytest.raises(ExportError, match=r"a frame is 4 s before the first one.*reordercap"):
        export(log, tmp_path / "x.mcap", "mcap", rig="bench")
    assert not (tmp_path / "x.mcap").exists()
    texts, _ = texts_of(np.array([np.inf, -np.inf, np.nan]), False, JSON_TEXTS)
    assert json.loads("[" + ",".join(texts) + "]") == [-np.inf, np.inf, None]


def test_a_name_of_another_kind_is_refused(source, tmp_path):
    with pytest.raises(ExportError, match=r".parquet is the ending of parquet; expected g.csv, or --to parquet"):
        export(source, tmp_path / "g.parquet", "csv")
    with pytest.raises(ExportError, match=r".pcapng is the ending of a recording; expected g.log"):
        export(source, tmp_path / "g.pcapng", "candump")
    assert not list(tmp_path.iterdir())
    assert export(source, tmp_path / "g.txt", "csv").rows == 4 * CYCLES
