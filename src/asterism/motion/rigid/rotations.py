"""Rotations over time in; relative rotations, rotation vectors, quaternions, helical axes and angular velocities out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.recording import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class HelicalAxes:
    """The screw that takes a body from the first frame to each other one (Spoor and Veldpaus 1980).

    directions (T, 3) unit vectors; angles (T,) rad, 0 to pi; shifts (T,) m along the direction; points (T, 3) m, the point of the axis
    nearest to the origin. NaN where the motion is missing; direction and point are NaN where nothing turns.
    """

    directions: Floats
    angles: Floats
    shifts: Floats
    points: Floats


def relative_rotations(parent: ArrayLike, child: ArrayLike) -> Floats:
    """(T, 3, 3) of the child in the parent's axes, parent' child; both (T, 3, 3) world from limb, NaN where missing.

    GaMoCap prints R_A R_B' (eq. 5). That has the same angle, but its axis is given in the world's axes at that moment, which is
    another one whenever both limbs turn together. R_B' R_A has it in the axes of limb B, so a hinge has the same axis in all frames.
    """
    of_parent, of_child = rotations_of_one_recording(parent, child)
    return np.asarray(np.einsum("tji,tjk->tik", of_parent, of_child))


def rotation_vectors(rotations: ArrayLike) -> Floats:
    """(T, 3) rad: direction is the axis, length the angle, 0 to pi (Rodrigues; GaMoCap section 3.1). NaN where a rotation is missing.

    >>> rotation_vectors([[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]]).round(4)
    array([[0. , 0. , 1.5708]])
    """
    given = as_rotations(rotations)
    out = np.full((len(given), 3), np.nan)
    present = np.isfinite(given).all(axis=(1, 2))
    if present.any():
        out[present] = _scipy_rotation(given[present]).as_rotvec()
    return out


def quaternions(rotations: ArrayLike) -> Floats:
    """(T, 4) unit quaternions (w, x, y, z), each with the sign that is nearest to the one before; NaN where a rotation is missing."""
    given = as_rotations(rotations)
    out = np.full((len(given), 4), np.nan)
    present = np.nonzero(np.isfinite(given).all(axis=(1, 2)))[0]
    if len(present):
        four = _scipy_rotation(given[present]).as_quat()[:, [3, 0, 1, 2]]
        # A quaternion and its negative are one rotation; the first has w >= 0, the others follow their neighbour.
        if four[0, 0] < 0:
            four[0] *= -1
        turns = np.sign(np.einsum("ti,ti->t", four[1:], four[:-1]))
        four[1:] *= np.cumprod(np.where(turns < 0, -1.0, 1.0))[:, None]
        out[present] = four
    return out


def angular_velocity(rotations: ArrayLike, rate: float) -> Floats:
    """(T, 3) rad/s in the world's axes: the rotation from the frame before to the frame after, over the time between them.

    One-sided at the ends and beside gaps; NaN where a frame has no neighbour. Noise in the rotations is not filtered: smooth first
    where the rate is high. Raises AsterismError where the rate is not positive.

    >>> turns = np.array([[[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]] for a in (0.0, 0.1, 0.2)])
    >>> angular_velocity(turns, rate=100.0)[:, 2].round(6)
    array([10., 10., 10.])
    """
    given = as_rotations(rotations)
    if not rate > 0:
        raise AsterismError(f"a rate of {rate} frames per second; it must be greater than 0.")
    frames = np.arange(len(given))
    present = np.isfinite(given).all(axis=(1, 2))
    # Central differences; beside a gap or an end only the neighbour that is there.
    before = np.where((frames > 0) & np.roll(present, 1), frames - 1, frames)
    after = np.where((frames < len(given) - 1) & np.roll(present, -1), frames + 1, frames)
    # World axes: the step is applied from the left.
    steps = np.einsum("tij,tkj->tik", given[after], given[before])
    out = rotation_vectors(steps) * rate / np.maximum(after - before, 1)[:, None]
    out[~present | (after == before)] = np.nan
    return out


def helical_axes(rotations: ArrayLike, translations: ArrayLike) -> HelicalAxes:
    """The screws from the first frame that is present to each frame, of x(t) = R x + t with (T, 3, 3) and (T, 3) m."""
    given, moved = as_rotations(rotations), np.asarray(translations, dtype=np.float64)
    if moved.shape != (len(given), 3):
        raise AsterismError(f"translations have shape {moved.shape}, expected ({len(given)}, 3): one in m for each rotation.")
    present = np.nonzero(np.isfinite(given).all(axis=(1, 2)))[0]
    if not len(present):
        nothing = np.full((len(given), 3), np.nan)
        return HelicalAxes(nothing, nothing[:, 0].copy(), nothing[:, 0].copy(), nothing.copy())
    first = present[0]
    turned = np.einsum("tij,kj->tik", given, given[first])
    shift = moved - turned @ moved[first]
    vectors = rotation_vectors(turned)
    angles = np.linalg.norm(vectors, axis=1)
    # Without a turn the direction is any, and its division by the angle is 0 by 0.
    still = ~(angles > 1e-9)
    directions = np.where(still[:, None], np.nan, vectors / np.where(still, 1.0, angles)[:, None])
    along = np.einsum("ti,ti->t", shift, directions)
    across = shift - along[:, None] * directions
    # The point of the axis at which the shift across it is that of a circle with this angle.
    half = np.tan(np.where(still, 1.0, angles) / 2)[:, None]
    points = 0.5 * (across + np.cross(directions, across) / half)
    lengths = np.where(still, np.linalg.norm(shift, axis=1), along)
    return HelicalAxes(directions, angles, lengths, points)


def as_rotations(given: ArrayLike) -> Floats:
    """(T, 3, 3). Raises AsterismError for another shape."""
    rotations = np.asarray(given, dtype=np.float64)
    if rotations.ndim != 3 or rotations.shape[1:] != (3, 3):
        raise AsterismError(f"rotations have shape {rotations.shape}, expected (frames, 3, 3).")
    return rotations


def rotations_of_one_recording(parent: ArrayLike, child: ArrayLike) -> tuple[Floats, Floats]:
    """Both (T, 3, 3). Raises AsterismError for other shapes, and where they differ in their number of frames."""
    one, other = as_rotations(parent), as_rotations(child)
    if len(one) != len(other):
        raise AsterismError(f"the limbs have {len(one)} and {len(other)} frames; give rotations of one recording.")
    return one, other


def unit_vectors(vectors: Floats) -> Floats:
    """(T, 3) of length 1; NaN where a vector is missing or has no length, such as between two markers in one place."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 1e-12, length, np.nan))


def cross(one: Floats, other: Floats) -> Floats:
    """(T, 3) the vector products of vectors (T, 3) or (3,), as `numpy.cross`, which takes longer to look at its axes than to multiply."""
    (a, b, c), (x, y, z) = one.T, other.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def _scipy_rotation(matrices: Floats) -> Rotation:
    """Raises AsterismError where a matrix is none of a rotation."""
    from scipy.spatial.transform import Rotation

    try:
        return Rotation.from_matrix(matrices)
    except ValueError:
        raise AsterismError("a matrix mirrors or flattens space, so it is no rotation; give matrices of determinant 1.") from None
