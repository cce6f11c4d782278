"""Points with covariances in; the same points, moved to where their paths through time say that they are, out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.motion._kernels import smooth_path
from asterism.progress import Progress
from asterism.recording import Clouds, Floats
from asterism.tracking.linking import LinkRules, find_tracklets

_MISS = 0.02
"""m that a link's prediction may miss: points that two cameras see at a narrow angle are as inexact. With 0.03 neighbours are linked."""
_SHORTEST = 6
"""Frames; of shorter pieces of a path little is to be learned."""
_JERK = 100.0
"""m2/s5, the power of jerk that a marker is expected to have before it is looked at: little, and soon outvoted."""
_TRUST, _WIDTH, _ROUNDS = 1.0, 3.0, 40


@dataclass(frozen=True)
class SmoothPaths:
    """Clouds whose points lie on smooth paths.

    clouds      as given, with other coordinates: the same points in the same order
    covariance  (P, 3, 3) m2 of each point, given its path
    paths       how many pieces of a path were smoothed
    moved       (P,) m, how far each point was moved; 0 where it hangs on no path
    """

    clouds: Clouds
    covariance: Floats
    paths: int
    moved: Floats


def smooth_paths(clouds: Clouds, covariance: ArrayLike, *, progress: Progress | None = None) -> SmoothPaths:
    """Use what the frames before and after tell about each point, as much as its covariance leaves open.

    covariance  (P, 3, 3) m2, positive definite, errors of different frames independent: those of `asterism.reconstruction`

    Points are linked to paths (`asterism.tracking.linking`); no point is added, none taken away, and links go no farther than to
    the next frame. Each path is the mean of what is known of a motion with normal third differences, whose variance is estimated along the
    path together with it, by expectation-maximization over some seven frames: a foot in stance is averaged over tenths of a second, at a
    heel strike over hundredths. The smoother is the banded form of a Kalman smoother with jerk as white noise. How far the variance may
    vary, and over how many frames, was chosen on simulated cameras around gait recordings (HC002, 003, 030, 033).

    O(P) time, some 80 microseconds a point; O(longest path) memory. Raises AsterismError where the covariances do not fit the points, or
    are none.
    """
    given = np.asarray(covariance, dtype=np.float64)
    if given.shape != (len(clouds.xyz), 3, 3):
        raise AsterismError(f"covariances of shape {given.shape} for {len(clouds.xyz)} points; give one 3 x 3 matrix in m2 for each.")
    if not (np.isfinite(given).all() and (len(given) == 0 or np.linalg.eigvalsh(given)[:, 0].min() > 0)):
        raise AsterismError("a covariance is not positive definite; a path needs to know how exact each of its points is.")
    tracklets = find_tracklets(clouds, LinkRules(noise=_MISS))
    order = np.argsort(tracklets.of_point, kind="stable")
    ends = np.cumsum(tracklets.last - tracklets.first + 1)
    rows, columns = np.triu_indices(3)
    information = np.linalg.inv(given)[:, rows, columns]
    near = np.arange(-3 * int(_WIDTH), 3 * int(_WIDTH) + 1)
    weights = np.exp(-0.5 * (near / _WIDTH) ** 2)
    # Third differences of a motion whose jerk is white noise of power q have a variance of 11/20 q dt^5.
    floor = 0.55 * _JERK / clouds.rate**5
    xyz, spread, paths = clouds.xyz.copy(), given.copy(), 0
    for j, points in enumerate(np.split(order, ends[:-1]) if len(order) else []):
        if len(points) >= _SHORTEST:
            path, known = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
            smooth_path(clouds.xyz[points], information[points], floor, _TRUST, weights, _ROUNDS, path, known)
            xyz[points], spread[points] = path, known
            paths += 1
        if progress is not None:
            progress(float(ends[j]) / len(order), "smoothing paths")
    return SmoothPaths(replace(clouds, xyz=xyz), spread, paths, np.linalg.norm(xyz - clouds.xyz, axis=1))
