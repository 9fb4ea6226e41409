"""Mutants of a module: each is one small edit of its syntax tree, such as an `abs` dropped or a
comparison turned.

A mutant is applied in memory only. Its line numbers are the module's own, and nothing on the disk
is touched.
"""

from __future__ import annotations

import ast
import copy
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
from typing import Any

__all__ = ["Mutant", "Source"]

COMPARISONS: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
"""The bound taken in or left out, and the condition turned into its contrary."""

ARITHMETIC: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}

FUNCTION_OR_CLASS = ast.FunctionDef | ast.ClassDef
DROPPED_CALLS = ("abs", "round")
CLAMPS = {"min": "max", "max": "min"}
LARGE = 100.0
"""A real beyond this is changed by a tenth: one more or less of 1e9 is no change."""


@dataclass
class Mutant:
    """One edit: `new` in place of what stands in `field` of `parent` (at `index`, where that is a
    list).
    """

    unit: str  # the function or method, "" for the module's constants
    line: int
    lines: range  # of the statement, for the coverage
    text: str  # the line as it stands
    operator: str
    change: str
    short: str  # the change of the node alone, which may stand in the line twice
    parent: ast.AST
    field: str
    index: int | None
    new: ast.AST

    def apply(self) -> None:
        """Edit the tree, for good."""
        if self.index is None:
            setattr(self.parent, self.field, self.new)
        else:
            getattr(self.parent, self.field)[self.index] = self.new

    def undone(self) -> Callable[[], None]:
        """Edit the tree; return what takes the edit back."""
        old = getattr(self.parent, self.field)
        old = old if self.index is None else old[self.index]
        self.apply()
        undo = Mutant(**{**self.__dict__, "new": old})
        return undo.apply


