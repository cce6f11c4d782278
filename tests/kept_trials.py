"""The trials of a training, kept by what is tried and by the sources: half of a model's training, of which tests make some hundred."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from computed import computed

from asterism.labelling.training import learning

anew = learning._try_group


def try_group(learned: Sequence[Any], stretches: Any, triples: Any, config: Any, few: bool, item: tuple[int, bool]) -> Any:
    """What `learning._try_group` gives; a function of a module, so that it goes to other processes as that does."""
    with suppress(TypeError):  # recordings may hold what has no digest
        return computed(anew, [learned[item[0]]], stretches, triples, config, few, (0, item[1]))
    return anew(learned, stretches, triples, config, few, item)
