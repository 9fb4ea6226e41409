"""`read` and `blocks` of logs without a rig: signals by PDO and object, as far as maps are known."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.recording.bus_match import ChannelError
from coulombus.recording.reading import blocks, read
from coulombus.recording.signals import UnknownSignal, series
from coulombus.rigs.rig import RigError
from explain_log import machine
from places import EDS


def configured(log, node, ms, index, *words):
    """Add the downloads that map `words` into the PDO whose mapping parameter is `index`."""
    values = [*enumerate(words, 1), (0, len(words))]
    for n, (sub, value) in enumerate(values):
        place = f"{index & 0xFF:02X}{index >> 8:02X}{sub:02X}"
        log.ask(node, ms + n, f"23{place}{value.to_bytes(4, 'little').hex()}", f"60{place}00000000")
    return log


def written(log, path, bus="can0"):
    lines = []
    for frame in log.frames:
        data = int(frame["word"]).to_bytes(8, "little", signed=True)[: int(frame["length"])]
        lines.append(f"({frame['t_ns'] / 1e9:.6f}) {bus} {int(frame['can_id']):03X}#{data.hex().upper()}\n")
    path.write_text("".join(lines))
    return path


def both(path, **how):
    """Yield what `read` and `blocks` give."""
    yield read(path, **how)
    yield blocks(path, **how)


@pytest.fixture
def path(tmp_path):
    log = configured(machine(5, until=500), 5, 20, 0x1A00, 0x60410010, 0x60640020, 0x00050008)
    log.cycles(
        60,
        500,
        (5,),
        data=lambda cycle, node: (0x0637).to_bytes(2, "little") + (-cycle).to_bytes(4, "little", signed=True) + b"\1",
    )
    return written(log, tmp_path / "x.log")


def test_a_map_seen_in_the_log_gives_raw_signals_by_pdo_and_object(path):
    for recording in both(path):
        assert [signal.name for pdo in recording.pdos for signal in pdo.signals] == [
            *("5.TPDO1.6041h:00", "5.TPDO1.6064h:00", "5.TPDO1.gap3"),
        ]
        word, position = series(recording, "5.TPDO1.6041h:00", "5.TPDO1.6064h:00")
        assert set(word.values.tolist()) == {0x0637}
        assert position.values.dtype == np.int64
        assert (np.diff(position.values) == -1).all()
        assert len(position) == 220
        with pytest.raises(UnknownSignal, match="6064h"):
            recording.signal("5.TPDO1.6064h")
    assert "without a rig" in repr(read(path))
    assert "without a rig" in read(path)._repr_html_()


def test_what_needs_a_rig_says_so_at_its_place(path):
    for recording in both(path):
        assert recording.axes == (recording,)
        for need in (lambda r: r.rig, lambda r: r.one_axis(None), lambda r: r.seen_by("x")):
            with pytest.raises(RigError, match=r"no rig.toml is attached.*--rig"):
                need(recording)


def test_another_map_later_leaves_the_frames_before_out_and_says_so(tmp_path):
    log = configured(machine(5, until=9000), 5, 20, 0x1A00, 0x60410010, 0x60640020)
    log.cycles(60, 5000, (5,), data=lambda cycle, node: bytes(6))
    configured(log, 5, 5100, 0x1A00, 0x60640020, 0x60410010)
    log.cycles(5200, 9000, (5,), data=lambda cycle, node: (7).to_bytes(4, "little") + b"\x37\x06")
    path = written(log, tmp_path / "x.log")
    for recording in both(path):
        (position,) = series(recording, "5.TPDO1.6064h:00")
        assert set(position.values.tolist()) == {7}
        assert position.t_s[0] > 5.1
        assert any("5.TPDO1 got another map at frame" in remark for remark in recording.remarks)


def test_an_eds_file_tells_the_maps_of_a_node(tmp_path):
    log = machine(1, until=300).cycles(60, 300, (1,), data=lambda cycle, node: bytes(8))
    path = written(log, tmp_path / "x.log")
    assert not read(path).signals
    for recording in both(path, eds=[f"1={EDS / 'motor.eds'}"]):
        assert "1.TPDO1.6064h:00" in [signal.name for pdo in recording.pdos for signal in pdo.signals]


def test_a_log_of_two_buses_asks_for_one(path):
    path.write_text(path.read_text() + "(9.000000) can1 701#05\n")
    for reader in (read, lambda p: list(blocks(p))):
        with pytest.raises(ChannelError, match="can1"):
            reader(path)
    for recording in both(path, channel="can0"):
        assert len(series(recording, "5.TPDO1.6041h:00")[0]) == 220
        assert f"{path}: 1 frames of the bus can1 were left out" in recording.remarks
