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
    frames: int = 50


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
    # Each pair once, axis by axis: a fifth of the time that all coordinate differences at once take.
    one, other = np.triu_indices(len(names), 1)
    x, y, z = np.ascontiguousarray(positions[some].transpose(2, 0, 1))
    gaps = np.sqrt((x[:, one] - x[:, other]) ** 2 + (y[:, one] - y[:, other]) ** 2 + (z[:, one] - z[:, other]) ** 2)
    seen = np.isfinite(gaps)
    together = seen.sum(axis=0)
    number = np.maximum(together, 1)
    gaps[~seen] = 0.0
    mean = gaps.sum(axis=0) / number
    spread = np.sqrt(np.maximum((gaps**2).sum(axis=0) / number - mean**2, 0.0))
    # Bones keep their length; of those that do, the short ones are likelier.
    cost = np.zeros((len(names), len(names)))
    cost[one, other] = 1e-6 + spread + _RULES.by_length * mean
    index = {canonical(name): i for i, name in enumerate(names)}
    for members in known.segments.values() if known else ():
        segment = [index[canonical(name)] for name in members if canonical(name) in index]
        # Within a segment first: it is rigid by its definition.
        cost[np.ix_(segment, segment)] *= _RULES.segment
    # Two markers that are rarely seen together have no reliable distance.
    left_out = (together < max(3, len(some) // 10)) | (mean > _RULES.longest)
    cost[one[left_out], other[left_out]] = 0.0
    return [[int(a), int(b)] for a, b in zip(*minimum_spanning_tree(cost).nonzero(), strict=True)]
