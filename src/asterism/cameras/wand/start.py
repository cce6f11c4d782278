"""Cameras from nothing but image sizes and a waved wand: a first pair, then one camera after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.cameras.bundle import Adjustment, Sightings, adjust, free_parameters, place_objects, triangulate
from asterism.cameras.camera import Camera
from asterism.cameras.wand.identify import Agreed, Wand, agree
from asterism.recording import Blobs, Floats, Ints

Bools = NDArray[np.bool_]

GUESSES = (0.55, 0.8, 1.15, 1.65, 2.4, 3.6)
"""Focal lengths to begin with, in widths of the image."""
FEWEST = 25
"""So many frames must two cameras share, or a camera with those that are posed already."""
_PAIR_FRAMES, _CAMERA_FRAMES, _WORKING_FRAMES = 100, 50, 500
_COARSE, _FINE = 0.012, 0.005
"""How far blobs may be off while the lens is not known well, in widths of the image."""


@dataclass(frozen=True)
class Start:
    """Cameras that a cold start posed.

    cameras  (C,) None where a camera could not be posed
    kept     share of the wand's blobs, by single images, that lie within the gate
    noise    px, of one coordinate
    late     (C,) int: by how many frames a camera's images had to be shifted, found for those that did not fit
    """

    cameras: tuple[Camera | None, ...]
    kept: float
    noise: float
    late: Ints

    @property
    def merit(self) -> tuple[int, float]:
        """More cameras first, then more kept and less noise."""
        return sum(camera is not None for camera in self.cameras), self.kept - 0.05 * self.noise


def guessed(name: str, size: tuple[int, int], focal: float) -> Camera:
    """A camera without distortion that looks along its image's middle."""
    return Camera(name, size, (focal, focal), (0.5 * (size[0] - 1), 0.5 * (size[1] - 1)))


def cold_start(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    sizes: Sequence[tuple[int, int]],
    known: Sequence[Camera | None],
    progress: Callable[[float, str], None] | None = None,
) -> Start | None:
    """Pose all cameras that can be posed. Several first pairs are tried until one explains what was seen; None where none does.

    blobs, chosen  what `identify` was given and gave; sizes (C,) px; known (C,): cameras whose lens is known
    """
    frames = spread_frames(shown(chosen), _WORKING_FRAMES)
    blobs, chosen = some_frames(blobs, chosen, frames)
    shared = shared_frames(chosen)
    first = [(int(shared[a, b]), a, b) for a in range(len(sizes)) for b in range(a + 1, len(sizes)) if shared[a, b] >= FEWEST]
    tried = [_pair(blobs, chosen, wand, sizes, known, a, b) for _, a, b in sorted(first, key=lambda s: (-s[0], s[1:]))[:6]]
    pairs = sorted((pair for pair in tried if pair is not None), key=lambda pair: pair.doubt)
    best: Start | None = None
    for n, pair in enumerate(pairs[:4]):
        start = _grow(blobs, chosen, wand, sizes, known, pair, progress if n == 0 else None)
        if best is None or start.merit > best.merit:
            best = start
        if start.kept > 0.9 and start.noise < 1.0 and all(start.cameras[c] is not None for c in np.nonzero(shared.sum(axis=0) > 0)[0]):
            break
    return best


@dataclass(frozen=True)
class _Pair:
    cameras: dict[int, Camera]
    error: float
    doubt: float


def shown(chosen: Ints) -> Bools:
    """(T, C) which images show the whole wand."""
    return np.asarray((chosen >= 0).all(axis=2))


def shared_frames(chosen: Ints) -> Ints:
    """(C, C) how many frames show the wand to both of two cameras."""
    seen = shown(chosen).astype(np.int64)
    return np.asarray(seen.T @ seen)


