"""A small sweep, run once."""

from __future__ import annotations

import pytest

SMALL = """\
rig = "bench"
mode = "active"
seconds = 2.0
seed = 3
design = "latin_hypercube"
runs = 6
[vary]
operator.inertia_kg_m2 = { low = 1e-4, high = 0.2, scale = "log" }
operator.damping_Nms_rad = { low = 0.05, high = 5.0, scale = "log" }
[rates]
still = "hold_counts_p2p <= 2"
untripped = "trip == none"
"""


@pytest.fixture
def sweep_file(tmp_path):
    def written(text=SMALL, **changes):
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "sweep.toml"
        path.write_text(text)
        return path

    return written
