"""Points with covariances in; the same points, moved to where their paths through time place them, out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.motion._kernels import JerkModel, smooth_path
from asterism.progress import Progress
from asterism.recording import Clouds, Floats
from asterism.tracking.linking import LinkRules, find_tracklets


@dataclass(frozen=True)
class SmoothingRules:
    """How paths are smoothed. Width and trust were chosen on simulated cameras around gait recordings (HC002, 003, 030, 033).

    link_miss_m  m that a link's prediction may miss: points that two cameras see at a narrow angle are as inexact. It links none of the 59
                 markers of the gait recordings to a neighbour; 0.03 does
    min_frames   shorter pieces of a path are left as they are
    jerk         m2/s5, the power of jerk that is expected of a marker beforehand
    trust        how many differences that expectation counts as
    width        frames, standard deviation of the window over which the strength of the jerk is estimated
    rounds       of expectation and maximization
    """

    link_miss_m: float = 0.02
    min_frames: int = 6
    jerk: float = 100.0
    trust: float = 1.0
    width: float = 3.0
    rounds: int = 40


RULES = SmoothingRules()


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


def smooth_paths(clouds: Clouds, covariance: ArrayLike, rules: SmoothingRules = RULES, *, progress: Progress | None = None) -> SmoothPaths:
    """Use what the frames before and after say about each point, as far as its covariance leaves that open.

    covariance  (P, 3, 3) m2, positive definite, errors of different frames independent: those of `asterism.reconstruction`

    Points are linked to paths (`asterism.tracking.linking`); no point is added, none taken away, and links go no farther than to
    the next frame. Each path is the mean of what is known of a motion with normal third differences, whose variance is estimated along the
    path together with it, by expectation-maximization over some seven frames: a foot in stance is averaged over tenths of a second, at a
    heel strike over hundredths. The smoother is the banded form of a Kalman smoother with jerk as white noise.

    O(P) time, some 80 microseconds a point; O(longest path) memory. Raises AsterismError where the covariances do not fit the points, or
    are not positive definite.

    >>> rng = np.random.default_rng(0)
    >>> line = np.arange(20)[:, None] * np.array([0.01, 0.0, 0.0])
    >>> noisy = Clouds.from_points(line[:, None] + rng.normal(0.0, 0.001, (20, 1, 3)), rate=100.0)
    >>> smooth = smooth_paths(noisy, np.tile(1e-6 * np.eye(3), (20, 1, 1)))
    >>> bool(np.abs(smooth.clouds.xyz - line).mean() < np.abs(noisy.xyz - line).mean())
    True
    """
    given = np.asarray(covariance, dtype=np.float64)
    if given.shape != (len(clouds.xyz), 3, 3):
        raise AsterismError(f"covariances of shape {given.shape} for {len(clouds.xyz)} points; give one 3 x 3 matrix in m2 for each.")
    if not (np.isfinite(given).all() and (len(given) == 0 or np.linalg.eigvalsh(given)[:, 0].min() > 0)):
        raise AsterismError("a covariance is not positive definite; give the 3 x 3 matrices in m2 that the reconstruction gave.")
    # Links of one frame only: a path must not bridge a gap by which a marker could become its neighbour.
    tracklets = find_tracklets(clouds, LinkRules(noise=rules.link_miss_m))
    # Points of one path beside each other, in order of time: the kernel takes one path at a time.
    order = np.argsort(tracklets.of_point, kind="stable")
    ends = np.cumsum(tracklets.last - tracklets.first + 1)
    rows, columns = np.triu_indices(3)
    # The normal equations add inverse covariances; a matrix is symmetric, so six numbers hold it.
    information = np.ascontiguousarray(np.linalg.inv(given)[:, rows, columns])
    # Beyond three widths a normal window holds nothing that counts.
    near = np.arange(-3 * int(rules.width), 3 * int(rules.width) + 1)
    weights = np.exp(-0.5 * (near / rules.width) ** 2)
    # Third differences of a motion whose jerk is white noise of power q have a variance of 11/20 q dt^5.
    floor = 0.55 * rules.jerk / clouds.rate**5
    model = JerkModel(floor, rules.trust, weights, rules.rounds)
    xyz, spread, paths = clouds.xyz.copy(), given.copy(), 0
    for j, points in enumerate(np.split(order, ends[:-1]) if len(order) else []):
        # A shorter piece has too few differences to tell its own jerk, so it stays as measured.
        if len(points) >= rules.min_frames:
            path, known = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
            smooth_path(clouds.xyz[points], information[points], model, path, known)
            xyz[points], spread[points] = path, known
            paths += 1
        if progress is not None:
            progress(float(ends[j]) / len(order), "smoothing paths")
    return SmoothPaths(replace(clouds, xyz=xyz), spread, paths, np.linalg.norm(xyz - clouds.xyz, axis=1))
