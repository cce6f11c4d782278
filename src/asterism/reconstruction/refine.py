"""A rig and any recording of markers in; which camera was bumped, and the rig mended from the recording itself, out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera, Rig, vector_from_rotation
from asterism.cameras.bundle import Sightings, adjust, free_parameters
from asterism.errors import AsterismError
from asterism.reconstruction.reconstruct import reconstruct
from asterism.recording import Blobs, Floats, to_common_clock

Progress = Callable[[float, str], None]

BUMPED = 0.6
"""px: a camera whose view of the points has moved by this much, or by twice the noise, was bumped."""
_FRAMES, _FEWEST = 80, 40
_NOISE_FRAMES, _MOST_GROUPS, _USUAL_NOISE = 16, 30, 0.5
_REACH, _BIN = 0.25, 0.004
"""How far the images of a bumped camera are looked for, and how finely, in widths of the image."""
_KEPT = 0.15
"""The share of its points that a camera must show again once it is mended."""


@dataclass(frozen=True)
class CameraCheck:
    """How one camera fits what the others see.

    name     of the camera
    before   px, median distance by which the recording says that its view has moved from where the rig has it; NaN where nothing is told
    after    px, RMS reprojection error of the points that it shows, with the mended rig
    turned   rad, and shifted m: how far the mended camera is from the rig's
    shown    share of the points in its image that it shows, once mended
    points   points of the others that it could be compared with
    state    "good", "bumped" (and mended), "lost" (it does not fit, and could not be mended) or "unknown" (too little to compare)
    """

    name: str
    before: float
    after: float
    turned: float
    shifted: float
    shown: float
    points: int
    state: str


@dataclass(frozen=True)
class Refinement:
    """A mended rig: those cameras that were bumped have new poses, the others are as they were.

    rig      all cameras; those that are lost keep their old pose
    cameras  (C,) what became of each
    noise    px, standard deviation of one coordinate of a blob
    frames   how many frames were looked at
    """

    rig: Rig
    cameras: tuple[CameraCheck, ...]
    noise: float
    frames: int

    @property
    def findings(self) -> tuple[str, ...]:
        """One sentence for each camera that is not good."""
        said = []
        for check in self.cameras:
            if check.state == "bumped":
                said.append(
                    f"camera {check.name} was bumped: it is turned by {np.degrees(check.turned):.2f} degrees and shifted by "
                    f"{1000 * check.shifted:.0f} mm, {check.before:.1f} px in its image; it was mended."
                )
            elif check.state == "lost":
                said.append(f"camera {check.name} does not fit the others and could not be mended; calibrate it again.")
            elif check.state == "unknown":
                said.append(f"camera {check.name} sees too few points that others see ({check.points}) to be checked; record more.")
        return tuple(said)


def refine_rig(blobs: Blobs, rig: Rig, *, frames: int = _FRAMES, progress: Progress | None = None) -> Refinement:
    """Check every camera of a rig against what the others see, and mend those that were bumped.

    blobs   any recording of markers, taken after the bump; the more markers move all over the volume, the better
    frames  how many of its frames to look at

    Each camera in turn is left out, and the points that the others compose are looked for in its images: near where they should be, or
    anywhere that all of them together have moved to. The camera that has moved and fits best in a new place is mended first; then the
    others are looked at without it, and again, until those that are left agree. At last the mended poses are adjusted to all sightings, the
    others held. Raises AsterismError where fewer than three cameras of the rig have blobs, or nothing can be composed.
    """
    blobs = to_common_clock(blobs) if blobs.times is not None else blobs
    rig = rig.select(blobs.cameras)
    seeing = [c for c in range(len(rig)) if blobs.counts[:, c].any()]
    if len(seeing) < 3:
        raise AsterismError(f"only {len(seeing)} cameras of the rig have blobs; to tell which one was bumped takes three.")
    told = progress or (lambda fraction, doing: None)
    some = _some_frames(blobs, seeing, frames)
    told(0.0, "measuring the noise")
    noise = _noise(some, rig, seeing)
    sound, mended = list(seeing), list(rig.cameras)
    looks: dict[int, _Look] = {}
    while len(sound) >= 2:
        looks = {}
        for n, c in enumerate(seeing):
            told(0.1 + 0.8 * (1 - (len(sound) - n / len(seeing)) / (len(seeing) + 1)), f"looking at camera {rig[c].name}")
            others = [other for other in sound if other != c]
            if len(others) >= 2:
                looks[c] = _look(some, rig, c, others, noise)
        moved = [c for c in sound if c in looks and looks[c].moved > max(BUMPED, 2.0 * noise)]
        if not moved:
            break
        sound.remove(_worst(some, rig, moved, looks, sound, noise))
    if len(sound) < 2:
        raise AsterismError("the cameras contradict each other so much that none can be trusted; calibrate the rig again.")
    bumped = [c for c in seeing if c not in sound and looks[c].camera is not None]
    for c in bumped:
        mended[c] = looks[c].camera or rig[c]
    told(0.9, "adjusting")
    fitted, errors, _ = _adjusted(some, replace(rig, cameras=tuple(mended)), bumped, [*sound, *bumped], noise)
    fits = np.isfinite(errors) & (errors < max(5.0 * noise, 1.5))
    states = ["lost" if c in seeing else "unknown" for c in range(len(rig))]
    for c in seeing:
        if c in bumped and fits[c]:
            states[c] = "bumped"
        elif c in sound:
            states[c] = "good" if fits[c] else "unknown"
    fitted = replace(fitted, cameras=tuple(fitted[c] if states[c] == "bumped" else rig[c] for c in range(len(rig))))
    checks = tuple(_check(rig[c], fitted[c], looks.get(c), float(errors[c]), states[c]) for c in range(len(rig)))
    told(1.0, "done")
    return Refinement(fitted, checks, noise, len(some))


def _worst(blobs: Blobs, rig: Rig, moved: list[int], looks: dict[int, _Look], sound: list[int], noise: float) -> int:
    """Of cameras that seem to have moved, the one that was: with its new pose all agree best. A bumped camera makes others look bumped."""
    likely = sorted((c for c in moved if looks[c].camera is not None), key=lambda c: -looks[c].shown)[:3]
    if len(likely) < 2:
        return likely[0] if likely else max(moved, key=lambda c: -looks[c].shown)
    merit = {}
    for c in likely:
        trial = replace(rig, cameras=tuple(looks[c].camera or camera if i == c else camera for i, camera in enumerate(rig)))
        _, errors, sightings = _adjusted(blobs, trial, [c], sound, noise)
        merit[c] = sightings * (1.0 - float(np.nanmean(errors)) / (8.0 * noise))
    return max(likely, key=lambda c: merit[c])


@dataclass(frozen=True)
class _Look:
    """What the others' points tell of a camera: a better pose, by how much its view has moved (px), what share of points it shows then."""

    camera: Camera | None
    moved: float
    shown: float
    points: int


