"""docs/drives.md: each file of other makers that is there, tried as the page says."""

import importlib.util

import pytest

from places import CORPUS, ROOT, beside

FILES = sorted(path for path in CORPUS.glob("*") if path.suffix.lower() in (".eds", ".dcf"))
PAGE = (ROOT / "docs" / "drives.md").read_text()

spec = importlib.util.spec_from_file_location("drives", ROOT / "scripts" / "drives.py")
drives = importlib.util.module_from_spec(spec)
spec.loader.exec_module(drives)


@pytest.mark.thorough
@beside(CORPUS)
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
@pytest.mark.parametrize("role", ["drive", "brake"])
def test_the_page_says_what_init_check_and_simulate_make_of_a_file(tmp_path, path, role):
    row = drives.tried(path, role, tmp_path)
    if row is None:
        assert f"| {path.name} |" not in PAGE.partition("<!-- brakes -->")[2]
        return
    assert row.line() in PAGE.splitlines()
    if row.kind != "E":  # what `check` calls ok is armed
        assert row.check == "ok"
        assert row.armed == ", ".join(drives.MODES[role])
