"""Features of points (thesis table 4.1) and of their motion (6.1, 6.2): the registry, and the pool of all over all subsets of a marker set.

One more feature is one more branch in `feature_kernels.later_feature` and one more line at the end of `FEATURES` here, with a
constant G20 beside the others; the pool, the training, the search and the files that models are saved in take it from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints

PAIR = ((0, 1),)
TRIPLE = ((0, 1, 2),)
APEX = ((0, 1, 2), (1, 0, 2), (2, 0, 1))
TWO_PAIRS = ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2))

MANY_MARKERS = 20
"""With more markers, features of four points are sampled instead of listed. Chosen by hand: the pool grows with their fourth power."""

SAMPLED = 20_000
"""Four-point features of one kind that a sampled pool holds. Not tuned."""


@dataclass(frozen=True)
class Feature:
    """One geometric property of a few points.

    name          as in the thesis ("g2"); the place in `FEATURES` is the kernel's `kind`
    title         what it is
    points        how many points it takes
    arrangements  the orders of a subset's points that give different classifiers: swapping the ends of a distance, or negating a
                  difference, moves the interval but not what it accepts, so such orders are left out
    unit          of its values
    source        where it comes from
    moving        whether it reads the points' motion (`motion_points.motion_of_points`); where that is not known, every interval accepts
    """

    name: str
    title: str
    points: int
    arrangements: tuple[tuple[int, ...], ...]
    unit: str
    source: str
    moving: bool = False


_SIGNED = "thesis tables 4.1 and 5.1; signed: the bars printed in 4.1 would lose the sign, by which a body differs from its mirror image"
_NOT_NORMED = "ours: g9 times twice the triangle's area, so that size counts, and points that coincide have a value"
_NEIGHBOURS, _DERIVATIVES = "thesis eq. 6.1, over the frames 0.2 s before and after", "thesis eq. 6.2"

FEATURES: tuple[Feature, ...] = (
    Feature("g1", "angle at a point between two others", 3, APEX, "rad", "thesis table 4.1"),
    Feature("g2", "distance", 2, PAIR, "m", "thesis table 4.1"),
    Feature("g3", "difference of two lengths over their mean", 4, TWO_PAIRS, "1", "thesis table 4.1"),
    Feature("g4", "height difference", 2, PAIR, "m", "thesis table 4.1, along the recording's vertical instead of y"),
    Feature("g5", "ratio of two lengths from one point", 3, APEX, "1", "thesis table 4.1"),
    Feature("g6", "angle between two segments", 4, TWO_PAIRS, "rad", "thesis table 4.1"),
    Feature("g7", "angle between a segment and the vertical", 2, PAIR, "rad", "thesis table 4.1"),
    Feature("g8", "triangle area", 3, TRIPLE, "m2", "thesis table 4.1"),
    Feature("g19", "vertical part of the cross product of two sides of a triangle", 3, TRIPLE, "m2", _NOT_NORMED),
    Feature("g10", "relative speed", 2, PAIR, "m/s", _DERIVATIVES, True),
    Feature("g11", "rate at which a distance changes, without sign", 2, PAIR, "m/s", _DERIVATIVES, True),
    Feature("g12", "half the second rate of change of a squared distance", 2, PAIR, "m2/s2", _DERIVATIVES, True),
    Feature("g13", "mean distance over three frames", 2, PAIR, "m", _NEIGHBOURS, True),
    Feature("g14", "mean height difference over three frames", 2, PAIR, "m", _NEIGHBOURS, True),
    Feature("g15", "range of a distance over three frames", 2, PAIR, "m", _NEIGHBOURS, True),
    Feature("g16", "range of a height difference over three frames", 2, PAIR, "m", _NEIGHBOURS, True),
    Feature("g17", "mean distance between one point before and the other after", 2, PAIR, "m", _NEIGHBOURS, True),
    Feature("g18", "mean of g19 over three frames", 3, TRIPLE, "m2", _NEIGHBOURS, True),
    Feature("g9", "vertical part of the unit normal of a triangle", 3, TRIPLE, "1", _SIGNED),
)
"""The registry; its order is that of the constants in `feature_kernels` and `motion_kernels`, and model files keep features
by their place. g19 has the place that g9 had in earlier models, which computed g19 under that name.

