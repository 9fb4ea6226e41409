"""``coulombus sweep`` as a user calls it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pyarrow.parquet
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.sweep.one_run import carry_out

TEXT = """\
mode = "hybrid"
seconds = 0.3
seed = 2
design = "sobol"
runs = 4
[vary]
limits.net_work_J = { values = [0.15, 1e-9] }
plant.coulomb_Nm = { low = 0.03, high = 0.09 }
[rates]
untripped = "trip == none"
"""


@pytest.fixture
def here(monkeypatch):
    """Runs are carried out in this process."""
    monkeypatch.setattr(
        "coulombus.lab.sweep.sweep.on_processes", lambda job, orders, count: (carry_out(job, one) for one in orders)
    )


@pytest.fixture
def call(tmp_path, here):
    (tmp_path / "sweep.toml").write_text(TEXT)

    def run(*words):
        return CliRunner().invoke(main, ["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / "out"), *words])

    return run


def test_json_is_one_object_with_the_rates(call, tmp_path):
    result = call("--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["runs"], told["failed"]) == (4, 2)
    assert told["rates"]["untripped"] == {
        "count": 2,
        "of": 4,
        "low": pytest.approx(0.0676, abs=1e-4),
        "high": pytest.approx(0.9324, abs=1e-4),
    }
    assert told["simulated_s_per_core_s"] > 0
    assert pyarrow.parquet.read_table(tmp_path / "out" / "runs.parquet").num_rows == 4


def test_people_read_rates_and_the_command_that_repeats_the_worst_case(call, tmp_path):
    out = call().stdout
    assert "untripped in 2 of 4 runs (6.76 to 93.24 %)" in out
    assert "4 runs, 2 of them failed" in out
    assert "mildest rig that misses untripped: limits.net_work_J = 1e-09" in out
    words = next(line for line in out.splitlines() if "coulombus simulate" in line).split()[1:]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 7, result.output


@pytest.mark.thorough
def test_another_sweep_is_refused_and_replaced_by_force(call, tmp_path):
    assert call().exit_code == 0
    (tmp_path / "sweep.toml").write_text(TEXT.replace("runs = 4", "runs = 2"))
    refused = call()
    assert refused.exit_code == 2
    assert "--overwrite" in refused.output
    assert "2 runs" in call("--force").stdout


def test_a_mistake_of_the_file_is_told_as_json_too(call, tmp_path):
    (tmp_path / "sweep.toml").write_text(TEXT.replace("runs = 4", "runs = 0"))
    result = call("--json")
    assert result.exit_code == 3
    told = json.loads(result.stdout)
    assert told["exit_status"] == 3
    assert "sweep.toml:5: runs" in told["error"]
    assert not (tmp_path / "out").exists()


def test_progress_is_told_in_lines_where_no_terminal_is(call, monkeypatch):
    monkeypatch.setattr("coulombus.cli.sweep.TOLD_EVERY_S", 0.0)
    err = call().stderr
    assert "runs: 4 of 4, 2 failed" in err
    assert "worst case of untripped: 1" in err


def test_without_pyarrow_it_is_said_before_anything_is_run(call, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "pyarrow"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    result = call()
    assert result.exit_code == 2
    assert "pip install -e '.[export]'" in result.output


@pytest.mark.thorough
@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_says_how_to_go_on(tmp_path):
    path, out = tmp_path / "sweep.toml", tmp_path / "out"
    path.write_text(TEXT.replace("runs = 4", "runs = 5000").replace("0.3", "1.0"))
    words = [sys.executable, "-m", "coulombus", "sweep", str(path), "-o", str(out), "--processes", "1"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not list(out.glob("parts/0*.parquet")) and process.poll() is None and time.monotonic() < deadline:
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.1)
    process.send_signal(signal.SIGINT)
    told, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert told == ""
    assert "Traceback" not in err
    line = next(line for line in err.splitlines() if "to continue" in line)
    assert line.endswith(f"to continue: coulombus sweep {path} -o {out}")
    kept = sum(pyarrow.parquet.read_table(part).num_rows for part in out.glob("parts/*.parquet"))
    assert int(line.split()[1]) == kept > 0
