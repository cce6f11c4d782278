"""Blobs and a calibrated rig in; 3D points with residual, covariance and cameras out (thesis 3.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.cameras import Rig
from asterism.detection.static_lights import without_still_lights
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.reconstruction import _frame_kernels, _kernels, _plain_kernels
from asterism.reconstruction.belief import told_by
from asterism.reconstruction.rays import Rays, rays_of
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.setting import Belief, Setting, common_view, image_borders
from asterism.recording import Blobs, Clouds, Floats, Ints, as_vertical
from asterism.synchronization import to_common_clock

METHODS = ("global", "plain")
STILL = 0.75
"""The share of a camera's frames in which a light must stay at one place to be masked: people hide lamps for a while."""
_CHUNK = 64
_FEW_LEFT = 0.1


def reconstruct(
    blobs: Blobs,
    rig: Rig,
    *,
    method: str = "global",
    noise: float | None = None,
    min_cameras: int = 2,
    gate: float = 4.0,
    volume: ArrayLike | None = None,
    mask_static: bool = False,
    progress: Progress | None = None,
) -> Reconstruction:
    """The 3D points that the blobs of each frame show.

    method       "global": each blob shows one point at most, and of all sets of points the likeliest is chosen, frame by frame;
                 "plain": the thesis' algorithms 3.1 and 3.2, all versions of a point merged by distance, ghosts and all
    noise        px, standard deviation of a blob's position per axis; None: told from the blobs themselves
    min_cameras  how many cameras must show a point, at least 2
    gate         how many standard deviations a blob may lie from where a point should show
    volume       (2, 3) m, two opposite corners of the box in which points may be; None: anywhere
    mask_static  leave out blobs that stay at one place of their image in three of four frames: lamps, reflections, and markers that rest
    progress     called with the share done and what is being done

    The rig's cameras are found by the blobs' names for them. Cameras that are not triggered together are brought to a common clock
    first (`asterism.synchronization.to_common_clock`). The clouds' vertical is the rig's, z where it has none. Each frame is
    reconstructed by itself: the same blobs give the same points.

    Cameras without a pose are left out. Raises AsterismError where the rig lacks a camera of the blobs, fewer than two cameras
    are left, or an argument makes no sense.
    """
    blobs, rig, remarks = _rig_of(blobs, rig)
    _check(method, noise, min_cameras, gate, len(rig))
    masked = np.zeros(len(rig), dtype=np.int64)
    if mask_static:
        before = len(blobs.xy)
        blobs, masked = without_still_lights(blobs, STILL)
        if len(blobs.xy) < _FEW_LEFT * before:
            remarks.append(
                f"{100 - 100 * len(blobs.xy) / before:.0f} % of the blobs never move and were left out as reflections or lamps; "
                "where these are markers, do not mask what is static."
            )
    if blobs.times is not None:
        before, blobs = len(blobs.xy), to_common_clock(blobs)
        if len(blobs.xy) < before:
            remarks.append(
                f"the cameras are not triggered together: {before - len(blobs.xy)} of {before} blobs could not be followed from frame to "
                "frame and brought to the common clock; they were left out."
            )
    rays, unreached, doubled = rays_of(blobs, rig)
    if unreached:
        remarks.append(f"{unreached} blobs lie where the lens model leads no ray; they were left out. Check the rig's distortion.")
    if doubled:
        remarks.append(f"{doubled} blobs stand twice in one image; one of each was used.")
    borders, corners = image_borders(rays.blobs, rig), _corners(volume)
    setting = Setting(rig, borders, corners, common_view(rig, borders, corners), min_cameras, gate)
    belief, untold = told_by(setting, rays.blobs.counts, partial(_some, rays), noise)
    if untold:
        remarks.append(untold)
    arrays = setting.arrays(belief)
    run = _run if method == "global" else _run_plain
    parts = []
    for begin in range(0, len(rays.blobs), _CHUNK):
        end = min(begin + _CHUNK, len(rays.blobs))
        parts.append(run(arrays, rays, begin, end))
        if progress is not None:
            progress(end / len(rays.blobs), f"frame {end} of {len(rays.blobs)}")
    silent = [name for name, total in zip(blobs.cameras, rays.blobs.counts.sum(axis=0), strict=True) if not total]
    if silent:
        remarks.append(f"camera {', '.join(silent)} saw nothing at all.")
    return replace(_assembled(parts, rays.blobs, rig, belief, method, masked, tuple(remarks)), fits=not untold)


