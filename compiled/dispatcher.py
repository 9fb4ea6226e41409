"""A kernel's two forms: its body, for the kernels that call it, and its entry, for Python.

Numba compiles each kernel as if Python called it: a wrapper that takes Python's objects, all its
callees optimised anew, machine code. Of 200 kernels of a run Python calls a dozen. So here a body is
typed and lowered to LLVM's intermediate code, once, and that is all; it refers to its callees by
name. An entry is a wrapper, linked with all bodies that it reaches, optimised as a whole, and
machine code. Both are kept on disk. A cold start takes 0.73 of the processor time that it took.

A body's symbol is made of the module, the name and the types, so one process can link what others
have lowered. Numba names a record by a number that counts the types of a process; here it is the
CRC-32 of what the record is (`_name_records`). What refers to its callees by name alone must find
them by that: a function that stands in another function is compiled in numba's way. So is everything with another numba than
those of `KNOWN`, because what is built on here is not its public interface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, TypeAlias
from zlib import crc32

import numba
from llvmlite import binding
from numba.core import compiler, event, types, typing
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.untyped_passes import ExtractByteCode

from coulombus.compiled.kernel_files import KernelCache

__all__ = ["KNOWN", "BodyCache", "KernelDispatcher", "fits"]

KNOWN = frozenset({(0, 68)})
"""Releases of numba with which this module is tested."""

Types: TypeAlias = tuple[Any, ...]
"""Numba's types of a call's arguments."""
Name: TypeAlias = tuple[str, str, Types]
"""Module, name and types of a body."""
Result: TypeAlias = Any  # numba's CompileResult

ENVIRONMENT = "_ZN08NumbaEnv"
"""How the names begin of the globals that hold a function's Python constants."""
ADDRESS = "numba.dynamic.globals"
"""How the names begin of those that hold an address of this process."""


def fits() -> bool:
    """Tell whether this numba is one that is known."""
    return tuple(numba.version_info.short) in KNOWN  # type: ignore[attr-defined,unused-ignore]


def _name_records() -> None:
    """Let a record have the same name in the symbols of each process."""

    def mangling_args(record: types.Record) -> tuple[str, tuple[int]]:
        return "Record", (crc32(repr(record).encode()),)

    setattr(types.Record, "mangling_args", property(mangling_args))  # noqa: B010  (numba's types say that it is a method)


if fits():
    _name_records()


_dispatchers: dict[tuple[str, str], KernelDispatcher] = {}
"""By module and name of their functions."""


class Body(JITCodeLibrary):  # type: ignore[misc]
    """The intermediate code of one kernel, with numba's helpers, without its callees."""

    def __init__(self, codegen: Any, name: Name) -> None:
        super().__init__(codegen, name[1])
        self.kernel = name
        self._named: list[Name] = []

    @classmethod
    def kept(cls, codegen: Any, name: Name, code: bytes, callees: list[Name]) -> Body:
        """Return a body as `parts` gave it."""
        body = cls(codegen, name)
        body._final_module, body._named, body._finalized = binding.parse_bitcode(code), callees, True
        return body

    def parts(self) -> tuple[Name, bytes, list[Name]]:
        """Return what `kept` takes."""
        self._ensure_finalized()
        return self.kernel, self._final_module.as_bitcode(), [callee.kernel for callee in self.callees()]

    def finalize(self) -> None:
        """Link the helpers; nothing is optimised as a whole, and no machine code is made."""
        for library in dict.fromkeys(self._linking_libraries):
            if not isinstance(library, Body):
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._final_module.verify()
        if any(value.name.startswith(ADDRESS) for value in self._final_module.global_variables):
            self._optimize_final_module()  # a tuple of kernels that a loop is unrolled over: nothing remains of it
        self._finalize_dynamic_globals()
        self._finalized = True

    def callees(self) -> list[Body]:
        """Return the bodies that this one calls."""
        for module, name, arguments in self._named:
            import_module(module)
            self._linking_libraries.append(_dispatchers[module, name].body(arguments).library)
        self._named = []
        return [library for library in dict.fromkeys(self._linking_libraries) if isinstance(library, Body)]

    def reached(self) -> Iterator[Body]:
        """Yield this body and all that it calls, directly or not, each once."""
        found, left = {self}, [self]
        while left:
            body = left.pop()
            yield body
            new = [callee for callee in body.callees() if callee not in found]
            found.update(new)
            left += new

    def whole(self) -> Any:
        """Return a module of this body and all that it reaches."""
        whole = binding.parse_assembly(str(self._codegen._create_empty_module(self.name)))
        for body in self.reached():
            body._ensure_finalized()
            whole.link_in(body._final_module, preserve=True)
        for value in whole.global_variables:
            if value.name.startswith(ENVIRONMENT) and not _constants(value.name):
                value.linkage = "internal"  # is removed; otherwise each entry would keep those of all its bodies
        return whole

    def _get_module_for_linking(self) -> Any:
        """Return that for what is compiled in numba's way: as often as it is linked."""
        whole = self.whole()
        for function in _strong(whole):
            function.linkage = "linkonce_odr"
        return whole


