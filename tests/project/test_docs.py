"""The documents say what the code does: links, commands, names and tables are held against it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import click
import pytest

from coulombus.cli.errors import STATUSES
from coulombus.cli.main import main
from coulombus.eds import nmt
from coulombus.eds.cia402 import TRANSITIONS
from coulombus.eds.cia402 import diagram as power_states
from coulombus.host.cycle.records import Phase, Trip
from coulombus.host.cycle.transitions import TRANSITIONS as TABLE_OF_PHASES
from coulombus.host.cycle.transitions import diagram as phases
from coulombus.host.run.runbook import advice, explained
from coulombus.node.emcy import CAUSES
from coulombus.rigs.overrides import SHARED_MACHINE
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.rig.plant import TRUTH_COLUMNS
from places import ROOT

SECTIONS = ["Added", "Changed", "Fixed", "Removed", "Security"]  # of a version in CHANGELOG.md
DOCS = [
    *(ROOT / name for name in ("README.md", "SECURITY.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
NAMES = [str(path.relative_to(ROOT)) for path in DOCS]
WITH_CHANGES = [*NAMES, "CHANGELOG.md"]  # what it says of verbs and options was true once
LINK = re.compile(r"!?\[[^]]*\]\(([^)\s]+)\)")
SPAN = re.compile(r"`([^`\n]+)`")


def text_of(name):
    return (ROOT / name).read_text()


def anchors(text):
    """Return the anchors of a document's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def commands(text):
    """Yield every command line of `coulombus` in a text: indented or fenced lines, and code
    spans.
    """
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    fenced = False
    for line in lines:
        if line.startswith("```"):
            fenced = not fenced
        elif fenced or line.startswith("    "):
            if re.match(r"\s*(\w+=\S+ )*(\S*/)?coulombus ", line):
                yield line
        else:
            yield from (span for span in SPAN.findall(line) if "coulombus " in span)


def own_options(command):
    return {name for parameter in command.params if isinstance(parameter, click.Option) for name in parameter.opts}


def options(command):
    """The options of a command, and of the verbs of a group."""
    return own_options(command).union(*(options(verb) for verb in getattr(command, "commands", {}).values()))


@pytest.mark.parametrize("name", WITH_CHANGES)
def test_relative_links_resolve(name):
    text = text_of(name)
    for target in LINK.findall(text):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = ((ROOT / name).parent / path).resolve() if path else ROOT / name
        assert file.exists(), f"{name}: {target}"
        assert not anchor or anchor in anchors(file.read_text()), f"{name}: {target}"


@pytest.mark.parametrize("name", NAMES)
def test_commands_exist(name):
    for line in commands(text_of(name)):
        after = re.search(r"(?:^|[\s/])coulombus ([a-z-][^|>#]*)", line)
        if after is None:
            continue
        words = after[1].split()
        verb = words[0]
        if verb.startswith("-"):
            assert verb in own_options(main) | {"--help"}, f"{name}: {line}"
            continue
        assert verb in main.commands, f"{name}: {line}"
        known = options(main.commands[verb]) | {"--help"}
        for word in words[1:]:
            if word.startswith("--"):
                assert word.partition("=")[0] in known, f"{name}: {line}"


@pytest.mark.parametrize("name", NAMES)
def test_options_named_alone_exist(name):
    known = set().union(*(options(command) for command in main.commands.values())) | {"--help"}
    for span in SPAN.findall(text_of(name)):
        if span.startswith("--"):
            assert span.split()[0].partition("=")[0] in known, f"{name}: {span}"


@pytest.mark.parametrize("name", NAMES)
def test_rig_keys_of_set_are_accepted(name):
    """`--set KEY=VALUE` in a document loads; paths of laws are shortened to a law that exists."""
    for line in commands(text_of(name)):
        rig = re.search(r"--rig (bench|paper|plane)\b", line)
        if "my-rig.toml" in line:
            continue
        for override in re.findall(r"--set (\S+)", line):
            value = re.sub(r"\S+\.py:\w+", "karnopp", override)
            if re.fullmatch(r"[a-z]\w*(\.\w+)+=\S+", value):
                load_rig(rig[1] if rig else "bench", [value])


def test_every_trip_is_explained():
    text = text_of("docs/safety.md")
    missing = [trip.name for trip in Trip if trip is not Trip.NONE and f"`{trip.name}`" not in text]
    assert not missing


