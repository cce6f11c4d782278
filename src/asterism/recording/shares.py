"""A labelling and its clouds in; what became of each marker in each frame, and the shares of that, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.recording.clouds import Clouds, Labelling

SURE = 0.99
"""Confidence from which a marker counts as labelled. Below it, one label in a hundred or more is expected to be wrong."""


@dataclass(frozen=True)
class LabelStates:
    """What became of each marker in each frame: (T, M) bool each, of which exactly one holds.

    labelled  a point got the marker's name, with a confidence of 99 % or more
    likely    a point got it, with less confidence, or with one that is not known
    unsure    no point got it, and the frame has points without a name, one of which may be the marker
    hidden    no point got it, and every point of the frame has a name
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
    # A point without a name may be the marker; without one it is hidden.
    unsure = ~given & (clouds.counts > given.sum(axis=1))[:, None]
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
    return LabelShares(*(float(state.mean()) for state in (states.labelled, states.likely, states.unsure, states.hidden)))