@dataclass(frozen=True)
class _Part:
    """What a run of frames gave: rays (P, C), points (P, 3), covariance (P, 3, 3), residual (P,), counts (T,), notes (T, 2)."""

    rays: Ints
    points: Floats
    covariance: Floats
    residual: Floats
    counts: Ints
    notes: Ints


def _some(rays: Rays, arrays: _kernels.RigArrays, begin: int, end: int) -> tuple[Ints, Floats, Floats]:
    part = _run(arrays, rays, begin, end)
    return part.rays, part.points, part.residual


def _run(arrays: _kernels.RigArrays, rays: Rays, begin: int, end: int) -> _Part:
    offsets, cameras = rays.blobs.offsets, len(rays.blobs.cameras)
    most = int(offsets[end * cameras] - offsets[begin * cameras]) // 2
    taken, points = np.empty((most, cameras), dtype=np.int64), np.empty((most, 3))
    covariance, residual = np.empty((most, 3, 3)), np.empty(most)
    counts, notes = np.zeros(end - begin, dtype=np.int64), np.zeros((end - begin, 2), dtype=np.int64)
    total = _frame_kernels.reconstruct_frames(
        arrays, rays.flat, rays.slopes, offsets, begin, end, taken, points, covariance, residual, counts, notes
    )
    return _Part(taken[:total], points[:total], covariance[:total], residual[:total], counts, notes)


def _run_plain(arrays: _kernels.RigArrays, rays: Rays, begin: int, end: int) -> _Part:
    offsets, cameras, room = rays.blobs.offsets, len(rays.blobs.cameras), 1024
    frames = []
    notes = np.zeros((end - begin, 2), dtype=np.int64)
    for t in range(begin, end):
        first = offsets[t * cameras : (t + 1) * cameras + 1]
        here = slice(first[0], first[-1])
        while True:
            taken, points = np.empty((room, cameras), dtype=np.int64), np.empty((room, 3))
            covariance, residual = np.empty((room, 3, 3)), np.empty(room)
            kept, versions = _plain_kernels.plain_frame(
                arrays, rays.flat[here], rays.slopes[here], first - first[0], taken, points, covariance, residual
            )
            if versions <= room:
                break
            room = 2 * versions
        taken[taken >= 0] += first[0]
        frames.append((taken[:kept], points[:kept], covariance[:kept], residual[:kept]))
        notes[t - begin] = versions, 1
    counts = np.array([len(frame[0]) for frame in frames], dtype=np.int64)
    taken, points, covariance, residual = (np.concatenate(column) for column in zip(*frames, strict=True))
    return _Part(taken, points, covariance, residual, counts, notes)


def _assembled(
    parts: list[_Part], blobs: Blobs, rig: Rig, belief: Belief, method: str, masked: Ints, remarks: tuple[str, ...]
) -> Reconstruction:
    cameras = len(blobs.cameras)
    taken = np.concatenate([np.empty((0, cameras), dtype=np.int64), *(part.rays for part in parts)])
    xyz = np.concatenate([np.empty((0, 3)), *(part.points for part in parts)])
    notes = np.concatenate([np.empty((0, 2), dtype=np.int64), *(part.notes for part in parts)])
    counts = np.concatenate([np.zeros(1, dtype=np.int64), *(part.counts for part in parts)])
    used = np.zeros(len(blobs.xy), dtype=np.bool_)
    used[taken[taken >= 0]] = True
    cell = blobs.frame_of * cameras + blobs.camera_of
    vertical = as_vertical("z" if rig.vertical is None else rig.vertical)
    return Reconstruction(
        Clouds(xyz, np.cumsum(counts), blobs.rate, vertical, np.full(len(xyz), -1, dtype=np.int64)),
        np.concatenate([np.empty(0), *(part.residual for part in parts)]),
        np.concatenate([np.empty((0, 3, 3)), *(part.covariance for part in parts)]),
        _scale(taken, xyz, rig),
        taken,
        blobs,
        belief.noise,
        method,
        np.bincount(cell[~used], minlength=len(blobs) * cameras).reshape(len(blobs), cameras),
        notes[:, 0],
        notes[:, 1] == 0,
        masked,
        remarks,
    )