def _some_frames(blobs: Blobs, seeing: list[int], most: int) -> Blobs:
    """Frames in which most cameras see something, evenly spread."""
    cameras = (blobs.counts[:, seeing] > 0).sum(axis=1)
    useful = np.nonzero(cameras >= min(3, len(seeing)))[0]
    if not len(useful):
        raise AsterismError("in no frame do three cameras see anything; give a recording of markers that several cameras see.")
    picked = useful[np.unique(np.linspace(0, len(useful) - 1, min(most, len(useful))).astype(np.int64))]
    place = np.full(len(blobs), -1)
    place[picked] = np.arange(len(picked))
    kept = place[blobs.frame_of] >= 0
    return Blobs.from_rows(
        place[blobs.frame_of[kept]], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, rate=blobs.rate, frames=len(picked)
    )


def _noise(blobs: Blobs, rig: Rig, cameras: list[int]) -> float:
    """px, the pixel noise by the small group of cameras that shows least of it: in some group none was bumped.

    Groups are three cameras, neighbours first, two where there are but three; one with no more noise than good blobs have ends it.
    """
    few = _some_frames(blobs, cameras, _NOISE_FRAMES)
    groups = list(combinations(cameras, 2 if len(cameras) == 3 else 3))
    places = np.array([camera.position for camera in rig])
    spread = [float(np.linalg.norm(places[list(group)] - places[list(group)].mean(axis=0))) for group in groups]
    least = np.inf
    for n in np.argsort(spread, kind="stable")[:_MOST_GROUPS]:
        least = min(least, _points(few, rig, list(groups[n]), None)[1])
        if least < _USUAL_NOISE and len(cameras) > 3:
            break
    return float(least)


def _points(blobs: Blobs, rig: Rig, cameras: list[int], noise: float | None) -> tuple[list[Floats], float]:
    """The points of each frame by some cameras only, those that three of them show where there are four, and the pixel noise told."""
    own = _of_cameras(blobs, cameras)
    made = reconstruct(own, replace(rig, cameras=tuple(rig[c] for c in cameras)), noise=noise, min_cameras=3 if len(cameras) >= 4 else 2)
    return [made.clouds[t] for t in range(len(own))], float(np.median(made.noise))


def _of_cameras(blobs: Blobs, cameras: list[int]) -> Blobs:
    """The blobs of some cameras only."""
    place = np.full(len(blobs.cameras), -1)
    place[cameras] = np.arange(len(cameras))
    own = place[blobs.camera_of]
    kept = own >= 0
    names = [blobs.cameras[c] for c in cameras]
    return Blobs.from_rows(blobs.frame_of[kept], own[kept], blobs.xy[kept], names, rate=blobs.rate, frames=len(blobs))


