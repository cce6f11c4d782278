"""Cameras from nothing but image sizes and a waved wand: a first pair, then one camera after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from asterism.calibration.wand.frames import evenly, spread_frames
from asterism.calibration.wand.poses import WandPoses
from asterism.calibration.wand.recording import WandRecording
from asterism.calibration.wand.two_view import RULES as TWO_VIEW
from asterism.calibration.wand.two_view import Pair, initial_camera, initial_pair, priors
from asterism.cameras.bundle import Adjustment, AdjustSettings, Sightings, adjust, free_parameters
from asterism.cameras.camera import Camera
from asterism.progress import Progress
from asterism.recording import Floats


@dataclass(frozen=True)
class InitialiseRules:
    """How cameras are posed one after the other.

    camera_frames    frames of each camera that an adjustment uses, evenly spread
    working_frames   frames of the recording, at least, that all of it works on
    pairs            pairs of cameras with most shared frames that are posed, and how many of the best begin a rig
    coarse, fine     how far blobs may be off while lenses are not known well, in widths of the image
    gate_noises      or as many times the noise
    joint            what two cameras by themselves may miss, where no other camera sees what they see, in widths of the image
    resection_frames frames that a camera is posed from
    least_share      share of these that its pose must fit
    enough_share     a rig that explains this share of the wand's images, with less than `enough_noise` px, ends the search

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    camera_frames: int = 50
    working_frames: int = 500
    pairs: tuple[int, int] = (6, 4)
    coarse: float = 0.012
    fine: float = 0.005
    gate_noises: float = 8.0
    joint: float = 0.0012
    resection_frames: int = 150
    least_share: float = 0.5
    enough_share: float = 0.9
    enough_noise: float = 1.0


RULES = InitialiseRules()


@dataclass(frozen=True)
class InitialCameras:
    """Cameras posed from nothing.

    cameras       (C,) None where a camera could not be posed
    inlier_share  share of the wand's blobs, by single images, that lie within the gate
    noise         px, of one coordinate
    """

    cameras: tuple[Camera | None, ...]
    inlier_share: float
    noise: float

    @property
    def rank(self) -> tuple[int, float]:
        """More cameras first, then more inliers and less noise."""
        return sum(camera is not None for camera in self.cameras), self.inlier_share - 0.05 * self.noise


def initialise_cameras(recording: WandRecording, progress: Progress | None = None) -> InitialCameras | None:
    """Pose all cameras that can be posed. Several first pairs are tried until one explains what was seen; None where no pair does."""
    cameras = len(recording.sizes)
    frames = spread_frames(recording.shows_wand, max(RULES.working_frames, 2 * RULES.camera_frames * cameras))
    recording = recording.select(frames)
    shared = recording.shared_frames
    first = [(int(shared[a, b]), a, b) for a in range(cameras) for b in range(a + 1, cameras) if shared[a, b] >= TWO_VIEW.least_frames]
    # Pairs that share many frames come first: the more a pair sees together, the better its two focal lengths are determined.
    tried = [initial_pair(recording, a, b) for _, a, b in sorted(first, key=lambda s: (-s[0], s[1:]))[: RULES.pairs[0]]]
    pairs = sorted((pair for pair in tried if pair is not None), key=lambda pair: pair.focal_uncertainty)
    best: InitialCameras | None = None
    for n, pair in enumerate(pairs[: RULES.pairs[1]]):
        start = _extend(recording, pair, progress if n == 0 else None)
        if best is None or start.rank > best.rank:
            best = start
        # A camera that shares no frame with any other can never be posed; it must not keep the search going.
        everyone = all(start.cameras[c] is not None for c in np.nonzero(shared.sum(axis=0) > 0)[0])
        if start.inlier_share > RULES.enough_share and start.noise < RULES.enough_noise and everyone:
            break
    return best


def _extend(recording: WandRecording, pair: Pair, progress: Progress | None) -> InitialCameras:
    """Pose one camera after the other by those that are posed already; each time all are adjusted together."""
    sizes = recording.sizes
    cameras: list[Camera | None] = [pair.cameras.get(c) for c in range(len(sizes))]
    width = max(size[0] for size in sizes)
    # Lenses are still rough here, so blobs far from where they should be may yet be right: the gate narrows as the lenses improve.
    noise, gate = pair.error, RULES.coarse * width
    added = True
    while added:
        posed = [c for c, camera in enumerate(cameras) if camera is not None]
        # Twice: the first round's better lenses let through blobs that its gate kept out.
        for _ in range(2):
            poses = recording.locate(cameras, gate)
            settings = AdjustSettings(loss="cauchy", scale=2.0, tolerance=1e-4, steps=20, covariance=False)
            adjusted = adjust_subset(recording, poses, cameras, ("pose", "focal", "k1", "k2"), RULES.camera_frames, settings)
            if adjusted is None:
                break
            result = adjusted[0]
            for c, camera in zip(posed, result.cameras, strict=True):
                cameras[c] = camera
            noise = robust_noise(result.residuals)
            gate = max(RULES.fine * width, min(gate, RULES.gate_noises * noise))
        poses = recording.locate(cameras, gate)
        if progress is not None:
            progress(0.1 + 0.5 * len(posed) / len(sizes), f"{len(posed)} of {len(sizes)} cameras posed")
        added = False
        for c in range(len(sizes)):
            if cameras[c] is None:
                cameras[c] = resect_camera(recording, poses, c)
                added = added or cameras[c] is not None
        added = added or _add_neighbour(recording, cameras)
    posed_now = np.array([camera is not None for camera in cameras])
    # Only images that a second posed camera can confirm count: a single one agrees with anything.
    offered = (recording.detections >= 0) & posed_now[None, :, None]
    offered &= (recording.shows_wand[:, posed_now].sum(axis=1) >= 2)[:, None, None]
    inliers = float((poses.observations >= 0)[offered].sum() / max(offered.sum(), 1))
    return InitialCameras(tuple(cameras), inliers, noise)


