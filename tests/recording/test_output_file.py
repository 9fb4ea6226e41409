"""New files that a user has named."""

import pytest

from coulombus.recording.output_file import new_file


def test_an_error_names_the_users_file_and_not_the_one_beside(tmp_path):
    path = tmp_path / "folder" / "x.csv"
    with pytest.raises(FileNotFoundError) as caught, new_file(path, force=False) as beside:
        beside.write_text("1")
    assert caught.value.filename == str(path)
    with pytest.raises(OSError, match="other") as caught, new_file(tmp_path / "y.csv", force=False):
        raise OSError(5, "Input/output error", "other")
    assert caught.value.filename == "other"
