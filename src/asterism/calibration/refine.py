"""A rig and any recording of markers in; which camera was bumped, and the rig mended from the recording itself, out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera, Rig
from asterism.cameras.bundle import PARAMETERS, AdjustSettings, Sightings, adjust, free_parameters
from asterism.errors import AsterismError
from asterism.geometry import vector_from_rotation
from asterism.progress import Progress
from asterism.reconstruction.camera_fit import fit_of_cameras, frames_behind, match_radius, misfit_limit
from asterism.reconstruction.reconstruct import reconstruct
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.settings import ReconstructionSettings
from asterism.recording import Blobs, Floats, Ints
from asterism.synchronization import to_common_clock
from asterism.synchronization.lags import out_of_step

_CONTRADICT = "the cameras contradict each other so much that none can be trusted; calibrate the rig again."
_SURE = 4.0
"""Standard deviations by which a view must have moved, or a focal length have changed, to be called so."""
_BY_TWO = 2.0
"""So many times as uncertain are points of two cameras."""
_SAME = (0.05, 0.1)
"""rad and m, within which two cameras stand in one place."""
_ZOOMED = 0.001
"""The least change of a focal length that is told."""
_FRAMES, _FEWEST = 80, 40
_NOISE_FRAMES, _MOST_GROUPS, _USUAL_NOISE, _MOST_NOISE = 16, 30, 0.5, 3.0
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
    zoomed   share by which its focal length changed, 0 where the recording does not tell that it did
    shown    share of the points in its image that it shows, once mended
    points   points of the others that it could be compared with
    state    "good", "bumped" (and mended), "out of step", "lost" (it does not fit, and could not be mended) or "unknown" (too little to
             compare)
    behind   frames by which it is behind the others
    place_of another camera of the rig in whose place it stands once mended, else ""
    """

    name: str
    before: float
    after: float
    turned: float
    shifted: float
    zoomed: float
    shown: float
    points: int
    state: str
    behind: int
    place_of: str


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
                if check.place_of:
                    said.append(f"camera {check.name} stands where the rig has camera {check.place_of}: were their names exchanged?")
                    continue
                zoom = f", its focal length changed by {100 * check.zoomed:+.2f} % (zoom or focus)" if check.zoomed else ""
                said.append(
                    f"camera {check.name} was bumped: it is turned by {np.degrees(check.turned):.2f} degrees and shifted by "
                    f"{1000 * check.shifted:.0f} mm{zoom}, {check.before:.1f} px in its image; it was mended."
                )
            elif check.state == "out of step":
                said.append(f"{' '.join(out_of_step(check.name, check.behind))} It was left as it is.")
            elif check.state == "lost":
                said.append(
                    f"camera {check.name} does not fit the others, and no new pose mends that: its lens, the size of its images or its "
                    "name in the rig may be another; calibrate it again."
                )
            elif check.state == "unknown":
                said.append(
                    f"the recording tells too little to check camera {check.name} ({check.points} points that others see too); "
                    "record markers that move all over the volume."
                )
        return tuple(said)


