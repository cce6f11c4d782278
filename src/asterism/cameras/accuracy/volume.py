"""Words or a rig in; out comes the box in which measurements are wanted, and places all over it."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras.accuracy.sensitivity import sees
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.geometry import nearest_point_to_lines
from asterism.recording import Floats, as_vertical

_FARTHEST = 1e5
"""m from the origin."""


@dataclass(frozen=True)
class Volume:
    """A box along the world's axes: low and high corner, (3,) m."""

    low: Floats
    high: Floats

    def __post_init__(self) -> None:
        low, high = np.asarray(self.low, dtype=np.float64), np.asarray(self.high, dtype=np.float64)
        if low.shape != (3,) or high.shape != (3,) or not (np.abs([low, high]) < _FARTHEST).all() or np.any(high <= low):
            raise AsterismError(f"a volume from {low} to {high} m is no box; give a lower and a higher corner.")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    @classmethod
    def parse(cls, text: str, vertical: ArrayLike | str = "z") -> Volume:
        """From "6x4x2.5": width, depth and height in metres on the floor around the origin; or from "-3:3,-2:2,0:2.5" along x, y, z.

        vertical  the axis that points up, for the first way. Raises AsterismError for any other text, and where the vertical is oblique.

        >>> Volume.parse("6x4x2.5").low.tolist()
        [-3.0, -2.0, 0.0]
        >>> Volume.parse("-3:3,-2:2,0:2.5").size.tolist()
        [6.0, 4.0, 2.5]
        """
        spans = re.fullmatch(r"\s*([^:,]+):([^:,]+),([^:,]+):([^:,]+),([^:,]+):([^:,]+)\s*", text)
        sides = re.fullmatch(r"\s*([^x×]+)[x×]([^x×]+)[x×]([^x×]+)\s*", text)
        try:
            if spans:
                ends = [float(number) for number in spans.groups()]
                return cls(np.array(ends[::2]), np.array(ends[1::2]))
            if sides:
                width, depth, height = (float(number) for number in sides.groups())
                return cls._on_the_floor(width, depth, height, as_vertical(vertical))
        except ValueError:
            pass
        raise AsterismError(
            f"volume {text!r} is no box; give width x depth x height such as 6x4x2.5, or spans such as -3:3,-2:2,0:2.5 (m)."
        )

    @classmethod
    def _on_the_floor(cls, width: float, depth: float, height: float, up: Floats) -> Volume:
        axis = int(np.argmax(np.abs(up)))
        if abs(up[axis]) < 0.99:
            raise AsterismError("the rig's vertical is no axis of its world; give the volume as spans such as -3:3,-2:2,0:2.5.")
        low, high = np.empty(3), np.empty(3)
        flat = [i for i in range(3) if i != axis]
        low[flat], high[flat] = (-0.5 * width, -0.5 * depth), (0.5 * width, 0.5 * depth)
        low[axis], high[axis] = (0.0, height) if up[axis] > 0 else (-height, 0.0)
        return cls(low, high)

    @property
    def size(self) -> Floats:
        """(3,) m."""
        return self.high - self.low

    def axes(self, step: float) -> tuple[Floats, Floats, Floats]:
        """Coordinates along x, y and z, about `step` m apart, from the middle of the first cell to that of the last."""
        coordinates = []
        for low, size in zip(self.low, self.size, strict=True):
            count = max(1, round(size / step))
            coordinates.append(low + size * (np.arange(count) + 0.5) / count)
        return coordinates[0], coordinates[1], coordinates[2]

    def places(self, step: float) -> Floats:
        """(N, 3) m, the middles of cells of about `step` m; x changes slowest, z fastest."""
        return np.stack([part.ravel() for part in np.meshgrid(*self.axes(step), indexing="ij")], axis=1)


def lines_of_sight_meet(rig: Rig) -> Floats:
    """(3,) m: the place that is nearest to all cameras' lines of sight, in the sense of least squares."""
    eyes = np.stack([camera.position for camera in rig])
    ahead = np.stack([camera.rotation[2] for camera in rig])
    return nearest_point_to_lines(eyes, ahead)


def volume_of(rig: Rig, least: int = 3) -> Volume:
    """The box around what at least `least` cameras see (all of them where there are fewer), 90 % of it along each axis.

    It is rounded to 0.1 m, of small rigs to less.

    Places are tried around where the lines of sight meet; where the vertical is an axis of the world and all cameras stand above 0, the
    box starts at the floor. Raises AsterismError where so many cameras see no place in common, or an image size is not known.
    """
    least = min(least, len(rig))
    middle = lines_of_sight_meet(rig)
    eyes = np.stack([camera.position for camera in rig])
    reach = float(np.median(np.linalg.norm(eyes - middle, axis=1)))
    places = Volume(middle - reach, middle + reach).places(reach / 16)
    if rig.vertical is not None and (eyes @ rig.vertical).min() > 0:
        places = places[places @ rig.vertical > 0]
    common = places[sees(rig, places).sum(axis=0) >= least]
    if len(common) < 8:
        raise AsterismError(f"no volume is seen by {least} cameras of the rig at once; turn them to one place, or give --volume.")
    low, high = np.percentile(common, 5, axis=0), np.percentile(common, 95, axis=0)
    if rig.vertical is not None and (eyes @ rig.vertical).min() > 0 and np.abs(rig.vertical).max() > 0.99:
        axis = int(np.argmax(np.abs(rig.vertical)))
        if rig.vertical[axis] > 0:
            low[axis] = 0.0
        else:
            high[axis] = 0.0
    unit = min(0.1, 10.0 ** np.floor(np.log10((high - low).min() / 10)))
    return Volume(np.round(np.floor(low / unit) * unit, 9), np.round(np.ceil(high / unit) * unit, 9))
