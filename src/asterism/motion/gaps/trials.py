"""Recordings with names in; those of the same person with the same markers in place out."""

from __future__ import annotations

from collections.abc import Iterable

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
    return [other for other in others if not _copy(recording, other) and marker_difference(recording, other) <= SAME_PERSON]


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
    shared = [label for label in first.labels if label in second.labels and not is_unnamed(label)]
    parts = [_distances(recording, shared) for recording in (first, second)]
    shared_seen = np.isfinite(parts[0][0] + parts[1][0])
    if len(shared) < _SHARED or not shared_seen.any():
        return float("nan")
    apart = np.abs(parts[0][0] - parts[1][0])[shared_seen]
    spread = np.hypot(parts[0][1], parts[1][1])[shared_seen]
    return float(np.median(apart[np.argsort(spread, kind="stable")[: _PAIRS * len(shared)]]))


def _distances(recording: Recording, labels: list[str]) -> tuple[Floats, Floats]:
    """(pairs,) m, the median distance of two markers and the median deviation from it; NaN where they are never seen together."""
    columns = [recording.labels.index(label) for label in labels]
    points = recording.positions[:: max(len(recording) // _FRAMES, 1), columns]
    rows, others = np.triu_indices(len(labels), 1)
    apart = np.linalg.norm(points[:, rows] - points[:, others], axis=2)
    middle = nan_median(apart, axis=0)
    return middle, nan_median(np.abs(apart - middle), axis=0)
