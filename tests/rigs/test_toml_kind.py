"""A file of another kind is said to be one, in one line, wherever it is given."""

from __future__ import annotations

from itertools import permutations

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.rigs.toml_lines import KINDS
from places import ROOT

EXAMPLES = {
    "rig": "coulombus/rigs/bench.toml",
    "faults": "examples/faults.toml",
    "script": "",
    "sweep": "examples/sweep_hybrid.toml",
    "study": "examples/study_constant.toml",
}
COMMANDS = {
    "rig": "check --rig FILE",
    "faults": "simulate --faults FILE --seconds 0.1",
    "script": "simulate --script FILE --seconds 0.1",
    "sweep": "sweep FILE -o OUT",
    "study": "experiment FILE --subject S1 -o OUT --virtual",
}


@pytest.mark.parametrize(("expected", "given"), list(permutations(KINDS, 2)))
def test_a_file_of_another_kind_is_one_mistake(tmp_path, expected, given):
    file = ROOT / EXAMPLES[given]
    if given == "script":
        file = tmp_path / "script.toml"
        file.write_text('[[at]]\nt_s = 1.0\nnode = "motor"\naction = "reset"\n')
    words = COMMANDS[expected].replace("OUT", str(tmp_path / "out")).split()
    done = CliRunner().invoke(main, [str(file) if word == "FILE" else word for word in words])
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"coulombus: {file}: this is {KINDS[given].name} (")
    assert line.endswith(f"; expected {KINDS[expected].name} ({KINDS[expected].given_by})")
    assert done.exit_code == 3
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", [kind for kind, path in EXAMPLES.items() if path])
def test_a_file_of_its_kind_is_taken(kind, tmp_path):
    from coulombus.rigs.toml_lines import of_another_kind, read_toml

    assert of_another_kind(read_toml((ROOT / EXAMPLES[kind]).read_text()).values, kind) is None