def _strong(module: Any) -> list[Any]:
    return [one for one in module.functions if not one.is_declaration and one.linkage == binding.Linkage.external]


def _constants(environment: str) -> list[Any]:
    """Return the Python objects that a function's code uses."""
    found = lookup_environment(environment)
    return [] if found is None else list(found.consts)


class Wrapped(JITCodeLibrary):  # type: ignore[misc]
    """The machine code of an entry. Nothing links it, so no intermediate code of it is kept."""

    def __init__(self, codegen: Any, body: Body) -> None:
        super().__init__(codegen, body.name)
        self._body = body
        self.enable_object_caching()

    def _optimize_final_module(self) -> None:
        """Optimise the wrapper and all bodies together.

        Only while its definition is the only one may LLVM infer what a function does not touch, so
        the bodies become private behind that.
        """
        wrappers = {function.name for function in _strong(self._final_module)}
        self._final_module.link_in(self._body.whole())
        super()._optimize_final_module()
        for function in _strong(self._final_module):
            if function.name not in wrappers:
                function.linkage = "internal"
        passes = binding.create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(self._final_module, self._codegen._pass_builder())

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Return the machine code, and a module that only says which symbols it defines."""
        self._ensure_finalized()
        defined = [function.name for function in self.get_defined_functions()]
        held = [value.name for value in self._final_module.global_variables if value.name.startswith(ENVIRONMENT)]
        lines = [f'define void @"{name}"() {{ ret void }}' for name in defined]
        lines += [f'@"{name}" = common global i8* null' for name in held]
        names = binding.parse_assembly("\n".join(lines)).as_bitcode()
        return self.name, "object", (self._get_compiled_object(), names)


class _Lowering(compiler.Compiler):  # type: ignore[misc]
    """Numba's compiler, up to the intermediate code of a body."""

    def compile_extra(self, function: Callable[..., Any]) -> Result:
        """Compile `function` under a name that is the same in each process."""
        state = self.state
        state.func_id = FunctionIdentity.from_function(function)
        state.func_id.unique_name = state.func_id.func_qualname
        state.func_id.unique_id = crc32(repr(state.args).encode())
        state.flags.no_compile = True
        state.flags.no_cpython_wrapper = True
        name = function.__module__, function.__qualname__, tuple(state.args)
        state.library = Body(state.targetctx.codegen(), name)
        ExtractByteCode().run_pass(state)
        state.lifted, state.lifted_from = (), None
        return self._compile_bytecode()