def _scale(taken: Ints, xyz: Floats, rig: Rig) -> Floats:
    """(P,) m/px, depth over focal length, the mean over each point's cameras."""
    total = np.zeros(len(xyz))
    for c, camera in enumerate(rig):
        depth = xyz @ camera.rotation[2] + camera.translation[2]
        total += np.where(taken[:, c] >= 0, depth / math.sqrt(camera.focal[0] * camera.focal[1]), 0.0)
    mean: Floats = total / np.maximum((taken >= 0).sum(axis=1), 1)
    return mean


def _rig_of(blobs: Blobs, rig: Rig) -> tuple[Blobs, Rig, list[str]]:
    """The rig's cameras in the blobs' order, both without cameras that have no pose, and a remark where there were such."""
    rig = rig.select(blobs.cameras)
    posed = np.array([camera.posed for camera in rig])
    remarks = []
    if not posed.all():
        without = [camera.name for camera in rig if not camera.posed]
        remarks.append(f"camera {', '.join(without)} has no pose in the rig and was left out; `asterism calibrate wand` gives it one.")
        rig = rig.select([camera.name for camera in rig if camera.posed]) if posed.any() else rig
        blobs = _of_cameras(blobs, posed)
    seeing = [name for name, count in zip(blobs.cameras, blobs.counts.sum(axis=0), strict=True) if count]
    if posed.sum() >= 2 and len(seeing) == 1:
        raise AsterismError(f"all blobs are of camera {seeing[0]}, and points need two cameras; add the others' blobs.")
    if posed.sum() < 2:
        raise AsterismError(
            f"points need two calibrated cameras or more; of the blobs' cameras ({', '.join(blobs.cameras) or 'none'}) "
            f"the rig has a pose for {posed.sum()}. Add the others' blobs, or calibrate them."
        )
    return blobs, rig, remarks


def _of_cameras(blobs: Blobs, kept: NDArray[np.bool_]) -> Blobs:
    """The blobs of some cameras; `kept` (C,) says which."""
    mine = kept[blobs.camera_of]
    counts = blobs.counts[:, kept]
    return replace(
        blobs,
        xy=blobs.xy[mine],
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        cameras=tuple(name for name, stays in zip(blobs.cameras, kept, strict=True) if stays),
        sizes=blobs.sizes[mine],
        times=None if blobs.times is None else blobs.times[:, kept],
    )


def _corners(volume: ArrayLike | None) -> Floats:
    if volume is None:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    corners = np.asarray(volume, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] != corners[1]).all():
        raise AsterismError("the volume needs two opposite corners, (2, 3) finite metres that differ in all axes.")
    return np.sort(corners, axis=0)


def _check(method: str, noise: float | None, min_cameras: int, gate: float, cameras: int) -> None:
    if method not in METHODS:
        raise AsterismError(f"there is no method {method}; choose {' or '.join(METHODS)}.")
    if noise is not None and not 0 < noise < math.inf:
        raise AsterismError(f"a pixel noise of {noise} px makes no sense; give a positive number, or leave it out to have it measured.")
    if not 2 <= min_cameras <= cameras:
        raise AsterismError(f"points from at least {min_cameras} cameras make no sense with {cameras}; choose from 2 to {cameras}.")
    if not 1 <= gate <= 20:
        raise AsterismError(f"a gate of {gate} standard deviations makes no sense; choose from 1 to 20, such as 4.")