def _add_neighbour(recording: WandRecording, cameras: list[Camera | None]) -> bool:
    """Pose, in place, one of the cameras that see the wand with a single posed one only, as in a chain; False where there is no such one.

    The pair is fitted by itself. Its size is the wand's; one moved marker has no size.
    """
    if len(recording.wand) < 2:
        return False
    seen, shared, number = recording.shows_wand, recording.shared_frames, len(cameras)
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    beside = [
        (int(shared[c, p]), c, p) for c in range(number) if cameras[c] is None for p in posed if shared[c, p] >= TWO_VIEW.least_frames
    ]
    for _, c, p in sorted(beside, key=lambda s: (-s[0], s[1:])):
        neighbour = cameras[p]
        # A camera that overlaps with two posed ones is left to `resect_camera`, whose points in space are better determined.
        several = int((seen[:, c] & (seen[:, posed].sum(axis=1) >= 2)).sum()) >= TWO_VIEW.least_frames
        if neighbour is None or several:
            continue
        # The neighbour's lens is known by now. With it fixed, the pair cannot trade one focal length for the other.
        lenses = list(recording.lenses)
        lenses[p] = replace(neighbour, rotation=np.eye(3), translation=np.zeros(3))
        pair = initial_pair(replace(recording, lenses=tuple(lenses)), p, c)
        if pair is not None and pair.error < RULES.joint * recording.sizes[c][0]:
            found = pair.cameras[c]
            # From the pair's own world, which is the neighbour's camera, to the rig's.
            rotation, translation = found.rotation @ neighbour.rotation, found.rotation @ neighbour.translation + found.translation
            cameras[c] = replace(found, rotation=rotation, translation=translation)
            return True
    return False


def robust_noise(residuals: Floats) -> float:
    """px, the standard deviation of one coordinate by the median of residuals (n, 2), which outliers do not move."""
    return float(np.nanmedian(np.abs(residuals))) / 0.6745


def adjust_subset(
    recording: WandRecording,
    poses: WandPoses,
    cameras: Sequence[Camera | None],
    groups: tuple[str, ...],
    frames_per_camera: int,
    settings: AdjustSettings,
) -> tuple[Adjustment, Sightings] | None:
    """Adjust these groups of parameters of the posed cameras on some frames of each; and the sightings that were used.

    None where too few frames agree.
    """
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    frames = spread_frames(poses.seen[:, posed], frames_per_camera * len(posed))
    sightings, kept = poses.sightings(recording.blobs, frames).compact()
    if len(kept) < TWO_VIEW.least_frames // 2:
        return None
    rotations, translations = (part[kept] for part in poses.placements())
    own = [camera for camera in cameras if camera is not None]
    sightings = sightings.among(cameras)
    result = adjust(
        own, recording.wand.template, sightings, rotations, translations, free=free_parameters(len(posed), *groups),
        prior=priors(own, [recording.lenses[c] for c in posed], 0.5), settings=settings,
    )  # fmt: skip
    return result, sightings


def resect_camera(recording: WandRecording, poses: WandPoses, camera: int) -> Camera | None:
    """A camera from where the posed ones say that the wand lay; None where that does not fit."""
    wand = recording.wand
    frames = np.nonzero(recording.shows_wand[:, camera] & np.isfinite(poses.starts[:, 0]))[0]
    if len(frames) < TWO_VIEW.least_frames:
        return None
    frames = evenly(frames, RULES.resection_frames)
    world, xy = poses.markers(wand, frames), recording.images(frames, camera)
    if wand.symmetric:
        # Which end is which is open, but the middle is the same from both ends.
        middle = slice(1, 2) if len(wand) == 3 else slice(None)
        world, xy = world[:, middle].mean(axis=1, keepdims=True), xy[:, middle].mean(axis=1, keepdims=True)
    name, size, lens = recording.blobs.cameras[camera], recording.sizes[camera], recording.lenses[camera]
    found, share = resect(world.reshape(-1, 3), xy.reshape(-1, 2), name, size, lens)
    return found if share > RULES.least_share else None


def resect(points: Floats, xy: Floats, name: str, size: tuple[int, int], known: Camera | None) -> tuple[Camera | None, float]:
    """A camera from points (n, 3) m and their images (n, 2) px by RANSAC over several focal lengths, and the share that fits it."""
    best, fit, share = None, -1.0, 0.0
    gate = RULES.coarse * size[0]
    # An unknown focal length is tried in steps of 22 %, near enough for the adjustment that follows to find the rest.
    for focal in [1.0] if known is not None else 0.5 * size[0] * 1.22 ** np.arange(11):
        camera = known or initial_camera(name, size, float(focal))
        flat = camera.undistort(xy)
        good = np.isfinite(flat).all(axis=1)
        if good.sum() < 6:
            continue
        limit = gate / camera.focal[0]
        done, turn, shift, _ = cv2.solvePnPRansac(
            points[good], np.ascontiguousarray(flat[good]), np.eye(3), None,
            iterationsCount=60, reprojectionError=limit, confidence=0.999, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
        if not done:
            continue
        posed = replace(camera, rotation=cv2.Rodrigues(turn)[0], translation=shift.ravel(), posed=True)
        off = np.linalg.norm(posed.project(points) - xy, axis=1)
        near = off < gate
        # A count of inliers alone would favour a long focal length, which brings all points near the axis; closeness counts too.
        score = float(np.where(near, 1.0 - np.square(off / gate), 0.0).sum())
        if score > fit:
            best, fit, share = posed, score, float(near.mean())
    return best, share
