"""Simulated clouds with known truth in; the same clouds with points that are no markers, of chosen life and place, out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Floats, Ints, MarkerSet, Recording

CROSSING_SPEED = 1.2
"""m/s of a point that moves across the volume, about that of a second person who walks by."""


@dataclass(frozen=True)
class Clutter:
    """Points that are no markers.

    per_frame  how many there are in a frame on average; how many begin in a frame is Poisson distributed
    life       frames that each is there; None for all frames of the recording
    place      "beside": at a normally distributed offset from a random marker in view, with which it moves; "fixed": uniform in the
               box that the markers pass, and at rest, as a reflection; "crossing": through a uniform place of the box at
               `CROSSING_SPEED` along a random horizontal line, as another person's marker
    spread     m, standard deviation along each axis of the offset from the marker

    Raises AsterismError where a number is negative or infinite, the life is no whole number from 1, or there is no such place.
    """

    per_frame: float
    life: int | None = 1
    place: Literal["beside", "fixed", "crossing"] = "beside"
    spread: float = 0.08

    def __post_init__(self) -> None:
        whole = self.life is None or (isinstance(self.life, int | np.integer) and self.life >= 1)
        if not (whole and 0 <= self.per_frame < np.inf and 0 <= self.spread < np.inf):
            raise AsterismError(
                f"clutter of {self.per_frame} points in a frame that live for {self.life} frames {self.spread} m away cannot be drawn; "
                "give finite numbers from 0, and a life of 1, 2, ... frames."
            )
        if self.place not in ("beside", "fixed", "crossing"):
            raise AsterismError(f"there is no place {self.place!r} for clutter; choose beside, fixed or crossing.")


def add_clutter(
    recording: Recording, clouds: Clouds, truth: Ints, clutter: Clutter, seed: int | np.random.Generator = 0
) -> tuple[Clouds, Ints]:
    """Add points that are no markers to simulated clouds.

    recording: whose clouds these are; clouds and truth (T, M) as `simulate_gaps_and_ghosts` gives them. Returns both with the clutter. A
    point beside a marker is there wherever the recording shows the marker, hidden or not. The points of each frame are in random order.
    Where the clouds have track numbers, each point of the clutter has a number for all its frames, and all numbers are drawn anew: they
    do not tell what a track is. O(P log P) for P points.
    Raises AsterismError where recording, clouds and truth are not of the same frames and markers.
    """
    if not len(recording) == len(clouds) == len(truth) or truth.shape != recording.visible.shape:
        raise AsterismError(
            f"the recording has {len(recording)} frames of {len(recording.labels)} markers, its clouds have {len(clouds)} frames and the "
            f"truth has the shape {truth.shape}; give those of one recording."
        )
    rng = np.random.default_rng(seed)
    xyz, frame, ghost = _clutter_points(recording, truth, clutter, rng)
    before = len(clouds.xyz)
    frame_of = np.concatenate([clouds.frame_of, frame])
    order = np.lexsort((rng.random(len(frame_of)), frame_of))
    offsets = np.concatenate([[0], np.cumsum(np.bincount(frame_of, minlength=len(clouds)))]).astype(np.int64)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order)) - offsets[frame_of[order]]
    shown = truth != NULL
    moved = truth.copy()
    moved[shown] = place[:before][(clouds.offsets[:-1, None] + truth)[shown]]
    tracks = None
    if clouds.tracks is not None:
        tracks = _numbered_anew(np.concatenate([clouds.tracks, clouds.tracks.max(initial=-1) + 1 + ghost]), rng)[order]
    columns = np.concatenate([clouds.columns, np.full(len(xyz), -1, dtype=np.int64)])[order]
    return replace(clouds, xyz=np.concatenate([clouds.xyz, xyz])[order], offsets=offsets, columns=columns, tracks=tracks), moved


def displace_marker(
    recording: Recording,
    marker_set: MarkerSet,
    metres: tuple[float, float] = (0.02, 0.10),
    seed: int | np.random.Generator = 0,
) -> tuple[Recording, str]:
    """A marker that is worn oddly: one marker of a segment, displaced along the segment in all frames.

    recording: T frames whose columns carry names of the set. A random marker of a segment of two markers or more is moved along the line
    to another random marker of that segment, towards it or away from it, by a distance (m) drawn uniformly from `metres`; along that line
    it keeps its distance, so that it moves with the segment. Its name stays: it is still the marker. Where the other marker is missing,
    so is the displaced one.
    Returns the recording and the name of the marker. O(T).
    Raises AsterismError where no two markers of a segment are columns of the recording, or the distances are not a range from 0.
    """
    least, most = metres
    if not 0 <= least <= most < np.inf:
        raise AsterismError(f"a marker cannot be displaced by {least} to {most} m; give the least and the most, from 0.")
    columns = {name: int(column) for name, column in zip(marker_set.names, marker_set.columns_of(recording.labels), strict=True)}
    lines = [
        (one, other)
        for segment in marker_set.segments.values()
        for one in segment
        for other in segment
        if one != other and columns[one] >= 0 and columns[other] >= 0
    ]
    if not lines:
        raise AsterismError("the recording has no two markers of one segment; give a marker set with segments, and its columns.")
    rng = np.random.default_rng(seed)
    names = sorted({one for one, _ in lines})
    name = names[int(rng.integers(len(names)))]
    others = [other for one, other in lines if one == name]
    other = others[int(rng.integers(len(others)))]
    distance = rng.uniform(least, most) * (1 if rng.random() < 0.5 else -1)
    positions = recording.positions.copy()
    along = positions[:, columns[other]] - positions[:, columns[name]]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    positions[:, columns[name]] += distance * along / np.where(length > 0, length, np.nan)
    return replace(recording, positions=positions), name


def _numbered_anew(tracks: Ints, rng: np.random.Generator) -> Ints:
    """The same tracks under numbers from 0 in random order; -1, for none, stays."""
    names, at = np.unique(tracks, return_inverse=True)
    numbers = np.full(len(names), -1, dtype=np.int64)
    numbers[names >= 0] = rng.permutation(int((names >= 0).sum()))
    return np.asarray(numbers[at])


def _clutter_points(recording: Recording, truth: Ints, clutter: Clutter, rng: np.random.Generator) -> tuple[Floats, Ints, Ints]:
    """The points (Q, 3) in m, the frame of each and the number of its ghost."""
    frames, markers = truth.shape
    if not frames or not markers:
        return np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    if clutter.life is None:
        first = np.zeros(rng.poisson(clutter.per_frame), dtype=np.int64)
        last = first + frames
    else:
        # as many begin in each of the frames in which one may begin to reach into the recording
        beginning = rng.poisson(clutter.per_frame / clutter.life * (frames + clutter.life - 1))
        first = rng.integers(1 - clutter.life, frames, beginning)
        last = first + clutter.life
    begin, end = np.maximum(first, 0), np.minimum(last, frames)
    ghost = np.repeat(np.arange(len(begin)), end - begin)
    frame = np.arange(len(ghost)) - np.repeat(np.cumsum(end - begin) - end, end - begin)
    if clutter.place == "beside":
        xyz = _beside(recording, truth, begin, ghost, frame, clutter.spread, rng)
    else:
        seconds = (frame - 0.5 * (first + last - 1)[ghost]) / recording.rate
        xyz = _in_box(recording, len(begin), ghost, seconds, CROSSING_SPEED if clutter.place == "crossing" else 0.0, rng)
    there = ~np.isnan(xyz[:, 0])
    return xyz[there], frame[there], ghost[there]


def _beside(recording: Recording, truth: Ints, begin: Ints, ghost: Ints, frame: Ints, spread: float, rng: np.random.Generator) -> Floats:
    """Points (Q, 3) that move with a marker in view when they begin, NaN where the recording does not show it."""
    shown = (truth != NULL)[begin]
    host = np.argmax(np.where(shown, rng.random(shown.shape), -1.0), axis=1)
    offset = rng.normal(0.0, spread, (len(begin), 3))
    offset[~shown.any(axis=1)] = np.nan
    return np.asarray(recording.positions[frame, host[ghost]] + offset[ghost])


def _in_box(recording: Recording, ghosts: int, ghost: Ints, seconds: Floats, speed: float, rng: np.random.Generator) -> Floats:
    """Points (Q, 3) that move at `speed` (m/s) along a horizontal line through a place of the box that all markers lie in.

    seconds (Q,): from the middle of the ghost's life, when it is at that place. NaN where the recording shows no marker.
    """
    shown = recording.positions[recording.visible]
    if not len(shown):
        return np.full((len(ghost), 3), np.nan)
    middle = rng.uniform(shown.min(axis=0), shown.max(axis=0), (ghosts, 3))
    direction = rng.normal(size=(ghosts, 3))
    direction -= (direction @ recording.vertical)[:, None] * recording.vertical
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(middle[ghost] + direction[ghost] * speed * seconds[:, None])
