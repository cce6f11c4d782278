"""What markers' own paths say: labels that change places, and labels that leap away and come back."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.audit._kernels import all_exchanges, exchange_path, path_score
from asterism.labelling.audit.errors import EXCHANGED, JUMP, Run
from asterism.recording import Floats, Ints

LEAST_SCALE = 1e-3
"""No path is steadier than this (m): cameras are not."""


def pairs_of(markers: int) -> Ints:
    """All pairs of markers: (P, 2)."""
    return np.array(list(combinations(range(markers), 2)), dtype=np.int64).reshape(-1, 2)


def scales_of(positions: Floats) -> Floats:
    """How far from a straight and even path each marker usually is after a frame, as a standard deviation per axis: (M,) m.

    From the upper quartile of the second differences, so that a few broken frames do not count. positions (T, M, 3) m, NaN where missing.
    """
    scales = np.full(positions.shape[1], LEAST_SCALE)
    miss = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=2)
    for m in range(positions.shape[1]):
        own = miss[~np.isnan(miss[:, m]), m]
        if len(own):
            scales[m] = max(LEAST_SCALE, float(np.quantile(own, 0.75)) / 2.03)
    return scales


def exchanges(positions: Floats, emission: Floats, switch: float, least: float) -> tuple[list[Run], Floats]:
    """Where pairs of markers are exchanged, one pair after the other, the plainest first; and the positions with that mended.

    positions (T, M, 3) m; emission (P, T) nats that a frame gains if the pair is exchanged in it, pairs as in `pairs_of`; switch nats that
    each beginning or end of an exchange costs; least nats for an exchange to be told.
    """
    frames, markers = positions.shape[:2]
    positions, pairs, scales = positions.copy(), pairs_of(markers), scales_of(positions)
    gains = np.zeros(len(pairs))
    if len(pairs) == 0 or frames < 3:
        return [], positions
    all_exchanges(positions, scales, emission, switch, pairs, gains)
    runs: list[Run] = []
    for _ in range(8 * markers):
        best = int(np.argmax(gains))
        if gains[best] < least:
            break
        a, b = pairs[best]
        found = _runs(positions, scales, emission[best], switch, (int(a), int(b)))
        gains[best] = 0.0
        found = [run for run in found if run.gain >= least]
        if not found:
            continue
        for run in found:
            span = slice(run.first, run.last + 1)
            positions[span, [a, b]] = positions[span, [b, a]]
            # what the body said of these frames was said of them as they were
            emission = emission.copy()
            emission[np.isin(pairs, (a, b)).any(axis=1), span] = 0.0
        runs += found
        again = np.nonzero(np.isin(pairs, (a, b)).any(axis=1))[0]
        fresh = np.zeros(len(again))
        all_exchanges(positions, scales, np.ascontiguousarray(emission[again]), switch, pairs[again], fresh)
        gains[again] = fresh
        gains[best] = 0.0
    return runs, positions


def _runs(positions: Floats, scales: Floats, emission: Floats, switch: float, pair: tuple[int, int]) -> list[Run]:
    """The stretches in which one pair is best taken as exchanged, each with its own gain."""
    seen = np.nonzero(~np.isnan(positions[:, pair, 0]).any(axis=1))[0]
    paths = np.ascontiguousarray(positions[seen][:, pair])
    both = np.full(2, scales[list(pair)].max())
    given = (paths, seen.astype(np.float64), both, np.ascontiguousarray(emission[seen]), switch)
    states = np.zeros(len(seen), dtype=np.int64)
    exchange_path(*given, states)
    never = path_score(*given, np.zeros_like(states))
    edges = np.diff(states, prepend=0, append=0)
    runs = []
    for start, stop in zip(np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0], strict=True):
        alone = np.zeros_like(states)
        alone[start:stop] = 1
        gain = path_score(*given, alone) - never
        runs.append(Run(int(seen[start]), int(seen[stop - 1]), pair, EXCHANGED, float(gain)))
    return runs


def jumps(positions: Floats, rate: float, far: float, fast: float, times: float, longest: float) -> list[Run]:
    """Where a marker leaves its path at once, and comes back onto it as abruptly within `longest` seconds.

    positions (T, M, 3) m. A leap is farther than `far` (m), than a change of speed by `fast` (m/s) within a frame, and than `times` the
    marker's usual miss. Where at least half of the markers leap together the recording itself was cut, which is nobody's label.
    The gain is the sum of both leaps, in nats of the marker's usual miss.
    """
    frames, markers = positions.shape[:2]
    if frames < 6:
        return []
    scales = scales_of(positions)
    leap = _leaps(positions)
    least = np.maximum(np.maximum(far, fast / rate), times * scales)
    broken = leap > least
    shown = ~np.isnan(leap)
    broken &= 2 * broken.sum(axis=1, keepdims=True) < np.maximum(shown.sum(axis=1, keepdims=True), 2)
    runs = []
    for m in range(markers):
        path = positions[:, m]
        edges = np.nonzero(broken[:, m])[0]
        taken = -1
        for one, other in pairwise(edges.tolist()):
            if one <= taken or other - one > longest * rate or not _comes_back(path, one, other):
                continue
            gain = sum(3.0 * np.log1p(leap[t, m] ** 2 / (3.0 * scales[m] ** 2)) for t in (one, other))
            runs.append(Run(int(one) + 1, int(other), (m,), JUMP, float(gain)))
            taken = other
    return runs


def _leaps(positions: Floats) -> Floats:
    """(T - 1, M) m: how far apart the path before and after a step are, seen from either side, the nearer of the two."""
    step = np.diff(positions, axis=0)
    before, after = np.full(step.shape, np.nan), np.full(step.shape, np.nan)
    before[1:], after[:-1] = step[:-1], step[1:]
    from_before, from_after = np.linalg.norm(step - before, axis=2), np.linalg.norm(step - after, axis=2)
    # a side that is not seen leaves the step itself
    bare = np.linalg.norm(step, axis=2)
    return np.fmin(np.where(np.isnan(from_before), bare, from_before), np.where(np.isnan(from_after), bare, from_after))


def _comes_back(path: NDArray[np.float64], one: int, other: int) -> bool:
    """Whether a path leaps back by what it leapt away, or goes on after the second leap about where it was before the first.

    About: off by less than a third of the smaller leap.
    """
    back, off, ahead = path[max(0, one - 3) : one + 1], path[one + 1 : other + 1], path[other + 1 : other + 5]
    back, ahead = back[~np.isnan(back[:, 0])], ahead[~np.isnan(ahead[:, 0])]
    if len(back) == 0 or len(ahead) == 0 or np.isnan(off[[0, -1]]).any():
        return False
    speeds = [np.diff(side, axis=0).mean(axis=0) for side in (back, ahead) if len(side) > 1]
    speed = np.mean(speeds, axis=0) if speeds else np.zeros(3)
    away, home = off[0] - back[-1] - speed, ahead[0] - off[-1] - speed
    bridged = ahead[0] - back[-1] - speed * (other - one + 1)
    return bool(min(np.linalg.norm(away + home), np.linalg.norm(bridged)) < min(np.linalg.norm(away), np.linalg.norm(home)) / 3.0)
