"""A place and a target in; the pose of a camera that stands there and looks at it out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.recording import Floats


def looking(position: ArrayLike, target: ArrayLike, roll: float = 0.0) -> tuple[Floats, Floats]:
    """The pose of a camera at `position` (3,) m that looks at `target` (3,) m: rotation (3, 3) and translation (3,) m, camera from world.

    z is up: the image's y points down, then turned by `roll` rad about the line of sight; where the camera looks straight up or down,
    the world's y is up in its image. Raises AsterismError where both places are the same.
    """
    position, up = np.asarray(position, dtype=np.float64), np.array([0.0, 0.0, 1.0])
    ahead = np.asarray(target, dtype=np.float64) - position
    length = _length(ahead)
    if not length > 0:
        raise AsterismError("a camera cannot look at the place where it stands; move its target.")
    ahead /= length
    right = _cross(ahead, up)
    if _length(right) < 1e-6:
        right = _cross(ahead, np.array([0.0, 1.0, 0.0]))
    right /= _length(right)
    down = _cross(ahead, right)
    cos, sin = math.cos(roll), math.sin(roll)
    rotation = np.stack([cos * right + sin * down, cos * down - sin * right, ahead])
    return rotation, -rotation @ position


def _length(vector: Floats) -> float:
    """The length of a vector (3,)."""
    return math.sqrt(vector @ vector)


def _cross(one: Floats, other: Floats) -> Floats:
    """The cross product of two vectors (3,). A plan asks for thousands: NumPy's checks take ten times as long as the product."""
    (a, b, c), (x, y, z) = one.tolist(), other.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])