def spread_frames(seen: Bools, most: int) -> Ints:
    """Some frames (m,), ascending: of each camera that sees something in (T, C) about equally many, evenly spread, no more than `most`."""
    useful = np.nonzero(seen.sum(axis=1) >= 2)[0]
    if len(useful) <= most:
        return useful
    picked = np.zeros(len(seen), dtype=bool)
    share = most // seen.shape[1]
    for own in seen[useful].T:
        at = useful[own]
        picked[at[np.unique(np.linspace(0, len(at) - 1, min(share, len(at))).astype(np.int64))] if len(at) else at] = True
    rest = useful[~picked[useful]]
    room = most - int(picked.sum())
    if room > 0 and len(rest):
        picked[rest[np.unique(np.linspace(0, len(rest) - 1, min(room, len(rest))).astype(np.int64))]] = True
    return np.nonzero(picked)[0]


def some_frames(blobs: Blobs, chosen: Ints, frames: Ints) -> tuple[Blobs, Ints]:
    """The blobs of some frames (m,) only, and what `identify` chose there."""
    cells = (frames[:, None] * len(blobs.cameras) + np.arange(len(blobs.cameras))).ravel()
    counts = np.diff(blobs.offsets)[cells]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    shift = blobs.offsets[cells] - offsets[:-1]
    at = np.repeat(shift, counts) + np.arange(offsets[-1])
    picked = chosen[frames] - shift.reshape(len(frames), -1)[:, :, None]
    few = replace(blobs, xy=blobs.xy[at], sizes=blobs.sizes[at], offsets=offsets, times=None)
    return few, np.where(chosen[frames] >= 0, picked, -1)


def priors(cameras: Sequence[Camera], known: Sequence[Camera | None], noise: float) -> tuple[Floats, Floats]:
    """What is expected of lenses before anything was seen, as `adjust` takes it: values and standard deviations (C, 15).

    Of an unknown lens: square pixels, a principal point in the middle of the image, little distortion. Of a known one: that it is so.
    """
    expected, spread = np.zeros((len(cameras), 15)), np.full((len(cameras), 15), np.inf)
    for c, (camera, lens) in enumerate(zip(cameras, known, strict=True)):
        width, height = camera.size or (1280, 1024)
        if lens is None:
            centre = (0.5 * (width - 1), 0.5 * (height - 1))
            expected[c, 6:] = camera.focal[0], 1.0, *centre, 0.0, 0.0, 0.0, 0.0, 0.0
            spread[c, 6:] = 10.0 * camera.focal[0], 0.003, 0.03 * width, 0.03 * width, 0.5, 0.5, 0.5, 0.005, 0.005
        else:
            radial = (*lens.radial, 0.0, 0.0, 0.0)[:3]
            expected[c, 6:] = lens.focal[0], lens.focal[1] / lens.focal[0], *lens.centre, *radial, *lens.tangential
            spread[c, 6:] = 0.02 * lens.focal[0], 0.003, 0.01 * width, 0.01 * width, 0.03, 0.05, 0.05, 0.002, 0.002
    return expected, spread / noise


def _pair(
    blobs: Blobs, chosen: Ints, wand: Wand, sizes: Sequence[tuple[int, int]], known: Sequence[Camera | None], a: int, b: int
) -> _Pair | None:
    """The best of several ways to pose two cameras: by the depths that the wand itself shows, by epipolar geometry; from several focals."""
    both = np.nonzero(shown(chosen)[:, [a, b]].all(axis=1))[0]
    both = both[np.unique(np.linspace(0, len(both) - 1, min(_PAIR_FRAMES, len(both))).astype(np.int64))]
    xy = blobs.xy[chosen[both][:, [a, b]]]
    epipolar = _fundamental(xy, wand, 0.003 * max(sizes[a]))
    tried: list[tuple[float, int, Adjustment, Bools]] = []
    for guess in GUESSES:
        pair = [known[c] or guessed(blobs.cameras[c], sizes[c], guess * sizes[c][0]) for c in (a, b)]
        poses = []
        if len(wand.lengths) == 3 and not wand.either:
            poses.append(_pose_by_depths(xy, pair, wand))
        if epipolar is not None:
            poses.append(_pose_by_epipolar_geometry(xy, pair, wand, epipolar))
        for pose in poses:
            if pose is None:
                continue
            posed = [pair[0], replace(pair[1], rotation=pose[0], translation=pose[1])]
            fitted = _fit_pair(xy, posed, [known[a], known[b]], wand, pose[2], 8)
            if fitted is not None:
                tried.append((_typical(fitted), len(tried), fitted, pose[2]))
        if known[a] is not None and known[b] is not None:
            break
    best: _Pair | None = None
    for _, _, fitted, turned in sorted(tried, key=lambda one: one[:2])[:3]:
        full = _fit_pair(xy, list(fitted.cameras), [known[a], known[b]], wand, turned, 25)
        if full is None or (best is not None and _typical(full) >= best.error):
            continue
        doubt = float((full.sigma[:, 6] / [camera.focal[0] for camera in full.cameras]).max())
        best = _Pair({a: full.cameras[0], b: full.cameras[1]}, _typical(full), doubt)
    return best


