"""Where markers were placed in each frame, and how surely, in; the probability that their labels are those of the frames around, out."""

from __future__ import annotations

import numpy as np

from asterism.recording import Floats
from asterism.views._chain_kernels import label_odds, link_chains

_FASTEST = 10.0
"""m/s: a foot that is swung while running. Half and twice of it change one sure label in ten thousand, since points that go far are seldom
alone."""
_NEAR = 0.005
"""m by which a placed marker is off: a pixel in three metres. With half of it one sure label in a thousand fewer is kept; with twice of it
one in ten of the wrong ones that were found is not."""
_DEPENDENT = 0.5
"""Share of what a label says that its neighbour in time has not said, since a frame starts from the labels of the last one. Half and twice
of it change one sure label in a thousand."""


def continued(positions: Floats, sure: Floats, rate: float, window: int) -> Floats:
    """(T, M) the probability that a marker is the one that its chain says.

    positions (T, M, 3) m, NaN where a marker was not placed; sure (T, M) the highest confidence of its labels in the frame; window: frames
    on both sides that count. A chain is of points that are the same one beyond doubt from frame to frame, whatever their labels are. A body
    that is held otherwise may explain a single frame better, but a marker does not become another one and return. 1 where nothing speaks
    against a label. O(T M (M + window)).

    Chosen on 48,000 sure labels of six simulated people, upright and lying, before two to four cameras, with and without a quarter of the
    sightings missing. Links over two or three frames were tried: they take ten times as many right labels away and find as many wrong ones.
    """
    frame, marker = np.nonzero(np.isfinite(positions).all(axis=2))
    offsets = np.searchsorted(frame, np.arange(len(positions) + 1))
    previous, following = np.empty((2, len(frame)), dtype=np.int64)
    link_chains(positions[frame, marker], offsets, _FASTEST / rate, _NEAR, previous, following)
    # Nats by which a label is better than none of it; a millionth keeps the last doubt.
    weights = -_DEPENDENT * np.log1p(-np.minimum(sure[frame, marker], 1.0 - 1e-6))
    odds = np.empty(len(frame))
    label_odds(previous, following, frame, marker, weights, window, np.zeros(positions.shape[1]), odds)
    shares: Floats = np.ones(positions.shape[:2])
    # A point that is alone says no more than it did, and one that others agree with keeps its own confidence.
    shares[frame, marker] = np.where(odds < weights, 1.0 / (1.0 + np.exp(-odds)), 1.0)
    return shares
