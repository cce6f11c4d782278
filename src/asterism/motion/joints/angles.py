"""The rotations of two limbs in; joint angles out: rotation vector, Cardan sequences, the clinical angles of Grood and Suntay."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.geometry import best_rotation
from asterism.motion.rigid.rotations import (
    as_rotations,
    relative_rotations,
    rotation_vectors,
    rotations_of_one_recording,
    unit_vectors,
)
from asterism.recording import Floats

SEQUENCES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def joint_rotation(parent: ArrayLike, child: ArrayLike, *, zero: int | None = None) -> Floats:
    """(T, 3, 3): the child's axes in the parent's axes.

    parent, child  (T, 3, 3) world from limb; times a limb's anatomical axes (3, 3, as columns) the angle is between those
    zero           a frame whose rotation counts as none, or None; `LimbMotion` has the world's axes in its reference frame, so the angle is
                   then that since this frame

    >>> still = np.tile(np.eye(3), (2, 1, 1))
    >>> turned = still.copy()
    >>> turned[1] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> np.degrees(rotation_vectors(joint_rotation(still, turned, zero=0)))[:, 2].round(6).tolist()
    [0.0, 90.0]
    """
    turned = relative_rotations(parent, child)
    if zero is not None:
        if not 0 <= zero < len(turned):
            raise AsterismError(f"there is no frame {zero} in {len(turned)} frames; choose another frame to count angles from.")
        if not np.isfinite(turned[zero]).all():
            raise AsterismError(f"frame {zero} has no rotation of both limbs; choose another frame to count angles from.")
        # From the right: the zero pose is taken off in the axes of the parent, in which the joint turns.
        turned = turned @ turned[zero].T
    return turned


def cardan_angles(rotations: ArrayLike, sequence: str = "zxy") -> Floats:
    """(T, 3) rad: angles of rotations about body-fixed axes in this order; "zxy" is ISB's for hip and knee (Wu et al. 2002).

    With ISB axes (x forward, y up, z to the right) the three are flexion, adduction, internal rotation of a right limb. The second angle
    lies within a quarter turn; where it is a quarter turn, first and third are not determined and the third is 0. NaN where missing.
    Raises AsterismError where the sequence does not name each axis once.

    >>> a = np.radians(30.0)
    >>> flexed = [[[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]]]
    >>> np.degrees(cardan_angles(flexed, "zxy"))[0, 0].round(6)
    np.float64(30.0)
    """
    if sequence.lower() not in SEQUENCES:
        raise AsterismError(f"{sequence} is no Cardan sequence; choose from {', '.join(SEQUENCES)}.")
    given = as_rotations(rotations)
    i, j, k = ("xyz".index(axis) for axis in sequence.lower())
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    # Rounding may leave an entry a little above 1.
    second = np.arcsin(np.clip(sign * given[:, i, k], -1.0, 1.0))
    # First and third axis fall together: only their sum is known, and the first takes it.
    locked = np.abs(given[:, i, k]) > 1.0 - 1e-12
    first = np.where(locked, np.arctan2(sign * given[:, k, j], given[:, j, j]), np.arctan2(-sign * given[:, j, k], given[:, k, k]))
    third = np.where(locked, 0.0, np.arctan2(-sign * given[:, i, j], given[:, i, i]))
    angles = np.stack([first, second, third], axis=1)
    angles[~np.isfinite(given).all(axis=(1, 2))] = np.nan
    return angles


def grood_suntay(parent: ArrayLike, child: ArrayLike) -> Floats:
    """(T, 3) rad: flexion, adduction, internal rotation in the joint coordinate system of Grood and Suntay (1983), with ISB axes.

    parent, child (T, 3, 3): anatomical axes x forward, y up, z to the right, as columns in the world. e1 is the parent's z (flexion), e3
    the child's y (rotation), e2 their cross product e3 x e1, about which the child adducts. For a right limb positive is extension of a
    knee in the sense of rotation about z; signs of a left limb's second and third angles mirror. Equal to `cardan_angles(..., "zxy")`,
    whatever the order in which the turns are made. NaN where axes are missing; flexion and rotation are NaN where e1 and e3 are parallel.
    Raises AsterismError for other shapes.
    """
    p, c = rotations_of_one_recording(parent, child)
    e1, e3 = p[:, :, 2], c[:, :, 1]
    e2 = unit_vectors(np.cross(e3, e1))

    def dot(one: Floats, other: Floats) -> Floats:
        return np.asarray(np.einsum("ti,ti->t", one, other))

    flexion = np.arctan2(dot(e2, p[:, :, 1]), dot(e2, p[:, :, 0]))
    adduction = np.arcsin(np.clip(dot(e3, e1), -1.0, 1.0))
    internal = np.arctan2(dot(e2, c[:, :, 2]), dot(e2, c[:, :, 0]))
    return np.stack([flexion, adduction, internal], axis=1)


def functional_flexion(rotations: ArrayLike) -> tuple[Floats, Floats]:
    """(T,) rad: the turn about the axis about which a joint turns most, and that axis (3,) in the parent's axes.

    rotations (T, 3, 3) of the child in the parent's axes. The turn is the twist of each rotation since their mean about the axis
    (swing and twist), so that turns about other axes do not leak into it; its mean over time is near 0. The axis' largest component is
    positive. NaN where a rotation is missing. Raises AsterismError where no rotation is present.
    """
    given = as_rotations(rotations)
    present = np.isfinite(given).all(axis=(1, 2))
    if not present.any():
        raise AsterismError("no frame has a rotation of both limbs, so there is no flexion.")
    # The sum of rotations, made a rotation again, is their mean in the chordal sense.
    mean = best_rotation(given[present].sum(axis=0))
    since = given @ mean.T
    vectors = rotation_vectors(since)
    # The direction of most turning; the sign is a convention, so it is fixed by the largest component.
    axis = np.linalg.svd(vectors[present], full_matrices=False)[2][0]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    angle = np.linalg.norm(vectors, axis=1)
    # Twist of a quaternion about the axis: exact for large angles, where a projection of the vector is not.
    half = np.sinc(angle / (2 * np.pi)) / 2
    twist = 2 * np.arctan2(half * (vectors @ axis), np.cos(angle / 2))
    return np.asarray(twist), axis
