"""What the other cameras' points tell of one camera: whether its view has moved, and where to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.calibration.refine.rules import RULES
from asterism.calibration.refine.subset import reconstruct_by
from asterism.cameras import Camera, Rig
from asterism.recording import Blobs, Floats


@dataclass(frozen=True)
class CameraComparison:
    """A camera against the points of others.

    camera  a better pose, None where none was found
    moved   px by which its view has moved
    shown   share of the points in its image that it shows with that pose
    points  that it could be compared with
    """

    camera: Camera | None
    moved: float
    shown: float
    points: int


def compare_camera(blobs: Blobs, rig: Rig, camera: int, others: list[int], noise: float) -> CameraComparison:
    """Look for the others' points in a camera's images."""
    model = rig[camera]
    clouds = reconstruct_by(blobs, rig, others, noise).clouds
    size = np.array(model.size or (2.0 * model.centre[0], 2.0 * model.centre[1]))
    images = [blobs.of(t, camera) for t in range(len(blobs))]
    pairs = [(points, xy) for points, xy in zip(clouds, images, strict=True) if len(points) and len(xy)]
    near = sum(int(_inside(model.project(points), size).sum()) for points, _ in pairs)
    if near < RULES.least_points:
        return CameraComparison(None, float("nan"), float("nan"), near)
    best = CameraComparison(None, float("inf"), 0.0, near)
    for start in (np.zeros(2), _shift(model, pairs, size)):
        found = _resect(model, pairs, size, noise, start)
        if found is not None and found.shown > best.shown + 0.05:
            best = found
        if best.shown > 0.9:
            break
    return best if best.shown >= RULES.least_shown else CameraComparison(None, float("inf"), best.shown, near)


def _inside(xy: Floats, size: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(xy).all(axis=1) & (xy > 0).all(axis=1) & (xy < size).all(axis=1))


def _shift(camera: Camera, pairs: list[tuple[Floats, Floats]], size: Floats) -> Floats:
    """px: by how much most images have moved together, by a vote of all pairs of a point and a blob of its frame."""
    reach, cell = RULES.reach * size[0], RULES.bin * size[0]
    bins = int(2 * reach / cell)
    votes = np.zeros((bins, bins))
    for points, xy in pairs:
        off = (xy[None] - camera.project(points)[:, None]).reshape(-1, 2)
        at = np.floor((off[np.isfinite(off).all(axis=1)] + reach) / cell).astype(np.int64)
        at = at[((at >= 0) & (at < bins)).all(axis=1)]
        np.add.at(votes, (at[:, 0], at[:, 1]), 1.0)
    wide = votes.copy()
    for axis in (0, 1):
        wide = wide + np.roll(wide, 1, axis=axis) + np.roll(wide, -1, axis=axis)
    peak = np.array(np.unravel_index(int(np.argmax(wide)), wide.shape), dtype=np.float64)
    return (peak + 0.5) * cell - reach


def _resect(camera: Camera, pairs: list[tuple[Floats, Floats]], size: Floats, noise: float, start: Floats) -> CameraComparison | None:
    """Pose a camera anew by the blobs nearest to where points should be, moved by `start` px at first, within a gate that narrows."""
    posed = camera
    gates = [*(0.02 * size[0] * 0.55 ** np.arange(4)), *([max(4.0 * noise, 1.0)] * 3)]
    shift = start
    for gate in gates:
        points, xy = _matched(posed, pairs, gate, shift)
        if len(points) < RULES.least_points // 2:
            return None
        flat = np.ascontiguousarray(posed.undistort(xy))
        done, turn, moved, _ = cv2.solvePnPRansac(
            points, flat, np.eye(3), None, iterationsCount=100, reprojectionError=0.5 * gate / camera.focal[0], flags=cv2.SOLVEPNP_SQPNP
        )
        if not done:
            return None
        posed = replace(posed, rotation=cv2.Rodrigues(turn)[0], translation=moved.ravel())
        shift = np.zeros(2)
    world = np.concatenate([points for points, _ in pairs])
    inside = _inside(posed.project(world), size)
    if inside.sum() < RULES.least_points:
        return None
    seen = _matched(posed, pairs, max(4.0 * noise, 1.0), shift)[0]
    moved_by = np.linalg.norm(posed.project(world[inside]) - camera.project(world[inside]), axis=1)
    moved_by = np.where(np.isfinite(moved_by), moved_by, np.inf)
    return CameraComparison(posed, float(np.median(moved_by)), min(len(seen) / int(inside.sum()), 1.0), int(inside.sum()))


def _matched(camera: Camera, pairs: list[tuple[Floats, Floats]], gate: float, shift: Floats) -> tuple[Floats, Floats]:
    """Points (n, 3) m and the blobs (n, 2) px that are each other's nearest and within the gate."""
    points, places = [np.empty((0, 3))], [np.empty((0, 2))]
    all_projected = camera.project(np.concatenate([cloud for cloud, _ in pairs])) + shift
    all_projected[~np.isfinite(all_projected).all(axis=1)] = np.inf
    ends = np.cumsum([len(cloud) for cloud, _ in pairs])
    for (cloud, xy), projected in zip(pairs, np.split(all_projected, ends[:-1]), strict=True):
        across, down = projected[:, None, 0] - xy[None, :, 0], projected[:, None, 1] - xy[None, :, 1]
        off = np.sqrt(across * across + down * down)
        blob = off.argmin(axis=1)
        mutual = (off.argmin(axis=0)[blob] == np.arange(len(cloud))) & (off[np.arange(len(cloud)), blob] < gate)
        points.append(cloud[mutual])
        places.append(xy[blob[mutual]])
    return np.concatenate(points), np.concatenate(places)
