"""Plain versions of the kernels of kinematic trees and of their smoothing: rotations by SciPy, dense matrices, differences."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from asterism.skeleton.tree import KinematicTree


def value_of(curve, q: float) -> float:
    """A curve's value: the piece that begins before q, straight outside the knots."""
    piece = max(int(np.searchsorted(curve.knots, q, side="right")) - 1, 0)
    u = q - curve.knots[piece]
    a, b, c, d = curve.cubics[piece]
    return a + b * u if u < 0 else a + b * u + c * u**2 + d * u**3


def markers_of(tree: KinematicTree, q: np.ndarray, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(M, 3) m: each bone posed by matrices, one motion after the other."""
    at = {coordinate.name: float(value) for coordinate, value in zip(tree.coordinates, q, strict=True)}
    poses: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for bone in tree.bones:
        rotation, joint = turn, place
        if bone.parent:
            above, start = poses[bone.parent]
            rotation, joint = above @ bone.frame, start + above @ bone.offset
        for motion in bone.motions:
            given = at[motion.coordinate] if motion.coordinate else 0.0
            value = given if motion.curve is None else value_of(motion.curve, given)
            if motion.slide:
                joint = joint + rotation @ np.array(motion.axis) * value
            else:
                rotation = rotation @ Rotation.from_rotvec(np.array(motion.axis) * value).as_matrix()
        poses[bone.name] = rotation, joint
    return np.array([poses[marker.bone][1] + poses[marker.bone][0] @ np.array(marker.place) for marker in tree.markers])


def stepped(q: np.ndarray, turn: np.ndarray, place: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The state after a step."""
    return q + step[6:], Rotation.from_rotvec(step[3:6]).as_matrix() @ turn, place + step[:3]


def jacobian(tree: KinematicTree, q: np.ndarray, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(3M, D) by central differences."""
    columns = []
    for number in range(6 + len(q)):
        step = np.zeros(6 + len(q))
        step[number] = 1e-6
        ahead, back = (markers_of(tree, *stepped(q, turn, place, sign * step)) for sign in (1, -1))
        columns.append(((ahead - back) / 2e-6).ravel())
    return np.array(columns).T


def second_differences(frames: int) -> np.ndarray:
    """(T - 2, T)."""
    return np.diff(np.eye(frames), n=2, axis=0)


def smoothing_matrix(blocks: np.ndarray, penalties: np.ndarray) -> np.ndarray:
    """(T D, T D): the frames' equations (T, D, D) and the penalties (D,) of second differences, frames first."""
    bends = second_differences(len(blocks))
    return block_diag(*blocks) + np.kron(bends.T @ bends, np.diag(penalties))
