"""docs/api.md and the public names of the package: the same names, with the same signatures."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys

import pytest

from places import ROOT

MODULES = ("coulombus", "coulombus.analysis", "coulombus.lab", "coulombus.recording")
TEXT = (ROOT / "docs" / "api.md").read_text()
SHORT = 12
"""A default that is longer is shown as "..."."""


def rows(module):
    """Return {name: signature} of a module's table."""
    part = TEXT.partition(f"\n## `{module}`\n")[2].partition("\n## ")[0]
    return dict(re.findall(r"^\| `(\w+)` \| [^|]+ \| `([^`]+)` \| [^|]+ \|$", part, re.M))


def signature(name, value):
    """Return a signature without types, as the page has it."""
    if isinstance(value, type) and issubclass(value, BaseException):
        return name
    parts = []
    for parameter in inspect.signature(value).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in parts:
            parts.append("*")
        default = parameter.default
        plain = default is None or isinstance(default, bool | int | float | str)
        shown = repr(default) if plain and len(repr(default)) <= SHORT else "..."
        parts.append(parameter.name if default is parameter.empty else f"{parameter.name}={shown}")
    return f"{name}({', '.join(parts)})"


@pytest.mark.parametrize("module", MODULES)
def test_the_page_has_each_public_name_with_its_signature(module):
    names = importlib.import_module(module).__all__
    found = {name: signature(name, getattr(importlib.import_module(module), name)) for name in names}
    assert len(found) >= 10
    assert rows(module) == found


@pytest.mark.parametrize("module", MODULES)
def test_each_public_name_has_a_docstring(module):
    for name in importlib.import_module(module).__all__:
        assert inspect.getdoc(getattr(importlib.import_module(module), name)), name


@pytest.mark.parametrize("module", MODULES)
def test_no_public_name_hides_a_module_of_its_package(module):
    package = importlib.import_module(module)
    inner = {found.name for found in pkgutil.iter_modules(package.__path__)}
    assert inner
    assert inner & set(package.__all__) == set()


@pytest.mark.parametrize("module", MODULES)
def test_a_name_that_is_not_public_is_refused(module):
    with pytest.raises(AttributeError, match=f"module '{module}' has no attribute 'decode'"):
        importlib.import_module(module).decode  # noqa: B018
    assert dir(importlib.import_module(module)) == sorted(importlib.import_module(module).__all__)


def test_a_name_of_two_modules_is_the_same_object():
    seen = {}
    for module in MODULES:
        for name in importlib.import_module(module).__all__:
            value = getattr(importlib.import_module(module), name)
            assert seen.setdefault(name, value) is value, name


def test_the_packages_load_nothing_before_a_name_is_used():
    code = f"import sys, {', '.join(MODULES)}; sys.exit(bool({{'numba', 'numpy', 'scipy', 'pydantic'}} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def returned():
    """Return {class: its attributes} of the page's last table."""
    part = TEXT.partition("\n## Returned values\n")[2]
    found = re.findall(r"^\| `([\w.]+)\.(\w+)` \| (.+) \|$", part, re.M)
    return {
        getattr(importlib.import_module(module), name): re.findall(r"`(\w+)(?:\(\))?`", attributes)
        for module, name, attributes in found
    }


def has(kind, name):
    return hasattr(kind, name) or any(name in vars(base).get("__annotations__", {}) for base in kind.__mro__)


def test_each_returned_value_has_the_attributes_of_the_page():
    values = returned()
    assert len(values) > 40
    assert {kind.__name__: name for kind, names in values.items() for name in names if not has(kind, name)} == {}
    assert all(len(names) == len(set(names)) > 0 for names in values.values())


def test_the_page_has_each_class_of_this_project_that_a_function_returns():
    described = {"CoulombusError", "Hand", "LiveBus", "Rig", "Study", "Sweep"}  # pages of their own, or handed on only
    shown = {kind.__name__ for kind in returned()} | described
    missing = set()
    for module in MODULES:
        for name in importlib.import_module(module).__all__:
            function = getattr(importlib.import_module(module), name)
            if not inspect.isfunction(function):
                continue
            for word in re.findall(r"[A-Z]\w*", str(inspect.signature(function).return_annotation)):
                kind = function.__globals__.get(word)
                if isinstance(kind, type) and kind.__module__.startswith("coulombus."):
                    missing |= {word} - shown
    assert missing == set()


def test_the_page_has_the_promise():
    assert "`DeprecationWarning`" in TEXT
    assert "MAJOR.MINOR.PATCH" in TEXT
