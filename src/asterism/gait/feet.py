"""A recording with markers of any laboratory in; heels, toes and pelvis over time, and where the person heads, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from asterism.errors import NoGait
from asterism.geometry import rotate_z_up
from asterism.motion.clinical.landmark_body import plug_in_gait_names
from asterism.motion.filters import zero_lag_butterworth
from asterism.recording import Floats, Recording, plain_name
from asterism.recording.display import significant
from asterism.recording.marker_set import canonical, shipped_sets

SIDES = ("L", "R")
HEEL = (("HEE",), ("HEEL",), ("CAL",), ("LCA",), ("ANK",))
TOE = (("TOE",), ("MT2",), ("D2M",), ("MT1", "MT5"), ("D1M", "D5M"), ("FM", "VM"), ("MT5",), ("5TH",), ("D5M",))
"""Names after the side, best first; of two names the middle counts. Points and underscores in names do not. An ankle's marker serves where
a heel has none, see `Feet.ankles`."""
PELVIS = ("SACR", "LASI", "RASI", "LPSI", "RPSI", "LASIS", "RASIS", "LPSIS", "RPSIS")
RATE = 200.0
"""samples per second of all curves here, so that what follows does not depend on the cameras' rate."""
CUT_OFF = 15.0
"""Hz of the low-pass filter of feet: a strike lasts 30 ms. At half, hard strikes are told early; at double, noise shifts offs."""
PELVIS_CUT_OFF = 6.0
"""Hz of the filter of the pelvis, which goes up and down with the steps, three times a second in a run."""
TURNING = 0.8
"""Hz of the filter of the direction: nobody turns faster, and both feet together point where one heads."""


@dataclass(frozen=True)
class Feet:
    """Curves (T,) or (T, 3) at `RATE` from the recording's first frame, z up.

    heels, toes   m by side, in the room; pelvis (T, 3) m
    ahead         (T, 2) unit vectors, where the feet point on average
    leg_length    m, from the pelvis to the floor
    ankles        sides whose ankle's marker is taken for the heel's: it goes ahead as the heel does, and knocks and slaps less clearly
    noise         by side, what the noise of its markers makes of the heel's acceleration, m/s2, and of the foot's turning, rad/s
    """

    times: Floats
    heels: Mapping[str, Floats]
    toes: Mapping[str, Floats]
    pelvis: Floats
    ahead: Floats
    leg_length: float
    noise: Mapping[str, tuple[float, float]]
    ankles: frozenset[str] = frozenset()

    def forward(self, points: Floats) -> Floats:
        """(T,) m, how far points are ahead of the pelvis."""
        return np.asarray(((points - self.pelvis)[:, :2] * self.ahead).sum(axis=1))

    @property
    def backwards(self) -> bool:
        """Whether the pelvis goes back by more than a leg's length in all, and most of its way.

        A person who stands or walks on a treadmill goes less than half a leg length to and fro; a single step back is a third of it.
        """
        ways = (np.diff(self.pelvis[:, :2], axis=0) * self.ahead[1:]).sum(axis=1)
        return float(-ways.sum()) > max(self.leg_length, 0.5 * float(np.linalg.norm(np.diff(self.pelvis[:, :2], axis=0), axis=1).sum()))

    @property
    def sides(self) -> tuple[str, ...]:
        """Those with heel and toe."""
        return tuple(self.heels)


_SEEN = 10
"""Frames: a marker that is seen in fewer tells no foot."""


@dataclass(frozen=True)
class FootColumns:
    """Which columns are heels and toes by side, whose mean counts, and which are the pelvis'.

    heels, toes  of the sides that have both; pelvis  any of them; ankles  see `Feet.ankles`
    hidden       names that are there and not shown
    """

    heels: Mapping[str, list[int]]
    toes: Mapping[str, list[int]]
    pelvis: list[int]
    ankles: frozenset[str]
    hidden: tuple[str, ...]


def foot_columns(labels: Sequence[str], shown: NDArray[np.bool_]) -> FootColumns:
    """The feet by the names of all shipped sets; shown (M,) whether a column's marker is seen."""
    names = [plain_name(label).upper() for label in labels]
    # other spellings of the shipped sets
    other = [label.upper() for label in plug_in_gait_names(tuple(labels))]
    names = [new if new != old.upper() and new not in names else name for new, old, name in zip(other, labels, names, strict=True)]
    hidden = dict[str, None]()

    def column(name: str) -> int | None:
        at = names.index(name) if name in names else None
        if at is not None and not shown[at]:
            hidden[name] = None
            return None
        return at

    def first(side: str, choices: tuple[tuple[str, ...], ...]) -> list[int] | None:
        found = ([at for name in choice if (at := column(side + name)) is not None] for choice in choices)
        return next((own for own, choice in zip(found, choices, strict=True) if len(own) == len(choice)), None)

    feet = {side: (heel, toe) for side in SIDES if (heel := first(side, HEEL)) is not None and (toe := first(side, TOE)) is not None}
    pelvis = [at for name in PELVIS if (at := column(name)) is not None]
    ankles = frozenset(side for side in feet if all(column(side + name) is None for (name,) in HEEL[:-1]))
    heels, toes = ({side: pair[which] for side, pair in feet.items()} for which in (0, 1))
    return FootColumns(heels, toes, pelvis, ankles, tuple(hidden))


