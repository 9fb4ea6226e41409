"""The tree of the project's errors: its drawing, its names, and that each has its exit status."""

from __future__ import annotations

import ast
import builtins
from functools import cache
from typing import NamedTuple

import pytest

import coulombus
from coulombus.cli.errors import FAULT, STATUSES
from coulombus.system import errors
from coulombus.system.errors import CoulombusError
from places import ROOT

INTERNAL = {
    "BadPacketError": "the reader of a file makes a remark or a PcapngError of it",
    "BusFull": "a sender waits and tries again; where it gives up, it raises BusUnavailable",
    "CannotRead": "a check of the doctor makes a finding of it",
    "CaseFailed": "ends a case of the conformance test, which makes a verdict of it",
    "Failure": "what the command line makes of each error: its text and its exit status",
    "MechanismMistake": "the reader of a rig file makes a RigError of it, with the file's line",
    "NoRegularFile": "an OSError of a file as any: told with the file's name and what is wrong",
    "NotApplicable": "ends a case of the conformance test, which makes a verdict of it",
    "SdoAbort": "the device answers the client with its code",
    "Stopped": "a KeyboardInterrupt: no error, and past every except Exception",
    "Unsupported": "a case of the conformance test goes on with the next PDO",
    "_DifferentError": "ends the comparison of a replay, whose result has the difference",
    "_Refused": "the roles of a rig make a problem of it",
}
"""Exceptions that are no CoulombusError, and why. What derives from one is none either."""


class Found(NamedTuple):
    """A class of the sources: its module, its bases' names, and its exit status.

    Attributes
    ----------
    status : its own; "n" where each error has one of its own; "" where it is the base's
    """

    name: str
    module: str
    bases: tuple[str, ...]
    status: str


def status_of(node: ast.ClassDef) -> str:
    for statement in node.body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "exit_status":
            return ast.unparse(statement.value)
    assigned = [ast.unparse(statement.targets[0]) for statement in ast.walk(node) if isinstance(statement, ast.Assign)]
    return "n" if "self.exit_status" in assigned else ""


def is_exception(name: str) -> bool:
    """Tell whether a base is an exception of Python, or by its name one of a library."""
    known = getattr(builtins, name, None)
    if known is not None:
        return isinstance(known, type) and issubclass(known, BaseException)
    return name.endswith(("Error", "Exception"))


@cache
def exceptions() -> list[Found]:
    """Return the exception classes of all sources, `CoulombusError` among them."""
    classes = []
    for top in ("coulombus", "eds", "host", "node", "sim_bus"):
        for path in sorted((ROOT / top).rglob("*.py")):
            source = path.read_text()
            if path.resolve() != path or "class " not in source:  # the links of coulombus/
                continue
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            module = module.removeprefix("coulombus.").removesuffix(".__init__")
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.ClassDef):
                    bases = tuple(ast.unparse(base).rpartition(".")[2] for base in node.bases)
                    classes.append(Found(node.name, module, bases, status_of(node)))
    known: set[str] = set()
    while True:
        more = {class_.name for class_ in classes if any(base in known or is_exception(base) for base in class_.bases)}
        if more == known:
            return [class_ for class_ in classes if class_.name in known]
        known = more


def below(name: str) -> list[Found]:
    """Return the classes right below one, by their names."""
    return sorted(class_ for class_ in exceptions() if name in class_.bases)


def derived(name: str) -> set[str]:
    return {name}.union(*(derived(class_.name) for class_ in below(name)))


def drawn(name: str, status: str = "", indent: str = "") -> list[str]:
    """Return the lines of the tree below a class."""
    lines = []
    children = below(name)
    for class_ in children:
        own = class_.status or status
        others = ", ".join(base for base in class_.bases if base != name)
        head = f"{indent}+-- {class_.name}"
        lines.append(f"{head:<33}{own:<4}{class_.module:<29}{others}".rstrip())
        lines += drawn(class_.name, own, indent + ("    " if class_ is children[-1] else "|   "))
    return lines


@pytest.mark.thorough
def test_the_module_draws_the_tree():
    tree = ["CoulombusError", *drawn("CoulombusError")]
    assert len(tree) > 60
    said = (errors.__doc__ or "").splitlines()
    begin = said.index("CoulombusError")
    assert said[begin : begin + len(tree)] == tree, "\n" + "\n".join(tree)
    assert said[begin + len(tree)] == ""


def test_every_exception_is_a_coulombus_error_or_internal():
    internal = set().union(*map(derived, INTERNAL))
    assert set(INTERNAL) <= {class_.name for class_ in exceptions()}
    assert not internal & derived("CoulombusError")
    assert {class_.name for class_ in exceptions()} - internal == derived("CoulombusError")


def test_no_name_stands_for_two_exceptions():
    names = [class_.name for class_ in exceptions()]
    assert sorted(names) == sorted(set(names))


def test_each_error_has_an_exit_status_of_the_table():
    known = {"n", *map(str, set(STATUSES) - {0, FAULT})}
    for line in drawn("CoulombusError"):
        name, status, *_ = line[line.index("+-- ") + 4 :].split()
        assert status in known, name


def test_a_script_catches_each_error_by_one_class():
    assert coulombus.CoulombusError is CoulombusError
    with pytest.raises(coulombus.CoulombusError, match=r"no-such\.toml") as caught:
        coulombus.load_rig("no-such.toml")
    assert caught.value.exit_status == 3
    with pytest.raises(coulombus.CoulombusError) as caught:
        coulombus.read(3)
    assert isinstance(caught.value, TypeError)