def _constants(node: ast.Constant, parent: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    value = node.value
    if isinstance(value, bool):
        yield "constant", ast.Constant(not value)
    elif isinstance(value, int | float) and value in (0, 1) and _stands_alone(parent):
        yield "constant", ast.Constant(type(value)(1 - value))
    elif isinstance(value, int):
        yield "constant", ast.Constant(value + 1)
        yield "constant", ast.Constant(value - 1)
    elif isinstance(value, float):
        large = abs(value) > LARGE
        yield "constant", ast.Constant(value * 1.1 if large else value + 1.0)
        yield "constant", ast.Constant(value / 1.1 if large else value - 1.0)
    if isinstance(value, int | float) and not isinstance(value, bool) and value and not _stands_alone(parent):
        yield "sign", ast.Constant(-value)


def _stands_alone(parent: ast.AST) -> bool:
    """Whether 0 and 1 are flags here, of which there is no third: assigned, returned, or asked for
    by == and !=.
    """
    if isinstance(parent, ast.Compare):
        return all(isinstance(op, ast.Eq | ast.NotEq) for op in parent.ops)
    return isinstance(parent, ast.Assign | ast.Return | ast.IfExp)


def _calls(node: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name in DROPPED_CALLS:
        yield f"{name} dropped", node.args[0]
    elif name in CLAMPS:
        yield "min/max", ast.Call(ast.Name(CLAMPS[name], ast.Load()), node.args, node.keywords)
        if len(node.args) > 1:
            for argument in node.args:
                yield "clamp dropped", argument


def _expressions(node: ast.AST, parent: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield (operator, expression in its place)."""
    if isinstance(node, ast.Constant):
        yield from _constants(node, parent)
    elif isinstance(node, ast.Call):
        yield from _calls(node)
    elif isinstance(node, ast.UnaryOp):
        yield {ast.USub: "minus dropped", ast.Not: "not dropped"}.get(type(node.op), "unary dropped"), node.operand
    elif isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        yield "arithmetic", ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
    elif isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            for other in COMPARISONS[type(op)]:
                ops = [*node.ops[:k], other(), *node.ops[k + 1 :]]
                yield "comparison", ast.Compare(node.left, ops, node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield "and/or", ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        for k in range(len(node.values)):
            rest = [*node.values[:k], *node.values[k + 1 :]]
            yield "condition dropped", rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
    if isinstance(node, ast.IfExp):
        yield "branches", ast.IfExp(node.test, node.orelse, node.body)


def _statements(node: ast.AST) -> Iterator[tuple[str, ast.stmt]]:
    """Yield (operator, statement in its place)."""
    if isinstance(node, ast.Assign | ast.AugAssign | ast.Return | ast.Break | ast.Continue) or (
        isinstance(node, ast.Expr) and not isinstance(node.value, ast.Constant)
    ):
        yield "statement deleted", ast.Pass()
    if isinstance(node, ast.AugAssign) and type(node.op) in ARITHMETIC:
        yield "arithmetic", ast.AugAssign(node.target, ARITHMETIC[type(node.op)](), node.value)


def _tests(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield (operator, condition in its place) of an if or a while."""
    if isinstance(node, ast.If | ast.While):
        if isinstance(node, ast.If):
            yield "condition forced", ast.Constant(True)
            if not isinstance(node.test, ast.Compare | ast.UnaryOp):  # those are turned anyway
                yield "condition negated", ast.UnaryOp(ast.Not(), node.test)
        yield "condition forced", ast.Constant(False)


class Source:
    """A module's source, its units (functions, methods, the module's constants) and their mutants.

    Parameters
    ----------
    path, text
        the file as it is called in messages, and its content
    units
        the functions and methods that are mutated; empty: all, and the module's constants
    """

    def __init__(self, path: str, text: str, units: tuple[str, ...] = ()) -> None:
        self.path = path
        self.lines = text.splitlines()
        self.tree = ast.parse(text, path)
        self.units = units
        self._unit = ""
        self._statement = range(0)

    @property
    def lacking(self) -> list[str]:
        """The units that the module does not have."""
        unit_names = {node.name for node in self.tree.body if isinstance(node, ast.FunctionDef)}
        for node in self.tree.body:
            if isinstance(node, ast.ClassDef):
                unit_names |= {f"{node.name}.{one.name}" for one in node.body if isinstance(one, ast.FunctionDef)}
        return [unit for unit in self.units if unit not in unit_names]

    def mutants(self) -> list[Mutant]:
        """Return every mutant that differs from the module and from the ones before it, in the
        order of the lines.
        """
        distinct, seen = [], {"": {self._code("")}}
        for mutant in self._walk_module():
            if mutant.unit not in seen:
                seen[mutant.unit] = {self._code(mutant.unit)}
            code = self._code_of(mutant)
            if code is not None and code not in seen[mutant.unit]:
                seen[mutant.unit].add(code)
                distinct.append(mutant)
        return distinct

    def edits(self) -> list[Mutant]:
        """Return every edit in the order of the lines, without a look at the code that comes of it."""
        return list(self._walk_module())

    def changes(self, edit: Mutant) -> bool:
        """Whether an edit gives code, and another one."""
        return self._code_of(edit) not in (None, self._code(edit.unit))

    def _code_of(self, mutant: Mutant) -> Any:
        undo = mutant.undone()
        try:
            return self._code(mutant.unit)
        except SyntaxError:  # a deleted binding of a nonlocal name, a starred argument alone
            return None
        finally:
            undo()

    def _code(self, unit: str) -> Any:
        if not unit:
            return _signature(self.compiled()), ast.dump(self._constants_only())
        head = unit.partition(".")[0]
        own = [node for node in self.tree.body if isinstance(node, FUNCTION_OR_CLASS) and node.name == head]
        return _signature(find_code(compile(ast.Module(own, []), self.path, "exec"), unit))

    def _constants_only(self) -> ast.Module:
        return ast.Module([node for node in self.tree.body if isinstance(node, ast.Assign)], [])

    def compiled(self) -> CodeType:
        """Return the module's code as the tree is now."""
        return compile(self.tree, self.path, "exec")

    def _walk_module(self) -> Iterator[Mutant]:
        for node in self.tree.body:
            if isinstance(node, ast.FunctionDef):
                yield from self._walk_function(node, node.name)
            elif isinstance(node, ast.ClassDef):
                for method in node.body:
                    if isinstance(method, ast.FunctionDef):
                        yield from self._walk_function(method, f"{node.name}.{method.name}")
            elif isinstance(node, ast.Assign) and not self.units and ast.unparse(node.targets[0]) != "__all__":
                self._unit = ""
                yield from self._walk_statement(node)

    def _walk_function(self, node: ast.FunctionDef, name: str) -> Iterator[Mutant]:
        if self.units and name not in self.units:
            return
        self._unit = name
        for k, statement in enumerate(node.body):
            yield from self._statement_mutants(node, "body", k, statement)

    def _statement_mutants(self, parent: ast.AST, field: str, k: int, node: ast.stmt) -> Iterator[Mutant]:
        self._statement = _own_lines(node)
        for operator, new in _statements(node):
            yield self._mutant(parent, field, k, node, operator, new)
        yield from self._walk_statement(node)

    def _walk_statement(self, node: ast.stmt) -> Iterator[Mutant]:
        self._statement = _own_lines(node)
        for operator, new in _tests(node):
            yield self._mutant(node, "test", None, node.test, operator, new)  # type: ignore[attr-defined]
        yield from self._walk_expressions(node)
        for field in ("body", "orelse", "finalbody"):
            for k, statement in enumerate(getattr(node, field, [])):
                yield from self._statement_mutants(node, field, k, statement)

    def _walk_expressions(self, node: ast.AST) -> Iterator[Mutant]:
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "func"):
                continue
            for k, child in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(child, ast.expr | ast.keyword):
                    continue
                index = k if isinstance(value, list) else None
                for operator, new in _expressions(child, node):
                    yield self._mutant(node, field, index, child, operator, new)
                yield from self._walk_expressions(child)

    def _mutant(
        self, parent: ast.AST, field: str, index: int | None, old: ast.AST, operator: str, new: ast.AST
    ) -> Mutant:
        new = ast.fix_missing_locations(ast.copy_location(copy.copy(new), old))
        line = getattr(old, "lineno", self._statement.start)
        after = "deleted" if isinstance(new, ast.Pass) else ast.unparse(new)
        text = self.lines[line - 1].strip()
        short = change = f"{ast.unparse(old)} -> {after}"
        mutant = Mutant(self._unit, line, self._statement, text, operator, change, short, parent, field, index, new)
        if isinstance(old, ast.Constant):  # a number alone says little
            undo = mutant.undone()
            after = ast.unparse(parent)
            undo()
            mutant.change = f"{ast.unparse(parent)} -> {after}"
        return mutant

    def install(self, module: ModuleType, unit: str) -> None:
        """Let the loaded `module` run the tree as it is now: its function's code is exchanged where
        it stands.
        """
        code = self.compiled()
        if unit:
            function: Any = module
            for name in unit.split("."):
                function = vars(function)[name]
            while not isinstance(function, FunctionType) or hasattr(function, "__wrapped__"):
                inner = (
                    getattr(function, name, None) for name in ("fget", "callback", "func", "py_func", "__wrapped__")
                )
                function = next(filter(None, inner))
            exchanged = find_code(code, unit)
            if function.__code__.co_freevars and not exchanged.co_freevars:  # `super()` was its only use of the class
                for node in ast.walk(self.tree):
                    if isinstance(node, ast.FunctionDef) and node.name == function.__name__:
                        node.body += ast.parse("if 0: __class__").body
                exchanged = find_code(self.compiled(), unit)
            function.__code__ = exchanged
            return
        before = dict(vars(module))
        fresh: dict[str, Any] = {"__name__": module.__name__, "__file__": module.__file__, "__package__": None}
        exec(code, fresh)
        for node in self._constants_only().body:
            for name in (n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)):
                _replace(name, before[name], fresh[name], module)


def _replace(name: str, old: Any, new: Any, module: ModuleType) -> None:
    """Set a constant in its module, and in those that have taken it from there."""
    for other in [module, *sys.modules.values()]:
        if other is module or (not name.startswith("_") and getattr(other, "__dict__", {}).get(name, other) is old):
            setattr(other, name, new)


def _own_lines(node: ast.stmt) -> range:
    """Return the lines of a statement without those of its body."""
    body = getattr(node, "body", None)
    end = body[0].lineno - 1 if body else node.end_lineno
    return range(node.lineno, max(end or node.lineno, node.lineno) + 1)


def find_code(code: CodeType, unit: str) -> CodeType:
    """Return the code of the function or method `unit` in a module's code."""
    if not unit:
        return code
    head, _, rest = unit.partition(".")
    for constant in code.co_consts:
        if isinstance(constant, CodeType) and constant.co_name == head:
            return find_code(constant, rest)
    raise LookupError(unit)


def _signature(code: CodeType) -> Any:
    """Return what tells two functions apart, without line numbers."""
    constants = tuple(_signature(c) if isinstance(c, CodeType) else (type(c), repr(c)) for c in code.co_consts)
    return code.co_code, constants, code.co_names, code.co_varnames