class _BodyCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    def reduce(self, result: Result) -> Any:
        description = result.fndesc
        description.typemap = description.calltypes = None
        return result.library.parts(), description, result.environment, result.signature

    def rebuild(self, target_context: Any, kept: Any) -> Result:
        parts, description, environment, signature = kept
        return compiler.CompileResult(
            **dict.fromkeys(compiler.CR_FIELDS)
            | {
                "target_context": target_context,
                "typing_context": target_context.typing_context,
                "library": Body.kept(target_context.codegen(), *parts),
                "fndesc": description,
                "environment": environment,
                "signature": signature,
                "objectmode": False,
                "lifted": (),
            }
        )


class BodyCache(FunctionCache):  # type: ignore[misc]
    """Keeps bodies as numba keeps compiled functions."""

    _impl_class = _BodyCacheImpl


def _variable(given: Any) -> Any:
    """Return the type of a variable that may hold a constant of the type `given`."""
    return given.dtype if isinstance(given, types.IntEnumMember) else types.unliteral(given)  # type: ignore[attr-defined]


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """What stands for a kernel in Python (numba's overloads: the entries) and in other kernels.

    Numba by itself compiles a function anew for each constant with which another kernel calls it,
    so a state or a length is one argument of many signatures; a fifth of all compilations were such
    copies.
    """

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None, pipeline_class: Any = None) -> None:
        super().__init__(py_func, locals, targetoptions, pipeline_class or _Lowering)
        _dispatchers[py_func.__module__, py_func.__qualname__] = self
        self.bodies: dict[Types, Result] = {}
        self.body_cache: NullCache | KernelCache = NullCache()

    def body(self, arguments: Types) -> Result:
        """Return the body for arguments of these types: lowered, or loaded, once."""
        with global_compiler_lock, self._compiling_counter:
            found = self.bodies.get(arguments)
            if found is not None:
                return found
            found = self.body_cache.load_overload(arguments, self.targetctx)
            if found is None:
                try:
                    with self._telling(arguments):
                        found = self._compiler.compile(arguments, None)
                    self.body_cache.save_overload(arguments, found)
                finally:
                    if isinstance(self.body_cache, KernelCache):
                        self.body_cache.release()
            found = found._replace(entry_point=object())  # by which numba knows it
            self.targetctx.insert_user_function(found.entry_point, found.fndesc, [found.library])
            self.bodies[arguments] = found
            return found

    def _telling(self, arguments: Types) -> Any:
        return event.trigger_event("numba:compile", {"dispatcher": self, "args": arguments, "return_type": None})

    def compile(self, sig: Any) -> Callable[..., Any]:
        """Return the entry for the types `sig`: compiled, or loaded, once."""
        arguments = tuple(normalize_signature(sig)[0])
        with global_compiler_lock, self._compiling_counter:
            found = self.overloads.get(arguments)
            if found is None:
                found = self._cache.load_overload(arguments, self.targetctx)
                (self._cache_misses if found is None else self._cache_hits)[arguments] += 1
                if found is None:
                    with self._telling(arguments):
                        found = self._wrapped(self.body(arguments))
                    self._cache.save_overload(arguments, found)
                self.add_overload(found)
            entry: Callable[..., Any] = found.entry_point
            return entry

    def _wrapped(self, body: Result) -> Result:
        context, description = self.targetctx, body.fndesc
        context.refresh()  # all bodies may have been loaded, and loading needs none
        library = Wrapped(context.codegen(), body.library)
        context.create_cpython_wrapper(library, description, body.environment, body.call_helper, release_gil=True)
        entry = context.get_executable(library, description, body.environment)
        return body._replace(library=library, entry_point=entry)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return what numba needs to type a call from a kernel."""
        given = tuple(map(_variable, args)), {name: _variable(kind) for name, kind in kws.items()}
        signature, folded = self._compiler.fold_argument_types(*given)
        self.body(tuple(folded))
        name = self.py_func.__name__
        signatures = [body.signature for body in self.bodies.values()]
        return typing.make_concrete_template(f"CallTemplate({name})", name, signatures), signature, folded, {}

    def get_overload(self, sig: Any) -> Any:
        """Return by what numba finds the body for a call from a kernel."""
        return self.bodies[tuple(normalize_signature(sig)[0])].entry_point
