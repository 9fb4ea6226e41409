"""What is written for another program is read back by that program's rules, as it was."""

from __future__ import annotations

import csv
import os
import re
import shlex
import shutil
import subprocess
from xml.etree import ElementTree

import cantools
import pytest
from cantools.database.can import Database, Message, Node, Signal
from hypothesis import example, given
from hypothesis import strategies as st

from coulombus.system.foreign_text import first_control, one_line, printable
from coulombus.system.quoting import (
    comment,
    dbc,
    extended_regex,
    interface_name,
    lua,
    shell,
    systemd_program,
    systemd_word,
    uat_cell,
    unit_name,
    xml,
)
from systemd_syntax import systemd_words

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
HOSTILE = "$%;\"'\\ \t\n\r|&`!*?[]{}()<>~#-.@+:=,/\x01\x1b\x7f\x9b\u202eéx0n"
texts = st.text(st.sampled_from(HOSTILE), max_size=12) | st.text(st.characters(exclude_characters="\0"), max_size=12)
paths = texts | st.binary(max_size=8).map(lambda raw: os.fsdecode(raw.replace(b"\0", b"")))
"""What a path may be: bytes that are no UTF-8 among them."""


@given(paths)
@example("x;touch$IFS..P")
@example("a\nb'")
def test_a_shell_reads_one_word_as_it_was(word):
    assert shlex.split(f"say {shell(word)} end") == ["say", word, "end"]


def test_sh_itself_reads_the_words_as_they_were():
    words = ["", "x;touch$IFS..P", "$(id)", "`id`", "a'b", 'a"b', "a\\", "*", "~", "a\nb", "%s", "-n", "\x1b", "é"]
    code = "printf '%s\\0' " + " ".join(map(shell, words))
    done = subprocess.run(["sh", "-c", code], capture_output=True, check=True)
    assert done.stdout == b"".join(word.encode() + b"\0" for word in words)


@given(st.lists(paths, min_size=1, max_size=4))
@example(["%n", "$HOME", "${A}", ";", "\\", "", "a'b", '"', "a\nExecStart=/bin/rm", "\x1b\x7f\u202e"])
def test_systemd_reads_the_words_as_they_were(words):
    program, *arguments = words
    line = " ".join((systemd_program(f"/{program}"), *map(systemd_word, arguments)))
    assert systemd_words(line) == [f"/{program}", *arguments]
    assert not CONTROL.search(line)
    assert "\n" not in line


@pytest.mark.parametrize(
    ("word", "written"),
    [
        ("/a/b-c.toml", "/a/b-c.toml"),
        ("50%", "50%%"),
        ("$HOME", "$$HOME"),
        ("my rig", '"my rig"'),
        ('a"b\\c', '"a\\"b\\\\c"'),
        ("a\nExecStart=/bin/rm", '"a\\x0aExecStart=/bin/rm"'),
        ("", '""'),
    ],
)
def test_words_are_written_as_systemd_reads_them(word, written):
    assert systemd_word(word) == written


@given(paths)
def test_the_name_of_a_unit_has_nothing_but_a_names_characters(text):
    name = unit_name(text)
    assert re.fullmatch(r"[A-Za-z0-9:_.\\-]*", name)
    back = re.sub(rb"\\x([0-9a-f]{2})", lambda match: bytes.fromhex(match[1].decode()), name.replace("-", "/").encode())
    assert os.fsdecode(back) == text


@pytest.mark.skipif(shutil.which("systemd-escape") is None, reason="no systemd-escape")
@pytest.mark.parametrize("text", ["can0", "can-a.1", ".x", "a/b", "a b%$é"])
def test_the_name_of_a_unit_is_that_of_systemd_escape(text):
    done = subprocess.run(["systemd-escape", "--", text], capture_output=True, text=True, check=True)
    assert unit_name(text) == done.stdout.strip()


@given(st.text(max_size=17) | st.text(st.sampled_from("aZ09_.-;$ "), max_size=17))
def test_the_name_of_an_interface_is_a_name_to_every_program(name):
    try:
        assert interface_name(name) == name
    except ValueError:
        assert not re.fullmatch("[A-Za-z0-9_][A-Za-z0-9_.-]{,14}", name)
    else:
        assert 1 <= len(name.encode()) <= 15
        assert name not in (".", "..")
        assert name[0] not in "-."
        assert shell(name) == systemd_word(name) == name


@given(texts)
def test_a_pattern_fits_its_text_alone(text):
    assert re.fullmatch(extended_regex(text), text)
    assert not re.fullmatch(extended_regex(text), f"{text}x")


@given(paths)
def test_a_comment_ends_with_its_line(text):
    assert not CONTROL.search(comment(text))
    assert not set("\n\r\t") & set(comment(text))


@given(paths)
def test_lua_reads_a_string_as_it_is_shown(text):
    written = lua(text)
    assert re.fullmatch(r'"(?:[ !#-\[\]-~]|\\\d{3})*"', written)
    raw = re.sub(rb"\\(\d{3})", lambda match: bytes([int(match[1])]), written[1:-1].encode())
    assert raw.decode() == printable(text)


@given(paths)
def test_wiresharks_table_reads_a_cell_as_it_is_shown(text):
    ((cell, other),) = csv.reader([f'{uat_cell(text)},"other"'])
    assert other == "other"
    assert re.sub(r"\\x([0-9a-f]{2})", lambda match: chr(int(match[1], 16)), cell) == one_line(text)


@given(paths)
def test_xml_is_read_as_it_is_shown(text):
    element = ElementTree.Element("a", b=xml(text))
    element.text = xml(text)
    back = ElementTree.fromstring(ElementTree.tostring(element, encoding="unicode"))
    assert back.get("b").replace("\r", "\n") == xml(text).replace("\r", "\n")
    assert not CONTROL.search((back.text or "") + (back.get("b") or ""))


@given(paths)
@example('a" ; CM_ "')
@example("a\\")
def test_dbc_and_kcd_are_read_as_they_are_shown(text):
    signal = Signal("s", 0, 8, comment=dbc(text))
    made = Database([Message(1, "m", 8, [signal], comment=dbc(text))], nodes=[Node("n", "")], version=dbc(text))
    for kind in ("dbc", "kcd", "sym"):
        back = cantools.database.load_string(getattr(made, f"as_{kind}_string")(), kind)
        (message,) = back.messages
        assert (message.signals[0].comment or "").strip() == dbc(text).strip()
        assert not CONTROL.search(getattr(made, f"as_{kind}_string")().replace("\r\n", "\n"))


@given(st.text())
def test_what_is_printed_has_no_control_characters_and_nothing_else_is_changed(text):
    shown = printable(text)
    assert not CONTROL.search(shown)
    assert printable(shown) == shown
    assert [character for character in text if not CONTROL.match(character)] == [
        character for character in text if character in shown and not CONTROL.match(character)
    ]
    assert bool(first_control(text)) == bool(CONTROL.search(text) or set("\t\n") & set(text))
