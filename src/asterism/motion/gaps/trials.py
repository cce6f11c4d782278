"""Recordings with names in; those of the same person with the same markers in place out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from asterism.recording import Floats, Recording, is_unnamed
from asterism.recording.arrays import nan_median

SAME_PERSON = 0.008
"""m by which distances between steady markers may differ. In `movement`, trials of a session differ by up to 7 mm, other people by 11 mm
and more, also in one marker set; at half, standing trials would not count, at double, other people would."""
_SHARED = 4
"""Markers that two recordings must share: three have too few distances to tell people apart."""
_ROUNDED = 5e-5
"""m: files with whole tenths of a mm are as inexact; two trials differ by centimetres, standing ones by 0.2 mm."""
_FRAMES = 40
"""Frames that tell the median of a distance."""
_PAIRS = 2
"""Pairs of markers for each marker that are compared, the steadiest: half and twice as many tell the same people apart."""


def trials_of_person(recording: Recording, others: Iterable[Recording]) -> list[Recording]:
    """Those of the others that show the same person with the same markers in the same places, by `marker_difference`.

    A copy of the recording itself is no other trial: it would tell what somebody filled in as if it were measured.

    >>> from asterism.simulation import simulate_walks
    >>> first, second, stranger = simulate_walks(subjects=2, frames=50, trials=2, seed=3)[:3]
    >>> len(trials_of_person(first, [second, stranger]))
    1
    """
    distances: dict[tuple[str, ...], tuple[Floats, Floats]] = {}
    return [other for other in others if not _copy(recording, other) and _difference(recording, other, distances) <= SAME_PERSON]


def _copy(first: Recording, second: Recording) -> bool:
    """Whether most samples of a marker that both have are the same, to what files round."""
    if len(first) != len(second):
        return False
    for label in first.labels:
        if label in second.labels and not is_unnamed(label):
            apart = np.abs(first.positions[:, first.labels.index(label)] - second.positions[:, second.labels.index(label)])
            if np.isfinite(apart).any() and np.nanmedian(apart) < _ROUNDED:
                return True
    return False


def marker_difference(first: Recording, second: Recording) -> float:
    """m, how much distances between markers differ in the median, over the pairs that keep theirs best; NaN for fewer than 4 shared names.

    O(markers^2) by at most 80 frames.
    """
    return _difference(first, second, {})


def _difference(first: Recording, second: Recording, known: dict[tuple[str, ...], tuple[Floats, Floats]]) -> float:
    """`marker_difference`; known: the distances of the first recording by the markers that others share with it, which grow."""
    shared = tuple(label for label in first.labels if label in second.labels and not is_unnamed(label))
    if len(shared) < _SHARED:
        return float("nan")
    if shared not in known:
        known[shared] = _distances(first, shared)
    (middle, spread), (other, others) = known[shared], _distances(second, shared)
    seen = np.isfinite(middle + other)
    if not seen.any():
        return float("nan")
    apart = np.abs(middle - other)[seen]
    return float(np.median(apart[np.argsort(np.hypot(spread, others)[seen], kind="stable")[: _PAIRS * len(shared)]]))


def _distances(recording: Recording, labels: Sequence[str]) -> tuple[Floats, Floats]:
    """(pairs,) m, the median distance of two markers and the median deviation from it; NaN where they are never seen together."""
    columns = [recording.labels.index(label) for label in labels]
    points = np.ascontiguousarray(recording.positions[:: max(len(recording) // _FRAMES, 1), columns].transpose(2, 1, 0))
    # One row for each pair: medians along what lies together in memory are cheap.
    rows, others = np.triu_indices(len(labels), 1)
    squares = np.zeros((len(rows), points.shape[2]))
    for axis in points:
        squares += (axis[rows] - axis[others]) ** 2
    apart = np.sqrt(squares)
    middle = nan_median(apart, axis=1)
    return middle, nan_median(np.abs(apart - middle[:, None]), axis=1)