def _typical(fitted: Adjustment) -> float:
    """px, the median distance of an adjustment's residuals."""
    return float(np.nanmedian(np.linalg.norm(fitted.residuals, axis=1)))


def _fit_pair(
    xy: Floats, cameras: list[Camera], known: Sequence[Camera | None], wand: Wand, turned: Bools, steps: int
) -> Adjustment | None:
    """Adjust two cameras to the wand's images (n, 2, K, 2) px; `turned` (n,): where the second camera's order is the reverse one."""
    xy = xy.copy()
    xy[turned, 1] = xy[turned, 1, ::-1]
    sightings = Sightings.from_array(xy)
    points = triangulate(cameras, sightings, len(xy), len(wand.lengths))
    rotations, translations = _placed(wand, points)
    good: Bools = np.asarray(np.isfinite(translations).all(axis=1))
    if good.sum() < FEWEST // 2:
        return None
    sightings, kept = sightings.select(good[sightings.frame]).compact()
    free = free_parameters(2, "pose", "focal", "k1")
    prior = priors(cameras, known, 0.5)
    prior[1][:, 6] = np.minimum(prior[1][:, 6], 0.7 * np.array([camera.focal[0] for camera in cameras]) / 0.5)
    return adjust(
        cameras, wand.template, sightings, rotations[kept], translations[kept],
        free=free, prior=prior, loss="cauchy", scale=3.0, tolerance=1e-4, steps=steps,
    )  # fmt: skip


def _placed(wand: Wand, points: Floats) -> tuple[Floats, Floats]:
    """The wand in each frame by its markers' positions (T, K, 3) m; a single dot is where it is."""
    if len(wand.lengths) == 1:
        return np.tile(np.eye(3), (len(points), 1, 1)), points[:, 0]
    return place_objects(wand.template, points)


def _pose_by_depths(xy: Floats, pair: Sequence[Camera], wand: Wand) -> tuple[Floats, Floats, Bools] | None:
    """The second camera's pose (rotation, translation m) in the first one's axes, from the wand as each camera alone sees it.

    Where the inner marker is seen between the others tells how much farther one end is than the other, and the length how far both are:
    the wand's ends in each camera's own axes, noisy in depth. One set is laid on the other (Kabsch 1976), reweighted.
    """
    share, whole = float(wand.lengths[1] / wand.lengths[2]), float(wand.lengths[2])
    ends = []
    for c, camera in enumerate(pair):
        flat = camera.undistort(xy[:, c])
        ray = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=2)
        near, far = np.cross(ray[:, 0], ray[:, 1]), np.cross(ray[:, 2], ray[:, 1])
        ratio = -(1.0 - share) * (near * far).sum(axis=1) / np.maximum(share * (far * far).sum(axis=1), 1e-15)
        ratio = np.clip(ratio, 0.4, 2.5)
        depth = whole / np.linalg.norm(ratio[:, None] * ray[:, 2] - ray[:, 0], axis=1)
        ends.append(np.stack([depth[:, None] * ray[:, 0], (depth * ratio)[:, None] * ray[:, 2]], axis=1))
    one, other = ends
    good = np.isfinite(one).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
    if good.sum() < FEWEST // 2:
        return None
    one, other = one[good].reshape(-1, 3), other[good].reshape(-1, 3)
    weight = np.ones(len(one))
    for _ in range(15):
        total = weight.sum()
        middle_one, middle_other = weight @ one / total, weight @ other / total
        u, _, vt = np.linalg.svd((weight[:, None] * (other - middle_other)).T @ (one - middle_one))
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        translation = middle_other - rotation @ middle_one
        miss = np.linalg.norm(other - one @ rotation.T - translation, axis=1)
        weight = 1.0 / (1.0 + np.square(miss / max(float(np.median(miss)), 1e-9)))
    return rotation, translation, np.zeros(len(xy), dtype=bool)


