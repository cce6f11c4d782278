"""Blobs of one frame in; where a body may stand, how large it is and which way it faces, out (the paper's section 3, eqs 1 to 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector, z_up_rotation
from asterism.recording import Floats, Ints
from asterism.skeleton.body import ArticulatedBody, Point
from asterism.skeleton.pose_kernels import HINGES
from asterism.skeleton.posing import posed_points
from asterism.views.scene import ViewsScene, cameras_with_blobs


@dataclass(frozen=True)
class StartPosture:
    """A way to be in a room other than upright: which way the pelvis is turned, and how the joints are bent.

    turn    degrees, rotation vector in the body's axes (x ahead, y left, z up)
    angles  hinge without its side -> degrees; other hinges, and those that the body lacks, are as usual
    """

    turn: Point = (0.0, 0.0, 0.0)
    angles: Mapping[str, float] = field(default_factory=dict)


POSTURES = (
    # On the back, on the front, on either side, upside down.
    StartPosture((0.0, -90.0, 0.0)),
    StartPosture((0.0, 90.0, 0.0)),
    StartPosture((90.0, 0.0, 0.0)),
    StartPosture((-90.0, 0.0, 0.0)),
    StartPosture((0.0, 180.0, 0.0)),
    # On the back with the feet on the floor, on all fours, bent down to the feet.
    StartPosture((0.0, -90.0, 0.0), {"thigh flexion": 50.0, "shank flexion": 90.0}),
    StartPosture((0.0, 90.0, 0.0), {"thigh flexion": 90.0, "shank flexion": 90.0, "upper arm raising": 90.0}),
    StartPosture((0.0, 70.0, 0.0), {"thigh flexion": 75.0, "upper arm raising": 80.0}),
    # Seated on a chair, seated on the floor, kneeling, on the heels, squatting.
    StartPosture(angles={"thigh flexion": 90.0, "shank flexion": 90.0}),
    StartPosture(angles={"thigh flexion": 90.0}),
    StartPosture(angles={"shank flexion": 90.0}),
    StartPosture(angles={"thigh flexion": 70.0, "shank flexion": 140.0}),
    StartPosture((0.0, 20.0, 0.0), {"thigh flexion": 110.0, "shank flexion": 120.0}),
)
"""Textbook postures, 90 degrees apart where they lie: a fit follows a body over half of that. Each is tried with every heading."""


def place_by_centroids(rig: Rig, centroids: Floats, body_centroid: Floats) -> Floats:
    """The translation T (3,) m that lays the body's centroid on the images' centroids (the paper's eqs 1 to 5).

    centroids (C, 2) px of each camera's blobs, NaN where a camera has none; body_centroid (3,) m, of the scaled and oriented body (C_v).

    The system is sum over cameras of c* P (C_v + T) = 0. In print E = c* P has four columns and T three rows: C_v is a point, whose fourth
    coordinate is 1, and T a direction, whose fourth is 0, so E is the first three columns. B then has the minus sign of eq. 5 and all of
    P C_v, and eq. 4 holds as printed. Rows are divided by the focal length, so that all cameras weigh the same. Raises AsterismError
    where fewer than two cameras have a centroid, or all look along one line.
    """
    rows, right = list[Floats](), list[Floats]()
    for camera, centroid in zip(rig, centroids, strict=True):
        flat = camera.undistort(centroid)
        if not np.isfinite(flat).all():
            continue
        cross: Floats = np.array([[0.0, -1.0, flat[1]], [1.0, 0.0, -flat[0]], [-flat[1], flat[0], 0.0]])
        rows.append(cross @ camera.rotation)
        right.append(-cross @ (camera.rotation @ body_centroid + camera.translation))
    if len(rows) < 2:
        raise AsterismError("a place needs blobs in two cameras at least; one image does not say how far away a body is.")
    e: Floats = np.concatenate(rows)
    b: Floats = np.concatenate(right)
    # Rays that are nearly parallel meet anywhere along them.
    normal: Floats = e.T @ e
    if np.linalg.cond(normal) > 1e10:
        raise AsterismError("all cameras look along one line; a place needs cameras beside each other.")
    place = np.linalg.solve(normal, e.T @ b)
    return np.asarray(place, dtype=np.float64)


def middle_of_rays(scene: ViewsScene, xy: Floats, offsets: Ints) -> Floats:
    """(3,) m: where the middles of the images' blobs meet. Medians, because strays shift a mean. Raises as `place_by_centroids`."""
    centroids = np.full((len(scene.rig), 2), np.nan)
    for c, camera in enumerate(scene.rig):
        if cameras_with_blobs(offsets)[c]:
            # The median of the blobs, since strays shift a mean.
            flat = np.median(xy[offsets[c] : offsets[c + 1]], axis=0) / np.array(camera.focal)
            centroids[c] = camera.project((np.append(flat, 1.0) - camera.translation) @ camera.rotation)
    return place_by_centroids(scene.rig, centroids, np.zeros(3))


def starts(
    scene: ViewsScene,
    body: ArticulatedBody,
    xy: Floats,
    offsets: Ints,
    headings: int,
    size: float | None = None,
    postures: tuple[StartPosture, ...] = (),
) -> tuple[Floats, Floats]:
    """Poses (N, 9 + J) and rotations (N, 3, 3) from which a frame may be fitted when nothing is known: all headings, all poses of the body.

    size: the person's as a multiple of the body's, where known; else from how far blobs spread along the vertical. postures: instead of the
    poses of an upright body. O(N). Raises as `middle_of_rays`.
    """
    middle = middle_of_rays(scene, xy, offsets)
    spreads = _spreads(scene, xy, offsets, middle) if size is None else []
    upright = z_up_rotation(scene.vertical).T
    angles = _angles_of(body, postures) if postures else body.start_angles
    turns = [rotation_from_vector(np.radians(posture.turn)) for posture in postures] or [np.eye(3)] * len(angles)
    poses = np.zeros((headings * len(angles), HINGES + angles.shape[1]))
    # Every heading with every usual pose: a fit finds neither by itself.
    rotations = np.empty((len(poses), 3, 3))
    for k in range(len(angles)):
        pose = np.concatenate([np.ones(3), np.zeros(6), angles[k]])
        places = posed_points(body, pose, turns[k])[0]
        pose[:3] = _size_by_spread(places @ np.array([0.0, 0.0, 1.0]), spreads) if size is None else size
        for h in range(headings):
            turn, n = 2 * np.pi * h / headings, k * headings + h
            about = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
            rotations[n] = upright @ about @ turns[k]
            poses[n] = pose
            poses[n, 3:6] = middle - upright @ about @ (pose[0] * places.mean(axis=0))
    return poses, rotations


def _angles_of(body: ArticulatedBody, postures: tuple[StartPosture, ...]) -> Floats:
    """(N, J) rad, the angles of a body's hinges in each posture."""
    arrays = body.arrays
    plain = [name.removeprefix("left ").removeprefix("right ") for name in body.hinge_names]
    out = np.repeat(arrays.usual[None], len(postures), axis=0)
    for row, posture in zip(out, postures, strict=True):
        for j, name in enumerate(plain):
            if name in posture.angles:
                row[j] = np.radians(posture.angles[name])
    return np.asarray(np.clip(out, arrays.low, arrays.high), dtype=np.float64)


def _spreads(scene: ViewsScene, xy: Floats, offsets: Ints, middle: Floats) -> list[tuple[float, float]]:
    """Of each image that tells a size: px over which the middle half of its blobs spreads along the vertical, and px of a metre there."""
    spreads = []
    for c, camera in enumerate(scene.rig):
        # Near blobs of one image hide how high the body reaches, so four are needed.
        seen = xy[offsets[c] : offsets[c + 1]]
        depth = float(camera.rotation[2] @ middle + camera.translation[2])
        if len(seen) >= 4 and depth > 0.1:
            # How many pixels a metre along the vertical is at the body's distance.
            up = (camera.rotation @ scene.vertical)[:2] * np.array(camera.focal) / depth
            length = float(np.linalg.norm(up))
            if length > 1e-6:
                spreads.append((float(np.diff(np.quantile(seen @ (up / length), [0.2, 0.8]))[0]), length))
    return spreads


def _size_by_spread(heights: Floats, spreads: list[tuple[float, float]]) -> float:
    """The person's size as a multiple of the body's, within 0.6 to 1.6.

    heights (M,) m: of the body's markers in a posture; spreads: see `_spreads`.
    """
    own = np.diff(np.quantile(heights, [0.2, 0.8]))[0]
    ratios = [spread / (length * own) for spread, length in spreads]
    # A person is rarely beyond these sizes; a wrong start outside of them would not be left again.
    return float(np.clip(np.median(ratios), 0.6, 1.6)) if ratios else 1.0
