"""The motions of two limbs in; the centre and axis about which they turn, with covariance, out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.geometry import best_rotation
from asterism.motion.rigid.rotations import relative_rotations, rotation_vectors
from asterism.recording import Floats

JOINT_METHODS = ("score", "sphere")
"""score: the point that both limbs carry alike (Ehrig et al. 2006; symmetric). sphere: the common centre of the spheres on which the
child's points move in the parent's axes (Gamage and Lasenby 2002)."""
LEAST_FRAMES = 3
"""Frames in which two limbs are known together, below which they have no joint: two tell no axis that a third could confirm."""


class Motion(Protocol):
    """A limb's motion, such as `asterism.motion.rigid.LimbMotion`: world from limb."""

    @property
    def rotations(self) -> Floats:
        """(T, 3, 3), NaN where missing."""

    @property
    def translations(self) -> Floats:
        """(T, 3) m."""


@dataclass(frozen=True)
class JointRules:
    """How joints are fitted. Chosen on the simulated subjects 100 to 109 (seed 1).

    hinge        the joint is a hinge where its rotations have less than this share of their spread about a second axis
    near_m       m, how well the place between the limbs is known from their points beforehand, standard deviation
    turn         rad: limbs that turn less against each other have no joint that their motion could tell
    """

    hinge: float = 0.15
    near_m: float = 0.03
    turn: float = 0.09


RULES = JointRules()


@dataclass(frozen=True)
class Joint:
    """A joint between two limbs.

    in_parent, in_child  (3,) m, its centre in the axes of the limbs
    axis_in_parent, axis_in_child  (3,) unit vectors, the axis about which the limbs turn most (SARA); NaN where they hardly turn
    kind                 "ball", "hinge", or "fixed" where the limbs hardly turn against each other
    covariance           (3, 3) m2 of the centre in the parent's axes, from the residuals, which are correlated in time
    residual             m, RMS distance between the places to which the two limbs carry the centre
    spread               (3,) rad, standard deviations of the relative rotation along its principal directions, the largest first
    method               one of JOINT_METHODS
    """

    in_parent: Floats
    in_child: Floats
    axis_in_parent: Floats
    axis_in_child: Floats
    kind: str
    covariance: Floats
    residual: float
    spread: Floats
    method: str

    def centres(self, parent: Motion, child: Motion) -> Floats:
        """(T, 3) m in the world: half-way between where the parent and where the child carry the centre."""
        one = parent.rotations @ self.in_parent + parent.translations
        other = child.rotations @ self.in_child + child.translations
        return np.asarray(np.where(np.isfinite(one) & np.isfinite(other), (one + other) / 2, np.where(np.isfinite(one), one, other)))


def fit_joint(
    parent: Motion,
    child: Motion,
    *,
    near: ArrayLike | None = None,
    points: ArrayLike | None = None,
    method: str = "score",
    rules: JointRules = RULES,
) -> Joint:
    """The centre and axis about which two limbs turn.

    near    (T, 3) m or None: roughly where the joint is in the world, for instance between the nearest points of the limbs. It decides only
            what the motion leaves open, such as the place along a hinge's axis (weight: `near_m`)
    points  (T, N, 3) m, the child's points, for the method "sphere"

    SCoRE minimises the sum of |R_p c_p + t_p - R_c c_c - t_c|^2 over c_p and c_c; SARA takes the direction that both limbs carry alike, the
    eigenvector of the smallest eigenvalue of the same equations (Ehrig et al. 2007). O(T) time. Raises AsterismError where the limbs share
    fewer than three frames, shapes differ, or a method is not known or lacks its points.
    """
    if method not in JOINT_METHODS:
        raise AsterismError(f"{method} is no method for joints; choose from {', '.join(JOINT_METHODS)}.")
    if len(parent.rotations) != len(child.rotations):
        raise AsterismError(f"the limbs have {len(parent.rotations)} and {len(child.rotations)} frames; give motions of one recording.")
    both = np.asarray(np.isfinite(parent.translations).all(axis=1) & np.isfinite(child.translations).all(axis=1))
    if both.sum() < LEAST_FRAMES:
        raise AsterismError(f"the limbs are known together in {int(both.sum())} frames; a joint needs three.")
    r_p, t_p, r_c, t_c = parent.rotations[both], parent.translations[both], child.rotations[both], child.translations[both]
    turned = relative_rotations(r_p, r_c)
    mean = best_rotation(turned.sum(axis=0))
    # Spread about the mean pose: about the first frame a bent joint would seem to have turned.
    spread = np.linalg.svd(rotation_vectors(mean.T @ turned) / np.sqrt(len(turned)), compute_uv=False)
    # One strong direction only is a hinge, and then the place along it stays open to the motion.
    kind = "fixed" if spread[0] < rules.turn / 2 else "hinge" if spread[1] < rules.hinge * spread[0] else "ball"
    design = np.concatenate([r_p, -r_c], axis=2)
    prior, expected = _prior(near, both, (r_p, t_p, r_c, t_c), rules)
    # The sphere fit has no equations of its own for the child: its centre is carried there and averaged.
    if method == "sphere":
        if points is None or np.ndim(points) != 3 or len(np.asarray(points)) != len(both):
            raise AsterismError(f"the method sphere needs the child's points as ({len(both)}, points, 3) in m.")
        centre = _sphere_centre(np.asarray(points, dtype=np.float64)[both], (r_p, t_p), expected[:3], prior[0, 0])
        other = np.einsum("tji,tj->ti", r_c, np.einsum("tij,j->ti", r_p, centre) + t_p - t_c).mean(axis=0)
        solution, covariance = np.concatenate([centre, other]), None
    else:
        solution, covariance = _score(design, t_c - t_p, expected, prior)
    left = np.einsum("tij,j->ti", design, solution) + t_p - t_c
    residual = float(np.sqrt((left**2).sum(axis=1).mean()))
    if covariance is None:
        covariance = np.linalg.inv(np.einsum("tki,tkj->ij", design, design) / _variance(left) + prior)
    axis_p, axis_c = _axis(design) if kind != "fixed" else (np.full(3, np.nan), np.full(3, np.nan))
    return Joint(solution[:3], solution[3:], axis_p, axis_c, kind, covariance[:3, :3], residual, spread, method)


