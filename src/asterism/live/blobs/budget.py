"""How long points took to make in; how many blobs of an image there is time for, and which these are, out."""

from __future__ import annotations

import math

import numpy as np

from asterism.recording import Floats, Ints

_SHARE = 0.8
"""Share of a frame's period that making its points may take, before blobs are left out. With all of it a frame that takes longer delays
those after it; half of it leaves blobs out that there was time for."""
_FEWEST = 100
"""Blobs of an image that are used in any case: a suit of markers. Half of them cuts a person with clusters and hands; with twice as many a
machine that is too slow takes four times as long for a frame."""
_FORGETS = 0.1
"""Share by which a frame's cost moves what is believed of it: a pause of the system is forgotten in ten frames, as a person is found again.
Half of it finds a person twice as late; with twice as much one pause costs blobs."""


class BlobBudget:
    """How many blobs of each image there is time for, by what the last frames took.

    rate: frames per second; NaN for no bound. Pairs of blobs grow with the square of an image's blobs, and so does the time.

    >>> budget = BlobBudget(100.0)
    >>> for _ in range(100):
    ...     budget.spent(200, 0.004)
    >>> budget.most
    282
    """

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._cost = 0.0

    def spent(self, blobs: int, seconds: float) -> None:
        """A frame whose fullest image had so many blobs took so long."""
        if blobs:
            self._cost += _FORGETS * (seconds / max(blobs, _FEWEST // 2) ** 2 - self._cost)

    @property
    def most(self) -> int | None:
        """Blobs of an image that there is time for; None where that is not known."""
        if not (self._cost > 0 and math.isfinite(self._period)):
            return None
        return max(_FEWEST, int(math.sqrt(_SHARE * self._period / self._cost)))


def telling(xy: Floats, sizes: Floats, places: Floats, most: int) -> Ints:
    """Which blobs of an image to use where there are too many: at most `most`, in their order.

    xy (n, 2) px; sizes (n,) px, NaN where unknown; places (p, 2) px, where the points of the last frame show. First the blob nearest to
    each place, since a flood of reflections must not take the person away; then the largest. O(n p).
    """
    places = places[np.isfinite(places).all(axis=1)]
    near = np.empty(0, dtype=np.int64)
    if len(places):
        apart = np.hypot(xy[:, None, 0] - places[None, :, 0], xy[:, None, 1] - places[None, :, 1])
        near = np.unique(apart.argmin(axis=0))[:most]
    by_size = np.argsort(-np.nan_to_num(sizes), kind="stable")
    rest = by_size[~np.isin(by_size, near)]
    return np.sort(np.concatenate([near, rest[: most - len(near)]]))
