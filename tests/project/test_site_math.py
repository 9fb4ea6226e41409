"""The formulas of the documents are typeset when the site is built, and the laws' are the code's."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import markdown
import pytest
from click.testing import CliRunner
from mkdocs.exceptions import PluginError

from coulombus.cli.main import main
from coulombus.host.laws.laws import BUILTIN_LAWS
from places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
site_math = importlib.import_module("site_math")
hooks = importlib.import_module("site_hooks")

PAGE = SimpleNamespace(file=SimpleNamespace(src_path="x.md"))
PAGES = sorted((ROOT / "docs").rglob("*.md"))
MARK = {"pymdownx.arithmatex": {"generic": True, "smart_dollar": True}}
PARTS = re.compile(r",?\s*\\q?quad\s*(?:\\Rightarrow\s*\\q?quad\s*)?")
"""Between the equations of one formula."""


def as_html(text):
    return markdown.markdown(text, extensions=["tables", "pymdownx.superfences", *MARK], extension_configs=MARK)


def typeset(text):
    return hooks.on_page_content(as_html(text), PAGE, None, None)


@pytest.mark.thorough
@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT / "docs")))
def test_each_formula_of_a_page_is_typeset(path):
    text = path.read_text()
    html = typeset(text)
    assert site_math.raw_formula(html) == ""
    assert html.count('display="block"') == len(site_math.formulas(text))


@pytest.mark.parametrize("name", ["laws.md", "theory.md", "plane.md"])
def test_the_pages_with_equations_have_typeset_ones(name):
    assert len(site_math.formulas((ROOT / "docs" / name).read_text())) >= 4


@pytest.mark.parametrize("name", BUILTIN_LAWS)
def test_the_page_of_the_laws_has_each_law_s_equation_under_its_name(name):
    shown = CliRunner().invoke(main, ["law", name]).output
    assert f"docs/laws.md#{name}\n" in shown
    section = re.search(rf"^##+ `{name}`\n(.*?)(?=^##)", (ROOT / "docs" / "laws.md").read_text(), re.M | re.S)[1]
    there = site_math.formulas(section)
    assert there
    for formula in site_math.formulas(inspect.getdoc(BUILTIN_LAWS[name].function)):
        for part in PARTS.split(" ".join(formula.split())):
            assert any(part.strip() in whole for whole in there), part


def test_a_formula_becomes_mathml_with_its_text_for_a_screen_reader():
    html = typeset("The law $\\psi = \\frac{a}{b}$.\n\n$$\nx_1 \\le |v| \\tag{7}\n$$\n")
    line, block = re.findall(r"<math.*?</math>", html)
    assert ET.fromstring(line).find(".//{*}mfrac") is not None
    assert 'alttext="\\psi = \\frac{a}{b}"' in line
    assert 'display="block"' in block
    assert "<span>(7)</span>" in html
    assert "".join(ET.fromstring(block).itertext()) == "x1≤|v|"


@pytest.mark.parametrize("latex", [r"\unheard{x}", r"\left(a\right", r"\begin{aligned}a&=b\end{aligned}", r"}{"])
def test_a_formula_that_cannot_be_typeset_ends_the_build(latex):
    with pytest.raises(PluginError, match=r"x\.md: no formula"):
        typeset(f"$$\n{latex}\n$$\n")


@pytest.mark.parametrize("raw", ["a $$ b", "the level :math:`g(v)`", ".. math:: x"])
def test_a_formula_that_no_extension_reads_ends_the_build(raw):
    with pytest.raises(PluginError, match=r"x\.md: a formula was not typeset"):
        hooks.on_post_page(as_html(raw), PAGE, None)
    in_code = as_html(f"`{raw.replace('`', '')}`")
    assert hooks.on_post_page(in_code, PAGE, None) == in_code


def test_a_docstring_s_formulas_become_those_of_a_page():
    text = "With :math:`a\n  b` it is\n\n    .. math::\n\n        c = d, \\quad\n        e\n\n    so.\n\n.. math:: f\n"
    assert site_math.dollars(text) == (
        "With $a b$ it is\n\n    $$\n    c = d, \\quad\n    e\n    $$\n\n    so.\n\n$$\nf\n$$\n"
    )


def test_the_names_for_scripts_have_their_formulas_typeset():
    docstrings = importlib.import_module("site_docstrings")
    module = importlib.import_module("coulombus.analysis.theory.describing")
    value = SimpleNamespace(docstring=SimpleNamespace(value=inspect.getdoc(module.coulomb_psi)))
    assert ":math:" in value.docstring.value
    docstrings.Described().on_object(obj=value)
    assert "<math" in typeset(value.docstring.value)
    assert ":math:" not in typeset(value.docstring.value)