def refine_rig(blobs: Blobs, rig: Rig, *, frames: int = _FRAMES, progress: Progress | None = None) -> Refinement:
    """Check every camera of a rig against what the others see, and mend those that were bumped.

    blobs   any recording of markers, taken after the bump; the more markers move all over the volume, the better
    frames  how many of its frames to look at

    Each camera in turn is left out, and the points that the others compose are looked for in its images: near where they should be, or
    anywhere that all of them together have moved to. The camera that has moved and fits best in a new place is mended first; then the
    others are looked at without it, and again, until those that are left agree. A camera that would fit at another frame is out of step and
    left alone. At last the mended poses, and focal lengths that clearly changed, are adjusted to all sightings, the others held; a camera
    that is still off is lost. Raises AsterismError where fewer than three cameras of the rig have blobs, nothing can be composed, or no few
    cameras agree with each other.
    """
    blobs = to_common_clock(blobs) if blobs.times is not None else blobs
    rig = rig.select(blobs.cameras)
    seeing = [c for c in range(len(rig)) if rig[c].posed and blobs.counts[:, c].any()]
    if len(seeing) < 3:
        raise AsterismError(f"only {len(seeing)} cameras of the rig have blobs and a pose; to tell which one was bumped takes three.")
    told = progress or (lambda fraction, doing: None)
    some, picked = _some_frames(blobs, seeing, frames)
    told(0.0, "measuring the noise")
    noise = _noise(some, rig, seeing)
    sound = list(seeing)
    looks: dict[int, _Look] = {}
    while len(sound) >= 2:
        looks = {}
        for n, c in enumerate(seeing):
            told(0.1 + 0.8 * (1 - (len(sound) - n / len(seeing)) / (len(seeing) + 1)), f"looking at camera {rig[c].name}")
            others = [other for other in sound if other != c]
            if len(others) >= 2:
                looks[c] = _look(some, rig, c, others, noise)
        moved = [c for c in sound if c in looks and looks[c].moved > _least_move(looks[c], noise, len(sound) - 1)]
        if not moved:
            break
        sound.remove(_worst(some, rig, moved, looks, sound, noise))
    if len(sound) < max(2, len(seeing) / 2):
        raise AsterismError(_CONTRADICT)
    others = [c for c in seeing if c not in sound]
    behind = {c: _behind(blobs, some, picked, rig, c, sound, noise) for c in others}
    bumped = [c for c in others if looks[c].camera is not None and not behind[c]]
    told(0.9, "adjusting")
    fitted = _mended(some, rig, bumped, {c: looks[c].camera for c in bumped}, sound, noise)
    last = _adjusted(some, fitted, [], [*sound, *bumped], noise)
    limit = misfit_limit(noise)
    unfit = [c for c in bumped if not last.off[c] <= limit]
    if unfit:
        last = _adjusted(some, fitted, [], [c for c in (*sound, *bumped) if c not in unfit], noise)
    states = _states(rig, seeing, sound, looks, behind, last.off, limit)
    if 2 * sum(states[c] == "lost" for c in sound) >= len(sound):
        raise AsterismError(_CONTRADICT)
    fitted = replace(fitted, cameras=tuple(fitted[c] if states[c] == "bumped" else rig[c] for c in range(len(rig))))
    checks = tuple(_check(rig, c, fitted[c], looks.get(c), float(last.errors[c]), states[c], behind.get(c, 0)) for c in range(len(rig)))
    told(1.0, "done")
    return Refinement(fitted, checks, noise, len(some))


def _least_move(look: _Look, noise: float, others: int) -> float:
    """px that a view must have moved by to be called moved, by what noise makes of a pose from so many points of so many cameras."""
    least = max(misfit_limit(noise), _SURE * noise * math.sqrt(6.0 / max(look.shown * look.points, 1.0)))
    return least if others >= 3 else _BY_TWO * least


def _behind(blobs: Blobs, some: Blobs, picked: Ints, rig: Rig, camera: int, sound: list[int], noise: float) -> int:
    """By how many frames a camera, as the rig has it, is behind those that are sound."""
    clouds = list(_reconstructed(some, rig, sound, noise).clouds)
    return frames_behind(clouds, picked.tolist(), blobs, camera, rig[camera], match_radius(noise))


def _mended(blobs: Blobs, rig: Rig, bumped: list[int], poses: dict[int, Camera | None], sound: list[int], noise: float) -> Rig:
    """The rig with its bumped cameras adjusted, twice since what they are seen to show changes; focal lengths only where they changed."""
    fitted = replace(rig, cameras=tuple(poses.get(c) or rig[c] for c in range(len(rig))))
    cameras = [*sound, *bumped]
    for _ in range(2 if bumped else 0):
        trial = _adjusted(blobs, fitted, bumped, cameras, noise, zoomed=bumped)
        least = np.maximum(_ZOOMED * np.array([camera.focal[0] for camera in rig]), _SURE * trial.focal_sigma)
        zoomed = [c for c in bumped if abs(trial.rig[c].focal[0] - rig[c].focal[0]) > least[c] and np.isfinite(trial.off[c])]
        start = tuple(trial.rig[c] if c in zoomed else replace(fitted[c], focal=rig[c].focal) for c in range(len(rig)))
        fitted = _adjusted(blobs, replace(rig, cameras=start), bumped, cameras, noise, zoomed=zoomed).rig
    return fitted


