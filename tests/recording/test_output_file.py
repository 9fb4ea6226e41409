"""New files that a user has named."""

import os
import stat

import pytest

from coulombus.recording.output_file import new_file, open_new


def test_an_error_names_the_users_file_and_not_the_one_beside(tmp_path):
    path = tmp_path / "folder" / "x.csv"
    with pytest.raises(FileNotFoundError) as caught, new_file(path, force=False) as beside:
        beside.write_text("1")
    assert caught.value.filename == str(path)
    with pytest.raises(OSError, match="other") as caught, new_file(tmp_path / "y.csv", force=False):
        raise OSError(5, "Input/output error", "other")
    assert caught.value.filename == "other"


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o002, 0o664), (0o077, 0o600)])
def test_the_umask_alone_says_who_may_read_a_recording(tmp_path, force, mask, mode):
    path = tmp_path / "run.pcapng"
    before = os.umask(mask)
    try:
        os.close(open_new(path, force=force))
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == mode
