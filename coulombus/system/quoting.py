r"""Quoting of text for other programs: one function per format, by that program's rules.

===================  ==============================================  =====================================
function             read by                                         its rules
===================  ==============================================  =====================================
`shell`              sh, as one word                                 POSIX, Shell Command Language 2.2
`comment`            sh, systemd, TOML: after a ``#``                up to the line's end
`extended_regex`     pgrep                                           POSIX, Base Definitions 9.4
`systemd_word`       systemd, as one word of ``ExecStart=``          systemd.syntax(7), systemd.service(5)
`systemd_program`    systemd, as the first word                      the same
`unit_name`          systemd, in the name of a unit                  systemd.unit(5), string escaping
`interface_name`     ip, systemd.network, systemd.link               netdevice(7), and no pattern
`lua`                Wireshark's Lua                                 Lua 5.2, 3.1
`uat_cell`           Wireshark's tables of a profile                 epan/uat.c: ``"`` and ``\xHH``
`xml`                KCD, JUnit, PlotJuggler, before ElementTree     XML 1.0, 2.2
`dbc`                DBC and SYM, before cantools                    a string of one line, no ``"``
===================  ==============================================  =====================================
"""

from __future__ import annotations

import os
import re
import shlex

from coulombus.system.foreign_text import one_line, printable

__all__ = [
    "INTERFACE",
    "comment",
    "dbc",
    "extended_regex",
    "interface_name",
    "lua",
    "shell",
    "systemd_program",
    "systemd_word",
    "uat_cell",
    "unit_name",
    "xml",
]

INTERFACE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,14}")
"""The kernel takes 1 to 15 bytes without white space, '/' and ':'. This pattern admits the subset that
shell, systemd and udev read as a plain name.
"""
_PLAIN_WORD = re.compile(r"[A-Za-z0-9_@%+=:,./$-]+")
_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def shell(word: str) -> str:
    """Quote a text as one word of a shell."""
    return shlex.quote(word)


def comment(text: str) -> str:
    """Return a text for use after ``#``: on one line, without control characters."""
    return one_line(text)


def extended_regex(text: str) -> str:
    """Return a pattern that matches this text alone."""
    return re.sub(r"[][\\.^$*+?(){}|]", r"\\\g<0>", text)


def systemd_word(word: str) -> str:
    """Return an argument of a command: quoted if necessary, with specifiers and variables escaped."""
    return systemd_program(word.replace("$", "$$"))


def systemd_program(word: str) -> str:
    """Return the command's program: systemd expands specifiers in it, but no variables."""
    word = word.replace("%", "%%")
    if _PLAIN_WORD.fullmatch(word):
        return word
    return '"' + "".join(map(_systemd_character, word)) + '"'


def _systemd_character(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    if character.isprintable():
        return character
    return "".join(f"\\x{byte:02x}" for byte in os.fsencode(character))


def unit_name(text: str) -> str:
    """Return a text escaped for the name of a unit, as by ``systemd-escape``."""

    def escaped(match: re.Match[str]) -> str:
        return "".join(f"\\x{byte:02x}" for byte in os.fsencode(match[0]))

    return re.sub(r"^\.|[^A-Za-z0-9:_./]", escaped, text).replace("/", "-")


def interface_name(name: str) -> str:
    """Return the name of a network interface unchanged.

    Raises
    ------
    ValueError
        a program would read it as more than a name
    """
    if not INTERFACE.fullmatch(name):
        raise ValueError(f"{name!r} cannot be the name of a network interface in another program's file")
    return name


def lua(text: str) -> str:
    r"""Return a Lua string; any special character is written as ``\ddd``."""
    plain = (chr(b) if 32 <= b < 127 and b not in b'"\\' else f"\\{b:03d}" for b in printable(text).encode())
    return '"' + "".join(plain) + '"'


def uat_cell(text: str) -> str:
    r"""Return a cell of a table of a Wireshark profile; ``"`` and ``\`` are written as ``\xHH``."""
    return '"' + re.sub(r'["\\]', lambda match: f"\\x{ord(match[0]):02x}", one_line(text)) + '"'


def xml(text: str) -> str:
    """Return a text in which U+FFFD replaces the characters that XML forbids; ElementTree escapes the rest."""
    return _NOT_IN_XML.sub("\ufffd", printable(text))


def dbc(text: str) -> str:
    """Return a text as a string of a DBC file; programs differ in how they read a backslash there."""
    return one_line(text).replace('"', "'").replace("\\", "/")
