"""A block transfer is limited by the bus, not by the node (in virtual time)."""

import random

import pytest

from benchmarks.node_bus import DOMAIN, NodeBus

CONTENT = random.Random(1).randbytes(20_000)


@pytest.mark.thorough
@pytest.mark.parametrize("bitrate", [125_000, 1_000_000])
def test_a_block_transfer_uses_the_bus(bitrate):
    bus = NodeBus(bitrate)
    down = bus.download(CONTENT)
    assert bus.device[DOMAIN, 0] == CONTENT
    content, up = bus.upload()
    assert content == CONTENT
    # 2858 segments in blocks of 127, an answer to each block, begin and end
    assert down.frames == 2858 + 23 + 4
    assert up.frames == 2858 + 23 + 4  # without the client's last word, which is still to be sent
    assert down.busy >= 0.9
    assert up.busy >= 0.9
    assert down.busy <= 1.001
