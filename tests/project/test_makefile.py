"""The Makefile's own work: a set-up that was interrupted heals itself."""

import os
import re
import shutil
import subprocess
import sys
import venv

import pytest

from places import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("make") is None, reason="no make")]


def made(folder):
    """Run the Makefile as far as the environment."""
    clean = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    words = ["make", "-f", str(ROOT / "Makefile"), ".venv/.made", f"PYTHON={sys.executable}"]
    done = subprocess.run(words, cwd=folder, env=clean, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_an_environment_that_was_cut_off_is_made_anew_and_one_that_works_is_kept(tmp_path):
    """Killed before pip came, `make` said "No module named pip" from then on."""
    venv.create(tmp_path / ".venv", with_pip=False)
    assert "creating .venv" in made(tmp_path)
    python = tmp_path / ".venv" / "bin" / "python"
    assert subprocess.run([python, "-m", "pip", "--version"], stdout=subprocess.DEVNULL, check=False).returncode == 0

    mine = tmp_path / ".venv" / "mine"  # what somebody has made by hand has no mark, and works
    mine.touch()
    (tmp_path / ".venv" / ".made").unlink()
    assert "creating" not in made(tmp_path)
    assert mine.exists()
    assert (tmp_path / ".venv" / ".made").exists()


def test_no_value_ends_with_the_spaces_before_a_comment():
    """With them the tests' kernels were compiled in `out/warm-up`, and again in a folder whose name ended with spaces."""
    values = [line for line in (ROOT / "Makefile").read_text().splitlines() if re.search(r"[:?]=", line)]
    assert len(values) > 5
    assert [line for line in values if re.search(r"[:?]=.*\S\s+#", line)] == []
