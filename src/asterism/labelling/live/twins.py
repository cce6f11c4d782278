"""Labelled frames of a stream in, now and then; how far ahead of the body's twins the labels are, and what they may be as certain as, out.

A labelling that explains a frame poorly has nearly all twins near it. To refine them all would keep one push waiting, so that only so many
are refined in one frame, and the next frame goes on with the others.
"""

from __future__ import annotations

import numpy as np

from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole.settings import TwinRules
from asterism.labelling.whole.turned import compare_with_twins, twin_limits, twins_held_against
from asterism.recording import NULL, Floats, Ints

NOT_COMPARED = 0.98
"""What no label is more certain than before it has been held against all twins once: below 0.99, from which a label is called sure."""


class LiveTwins:
    """Holds the labels of a stream against the body's twins, at most `refined` of them in a frame.

    lead  (M,) nats by which each marker is ahead of the best twin that has another point for it; None before all have been looked at
    """

    def __init__(self, labeller: BodyLabeller, refined: int) -> None:
        self._labeller, self._refined, self._rules = labeller, refined, TwinRules()
        self.restart()

    def restart(self) -> None:
        """Forget the labels."""
        self.lead: Floats | None = None
        self._labelled, self._begun_with, self._so_far = 0, 0, np.zeros(0)
        self._done = np.zeros(twins_held_against(self._labeller), dtype=np.bool_)

    def compare(self, xyz: Floats, point_of: Ints) -> Ints | None:
        """Hold a frame's labels (M,) against the next twins, xyz (n, 3) m, z up. Gives the best one that is ahead, (M,), or None."""
        labelled, points = int((point_of != NULL).sum()), np.arange(len(xyz))
        # labels that explain more have other twins, and fewer that come near
        if not self._done.any() or labelled > self._begun_with:
            self._begun_with, self._so_far = labelled, np.full(len(point_of), np.inf)
            self._done[:] = False
        offsets, label = np.array([0, len(xyz)]), marker_of(point_of, len(xyz))
        lead, twin = compare_with_twins(self._labeller, xyz, offsets, points, label, self._rules, self._refined, self._done)
        self._so_far = np.minimum(self._so_far, np.maximum(lead, 0.0))
        if self._done.all():
            self._done[:] = False
            mean = self._so_far if self.lead is None else 0.5 * (self.lead + self._so_far)
            mean = np.where(np.isfinite(mean), mean, self._so_far)
            # a frame that shows fewer of the same markers says less: it takes nothing back, and adds where it says more
            if self.lead is None or self._begun_with >= self._labelled:
                self.lead, self._labelled = mean, self._begun_with
            else:
                self.lead = np.maximum(self.lead, np.where(np.isfinite(mean), mean, 0.0))
        return None if twin is None else twin[0]

    def limits(self, markers: int) -> Floats:
        """What labels of each of so many markers may be as certain as, (M,)."""
        return np.full(markers, NOT_COMPARED) if self.lead is None else twin_limits(self.lead, np.arange(markers), self._rules)


def marker_of(point_of: Ints, points: int) -> Ints:
    """The marker of each point (n,), -1 for none, from the point of each marker (M,)."""
    marker = np.full(points, NULL, dtype=np.int64)
    marker[point_of[point_of >= 0]] = np.nonzero(point_of >= 0)[0]
    return marker