def test_the_runbook_has_each_trip_each_emcy_and_each_exit_status():
    text = text_of("docs/runbook.md")
    trips = [trip.name for trip in Trip if trip is not Trip.NONE]
    assert sorted(re.findall(r"^### (\w+)$", text, re.M)) == sorted(trips)
    assert not [name for name in trips if advice(f"{name}: why") != f"coulombus help {name}"]
    assert {name.lower() for name in trips} <= anchors(text)
    assert not [f"{cause.code:04X}h" for cause in CAUSES if cause.name and f"| {cause.code:04X}h |" not in text]
    assert not [status for status in STATUSES if f"| {status} | " not in text]
    for name in trips:  # a heading alone helps nobody
        section = text.partition(f"### {name}\n")[2].partition("\n#")[0]
        assert len(section.split()) >= 8, name
        assert re.findall(r"^(\d)\. \S", section, re.M) == ["1", "2", "3"], name
        assert re.search(r"^Do not \S", section, re.M), name
        shown = explained(name.lower())
        assert shown == explained(name)
        assert len(shown.splitlines()) <= 24, name  # a screen
        assert max(map(len, shown.splitlines())) <= 80, name
        assert not re.search(r"[*`]|\]\(", shown), name
    for cause in CAUSES:
        assert f"{cause.code:04X}h" in explained(f"{cause.code:04x}h")


def test_the_cause_is_looked_up_before_what_it_led_to():
    assert advice("axis left: OTHER_AXIS (TPDO_LOST on axis right)") == "coulombus help TPDO_LOST"
    assert advice("axis left: OTHER_AXIS") == "coulombus help OTHER_AXIS"
    assert advice("HOST: OSError: x") == "coulombus help HOST"
    assert advice("arming refused: the space bar was not held") is None


def test_every_limit_is_in_the_safety_document():
    text = text_of("docs/safety.md")
    keys = type(load_rig("bench").one_axis().limits).model_fields
    assert not [key for key in keys if f"limits.{key}" not in text]


def test_the_true_course_and_the_signals_are_named():
    truth, recording = text_of("docs/simulation.md"), text_of("docs/recording.md")
    assert not [column for column in TRUTH_COLUMNS if f"| `{column}` |" not in truth]
    for pdo in load_rig("bench").pdos():
        for signal in pdo.signals:
            assert f"| `{signal.name}` | {signal.unit}".rstrip() in recording, signal.name


def test_the_power_state_machine_is_the_table():
    drawn = re.findall(r"^ +([A-Z_]+) --> ([A-Z_]+): (\d+) ([A-Z_]+)$", text_of("docs/devices.md"), re.M)
    table = [(state.name, following.name, str(n), command.name) for n, state, command, following in TRANSITIONS]
    assert drawn == table
    assert power_states() in text_of("docs/devices.md")


def test_the_nmt_states_and_their_services_are_the_table():
    text = text_of("docs/devices.md")
    assert nmt.diagram() in text
    assert nmt.services() in text
    drawn = re.findall(r"^ +([A-Z_]+) --> ([A-Z_]+): ([A-Z_]+) \((\d+)\)$", text, re.M)
    assert drawn == [(state.name, end.name, command.name, str(n)) for n, state, command, end in nmt.TRANSITIONS]


def test_the_phases_are_the_table():
    text = text_of("docs/safety.md")
    assert phases() in text
    rows = dict(re.findall(r"^\| ([A-Z]+) \|.*\| ([^|]+) \|$", text, re.M))
    for row in TABLE_OF_PHASES:
        for trip in row.trips if row.following is Phase.SAFE and len(row.phases) == 1 else ():
            words = rows[row.phases[0].name]
            assert f"`{trip.name}`" in words or (trip.name.startswith("SIGN_") and "`SIGN_...`" in words), trip


def test_devices_show_the_pdos_the_objects_and_the_emergencies():
    text = text_of("docs/devices.md")
    rig = load_rig("bench")
    for pdo in rig.pdos():
        assert pdo.layout.diagram() in text
    for node in ("motor", "brake"):
        objects = [f"{index:04X}h" for index in rig.one_axis().description(node).objects]
        ranges = {"1401h", "1402h", "1601h", "1602h", "1801h", "1802h", "1A01h", "1A02h"}  # named by their ends
        assert not [name for name in objects if name not in text and name not in ranges]
    for cause in CAUSES:
        if cause.name:
            register = f"{cause.register | 1:02X}h"
            row = rf"\| {cause.code:04X}h \| [^|]+ \| {register} \| {'yes' if cause.fault else 'no'} \|"
            assert re.search(row, text), cause.name