def markers_of_feet(labels: Sequence[str]) -> dict[str, list[int]]:
    """By side "L" and "R", the columns of all markers that stand on a foot by the shipped sets, or that `foot_columns` takes for it."""
    spelled = [canonical(plain_name(label)) for label in labels]
    names = [name.upper() for name in plug_in_gait_names(tuple(plain_name(label) for label in labels))]
    known = {name for choices in (HEEL, TOE) for choice in choices for name in choice}
    feet = _on_feet()
    return {
        side: [
            at
            for at, (name, spelling) in enumerate(zip(names, spelled, strict=True))
            if (name[:1] == side and name[1:] in known) or feet.get(spelling) == side
        ]
        for side in SIDES
    }


@cache
def _on_feet() -> Mapping[str, str]:
    """Spelling of a marker -> the side of the foot that it stands on."""
    sides = {"left foot": "L", "right foot": "R"}
    placed = [(name, markers, place) for markers in shipped_sets().values() for name, place in markers.places.items()]
    return {
        canonical(spelling): sides[place.segment]
        for name, markers, place in placed
        if place.segment in sides
        for spelling in (name, *markers.aliases.get(name, ()))
    }


def feet_of(recording: Recording) -> Feet:
    """The feet of a recording. Gaps are bridged; frames before the first sample of a marker repeat it. O(T).

    Raises NoGait where no foot has a marker of heel or ankle and one of the toes, or no marker of the pelvis is there.
    """
    positions = rotate_z_up(recording.positions, recording.vertical)
    columns = foot_columns(recording.labels, np.isfinite(positions[:, :, 0]).sum(axis=0) > _SEEN)
    hidden = columns.hidden
    feet = {side: (positions[:, columns.heels[side]].mean(axis=1), positions[:, columns.toes[side]].mean(axis=1)) for side in columns.heels}
    hips = [positions[:, column] for column in columns.pelvis]
    file = recording.metadata.get("file", "the recording")
    if hidden and not (feet and hips):
        raise NoGait(f"{file} shows {', '.join(hidden)} in ten frames or fewer; gait events need a longer recording of them.")
    if not feet:
        raise NoGait(
            f"{file} has no foot with a marker of heel or ankle and one of the toes (such as LHEE and LTOE); gait events need them."
        )
    if not hips:
        raise NoGait(f"{file} has no marker of the pelvis ({', '.join(PELVIS[:5])}); gait events need one.")
    times = np.arange(0.0, (len(recording) - 1) / recording.rate + 1e-9, 1.0 / RATE)
    # a speed needs a sample on either side
    if len(times) < 3:
        raise NoGait(f"{file} lasts {significant(len(recording) / recording.rate, 3)} s by its rate; gait events need steps.")
    parts = _smooth([part for pair in feet.values() for part in pair], recording.rate, times, CUT_OFF)
    smooth = dict(zip(feet, zip(parts[::2], parts[1::2], strict=True), strict=True))
    middle = np.nansum(hips, axis=0) / np.maximum(np.isfinite(hips).sum(axis=0), 1)
    middle[~np.isfinite(hips).any(axis=0)] = np.nan
    (pelvis,) = _smooth([middle], recording.rate, times, PELVIS_CUT_OFF)
    pointing = sum(toe - heel for heel, toe in smooth.values())[:, :2]  # type: ignore[index]
    ahead = _unit(zero_lag_butterworth(_unit(pointing), RATE, TURNING))
    heels, toes = ({side: pair[which] for side, pair in smooth.items()} for which in (0, 1))
    floor = min(float(np.percentile(heel[:, 2], 5)) for heel in heels.values())
    noise = {side: _noise(*pair, recording.rate) for side, pair in feet.items()}
    return Feet(times, heels, toes, pelvis, ahead, float(np.median(pelvis[:, 2])) - floor, noise, columns.ankles)


def _noise(heel: Floats, toe: Floats, rate: float) -> tuple[float, float]:
    """See `Feet.noise`: independent errors of the samples (F, 3), as third differences show them, behind the filter and a derivative.

    A foot stands for a quarter of the time at the least. The lower quarter of absolute values of a normal distribution ends at 0.32 of its
    deviation, and third differences have a variance of 20.
    """
    errors = []
    for points in (heel, toe):
        rough = np.abs(np.diff(points[:, 2], 3))
        rough = rough[np.isfinite(rough)]
        errors.append(float(np.percentile(rough, 25)) / 0.32 / 20**0.5 if len(rough) else 0.0)
    hertz = np.linspace(0.0, 0.5 * rate, 500)
    turning = 2 * np.pi * hertz / (1.0 + (hertz / CUT_OFF) ** 4)
    length = max(float(np.nanmedian(np.linalg.norm(toe - heel, axis=1))), 0.05)
    upwards = errors[0] * np.sqrt(np.mean((2 * np.pi * hertz * turning) ** 2))
    return float(upwards), float(np.hypot(errors[0], errors[1]) / length * np.sqrt(np.mean(turning**2)))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))


def _smooth(curves: Sequence[Floats], rate: float, times: Floats, cut_off: float) -> list[Floats]:
    """Curves (F, 3) each without gaps, filtered, at other times; all together."""
    frames, filled = np.arange(len(curves[0])), []
    for points in curves:
        known = np.isfinite(points).all(axis=1)
        filled += [np.interp(frames, frames[known], points[known, axis]) for axis in range(3)]
    smooth = CubicSpline(frames / rate, zero_lag_butterworth(np.stack(filled, axis=1), rate, cut_off), axis=0)(times)
    return np.split(smooth, len(curves), axis=1)
