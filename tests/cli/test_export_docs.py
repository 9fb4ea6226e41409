"""Every command and script of docs/export.md does what the page says."""

import json
import re
import shlex

import pytest
from click.testing import CliRunner

from bench_recording import record
from coulombus.cli.main import main
from places import ROOT

PAGE = (ROOT / "docs" / "export.md").read_text()
COMMANDS = re.findall(r"^    coulombus ((?:export|plot|diff) .*)$", PAGE, re.MULTILINE)
NEEDS = {"mf4": "asammdf", "parquet": "pyarrow"}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, late in (("run", 0), ("again", 2_000_000), ("sim", 0), ("rig", 0)):
        record(tmp_path / f"{name}.pcapng", late=late, push=40 if name == "rig" else 0)
    return tmp_path


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("words", COMMANDS)
def test_a_command_as_it_is_printed(here, words):
    for kind, library in NEEDS.items():
        if f"--to {kind}" in words:
            pytest.importorskip(library)
    before = set(here.iterdir())
    result = CliRunner().invoke(main, shlex.split(words))
    assert result.exit_code == 0, result.output
    made = [path for path in here.iterdir() if path not in before]
    if "-o" in words.split() or not words.startswith("diff"):
        assert [path.stat().st_size > 500 for path in made] == [True]
    if "--json" in words:
        assert json.loads(result.stdout)["equal"] is True


def test_a_difference_ends_with_1_and_names_signal_and_time(here):
    result = CliRunner().invoke(main, ["diff", "sim.pcapng", "rig.pcapng"])
    assert result.exit_code == 1
    (row,) = (line for line in result.stdout.splitlines() if line.rstrip().endswith("differs"))
    assert row.split() == ["brake.setpoint_Nm", "0.04", "0.002", "0.153", "hold", "differs"]
    assert all(len(line) <= 80 for line in result.stdout.splitlines())


def test_the_script(here):
    for library in ("pandas", "xarray"):
        pytest.importorskip(library)
    script, _ = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)  # the other: tests/monitor/test_callbacks.py
    exec(compile(script, "docs/export.md", "exec"), {})
    assert (here / "angle.png").stat().st_size > 5000