def missing_names(text):
    """Return the names of code that a text places in a file, as "`LAWS` of `host/laws/laws.py`", and that are not there."""
    placed = re.findall(r"`([A-Za-z_]\w*)(?:\([^`]*\))?`\s+(?:of|in)\s+`([\w/]+\.py)`", text)
    sources = {file: next(filter(Path.is_file, (ROOT / file, ROOT / "coulombus" / file)), None) for _, file in placed}
    return [
        (name, file)
        for name, file in placed
        if sources[file] is None or not re.search(rf"\b{name}\b", sources[file].read_text())
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_of_code_stands_in_its_file(name):
    assert missing_names(text_of(name)) == []


def test_a_name_that_is_gone_is_noticed():
    assert len(missing_names("`LAWS`\nof `host/laws/laws.py`, `GONE` of `host/laws/laws.py`, `A` in `gone.py`")) == 2


@pytest.mark.parametrize("name", WITH_CHANGES)
def test_no_machine_path(name):
    assert not re.search(r"(?<!\.)/(work|tmp|home|root)/", text_of(name))


def test_the_version_is_the_same_everywhere():
    version = tomllib.loads(text_of("pyproject.toml"))["project"]["version"]
    assert re.search(rf"^version: {re.escape(version)}$", text_of("CITATION.cff"), re.M)
    (date,) = re.findall(rf"^## {re.escape(version)} - (\d{{4}}-\d\d-\d\d)$", text_of("CHANGELOG.md"), re.M)
    assert re.search(rf"^date-released: {date}$", text_of("CITATION.cff"), re.M)


def versions():
    """Return (heading, text) of each version in CHANGELOG.md."""
    parts = re.split(r"^## (.*)$", text_of("CHANGELOG.md"), flags=re.M)[1:]
    return list(zip(parts[::2], parts[1::2], strict=True))


def test_the_changelog_has_dated_versions_newest_first():
    heads = [head for head, _ in versions()]
    assert heads[0] == "Unreleased"
    dated = [re.fullmatch(r"(\d+)\.(\d+)\.(\d+) - (\d{4}-\d\d-\d\d)", head) for head in heads[1:]]
    assert all(dated), heads
    numbers = [tuple(int(part) for part in found.groups()[:3]) for found in dated]
    assert numbers == sorted(set(numbers), reverse=True)
    dates = [found[4] for found in dated]
    assert dates == sorted(dates, reverse=True)


@pytest.mark.parametrize("head", [head for head, _ in versions()])
def test_a_version_has_known_sections_of_short_entries(head):
    text = dict(versions())[head]
    sections = re.split(r"^### (.*)$", text, flags=re.M)
    names = sections[1::2]
    assert names == [name for name in SECTIONS if name in names], "unknown, doubled or out of order"
    assert "\n- " not in sections[0], "an entry above the first section"
    for name, entries in zip(names, sections[2::2], strict=True):
        short = re.compile(r"- \S.*(\n  \S.*)?")  # one line, or two
        listed = re.split(r"\n(?! )", entries.strip("\n"))
        assert [entry for entry in listed if not short.fullmatch(entry)] == [], f"{head}, {name}"


def test_the_settings_for_a_shared_machine_are_those_of_the_option():
    found = re.findall(r"--set (\S+)", text_of("docs/realtime.md"))
    assert tuple(found) == SHARED_MACHINE


@pytest.mark.parametrize("name", NAMES)
def test_a_page_begins_with_what_its_subject_is(name):
    """Its first paragraph is a sentence of its own, neither a command nor a formula of all pages."""
    first = text_of(name).split("\n\n")[1]
    assert not first.startswith(("After this page", "    ", "|", "```", "![")), name
    assert first.rstrip(":").endswith((".", ")")) or first.endswith(":"), name


@pytest.mark.parametrize("name", WITH_CHANGES)
def test_lines_of_prose_have_at_most_100_columns(name):
    prose = re.sub(r"^```.*?^```$", "", text_of(name), flags=re.M | re.S)
    long = [line for line in prose.splitlines() if len(line) > 100 and not line.startswith(("|", "    ", "!["))]
    assert [line for line in long if " " in re.sub(r"`[^`]+`|\[[^]]*\]\([^)]*\)", "", line[:100])[60:]] == [], name
