"""A rig and moving points in; the blobs that its cameras would deliver, and which point each of them shows, out."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class ImagingSettings:
    """How cameras see markers.

    noise        px, standard deviation of each blob's x and y
    diameter     m, of the markers; it gives the blobs' sizes
    strays       lights that are nowhere in the next frame: how many per image, on average
    reflections  lights that stay where they are: how many per camera (4 to 20 px wide)
    missed       share of the markers in view that leave no blob
    dropped      share of the images that never arrive: no blobs at all
    outliers     share of the blobs that are elsewhere: anywhere in the image
    merging      whether blobs nearer than the mean of their diameters become one, at the mean of their areas
    delays       (C,) s, how much later than the first moment each camera takes its images; gives the blobs their times
    """

    noise: float = 0.3
    diameter: float = 0.014
    strays: float = 0.0
    reflections: int = 0
    missed: float = 0.0
    dropped: float = 0.0
    outliers: float = 0.0
    merging: bool = True
    delays: ArrayLike | None = None

    def check(self) -> None:
        """Raise AsterismError where a number is out of range."""
        for name in ("noise", "strays", "dropped", "missed", "outliers", "reflections"):
            number, highest = getattr(self, name), 1.0 if name in ("dropped", "missed", "outliers") else np.inf
            if not 0 <= number <= highest:
                raise AsterismError(f"{name} is {number}; it must be at least 0" + (" and at most 1." if highest == 1 else "."))

    def delay_of_each(self, cameras: int) -> Floats:
        """(C,) s. Raises AsterismError where there is not one number for each camera."""
        delays = np.zeros(cameras) if self.delays is None else np.asarray(self.delays, dtype=np.float64)
        if delays.shape != (cameras,) or not np.isfinite(delays).all():
            raise AsterismError(f"delays are {delays.shape} numbers for {cameras} cameras; give one, in seconds, for each.")
        return delays


def simulate_blobs(
    rig: Rig,
    positions: ArrayLike,
    settings: ImagingSettings | None = None,
    *,
    rng: np.random.Generator,
    body: Capsules | None = None,
    rate: float = 100.0,
) -> tuple[Blobs, Ints]:
    """What the cameras of a rig see of markers.

    positions  (T, M, 3) m, or (M, 3) for one frame; NaN where a marker is missing
    settings   None: the default ones
    body       what hides markers: those behind a capsule, and those on its far side
    rate       frames per second

    Returns the blobs, in each image from top to bottom, and what each of them shows, (P,) int: the marker, STRAY (-1; outliers too) or
    MERGED (-2: several in one). Blobs outside the image are left out. The same arguments and generator give the same blobs. O(T C M K)
    for K capsules. Raises AsterismError where a camera's image size is not known or a setting is out of range.

    >>> from asterism.simulation.cameras import ring_rig
    >>> blobs, identity = simulate_blobs(ring_rig(4), [[0.0, 0.0, 1.0], [0.3, 0.0, 1.2]], rng=np.random.default_rng(0))
    >>> len(blobs.xy), sorted(set(identity.tolist()))
    (8, [0, 1])
    """
    settings = ImagingSettings() if settings is None else settings
    points = np.asarray(positions, dtype=np.float64)
    points = points[None] if points.ndim == 2 else points
    # At the door: a camera without an image size would fail in the middle of a session.
    for camera in rig:
        _image_size(camera)
    _check(points, body)
    settings.check()
    delays = settings.delay_of_each(len(rig))
    kept = [_seen_by(camera, points, body, settings, delay * rate, rng) for camera, delay in zip(rig, delays, strict=True)]
    frame, xy, sizes, shows = (np.concatenate(column) for column in zip(*kept, strict=True))
    camera_of = np.repeat(np.arange(len(rig)), [len(part[0]) for part in kept])
    # Times only where cameras differ: else the frame number says all.
    times = None if settings.delays is None else np.arange(len(points))[:, None] / rate + delays
    blobs = Blobs.from_rows(frame, camera_of, xy, rig.names, rate=rate, sizes=sizes, frames=len(points), times=times)
    return blobs, shows[np.argsort(frame * len(rig) + camera_of, kind="stable")]


Rows = tuple[Ints, Floats, Floats, Ints]
"""Blobs of one camera: frame (N,), position (N, 2) px, size (N,) px, what each shows (N,)."""


def _seen_by(
    camera: Camera, points: Floats, body: Capsules | None, settings: ImagingSettings, late: float, rng: np.random.Generator
) -> Rows:
    """The blobs of one camera, by frame and from top to bottom; `late`: frames after the first moment."""
    frames, size = len(points), _image_size(camera)
    # Markers and body at the moment of this camera: both move between its frame and the first one's.
    shadow = body if body is None else Capsules(_later(body.starts, late), _later(body.ends, late), body.radii, ())
    markers = _markers_of(camera, _later(points, late), shadow, settings, rng)
    lights = _lights(size, frames, settings, rng)
    frame, xy, sizes, shows = (np.concatenate(both) for both in zip(markers, lights, strict=True))
    # Outliers keep their frame and size; their place is anywhere in the image.
    astray = rng.random(len(frame)) < settings.outliers
    xy[astray] = rng.random((int(astray.sum()), 2)) * size
    shows[astray] = STRAY
    # A lost image loses all of its blobs at once.
    arrived = (rng.random(frames) >= settings.dropped)[frame]
    inside = ((xy > -0.5) & (xy < np.array(size) - 0.5)).all(axis=1)
    # By frame first, for the merging looks at one image after the other.
    order = np.argsort(frame, kind="stable")
    order = order[(arrived & inside)[order]]
    part = (frame[order], xy[order], sizes[order], shows[order])
    part = _merged(*part, frames) if settings.merging else part
    # From top to bottom, as detectors deliver them; the order must not tell which marker a blob is.
    order = np.lexsort((part[1][:, 0], part[1][:, 1], part[0]))
    return part[0][order], part[1][order], part[2][order], part[3][order]


def _image_size(camera: Camera) -> tuple[int, int]:
    if camera.size is None:
        raise AsterismError(f"camera {camera.name}: its image size is not known; give it one.")
    return camera.size


def _check(points: Floats, body: Capsules | None) -> None:
    if points.ndim != 3 or points.shape[2] != 3:
        raise AsterismError(f"positions have shape {points.shape}, expected (frames, markers, 3).")
    if body is not None and len(body.starts) != len(points):
        raise AsterismError(f"the body has {len(body.starts)} frames, the markers {len(points)}; give both the same.")


def _later(points: Floats, frames: float) -> Floats:
    """Points (T, ..., 3) some frames later, between frames by a cubic; before the first and after the last frame they go on straight."""
    if frames == 0.0 or len(points) < 2:
        return points
    at, moments = np.arange(len(points), dtype=np.float64), np.arange(len(points)) + frames
    flat = points.reshape(len(points), -1)
    out = np.full(flat.shape, np.nan)
    for column in range(flat.shape[1]):
        there = np.isfinite(flat[:, column])
        # A cubic needs all frames; a course with gaps is followed on straight lines, and its gaps stay.
        if there.all():
            inside = CubicSpline(at, flat[:, column], bc_type="natural")(np.clip(moments, 0, at[-1]))
            beyond = np.clip(moments - at[-1], 0, None) * (flat[-1, column] - flat[-2, column])
            out[:, column] = inside + beyond + np.clip(moments, None, 0) * (flat[1, column] - flat[0, column])
        elif there.any():
            out[:, column] = np.interp(moments, at[there], flat[there, column])
            out[~there[np.clip(np.rint(moments), 0, at[-1]).astype(np.int64)], column] = np.nan
    return out.reshape(points.shape)


def _markers_of(camera: Camera, points: Floats, body: Capsules | None, settings: ImagingSettings, rng: np.random.Generator) -> Rows:
    """The blobs of all markers before the camera that nothing hides."""
    # The noise before the question of visibility: a marker at the edge may leave the image by it.
    xy = camera.project(points) + rng.normal(0.0, 1.0, (*points.shape[:2], 2)) * settings.noise
    there = np.isfinite(xy[:, :, 0]) & (rng.random(points.shape[:2]) >= settings.missed)
    if body is not None:
        hidden: NDArray[np.bool_] = np.empty(points.shape[:2], dtype=np.bool_)
        starts, ends = np.ascontiguousarray(body.starts), np.ascontiguousarray(body.ends)
        _kernels.hidden(camera.position, np.ascontiguousarray(points), starts, ends, body.radii, 0.5 * settings.diameter, hidden)
        there &= ~hidden
    frame, marker = np.nonzero(there)
    # The size of a blob follows from the distance along the line of sight.
    depth = points[frame, marker] @ camera.rotation[2] + camera.translation[2]
    return frame, xy[frame, marker], camera.focal[0] * settings.diameter / depth, marker


def _lights(size: tuple[int, int], frames: int, settings: ImagingSettings, rng: np.random.Generator) -> Rows:
    """The blobs of lights that are not markers."""
    reflections = settings.reflections
    passing = np.repeat(np.arange(frames), rng.poisson(settings.strays, frames))
    static = np.repeat(np.arange(frames), reflections)
    # A reflection stays where it is but for the noise of its measurement.
    places = np.tile(rng.random((reflections, 2)) * size, (frames, 1)) + 0.2 * settings.noise * rng.normal(size=(len(static), 2))
    xy = np.concatenate([rng.random((len(passing), 2)) * size, places])
    sizes = np.concatenate([rng.uniform(2.0, 6.0, len(passing)), np.tile(rng.uniform(4.0, 20.0, reflections), frames)])
    frame = np.concatenate([passing, static])
    return frame, xy, sizes, np.full(len(frame), STRAY, dtype=np.int64)


def _merged(frame: Ints, xy: Floats, sizes: Floats, shows: Ints, frames: int) -> Rows:
    """The same blobs with every group of overlapping ones as one, weighted by area; they are sorted by frame."""
    offsets = np.searchsorted(frame, np.arange(frames + 1))
    head = np.empty(len(frame), dtype=np.int64)
    _kernels.merge(offsets, xy, sizes, head)
    heads, group, members = np.unique(head, return_inverse=True, return_counts=True)
    # A blob of two markers has the middle of the light, and light goes with the area.
    area = sizes**2
    total = np.bincount(group, area, len(heads))
    middle = np.stack([np.bincount(group, area * xy[:, axis], len(heads)) / total for axis in (0, 1)], axis=1)
    alone = members == 1
    middle[alone] = xy[heads[alone]]
    # strays only: still a stray
    markers = np.bincount(group, shows >= 0, len(heads))
    what = np.where(alone, shows[heads], np.where(markers > 0, MERGED, STRAY))
    return frame[heads], middle, np.sqrt(total), what