def _states(
    rig: Rig, seeing: list[int], sound: list[int], looks: dict[int, _Look], behind: dict[int, int], off: Floats, limit: float
) -> list[str]:
    """What became of each camera. Two sound cameras have nobody to look at them but each other."""
    states = []
    for c in range(len(rig)):
        if c not in seeing:
            states.append("unknown")
        elif c in sound:
            known = np.isfinite(off[c]) and (len(sound) < 3 or np.isfinite(looks[c].moved))
            states.append("unknown" if not known else "good" if off[c] <= limit else "lost")
        elif behind[c]:
            states.append("out of step")
        else:
            states.append("bumped" if off[c] <= limit else "lost")
    return states


def _worst(blobs: Blobs, rig: Rig, moved: list[int], looks: dict[int, _Look], sound: list[int], noise: float) -> int:
    """Of cameras that seem to have moved, the one that was: with its new pose all agree best. A bumped camera makes others look bumped."""
    likely = sorted((c for c in moved if looks[c].camera is not None), key=lambda c: -looks[c].shown)[:3]
    if len(likely) < 2:
        return likely[0] if likely else max(moved, key=lambda c: -looks[c].shown)
    merit = {}
    for c in likely:
        trial = replace(rig, cameras=tuple(looks[c].camera or camera if i == c else camera for i, camera in enumerate(rig)))
        fit = _adjusted(blobs, trial, [c], sound, noise)
        merit[c] = fit.sightings * (1.0 - float(np.nanmean(fit.errors)) / (8.0 * noise)) if fit.sightings else -math.inf
    return max(likely, key=lambda c: merit[c])


@dataclass(frozen=True)
class _Look:
    """What the others' points tell of a camera: a better pose, by how much its view has moved (px), what share of points it shows then."""

    camera: Camera | None
    moved: float
    shown: float
    points: int


def _some_frames(blobs: Blobs, seeing: list[int], most: int) -> tuple[Blobs, Ints]:
    """Frames in which most cameras see something, evenly spread, and their numbers."""
    cameras = (blobs.counts[:, seeing] > 0).sum(axis=1)
    useful = np.nonzero(cameras >= min(3, len(seeing)))[0]
    if not len(useful):
        raise AsterismError("in no frame do three cameras see anything; give a recording of markers that several cameras see.")
    picked = useful[np.unique(np.linspace(0, len(useful) - 1, min(most, len(useful))).astype(np.int64))]
    place = np.full(len(blobs), -1)
    place[picked] = np.arange(len(picked))
    kept = place[blobs.frame_of] >= 0
    some = Blobs.from_rows(
        place[blobs.frame_of[kept]], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, rate=blobs.rate, frames=len(picked)
    )
    return some, picked


def _noise(blobs: Blobs, rig: Rig, cameras: list[int]) -> float:
    """px, the pixel noise by the small group of cameras that shows least of it: in some group none was bumped.

    Groups are three cameras, neighbours first, two where there are but three; one with no more noise than good blobs have ends it.
    Raises AsterismError where no group agrees.
    """
    few, _ = _some_frames(blobs, cameras, _NOISE_FRAMES)
    groups = list(combinations(cameras, 2 if len(cameras) == 3 else 3))
    places = np.array([camera.position for camera in rig])
    spread = [float(np.linalg.norm(places[list(group)] - places[list(group)].mean(axis=0))) for group in groups]
    least = np.inf
    for n in np.argsort(spread, kind="stable")[:_MOST_GROUPS]:
        made = _reconstructed(few, rig, list(groups[n]), None)
        if made.noise_known:
            least = min(least, float(np.median(made.noise)))
        if least < _USUAL_NOISE and len(cameras) > 3:
            break
    if least > _MOST_NOISE:
        raise AsterismError(
            f"no few cameras agree on points to {_MOST_NOISE:g} px: this is not the rig of the recording (image size, names of cameras, y "
            "counted from the top?), or too few markers move in it; calibrate the rig again, or record more of them."
        )
    return least


