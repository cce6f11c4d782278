"""The one kernel decorator: one policy of compiler flags, and a compile cache that knows the sources of all kernels that a kernel calls.

Policy of flags, the same for all kernels:

- `nogil`: kernels touch no Python object, so threads run them side by side.
- `error_model="numpy"`: a division by zero gives an infinity or NaN, as NumPy does, and NaN means missing. Kernels therefore test a divisor
  that can be zero. Numba's other model puts a branch that raises behind each division, which keeps loops from running in vector registers.
- no fast-math: the order of additions is the order of the source, and NaN and infinity keep their meaning. So a result does not depend on
  which kernel was inlined into which.
- `no_cfunc_wrapper`: nobody calls kernels from C; leaving the wrapper out saves a twentieth of the compiling.
- `inline=True` copies a kernel into each of its callers before these compile. It is for small kernels in the innermost loops, and for the
  steps of `label_clouds`, which have one caller each: copied into it, the whole compiles a twentieth quicker.

How kernels become machine code is in `linking.py`, what is kept of it in `compile_cache.py`.

Everything that depends on private parts of Numba is in this package. Where a release of Numba has changed them, its own way takes over.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, overload

import numba
from numba import njit

Function = Callable[..., Any]

_FLAGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


@overload
def kernel(function: Function, /) -> Function: ...


@overload
def kernel(*, inline: bool = False) -> Callable[[Function], Function]: ...


def kernel(function: Function | None = None, /, *, inline: bool = False) -> Any:
    """Compile a function with Numba when it is first called, by the policy of this file. Used bare, or as `@kernel(inline=True)`.

    With `NUMBA_DISABLE_JIT=1` the function stays plain Python.
    """

    def decorate(function: Function) -> Function:
        flags = _FLAGS | ({"inline": "always"} if inline else {})
        dispatcher: Any = njit(**flags)(function)
        if not numba.config.DISABLE_JIT:
            _keep_compiled(dispatcher, function, flags)
        return dispatcher

    return decorate if function is None else decorate(function)


def _keep_compiled(dispatcher: Any, function: Function, flags: dict[str, Any]) -> None:
    """Give a dispatcher the linking and the cache of this package, or Numba's where they do not work with the Numba that is installed."""
    try:
        from asterism._jit.compiling import CompiledKernel

        dispatcher._cache = CompiledKernel(dispatcher, function, flags)
    except (ImportError, AttributeError, TypeError):
        try:
            dispatcher.enable_caching()
        except RuntimeError:  # no folder can be written
            return
