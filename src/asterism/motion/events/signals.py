"""Markers by the names of a movement's rules in; curves such as heights, angles and speeds over time out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.motion.events.rules import MovementRules, SignalRule
from asterism.motion.filters import zero_lag_butterworth
from asterism.motion.rigid.rotations import unit_vectors
from asterism.recording import Floats, Recording, canonical, plain_name

Key = tuple[str, str]
"""A name of the rules, and the side that it is of: "L", "R" or ""."""
_FEWEST = 10
"""Frames in which a marker has to be seen: fewer show no movement."""


@dataclass(frozen=True)
class Places:
    """The markers that the rules name.

    raw       (T, 3) m, z up, gaps bridged by straight lines
    seen      (T,) whether it was there; frames beside a gap, as many as it has, show the line across it and count as the gap does
    filtered  (T, 3) m
    noise     (3,) m, standard deviation of a coordinate in a frame
    missing   the names of which nothing is worn
    """

    raw: Mapping[Key, Floats]
    seen: Mapping[Key, NDArray[np.bool_]]
    filtered: Mapping[Key, Floats]
    noise: Mapping[Key, Floats]
    missing: tuple[str, ...]

    def drawn(self, rng: np.random.Generator, rate: float, cut_off: float) -> dict[Key, Floats]:
        """As another recording of the same movement would show them, filtered by another cut-off."""
        return {
            key: zero_lag_butterworth(path + self.noise[key] * rng.standard_normal(path.shape), rate, cut_off)
            for key, path in self.filtered.items()
        }


def places_of(recording: Recording, rules: MovementRules, given: Mapping[str, str]) -> Places:
    """The markers of a recording. given: names of the rules -> labels, which go before the rules' own.

    Raises AsterismError where `given` names what is not there.
    """
    labels = {plain_name(label): column for column, label in reversed(list(enumerate(recording.labels)))}
    for name, label in given.items():
        if name not in rules.markers:
            raise AsterismError(f"--marker {name}={label}: {name} is no marker of these rules; theirs are {', '.join(rules.markers)}.")
        if canonical(label) not in labels:
            raise AsterismError(f"--marker {name}={label}: {recording.metadata.get('file', 'the recording')} has no marker {label}.")
    positions = rotate_z_up(recording.positions, recording.vertical)
    raw, seen, filtered, noise, missing = {}, {}, {}, {}, []
    for name, choices in rules.markers.items():
        for side in ("L", "R") if any("{side}" in choice for choice in choices) else ("",):
            own = (given[name],) if name in given else choices
            path = next((found for choice in own if (found := _path(positions, labels, choice.replace("{side}", side))) is not None), None)
            if path is None:
                missing.append(f"{name} of the {'left' if side == 'L' else 'right'}" if side else name)
                continue
            key, known = (name, side), np.asarray(np.isfinite(path).all(axis=1))
            frames = np.arange(len(path))
            raw[key] = np.stack([np.interp(frames, frames[known], path[known, axis]) for axis in range(3)], axis=1)
            seen[key] = _beside_no_gap(known)
            filtered[key] = zero_lag_butterworth(raw[key], recording.rate, rules.cut_off)
            # What the filter takes off is noise above its cut-off; the median does not see fast movement that it takes off, too.
            taken = np.abs(raw[key] - filtered[key])[known]
            above = max(1.0 - 2.0 * rules.cut_off / recording.rate, 0.1)
            noise[key] = 1.4826 * np.median(taken, axis=0) / np.sqrt(above)
    return Places(raw, seen, filtered, noise, tuple(missing))


def _path(positions: Floats, labels: Mapping[str, int], choice: str) -> Floats | None:
    """(T, 3) of "A" or the middle of "A+B"; None where one is not worn."""
    columns = [labels.get(canonical(label)) for label in choice.split("+")]
    known = [column for column in columns if column is not None]
    if len(known) < len(columns) or not known:
        return None
    path: Floats = positions[:, known].mean(axis=1)
    return path if np.isfinite(path).all(axis=1).sum() >= _FEWEST else None


def _beside_no_gap(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    out = known.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(int)))
    for begin, end in edges.reshape(-1, 2).tolist():
        out[max(2 * begin - end, 0) : 2 * end - begin] = False
    return out


def keys_of(signal: SignalRule, rules: MovementRules, side: str) -> list[Key]:
    """The markers of a signal of one side of the movement."""
    names = (*signal.markers, signal.relative) if signal.relative else signal.markers
    own = signal.side or side
    return [(name, own if any("{side}" in choice for choice in rules.markers[name]) else "") for name in names]


def way_ahead(path: Floats) -> Floats:
    """(3,) the horizontal direction along which a path goes farthest, the way that it ends."""
    flat = path[:, :2] - path[:, :2].mean(axis=0)
    way = np.linalg.svd(flat, full_matrices=False)[2][0]
    way = way if (path[-1, :2] - path[0, :2]) @ way >= 0 else -way
    return np.array([way[0], way[1], 0.0])


def signal_curve(signal: SignalRule, paths: list[Floats], rate: float, ahead: Floats | None) -> Floats:
    """(T,) in the signal's unit, see `SignalRule`."""
    first = paths[0]
    if signal.kind == "along":
        way = np.array([0.0, 0.0, 1.0]) if ahead is None else ahead
        return np.asarray((first - paths[1] if signal.relative else first) @ way)
    if signal.kind == "distance":
        return np.asarray(np.linalg.norm(paths[1] - first, axis=1))
    if signal.kind == "speed":
        return np.asarray(np.linalg.norm(np.gradient(first, axis=0), axis=1) * rate)
    if signal.kind == "bend":
        before, behind = unit_vectors(paths[1] - first), unit_vectors(paths[2] - paths[1])
        return np.degrees(np.arctan2(np.linalg.norm(np.cross(before, behind), axis=1), (before * behind).sum(axis=1)))
    if signal.kind == "lean":
        line = paths[1] - first
        return np.degrees(np.arctan2(np.linalg.norm(line[:, :2], axis=1), line[:, 2]))
    if signal.kind == "turn":
        line = paths[1] - first
        return np.degrees(np.unwrap(np.arctan2(line[:, 1], line[:, 0])))
    line = unit_vectors(paths[1] - first)
    return np.degrees(np.linalg.norm(np.cross(line, np.gradient(line, axis=0)), axis=1) * rate)
