"""Blobs and a calibrated rig in; 3D points with residual, covariance and cameras out (thesis 3.4)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.recording import Blobs, Clouds, Floats, Ints, as_vertical
from asterism.reconstruction import _frame_kernels, _kernels, _plain_kernels
from asterism.reconstruction.result import Reconstruction

Progress = Callable[[float, str], None]

METHODS = ("global", "plain")
_CHUNK = 64
_SAMPLE = 40
_NOISE_GUESS = 0.5
_NOISE_FLOOR = 0.02
_SEEN_GUESS = 0.7
_STRAYS_GUESS = 0.02


@dataclass(frozen=True)
class _Belief:
    """What is held about how the images come about: per camera pixel noise, share of visible markers seen, strays per frame."""

    noise: Floats
    seen: Floats
    strays: Floats
    points: float


def reconstruct(
    blobs: Blobs,
    rig: Rig,
    *,
    method: str = "global",
    noise: float | None = None,
    min_cameras: int = 2,
    gate: float = 4.0,
    volume: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The 3D points that the blobs of each frame show.

    method       "global": each blob explains one point at most, and of all sets of points the likeliest is chosen, frame by frame;
                 "plain": the thesis' algorithms 3.1 and 3.2, all versions of a point merged by distance, ghosts and all
    noise        px, standard deviation of a blob's position per axis; None: told from the blobs themselves
    min_cameras  how many cameras must show a point, at least 2
    gate         how many standard deviations a blob may lie from where a point should show
    volume       (2, 3) m, two opposite corners of the box in which points may be; None: anywhere

    The clouds' vertical is the rig's (z where it has none). Each frame is reconstructed by itself: the same blobs give the same points.
    Raises AsterismError where the blobs' cameras are not the rig's, fewer than two of them are calibrated, or an argument makes no sense.
    """
    rig = _rig_of(blobs, rig)
    _check(method, noise, min_cameras, gate, len(rig))
    corners = _corners(volume)
    flat, slopes, blobs = _undistorted(blobs, rig)
    borders = _borders(blobs, rig)
    setting = _Setting(rig, borders, corners, min_cameras, gate)
    belief = _belief(setting, blobs, flat, slopes, noise)
    arrays = setting.arrays(belief)
    run = _run if method == "global" else _run_plain
    parts = []
    spans = [(begin, min(begin + _CHUNK, len(blobs))) for begin in range(0, len(blobs), _CHUNK)]
    for begin, end in spans:
        parts.append(run(arrays, blobs, flat, slopes, begin, end))
        if progress is not None:
            progress(end / len(blobs), f"frame {end} of {len(blobs)}")
    return _assembled(parts, blobs, rig, belief, method)


@dataclass(frozen=True)
class _Part:
    """What the kernel gave for a run of frames."""

    rays: Ints
    points: Floats
    covariance: Floats
    residual: Floats
    counts: Ints
    notes: Ints


@dataclass(frozen=True)
class _Setting:
    """What does not change while beliefs are refined: rig, image borders (2, C, 2) px, corners (2, 3) m, and the user's wishes."""

    rig: Rig
    borders: Floats
    corners: Floats
    min_cameras: int
    gate: float

    def arrays(self, belief: _Belief) -> _kernels.RigArrays:
        """All of it as the kernels take it."""
        cameras = self.rig.cameras
        lenses = np.zeros((len(cameras), max(len(camera.lens) for camera in cameras)))
        for row, camera in zip(lenses, cameras, strict=True):
            row[: len(camera.lens)] = camera.lens
        pairs, axes = _pairs(self.rig)
        area = np.maximum(np.prod(self.borders[1] - self.borders[0], axis=1), 1.0)
        positions = np.array([camera.position for camera in cameras])
        box = self.corners if np.isfinite(self.corners).all() else np.stack([positions.min(axis=0), positions.max(axis=0)])
        extent = np.maximum(box[1] - box[0], 0.2 * np.max(box[1] - box[0]))
        density = belief.points / float(np.prod(extent))
        rows = np.column_stack(
            [
                np.array([camera.rotation.ravel() for camera in cameras]),
                np.array([camera.translation for camera in cameras]),
                positions,
                belief.noise,
                np.log(belief.seen * area / (2 * math.pi * belief.noise**2 * belief.strays)),
                np.log(1 - belief.seen),
                self.borders[0],
                self.borders[1],
                lenses,
            ]
        )
        prior = math.log(density) + 1.5 * math.log(2 * math.pi)
        setting = np.array([prior, self.gate, self.min_cameras, *self.corners[0], *self.corners[1]])
        return _kernels.RigArrays(np.ascontiguousarray(rows), setting, pairs, axes)


