"""The gallery: the site draws each picture with the command of the page."""

from __future__ import annotations

import importlib
import re
import sys

import pytest

from places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
gallery = importlib.import_module("site_gallery")

TEXT = (ROOT / "docs" / "gallery.md").read_text()
ONE = """# A

## First

    coulombus law viscous --motion ramp --picture law.png

<!-- drawn: law.png -->

## Second

    coulombus demo
"""
PNG = b"\x89PNG\r\n"


def test_each_picture_of_the_page_is_written_by_a_command_above_it():
    assert len(gallery.DRAWN.findall(TEXT)) >= 7
    for section in re.split(r"^(?=## )", TEXT, flags=re.M):
        for name in gallery.DRAWN.findall(section):
            place = section.index(f"<!-- drawn: {name}")
            before = section[:place]
            assert name in before or f"--figures {name.rpartition('/')[0]}\n" in before, name


def test_each_section_with_a_figure_has_a_command_and_a_picture():
    sections = re.split(r"^(?=## )", TEXT, flags=re.M)[1:-1]
    for section in sections:
        assert re.search(r"^    (coulombus|python) ", section, re.M), section
        assert gallery.DRAWN.search(section) or re.search(r"^!\[.+\]\([\w-]+\.png\)$", section, re.M), section


@pytest.mark.thorough
def test_the_site_runs_the_commands_and_shows_their_pictures(tmp_path):
    assert gallery.commands(ONE) == ["coulombus law viscous --motion ramp --picture law.png"]
    (picture,) = gallery.pictures(ONE, tmp_path).items()
    assert picture[0] == "law.png"
    assert picture[1].startswith(PNG)
    shown = gallery.shown(ONE)
    assert "(gallery/law.png)" in shown
    assert "drawn:" not in shown


def test_pictures_are_kept_for_the_same_commands_and_drawn_again_for_others(tmp_path, monkeypatch):
    runs = []

    def drawn(text):
        runs.append(text)
        return {"law.png": PNG}

    monkeypatch.setattr(gallery, "_drawn", drawn)
    other = ONE.replace("ramp", "sine")
    for text, count in ((ONE, 1), (ONE, 1), (other, 2), (ONE.replace("# A", "# B"), 3), (ONE, 3)):
        assert gallery.pictures(text, tmp_path) == {"law.png": PNG}
        assert len(runs) == count
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.thorough
def test_a_command_that_fails_or_draws_nothing_ends_the_build(tmp_path):
    with pytest.raises(RuntimeError, match="exit status 2"):
        gallery.pictures(ONE.replace("ramp", "rampp"), tmp_path)
    with pytest.raises(RuntimeError, match=r"no command of gallery\.md draws other\.png"):
        gallery.pictures(ONE.replace("drawn: law.png", "drawn: other.png"), tmp_path)