def _fundamental(xy: Floats, wand: Wand, gate: float) -> tuple[Floats, Bools] | None:
    """The fundamental matrix of two cameras by RANSAC, and in which frames (n,) the second one's markers come in reverse order.

    Where images leave the order open, first by the middle of the wand, whose images belong together (exactly with three markers, nearly
    with two); then each frame takes the order that fits.
    """
    turned = np.zeros(len(xy), dtype=bool)
    if not wand.either or len(wand.lengths) == 1:
        points = xy.transpose(1, 0, 2, 3).reshape(2, -1, 2)
        matrix = _ransac(points[0], points[1], gate)
        return None if matrix is None else (matrix, turned)
    middle = xy[:, :, 1] if len(wand.lengths) == 3 else xy.mean(axis=2)
    matrix = _ransac(middle[:, 0], middle[:, 1], 3.0 * gate)
    for _ in range(2):
        if matrix is None:
            return None
        straight = _off_the_lines(matrix, xy[:, 0], xy[:, 1]).sum(axis=1)
        turned = _off_the_lines(matrix, xy[:, 0], xy[:, 1, ::-1]).sum(axis=1) < straight
        second = np.where(turned[:, None, None], xy[:, 1, ::-1], xy[:, 1])
        matrix = _ransac(xy[:, 0].reshape(-1, 2), second.reshape(-1, 2), gate)
    return None if matrix is None else (matrix, turned)


def _ransac(one: Floats, other: Floats, gate: float) -> Floats | None:
    if len(one) < 15:
        return None
    matrix, _ = cv2.findFundamentalMat(np.ascontiguousarray(one), np.ascontiguousarray(other), cv2.FM_RANSAC, gate, 0.999, 2000)
    return None if matrix is None or matrix.shape != (3, 3) else np.asarray(matrix, dtype=np.float64)


def _off_the_lines(matrix: Floats, one: Floats, other: Floats) -> Floats:
    """px, how far points (n, K, 2) of the second image are from the epipolar lines of those of the first."""
    lines = np.concatenate([one, np.ones((*one.shape[:-1], 1))], axis=-1) @ matrix.T
    distance = np.abs((lines[..., :2] * other).sum(axis=-1) + lines[..., 2]) / np.maximum(np.linalg.norm(lines[..., :2], axis=-1), 1e-12)
    return np.asarray(distance, dtype=np.float64)


def _pose_by_epipolar_geometry(
    xy: Floats, pair: Sequence[Camera], wand: Wand, epipolar: tuple[Floats, Bools]
) -> tuple[Floats, Floats, Bools] | None:
    """The second camera's pose in the first one's axes from their fundamental matrix and lenses; scale from the wand."""
    matrix, turned = epipolar
    ordered = np.stack([xy[:, 0], np.where(turned[:, None, None], xy[:, 1, ::-1], xy[:, 1])], axis=1)
    flat = [camera.undistort(ordered[:, c].reshape(-1, 2)) for c, camera in enumerate(pair)]
    good = np.isfinite(flat[0]).all(axis=1) & np.isfinite(flat[1]).all(axis=1)
    if good.sum() < 15:
        return None
    essential = pair[1].matrix.T @ matrix @ pair[0].matrix
    _, rotation, translation, _ = cv2.recoverPose(essential, flat[0][good], flat[1][good], np.eye(3))
    translation = translation.ravel()
    if len(wand.lengths) > 1:
        cameras = [pair[0], replace(pair[1], rotation=rotation, translation=translation)]
        points = triangulate(cameras, Sightings.from_array(ordered), len(xy), len(wand.lengths))
        seen = np.linalg.norm(points[:, -1] - points[:, 0], axis=1)
        length = float(np.nanmedian(seen)) if np.isfinite(seen).any() else 0.0
        if not length > 1e-9:
            return None
        translation = translation * (wand.lengths[-1] / length)
    return rotation, translation, turned


