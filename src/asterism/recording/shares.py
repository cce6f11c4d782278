"""A labelling and its clouds in; what became of each marker in each frame, and the shares of that, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.recording.clouds import Clouds, Labelling

SURE = 0.99
"""Confidence from which a marker counts as labelled, and is believed to be hidden. Below it, one in a hundred or more is expected to be
wrong. At half of it a guess would count as labelled; nothing is twice as sure."""


LABEL_STATES = ("labelled", "likely", "unsure", "hidden")
"""What becomes of a marker in a frame; see `LabelStates`."""


@dataclass(frozen=True)
class LabelStates:
    """What became of each marker in each frame: (T, M) bool each, of which exactly one holds.

    labelled  a point got the marker's name, with a confidence of 99 % or more
    likely    a point got it, with less confidence, or with one that is not known
    unsure    no point got it, and one of the frame's points without a name may be the marker
    hidden    no point got it, and none is left that may be the marker: every point of the frame has a name, or beside labelled markers the
              best of the others is the marker with a chance of less than 1 % (a ghost)
    """

    labelled: NDArray[np.bool_]
    likely: NDArray[np.bool_]
    unsure: NDArray[np.bool_]
    hidden: NDArray[np.bool_]


@dataclass(frozen=True)
class LabelShares:
    """The shares of all markers in all frames that are labelled, likely, unsure and hidden; see `LabelStates`. They add up to 1."""

    labelled: float
    likely: float
    unsure: float
    hidden: float


def label_states(labelling: Labelling, clouds: Clouds) -> LabelStates:
    """What became of each marker in each frame, for a labelling of `clouds`."""
    given = np.asarray(labelling.indices >= 0)
    # A confidence that is not known is not sure.
    sure = given & (np.nan_to_num(labelling.confidence) >= SURE)
    # Where nothing has a label, nothing tells where a marker would be; nor does a chance that is not known.
    number = given.sum(axis=1)
    ghosts = (number > 0)[:, None] & (labelling.confidence < 1.0 - SURE)
    unsure = ~given & (clouds.counts > number)[:, None] & ~ghosts
    return LabelStates(sure, given & ~sure, unsure, ~given & ~unsure)


def label_shares(labelling: Labelling, clouds: Clouds) -> LabelShares:
    """The shares for a labelling of `clouds`; all NaN where there are no frames.

    >>> from asterism.recording import Clouds, Labelling
    >>> clouds = Clouds.from_points([np.zeros((3, 3)) + [[0.0], [1.0], [2.0]]] * 2, rate=100.0)
    >>> labelling = Labelling(np.array([[0, 1], [0, -1]]), np.array([[0.999, 0.95], [0.999, 0.4]]), ("LKNE", "RKNE"))
    >>> label_shares(labelling, clouds)
    LabelShares(labelled=0.5, likely=0.25, unsure=0.25, hidden=0.0)
    """
    # Nothing was labelled: no share is right or wrong.
    if labelling.indices.size == 0:
        return LabelShares(*[float("nan")] * 4)
    states = label_states(labelling, clouds)
    return LabelShares(*(float(getattr(states, name).mean()) for name in LABEL_STATES))