def _look(blobs: Blobs, rig: Rig, camera: int, others: list[int], noise: float) -> _Look:
    """Look for the others' points in a camera's images."""
    model = rig[camera]
    clouds, _ = _points(blobs, rig, others, noise)
    size = np.array(model.size or (2.0 * model.centre[0], 2.0 * model.centre[1]))
    images = [blobs.of(t, camera) for t in range(len(blobs))]
    pairs = [(points, xy) for points, xy in zip(clouds, images, strict=True) if len(points) and len(xy)]
    near = sum(int(_inside(model.project(points), size).sum()) for points, _ in pairs)
    if near < _FEWEST:
        return _Look(None, float("nan"), float("nan"), near)
    best = _Look(None, float("inf"), 0.0, near)
    for start in (np.zeros(2), _shift(model, pairs, size)):
        found = _fitted(model, pairs, size, noise, start)
        if found is not None and found.shown > best.shown + 0.05:
            best = found
        if best.shown > 0.9:
            break
    return best if best.shown >= _KEPT else _Look(None, float("inf"), best.shown, near)


def _inside(xy: Floats, size: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(xy).all(axis=1) & (xy > 0).all(axis=1) & (xy < size).all(axis=1))


def _shift(camera: Camera, pairs: list[tuple[Floats, Floats]], size: Floats) -> Floats:
    """px: by how much most images have moved together, by a vote of all pairs of a point and a blob of its frame."""
    reach, cell = _REACH * size[0], _BIN * size[0]
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


def _fitted(camera: Camera, pairs: list[tuple[Floats, Floats]], size: Floats, noise: float, start: Floats) -> _Look | None:
    """Pose a camera anew by the blobs nearest to where points should be, moved by `start` px at first, within a gate that narrows."""
    posed = camera
    gates = [*(0.02 * size[0] * 0.55 ** np.arange(4)), *([max(4.0 * noise, 1.0)] * 3)]
    shift = start
    for gate in gates:
        points, xy = _matched(posed, pairs, gate, shift)
        if len(points) < _FEWEST // 2:
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
    if inside.sum() < _FEWEST:
        return None
    seen = _matched(posed, pairs, max(4.0 * noise, 1.0), shift)[0]
    moved_by = np.linalg.norm(posed.project(world[inside]) - camera.project(world[inside]), axis=1)
    moved_by = np.where(np.isfinite(moved_by), moved_by, np.inf)
    return _Look(posed, float(np.median(moved_by)), min(len(seen) / int(inside.sum()), 1.0), int(inside.sum()))


def _matched(camera: Camera, pairs: list[tuple[Floats, Floats]], gate: float, shift: Floats) -> tuple[Floats, Floats]:
    """Points (n, 3) m and the blobs (n, 2) px that are each other's nearest and within the gate."""
    points, places = [np.empty((0, 3))], [np.empty((0, 2))]
    for cloud, xy in pairs:
        projected = camera.project(cloud) + shift
        off = np.linalg.norm(projected[:, None] - xy[None], axis=2)
        off = np.where(np.isfinite(off), off, np.inf)
        blob = off.argmin(axis=1)
        mutual = (off.argmin(axis=0)[blob] == np.arange(len(cloud))) & (off[np.arange(len(cloud)), blob] < gate)
        points.append(cloud[mutual])
        places.append(xy[blob[mutual]])
    return np.concatenate(points), np.concatenate(places)


def _adjusted(blobs: Blobs, rig: Rig, bumped: list[int], cameras: list[int], noise: float) -> tuple[Rig, Floats, int]:
    """The bumped cameras' poses by all points that three cameras or more show, the others held.

    Returns the rig, each camera's error (C,) px, and the number of blobs that show such points.
    """
    order = sorted(cameras)
    own = _of_cameras(blobs, order)
    part = [rig[c] for c in order]
    made = reconstruct(own, replace(rig, cameras=tuple(part)), noise=noise, min_cameras=min(3, len(order)))
    errors = np.full(len(rig), np.nan)
    if not len(made.rays):
        return rig, errors, 0
    point, camera = np.nonzero(made.rays >= 0)
    sightings = Sightings.of(point, camera, np.zeros(len(point), dtype=np.int64), made.blobs.xy[made.rays[point, camera]])
    free = free_parameters(len(order), "pose")
    free[[i for i, c in enumerate(order) if c not in bumped]] = False
    points = np.concatenate([made.clouds[t] for t in range(len(own))])
    turned = np.tile(np.eye(3), (len(points), 1, 1))
    result = adjust(part, np.zeros((1, 3)), sightings, turned, points, free=free, scale=3.0 * noise, covariance=False)
    cameras_now = list(rig.cameras)
    for i, c in enumerate(order):
        errors[c] = result.cameras[i].error
        if c in bumped:
            cameras_now[c] = result.cameras[i]
    return replace(rig, cameras=tuple(cameras_now)), errors, len(sightings)


def _check(was: Camera, now: Camera, look: _Look | None, error: float, state: str) -> CameraCheck:
    turned = float(np.linalg.norm(vector_from_rotation(now.rotation @ was.rotation.T)))
    moved, shown, points = (look.moved, look.shown, look.points) if look is not None else (float("nan"), float("nan"), 0)
    return CameraCheck(was.name, moved, error, turned, float(np.linalg.norm(now.position - was.position)), shown, points, state)