def _grow(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    sizes: Sequence[tuple[int, int]],
    known: Sequence[Camera | None],
    pair: _Pair,
    progress: Callable[[float, str], None] | None,
) -> Start:
    """One camera after the other by what is posed already; each time all are adjusted together."""
    cameras: list[Camera | None] = [pair.cameras.get(c) for c in range(len(sizes))]
    width = max(size[0] for size in sizes)
    late = np.zeros(len(sizes), dtype=np.int64)
    noise, gate = pair.error, _COARSE * width
    while True:
        posed = [c for c, camera in enumerate(cameras) if camera is not None]
        for _ in range(2):
            agreed = agree(blobs, chosen, wand, cameras, gate)
            result = adjust_some(blobs, agreed, wand, cameras, known, ("pose", "focal", "k1", "k2"), 2.0, _CAMERA_FRAMES)
            if result is None:
                break
            for c, camera in zip(posed, result.cameras, strict=True):
                cameras[c] = camera
            noise = float(np.nanmedian(np.abs(result.residuals))) / 0.6745
            gate = max(_FINE * width, min(gate, 8.0 * noise))
        agreed = agree(blobs, chosen, wand, cameras, gate)
        if progress is not None:
            progress(0.1 + 0.5 * len(posed) / len(sizes), f"{len(posed)} of {len(sizes)} cameras posed")
        added = False
        for c in range(len(sizes)):
            if cameras[c] is None:
                cameras[c] = _resected(blobs, chosen, agreed, wand, c, sizes[c], known[c])
                added = added or cameras[c] is not None
        if not added:
            break
    posed_now = np.array([camera is not None for camera in cameras])
    told = (chosen >= 0) & posed_now[None, :, None]
    told &= (shown(chosen)[:, posed_now].sum(axis=1) >= 2)[:, None, None]
    kept = float((agreed.sights >= 0)[told].sum() / max(told.sum(), 1))
    return Start(tuple(cameras), kept, noise, late)


def adjust_some(
    blobs: Blobs,
    agreed: Agreed,
    wand: Wand,
    cameras: Sequence[Camera | None],
    known: Sequence[Camera | None],
    groups: tuple[str, ...],
    scale: float,
    frames_per_camera: int,
) -> Adjustment | None:
    """Adjust the posed cameras on some frames of each, by Cauchy's loss of this scale (px); None where too little agrees."""
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    frames = spread_frames(agreed.seen[:, posed], frames_per_camera * len(posed))
    sightings, kept = agreed.sightings(blobs, frames).compact()
    if len(kept) < FEWEST // 2:
        return None
    place = np.full(len(cameras), -1)
    place[posed] = np.arange(len(posed))
    rotations, translations = (part[kept] for part in agreed.placements())
    own = [camera for camera in cameras if camera is not None]
    return adjust(
        own, wand.template, replace(sightings, camera=place[sightings.camera]), rotations, translations,
        free=free_parameters(len(posed), *groups), prior=priors(own, [known[c] for c in posed], 0.5), loss="cauchy",
        scale=scale, tolerance=1e-4, steps=20, covariance=False,
    )  # fmt: skip


def _resected(
    blobs: Blobs, chosen: Ints, agreed: Agreed, wand: Wand, camera: int, size: tuple[int, int], known: Camera | None
) -> Camera | None:
    """A camera from where the posed ones say that the wand lay; None where that does not fit."""
    frames = np.nonzero((chosen[:, camera] >= 0).all(axis=1) & np.isfinite(agreed.starts[:, 0]))[0]
    if len(frames) < FEWEST:
        return None
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, min(150, len(frames))).astype(np.int64))]
    world = agreed.starts[frames, None] + wand.lengths[None, :, None] * agreed.directions[frames, None]
    xy = blobs.xy[chosen[frames, camera]]
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