def _run(arrays: _kernels.RigArrays, blobs: Blobs, flat: Floats, slopes: Floats, begin: int, end: int) -> _Part:
    cameras = len(blobs.cameras)
    most = int(blobs.offsets[end * cameras] - blobs.offsets[begin * cameras]) // 2
    rays, points = np.empty((most, cameras), dtype=np.int64), np.empty((most, 3))
    covariance, residual, scores = np.empty((most, 3, 3)), np.empty(most), np.empty(most)
    counts, notes = np.zeros(end - begin, dtype=np.int64), np.zeros((end - begin, 2), dtype=np.int64)
    total = _frame_kernels.reconstruct_frames(
        arrays, flat, slopes, blobs.offsets, begin, end, rays, points, covariance, residual, scores, counts, notes
    )
    return _Part(rays[:total], points[:total], covariance[:total], residual[:total], counts, notes)


def _run_plain(arrays: _kernels.RigArrays, blobs: Blobs, flat: Floats, slopes: Floats, begin: int, end: int) -> _Part:
    cameras, room = len(blobs.cameras), 1024
    parts, counts, notes = [], [], []
    for t in range(begin, end):
        first = blobs.offsets[t * cameras : (t + 1) * cameras + 1]
        here = slice(first[0], first[-1])
        while True:
            rays, points = np.empty((room, cameras), dtype=np.int64), np.empty((room, 3))
            covariance, residual = np.empty((room, 3, 3)), np.empty(room)
            kept, versions = _plain_kernels.plain_frame(
                arrays, flat[here], slopes[here], first - first[0], rays, points, covariance, residual
            )
            if versions <= room:
                break
            room = 2 * versions
        rays[rays >= 0] += first[0]
        parts.append((rays[:kept], points[:kept], covariance[:kept], residual[:kept]))
        counts.append(kept)
        notes.append((versions, 0))
    rays, points, covariance, residual = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return _Part(rays, points, covariance, residual, np.array(counts, dtype=np.int64), np.array(notes, dtype=np.int64))


def _assembled(parts: list[_Part], blobs: Blobs, rig: Rig, belief: _Belief, method: str) -> Reconstruction:
    cameras = len(blobs.cameras)
    rays = np.concatenate([np.empty((0, cameras), dtype=np.int64), *(part.rays for part in parts)])
    xyz = np.concatenate([np.empty((0, 3)), *(part.points for part in parts)])
    notes = np.concatenate([np.empty((0, 2), dtype=np.int64), *(part.notes for part in parts)])
    counts = np.concatenate([np.zeros(1, dtype=np.int64), *(part.counts for part in parts)])
    used = np.zeros(len(blobs.xy), dtype=np.bool_)
    used[rays[rays >= 0]] = True
    cell = blobs.frame_of * cameras + blobs.camera_of
    unused = np.bincount(cell[~used], minlength=len(blobs) * cameras).reshape(len(blobs), cameras)
    clouds = Clouds(
        xyz, np.cumsum(counts), blobs.rate, as_vertical("z" if rig.vertical is None else rig.vertical), np.full(len(xyz), -1, dtype=np.int64)
    )
    return Reconstruction(
        clouds,
        np.concatenate([np.empty(0), *(part.residual for part in parts)]),
        np.concatenate([np.empty((0, 3, 3)), *(part.covariance for part in parts)]),
        rays,
        blobs.cameras,
        belief.noise,
        method,
        unused,
        notes[:, 0],
        (notes[:, 1] == 0) & (method == "global"),
    )


def _belief(setting: _Setting, blobs: Blobs, flat: Floats, slopes: Floats, noise: float | None) -> _Belief:
    """Pixel noise, share of points that each camera sees, and strays, told from some frames spread over the recording.

    Starts with much noise, so that no true ray is missed, and goes on with what was found.
    """
    counts = blobs.counts
    cameras = len(blobs.cameras)
    most = np.maximum(np.median(counts[counts.sum(axis=1) > 0], axis=0), 1.0) if counts.any() else np.ones(cameras)
    belief = _Belief(
        np.full(cameras, noise or 2 * _NOISE_GUESS), np.full(cameras, _SEEN_GUESS), _STRAYS_GUESS * most + 0.1, float(most.max())
    )
    chosen = np.unique(np.linspace(0, len(blobs) - 1, min(_SAMPLE, len(blobs))).round().astype(np.int64))
    for _ in range(5):
        arrays = setting.arrays(belief)
        parts = [_run(arrays, blobs, flat, slopes, t, t + 1) for t in chosen]
        before = belief
        belief = _refined(arrays, belief, parts, counts[chosen], noise)
        if np.allclose(before.noise, belief.noise, rtol=0.1):
            break
    return belief


