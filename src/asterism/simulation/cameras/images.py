"""A rig and moving points in; out come the blobs that its cameras would have delivered, and which point each of them shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from asterism.cameras import Camera, Rig
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints
from asterism.simulation.cameras import _kernels
from asterism.simulation.cameras.shadows import Capsules

STRAY, MERGED = -1, -2
"""Identities of blobs that show no marker, and of those that show several in one."""


def images_of(
    rig: Rig,
    positions: ArrayLike,
    noise: float = 0.3,
    body: Capsules | None = None,
    strays: float = 0.0,
    dropped: float = 0.0,
    *,
    rng: np.random.Generator,
    rate: float = 100.0,
    diameter: float = 0.014,
    missed: float = 0.0,
    outliers: float = 0.0,
    reflections: int = 0,
    merging: bool = True,
    delays: ArrayLike | None = None,
) -> tuple[Blobs, Ints]:
    """What the cameras of a rig see of markers.

    positions    (T, M, 3) m, or (M, 3) for one frame; NaN where a marker is not there
    noise        px, standard deviation of each blob's x and y
    body         what hides markers: those behind a capsule, and those on its far side
    strays       lights that are nowhere in the next frame: how many per image, on average
    dropped      share of the images that never arrive: no blobs at all
    rate         frames per second
    diameter     m, of the markers; it gives the blobs' sizes
    missed       share of the markers in view that leave no blob
    outliers     share of the blobs that are elsewhere: anywhere in the image
    reflections  lights that stay where they are: how many per camera (4 to 20 px wide)
    merging      whether blobs nearer than the mean of their diameters become one, at the mean of their areas
    delays       (C,) s, how much later than the first moment each camera takes its images; gives the blobs their times

    Returns the blobs, in each image from top to bottom, and what each of them shows, (P,) int: the marker, STRAY (-1; outliers too) or
    MERGED (-2: several in one). Blobs outside the image are not there. The same arguments and generator give the same blobs. O(T C M K)
    for K capsules. Raises AsterismError where a camera's image size is not known or an argument makes no sense.
    """
    points = np.asarray(positions, dtype=np.float64)
    points = points[None] if points.ndim == 2 else points
    sizes = [_size(camera) for camera in rig]
    _check(points, body, noise=noise, strays=strays, dropped=dropped, missed=missed, outliers=outliers, reflections=reflections)
    frames, cameras = len(points), len(rig)
    late = np.zeros(cameras) if delays is None else np.asarray(delays, dtype=np.float64)
    if late.shape != (cameras,) or not np.isfinite(late).all():
        raise AsterismError(f"delays are {late.shape} numbers for {cameras} cameras; give one, in seconds, for each.")
    kept: list[tuple[Ints, Floats, Floats, Ints]] = []
    for c, camera in enumerate(rig):
        seen_at = _later(points, late[c] * rate)
        shadow = body if body is None else Capsules(_later(body.starts, late[c] * rate), _later(body.ends, late[c] * rate), body.radii, ())
        markers = _markers_of(camera, seen_at, noise, shadow, diameter, missed, rng)
        lights = _lights(sizes[c], frames, strays, reflections, noise, rng)
        frame, xy, wide, shows = (np.concatenate(both) for both in zip(markers, lights, strict=True))
        astray = rng.random(len(frame)) < outliers
        xy[astray] = rng.random((int(astray.sum()), 2)) * sizes[c]
        shows[astray] = STRAY
        arrived = (rng.random(frames) >= dropped)[frame]
        inside = ((xy > -0.5) & (xy < np.array(sizes[c]) - 0.5)).all(axis=1)
        order = np.argsort(frame, kind="stable")
        order = order[(arrived & inside)[order]]
        part = (frame[order], xy[order], wide[order], shows[order])
        part = _merged(*part, frames) if merging else part
        order = np.lexsort((part[1][:, 0], part[1][:, 1], part[0]))
        kept.append((part[0][order], part[1][order], part[2][order], part[3][order]))
    frame, xy, wide, shows = (np.concatenate(column) for column in zip(*kept, strict=True))
    camera_of = np.repeat(np.arange(cameras), [len(part[0]) for part in kept])
    times = None if delays is None else np.arange(frames)[:, None] / rate + late
    blobs = Blobs.from_rows(frame, camera_of, xy, rig.names, rate=rate, sizes=wide, frames=frames, times=times)
    return blobs, shows[np.argsort(frame * cameras + camera_of, kind="stable")]


def _size(camera: Camera) -> tuple[int, int]:
    if camera.size is None:
        raise AsterismError(f"camera {camera.name}: its image size is not known, so nobody can say what it sees; give it one.")
    return camera.size


def _check(points: Floats, body: Capsules | None, **numbers: float) -> None:
    if points.ndim != 3 or points.shape[2] != 3:
        raise AsterismError(f"positions have shape {points.shape}, expected (frames, markers, 3).")
    if body is not None and len(body.starts) != len(points):
        raise AsterismError(f"the body has {len(body.starts)} frames, the markers {len(points)}; give both the same.")
    for name, number in numbers.items():
        highest = 1.0 if name in ("dropped", "missed", "outliers") else np.inf
        if not 0 <= number <= highest:
            raise AsterismError(f"{name} is {number}; it must be at least 0" + (" and at most 1." if highest == 1 else "."))


def _later(points: Floats, frames: float) -> Floats:
    """Points (T, ..., 3) some frames later, between frames by a cubic; before the first and after the last frame they go on straight."""
    if frames == 0.0 or len(points) < 2:
        return points
    at, moments = np.arange(len(points), dtype=np.float64), np.arange(len(points)) + frames
    flat = points.reshape(len(points), -1)
    out = np.full(flat.shape, np.nan)
    for column in range(flat.shape[1]):
        there = np.isfinite(flat[:, column])
        if there.all():
            inside = CubicSpline(at, flat[:, column], bc_type="natural")(np.clip(moments, 0, at[-1]))
            beyond = np.clip(moments - at[-1], 0, None) * (flat[-1, column] - flat[-2, column])
            out[:, column] = inside + beyond + np.clip(moments, None, 0) * (flat[1, column] - flat[0, column])
        elif there.any():
            out[:, column] = np.interp(moments, at[there], flat[there, column])
            out[~there[np.clip(np.rint(moments), 0, at[-1]).astype(np.int64)], column] = np.nan
    return out.reshape(points.shape)


def _markers_of(
    camera: Camera, points: Floats, noise: float, body: Capsules | None, diameter: float, missed: float, rng: np.random.Generator
) -> tuple[Ints, Floats, Floats, Ints]:
    """Rows of frame, position, size and marker, of all markers before the camera that nothing hides."""
    xy = camera.project(points) + rng.normal(0.0, 1.0, (*points.shape[:2], 2)) * noise
    there = np.isfinite(xy[:, :, 0]) & (rng.random(points.shape[:2]) >= missed)
    if body is not None:
        hidden: NDArray[np.bool_] = np.empty(points.shape[:2], dtype=np.bool_)
        starts, ends = np.ascontiguousarray(body.starts), np.ascontiguousarray(body.ends)
        _kernels.hidden(camera.position, np.ascontiguousarray(points), starts, ends, body.radii, 0.5 * diameter, hidden)
        there &= ~hidden
    frame, marker = np.nonzero(there)
    depth = points[frame, marker] @ camera.rotation[2] + camera.translation[2]
    return frame, xy[frame, marker], camera.focal[0] * diameter / depth, marker


def _lights(
    size: tuple[int, int], frames: int, strays: float, reflections: int, noise: float, rng: np.random.Generator
) -> tuple[Ints, Floats, Floats, Ints]:
    """Rows as `_markers_of` gives them, of lights that are no markers."""
    passing = np.repeat(np.arange(frames), rng.poisson(strays, frames))
    still = np.repeat(np.arange(frames), reflections)
    places = np.tile(rng.random((reflections, 2)) * size, (frames, 1)) + 0.2 * noise * rng.normal(size=(len(still), 2))
    xy = np.concatenate([rng.random((len(passing), 2)) * size, places])
    wide = np.concatenate([rng.uniform(2.0, 6.0, len(passing)), np.tile(rng.uniform(4.0, 20.0, reflections), frames)])
    frame = np.concatenate([passing, still])
    return frame, xy, wide, np.full(len(frame), STRAY, dtype=np.int64)


def _merged(frame: Ints, xy: Floats, wide: Floats, shows: Ints, frames: int) -> tuple[Ints, Floats, Floats, Ints]:
    """The same rows with every heap of overlapping blobs as one, weighted by area; rows are sorted by frame."""
    offsets = np.searchsorted(frame, np.arange(frames + 1))
    head = np.empty(len(frame), dtype=np.int64)
    _kernels.merge(offsets, xy, wide, head)
    heads, heap, members = np.unique(head, return_inverse=True, return_counts=True)
    area = wide**2
    total = np.bincount(heap, area, len(heads))
    middle = np.stack([np.bincount(heap, area * xy[:, axis], len(heads)) / total for axis in (0, 1)], axis=1)
    alone = members == 1
    middle[alone] = xy[heads[alone]]
    # strays only: still a stray
    markers = np.bincount(heap, shows >= 0, len(heads))
    what = np.where(alone, shows[heads], np.where(markers > 0, MERGED, STRAY))
    return frame[heads], middle, np.sqrt(total), what
