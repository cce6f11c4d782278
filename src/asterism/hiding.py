"""A labelled recording in; out come anonymous clouds with hidden markers and ghost points, and the truth about them."""

from __future__ import annotations

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Floats, Ints, Recording

GHOST_RADIUS = 0.15
"""How far from a marker a ghost may lie, in metres."""


def hide_and_haunt(recording: Recording, occlusions: int = 2, ghosts: int = 1, seed: int | np.random.Generator = 0) -> tuple[Clouds, Ints]:
    """Take the labels away, hide some markers of each frame, add ghosts, and shuffle the points of each frame.

    In each frame exactly `occlusions` of the visible markers go, at random (all of them where fewer are visible). `ghosts` points
    come: each uniformly placed in a ball of `GHOST_RADIUS` around a random marker of that frame, hidden ones included. A frame
    in which the recording has no marker at all gets no ghosts.

    Returns the clouds (m; their `columns` are all -1, they are anonymous) and the truth: (T, M) int, for each marker its
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
    haunted = np.take_along_axis(recording.positions, host[:, :, None], axis=1) + _in_ball((frames, host.shape[1]), rng) * GHOST_RADIUS

    points = np.concatenate([recording.positions, haunted], axis=1)
    there = np.concatenate([kept, np.repeat(count[:, None] > 0, host.shape[1], axis=1)], axis=1)
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
    return clouds, np.where(kept, _ranks(keys)[:, :markers], NULL)


def anonymous(clouds: Clouds) -> Recording:
    """Clouds as a recording of unlabelled columns *1, *2, ...: the n-th point of each frame lies in column n.

    Its own `clouds()` are the given ones, point for point, so a labelling of them fits `with_labelling`, and it can be written to a file.
    """
    counts = clouds.counts
    column = np.arange(len(clouds.xyz)) - np.repeat(clouds.offsets[:-1], counts)
    positions = np.full((len(clouds), int(counts.max(initial=0)), 3), np.nan)
    positions[np.repeat(np.arange(len(clouds)), counts), column] = clouds.xyz
    labels = tuple(f"*{i + 1}" for i in range(positions.shape[1]))
    return Recording(positions, labels, clouds.rate, clouds.vertical)


def _ranks(keys: Floats) -> Ints:
    """(T, N) the place of each key in its sorted row."""
    return np.argsort(np.argsort(keys, axis=1), axis=1).astype(np.int64)


def _in_ball(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """(T, G, 3) points uniform in the unit ball."""
    direction = rng.normal(size=(*shape, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    return direction * np.cbrt(rng.random((*shape, 1)))
