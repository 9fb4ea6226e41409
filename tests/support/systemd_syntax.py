"""A command line of a unit as systemd reads it: systemd.syntax(7), systemd.service(5),
systemd.unit(5).
"""

from __future__ import annotations

import os
import re

__all__ = ["systemd_words"]

ESCAPES = {"a": 7, "b": 8, "f": 12, "n": 10, "r": 13, "t": 9, "v": 11, "\\": 92, '"': 34, "'": 39, "s": 32}
CODE = re.compile(r"x([0-9a-fA-F]{2})|([0-7]{3})|u([0-9a-fA-F]{4})|U([0-9a-fA-F]{8})")


def systemd_words(line):
    """Return the words of a value of ``ExecStart=``, the first of which is the program.

    ValueError: a specifier or a variable is in it, a second command begins, or the manuals forbid it.
    """
    assert not re.search("[\0\n\r]", line), "the value ends here"
    assert not line.endswith("\\"), "the next line is joined"
    words = []
    rest = line.strip(" \t")
    while rest:
        if re.match(r";([ \t]|$)", rest):
            raise ValueError("a second command")
        word, rest = _word(rest)
        words.append(_specified(word) if not words else _substituted(_specified(word)))
        rest = rest.lstrip(" \t")
    return words


def _word(text):
    found, quote, i = b"", "", 0
    while i < len(text):
        character = text[i]
        if character == "\\":
            code, length = _unescaped(text[i + 1 :])
            found, i = found + code, i + 1 + length
            continue
        i += 1
        if quote:
            if character == quote:
                if text[i : i + 1] not in ("", " ", "\t"):
                    raise ValueError("white space, or the end, follows a closing quote")
                quote = ""
                continue
        elif character in " \t":
            break
        elif character in "\"'":
            if i > 1:
                raise ValueError("a quote begins within a word")
            quote = character
            continue
        found += os.fsencode(character)
    if quote:
        raise ValueError("a quote is open")
    return os.fsdecode(found), text[i:]


def _unescaped(text):
    if text[:1] in ESCAPES and text[:1]:
        return bytes([ESCAPES[text[0]]]), 1
    code = CODE.match(text)
    if code is None:
        raise ValueError(f"an unknown escape: {text[:4]!r}")
    if code[1] or code[2]:
        byte = int(code[1], 16) if code[1] else int(code[2], 8)
        if not 0 < byte < 256:
            raise ValueError("no byte, or 0")
        return bytes([byte]), code.end()
    return chr(int(code[3] or code[4], 16)).encode(), code.end()


def _specified(word):
    """`%%` is a percent sign; any other specifier is expanded."""
    if re.search("%", word.replace("%%", "")):
        raise ValueError("a specifier")
    return word.replace("%%", "%")


def _substituted(word):
    """`$$` is a dollar sign; any other one may begin a variable."""
    if "$" in word.replace("$$", ""):
        raise ValueError("a variable")
    return word.replace("$$", "$")
