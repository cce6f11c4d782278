"""A body in; which of its left and right parts a fit may have exchanged, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Ints
from asterism.skeleton.body import ArticulatedBody


@dataclass(frozen=True, eq=False)
class Exchange:
    """Parts of a body whose left and right markers take each other's names.

    names   (M + 1,) the new label of each label, that of -1 first
    hinges  (H,) the hinges of the bones that carry these markers, by their numbers in the body
    """

    names: Ints
    hinges: Ints


def exchanges_of(body: ArticulatedBody) -> tuple[Exchange, ...]:
    """Each bone with markers of both sides, and each bone with all that hangs on it, once. O(bones^2 + bones pairs)."""
    arrays, number = body.arrays, {name: m for m, name in enumerate(body.labels)}
    pairs = [(number[left], number[right]) for left, right in body.marker_set.pairs]
    groups = dict[tuple[tuple[int, int], ...], None]()
    for first in range(len(arrays.parents)):
        # Bones come in the order of parent before child, so one pass finds all below the first.
        below = {first}
        below.update(b for b in range(first, len(arrays.parents)) if _is_below(arrays.parents, b, first))
        for bones in (below, {first}):
            # A leg that takes the other's place does so from the hip, the knee or the ankle down, or one bone alone does.
            group = tuple(pair for pair in pairs if int(arrays.bones[pair[0]]) in bones)
            if group:
                groups.setdefault(group)
    return tuple(_exchange(body, group) for group in groups)


def _is_below(parents: Ints, bone: int, above: int) -> bool:
    while bone > above:
        # A parent has a smaller number than its child, so the climb ends at `above` or passes it.
        bone = int(parents[bone])
    return bone == above


def _exchange(body: ArticulatedBody, group: tuple[tuple[int, int], ...]) -> Exchange:
    arrays, names = body.arrays, np.arange(-1, len(body.markers))
    for left, right in group:
        names[left + 1], names[right + 1] = right, left
    bones = sorted({int(arrays.bones[m]) for pair in group for m in pair})
    hinges = [np.arange(arrays.hinge_starts[b], arrays.hinge_starts[b + 1]) for b in bones]
    return Exchange(names, np.concatenate(hinges).astype(np.int64))
