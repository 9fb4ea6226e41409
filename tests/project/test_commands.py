"""The commands of the documents, as they are printed, from the clone's folder.

Each page has a folder of its own with what a clone has and what its commands read. What
`support/documented.py` says is not run here has its reason there. A display is shortened, and a
pager or `tail` behind a pipe is left out.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.reader import read_eds
from documented import HERE, RULES, commands_of, documented, pages, rule_of, strangers
from foreign_eds import another, dual
from places import ROOT
from reader import Reader, missing
from xdd_text import as_xdd

SECONDS = "0.6"
FOUND = documented()
RUN = {
    page: [one.line for one in FOUND if one.page == page and one.fate == HERE] for page in {one.page for one in FOUND}
}
OUTPUTS = ("-o", "--record", "--csv", "--plot", "--truth", "--gantt")


def call(words):
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, f"{shlex.join(words)}: {result.exit_code}\n{result.output}"
    return result.stdout


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """What the pages' commands read, by name."""
    folder = tmp_path_factory.mktemp("inputs")
    recording = folder / "run.pcapng"
    call(["simulate", "--seconds", SECONDS, "--record", str(recording)])
    call(["init", "--drive", "bench", "--brake", "bench", "--rehearse", "-o", str(folder / "my-rig.toml")])
    for name in ("vendor.eds", "drive.eds"):
        shutil.copy(ROOT / "eds" / "motor.eds", folder / name)
    (folder / "dual.eds").write_text(dual(another((ROOT / "eds" / "motor.eds").read_text())))
    (folder / "vendor.xdd").write_text(as_xdd(read_eds(ROOT / "eds" / "motor.eds")))
    for name, faults in (("candump.log", ["--faults", str(ROOT / "examples" / "faults.toml")]), ("both.log", [])):
        log, recorded = folder / name, folder / f"of-{name}.pcapng"
        call(["simulate", "--seconds", SECONDS, "--record", str(recorded), *faults])
        call(["export", str(recorded), "--to", "candump", "-o", str(log)])
    rows = (folder / "both.log").read_text()
    (folder / "both.log").write_text(rows.replace(" can0 ", " can1 ") + rows.replace(" can1 ", " can0 "))
    for name in ("hybrid", "again", "sim", "rig"):
        shutil.copy(recording, folder / f"{name}.pcapng")
    (folder / "my-motion.csv").write_text("t_s,x_rad\n0,0\n1,0.1\n2,0\n")
    law = re.search(r"```python\n# my_law\.py\n(.*?)```", (ROOT / "docs" / "laws.md").read_text(), re.S)[1]
    (folder / "my_law.py").write_text(
        f"{law}\n\ndef law(motion, law, state):\n    state.brake_Nm = 1.0\n    return 0.0\n"
    )
    return folder


def desk(folder, inputs, lines):
    """Make the folder in which a reader of a page is: the clone's, with the files that the page's
    commands read and do not make.
    """
    for name in ("examples", "eds"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "out").mkdir()
    made = set()
    for line in lines:
        words = shlex.split(line)
        outputs = {word for option, word in pairwise(words) if option in OUTPUTS}
        for word in set(re.split(r"[\s=:]", line)) - outputs - made:
            source = inputs / Path(word).name
            if source.is_file() and not (folder / word).exists():
                (folder / word).parent.mkdir(exist_ok=True)
                shutil.copy(source, folder / word)
        made |= outputs


SHORT = {"simulate": ("--seconds", SECONDS), "analyse plane": ("--grid", "4")}
"""Verb -> an option of its length, and a value."""


def shortened(words):
    verb = next((verb for verb in SHORT if words[: len(verb.split())] == verb.split()), None)
    if verb is None:
        return words
    option, value = SHORT[verb]
    if option in words:
        at = words.index(option)
        words = [*words[:at], *words[at + 2 :]]
    return [*words, option, value]


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=() if page == "README.md" else pytest.mark.thorough)
        for page, lines in sorted(RUN.items())
        if lines
    ],
)
def test_the_commands_of_a_page(page, inputs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    desk(tmp_path, inputs, RUN[page])
    absent = []
    for line in RUN[page]:
        command, _, rest = line.partition(" | ")
        assert rest.split()[:1] in ([], ["less"], ["tail"]), line
        command, _, file = command.partition(" > ") if "'" not in command else (command, "", "")
        words = shlex.split(command)
        if not words[0].endswith("coulombus"):
            if missing(line):
                absent += missing(line)
                continue
            path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
            environment = {**os.environ, "PATH": path}
            done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300, env=environment)
            assert done.returncode == 0, f"{line}: {done.stderr}"
            continue
        printed = call(shortened(words[1:]))
        if file:
            Path(file).write_text(printed)
    if absent:
        pytest.skip(f"all other commands passed; not installed: {', '.join(dict.fromkeys(absent))}")


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.patient
def test_the_commands_of_a_live_bus(tmp_path, private_sockets):
    folder = tmp_path / "desk"
    folder.mkdir()
    desk(folder, tmp_path, [])
    lines = [one.line for one in FOUND if one.page == "docs/service.md" and one.fate.endswith("on a live bus")]
    assert len(lines) > 10
    with Reader(folder) as reader:
        for line in lines:
            reader.command(line + " &" if line.startswith("coulombus node ") else line)


def test_every_rule_has_its_commands_and_names_what_there_is():
    used = {rule_of(one.page, one.line) for one in FOUND}
    assert [RULES[n] for n in range(len(RULES)) if n not in used] == []
    for _, fate in RULES:
        for place in re.findall(r"\b(?:tests|docs)/[\w/.]*\w", fate):
            assert (ROOT / place).exists(), place
    assert [line for path in pages() for line in commands_of(path.read_text())] == [one.line for one in FOUND]
    assert os.sep not in RUN


def test_every_line_of_an_indented_block_is_a_command():
    """So no command can be missed because nobody knows its first word."""
    assert [(path.name, line) for path in pages() for line in strangers(path.read_text())] == []
