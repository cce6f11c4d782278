"""Two limbs' motions and points' noise in; the angle's standard uncertainty by the law of propagation, and where it holds, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.motion.analysis import JointAngles
from asterism.motion.rigid.limb import LimbMotion
from asterism.motion.uncertainty.monte_carlo import MonteCarlo, numerical_tolerance
from asterism.recording import Floats

_COVERAGE_FACTOR = {0.65: 0.9345892910734805, 0.95: 1.959963984540054}

_SAMPLING = 2.67
"""Standard uncertainties times the root of the trials: the standard error of the end of a 95 % interval, root(0.025 0.975) / 0.0584."""


@dataclass(frozen=True)
class FirstOrder:
    """The law of propagation's result (GUM 5.1.2) and whether it holds.

    standard  (T,) rad of the angle, for the measurement noise of the points
    holds     (T,) bool: where the ends of its 95 % interval are those of the Monte Carlo within half a unit of the last significant digit
              (Supplement 1, clause 8) and three standard errors of these ends; False where the angle is not known; None without a Monte
              Carlo to compare with
    """

    standard: Floats
    holds: np.ndarray | None = None


def rotation_covariance(motion: LimbMotion, sigma: float) -> Floats:
    """(T, 3, 3) rad2: the covariance of a limb's rotation, as a small turn in the world's axes, from independent noise of its points (m).

    For weights w and points p about their weighted mean, A = sum of w (|p|^2 1 - p p'), B = sum of w^2 (|p|^2 1 - p p'): the covariance is
    sigma^2 A^-1 B A^-1. Derived from the least squares of a small turn; weights and template count as given. NaN where the motion is
    missing.
    """
    present = np.isfinite(motion.residuals) & np.isfinite(motion.rotations[:, 0, 0])[:, None]
    weights = np.where(present, motion.weights, 0.0)
    total = np.maximum(weights.sum(axis=1), 1e-30)
    template = np.where(np.isfinite(motion.template), motion.template, 0.0)
    # About the weighted mean, where rotation and translation do not mix.
    mean = (weights @ template) / total[:, None]

    def tensor(w: Floats) -> Floats:
        second = np.einsum("tn,ni,nj->tij", w, template, template, optimize=True)
        first = w @ template
        outer = first[:, :, None] * mean[:, None, :]
        # Moments about the mean from those about the origin, for all frames at once.
        second = second - outer - outer.swapaxes(1, 2) + w.sum(axis=1)[:, None, None] * mean[:, :, None] * mean[:, None, :]
        return np.asarray(np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second)

    # All frames are computed, those without a motion with weights of zero: one selection at the end instead of one in each product.
    inverse = np.linalg.pinv(tensor(weights))
    local = sigma**2 * inverse @ tensor(weights**2) @ inverse
    r = motion.rotations
    return np.asarray(r @ local @ r.swapaxes(1, 2))


def first_order_angles(
    angles: JointAngles, parent: LimbMotion, child: LimbMotion, sigma: float, check: MonteCarlo | None = None
) -> FirstOrder:
    """The standard uncertainty of `angles.angle` to first order, from noise of standard deviation `sigma` m of all points.

    The relative rotation's small turn has the sum of both limbs' covariances, and the zero frame's added; the angle's is its part along the
    rotation's axis. NaN where the angle is. check: a Monte Carlo of the same source and of nothing else, against which the result is held.
    """
    spread = rotation_covariance(parent, sigma) + rotation_covariance(child, sigma)
    r = parent.rotations
    # Into the parent's axes, in which the joint's vector is given.
    local = r.swapaxes(1, 2) @ spread @ r
    both = local + local[angles.zero]
    variance = np.einsum("ti,tij,tj->t", angles.directions, both, angles.directions)
    # The zero frame is compared with itself.
    variance[angles.zero] = 0.0
    standard = np.where(np.isfinite(angles.angle), np.sqrt(np.maximum(variance, 0.0)), np.nan)
    if check is None:
        return FirstOrder(standard)
    low, high = check.intervals.get(0.95, (check.estimate, check.estimate))
    reach = _COVERAGE_FACTOR[0.95] * standard
    typical = float(np.median(standard[np.isfinite(standard)]))
    tolerance = numerical_tolerance(typical) + 3 * _SAMPLING * typical / np.sqrt(check.trials)
    # Both ends must agree: a skewed distribution agrees at one.
    miss = np.maximum(np.abs(check.estimate - reach - low), np.abs(check.estimate + reach - high))
    return FirstOrder(standard, miss <= tolerance)
