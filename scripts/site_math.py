"""Typesets the documents' formulas as MathML when the site is built: no script, no network.

A page has formulas in LaTeX, `$...$` in a line and `$$...$$` in a block of its own, as code hosts
render them. Markdown's extension `pymdownx.arithmatex` finds them. `typeset` makes MathML, which
browsers draw themselves. Docstrings have Sphinx's form of the same formulas (`dollars`).
"""

from __future__ import annotations

import re
import textwrap
import xml.etree.ElementTree as ET
from html import escape, unescape

from latex2mathml.converter import convert

__all__ = ["STYLE", "dollars", "formulas", "mathml", "raw_formula", "typeset"]

MARKED = re.compile(r'<(div|span) class="arithmatex">(?:\\\((?P<line>.*?)\\\)|\\\[(?P<block>.*?)\\\])</\1>', re.S)
"""A formula as arithmatex marks it."""
BLOCK = re.compile(r"^\$\$\n(.*?)\n\$\$$", re.M | re.S)
ROLE = re.compile(r":math:`([^`]+)`")
DIRECTIVE = re.compile(r"^( *)\.\. math::[ ]?(.*(?:\n+(?:\1[ ]{3,}\S.*))*)", re.M)
CODE = re.compile(r"<(pre|code|script|style|math)\b.*?</\1>", re.S)
RAW = re.compile(r":math:|\.\. math::|\$\$|class=\"arithmatex\"")
BAR = re.compile(r"<mo( stretchy=\"false\")?>(&#x0007C;|&#x02016;)</mo>")
FUNCTION = re.compile(r"<mi>(sin|cos|tan|tanh|arctan|exp|ln|log)</mi>(?!<mo[^>]*>&#x00028;)")
NAMED = re.compile(r"<mo>([A-Za-z]{2,})</mo>(?=(<mo[^>]*>&#x00028;)?)")
"""A function named by the author, and the parenthesis after it."""
TAG = re.compile(r"\\tag\{([^{}]*)\}")
STYLE = (
    "<style>math{font-family:'STIX Two Math','Latin Modern Math','Cambria Math','TeX Gyre Termes Math',"
    "'DejaVu Math TeX Gyre',math;font-size:1.1em}"
    ".formula{display:flex;align-items:center;margin:1em 0}"
    ".formula math{flex:1;overflow:auto hidden;padding:.3em 0}</style>"
)
"""Style of the formulas: the reader's own mathematical font. A narrow window scrolls a long one."""


def mathml(latex: str, block: bool = False) -> str:
    """Return a formula as an element of MathML.

    Parameters
    ----------
    latex : the formula, without its dollars
    block : whether it has a line of its own

    Raises
    ------
    ValueError
        The formula has an unknown command, or braces and ends without their beginnings.
    """
    try:
        markup = convert(latex, display="block" if block else "inline")
        words = "".join(ET.fromstring(markup).itertext())
    except Exception as error:  # the converter has no base class of its errors
        raise ValueError(f"no formula: {latex!r}: {error or type(error).__name__}") from error
    if unread := re.search(r"\\\w*|[&$]", words):
        raise ValueError(f"no formula: {latex!r}: {unread[0]!r} is not understood")
    markup = BAR.sub(r'<mo stretchy="false" lspace="0" rspace="0">\2</mo>', markup)  # else spaced as between two terms
    markup = FUNCTION.sub(r'<mo form="prefix" lspace="0.17em" rspace="0.17em">\1</mo>', markup)
    markup = NAMED.sub(
        lambda m: f'<mo form="prefix" lspace="0.17em" rspace="{0 if m[2] else 0.17}em">{m[1]}</mo>', markup
    )
    return markup.replace("<math ", f'<math alttext="{escape(" ".join(latex.split()), quote=True)}" ', 1)


def typeset(html: str) -> str:
    """Return a page with every marked formula as MathML.

    Raises
    ------
    ValueError
        A formula cannot be typeset.
    """

    def formula(match: re.Match[str]) -> str:
        latex = unescape(match["line"] if match["block"] is None else match["block"]).strip()
        if match["block"] is None:
            return mathml(latex)
        number = "".join(f"<span>({escape(text)})</span>" for text in TAG.findall(latex))
        return f'<div class="formula">{mathml(TAG.sub("", latex), block=True)}{number}</div>'

    return MARKED.sub(formula, html)


def raw_formula(html: str) -> str:
    """Return the first formula of a page that is not typeset; code is no formula. Empty: none."""
    match = RAW.search(CODE.sub("", html))
    return match[0] if match else ""


def dollars(docstring: str) -> str:
    """Return a docstring whose formulas stand between dollars instead of in Sphinx's roles."""

    def block(match: re.Match[str]) -> str:
        lines = [line.strip() for line in textwrap.dedent(match[2]).splitlines() if line.strip()]
        return "".join(f"{match[1]}{line}\n" for line in ("$$", *lines, "$$")).rstrip("\n")

    return ROLE.sub(lambda match: f"${' '.join(match[1].split())}$", DIRECTIVE.sub(block, docstring))


def formulas(text: str) -> list[str]:
    """Return the formulas of a page or docstring that have a line of their own."""
    return [" ".join(formula.split()) for formula in BLOCK.findall(textwrap.dedent(dollars(text)))]
