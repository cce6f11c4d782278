"""Blobs of several cameras in; by how many frames each camera lags behind the others, out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera, Rig
from asterism.recording import Blobs, Floats
from asterism.synchronization._sync_kernels import crossing


@dataclass(frozen=True)
class LagSearchRules:
    """How lags of whole frames are searched for.

    longest          frames up to which lags are searched
    frames           frames of the first camera that are tried on known epipolar lines
    frames_to_fit    frames that unknown epipolar lines are fitted to
    crowd            images with more blobs are not tried: every line meets one
    near_px          px from its epipolar line within which a blob counts
    crossing         share of blobs near their line that the best lag needs, and how far above the next peak that must be
    fitting          the same with unknown lines, of the logarithm of spread over residual
    fewest           frames that two cameras must share to be tried on known epipolar lines; frames of a third of the recording for `slips`
    fewest_to_fit    frames that they must share for unknown ones
    shortest_shares  a lag is at most the recording's length divided by this, with known lines and with unknown ones
    kept             share of the frames that each of three fits of unknown lines keeps: the nearest

    Checked on the simulated cameras out of step of tests/test_reconstruction.py and tests/test_wand.py.
    """

    longest: int = 250
    frames: int = 60
    frames_to_fit: int = 240
    crowd: int = 100
    near_px: float = 2.0
    crossing: tuple[float, float] = (0.4, 0.1)
    fitting: tuple[float, float] = (2.5, 0.5)
    fewest: int = 30
    fewest_to_fit: int = 200
    shortest_shares: tuple[int, int] = (3, 8)
    kept: float = 2 / 3


RULES = LagSearchRules()


def lags(blobs: Blobs, rig: Rig | None = None, longest: int = RULES.longest) -> Floats:
    """How many frames each camera is behind most others: (C,), whole numbers; NaN where nothing is known.

    With a rig: at the right lag, blobs of one camera lie on the epipolar lines of the other's. Without: at the right lag, one fundamental
    matrix explains how the middle of all blobs moves in both; that takes some hundred frames of something that moves all over the images.
    Each pair of cameras tells its lag where one stands out from all others up to `longest` frames; the pairs that stand out most tie the
    cameras together, and a camera that most of its pairs contradict has no lag.
    """
    longest = min(longest, len(blobs) // RULES.shortest_shares[rig is None])
    cameras = len(blobs.cameras)
    pairs: list[tuple[float, int, int, int]] = []
    if longest >= 1 and rig is not None:
        flat = _flat(blobs, rig)
        for a, b in combinations(range(cameras), 2):
            above, best = _stands_out(_crossing(blobs, flat, (rig[a], rig[b]), (a, b), longest), *RULES.crossing)
            pairs += [(above, a, b, best - longest)] if above > 0 else []
    elif longest >= 1:
        middles = [_middles(blobs, c) for c in range(cameras)]
        for a, b in combinations(range(cameras), 2):
            above, best = _stands_out(_fitting(middles[a], middles[b], longest), *RULES.fitting)
            pairs += [(above, a, b, best - longest)] if above > 0 else []
    behind = np.full(cameras, np.nan)
    # The pairs that stand out most decide first; a chain of them reaches all cameras.
    pairs.sort(reverse=True)
    if pairs:
        behind[pairs[0][1]] = 0.0
    for _ in range(cameras):
        for _, a, b, lag in pairs:
            if np.isnan(behind[a]) and np.isfinite(behind[b]):
                behind[a] = behind[b] - lag
            elif np.isnan(behind[b]) and np.isfinite(behind[a]):
                behind[b] = behind[a] + lag
    agree = np.zeros((2, cameras))
    for _, a, b, lag in pairs:
        #
        agree[int(abs(behind[b] - behind[a] - lag) <= 1), [a, b]] += 1
    # A camera that its pairs contradict as often as confirm is not late but unknown.
    behind[agree[1] <= agree[0]] = np.nan
    known = behind[np.isfinite(behind)]
    if len(known):
        values, counts = np.unique(known, return_counts=True)
        # Most cameras of a room are in step; the lag is counted from them.
        behind -= values[np.argmax(counts)]
    return behind


def out_of_step(name: str, behind: float) -> tuple[str, str]:
    """A sentence about a camera that is so many frames behind most others, see `lags`, and what to do about it.

    >>> out_of_step("c2", 3.0)[0]
    "camera c2 is 3 frames out of step: its frame 200 is the others' frame 197."
    """
    many = f"{abs(behind):.0f} frame{'s' if abs(behind) != 1 else ''}"
    return (
        f"camera {name} is {many} out of step: its frame 200 is the others' frame {200 - behind:.0f}.",
        "Start the cameras together, give the time of each image, or renumber its frames.",
    )


def slips(blobs: Blobs, rig: Rig) -> Floats:
    """How many frames farther behind most others each camera is in the last third than in the first: (C,); NaN where nothing is known.

    A camera that loses an image in the middle, without a gap in its numbers, is ahead of the others from there on.
    """
    third = len(blobs) // 3
    if third < RULES.fewest:
        return np.full(len(blobs.cameras), np.nan)
    first, last = _frames(blobs, 0, third), _frames(blobs, len(blobs) - third, len(blobs))
    return lags(last, rig) - lags(first, rig)


def _frames(blobs: Blobs, begin: int, end: int) -> Blobs:
    """The frames begin to end of a recording."""
    cameras = len(blobs.cameras)
    offsets = blobs.offsets[begin * cameras : end * cameras + 1]
    own = slice(offsets[0], offsets[-1])
    times = None if blobs.times is None else blobs.times[begin:end]
    return replace(blobs, xy=blobs.xy[own], sizes=blobs.sizes[own], offsets=offsets - offsets[0], times=times)


def _middles(blobs: Blobs, camera: int) -> Floats:
    """(T, 2) px, the mean of the blobs of one camera in each frame that has as many of them as most have; NaN in others."""
    counts = blobs.counts[:, camera]
    # The middle jumps where a marker appears or goes, so only frames with the usual number of blobs count.
    usual = int(np.argmax(np.bincount(counts[counts > 0], minlength=1)))
    middles = np.full((len(blobs), 2), np.nan)
    frames = np.flatnonzero((counts == usual) & (counts > 0))
    rows = _ranges(blobs.offsets[frames * len(blobs.cameras) + camera], counts[frames])
    middles[frames] = blobs.xy[rows].reshape(len(frames), -1, 2).mean(axis=1) if len(frames) else 0.0
    return middles


def _fitting(first: Floats, second: Floats, longest: int) -> Floats:
    """How well one fundamental matrix explains the middles of two cameras, at each lag of the second: minus the logarithm of the residual,
    as a share of the spread; NaN where they share few frames. The worst third of the frames is left out, twice."""
    scores = np.full(2 * longest + 1, np.nan)
    fewest = max(RULES.fewest_to_fit, 0.5 * float((np.isfinite(first[:, 0]) & np.isfinite(second[:, 0])).sum()))
    a, b = _normalized(first), _normalized(second)
    for lag in range(-longest, longest + 1):
        x, y = a[max(0, -lag) : len(a) - max(0, lag)], b[max(0, lag) : len(b) - max(0, -lag)]
        both = np.flatnonzero(np.isfinite(x[:, 0]) & np.isfinite(y[:, 0]))
        if len(both) < fewest:
            continue
        both = both[np.linspace(0, len(both) - 1, min(RULES.frames_to_fit, len(both))).astype(int)]
        # Each pair of middles gives one row of y^T F x = 0, linear in the nine entries of F.
        products = (y[both, :, None] * x[both, None, :]).reshape(-1, 9)
        kept = products
        for _ in range(3):
            values, vectors = np.linalg.eigh(kept.T @ kept)
            miss = np.abs(products @ vectors[:, 0])
            # A fraction of the frames always has a hidden marker in one camera.
            kept = products[miss <= np.quantile(miss, RULES.kept)]
        scores[lag + longest] = -0.5 * np.log(max(float(values[0]) / (len(kept) - 8), 1e-18))
    return scores


def _normalized(middles: Floats) -> Floats:
    """(T, 3) homogeneous, about their mean and in units of their spread."""
    known = middles[np.isfinite(middles[:, 0])]
    spread = np.sqrt(known.var(axis=0).mean()) if len(known) else 1.0
    centre = known.mean(axis=0) if len(known) else 0.0
    return np.column_stack([(middles - centre) / max(float(spread), 1e-9), np.ones(len(middles))])


def _flat(blobs: Blobs, rig: Rig) -> Floats:
    """(P, 2) all blobs on their cameras' normalized planes."""
    flat = np.empty((len(blobs.xy), 2))
    camera_of = blobs.camera_of
    for c, camera in enumerate(rig):
        flat[camera_of == c] = camera.undistort(blobs.xy[camera_of == c])
    return flat