def _reconstructed(blobs: Blobs, rig: Rig, cameras: list[int], noise: float | None) -> Reconstruction:
    """Points by some cameras only, those that three of them show where there are four."""
    part = replace(rig, cameras=tuple(rig[c] for c in cameras))
    return reconstruct(_of_cameras(blobs, cameras), part, ReconstructionSettings(noise=noise, min_cameras=3 if len(cameras) >= 4 else 2))


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
    clouds = _reconstructed(blobs, rig, others, noise).clouds
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


@dataclass(frozen=True)
class _Fit:
    """An adjusted rig; for each camera its error and how far it is off as a whole (C,) px, NaN where nothing tells; how many blobs show
    the points; the standard deviations of focal lengths (C,) px, 0 where they were held."""

    rig: Rig
    errors: Floats
    off: Floats
    sightings: int
    focal_sigma: Floats


def _adjusted(blobs: Blobs, rig: Rig, bumped: list[int], cameras: list[int], noise: float, zoomed: Sequence[int] = ()) -> _Fit:
    """The bumped cameras' poses, and focal lengths of those zoomed, by all points that three cameras or more show, the others held."""
    order = sorted(cameras)
    own = _of_cameras(blobs, order)
    part = Rig(tuple(rig[c] for c in order), rig.vertical)
    made = reconstruct(own, part, ReconstructionSettings(noise=noise, min_cameras=min(3, len(order))))
    errors, off, sigma = np.full(len(rig), np.nan), np.full(len(rig), np.nan), np.zeros(len(rig))
    if not len(made.rays):
        return _Fit(rig, errors, off, 0, sigma)
    off[order] = [camera.systematic for camera in fit_of_cameras(made, part)]
    point, camera = np.nonzero(made.rays >= 0)
    sightings = Sightings.of(point, camera, np.zeros(len(point), dtype=np.int64), made.blobs.xy[made.rays[point, camera]])
    free = free_parameters(len(order), "pose")
    free[[i for i, c in enumerate(order) if c not in bumped]] = False
    free |= free_parameters(len(order), "focal") & np.array([c in zoomed for c in order])[:, None]
    points = made.clouds.xyz
    turned = np.tile(np.eye(3), (len(points), 1, 1))
    told = len(zoomed) > 0
    settings = AdjustSettings(scale=3.0 * noise, covariance=told)
    result = adjust(list(part), np.zeros((1, 3)), sightings, turned, points, free=free, settings=settings)
    cameras_now = list(rig.cameras)
    for i, c in enumerate(order):
        errors[c] = result.cameras[i].error
        if c in bumped:
            cameras_now[c] = result.cameras[i]
    if told:
        sigma[order] = np.nan_to_num(result.sigma[:, PARAMETERS.index("focal")])
    return _Fit(replace(rig, cameras=tuple(cameras_now)), errors, off, len(sightings), sigma)


def _check(rig: Rig, c: int, now: Camera, look: _Look | None, error: float, state: str, behind: int) -> CameraCheck:
    was = rig[c]
    turned, shifted = _apart(was, now)
    near_it = (
        other.name for other in rig if other.name != was.name and _apart(other, now)[0] < _SAME[0] and _apart(other, now)[1] < _SAME[1]
    )
    place_of = next(near_it, "") if state == "bumped" else ""
    zoomed = now.focal[0] / was.focal[0] - 1.0
    moved, shown, points = (look.moved, look.shown, look.points) if look is not None else (float("nan"), float("nan"), 0)
    return CameraCheck(was.name, moved, error, turned, shifted, zoomed, shown, points, state, behind, place_of)


def _apart(one: Camera, other: Camera) -> tuple[float, float]:
    """rad and m by which two cameras are turned and shifted against each other."""
    turned = float(np.linalg.norm(vector_from_rotation(other.rotation @ one.rotation.T)))
    return turned, float(np.linalg.norm(other.position - one.position))