def _refined(arrays: _kernels.RigArrays, belief: _Belief, parts: list[_Part], counts: Ints, noise: float | None) -> _Belief:
    rays = np.concatenate([part.rays for part in parts])
    points = np.concatenate([part.points for part in parts])
    residual = np.concatenate([part.residual for part in parts])
    if len(points) < 10:
        return belief if noise is not None else replace(belief, noise=np.full(len(belief.noise), _NOISE_GUESS))
    in_sight, seen = np.zeros(rays.shape[1], dtype=np.int64), np.zeros(rays.shape[1], dtype=np.int64)
    _frame_kernels.seen_shares(arrays, points, rays, in_sight, seen)
    unused = counts.mean(axis=0) - (rays >= 0).sum(axis=0) / len(counts)
    share = np.clip((seen + 10 * _SEEN_GUESS) / (in_sight + 10), 0.2, 0.98)
    return _Belief(
        belief.noise if noise is not None else np.full(len(belief.noise), _noise_of(residual, (rays >= 0).sum(axis=1), belief.noise[0])),
        share,
        np.maximum(unused, 0.0) + _STRAYS_GUESS * np.maximum(counts.mean(axis=0), 1.0) / 4 + 0.02,
        len(points) / len(counts),
    )


def _noise_of(residual: Floats, cameras: Ints, before: float) -> float:
    """px per axis, from the residuals that 80 % of the points stay below: 2 n - 3 of their 2 n numbers are free (Wilson and Hilferty)."""
    enough = cameras >= 3 if (cameras >= 3).sum() >= 10 else cameras >= 2
    free = 2.0 * cameras[enough] - 3.0
    expected = (1 - 2 / (9 * free) + 0.8416 * np.sqrt(2 / (9 * free))) ** 3
    told = math.sqrt(float(np.quantile(residual[enough] ** 2 * cameras[enough] / (free * expected), 0.8)))
    return max(_NOISE_FLOOR, told if told < 0.7 * before else 2.0 * before if told > 0.9 * before and before < 4 else told)


def _pairs(rig: Rig) -> tuple[Ints, Floats]:
    """All camera pairs (K, 2), those that look across each other's view first, and axes (K, 2, 3) across each baseline."""
    looks = np.array([camera.rotation[2] for camera in rig])
    found = []
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            baseline = rig[b].position - rig[a].position
            length = float(np.linalg.norm(baseline))
            if length < 1e-9:
                continue
            along = baseline / length
            middle = looks[a] + looks[b]
            across = middle - along * (middle @ along)
            if np.linalg.norm(across) < 1e-6:
                across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
            across /= np.linalg.norm(across)
            found.append((-float(np.linalg.norm(np.cross(looks[a], looks[b]))), a, b, np.stack([across, np.cross(along, across)])))
    if not found:
        raise AsterismError("all cameras of the rig stand in one place: no depth can be seen; check the rig's translations.")
    found.sort(key=lambda pair: pair[:3])
    return np.array([pair[1:3] for pair in found], dtype=np.int64), np.array([pair[3] for pair in found])


def _undistorted(blobs: Blobs, rig: Rig) -> tuple[Floats, Floats, Blobs]:
    """Normalized coordinates (B, 2) and slopes (B, 4) px of all blobs, and the blobs without those that no ray leads to."""
    flat, slopes = np.empty_like(blobs.xy), np.empty((len(blobs.xy), 4))
    camera_of = blobs.camera_of
    for number, camera in enumerate(rig):
        mine = np.nonzero(camera_of == number)[0]
        flat[mine] = camera.undistort(blobs.xy[mine])
        share = np.empty((len(mine), 4))
        _kernels.lens_slopes(camera.lens, flat[mine], share)
        slopes[mine] = share
    return flat, slopes, blobs


def _borders(blobs: Blobs, rig: Rig) -> Floats:
    """(2, C, 2) px, the least and greatest pixel of each image; where its size is not known, of its blobs."""
    camera_of = blobs.camera_of
    borders = np.zeros((2, len(rig), 2))
    for number, camera in enumerate(rig):
        mine = blobs.xy[camera_of == number]
        if camera.size is not None:
            borders[:, number] = [(-0.5, -0.5), (camera.size[0] - 0.5, camera.size[1] - 0.5)]
        elif len(mine):
            borders[:, number] = [mine.min(axis=0), mine.max(axis=0)]
    return borders


def _rig_of(blobs: Blobs, rig: Rig) -> Rig:
    """The rig's cameras in the blobs' order."""
    rig = rig.select(blobs.cameras)
    without = [camera.name for camera in rig if not camera.posed]
    if without:
        raise AsterismError(f"camera {without[0]} has no pose in the rig; calibrate it with `asterism calibrate wand`, or leave it out.")
    if len(rig) < 2:
        raise AsterismError("points need two cameras or more, and the blobs come from one; add the others' blobs.")
    return rig


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
        raise AsterismError(f"a point from at least {min_cameras} cameras makes no sense with {cameras}; choose from 2 to {cameras}.")
    if not 1 <= gate <= 20:
        raise AsterismError(f"a gate of {gate} standard deviations makes no sense; choose from 1 to 20, such as 4.")
