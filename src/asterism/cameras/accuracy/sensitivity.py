"""A rig and places in; out come how far pixels move them: one at a time, analytically, and all together as a covariance."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.cameras.accuracy import jacobian_kernels
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.recording import Floats, Ints

METHODS = ("analytic", "one-at-a-time")


@dataclass(frozen=True)
class Sensitivity:
    """How much the composition of two cameras moves with their pixels (thesis 3.3).

    pairs    (Q, 2) int, the two cameras
    scalars  (Q, N, 3, 4) m: how far each axis moves between plus and minus the shift of xa, ya, xb, yb; NaN where one cannot see it
    """

    pairs: Ints
    scalars: Floats

    @property
    def effective(self) -> Floats:
        """(Q, N) m: the mean of the 12 scalars, the thesis' effective sensitivity S(X, Y, Z)."""
        mean: Floats = self.scalars.mean(axis=(2, 3))
        return mean


def sees(rig: Rig, places: ArrayLike) -> NDArray[np.bool_]:
    """(C, N) whether each camera has each place (N, 3) m in its image. Raises AsterismError where an image size is not known."""
    for camera in rig:
        if camera.size is None:
            raise AsterismError(
                f"camera {camera.name}: its image size is not known, nor is what it sees; add it to the rig (--image-size)."
            )
    sizes = np.array([camera.size for camera in rig])[:, None]
    xy = rig.project(np.asarray(places, dtype=np.float64).reshape(-1, 3))
    inside: NDArray[np.bool_] = np.all((xy > -0.5) & (xy < sizes - 0.5), axis=2)
    return inside


def sensitivity(rig: Rig, places: ArrayLike, shift: float = 0.1, method: str = "analytic") -> Sensitivity:
    """The 12 scalars of every pair of cameras at places (N, 3) m; cameras need not have the place in their image, only before them.

    shift   px, how far each image coordinate is moved to either side: what the cameras can tell apart, or their noise
    method  "one-at-a-time": composed again with each coordinate moved, as the thesis says; "analytic": the same to first order, from
            the pseudo-inverse of the four equations' derivatives (eq. 3.8), several times faster
    Raises AsterismError for another method, a shift that is not positive, and a rig of one camera.
    """
    points = np.ascontiguousarray(np.asarray(places, dtype=np.float64).reshape(-1, 3))
    if method not in METHODS or not shift > 0:
        raise AsterismError(
            f"sensitivity by {method!r} with a shift of {shift} px is impossible; give a positive shift; methods: {', '.join(METHODS)}."
        )
    if len(rig) < 2:
        raise AsterismError("one camera composes nothing: the rig needs at least two.")
    pairs = np.array(list(combinations(range(len(rig)), 2)), dtype=np.int64)
    out = np.empty((len(pairs), len(points), 3, 4))
    jacobians = _jacobians(rig, points)
    for q, (a, b) in enumerate(pairs):
        if method == "analytic":
            both = np.concatenate([jacobians[a], jacobians[b]], axis=1)
            known = np.isfinite(both).all(axis=(1, 2))
            out[q] = np.nan
            # cameras that look along one line compose nothing there: no pseudo-inverse, but infinite sensitivity
            known[known] = np.linalg.cond(both[known]) < 1e6
            out[q, known] = 2 * shift * np.abs(np.linalg.pinv(both[known]))
        else:
            jacobian_kernels.one_at_a_time(*_parameters(rig, a), *_parameters(rig, b), points, shift, out[q])
    return Sensitivity(pairs, out)


def information(rig: Rig, places: ArrayLike) -> Floats:
    """(C, N, 3, 3) 1/m2: what one camera tells about a place where its pixels have 1 px noise; NaN where it is behind the camera."""
    jacobians = _jacobians(rig, np.ascontiguousarray(np.asarray(places, dtype=np.float64).reshape(-1, 3)))
    each: Floats = jacobians.swapaxes(2, 3) @ jacobians
    return each


def covariance(rig: Rig, places: ArrayLike, noise: float = 0.3, seen: ArrayLike | None = None) -> Floats:
    """(N, 3, 3) m2: the covariance of a point at each place (N, 3) m, composed from all cameras that see it.

    noise  px, standard deviation of x and of y
    seen   (C, N) bool, which cameras see each place; by default those that have it in their image

    From the derivatives of all projections, (sum of J'J / noise^2)^-1; calibration is taken as exact. NaN where fewer than two cameras
    see the place, or two on one line with it. Raises AsterismError where `seen` is not given and an image size is not known.
    """
    each = information(rig, places)
    used = sees(rig, places) if seen is None else np.asarray(seen, dtype=np.bool_)
    used = used & np.isfinite(each[:, :, 0, 0])
    total = np.where(used[:, :, None, None], each, 0.0).sum(axis=0)
    out = np.full(total.shape, np.nan)
    scale = np.trace(total, axis1=1, axis2=2)
    known = (used.sum(axis=0) >= 2) & (np.linalg.det(total) > 1e-12 * scale**3)
    out[known] = noise**2 * np.linalg.inv(total[known])
    return out


def _parameters(rig: Rig, camera: int) -> tuple[Floats, Floats, Floats]:
    own = rig[camera]
    return own.lens, own.rotation, own.translation


def _jacobians(rig: Rig, points: Floats) -> Floats:
    """(C, N, 2, 3) px/m."""
    out = np.empty((len(rig), len(points), 2, 3))
    for c in range(len(rig)):
        jacobian_kernels.pixel_jacobians(*_parameters(rig, c), points, out[c])
    return out
