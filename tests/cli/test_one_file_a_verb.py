"""Each verb has a module of its name in `coulombus.cli`, and what else is there has its reason."""

from __future__ import annotations

import ast
from importlib import import_module

import click

from coulombus.cli.main import SECTIONS, main
from places import ROOT

CLI = ROOT / "coulombus" / "cli"
VERBS = {name for section in SECTIONS.values() for name in section}
SHARED = {
    "main": "the list of the verbs",
    "errors": "what ends a verb, and with which status",
    "options": "how options are declared, and those of several verbs",
    "option_types": "what an option's text may be",
    "rig_options": "a rig, its buses, and the running host that are meant",
    "device_options": "the bus of the verbs for devices",
    "page_options": "the page of run, emulate and watch",
    "tables": "what is printed, and progress",
    "run_table": "the results of run, simulate and demo",
    "sdo_shell": "the prompt of sdo",
    "analyse_shared": "options of the verbs of analyse, and what they print",
    "analyse_theory": "the verbs of analyse that need no rig",
    "analyse_rig": "the verbs of analyse on a rig",
}
"""The modules that are no verb, and what they hold."""


def module_of(verb):
    return f"coulombus.cli.{verb.replace('-', '_')}"


def test_each_verb_is_the_command_of_the_module_of_its_name():
    for name in VERBS:
        verb = main.commands[name]
        commands = [thing for thing in vars(import_module(module_of(name))).values() if thing is verb]
        assert isinstance(verb, click.Command)
        assert (verb.name, len(commands), verb.callback.__module__) == (name, 1, module_of(name))


def test_each_module_is_a_verb_or_has_a_reason():
    modules = {path.stem for path in CLI.glob("*.py")} - {"__init__"}
    assert not VERBS & set(SHARED)
    assert modules == {name.replace("-", "_") for name in VERBS} | set(SHARED)


def test_no_verb_imports_another():
    for name in VERBS:
        for node in ast.walk(ast.parse((CLI / f"{name.replace('-', '_')}.py").read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("coulombus.cli."):
                assert node.module.removeprefix("coulombus.cli.") in SHARED, f"{name}: {node.module}"