def _prior(
    near: ArrayLike | None, both: np.ndarray, motions: tuple[Floats, Floats, Floats, Floats], rules: JointRules
) -> tuple[Floats, Floats]:
    """What is known beforehand: precision (6, 6) 1/m2 and expected (6,) m. Without a hint, hardly anything, about the limbs' origins."""
    r_p, t_p, r_c, t_c = motions
    if near is None:
        return 1e-2 * np.eye(6), np.zeros(6)
    place = np.asarray(near, dtype=np.float64)
    if place.shape != (len(both), 3):
        raise AsterismError(f"near has shape {place.shape}, expected ({len(both)}, 3): a place in the world for each frame.")
    place = place[both]
    known = np.isfinite(place).all(axis=1)
    if not known.any():
        return 1e-2 * np.eye(6), np.zeros(6)
    in_parent = np.einsum("tji,tj->ti", r_p, place - t_p)[known].mean(axis=0)
    in_child = np.einsum("tji,tj->ti", r_c, place - t_c)[known].mean(axis=0)
    return np.eye(6) / rules.near_m**2, np.concatenate([in_parent, in_child])


def _score(design: Floats, right: Floats, expected: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """The centre (6,) m and its covariance (6, 6): two rounds, since how much the prior counts depends on the residuals."""
    normal, shift = np.einsum("tki,tkj->ij", design, design), np.einsum("tki,tk->i", design, right)
    # A centimetre to begin with. How much the prior counts depends on the residuals, and these on the prior: a few rounds.
    variance = 1e-4
    for _ in range(4):
        solution = np.linalg.solve(normal / variance + prior, shift / variance + prior @ expected)
        left = np.einsum("tij,j->ti", design, solution) - right
        variance = _variance(left)
    return solution, np.linalg.inv(normal / variance + prior)


def _variance(left: Floats) -> float:
    """m2 of one residual coordinate, as large as makes residuals that are correlated in time count as often as they are independent."""
    frames = len(left)
    square = float((left**2).sum()) / max(3 * frames - 6, 1)
    # Residuals that follow each other count less often than frames: an AR(1) course of their correlation.
    lagged = float((left[1:] * left[:-1]).sum() / max((left**2).sum(), 1e-30)) if frames > 3 else 0.0
    lagged = min(max(lagged, 0.0), 0.98)
    return max(square, 1e-10) * (1 + lagged) / (1 - lagged)


def _axis(design: Floats) -> tuple[Floats, Floats]:
    """The direction that both limbs carry alike, in the axes of each; its largest component in the parent is positive."""
    vectors = np.linalg.eigh(np.einsum("tki,tkj->ij", design, design))[1]
    one, other = vectors[:3, 0], vectors[3:, 0]
    sign = np.sign(one[np.argmax(np.abs(one))])
    return sign * one / max(float(np.linalg.norm(one)), 1e-12), sign * other / max(float(np.linalg.norm(other)), 1e-12)


def _sphere_centre(points: Floats, parent: tuple[Floats, Floats], expected: Floats, precision: float) -> Floats:
    """(3,) m in the parent's axes: the centre whose squared distances from each point vary least (Gamage and Lasenby 2002, eq. 5)."""
    local = np.einsum("tji,tnj->tni", parent[0], points - parent[1][:, None])
    # About the expected place: squares of far coordinates would lose the digits that count.
    local -= expected
    seen = np.isfinite(local[:, :, :1])
    count = np.maximum(seen.sum(axis=0), 1)
    filled = np.where(seen, local, 0.0)
    mean = filled.sum(axis=0) / count
    square = (filled**2).sum(axis=2, keepdims=True)
    moved = np.where(seen, filled - mean, 0.0)
    normal = 2 * np.einsum("tni,tnj->ij", moved, moved)
    right = np.einsum("tni,tn->i", moved, (square - square.sum(axis=0) / count)[:, :, 0])
    weak = 1e-9 * np.trace(normal) if precision < 1.0 else 1e-4 * np.trace(normal)
    # Points that never move leave all open: 1e-12 m2, far below what millimetres over ten frames give, keeps the expected place.
    return np.asarray(np.linalg.solve(normal + max(weak, 1e-12) * np.eye(3), right) + expected)
