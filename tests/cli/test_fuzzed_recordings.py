"""Recordings that somebody has mutilated, given to each verb that reads one: read, or refused with
a documented status; never a fault of this program.
"""

from __future__ import annotations

import random
import re
import struct

import pytest
from click.testing import CliRunner

from coulombus.cli.errors import FAULT, STATUSES
from coulombus.cli.main import main
from coulombus.lab.simulate import simulate
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter

PHASES = """phase=[{kind = "rest", duration_s = 0.05},
{kind = "stroke", duration_s = 0.1, speed_rad_s = 2.0, move_s = 0.03, dwell_s = 0.02}]""".replace("\n", " ")
VERBS = (
    *("decode FILE --json", "decode FILE", "hz FILE", "diff FILE WHOLE", "diff WHOLE FILE --tolerance 0.1"),
    *("export FILE --to csv -o OUT --force", "export FILE --to candump -o OUT --force"),
    *("replay FILE --host", "identify FILE", "plot FILE -o OUT.svg --force"),
)
NUMBERS = ("0", "-1", "1e308", "nan", "inf", "1e-320", "99999999999999999999", '""', "[]", "true", "0x7f")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "whole.pcapng"
    simulate("bench", "hybrid", 0.15, record=path, overrides=(PHASES,))
    return path


@pytest.fixture(scope="module")
def log(whole):
    path = whole.with_suffix(".log")
    assert CliRunner().invoke(main, ["export", str(whole), "--to", "candump", "-o", str(path)]).exit_code == 0
    return path


def blocks_of(content):
    """Return the blocks of a pcapng file of this machine's byte order."""
    found, at = [], 0
    while at < len(content):
        length = struct.unpack_from("=I", content, at + 4)[0]
        found.append(content[at : at + length])
        at += length
    return found


def some_bytes(noise, whole):
    content = bytearray(whole.read_bytes())
    for _ in range(noise.choice((1, 1, 3, 30))):
        content[noise.randrange(len(content))] = noise.randrange(256)
    return bytes(content)


def some_blocks(noise, whole):
    """Lost, doubled, exchanged, cut."""
    blocks = blocks_of(whole.read_bytes())
    for _ in range(noise.choice((1, 2, 5))):
        at, other = noise.randrange(len(blocks)), noise.randrange(len(blocks))
        match noise.randrange(4):
            case 0:
                del blocks[at]
            case 1:
                blocks.insert(other, blocks[at])
            case 2:
                blocks[at], blocks[other] = blocks[other], blocks[at]
            case _:
                blocks[at] = blocks[at][: noise.randrange(len(blocks[at]))]
    return b"".join(blocks)


def an_attachment(noise, whole):
    """Its text is changed, and the file is whole."""
    capture = read_pcapng(whole)
    attachments = dict(capture.attachments)
    name = noise.choice([one for one in attachments if one.endswith((".toml", ".eds"))])
    lines = attachments[name].decode().splitlines()
    for _ in range(noise.choice((1, 1, 4))):
        at = noise.randrange(len(lines))
        match noise.randrange(4):
            case 0:
                lines[at] = re.sub(r"(?<![\w.])-?\d[\w.+-]*", lambda _: noise.choice(NUMBERS), lines[at], count=1)
            case 1:
                lines.insert(at, noise.choice(lines))
            case 2:
                lines[at] = lines[at][: noise.randrange(len(lines[at]) + 1)]
            case _:
                lines[at] = ""
    attachments[name] = "\n".join(lines).encode()
    path = whole.with_name("rewritten.pcapng")
    with PcapngWriter(path, attachments=attachments, force=True) as writer:
        writer.write(capture.frames)
    return path.read_bytes()


def some_text(noise, log):
    """Of a candump log."""
    lines = log.read_text().splitlines()
    for _ in range(noise.choice((1, 3))):
        at = noise.randrange(len(lines))
        line = list(lines[at])
        for _ in range(noise.choice((1, 4))):
            line[noise.randrange(len(line)) :][:1] = noise.choice("0Fx#.() \x00é")
            line[noise.randrange(len(line))] = noise.choice("0Fxz#.() \x00é9")
        lines[at] = "".join(line)
    return "\n".join(lines).encode()


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("mutilated", [some_bytes, some_blocks, an_attachment, some_text])
def test_a_mutilated_recording_is_read_or_refused(whole, log, mutilated, seed, tmp_path):
    noise = random.Random(f"{mutilated.__name__} {seed}")
    source = log if mutilated is some_text else whole
    path = tmp_path / f"mutilated{source.suffix}"
    for verb in noise.sample(VERBS, 5):
        path.write_bytes(mutilated(noise, source))
        words = {
            "FILE": str(path),
            "WHOLE": str(whole),
            "OUT": str(tmp_path / "out"),
            "OUT.svg": str(tmp_path / "o.svg"),
        }
        rig = ["--rig", "bench"] if source is log and not verb.startswith(("replay", "export")) else []
        done = CliRunner().invoke(main, [words.get(word, word) for word in verb.split()] + rig)
        told = f"{verb}: {done.exit_code}\n{done.output[-2000:]}"
        assert done.exit_code in STATUSES, told
        assert done.exit_code != FAULT, told
        assert "Traceback" not in done.output, told
        if done.exit_code in (2, 3):
            assert path.name in done.output, told
