"""CITATION.cff and .zenodo.json say the same, and what they cite is what the project rests on."""

from __future__ import annotations

import json
import re

import pytest

from coulombus.host.laws.laws import BUILTIN_LAWS
from places import ROOT

yaml = pytest.importorskip("yaml")

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
ZENODO = json.loads((ROOT / ".zenodo.json").read_text())
REFERENCES = CITATION["references"]


def test_the_archive_has_what_the_citation_has():
    assert ZENODO["title"] == CITATION["title"]
    assert ZENODO["version"] == str(CITATION["version"])
    assert ZENODO["license"] == CITATION["license"]
    assert ZENODO["keywords"] == CITATION["keywords"]
    assert ZENODO["description"] == CITATION["abstract"]
    assert ZENODO["publication_date"] == str(CITATION["date-released"])
    assert [creator["name"] for creator in ZENODO["creators"]] == [author["name"] for author in CITATION["authors"]]
    assert ZENODO["upload_type"] == CITATION["type"] == "software"


def test_the_archive_names_each_reference_with_a_doi():
    dois = [reference["doi"] for reference in REFERENCES if "doi" in reference]
    assert [related["identifier"] for related in ZENODO["related_identifiers"]] == dois
    assert {related["relation"] for related in ZENODO["related_identifiers"]} == {"cites"}
    assert all(re.fullmatch(r"10\.\d{4,}/\S+", doi) for doi in dois)


def test_the_paper_is_the_first_reference_in_both():
    paper = REFERENCES[0]
    assert paper["title"] in (ROOT / "docs" / "theory.md").read_text()
    (text,) = ZENODO["references"]
    parts = [paper["title"], paper["url"], str(paper["year"]), paper["conference"]["name"]]
    parts += [f"{author['family-names']}, {author['given-names']}" for author in paper["authors"]]
    assert [part for part in parts if part not in text] == []


def test_the_standards_are_references():
    standards = [reference["title"] for reference in REFERENCES if reference["type"] == "standard"]
    assert [title.partition(":")[0] for title in standards] == ["CiA 301", "CiA 402", "CiA 404"]


@pytest.mark.parametrize("law", ["lugre", "dahl", "karnopp", "kikuuwe"])
def test_the_doi_of_a_law_is_that_of_its_source(law):
    cited = {reference.get("doi") for reference in REFERENCES}
    assert cited & set(BUILTIN_LAWS[law].dois)


def test_each_reference_has_what_a_reader_needs_to_find_it():
    for reference in REFERENCES:
        assert reference["authors"], reference["title"]
        assert reference["type"] == "standard" or reference.keys() & {"doi", "url"}, reference["title"]
