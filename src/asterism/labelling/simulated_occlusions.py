"""A labelled recording in; unlabelled clouds with hidden markers and ghost points, and the true labels, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Floats, Ints, Recording

GHOST_RADIUS = 0.15
"""Largest distance of a ghost from its marker (m). Chosen by hand: nearer ghosts are taken for the marker most easily."""


def simulate_occlusions(
    recording: Recording, occlusions: int = 2, ghosts: int = 1, seed: int | np.random.Generator = 0
) -> tuple[Clouds, Ints]:
    """Take the labels away, hide some markers of each frame, add ghosts, and shuffle the points of each frame.

    In each frame exactly `occlusions` of the visible markers are hidden, at random (all of them where fewer are visible). `ghosts` points
    are added, each uniformly placed in a ball of `GHOST_RADIUS` around a random marker of that frame, hidden ones included. A frame
    in which the recording has no marker at all gets no ghosts.

    Returns the clouds (m; their `columns` are all -1) and the truth: (T, M) int, for each marker its
    place in its frame's cloud, -1 where it was hidden or missing. `seed` is a number or a generator. O(T (M + G) log(M + G)).
    Raises AsterismError where `occlusions` or `ghosts` is negative, or more markers should be hidden than there are columns.
    """
    frames, markers = recording.visible.shape
    if not 0 <= occlusions <= markers:
        raise AsterismError(f"cannot hide {occlusions} of {markers} markers; ask for 0 to {markers} occlusions.")
    if ghosts < 0:
        raise AsterismError(f"cannot add {ghosts} ghosts; ask for 0 or more.")
    rng = np.random.default_rng(seed)
    visible = recording.visible
    kept = visible & (_ranks(np.where(visible, rng.random((frames, markers)), np.inf)) >= occlusions)

    count = visible.sum(axis=1)
    visible_first = np.argsort(~visible, axis=1, kind="stable")
    nth = np.minimum((rng.random((frames, ghosts)) * count[:, None]).astype(np.int64), np.maximum(count - 1, 0)[:, None])
    host = np.take_along_axis(visible_first, nth, axis=1) if markers else np.zeros((frames, 0), dtype=np.int64)
    ghost_points = np.take_along_axis(recording.positions, host[:, :, None], axis=1) + _in_ball((frames, host.shape[1]), rng) * GHOST_RADIUS

    points = np.concatenate([recording.positions, ghost_points], axis=1)
    there = np.concatenate([kept, np.repeat(count[:, None] > 0, host.shape[1], axis=1)], axis=1)
    clouds, rank, _, _ = _shuffled(recording, points, there, rng)
    return clouds, np.where(kept, rank[:, :markers], NULL)


def simulate_gaps_and_ghosts(
    recording: Recording,
    hidden: int = 3,
    ghosts: int = 0,
    seed: int | np.random.Generator = 0,
    *,
    gap_seconds: tuple[float, float] = (0.1, 1.0),
    ghost_seconds: tuple[float, float] = (0.05, 0.5),
    number_tracks: bool = True,
) -> tuple[Clouds, Ints]:
    """Take the labels away as a camera system would: markers disappear for a while and return with new track numbers; ghosts follow them.

    At every moment exactly `hidden` markers that the recording shows are in a gap (all of them where fewer are shown). A gap lasts
    uniformly `gap_seconds`, or until its marker leaves the recording; then another random marker's begins (the same one's only where no
    other is shown). At every moment there are `ghosts` ghost tracks: each lasts uniformly `ghost_seconds` and keeps its offset, drawn
    uniformly in a ball of `GHOST_RADIUS`, from a random marker of the recording, hidden ones included, as long as that is visible. The
    first gaps and ghosts begin before the recording does.

    Returns the clouds (m), the points of each frame in random order, and the truth as `simulate_occlusions` gives it. The clouds' tracks
    number every unbroken stretch of a marker, and every ghost, in random order; None without `number_tracks`. O(T (M + G) log(M + G)).
    Raises AsterismError where `hidden` or `ghosts` is negative, more markers should be hidden than there are columns, or a range of
    seconds is empty.
    """
    frames, markers = recording.visible.shape
    if not 0 <= hidden <= markers:
        raise AsterismError(f"cannot hide {hidden} of {markers} markers; ask for 0 to {markers}.")
    if ghosts < 0:
        raise AsterismError(f"cannot add {ghosts} ghosts; ask for 0 or more.")
    _check_seconds("gaps", gap_seconds)
    _check_seconds("ghosts", ghost_seconds)
    rng = np.random.default_rng(seed)
    visible = recording.visible
    in_gap = _gaps(visible, hidden, gap_seconds, recording.rate, rng)
    kept = visible & ~in_gap
    ghost_points, ghost_number = _ghost_tracks(recording, ghosts, ghost_seconds, rng)
    points = np.concatenate([recording.positions, ghost_points], axis=1)
    there = np.concatenate([kept, ghost_number >= 0], axis=1)
    begins = kept & ~np.concatenate([np.zeros((1, markers), dtype=np.bool_), kept[:-1]])
    number = np.where(kept, np.cumsum(begins, axis=0) * markers + np.arange(markers), -1)
    number = np.concatenate([number, np.where(ghost_number >= 0, ghost_number + (frames + 1) * markers, -1)], axis=1)

    clouds, rank, order, present = _shuffled(recording, points, there, rng)
    if number_tracks:
        names, tracks = np.unique(np.take_along_axis(number, order, axis=1)[present], return_inverse=True)
        clouds = replace(clouds, tracks=rng.permutation(len(names))[tracks].astype(np.int64))
    return clouds, np.where(kept, rank[:, :markers], NULL)


def simulate_gaps(
    recording: Recording, gaps: int, seed: int | np.random.Generator = 0, *, gap_seconds: tuple[float, float] = (0.1, 1.0)
) -> tuple[Clouds, Ints]:
    """So many gaps in the whole recording, of random markers at random moments, as in much of the literature. No ghosts.

    Raises AsterismError where `gaps` is negative, the recording has no markers, or the range of seconds is empty.
    """
    if gaps < 0:
        raise AsterismError(f"cannot make {gaps} gaps; ask for 0 or more.")
    if not recording.labels:
        raise AsterismError("the recording has no markers to make gaps in; choose one that has.")
    _check_seconds("gaps", gap_seconds)
    rng = np.random.default_rng(seed)
    positions = recording.positions.copy()
    for _ in range(gaps):
        length = max(1, round(rng.uniform(*gap_seconds) * recording.rate))
        start = int(rng.integers(max(1, len(positions) - length + 1)))
        positions[start : start + length, rng.integers(positions.shape[1])] = np.nan
    return simulate_gaps_and_ghosts(replace(recording, positions=positions), 0, 0, rng)


def _shuffled(
    recording: Recording, points: Floats, there: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[Clouds, Ints, Ints, NDArray[np.bool_]]:
    """The points (T, N, 3) that are `there` (T, N), in random order in every frame.

    Returns the clouds, each point's place in its frame's cloud (T, N), the columns in the order of the clouds (T, N), and which of these
    are there (T, N).
    """
    keys = np.where(there, rng.random(there.shape), np.inf)
    order = np.argsort(keys, axis=1)
    present = np.take_along_axis(there, order, axis=1)
    clouds = Clouds(
        xyz=np.ascontiguousarray(np.take_along_axis(points, order[:, :, None], axis=1)[present]),
        offsets=np.concatenate([[0], np.cumsum(there.sum(axis=1))]).astype(np.int64),
        rate=recording.rate,
        vertical=recording.vertical,
        columns=np.full(int(there.sum()), -1, dtype=np.int64),
    )
    return clouds, _ranks(keys), order, present


def _check_seconds(what: str, seconds: tuple[float, float]) -> None:
    shortest, longest = seconds
    if not 0 < shortest <= longest < np.inf:
        raise AsterismError(f"{what} of {shortest} to {longest} s cannot be drawn; give the shortest and the longest, both above 0.")


def _gaps(
    visible: NDArray[np.bool_], hidden: int, seconds: tuple[float, float], rate: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """(T, M) whether a marker is in one of the gaps of which `hidden` are open at every moment."""
    frames, markers = visible.shape
    in_gap = np.zeros((frames, markers), dtype=np.bool_)
    left = np.zeros(markers, dtype=np.int64)
    for t in range(frames):
        left = np.where(visible[t], np.maximum(left - 1, 0), 0)
        while (left > 0).sum() < min(hidden, visible[t].sum()):
            free = visible[t] & (left == 0)
            not_before = free & ~in_gap[t - 1] if t else free
            marker = rng.choice(np.nonzero(not_before if not_before.any() else free)[0])
            length = max(1, round(rng.uniform(*seconds) * rate))
            left[marker] = length if t else rng.integers(1, length + 1)
        in_gap[t] = left > 0
    return in_gap


def _ghost_tracks(recording: Recording, ghosts: int, seconds: tuple[float, float], rng: np.random.Generator) -> tuple[Floats, Ints]:
    """Positions (T, G, 3) of the ghosts at every moment, and the number of each ghost (T, G), -1 for none."""
    frames = len(recording)
    positions, number = np.full((frames, ghosts, 3), np.nan), np.full((frames, ghosts), -1, dtype=np.int64)
    count = 0
    for g in range(ghosts):
        t = 0
        while t < frames:
            shown = np.nonzero(recording.visible[t])[0]
            if len(shown) == 0:
                t += 1
                continue
            host = rng.choice(shown)
            length = max(1, round(rng.uniform(*seconds) * recording.rate))
            length = length if t else int(rng.integers(1, length + 1))
            gone = np.nonzero(~recording.visible[t : t + length, host])[0]
            end = t + int(gone[0]) if len(gone) else min(t + length, frames)
            positions[t:end, g] = recording.positions[t:end, host] + _in_ball((1, 1), rng)[0, 0] * GHOST_RADIUS
            number[t:end, g] = count
            count += 1
            t = end
    return positions, number


def _ranks(keys: Floats) -> Ints:
    """(T, N) the place of each key in its sorted row."""
    return np.argsort(np.argsort(keys, axis=1), axis=1).astype(np.int64)


def _in_ball(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """(T, G, 3) points uniform in the unit ball."""
    direction = rng.normal(size=(*shape, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    return direction * np.cbrt(rng.random((*shape, 1)))
