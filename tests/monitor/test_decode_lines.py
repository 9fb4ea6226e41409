"""The lines of whole columns are those of the single rows, whatever the frames are."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from coulombus.kernels.records import Records, new_records
from coulombus.monitor import decode as module
from coulombus.monitor.decode import as_text, rows, text_lines
from coulombus.recording.pcapng_writer import PcapngWriter, SectionTexts
from coulombus.recording.reading import blocks
from coulombus.rigs.rig import Rig, load_rig, load_rig_text
from coulombus.system.foreign_text import printable
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.frame import Frame

COUNT = 3000


def two_buses() -> Rig:
    """Return the rig of two axes with a bus for each."""
    rig = load_rig("two_axes")
    text = rig.text.replace("[axis.left]", '[axis.left]\nbus.channel = "a"', 1)
    text = text.replace("[axis.right]", '[axis.right]\nbus.channel = "b"', 1)
    return load_rig_text(text, "two.toml", dict(rig.eds_texts))


def any_frames(rig: Rig, seed: int, buses: int) -> Records:
    """Return PDOs, some of a wrong length, and every other service; few words, so that they come again."""
    chance = np.random.default_rng(seed)
    pdos = [pdo.layout.cob_id for pdo in rig.pdos()]
    others = [0, 0x80, 0x81, 0x82, 0x100, 0x701, 0x702, 0x581, 0x601, 0x282, 0x7E4, 0x7E5, 0x7FF]
    flagged = [CAN_EFF_FLAG | 0x12345, CAN_RTR_FLAG | 0x181, CAN_RTR_FLAG | 0x701, CAN_ERR_FLAG | 0x40]
    frames = new_records(Frame, COUNT)
    frames["t_ns"] = np.cumsum(chance.integers(1, 400_000, COUNT))
    frames["can_id"] = chance.choice([*3 * pdos, *others, *flagged], COUNT)
    frames["length"] = chance.choice([0, 1, 2, 4, 6, 8, 8, 8, 8], COUNT)
    frames["word"] = chance.choice(chance.integers(-(2**63), 2**63 - 1, 40), COUNT)
    frames["word"] &= np.array([(1 << 8 * n) - 1 for n in range(8)] + [-1])[frames["length"]]
    frames["source"] = chance.integers(0, buses, COUNT)
    return frames


def expected(source: Iterable[object]) -> list[str]:
    return [printable(as_text(row)) for row in rows(source)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [lambda: load_rig("bench"), lambda: load_rig("two_axes"), two_buses])
def test_the_lines_are_those_of_the_rows(tmp_path, monkeypatch, make, seed):
    monkeypatch.setattr("coulombus.recording.pcapng_reader.CHUNK", 60_000)  # so that there are several blocks
    monkeypatch.setattr(module, "MOST_KEPT", 50)
    rig, path = make(), tmp_path / "any.pcapng"
    frames = any_frames(rig, seed, len(rig.channels))
    texts = {row: ("phase hold", "two\nlines", "\x1b[31m", "100 %d")[row % 4] for row in range(0, COUNT, 37)}
    with PcapngWriter(
        path, attachments={}, interface=None if len(rig.channels) > 1 else "can0", texts=SectionTexts(application="x")
    ) as writer:
        for name in rig.channels if len(rig.channels) > 1 else ():
            writer.add_interface(name)
        writer.write(frames, texts)
    lines = list(text_lines(blocks(path, rig)))
    assert len(lines) > 1
    assert [line for block in lines for line in block] == expected(blocks(path, rig))
    assert any("statusword" in line for line in lines[0])
    assert any("SDO" in line for line in lines[0])
