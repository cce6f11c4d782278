"""Marker names and positions in; the side of each marker, and the pairs of markers that a picture joins by a line, out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from asterism.recording import Floats, MarkerSet, canonical, shipped_sets
from asterism.recording.marker_set import without_subject

_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_OTHER_SIDE = {"l": "r", "r": "l", "left": "right", "right": "left"}


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


def known_set(names: Sequence[str]) -> MarkerSet | None:
    """The smallest shipped marker set that has all these markers, for their pairs and segments."""
    wanted = {canonical(without_subject(name)) for name in names}
    return next((known for known in _shipped() if wanted <= {canonical(name) for name in known.names}), None)


@cache
def _shipped() -> tuple[MarkerSet, ...]:
    """The shipped sets, the smallest first."""
    return tuple(sorted(shipped_sets().values(), key=len))


def marker_sides(names: Sequence[str], marker_set: MarkerSet | None = None) -> list[str]:
    """For each marker "left", "right" or "middle".

    By the pairs of the marker set, or of a shipped one with these markers; other markers by their names: LKNE beside RKNE, L.Knee,
    KneeOut_L, left_heel.

    >>> marker_sides(["LKNE", "RKNE", "SACR", "left_heel"])
    ['left', 'right', 'middle', 'left']
    """
    # The set says which markers are pairs; names are only asked where it does not.
    known = marker_set if marker_set is not None and marker_set.pairs else known_set(names)
    side: dict[str, str] = {}
    for left, right in known.pairs if known is not None else ():
        side[canonical(left)], side[canonical(right)] = "left", "right"
    plain = [without_subject(name) for name in names]
    every = {canonical(name) for name in plain}
    return [
        side.get(canonical(name)) or side.get(canonical(bare)) or _side_of(bare, every) for name, bare in zip(names, plain, strict=True)
    ]


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


def _side_of(name: str, every: set[str]) -> str:
    """By a name's own words, or because the name with the other side's letter is a marker too; every: all names, canonical."""
    words = [word.casefold() for word in _WORDS.findall(name)]
    plain_name = canonical(name)
    for word in ("left", "right"):
        if word in words or plain_name.startswith(word):
            return word
    # A single letter counts only beside another word: a marker may be called L.
    alone = [word for word in (words[:1] + words[-1:]) if word in ("l", "r")]
    if alone and len(words) > 1:
        return "left" if alone[0] == "l" else "right"
    for at in [0, len(plain_name) - 1, *range(1, len(plain_name) - 1)] if plain_name else ():
        other = _OTHER_SIDE.get(plain_name[at])
        if other is not None and plain_name[:at] + other + plain_name[at + 1 :] in every:
            return "left" if plain_name[at] == "l" else "right"
    return "middle"
