"""Simulated clouds with known truth in; the same clouds with points that are no markers, of chosen life and place, out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Floats, Ints, Recording

CROSSING_SPEED = 1.2
"""m/s of a point that moves across the volume, about that of a second person who walks by."""


@dataclass(frozen=True)
class Clutter:
    """Points that are no markers.

    per_frame  how many there are in a frame on average; how many begin in a frame is Poisson distributed
    life       frames that each is there; None for all frames of the recording
    place      "beside": at a normally distributed offset from a random marker in view, with which it moves; "fixed": uniform in the
               volume that the markers pass, and at rest, as a reflection; "crossing": through a uniform place in the volume at
               `CROSSING_SPEED` along a random horizontal line, as another person's marker
    spread     m, standard deviation along each axis of the offset from the marker
    """

    per_frame: float
    life: int | None = 1
    place: Literal["beside", "fixed", "crossing"] = "beside"
    spread: float = 0.08

    def __post_init__(self) -> None:
        if not 0 <= self.per_frame < np.inf or (self.life is not None and self.life < 1) or not 0 <= self.spread < np.inf:
            raise AsterismError(
                f"clutter of {self.per_frame} points in a frame that live for {self.life} frames {self.spread} m away cannot be drawn; "
                "give numbers from 0, and a life of at least 1 frame."
            )
        if self.place not in ("beside", "fixed", "crossing"):
            raise AsterismError(f"there is no place {self.place!r} for clutter; choose beside, fixed or crossing.")


def add_clutter(
    recording: Recording, clouds: Clouds, truth: Ints, clutter: Clutter, seed: int | np.random.Generator = 0
) -> tuple[Clouds, Ints]:
    """Add points that are no markers to simulated clouds.

    recording: whose clouds these are; clouds and truth (T, M) as `simulate_gaps_and_ghosts` gives them. Returns both with the clutter. The
    points of each frame are in random order; where the clouds have track numbers, each point of the clutter has a number of its own for
    all its frames. O(P log P) for P points.
    Raises AsterismError where recording, clouds and truth are of different numbers of frames.
    """
    if not len(recording) == len(clouds) == len(truth):
        raise AsterismError(
            f"the recording, its clouds and their truth have {len(recording)}, {len(clouds)} and {len(truth)} frames; give those of one."
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
        tracks = np.concatenate([clouds.tracks, clouds.tracks.max(initial=-1) + 1 + ghost])[order]
    columns = np.concatenate([clouds.columns, np.full(len(xyz), -1, dtype=np.int64)])[order]
    return replace(clouds, xyz=np.concatenate([clouds.xyz, xyz])[order], offsets=offsets, columns=columns, tracks=tracks), moved


def _clutter_points(recording: Recording, truth: Ints, clutter: Clutter, rng: np.random.Generator) -> tuple[Floats, Ints, Ints]:
    """The points (Q, 3) in m, the frame of each and the number of its ghost."""
    frames = len(recording)
    life = frames if clutter.life is None else clutter.life
    starts = np.arange(1) if clutter.life is None else np.arange(1 - life, frames)
    rate = clutter.per_frame if clutter.life is None else clutter.per_frame / life
    begin = np.repeat(starts, rng.poisson(rate, len(starts)))
    ghost = np.repeat(np.arange(len(begin)), life)
    frame = np.repeat(begin, life) + np.tile(np.arange(life), len(begin))
    if clutter.place == "beside":
        xyz = _beside(recording, truth, begin, ghost, frame, clutter.spread, rng)
    else:
        xyz = _in_volume(recording, begin, ghost, frame, CROSSING_SPEED if clutter.place == "crossing" else 0.0, rng)
    there = (frame >= 0) & (frame < frames)
    there[there] = ~np.isnan(xyz[there, 0])
    return xyz[there], frame[there], ghost[there]


def _beside(recording: Recording, truth: Ints, begin: Ints, ghost: Ints, frame: Ints, spread: float, rng: np.random.Generator) -> Floats:
    """Points (Q, 3) that move with a marker in view, NaN where the recording does not show it."""
    frames = len(recording)
    shown = (truth != NULL)[np.clip(begin, 0, frames - 1)]
    host = np.argmax(np.where(shown, rng.random(shown.shape), -1.0), axis=1) if shown.size else np.zeros(len(begin), dtype=np.int64)
    offset = rng.normal(0.0, spread, (len(begin), 3))
    offset[~shown.any(axis=1)] = np.nan
    return np.asarray(recording.positions[np.clip(frame, 0, frames - 1), host[ghost]] + offset[ghost])


def _in_volume(recording: Recording, begin: Ints, ghost: Ints, frame: Ints, speed: float, rng: np.random.Generator) -> Floats:
    """Points (Q, 3) that move at `speed` (m/s) along a horizontal line through the box that all markers of the recording lie in."""
    shown = recording.positions[recording.visible]
    if not len(shown):
        return np.full((len(frame), 3), np.nan)
    start = rng.uniform(shown.min(axis=0), shown.max(axis=0), (len(begin), 3))
    direction = rng.normal(size=(len(begin), 3))
    direction -= (direction @ recording.vertical)[:, None] * recording.vertical
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # a point that is there all the time is at its place in the middle of the recording
    centre = 0.5 * (frame.max(initial=0) + frame.min(initial=0)) if len(begin) and (begin == begin[0]).all() else begin[ghost]
    return np.asarray(start[ghost] + direction[ghost] * speed * ((frame - centre) / recording.rate)[:, None])
