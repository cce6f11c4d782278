"""Paths of labelled markers in; labels that are exchanged, and labels that jump away and come back, out."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.audit._kernels import all_exchanges, exchange_path, path_score
from asterism.labelling.audit.errors import EXCHANGED, JUMP, ErrorRun
from asterism.recording import Floats, Ints

LEAST_SCALE = 1e-3
"""m, the lowest prediction error of a path; below it is the noise of cameras."""


def pairs_of(markers: int) -> Ints:
    """All pairs of markers: (P, 2)."""
    return np.array(list(combinations(range(markers), 2)), dtype=np.int64).reshape(-1, 2)


def scales_of(positions: Floats) -> Floats:
    """(M,) m, the usual error of predicting each marker at constant velocity for a frame, as a standard deviation per axis.

    From the upper quartile of the second differences, so that a few wrong frames do not count. positions (T, M, 3) m, NaN where missing.
    """
    scales = np.full(positions.shape[1], LEAST_SCALE)
    error = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=2)
    for m in range(positions.shape[1]):
        known = error[~np.isnan(error[:, m]), m]
        if len(known):
            # 2.03 is the upper quartile of the length of a second difference over its deviation per axis.
            scales[m] = max(LEAST_SCALE, float(np.quantile(known, 0.75)) / 2.03)
    return scales


def exchanges(positions: Floats, emission: Floats, switch: float, least: float) -> tuple[list[ErrorRun], Floats]:
    """Where pairs of markers are exchanged, one pair after the other, the largest gain first; and the corrected positions.

    positions  (T, M, 3) m
    emission   (P, T) nats that a frame gains if the pair is exchanged in it, pairs as in `pairs_of`
    switch     nats that each beginning or end of an exchange costs
    least      nats that an exchange gains at least
    """
    frames, markers = positions.shape[:2]
    positions, pairs, scales = positions.copy(), pairs_of(markers), scales_of(positions)
    gains = np.zeros(len(pairs))
    if len(pairs) == 0 or frames < 3:
        return [], positions
    all_exchanges(positions, scales, emission, switch, pairs, gains)
    runs: list[ErrorRun] = []
    # Each exchange is undone before the next is sought; the limit ends a pair that goes back and forth.
    for _ in range(8 * markers):
        best = int(np.argmax(gains))
        if gains[best] < least:
            break
        a, b = pairs[best]
        found = _runs(positions, scales, emission[best], switch, (int(a), int(b)))
        # Whatever it yields, the pair is done until its paths change again.
        gains[best] = 0.0
        found = [run for run in found if run.gain >= least]
        if not found:
            continue
        for run in found:
            span = slice(run.first, run.last + 1)
            positions[span, [a, b]] = positions[span, [b, a]]
            # the evidence of the body was for these frames as they were
            emission = emission.copy()
            emission[np.isin(pairs, (a, b)).any(axis=1), span] = 0.0
        runs += found
        # Only pairs with one of the two markers have another path now.
        affected = np.nonzero(np.isin(pairs, (a, b)).any(axis=1))[0]
        updated = np.zeros(len(affected))
        all_exchanges(positions, scales, np.ascontiguousarray(emission[affected]), switch, pairs[affected], updated)
        gains[affected] = updated
        gains[best] = 0.0
    return runs, positions


def _runs(positions: Floats, scales: Floats, emission: Floats, switch: float, pair: tuple[int, int]) -> list[ErrorRun]:
    """The runs of frames in which the most likely path has the pair exchanged, each with the gain of that run alone."""
    seen = np.nonzero(~np.isnan(positions[:, pair, 0]).any(axis=1))[0]
    paths = np.ascontiguousarray(positions[seen][:, pair])
    both = np.full(2, scales[list(pair)].max())
    arguments = (paths, seen.astype(np.float64), both, np.ascontiguousarray(emission[seen]), switch)
    states = np.zeros(len(seen), dtype=np.int64)
    exchange_path(*arguments, states)
    never = path_score(*arguments, np.zeros_like(states))
    # Where the state goes up a run begins, where it goes down it ends.
    edges = np.diff(states, prepend=0, append=0)
    runs = []
    for start, stop in zip(np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0], strict=True):
        only_this = np.zeros_like(states)
        only_this[start:stop] = 1
        # Each run by itself: a strong one must not carry a weak one over the limit.
        gain = path_score(*arguments, only_this) - never
        runs.append(ErrorRun(int(seen[start]), int(seen[stop - 1]), pair, EXCHANGED, float(gain)))
    return runs


def jumps(positions: Floats, rate: float, distance: float, speed: float, errors: float, longest: float) -> list[ErrorRun]:
    """Where a marker jumps off its path between two frames, and jumps back within `longest` seconds.

    positions (T, M, 3) m. A jump is longer than `distance` (m), than a change of speed by `speed` (m/s) within a frame, and than `errors`
    usual prediction errors of the marker. Where at least half of the markers jump in one frame, the recording was cut, and no label is
    wrong. The gain is the sum over both jumps, in nats of the marker's usual prediction error.
    """
    frames, markers = positions.shape[:2]
    # A jump and its return need samples on both sides.
    if frames < 6:
        return []
    scales = scales_of(positions)
    size = _jump_sizes(positions)
    least = np.maximum(np.maximum(distance, speed / rate), errors * scales)
    broken = size > least
    shown = ~np.isnan(size)
    # Half of the markers at once is a cut of the recording, not a wrong label.
    broken &= 2 * broken.sum(axis=1, keepdims=True) < np.maximum(shown.sum(axis=1, keepdims=True), 2)
    runs = []
    for m in range(markers):
        path = positions[:, m]
        edges = np.nonzero(broken[:, m])[0]
        taken = -1
        for one, other in pairwise(edges.tolist()):
            # A frame that belongs to a run already cannot begin another.
            if one <= taken or other - one > longest * rate or not _comes_back(path, one, other):
                continue
            # By the heavy-tailed density: a few large jumps must not outweigh all other evidence.
            gain = sum(3.0 * np.log1p(size[t, m] ** 2 / (3.0 * scales[m] ** 2)) for t in (one, other))
            runs.append(ErrorRun(int(one) + 1, int(other), (m,), JUMP, float(gain)))
            taken = other
    return runs


def _jump_sizes(positions: Floats) -> Floats:
    """(T - 1, M) m: how far a step differs from the step before it and from the step after it, the smaller of the two."""
    step = np.diff(positions, axis=0)
    before, after = np.full(step.shape, np.nan), np.full(step.shape, np.nan)
    before[1:], after[:-1] = step[:-1], step[1:]
    from_before, from_after = np.linalg.norm(step - before, axis=2), np.linalg.norm(step - after, axis=2)
    # without the step on one side, the length of the step itself counts
    length = np.linalg.norm(step, axis=2)
    return np.fmin(np.where(np.isnan(from_before), length, from_before), np.where(np.isnan(from_after), length, from_after))


def _comes_back(path: NDArray[np.float64], one: int, other: int) -> bool:
    """Whether the second jump undoes the first, or the path continues after it as it went before the first.

    Both to less than a third of the smaller jump.
    """
    # A few samples on each side give the speed; more would follow a turn of the body.
    back, off, ahead = path[max(0, one - 3) : one + 1], path[one + 1 : other + 1], path[other + 1 : other + 5]
    back, ahead = back[~np.isnan(back[:, 0])], ahead[~np.isnan(ahead[:, 0])]
    if len(back) == 0 or len(ahead) == 0 or np.isnan(off[[0, -1]]).any():
        return False
    speeds = [np.diff(side, axis=0).mean(axis=0) for side in (back, ahead) if len(side) > 1]
    speed = np.mean(speeds, axis=0) if speeds else np.zeros(3)
    away, home = off[0] - back[-1] - speed, ahead[0] - off[-1] - speed
    # A marker that moves on during the jump comes back to where its speed would have brought it.
    bridged = ahead[0] - back[-1] - speed * (other - one + 1)
    return bool(min(np.linalg.norm(away + home), np.linalg.norm(bridged)) < min(np.linalg.norm(away), np.linalg.norm(home)) / 3.0)
