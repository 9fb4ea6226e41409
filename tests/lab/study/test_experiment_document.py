"""docs/experiment.md names every key, and nothing else."""

import re

from coulombus.lab.study.study import METHODS, StudyFile
from places import ROOT

TEXT = (ROOT / "docs" / "experiment.md").read_text()


def rows(header):
    table = TEXT.split(header)[1].split("\n\n")[0]
    return [line.split("|")[1:3] for line in table.splitlines()[2:]]


def test_every_key_of_a_study_file_stands_in_its_table():
    keys = [key for first, _ in rows("| key | meaning |") for key in re.findall(r"`(\w+)`", first)]
    assert sorted(keys) == sorted(StudyFile.model_fields)


def test_every_method_stands_in_its_table_with_its_keys():
    found = {first.strip().strip("`"): keys for first, keys in rows("| `method.kind` | keys |")}
    assert set(found) == set(METHODS)
    for kind, model in METHODS.items():
        assert set(re.findall(r"`(\w+)`", found[kind])) == set(model.model_fields) - {"kind"}