None of them changes when the recording is turned about the vertical or shifted, nor when it is played backwards.
"""

THESIS = ("g2", "g4", "g9")
"""The features of the thesis' experiment (section 5.2)."""

TEMPORAL = tuple(feature.name for feature in FEATURES if feature.moving)
"""The features of motion."""


def kinds_of(names: Sequence[str]) -> Ints:
    """Places in `FEATURES` of features by name, each once. Raises AsterismError for a name that is not there or given twice."""
    known = {feature.name: kind for kind, feature in enumerate(FEATURES)}
    for name in names:
        if name not in known:
            raise AsterismError(f"feature {name!r} is not known; choose among {', '.join(known)}.")
    if len(set(names)) != len(names) or not names:
        raise AsterismError(f"features {', '.join(names) or '(none)'}: name at least one, and each once.")
    return np.array(sorted(known[name] for name in names), dtype=np.int64)


def feature_pool(n_markers: int, features: Sequence[str] = THESIS, seed: int | np.random.Generator = 0) -> tuple[Ints, Ints]:
    """Every feature over every subset of the markers (section 4.3, step 1): kinds (F,) and slots (F, 4), unused slots 0.

    15 markers and the thesis' three features give its 665. With more than `MANY_MARKERS` markers, features of four points are a random
    sample of `SAMPLED` per kind (or all, where there are fewer). Raises AsterismError for unknown features.
    """
    rng = np.random.default_rng(seed)
    kinds, slots = [], []
    for kind in kinds_of(features):
        feature = FEATURES[kind]
        total = comb(n_markers, feature.points) * len(feature.arrangements)
        if feature.points == 4 and n_markers > MANY_MARKERS and total > SAMPLED:
            subsets = np.sort(np.argsort(rng.random((SAMPLED, n_markers)), axis=1)[:, :4], axis=1)
            order = np.array(feature.arrangements)[rng.integers(len(feature.arrangements), size=SAMPLED)]
            listed = np.unique(np.take_along_axis(subsets, order, axis=1), axis=0)
        else:
            subsets = np.array(list(combinations(range(n_markers), feature.points)), dtype=np.int64).reshape(-1, feature.points)
            listed = np.concatenate([subsets[:, list(order)] for order in feature.arrangements])
        padded = np.zeros((len(listed), 4), dtype=np.int64)
        padded[:, : feature.points] = listed
        kinds.append(np.full(len(listed), kind, dtype=np.int64))
        slots.append(padded)
    return np.concatenate(kinds), np.concatenate(slots)


def needs_motion(kinds: Ints) -> bool:
    """Whether any of the features (places in `FEATURES`) reads the points' motion."""
    return bool(np.array([feature.moving for feature in FEATURES])[kinds].any())


def check_motion(kinds: Ints, frames: Floats) -> None:
    """Raise AsterismError where features read a motion that the frames (..., 3 or more) do not carry."""
    if frames.shape[-1] == 3 and needs_motion(kinds):
        raise AsterismError("features of motion need frames that carry their motion; make them with labelling.features.motion_points.")


def markers_read(kinds: Ints, slots: Ints, n_markers: int) -> NDArray[np.bool_]:
    """(F, M) bool: which markers each feature reads."""
    out = np.zeros((len(kinds), n_markers), dtype=np.bool_)
    points = np.array([feature.points for feature in FEATURES])[kinds]
    for place in range(4):
        reads = points > place
        out[np.nonzero(reads)[0], slots[reads, place]] = True
    return out


def describe(kind: int, slots: Ints, names: Sequence[str]) -> str:
    """A feature in words: "distance (RKNE, RTIB)"."""
    feature = FEATURES[kind]
    return f"{feature.title} ({', '.join(names[marker] for marker in slots[: feature.points])})"
