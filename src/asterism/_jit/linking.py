"""How kernels compile: each is typed and lowered once, and optimised only as part of what Python calls.

Numba optimises every function by itself, together with copies of all that it calls, and makes machine code of it. So the innermost kernel
of six that call each other is optimised six times and translated six times, of which one is ever run. Here a kernel is kept as code that
others can link (`LinkedLibrary`): each function simplified by itself, without machine code and without the wrapper through which Python
calls it. Only when Python calls a kernel, its wrapper and all that it reaches become one program that is optimised as a whole and
translated (`ProgramLibrary`).

The order of floating-point operations is that of the source either way, so results stay the same bit for bit.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import llvmlite.binding as llvm
from numba import _dynfunc, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult, compile_result
from numba.core.environment import lookup_environment
from numba.core.typing import Signature

_ENVIRONMENT = "_ZN08NumbaEnv"
"""How Numba's names of variables begin that point to the globals of a function."""


class LinkedLibrary(JITCodeLibrary):
    """A kernel's code with all that it calls, for other kernels to link."""

    def finalize(self) -> None:
        """Link what the kernel calls, and leave it at that."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """There is no machine code."""
        self._ensure_finalized()
        return self.name, "bitcode", self._get_module_for_linking().as_bitcode()

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, bytes]) -> LinkedLibrary:
        name, _, bitcode = state
        library = cls(codegen, name)
        library._final_module = llvm.parse_bitcode(bitcode)
        library._finalize_dynamic_globals()
        library._finalized = True
        return library


class ProgramLibrary(JITCodeLibrary):
    """A kernel's wrapper and all that it reaches, as machine code."""

    entry = ""
    """The name of the wrapper."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        # Nobody else calls what is in here: each function may be changed for its callers, and goes where all of them took it in.
        for function in self._final_module.functions:
            if not function.is_declaration and function.name != self.entry:
                function.linkage = "internal"
        super()._optimize_final_module()


def program_of(context: Any, linked: CompileResult) -> tuple[ProgramLibrary, Any]:
    """The program of a kernel, and the function that Python calls."""
    library = ProgramLibrary(context.codegen(), linked.library.name)
    library.entry = linked.fndesc.llvm_cpython_wrapper_name
    library.enable_object_caching()
    library.add_linking_library(linked.library)
    # Arrays that Python gets are counted; a context as such counts none.
    wrapping = context.subtarget(enable_nrt=True)
    wrapping.create_cpython_wrapper(library, linked.fndesc, linked.environment, linked.call_helper, release_gil=True)
    function = context.get_executable(library, linked.fndesc, linked.environment)
    for environment in _environments(library):
        library.codegen.set_env(environment.env_name, environment)
    return library, function


def packed(library: ProgramLibrary, linked: CompileResult) -> tuple[Any, ...]:
    """What `unpacked` needs to have a kernel's program again in another process."""
    # They are large, and only a compiler asks for them.
    linked.fndesc.typemap = linked.fndesc.calltypes = None
    # The globals of functions that Numba makes while it runs are nowhere to be found in another process; Numba leaves them out, too.
    environments = [environment for environment in _environments(library) if environment.can_cache()]
    own = linked.environment
    return library.name, library._get_compiled_object(), linked.fndesc, own, list(own.consts), linked.signature, environments


def unpacked(context: Any, state: tuple[Any, ...]) -> CompileResult:
    """A kernel's program from what `packed` gave; its entry point is the function that Python calls."""
    name, machine_code, fndesc, own, constants, signature, environments = state
    # Another program may have brought the kernel's globals along, without the constants that its wrapper has added.
    if len(own.consts) < len(constants):
        own.consts[:] = constants
    library = ProgramLibrary(context.codegen(), name)
    library.enable_object_caching()
    library._set_compiled_object(machine_code)
    library._finalize_final_module()
    names = {fndesc.llvm_cpython_wrapper_name, *(environment.env_name for environment in environments)}
    context.codegen()._engine._defined_symbols.update(names)
    function = context.get_executable(library, fndesc, own)
    for environment in environments:
        context.codegen().set_env(environment.env_name, environment)
    return compile_result(
        target_context=context,
        typing_context=context.typing_context,
        library=library,
        environment=own,
        entry_point=function,
        fndesc=fndesc,
        signature=signature,
        objectmode=False,
        lifted=(),
        call_helper=None,
        reload_init=[],
        referenced_envs=environments,
    )


def _environments(library: ProgramLibrary) -> list[Any]:
    """The globals of all functions of a program that ask for them."""
    variables = [variable.name for variable in library._final_module.global_variables]
    found = [lookup_environment(name) for name in variables if name.startswith(_ENVIRONMENT)]
    return [environment for environment in found if environment is not None]


@ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
def _no_program(_function: int | None, _arguments: int | None, _keywords: int | None) -> None:
    raise RuntimeError("this kernel was compiled for other kernels only")


_NO_PROGRAM = ctypes.cast(_no_program, ctypes.c_void_p).value


@contextmanager
def linking_only(context: Any) -> Iterator[None]:
    """While this holds, Numba compiles functions so that others can link them. To be entered with Numba's lock only."""
    codegen = context.codegen()

    def placeholder(library: Any, fndesc: Any, environment: Any) -> Any:
        # Numba tells one compiled function from another by this object.
        name = fndesc.qualname.rpartition(".")[2]
        return _dynfunc.make_function(fndesc.lookup_module(), name, "linked", _NO_PROGRAM, environment, (library,))

    changes: list[tuple[Any, str, Any]] = [
        (codegen, "_library_class", LinkedLibrary),
        (codegen, "set_env", lambda name, environment: None),
        (context, "get_executable", placeholder),
        (context, "create_cpython_wrapper", lambda *_, **__: None),
        (types.BaseFunction, "get_call_type", _remembered_call_type),
    ]
    before = [vars(where).get(name) for where, name, _ in changes]
    for where, name, value in changes:
        setattr(where, name, value)
    try:
        yield
    finally:
        for (where, name, _), value in zip(changes, before, strict=True):
            if value is None:
                delattr(where, name)
            else:
                setattr(where, name, value)


_call_types: dict[Any, tuple[Signature, Any, Any]] = {}
_plain_call_type: Callable[..., Signature] = types.BaseFunction.get_call_type


def _remembered_call_type(function: Any, context: Any, arguments: Any, keywords: Any) -> Signature:
    """The signature with which a function that Numba knows is called; Numba looks through all its forms each time.

    All kernels compile by the same flags, on which the forms depend.
    """
    key = id(function), context, tuple(arguments), tuple(keywords.items())
    known = _call_types.get(key)
    if known is None:
        signature = _plain_call_type(function, context, arguments, keywords)
        # The function itself is kept, so that no other one gets its id.
        _call_types[key] = signature, function._impl_keys[signature.args], function
        return signature
    signature, form, _ = known
    function._impl_keys[signature.args] = form
    return signature
