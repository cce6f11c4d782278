"""Simulated clouds and their truth: which marker each point is, checked on the way."""

from __future__ import annotations

import numpy as np

from asterism.recording import NULL, Clouds, Ints, Recording


def owners(recording: Recording, clouds: Clouds, truth: Ints) -> Ints:
    """(P,) the marker of each point by the truth (T, M), -1 for ghosts and clutter.

    Asserts that each point which the truth names is there, lies where the recording has its marker, and belongs to one marker only.
    """
    owner = np.full(len(clouds.xyz), -1)
    frames, markers = np.nonzero(truth != NULL)
    points = clouds.offsets[frames] + truth[frames, markers]
    assert (truth[frames, markers] < clouds.counts[frames]).all(), "the truth names a point that its frame does not have"
    np.testing.assert_array_equal(clouds.xyz[points], recording.positions[frames, markers])
    owner[points] = markers
    assert (owner >= 0).sum() == len(points), "two markers claim one point"
    return owner
