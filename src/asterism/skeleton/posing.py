"""A body and a pose in; where its markers and capsules are in the world out."""

from __future__ import annotations

import numpy as np

from asterism.recording import Floats
from asterism.skeleton.body import ArticulatedBody
from asterism.skeleton.pose_kernels import place_bones, place_points


def posed_points(body: ArticulatedBody, pose: Floats, rotation: Floats) -> tuple[Floats, Floats, Floats]:
    """Markers (M, 3) m, and the capsules' starts and ends (K, 3) m, of a body in a pose (9 + J,) with a rotation (3, 3).

    The pose: three scales, the root's place (m), three numbers that are not used, and the hinge angles (rad). O(B + M + K).
    """
    arrays, capsules = body.arrays, len(body.capsules)
    turned, moved = posed_bones(body, pose, rotation)
    points, ends = np.empty((len(body.markers), 3)), np.empty((2 * capsules, 3))
    place_points(arrays.bones, arrays.places, pose, turned, moved, points)
    place_points(arrays.capsule_bones, arrays.capsule_ends, pose, turned, moved, ends)
    return points, ends[:capsules], ends[capsules:]


def posed_bones(body: ArticulatedBody, pose: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """How each bone of a body in a pose is turned (B, 3, 3) and moved (B, 3) m, see `place_bones`. O(B)."""
    arrays, bones, hinges = body.arrays, len(body.bones), len(body.hinges)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots = np.empty((hinges, 3)), np.empty((hinges, 3))
    place_bones(arrays.parents, arrays.pivots, arrays.hinge_starts, arrays.axes, pose, rotation, turned, moved, by_scale, axes, pivots)
    return turned, moved
