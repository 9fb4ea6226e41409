"""The glossary is the vocabulary: each term has its source, and each name that occurs more than once
in the package its reason.
"""

from __future__ import annotations

import ast
import os
import re
from collections import Counter
from pathlib import Path

import pytest

from places import ROOT

TEXT = (ROOT / "docs" / "glossary.md").read_text()
SOURCES = r"ISO 11898-1|CiA \d{3}(-\d)?(, \d{3})*|IEC 61131-3|Linux|NumPy|paper|house|control theory|psychophysics"


def files():
    """Return every module of the package. The four links are followed; none of them leads back."""
    found = []
    for folder, below, names in os.walk(ROOT / "coulombus", followlinks=True):
        below[:] = [name for name in below if name != "__pycache__"]
        found += [Path(folder) / name for name in names if name.endswith(".py")]
    return found


def repeated(names):
    return {name for name, times in Counter(names).items() if times > 1 and not name.startswith("_")}


def tables():
    """Yield (heading, rows) of each table of the page; a row is its cells."""
    for part in re.split(r"^##+ ", TEXT, flags=re.M)[1:]:
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in re.findall(r"^\|.*\|$", part, re.M)]
        if rows:
            yield part.partition("\n")[0], rows


def entries(heading):
    return [row[0].strip("`") for row in dict(tables())[heading][2:]]


def assert_each_has_its_entry(names, heading):
    listed = entries(heading)
    assert len(listed) == len(set(listed))
    assert listed == sorted(listed)
    assert sorted(names - set(listed)) == [], f"docs/glossary.md, {heading}: say why, or rename"
    assert sorted(set(listed) - names) == [], f"docs/glossary.md, {heading}: no name that occurs twice"


def test_each_class_name_that_occurs_twice_has_its_reason():
    texts = [path.read_text() for path in files()]
    lines = [set(re.findall(r"^ *class (\w+)", text, re.M)) for text in texts]  # to parse all takes seconds
    names = [name for found in lines for name in found]
    twice = repeated(names)
    assert len(names) > 300
    parsed = [ast.walk(ast.parse(text)) for text, found in zip(texts, lines, strict=True) if found & twice]
    classes = [{node.name for node in nodes if isinstance(node, ast.ClassDef)} for nodes in parsed]
    assert_each_has_its_entry(repeated(name for found in classes for name in found), "Classes")


def test_each_module_name_that_occurs_twice_has_its_reason():
    assert_each_has_its_entry(repeated(path.stem for path in files()), "Modules")


def test_the_links_are_followed_once():
    real = [path.resolve() for path in files()]
    assert len(real) == len(set(real))
    assert {"host", "node", "eds", "sim_bus"} <= {path.relative_to(ROOT).parts[0] for path in real}


def test_a_repeated_name_is_found_and_a_private_one_is_not():
    assert repeated(["Plan", "Order", "Plan", "_Own", "_Own", "__init__", "__init__"]) == {"Plan"}


@pytest.mark.parametrize("heading", [heading for heading, rows in tables() if rows[0][0] == "term"])
def test_each_term_has_its_source_and_meaning(heading):
    rows = dict(tables())[heading]
    assert rows[0] == ["term", "from", "meaning"]
    for term, source, meaning in rows[2:]:
        assert re.fullmatch(rf"{SOURCES}|\[\w+\.md\]\(\w+\.md\)", source), f"{term}: {source}"
        assert meaning.endswith("."), term


def test_each_term_is_defined_once_and_used_elsewhere():
    pages = [ROOT / "README.md", *(path for path in (ROOT / "docs").rglob("*.md") if path.name != "glossary.md")]
    used = " ".join(" ".join(path.read_text() for path in pages).split()).lower()
    terms = [part for _, rows in tables() if rows[0][0] == "term" for row in rows[2:] for part in row[0].split(", ")]
    assert 60 <= len(terms) == len(set(terms))
    assert [term for term in terms if term.lower() not in used] == []
