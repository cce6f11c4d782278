"""What a force plate measured beside a recording of markers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording.arrays import Floats, Ints

LOADED = 20.0
"""N of vertical force from which a plate counts as loaded, as gait laboratories take it. Amplifiers drift by a few N; at half, drift is a
step, at double a strike is told a millisecond late."""
_STEP = 50.0
"""N, the load that a contact reaches, five kilograms: less is the drift of a plate. At half, old plates step; at double, no small child."""
_SHORTEST = 0.05
"""s, no foot stands or swings for less. At half, the shaking of a treadmill is a step; at double, quick steps of a child are none."""


@dataclass(frozen=True)
class ForcePlate:
    """Forces on a person from one plate, in the axes of the recording that it belongs to.

    number       of the plate in the file, from 1
    corners      (4, 3) m, of the surface
    force        (S, 3) N, on the person: upwards where somebody stands
    moment       (S, 3) N m, of that force about `centre`
    rate         samples per second; the first sample is at the recording's first frame
    vertical     (3,) up
    """

    number: int
    corners: Floats
    force: Floats
    moment: Floats
    rate: float
    vertical: Floats

    @property
    def centre(self) -> Floats:
        """(3,) m, the middle of the surface."""
        return np.asarray(self.corners.mean(axis=0))

    @cached_property
    def load(self) -> Floats:
        """(S,) N, the vertical force."""
        return np.asarray(self.force @ self.vertical)

    @cached_property
    def loaded(self) -> NDArray[np.bool_]:
        """(S,) whether somebody stands on it."""
        return np.asarray(self.load > LOADED)

    @cached_property
    def contacts(self) -> tuple[slice, ...]:
        """The runs of samples in which somebody stands on it, the next of which begins when the foot has left it."""
        edges, shortest = np.diff(np.concatenate([[0], self.loaded.astype(np.int8), [0]])), _SHORTEST * self.rate
        begins, ends = np.nonzero(edges > 0)[0], np.nonzero(edges < 0)[0]
        # A foot that comes back at once has not left.
        apart = begins[1:] - ends[:-1] >= shortest
        begins, ends = begins[np.concatenate([[True], apart])[: len(begins)]], ends[np.concatenate([apart, [True]])[: len(ends)]]
        runs = [slice(int(a), int(b)) for a, b in zip(begins, ends, strict=True) if b - a >= shortest]
        return tuple(run for run in runs if self.load[run].max() >= _STEP)

    @cached_property
    def pressure(self) -> Floats:
        """(S, 3) m, the centre of pressure on the surface; NaN where the plate is not loaded."""
        load = np.where(self.loaded, self.load, np.nan)[:, None]
        # About the centre of pressure the moment is along the vertical: v x M / F.
        return np.asarray(self.centre + np.cross(self.vertical, self.moment) / load + self._lean(load))

    def _lean(self, load: Floats) -> Floats:
        """(S, 3) m: none on a level surface; elsewhere as far as the surface rises towards the point."""
        flat = np.cross(self.vertical, self.moment) / load
        normal = np.cross(self.corners[1] - self.corners[0], self.corners[3] - self.corners[0])
        rise = -(flat @ normal) / float(normal @ self.vertical)
        return np.asarray(rise[:, None] * self.vertical)

    @property
    def free_moment(self) -> Floats:
        """(S,) N m about the vertical through the centre of pressure; NaN where the plate is not loaded."""
        arm = self.pressure - self.centre
        return np.asarray((self.moment - np.cross(arm, self.force)) @ self.vertical)

    def at(self, rate: float, frames: int) -> ForcePlate:
        """With as many samples as the recording has frames, each the mean of the samples of half a frame before and behind it.

        Samples that are not finite do not count; a frame without any other is NaN.

        Raises AsterismError where the plate has fewer samples than frames.
        """
        # Events, moments and the page ask for the same frames.
        known = self._at_frames.get((rate, frames))
        if known is not None:
            return known
        step = self.rate / rate
        if step < 0.999 or len(self.force) < frames * step - step:
            raise AsterismError(f"plate {self.number} has {len(self.force)} samples at {self.rate:g} Hz, too few for {frames} frames.")
        edges = np.round((np.arange(frames + 1) - 0.5) * step).astype(int)
        begins = np.clip(edges[:-1], 0, len(self.force) - 1)
        ends = np.clip(edges[1:], begins + 1, len(self.force))
        force, moment = (_means(values, begins, ends) for values in (self.force, self.moment))
        self._at_frames[rate, frames] = replace(self, force=force, moment=moment, rate=rate)
        return self._at_frames[rate, frames]

    @cached_property
    def _at_frames(self) -> dict[tuple[float, int], ForcePlate]:
        """What `at` has given."""
        return {}


def _means(values: Floats, begins: Ints, ends: Ints) -> Floats:
    """(F, 3) the means of the finite rows of values (S, 3) from each begin to before each end; NaN where there is none."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=1))
    # Sums over all samples before: one that is not finite would spoil each that follows.
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(np.where(known[:, None], values, 0.0), axis=0)])
    counts = np.concatenate([[0], np.cumsum(known)])
    many = (counts[ends] - counts[begins])[:, None]
    return np.where(many > 0, (sums[ends] - sums[begins]) / np.maximum(many, 1), np.nan)
