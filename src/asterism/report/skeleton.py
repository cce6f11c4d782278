"""Marker names and positions in; the pairs of markers that a picture joins by a line, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from asterism.recording import Floats, MarkerSet, canonical
from asterism.recording.sides import known_set


@dataclass(frozen=True)
class BoneRules:
    """Which markers a line joins. Chosen by looking at the gait and movement recordings.

    longest   m, the longest line
    by_length weight of a line's mean length, m, against how much it changes, m
    segment   factor on the cost of a line within one segment of the marker set
    frames    frames that are compared, at most
    """

    longest: float = 0.65
    by_length: float = 0.15
    segment: float = 0.01
    frames: int = 200


_RULES = BoneRules()


def marker_bones(positions: Floats, names: Sequence[str], marker_set: MarkerSet | None = None) -> list[list[int]]:
    """Pairs of markers to join by a line: those of one segment first, then pairs with a short distance that changes little.

    positions  (T, M, 3) m, NaN where a marker is not seen
    """
    known = marker_set if marker_set is not None and marker_set.segments else known_set(names) or marker_set
    some = np.nonzero(np.isfinite(positions[:, :, 0]).any(axis=1))[0]
    # Distances settle in a sample of frames.
    some = some[:: max(1, len(some) // _RULES.frames)]
    if not len(some):
        return []
    gaps = np.linalg.norm(positions[some][:, :, None] - positions[some][:, None], axis=3)
    seen = np.isfinite(gaps)
    # Two markers that are rarely seen together have no reliable distance.
    frequent = seen.sum(axis=0) >= max(3, len(some) // 10)
    number = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, gaps, 0.0).sum(axis=0) / number
    spread = np.sqrt(np.where(seen, (gaps - mean) ** 2, 0.0).sum(axis=0) / number)
    # Bones keep their length; of those that do, the short ones are likelier.
    cost = 1e-6 + spread + _RULES.by_length * mean
    index = {canonical(name): i for i, name in enumerate(names)}
    for members in known.segments.values() if known else ():
        segment = [index[canonical(name)] for name in members if canonical(name) in index]
        # Within a segment first: it is rigid by its definition.
        cost[np.ix_(segment, segment)] *= _RULES.segment
    cost[~frequent | (mean > _RULES.longest)] = 0.0
    np.fill_diagonal(cost, 0.0)
    return [[int(a), int(b)] for a, b in zip(*minimum_spanning_tree(np.triu(cost)).nonzero(), strict=True)]
