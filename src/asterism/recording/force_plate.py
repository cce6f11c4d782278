"""A force plate and what it measured; when something stands on it, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.recording.arrays import Floats

UNLOADED = 20.0
"""N, the force out of the surface below which nothing is known to stand on a plate, as gait laboratories have it. The centre of pressure is
a moment divided by this force. At half of it the noise of older plates stands on them; at double the first and last hundredth of a second
of a step is missing."""


SOMEBODY = 50.0
"""N, the force from which somebody stands on a plate, and it is not its drift: five kilograms. At half, the drift of older plates counts as
somebody; at double, a small child does not."""

SHORTEST = 0.05
"""s, no foot stands or swings for less. At half, the shaking of a treadmill is a step; at double, quick steps of a child are none."""


@dataclass(frozen=True)
class ForcePlate:
    """A force plate in the axes of its recording, and the load on it over time: what the plate does to the body.

    corners    (4, 3) m, of the surface, in their order about it
    normal     (3,) unit vector out of the surface
    rate       samples per second
    start      s, the time of the first sample on the recording's clock
    forces     (S, 3) N
    pressures  (S, 3) m, the centre of pressure on the surface, NaN where the force out of it is below `UNLOADED`
    moments    (S, 3) N m, the free moment: about the normal, at the centre of pressure; NaN as there
    """

    corners: Floats
    normal: Floats
    rate: float
    start: float
    forces: Floats
    pressures: Floats
    moments: Floats

    @property
    def centre(self) -> Floats:
        """(3,) m, the middle of the surface."""
        return np.asarray(self.corners.mean(axis=0))

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(S,) bool, where something is known to stand on it."""
        return np.isfinite(self.pressures[:, 0])

    @property
    def times(self) -> Floats:
        """(S,) s, on the recording's clock."""
        return self.start + np.arange(len(self.forces)) / self.rate

    def contacts(self) -> list[slice]:
        """The runs of samples in which somebody stands on it, the next of which begins when the foot has left it."""
        edges, load = np.diff(np.concatenate([[0], self.loaded.astype(np.int8), [0]])), self.forces @ self.normal
        begins, ends = np.nonzero(edges > 0)[0], np.nonzero(edges < 0)[0]
        # A foot that comes back at once has not left.
        apart = begins[1:] - ends[:-1] >= SHORTEST * self.rate
        begins, ends = begins[np.concatenate([[True], apart])[: len(begins)]], ends[np.concatenate([apart, [True]])[: len(ends)]]
        runs = [slice(int(a), int(b)) for a, b in zip(begins, ends, strict=True) if b - a >= SHORTEST * self.rate]
        return [run for run in runs if load[run].max() >= SOMEBODY]

    def on_surface(self, points: Floats, beyond: float = 0.0) -> NDArray[np.bool_]:
        """(N,) bool, whether points (N, 3) in m lie over the surface, or at most `beyond` m outside its edges."""
        one, other = self.corners[0] - self.corners[1], self.corners[1] - self.corners[2]
        inside = np.ones(len(points), dtype=np.bool_)
        for side in (one, other):
            length = float(np.linalg.norm(side))
            inside &= np.abs((points - self.centre) @ (side / length)) <= 0.5 * length + beyond
        return inside
