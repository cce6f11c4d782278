"""Parts of a training, kept by what goes in and by the sources: virtual people, a body that is learned, partial solvers, trials.

They are most of a training's time, and tests train some hundred models of the same people.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import Any

import pytest
from computed import computed

from asterism.labelling.training import learning, train, virtual

_PLAIN = {
    (learning, "_try_group"): learning._try_group,
    (learning, "fit_whole"): learning.fit_whole,
    (train, "fit_whole"): train.fit_whole,
    (train, "search_partial_solvers"): train.search_partial_solvers,
    (virtual, "_drawn"): virtual._drawn,
}


# Functions of a module, as those that they stand for are: so they go to other processes.
def _try_group(learned: Sequence[Any], stretches: Any, triples: Any, config: Any, few: bool, item: tuple[int, bool]) -> Any:
    plain = _PLAIN[learning, "_try_group"]
    with suppress(TypeError):  # recordings may hold what has no digest
        return computed(plain, [learned[item[0]]], stretches, triples, config, few, (0, item[1]))
    return plain(learned, stretches, triples, config, few, item)


def _fit_whole(*given: Any) -> Any:
    return computed(_PLAIN[learning, "fit_whole"], *given)


def _search_partial_solvers(*given: Any, progress: object = None, **settings: Any) -> Any:
    return computed(_PLAIN[train, "search_partial_solvers"], *given, **settings)


@lru_cache(maxsize=2)
def _drawn(worn_set: Any, people: int, seed: int) -> Any:
    return computed(_PLAIN[virtual, "_drawn"].__wrapped__, worn_set, people, seed)


@contextmanager
def parts_kept() -> Iterator[None]:
    """Trainings take what is kept."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name in _PLAIN:
            patch.setattr(module, name, globals()[name if name.startswith("_") else f"_{name}"])
        yield


@contextmanager
def parts_anew() -> Iterator[None]:
    """Trainings work out everything."""
    with pytest.MonkeyPatch.context() as patch:
        for (module, name), plain in _PLAIN.items():
            patch.setattr(module, name, plain)
        yield
