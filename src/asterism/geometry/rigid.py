"""Two sets of corresponding points in; the rotation and the translation that lay one on the other out. Never a reflection."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_FLAT = 1e-9
"""m: a template with less extent than this along a direction has none."""


def best_rotation(covariances: Floats) -> Floats:
    """The rotations R (..., 3, 3) that maximise trace(R' C) for matrices C (..., 3, 3) (Kabsch 1976).

    C is the sum of outer(target, point) over centred pairs. Where C is of rank 1 or 0 (points in a line, or coincident) one of the
    equally good rotations is returned.

    >>> points = np.diag([1.0, 2.0, 3.0])
    >>> targets = points[:, [1, 0, 2]] * [-1, 1, 1]  # a quarter turn about z
    >>> best_rotation(targets.T @ points).round(6) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    u, _, vt = np.linalg.svd(covariances)
    # The sign of the last axis turns a reflection into the best rotation.
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    rotations: Floats = u @ vt
    return rotations


def fit_rigid(points: Floats, targets: Floats, weights: Floats | None = None) -> tuple[Floats, Floats]:
    """The rotation (3, 3) and translation (3,) m that lay points (N, 3) m on targets (N, 3) m by least squares (Kabsch 1976).

    weights (N,) weigh the squared distances. All values must be finite and N at least 1. Fewer than three points, or points in a line,
    leave the rotation open: one of the best is returned.

    >>> corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    >>> rotation, translation = fit_rigid(corner, corner + [0.0, 0.0, 2.0])
    >>> translation.round(6) + 0.0
    array([0., 0., 2.])
    """
    if weights is None:
        # Only what is centred decides the rotation.
        here, there = points.mean(axis=0), targets.mean(axis=0)
        covariance = (targets - there).T @ (points - here)
    else:
        total = weights.sum()
        here, there = weights @ points / total, weights @ targets / total
        covariance = (weights[:, None] * (targets - there)).T @ (points - here)
    rotation = best_rotation(covariance)
    # The centre of the points must land on the centre of the targets.
    return rotation, there - rotation @ here


def place_objects(template: ArrayLike, positions: Floats) -> tuple[Floats, Floats]:
    """`fit_rigid` of a template (K, 3) m on its points in each frame, (T, K, 3) m with NaN for missing ones.

    Returns rotations (T, 3, 3) and translations (T, 3) m, world from object. NaN where too few points are present: fewer than two for a
    template in a line, fewer than three for others.

    >>> plate = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    >>> seen = np.stack([plate + [1.0, 0.0, 0.0], plate])
    >>> seen[1, 1:] = np.nan  # one marker is too few
    >>> rotations, translations = place_objects(plate, seen)
    >>> translations.round(6) + 0.0
    array([[ 1.,  0.,  0.],
           [nan, nan, nan]])
    """
    model = np.asarray(template, dtype=np.float64).reshape(-1, 3)
    present = np.asarray(np.isfinite(positions).all(axis=2))
    count = np.maximum(present.sum(axis=1), 1)[:, None]
    # Missing points take part as zeros, which add nothing.
    filled = np.where(present[:, :, None], positions, 0.0)
    mean = filled.sum(axis=1) / count
    model_mean = (present[:, :, None] * model).sum(axis=1) / count
    # The template is centred on the points that are seen, not on all of its own.
    centred = np.where(present[:, :, None], model[None] - model_mean[:, None], 0.0)
    rotations = best_rotation(np.einsum("tki,tkj->tij", np.where(present[:, :, None], filled - mean[:, None], 0.0), centred))
    translations = mean - np.einsum("tij,tj->ti", rotations, model_mean)
    # A template in a line has two points at least, any other three.
    rank = np.linalg.matrix_rank(model - model.mean(axis=0), tol=_FLAT)
    too_few = present.sum(axis=1) < min(rank + 1, 3)
    rotations[too_few], translations[too_few] = np.nan, np.nan
    return rotations, translations


def align_about_z(frames: Floats, template: Floats) -> Floats:
    """Frames (N, M, 3) m, each turned about +z and shifted so that it lies best on `template` (M, 3) m by least squares.

    Markers that are NaN in the frame or in the template do not count; they move with the others. The kernel of the same name does this
    for one frame.

    >>> body = np.array([[0.3, 0.0, 1.0], [-0.3, 0.0, 1.0], [0.0, 0.1, 0.0]])
    >>> turned = body[:, [1, 0, 2]] * [-1, 1, 1] + [5.0, 0.0, 0.0]
    >>> bool(np.allclose(align_about_z(turned[None], body)[0], body))
    True
    """
    # A marker counts where both have it.
    shown = ~np.isnan(frames[:, :, :1]) & ~np.isnan(template[None, :, :1])
    if len(template) and shown.all():
        # Most frames show all: nothing need be left out.
        here = frames.sum(axis=1, keepdims=True) / len(template)
        moved, there = frames - here, template.sum(axis=0, keepdims=True)[None] / len(template)
        a, b = np.ascontiguousarray(moved[..., :2]), template[None, :, :2] - there[..., :2]
    else:
        count = np.maximum(shown.sum(axis=1, keepdims=True), 1)
        here = np.where(shown, frames, 0.0).sum(axis=1, keepdims=True) / count
        there = np.where(shown, template, 0.0).sum(axis=1, keepdims=True) / count
        moved = frames - here
        a, b = np.where(shown, moved[..., :2], 0.0), np.where(shown, template[:, :2] - there[..., :2], 0.0)
    along = (a * b).sum(axis=(1, 2))
    across = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    # The angle of the least squares in the plane, in closed form.
    angle = np.arctan2(across, along)[:, None]
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = moved[..., 0].copy(), moved[..., 1].copy()
    moved[..., 0] = cos * x - sin * y
    moved[..., 1] = sin * x + cos * y
    moved += there
    return moved
