"""What compiles, links and keeps one kernel."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba import types
from numba.core.compiler import CompileResult, Flags
from numba.core.compiler_lock import global_compiler_lock
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

from asterism._jit.compile_cache import KernelFiles
from asterism._jit.linking import linking_only, packed, program_of, unpacked


class CompiledKernel:
    """What compiles, links and keeps one kernel: it takes the place of the dispatcher's own methods."""

    def __init__(self, dispatcher: Any, function: Callable[..., Any], flags: dict[str, Any]) -> None:
        self.dispatcher, self.files = dispatcher, KernelFiles(function, flags)
        self.linked: dict[Any, Any] = {}
        """What other kernels link, by argument types."""
        self.programs: dict[Any, Any] = {}
        """The functions that Python calls, by argument types."""
        self._compile, self._resolve = dispatcher.compile, dispatcher.get_call_template
        dispatcher.compile, dispatcher.get_call_template = self.compile, self.resolve
        customize = dispatcher._compiler._customize_flags
        dispatcher._compiler._customize_flags = lambda flags: _KernelFlags(customize(flags))
        # Numba would let Python call what is there for linking.
        dispatcher.add_overload = self._add_linked

    @property
    def context(self) -> Any:
        return self.dispatcher.targetctx

    def resolve(self, args: Any, kws: Any) -> Any:
        """The types with which another kernel calls this one, compiled for it; called by Numba.

        A kernel that is called with a constant compiles for the constant's type. Numba compiles it for each constant anew.
        """
        _calls.depth = getattr(_calls, "depth", 0) + 1
        try:
            return self._resolve(tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()})
        finally:
            _calls.depth -= 1

    def compile(self, sig: Any) -> Any:
        """Compile for argument types; called by Numba. Returns the function that Python calls, or a placeholder where a kernel calls."""
        inside = getattr(_calls, "depth", 0) > 0
        done = self.linked if inside else self.programs
        if not isinstance(sig, tuple):
            sig = normalize_signature(sig)[0]
        if sig not in done:
            # Numba's lock comes first: a thread that has it may wait for a kernel, and never one that has a kernel for it.
            with global_compiler_lock, _collector_paused():
                if sig not in done:
                    self.context.refresh()
                    self._link(sig) if inside else self._build(sig)
        return self.linked[sig].entry_point if inside else done[sig]

    def _link(self, sig: Any) -> None:
        codegen = self.context.codegen()
        known = self.dispatcher.overloads.pop(sig, None)
        try:
            with self.files.turn("link", sig, codegen), linking_only(self.context):
                self._compile(sig)
        except BaseException:
            if known is not None:
                self.dispatcher.overloads[sig] = known
            raise

    def _add_linked(self, compiled: Any) -> None:
        args = tuple(compiled.signature.args)
        self.linked[args] = self.dispatcher.overloads[args] = compiled

    def _build(self, sig: Any) -> None:
        codegen = self.context.codegen()
        with self.files.turn("run", sig, codegen):
            state = self.files.read("run", sig, codegen)
            if state is not None:
                compiled = unpacked(self.context, state)
                self.dispatcher._cache_hits[sig] += 1
                self.dispatcher.overloads.setdefault(sig, compiled)
                function = compiled.entry_point
            else:
                if sig not in self.linked:
                    self._link(sig)
                library, function = program_of(self.context, self.linked[sig])
                if not library.has_dynamic_globals:
                    self.files.write("run", sig, codegen, lambda: dumps(packed(library, self.linked[sig])))
        self.dispatcher._insert([kind._code for kind in sig], function, False)
        self.programs[sig] = function

    # What Numba asks of a dispatcher's cache, here for what is linked.

    @property
    def cache_path(self) -> str:
        return self.files.path

    def load_overload(self, sig: Any, context: Any) -> Any:
        state = self.files.read("link", sig, context.codegen())
        if state is None:
            return None
        return CompileResult._rebuild(context, *state)

    def save_overload(self, sig: Any, compiled: Any) -> None:
        # What depends on values outside the source cannot be told apart by it.
        if all(lifted.can_cache for lifted in compiled.lifted) and not compiled.library.has_dynamic_globals:
            self.files.write("link", sig, compiled.codegen, lambda: dumps(compiled._reduce()))

    def enable(self) -> None: ...

    def disable(self) -> None: ...

    def flush(self) -> None: ...


_calls = threading.local()
"""How many kernels deep the calls are that this thread finds the types of."""


class _KernelFlags(Flags):
    """Numba looks up each call that it types by the compiler's flags, among others, and compares all fifty of them each time.

    They are the same object, or were set alike; only where neither holds does Numba's own comparison decide.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        alike = self is other or (type(other) is _KernelFlags and self._values == other._values)
        return alike or bool(super().__eq__(other))

    def __hash__(self) -> int:
        return hash(_KernelFlags)


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Collect no garbage.

    A compile makes a million objects that live as long as it does. Looking through them again and again takes a sixth of its time. What
    Numba knows of kernels lives until the process ends, so the collector is never shown it: one look at all takes seconds in a command.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
