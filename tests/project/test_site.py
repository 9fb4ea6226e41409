"""The site's pages that are made from the code, its diagrams, and its list of pages."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import pytest
import yaml
from mkdocs.exceptions import PluginError

from coulombus.cli.main import main
from coulombus.kernels.records import Record, dtype_of
from coulombus.rigs.axis import Sections
from coulombus.rigs.field_help import fields_of
from places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
hooks = importlib.import_module("site_hooks")
diagrams = importlib.import_module("site_diagrams")
docstrings = importlib.import_module("site_docstrings")
records = importlib.import_module("site_records")


def test_every_verb_and_every_option_is_on_the_page():
    text = hooks.verbs_page()
    for verb in main.commands.values():
        section = text.partition(f"\n## `coulombus {verb.name}`\n")[2].partition("\n## ")[0]
        assert section.count("coulombus") > 0, verb.name
        seen = [parameter for parameter in verb.params if not getattr(parameter, "hidden", False)]
        for name in [name for parameter in seen for name in parameter.opts if name.startswith("--")]:
            assert name in section, f"{verb.name} {name}"


def test_every_section_of_the_rig_file_is_on_the_page():
    text = hooks.rig_keys_page()
    sections = re.findall(r"^## `\[+([a-z]+)", text, re.M)
    assert set(fields_of(Sections)) == set(sections)
    assert "| `period_s` | s | 0.0001 to 1 | required | SYNC period, one cycle of the law |" in text


def test_every_public_name_of_the_package_is_on_the_page():
    full = [name for names in hooks.documented_names().values() for name in names]
    assert len(full) == len(set(full)) > 60
    for package in hooks.API:
        for name in importlib.import_module(package).__all__:
            value = getattr(importlib.import_module(package), name)
            assert f"{value.__module__}.{value.__qualname__}" in full
    for name in full:
        module, _, what = name.rpartition(".")
        assert hasattr(importlib.import_module(module), what)
        assert f"::: {name}\n" in hooks.python_page()


def test_every_field_of_the_records_is_on_the_page():
    text = records.records_page()
    for record in records.SHOWN:
        own = dtype_of(record).names or ()
        inherited = {name for base in record.__bases__ if base is not Record for name in dtype_of(base).names or ()}
        found = [name for name, _, _ in records.fields_of_record(record)]
        assert found == [name for name in own if name not in inherited], record
        assert all(words for _, _, words in records.fields_of_record(record)), f"{record}: a field without a word"
        assert f"\n## {record.__name__}\n" in text
    assert "| `phase_cycle` | `int` | cycles since the phase began |" in text
    assert "| `frames` | `Frame[QUEUE_CAPACITY]` | the first `count` of them are valid |" in text


@pytest.mark.parametrize("name", ["architecture.md", "devices.md", "index.md", "safety.md"])
def test_every_diagram_is_drawn_with_all_its_words(name):
    found = hooks.MERMAID.findall((ROOT / "docs" / name).read_text())
    assert found
    for text in found:
        drawn = ET.fromstring(diagrams.svg(text))
        words = " ".join(drawn.itertext())
        for label in re.findall(r'^[^"\n]*: (.+)$|"([^"]+)"', text, re.M):
            assert all(part in words for part in "".join(label).split("<br/>")), label


def test_a_loop_is_drawn_from_left_to_right():
    edges = '    a -- "go" --> b\n    a -- "run" --> c\n    b -- "on" --> d\n    c --> d\n    d -- "back" --> b\n'
    drawn = ET.fromstring(diagrams.svg(f"graph LR\n{edges}"))
    boxes = [(float(box.get("x")), float(box.get("height"))) for box in drawn.findall(".//{*}rect")]
    assert len(boxes) == 4
    assert boxes[0][0] < boxes[1][0] == boxes[2][0] < boxes[3][0]
    assert boxes[0][1] == boxes[3][1] > 2 * boxes[1][1]
    ways = [
        re.fullmatch(r"M([\d.]+) ([\d.]+)H([\d.]+)", path.get("d")).groups()
        for path in drawn.findall(".//{*}g/{*}path")
    ]
    senses = [float(x1) > float(x0) for x0, _, x1 in ways]
    assert senses == [True, True, True, True, False]
    assert len({(x0, y) for x0, y, _ in ways}) == 5  # no arrow lies on another one


def test_what_cannot_be_drawn_ends_the_build():
    for text in (
        "pie\n  a: 1",
        "stateDiagram-v2\n  a => b",
        "sequenceDiagram\n  loop",
        "graph LR\n  a --> b\n  b --> c\n  a --> c",
    ):
        with pytest.raises(ValueError, match=r"^no "):
            diagrams.svg(text)


def test_make_docs_fails_on_a_warning(tmp_path):
    (words,) = re.findall(r"-m (mkdocs build [^#\n]*)", (ROOT / "Makefile").read_text())
    (tmp_path / "mkdocs.yml").write_text("site_name: x\n")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[to nowhere](nowhere.md)\n")
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *words.split()],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "nowhere.md" in done.stderr


def test_a_link_to_nowhere_is_left_to_mkdocs_which_warns():
    page = SimpleNamespace(file=SimpleNamespace(src_path="faq.md"), meta={})
    text = "[a](theory.md) [b](theorie.md) [c](../nowhere.py) [d](../examples) [e](../LICENSE)"
    wanted = "[a](theory.md) [b](theorie.md) [c](../nowhere.py) d [e](repository/LICENSE.md)"
    assert hooks.on_page_markdown(text, page, None, None) == wanted


@pytest.mark.parametrize("tag", ['<script src="https://x.org/a.js">', '<link rel="stylesheet" href="//x.org/a.css">'])
def test_a_page_that_loads_from_the_network_ends_the_build(tag):
    page = SimpleNamespace(file=SimpleNamespace(src_path="x.md"))
    with pytest.raises(PluginError, match=r"x\.md loads from the network"):
        hooks.on_post_page(f"<html>{tag}</html>", page, None)
    assert hooks.on_post_page('<a href="https://x.org">', page, None) == '<a href="https://x.org">'


def test_the_page_of_a_wrong_address_has_relative_links_below_the_site_s_first_folder():
    made = '<html><head><link href="/assets/a.css"></head><h1>404 - Not found</h1><a href="/laws.html">l</a></html>'
    page = hooks.on_post_template(made, "404.html", None)
    assert not re.search(r'(href|src)="/', page)
    assert 'href="laws.html"' in page
    for link in re.findall(r'<li><a href="([\w/.]+)\.html"', page):
        assert (ROOT / "docs" / f"{link}.md").exists() or link == "reference/verbs"
    assert page.index("document.head.append(base)") < page.index("assets/a.css")
    assert {"tutorials", "reference", "project", "repository"} <= set(
        re.findall(r'"(\w+)"', page.partition("<link")[0])
    )
    assert hooks.on_post_template(made, "sitemap.xml", None) == made


def test_the_faq_is_first_for_how_do_i_stop():
    page = SimpleNamespace(file=SimpleNamespace(src_path="faq.md"), meta={})
    text = hooks.on_page_markdown((ROOT / "docs" / "faq.md").read_text(), page, None, None)
    assert re.search(r"^## How do I stop\b", text, re.M)
    assert page.meta["search"]["boost"] > 1


@pytest.mark.parametrize("torn", ["<em k_1>k = (x_k − x</em>", "<em>, and a = 4c|H</em>"])
def test_a_formula_that_is_torn_by_emphasis_ends_the_build(torn):
    page = SimpleNamespace(file=SimpleNamespace(src_path="x.md"))
    with pytest.raises(PluginError, match=r"x\.md: a formula was read as emphasis"):
        hooks.on_post_page(f"<html>{torn}</html>", page, None)
    whole = "<em>Haptic Friction Display</em>, <em>faster than <code>limits.speed_rad_s</code></em>"
    assert hooks.on_post_page(whole, page, None) == whole


def test_exceptions_that_share_a_description_are_listed_one_by_one():
    text = "Do it.\n\nRaises\n------\na.B\n    one\n    two\nc.D, e.F,\ng.H\n    three\n\nNotes\n-----\nx\n"
    one = SimpleNamespace(docstring=SimpleNamespace(value=text))
    docstrings.Described().on_object(obj=one)
    raised = one.docstring.value.partition("------\n")[2].partition("\nNotes")[0].split("\n")
    assert [line for line in raised if line] == [
        *("a.B", "    one", "    two", "c.D", "    three", "e.F", "    three", "g.H", "    three")
    ]
    assert one.docstring.value.endswith("Notes\n-----\nx\n")


def test_every_page_is_in_the_list_of_pages():
    class Loader(yaml.SafeLoader):
        pass

    Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)
    listed = re.findall(r"'([\w/.-]+\.(?:md|ipynb))'", str(yaml.load((ROOT / "mkdocs.yml").read_text(), Loader)["nav"]))
    written = {
        str(path.relative_to(ROOT / "docs")) for end in ("md", "ipynb") for path in (ROOT / "docs").rglob(f"*.{end}")
    }
    made = {
        "reference/verbs.md",
        "reference/commands.md",
        "reference/python.md",
        "reference/records.md",
        "reference/rig-keys.md",
        *(f"project/{name}" for name in hooks.PROJECT),
    }
    assert len(listed) == len(set(listed))
    assert set(listed) == written | made


@pytest.mark.thorough
def test_the_site_needs_none_of_the_development_tools():
    """`make docs` in a copy that only ran `make demo` has the extra `docs` alone."""
    blocked = "import sys; sys.modules |= dict.fromkeys(('pytest', '_pytest', 'hypothesis', 'xdist', 'coverage'));"
    code = f"{blocked} sys.path.insert(0, 'scripts'); import site_hooks"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120)
