"""Clouds or recordings in; points with their neighbouring positions, velocities and accelerations out, as features of motion read them."""

from __future__ import annotations

import numpy as np

from asterism.geometry import rotate_z_up
from asterism.labelling.features.motion_kernels import WIDTH, estimate_motion
from asterism.recording import Clouds, Floats, Ints, Recording
from asterism.tracking.linking import find_tracklets

NEIGHBOUR = 0.2
"""Seconds from a frame to its neighbours before and after. Chosen by hand."""

REACH = 0.05
"""Seconds on each side over which velocity and acceleration are fitted; two frames at least. Not tuned."""

SLOWEST = 20.0
"""Frames per second below which the frames are too far apart for a parabola: all motion is unknown. Not tuned."""


def motion_of_points(clouds: Clouds, tracks: Ints | None = None) -> Floats:
    """The upright points of clouds with their motion: (P, WIDTH), in the order of `clouds.xyz`.

    Columns 0:3 the position, 3:6 and 6:9 the positions `NEIGHBOUR` seconds before and after (m), 9:12 the velocity (m/s), 12:15 the
    acceleration (m/s2) of the parabola fitted to `REACH` seconds on each side. All are turned so that the vertical is +z.
    They come from the point's track: `tracks` (P,) that are known to be right, by default the tracklets that `find_tracklets` makes of the
    clouds. Where a track has not enough frames without a gap on both sides they are NaN: half a window would give another number. Played
    backwards, the positions before and after change places, and the velocity its sign. O(P).
    """
    out = np.full((len(clouds.xyz), WIDTH), np.nan)
    out[:, :3] = clouds.xyz
    if clouds.rate >= SLOWEST:
        tracks = find_tracklets(clouds).of_point if tracks is None else tracks
        frame = clouds.frame_of
        order = np.lexsort((frame, tracks))
        away, reach = round(NEIGHBOUR * clouds.rate), max(2, round(REACH * clouds.rate))
        estimate_motion(clouds.xyz, frame, tracks, order, away, reach, clouds.rate, out)
    return np.ascontiguousarray(rotate_z_up(out.reshape(-1, WIDTH // 3, 3), clouds.vertical).reshape(-1, WIDTH))


def frames_with_motion(recording: Recording) -> Floats:
    """A labelled recording as upright frames with their motion: (T, M, WIDTH), NaN where a marker is missing. A column is a track."""
    clouds = recording.clouds()
    out = np.full((*recording.visible.shape, WIDTH), np.nan)
    out[recording.visible] = motion_of_points(clouds, clouds.columns)
    return out


def feature_points(clouds: Clouds, wanted: bool) -> Floats:
    """The upright points of clouds: with their motion (P, WIDTH) where it is wanted, else (P, 3)."""
    return motion_of_points(clouds) if wanted else np.ascontiguousarray(rotate_z_up(clouds.xyz, clouds.vertical))
