"""Cameras from nothing but image sizes and a waved wand: a first pair, then one camera after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.calibration.wand.frames import shared_frames, shown, some_frames, spread_frames
from asterism.calibration.wand.identify import Agreed, Wand, agree
from asterism.calibration.wand.two_view import FEWEST, Pair, first_pair, guessed, priors
from asterism.cameras.bundle import Adjustment, Sightings, adjust, free_parameters
from asterism.cameras.camera import Camera
from asterism.progress import Progress
from asterism.recording import Blobs, Floats, Ints

Bools = NDArray[np.bool_]

_CAMERA_FRAMES, _WORKING_FRAMES = 50, 500
_COARSE, _FINE = 0.012, 0.005
"""How far blobs may be off while the lens is not known well, in widths of the image."""
_JOINT = 0.0012
"""What two cameras by themselves may miss, where nobody else sees what they see, in widths of the image."""


@dataclass(frozen=True)
class Start:
    """Cameras that a cold start posed.

    cameras  (C,) None where a camera could not be posed
    kept     share of the wand's blobs, by single images, that lie within the gate
    noise    px, of one coordinate
    """

    cameras: tuple[Camera | None, ...]
    kept: float
    noise: float

    @property
    def merit(self) -> tuple[int, float]:
        """More cameras first, then more kept and less noise."""
        return sum(camera is not None for camera in self.cameras), self.kept - 0.05 * self.noise


def cold_start(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    sizes: Sequence[tuple[int, int]],
    known: Sequence[Camera | None],
    progress: Progress | None = None,
) -> Start | None:
    """Pose all cameras that can be posed. Several first pairs are tried until one explains what was seen; None where none does.

    blobs, chosen  what `identify` was given and gave; sizes (C,) px; known (C,): cameras whose lens is known
    """
    frames = spread_frames(shown(chosen), max(_WORKING_FRAMES, 2 * _CAMERA_FRAMES * len(sizes)))
    blobs, chosen = some_frames(blobs, chosen, frames)
    shared = shared_frames(chosen)
    first = [(int(shared[a, b]), a, b) for a in range(len(sizes)) for b in range(a + 1, len(sizes)) if shared[a, b] >= FEWEST]
    tried = [first_pair(blobs, chosen, wand, sizes, known, a, b) for _, a, b in sorted(first, key=lambda s: (-s[0], s[1:]))[:6]]
    pairs = sorted((pair for pair in tried if pair is not None), key=lambda pair: pair.doubt)
    best: Start | None = None
    for n, pair in enumerate(pairs[:4]):
        start = _grow(blobs, chosen, wand, sizes, known, pair, progress if n == 0 else None)
        if best is None or start.merit > best.merit:
            best = start
        if start.kept > 0.9 and start.noise < 1.0 and all(start.cameras[c] is not None for c in np.nonzero(shared.sum(axis=0) > 0)[0]):
            break
    return best


def _grow(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    sizes: Sequence[tuple[int, int]],
    known: Sequence[Camera | None],
    pair: Pair,
    progress: Progress | None,
) -> Start:
    """One camera after the other by what is posed already; each time all are adjusted together."""
    cameras: list[Camera | None] = [pair.cameras.get(c) for c in range(len(sizes))]
    width = max(size[0] for size in sizes)
    noise, gate = pair.error, _COARSE * width
    while True:
        posed = [c for c, camera in enumerate(cameras) if camera is not None]
        for _ in range(2):
            agreed = agree(blobs, chosen, wand, cameras, gate)
            made = adjust_some(blobs, agreed, wand, cameras, known, ("pose", "focal", "k1", "k2"), 2.0, _CAMERA_FRAMES)
            if made is None:
                break
            result = made[0]
            for c, camera in zip(posed, result.cameras, strict=True):
                cameras[c] = camera
            noise = typical_noise(result.residuals)
            gate = max(_FINE * width, min(gate, 8.0 * noise))
        agreed = agree(blobs, chosen, wand, cameras, gate)
        if progress is not None:
            progress(0.1 + 0.5 * len(posed) / len(sizes), f"{len(posed)} of {len(sizes)} cameras posed")
        added = False
        for c in range(len(sizes)):
            if cameras[c] is None:
                cameras[c] = resected(blobs, chosen, agreed, wand, c, sizes[c], known[c])
                added = added or cameras[c] is not None
        if not added:
            added = _add_neighbour(blobs, chosen, wand, sizes, known, cameras)
        if not added:
            break
    posed_now = np.array([camera is not None for camera in cameras])
    told = (chosen >= 0) & posed_now[None, :, None]
    told &= (shown(chosen)[:, posed_now].sum(axis=1) >= 2)[:, None, None]
    kept = float((agreed.sights >= 0)[told].sum() / max(told.sum(), 1))
    return Start(tuple(cameras), kept, noise)


def _add_neighbour(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    sizes: Sequence[tuple[int, int]],
    known: Sequence[Camera | None],
    cameras: list[Camera | None],
) -> bool:
    """Pose, in place, one of the cameras that see the wand with a single posed one only, as in a chain; False where there is none.

    The pair is fitted by itself, its size is the wand's; one moved marker has none.
    """
    seen, shared = shown(chosen), shared_frames(chosen)
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    beside = [(int(shared[c, p]), c, p) for c in range(len(sizes)) if cameras[c] is None for p in posed if shared[c, p] >= FEWEST]
    for _, c, p in sorted(beside, key=lambda s: (-s[0], s[1:])):
        neighbour = cameras[p]
        several = int((seen[:, c] & (seen[:, posed].sum(axis=1) >= 2)).sum()) >= FEWEST
        if neighbour is None or several or len(wand.lengths) < 2:
            continue
        lenses = [*known]
        lenses[p] = replace(neighbour, rotation=np.eye(3), translation=np.zeros(3))
        pair = first_pair(blobs, chosen, wand, sizes, lenses, p, c)
        if pair is not None and pair.error < _JOINT * sizes[c][0]:
            found = pair.cameras[c]
            rotation, translation = found.rotation @ neighbour.rotation, found.rotation @ neighbour.translation + found.translation
            cameras[c] = replace(found, rotation=rotation, translation=translation)
            return True
    return False


def typical_noise(residuals: Floats) -> float:
    """px, the standard deviation of one coordinate by the median of what residuals (n, 2) miss, which outliers do not move."""
    return float(np.nanmedian(np.abs(residuals))) / 0.6745


def adjust_some(
    blobs: Blobs,
    agreed: Agreed,
    wand: Wand,
    cameras: Sequence[Camera | None],
    known: Sequence[Camera | None],
    groups: tuple[str, ...],
    scale: float,
    frames_per_camera: int,
) -> tuple[Adjustment, Sightings] | None:
    """Adjust the posed cameras on some frames of each, and on which sightings, by Cauchy's loss of this scale (px).

    None where too little agrees.
    """
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    frames = spread_frames(agreed.seen[:, posed], frames_per_camera * len(posed))
    sightings, kept = agreed.sightings(blobs, frames).compact()
    if len(kept) < FEWEST // 2:
        return None
    rotations, translations = (part[kept] for part in agreed.placements())
    own = [camera for camera in cameras if camera is not None]
    sightings = sightings.among(cameras)
    result = adjust(
        own, wand.template, sightings, rotations, translations,
        free=free_parameters(len(posed), *groups), prior=priors(own, [known[c] for c in posed], 0.5), loss="cauchy",
        scale=scale, tolerance=1e-4, steps=20, covariance=False,
    )  # fmt: skip
    return result, sightings


def resected(
    blobs: Blobs, chosen: Ints, agreed: Agreed, wand: Wand, camera: int, size: tuple[int, int], known: Camera | None
) -> Camera | None:
    """A camera from where the posed ones say that the wand lay; None where that does not fit."""
    frames = np.nonzero((chosen[:, camera] >= 0).all(axis=1) & np.isfinite(agreed.starts[:, 0]))[0]
    if len(frames) < FEWEST:
        return None
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, min(150, len(frames))).astype(np.int64))]
    world, xy = agreed.markers(wand, frames), blobs.xy[chosen[frames, camera]]
    if wand.either:
        middle = slice(1, 2) if len(wand.lengths) == 3 else slice(None)
        world, xy = world[:, middle].mean(axis=1, keepdims=True), xy[:, middle].mean(axis=1, keepdims=True)
    found, share = resect(world.reshape(-1, 3), xy.reshape(-1, 2), blobs.cameras[camera], size, known)
    return found if share > 0.5 else None


def resect(points: Floats, xy: Floats, name: str, size: tuple[int, int], known: Camera | None) -> tuple[Camera | None, float]:
    """A camera from points (n, 3) m and their images (n, 2) px by RANSAC over several focal lengths, and the share that fits it."""
    best, fit, share = None, -1.0, 0.0
    gate = 0.012 * size[0]
    for focal in [1.0] if known is not None else 0.5 * size[0] * 1.22 ** np.arange(11):
        camera = known or guessed(name, size, float(focal))
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
        score = float(np.where(near, 1.0 - np.square(off / gate), 0.0).sum())
        if score > fit:
            best, fit, share = posed, score, float(near.mean())
    return best, share
