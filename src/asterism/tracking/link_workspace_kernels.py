"""The arrays that the linking kernels share: limits at one frame rate, ends of tracks, links and working arrays.

The rules are in `linking.LinkRules`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel


class LinkLimits(NamedTuple):
    """`linking.LinkRules` at one frame rate: distances in m, velocities in m per frame, accelerations in m per frame^2."""

    noise: float
    usual_change: float
    max_change: float
    residual_gain: float
    ratio_test: float
    rival_gap: float
    neighbour_velocity_tol: float
    rotation_tol: float
    disagreement_gain: float
    max_step: float
    no_cut_below: float
    jump: float


class TrackEnds(NamedTuple):
    """The last points of n tracks, all in one frame.

    position      (n, 3) m
    velocity      (n, 3) m per frame, where age > 1
    acceleration  (n, 3) m per frame^2, where age > 2
    age           (n,) points of the track so far
    recent_error  (n,) m, prediction errors of the last frames, decaying, where age > 2
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    age: np.ndarray
    recent_error: np.ndarray


class Links(NamedTuple):
    """Links of P points in both directions, -1 for none.

    previous   (P,) the point of the frame before
    following  (P,) the point of the frame after
    """

    previous: np.ndarray
    following: np.ndarray


class LinkWorkspace(NamedTuple):
    """Working arrays of one thread, for up to n tracks and points: see `make_link_workspace`.

    predicted, gate         (n, 3) m, where each track is expected; (n,) m, how far from there its point may be
    next_point              (n,) the point that each track goes on with, -1 for none yet
    nearest_point           (n,) each track's nearest free point; its distance and that of the second nearest, m
    nearest_track           (n,) each point's nearest free track; its distance and that of the second nearest, m
    pair_track, pair_point  (8 n,) pairs of a track and a point within its reach; their distance, m
    """

    predicted: np.ndarray
    gate: np.ndarray
    next_point: np.ndarray
    nearest_point: np.ndarray
    nearest_point_distance: np.ndarray
    second_point_distance: np.ndarray
    nearest_track: np.ndarray
    nearest_track_distance: np.ndarray
    second_track_distance: np.ndarray
    pair_track: np.ndarray
    pair_point: np.ndarray
    pair_distance: np.ndarray


@kernel
def make_track_ends(n):
    """The ends of n tracks, to be filled. Returns TrackEnds. O(n) memory."""
    return TrackEnds(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.ones(n, dtype=np.int64), np.zeros(n))


@kernel
def make_link_workspace(n):
    """Working arrays for frames of up to n points. Returns LinkWorkspace. O(n) memory."""
    return LinkWorkspace(
        np.empty((n, 3)),
        np.empty(n),
        np.empty(n, dtype=np.int64),
        np.empty(n, dtype=np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(n, dtype=np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(8 * n, dtype=np.int64),
        np.empty(8 * n, dtype=np.int64),
        np.empty(8 * n),
    )
