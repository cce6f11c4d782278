"""A contact with a force plate and the markers of both feet in; which foot bore the load, out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from asterism.recording.arrays import Floats
from asterism.recording.force_plate import ForcePlate

BOTH, NOBODY = "both", "nobody"
"""Feet that no single side bears: both at once, or none whose markers are known."""
_SAMPLES = 60
"""Samples of a contact that are looked at."""
_LOW = 0.2
"""m above the lowest marker up to which a marker is of a foot that stands. At half, an ankle's is none; at double, a child's knee is."""
_SOLE = 0.09
"""m: the centre of pressure is nearer than that to the line between two markers of a foot that bears it alone: half the width of a sole,
and what corners of plates and markers are off. At half, one of five steps at hand is of no foot; at double, two feet are one."""
_LENGTH = 0.3
"""m, how far a single marker of the foot that stands may be, and that within which feet are known at all: the length of a foot. At half, an
ankle's marker is too far at push-off; at double, the other foot's markers are near."""
_BEYOND = 0.4
"""Of the line between the two low markers that are farthest apart, how far the foot may reach beyond either: toes lie ahead of their
marker. At half, a step that ends on the toes is of no foot by its last part; at double, the next foot on the plate is this one."""
_ALONE = 0.7
"""Share of the load that is under one foot where it stands alone: the other passes it, but bears nothing. At 0.5 any two feet on one plate
are one foot; at 0.9 many single steps are two feet."""


def foot_on(plate: ForcePlate, contact: slice, feet: Mapping[str, Floats], rate: float) -> str:
    """The side of `feet` whose foot alone bore a contact of a plate, else `BOTH` or `NOBODY`. O(1).

    feet  by side: positions (F, M, 3) m of markers of that side from the plate's first sample on; NaN where a
          marker is not seen
    rate  of these positions, per second
    """
    some = np.unique(np.linspace(contact.start, contact.stop - 1, _SAMPLES).round().astype(np.int64))
    frames = np.round(some / plate.rate * rate).astype(np.int64)
    feet = {side: points for side, points in feet.items() if points.shape[1]}
    inside = plate.loaded[some] & (frames < min((len(points) for points in feet.values()), default=0))
    some, frames = some[inside], frames[inside]
    if not len(some):
        return NOBODY
    load, pressure = plate.load[some], plate.pressure[some]
    apart = {side: _apart(points[frames], pressure, plate.vertical) for side, points in feet.items()}
    known = np.min([far for far, _ in apart.values()], axis=0) < _LENGTH
    if load[known].sum() <= 0.5 * load.sum():
        return NOBODY
    for side, (far, reach) in apart.items():
        others = np.min([np.full(len(some), np.inf), *(other for name, (other, _) in apart.items() if name != side)], axis=0)
        # Where pressure or markers are off by more than a sole, the foot that is by far the nearer one bears it.
        under = ((far < reach) & (far <= others)) | ((far < _LENGTH) & (2 * far < others))
        # By the load: the first and last samples of a contact say least, and their centre of pressure is the least exact.
        if load[known & under].sum() >= _ALONE * load[known].sum():
            return side
    return BOTH


def _apart(points: Floats, pressure: Floats, vertical: Floats) -> tuple[Floats, Floats]:
    """(S,) m along the plate from the centre of pressure (S, 3) to the foot of markers (S, M, 3), and how far it may be under that foot."""
    heights = points @ vertical
    # belts and steps stand higher than their plates: the foot's own lowest marker tells where it stands
    low = np.nanmin(heights, initial=np.inf) + _LOW
    arms = points - pressure[:, None]
    flat = arms - (arms @ vertical)[..., None] * vertical
    flat[~(heights < low)] = np.nan
    far = np.fmin.reduce(np.linalg.norm(flat, axis=2), axis=1, initial=np.inf)
    lengths = np.linalg.norm(flat[:, :, None] - flat[:, None], axis=3)
    lengths[~(lengths < _LENGTH)] = 0.0
    every, count = np.arange(len(points)), points.shape[1]
    one, other = np.divmod(lengths.reshape(len(points), -1).argmax(axis=1), count)
    line = lengths[every, one, other] > 0.0
    begin, along = flat[every, one], flat[every, other] - flat[every, one]
    square = np.maximum(np.einsum("sa,sa->s", along, along), 1e-9)
    share = np.clip(-np.einsum("sa,sa->s", begin, along) / square, -_BEYOND, 1.0 + _BEYOND)
    off = np.linalg.norm(begin + share[:, None] * along, axis=1)
    return np.where(line, off, far), np.where(line, _SOLE, _LENGTH)
