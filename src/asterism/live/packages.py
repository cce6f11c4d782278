"""An import that may fail in; the package, or one sentence that says how to install it, out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from asterism.errors import AsterismError


@contextmanager
def packages_for(what: str, extra: str = "live") -> Iterator[None]:
    """Imports without which `what` (as in "osc://") cannot be stand inside. Raises AsterismError where one is missing or does not load."""
    try:
        yield
    except ModuleNotFoundError as problem:
        package = (problem.name or what).partition(".")[0]
        raise AsterismError(
            f'{what} needs {package}, which is not installed; install it with `pip install "asterism[{extra}]"`.'
        ) from problem
    # A package may bring a library for another system, or none.
    except (ImportError, OSError, RuntimeError) as problem:
        raise AsterismError(f"the package for {what} is installed but does not load ({problem}); install it anew.") from problem
