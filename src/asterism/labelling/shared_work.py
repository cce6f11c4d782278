"""A function and items in; what it gives for each, from wherever the caller has the work done, out."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]
"""Calls a picklable function for each of some items, and gives the values in the order of the items."""

_EACH: ContextVar[Each | None] = ContextVar("each", default=None)


@contextmanager
def shared_by(each: Each | None) -> Iterator[None]:
    """While this holds, training and evaluating have their parts done by `each`, such as `session.each_of`. What they give is the same."""
    before = _EACH.set(each)
    try:
        yield
    finally:
        _EACH.reset(before)


def each_shared(function: Callable[[Any], Any], items: Sequence[Any], otherwise: Each) -> Iterable[Any]:
    """What a function gives for each item, in their order; by `otherwise` where nobody shares the work."""
    return (_EACH.get() or otherwise)(function, items)


def is_shared() -> bool:
    """Whether somebody else does the work, who tells nothing of how far a part of it is."""
    return _EACH.get() is not None


def in_threads(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """What a function gives for each item, in their order, from threads: kernels release the lock of the interpreter."""
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            yield from pool.map(function, items)
        # also at Ctrl-C: the tasks that have not begun must not keep the process alive
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