def _crossing(blobs: Blobs, flat: Floats, cameras: tuple[Camera, Camera], places: tuple[int, int], longest: int) -> Floats:
    """The share of the first camera's blobs that have one of the second's on their epipolar line, at each lag of the second.

    Looks at some frames of the first, and at none with so many blobs that every line meets one.
    """
    (one, two), (a, b) = cameras, places
    turn = two.rotation @ one.rotation.T
    x, y, z = two.translation - turn @ one.translation
    #
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    scores = np.full(2 * longest + 1, np.nan)
    counts = blobs.counts[:, a]
    frames = np.flatnonzero((counts > 0) & (counts <= RULES.crowd))
    if not len(frames):
        return scores
    frames = frames[np.linspace(0, len(frames) - 1, min(RULES.frames, len(frames))).astype(int)]
    near, fewest = RULES.near_px / two.focal[0], min(RULES.fewest, len(blobs) // 3)
    crossing(flat, blobs.offsets, len(blobs.cameras), a, b, frames, essential, near, longest, RULES.crowd, fewest, scores)
    return scores


def _ranges(starts: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Starts to starts + counts, one range after the other."""
    before = np.cumsum(counts) - counts
    return np.repeat(starts - before, counts) + np.arange(int(counts.sum()))


def _stands_out(scores: Floats, lowest: float, margin: float) -> tuple[float, int]:
    """How far the highest peak stands above all others, and its place; 0 where it is low, at an end, or not clear.

    Its own flanks, down to where the scores rise again, do not count; no lag at all is preferred where it is about as good.
    """
    if not np.isfinite(scores).any():
        return 0.0, 0
    #
    filled = np.where(np.isfinite(scores), scores, -1.0)
    best = int(np.argmax(filled))
    left = right = best
    # Scores fall off slowly to both sides of a peak; only beyond these flanks is there another one to compare with.
    while left > 0 and filled[left - 1] <= filled[left]:
        left -= 1
    while right < len(filled) - 1 and filled[right + 1] <= filled[right]:
        right += 1
    others = np.concatenate([filled[: left + 1], filled[right:]])
    above = float(filled[best] - others.max())
    known = np.flatnonzero(np.isfinite(scores))
    middle = len(filled) // 2
    # Periodic motion, such as walking, has peaks a cycle apart.
    if filled[middle] > filled[best] - margin:
        best = middle
    clear = filled[best] >= lowest and above >= margin and known[0] < best < known[-1]
    return (above, best) if clear else (0.0, best)
