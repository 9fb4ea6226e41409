"""The words that people read: no phrase of the list below in a page or a help text, one accepted spelling for
each word (misspelt words are codespell's), and no word twice in a row.

A phrase stands in the list with the words to write instead. What stands in code is not prose: fenced
and indented blocks, spans between backticks, and the targets of links.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import click
import pytest

from coulombus.cli.main import main
from places import ROOT

INSTEAD = {  # a pattern of words -> what to write
    # riddles: the thing stands first
    r"that which": "the noun itself",
    r"somebody|someone|anybody|anyone|nobody": "the node, the client or the person that acts",
    r"whoever|whosoever": "the noun of the actor",
    r"is told|are told|was told": "is reported, is printed",
    r"tells? nothing": "has no value",
    r"is looked for|are looked for": "is searched",
    r"looks? on": "monitors",
    r"in the midst": "during, in the middle",
    r"afterwards you can|after this page": "the subject of the page",
    r"what came of|became of": "the result",
    # metaphors where a term exists
    r"at the door": "connected",
    r"loses? heart": "gives up",
    r"sits? down": "acquires control",
    r"goes? wrong": "fails",
    r"twin": "equivalent, duplicate",
    r"for ever": "without end, continuous",
    r"any doubt": "a failed check",
    r"stood still|stands still": "hung, stalled (a program), is at rest (a handle)",
    r"mends?|mended|mending": "fix, correct",
    r"a belief|the belief|beliefs?|believes?|believed": "assumption, estimate",
    r"lives behind": "is simulated behind",
    # standard terms
    r"answers? no SDO": "does not respond to SDO",
    r"a mistake of this program": "internal error",
    r"go on behind|goes on behind": "continues after",
    # idle words
    r"of course|obviously|simply|easily|just so": "nothing: delete it",
}
SPELLINGS = {  # pattern of a spelling -> the accepted one
    r"behavior\w*": "behaviour",
    r"colors?|colored": "colour",
    r"centers?|centered": "centre",
    r"analyz\w+": "analyse",
    r"initialize\w*": "initialise",
    r"synchroniz\w+": "synchronise",
    r"recogniz\w+": "recognise",
    r"normaliz\w+": "normalise",
    r"labor\w*": "laboratory, labour",
    r"modeled|modeling": "modelled, modelling",
    r"canceled|canceling": "cancelled, cancelling",
    r"labeled|labeling": "labelled, labelling",
    r"setpoints?": "set-point",
    r"timeouts?": "time-out",
    r"timestamps?": "time stamp",
    r"bitrates?": "bit rate",
    r"heart beats?|heart-beats?": "heartbeat",
    r"bring up|bringup": "bring-up",
}
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "docs").rglob("*.ipynb")),
]


def prose(text: str) -> str:
    """Return the sentences of a page of Markdown, without code and without targets of links."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    text = re.sub(r"^    .*$", "", text, flags=re.M)
    text = re.sub(r"<!--.*?-->|`[^`]*`|\]\([^)]*\)|https?://\S+", " - ", text, flags=re.S)
    text = re.sub(
        r"^(#+ .*)$|^[ ]*(?=[-*] |\d+\. )|\n\n+", r" . \1 . ", text, flags=re.M
    )  # no sentence goes over these
    return re.sub(r"\s+", " ", text)


def page_text(path) -> str:
    """Return a page's Markdown: of a notebook its cells of text, of the changelog its next version."""
    text = path.read_text(encoding="utf-8")
    if path.name == "CHANGELOG.md":
        return re.split(r"^## (?=\d)", text, maxsplit=1, flags=re.M)[0]
    if path.suffix != ".ipynb":
        return text
    return "\n\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown")


def commands(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    """Yield each command of a group with its words, and the group."""
    yield name, command
    for verb, child in getattr(command, "commands", {}).items():
        yield from commands(child, f"{name} {verb}")


def help_of(command: click.Command) -> str:
    """Return what `--help` says in sentences: of the command, and of each option."""
    options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    return prose(". ".join([command.help or "", *(option.help or "" for option in options)]).replace("\b", " "))


def hits(text: str, patterns: dict[str, str]) -> list[str]:
    """Return each word or phrase of a list that a text has, with its neighbours and the better one."""
    found = []
    for pattern, better in patterns.items():
        for match in re.finditer(rf"(?<![\w-])(?:{pattern})(?![\w-])", text, re.I):
            around = text[max(0, match.start() - 30) : match.end() + 30]
            found.append(f"'{match[0]}' in '...{around}...': write: {better}")
    return found


def doubled(text: str) -> list[str]:
    """Return each word that stands twice in a row."""
    return [match[0] for match in re.finditer(r"(?<![\w-])([A-Za-z]{2,}) \1(?![\w-])", text)]


@pytest.mark.parametrize("path", PAGES, ids=[str(path.relative_to(ROOT)) for path in PAGES])
def test_a_page_has_the_accepted_words_and_spellings(path):
    text = prose(page_text(path))
    assert hits(text, INSTEAD) == []
    assert hits(text, SPELLINGS) == []
    assert doubled(text) == []


@pytest.mark.parametrize("name", [name for name, _ in commands(main, "coulombus")])
def test_a_help_text_has_the_accepted_words_and_spellings(name):
    text = help_of(dict(commands(main, "coulombus"))[name])
    assert hits(text, INSTEAD) == []
    assert hits(text, SPELLINGS) == []
    assert doubled(text) == []


def test_a_phrase_of_the_list_is_found_over_the_end_of_a_line():
    assert len(hits(prose("A host is\ntold so."), INSTEAD)) == 1
    assert len(hits(prose("The setpoint behavior."), SPELLINGS)) == 2
    assert doubled(prose("It is in the\nthe queue.")) == ["the the"]


def test_code_is_no_prose():
    text = "Set `motor.setpoint` here.\n\n    coulombus timeout\n\n```\nbehavior\n```\n[A page](timeout.md)."
    assert hits(prose(text), SPELLINGS) == []
