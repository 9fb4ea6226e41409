"""Paths, Python names and numbers in the documents are held against the files and the code."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from functools import cache

import pytest

from conformance_mutants import MUTANTS
from coulombus.conformance.catalogue import catalogue
from coulombus.host.commission.session import STEPS
from coulombus.host.laws.law import LAW, LAW_STATE, MOTION
from coulombus.host.laws.laws import BUILTIN_LAWS
from places import ROOT

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
NAMES = [str(path.relative_to(ROOT)) for path in PAGES]
TOPS = {path.name for top in (ROOT, ROOT / "coulombus") for path in top.iterdir() if path.is_dir()} - {"out", "build"}
OF_USERS = {"lamp.py", "my_law.py", "pedal.py", "host.law.py"}  # files that a page tells its reader to write
WORDS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]


def text_of(name):
    return (ROOT / name).read_text()


def spans(text):
    return re.findall(r"`([^`\n]+)`", text)


def rows(text):
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in re.findall(r"^\|.*\|$", text, re.M)]


def files_of(span):
    """Return the path that a code span names, None where it names none of this project."""
    path = re.fullmatch(r"([\w.-]+)/[\w./-]*", span)
    return span if path and path[1] in TOPS else None


@pytest.mark.parametrize("name", NAMES)
def test_each_path_in_backticks_exists(name):
    named = [path for path in map(files_of, spans(text_of(name))) if path]
    assert [path for path in named if not (ROOT / path).exists() and not (ROOT / "coulombus" / path).exists()] == []


@cache
def modules():
    return {path.name for top in TOPS - {".venv"} for path in (ROOT / top).rglob("*.py")}


@pytest.mark.parametrize("name", NAMES)
def test_each_module_named_without_its_folder_exists(name):
    named = {span for span in spans(text_of(name)) if re.fullmatch(r"[\w.]+\.py", span)}
    assert named - modules() - OF_USERS == set()


def test_a_path_of_the_project_is_told_from_other_spans():
    assert files_of("host/cycle/step.py") == "host/cycle/step.py"
    assert files_of("coulombus/rigs/") == "coulombus/rigs/"
    assert not any(
        map(files_of, ["Nm/rad", "linux/can/error.h", "/proc/self", "coulombus emulate", "out/site", "host"])
    )


@pytest.mark.parametrize("name", [name for name in NAMES if name != "docs/tools.md"])  # which has Wireshark's names
def test_each_python_name_in_backticks_exists(name):
    for span in spans(text_of(name)):
        if not re.fullmatch(r"coulombus(\.\w+)+", span):
            continue
        place, *rest = span.split(".")
        place = ROOT / place
        while rest and ((place / rest[0]).is_dir() or (place / f"{rest[0]}.py").is_file()):
            folder = place / rest.pop(0)
            place = folder if folder.is_dir() else folder.with_suffix(".py")
        source = (place / "__init__.py" if place.is_dir() else place).read_text()
        assert all(re.search(rf"\b{part}\b", source) for part in rest), f"{name}: {span}"
        assert place != ROOT / "coulombus" or len(rest) == 1, f"{name}: {span}"


def test_the_folders_of_the_architecture_and_what_they_hold_exist():
    table = text_of("docs/architecture.md").partition("| folder | what it holds |")[2].partition("\n\n")[0]
    folders = {row[0].strip("`"): row[1] for row in rows(table)[1:]}
    for folder, holds in folders.items():
        inner = [span for span in spans(holds) if re.fullmatch(r"\w+/|\w+\.(py|toml)", span) and span != "node/"]
        assert [span for span in inner if not (ROOT / folder / span).exists()] == [], folder
    top = {f"{path.name}/" for path in (ROOT / "coulombus").iterdir() if (path / "__init__.py").exists()}
    assert {folder.removeprefix("coulombus/") for folder in folders} == top | {""}


def test_the_page_of_laws_has_every_law_and_every_field():
    text = text_of("docs/laws.md")
    listed = [row[0].strip("`") for row in rows(text.partition("## The laws")[2].partition("\n## ")[0])[2:]]
    assert sorted(listed) == sorted(BUILTIN_LAWS)
    for record, dtype in (("MotionRecord", MOTION), ("LawRecord", LAW), ("LawStateRecord", LAW_STATE)):
        table = text.partition(f", a `{record}`")[2].partition("| field |")[2].partition("\n\n")[0]
        fields = [row[0].strip("`").partition("[")[0] for row in rows(table)[1:]]
        assert [field for field in fields if " " not in field] == list(dtype.names), record


def test_the_numbers_of_cases_are_those_of_the_catalogue():
    text = text_of("docs/conformance.md")
    own = [case.id for case in catalogue() if case.is_additional]
    planned = len(catalogue()) - len(own)
    assert f"{planned} of a conformance test plan" in text
    last = {letter: max(int(name[2:]) for name in own if name[0] == letter) for letter in {name[0] for name in own}}
    assert Counter(name[0] for name in own) == last
    for letter, number in last.items():
        ends = {1: f"`{letter}.1` |", 2: f"`{letter}.1`, `{letter}.2` |"}.get(
            number, f"`{letter}.1` to `{letter}.{number}`"
        )
        assert ends in text, letter
    table = {row[0]: row[1:] for row in rows(text.partition("What LocalNode fails")[0])}
    assert table[f"passed, of the {planned}"][:2] == [str(planned)] * 2
    results = ("passed, all", "failed", "not applicable")
    for column in range(3):
        assert sum(int(table[result][column].split()[0]) for result in results) == len(catalogue())
    (least,) = re.findall(r"more than (\d+) nodes with one fault", " ".join(text.split()))
    assert len(MUTANTS) > int(least)


def test_the_table_of_mutants_has_every_module_and_adds_up():
    table = text_of("docs/safety.md").partition("| module | mutants |")[2].partition("\n\n")[0]
    parts = {row[0]: [int(cell) for cell in row[1:5]] for row in rows(table)[1:]}
    total = parts.pop("all")
    targets = tomllib.loads(text_of("scripts/mutants_targets.toml"))
    assert sorted(span for cell in parts for span in spans(cell)) == sorted(targets)
    assert [sum(column) for column in zip(*parts.values(), strict=True)] == total
    assert all(mutants == killed + equivalent + survived for mutants, killed, equivalent, survived in parts.values())


def test_the_numbers_of_steps_and_links_are_those_of_the_code():
    assert f"all {WORDS[len(STEPS)]} steps" in text_of("docs/deploy.md")
    links = [path for path in (ROOT / "coulombus").iterdir() if path.is_symlink()]
    assert f"{WORDS[len(links)]} links" in text_of("docs/architecture.md")
