"""A labelling and its clouds in; the data with which the page shows the moving body in 3D out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import minimum_spanning_tree

from asterism.geometry import rotate_z_up
from asterism.recording import Clouds, Floats, Labelling, MarkerSet, canonical, shipped_marker_sets

FRAMES = 200
"""The most frames in a page."""
LONGEST_BONE = 0.65
"""m, the longest line between two markers."""
REST_POINTS = 150
"""The most unlabelled points that are drawn in a frame."""


def known_set(names: Sequence[str]) -> MarkerSet | None:
    """The smallest shipped marker set that has all these markers, for their pairs and segments."""
    sets = sorted((MarkerSet.load(name) for name in shipped_marker_sets()), key=len)
    wanted = {canonical(name) for name in names}
    return next((known for known in sets if wanted <= {canonical(name) for name in known.names}), None)


def scene(labelling: Labelling, clouds: Clouds, marker_set: MarkerSet | None, wrong: NDArray[np.bool_] | None) -> dict[str, Any] | None:
    """The scene's data: points in mm with z up, in axes that follow the body over the floor.

    wrong  (T, M) the labels that are known to be wrong, or None. Returns None where no marker got a label.
    """
    labelled = rotate_z_up(labelling.positions(clouds), clouds.vertical)
    seen = np.isfinite(labelled[:, :, 0])
    if not seen.any():
        return None
    marker_set = marker_set or known_set(labelling.names)
    origin = _body_position(labelled, seen)
    labelled = labelled - origin[:, None]
    frames = _frames(seen, clouds.rate)
    ranges = _ranges(labelled[seen])
    rest = []
    for t in frames:
        taken = labelling.indices[t][labelling.indices[t] >= 0]
        left = rotate_z_up(np.delete(clouds[int(t)], taken, axis=0), clouds.vertical) - origin[t]
        near = ((left > ranges[:, 0]) & (left < ranges[:, 1])).all(axis=1)
        rest.append(_millimetres(left[near][:REST_POINTS]))
    mistaken = wrong if wrong is not None else np.zeros(seen.shape, dtype=bool)
    sides = _sides(labelling.names, marker_set)
    shown = {*sides, *(["wrong"] if mistaken[frames].any() else []), *(["rest"] if any(rest) else [])}
    return {
        "names": list(labelling.names),
        "named": len(labelling.names) <= 20,
        "side": sides,
        "shown": sorted(shown),
        "bones": _bones(labelled, seen, labelling.names, marker_set),
        "points": [_millimetres(labelled[t]) for t in frames],
        "rest": rest,
        "wrong": [np.nonzero(mistaken[t])[0] for t in frames],
        "frames": frames + 1,
        "seconds": np.round(frames / clouds.rate, 3),
        "step_ms": 1000 * float(frames[1] - frames[0]) / clouds.rate if len(frames) > 1 else 40,
        "ranges": ranges,
        "aspect": np.round((ranges[:, 1] - ranges[:, 0]) / (ranges[:, 1] - ranges[:, 0]).max(), 3),
        "eye": {"x": 1.2, "y": 1.2, "z": 0.25},
    }


def _body_position(labelled: Floats, seen: NDArray[np.bool_]) -> Floats:
    """(T, 3) m: the place on the floor below the body, smoothed; its height is that of the lowest markers in the recording."""
    some = np.nonzero(seen.any(axis=1))[0]
    middle = np.array([np.median(labelled[t, seen[t]], axis=0) for t in some])
    every = np.arange(len(labelled))
    out = np.stack([np.interp(every, some, middle[:, axis]) for axis in range(3)], axis=1)
    out[:, :2] = gaussian_filter1d(out[:, :2], 12.0, axis=0, mode="nearest")
    out[:, 2] = np.percentile(labelled[:, :, 2][seen], 0.5)
    return out


def _frames(seen: NDArray[np.bool_], rate: float) -> NDArray[np.int64]:
    """Frames to show, from the first with labels: about 25 per second, fewer where that would be more than FRAMES."""
    some = np.nonzero(seen.any(axis=1))[0]
    step = max(1, round(rate / 25), -(-(some[-1] + 1 - some[0]) // FRAMES))
    return np.arange(some[0], some[-1] + 1, step)


def _ranges(points: Floats) -> Floats:
    """(3, 2) m: the box that holds nearly all points, with a margin."""
    low, high = np.percentile(points, 0.5, axis=0), np.percentile(points, 99.5, axis=0)
    margin = np.array([0.15, 0.15, 0.1])
    return np.round(np.stack([low - margin, high + margin], axis=1), 3)


def _millimetres(points: Floats) -> list[list[int] | None]:
    return [[int(v) for v in np.rint(1000 * point)] if np.isfinite(point).all() else None for point in points]


def _sides(names: Sequence[str], marker_set: MarkerSet | None) -> list[str]:
    if marker_set is None:
        return ["middle"] * len(names)
    left = {canonical(pair[0]) for pair in marker_set.pairs}
    right = {canonical(pair[1]) for pair in marker_set.pairs}
    return ["left" if canonical(n) in left else "right" if canonical(n) in right else "middle" for n in names]


def _bones(labelled: Floats, seen: NDArray[np.bool_], names: Sequence[str], marker_set: MarkerSet | None) -> list[list[int]]:
    """Pairs of markers to join by a line: those of one segment first, then pairs with a short distance that changes little."""
    some = np.nonzero(seen.any(axis=1))[0]
    some = some[:: max(1, len(some) // 200)]
    gaps = np.linalg.norm(labelled[some][:, :, None] - labelled[some][:, None], axis=3)
    known = np.isfinite(gaps)
    frequent = known.sum(axis=0) >= max(3, len(some) // 10)
    number = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, gaps, 0.0).sum(axis=0) / number
    spread = np.sqrt(np.where(known, (gaps - mean) ** 2, 0.0).sum(axis=0) / number)
    cost = 1e-6 + spread + 0.15 * mean
    index = {canonical(name): i for i, name in enumerate(names)}
    for members in marker_set.segments.values() if marker_set else ():
        segment = [index[canonical(name)] for name in members if canonical(name) in index]
        cost[np.ix_(segment, segment)] *= 0.01
    cost[~frequent | (mean > LONGEST_BONE)] = 0.0
    np.fill_diagonal(cost, 0.0)
    return [[int(a), int(b)] for a, b in zip(*minimum_spanning_tree(np.triu(cost)).nonzero(), strict=True)]
