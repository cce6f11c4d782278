"""Two cameras and their images of a wand in; both posed, with nothing known, out: what a cold start begins from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.calibration.wand.frames import evenly
from asterism.calibration.wand.identify import Wand
from asterism.calibration.wand.recording import WandRecording
from asterism.cameras.bundle import Adjustment, AdjustSettings, Sightings, adjust, free_parameters, triangulate
from asterism.cameras.camera import Camera
from asterism.geometry import fit_rigid, place_objects
from asterism.recording import Floats

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class TwoViewRules:
    """How two cameras are posed with nothing known.

    focal_guesses   focal lengths to begin with, in widths of the image; each is 1.45 times the one before
    least_frames    that two cameras must share, or a camera with those that are posed already
    pair_frames     evenly spread, that a pair is posed from
    epipolar_gate   share of the image's longer side: how far a point may lie from its epipolar line; `middle_gate` times as far where
                    the middle of the wand stands for it
    fewest_points   of each camera that epipolar geometry needs
    depth_ratio     one end of the wand is at most this many times as far from a camera as the other
    depth_rounds    of reweighting, in which the wand's ends by one camera's depths are laid on those by the other's
    coarse_steps    of the adjustment of every start
    refined         so many of the best starts are adjusted on, in `fine_steps` steps
    fine_steps      see `refined`
    noise           px, of one coordinate, that priors are weighed against
    loss_noises     the robust loss grows slower from so many times that on
    focal_spread    standard deviation of a focal length around its guess, as a share of it

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    focal_guesses: tuple[float, ...] = (0.55, 0.8, 1.15, 1.65, 2.4, 3.6)
    least_frames: int = 25
    pair_frames: int = 100
    epipolar_gate: float = 0.003
    middle_gate: float = 3.0
    fewest_points: int = 15
    depth_ratio: float = 2.5
    depth_rounds: int = 15
    coarse_steps: int = 8
    refined: int = 3
    fine_steps: int = 25
    noise: float = 0.5
    loss_noises: float = 3.0
    focal_spread: float = 0.7


RULES = TwoViewRules()


@dataclass(frozen=True)
class LensSpread:
    """Standard deviations of a lens before anything was seen.

    focal       share of the focal length
    aspect      of the ratio of its two focal lengths
    centre      of the principal point, in widths of the image
    radial      of three coefficients
    tangential  of both coefficients
    """

    focal: float
    aspect: float
    centre: float
    radial: tuple[float, float, float]
    tangential: float


UNKNOWN_LENS = LensSpread(focal=10.0, aspect=0.003, centre=0.03, radial=(0.5, 0.5, 0.5), tangential=0.005)
"""A lens of which nothing is known: the pixels are square, all else is left to the images. Checked like `TwoViewRules`."""
KNOWN_LENS = LensSpread(focal=0.02, aspect=0.003, centre=0.01, radial=(0.03, 0.05, 0.05), tangential=0.002)
"""A lens that was calibrated before, and may have been touched since. Checked like `TwoViewRules`."""


@dataclass(frozen=True)
class Pair:
    """Two posed cameras.

    cameras            by their number in the recording
    error              px, the median distance of the residuals
    focal_uncertainty  standard deviation of the less certain focal length, as a share of it
    """

    cameras: dict[int, Camera]
    error: float
    focal_uncertainty: float


def initial_camera(name: str, size: tuple[int, int], focal: float) -> Camera:
    """A camera without distortion that looks along its image's middle."""
    return Camera(name, size, (focal, focal), (0.5 * (size[0] - 1), 0.5 * (size[1] - 1)))


def priors(cameras: Sequence[Camera], known: Sequence[Camera | None], noise: float) -> tuple[Floats, Floats]:
    """What is expected of lenses before anything was seen, as `adjust` takes it: values and standard deviations (C, 15).

    Of an unknown lens: square pixels, a principal point in the middle of the image, little distortion. Of a known one: that it is so.
    """
    expected, spread = np.zeros((len(cameras), 15)), np.full((len(cameras), 15), np.inf)
    for c, (camera, lens) in enumerate(zip(cameras, known, strict=True)):
        width, height = camera.size or (1280, 1024)
        if lens is None:
            centre = (0.5 * (width - 1), 0.5 * (height - 1))
            # The focal length at hand is only where the search is; a spread of ten times its length lets it go anywhere.
            expected[c, 6:] = camera.focal[0], 1.0, *centre, 0.0, 0.0, 0.0, 0.0, 0.0
        else:
            radial = (*lens.radial, 0.0, 0.0, 0.0)[:3]
            expected[c, 6:] = lens.focal[0], lens.focal[1] / lens.focal[0], *lens.centre, *radial, *lens.tangential
        its = UNKNOWN_LENS if lens is None else KNOWN_LENS
        focal, centre_px = its.focal * expected[c, 6], its.centre * width
        spread[c, 6:] = focal, its.aspect, centre_px, centre_px, *its.radial, its.tangential, its.tangential
    return expected, spread / noise


def initial_pair(recording: WandRecording, a: int, b: int) -> Pair | None:
    """The best of several ways to pose two cameras: by the depths that the wand itself shows, by epipolar geometry; from several focals."""
    both = np.nonzero(recording.shows_wand[:, [a, b]].all(axis=1))[0]
    xy = recording.blobs.xy[recording.detections[evenly(both, RULES.pair_frames)][:, [a, b]]]
    lenses = [recording.lenses[a], recording.lenses[b]]
    epipolar = _fundamental(xy, recording.wand, RULES.epipolar_gate * max(recording.sizes[a]))
    tried: list[tuple[float, int, Adjustment, Bools]] = []
    # A wrong focal length bends the whole pair, and the adjustment does not find out of it: begin from several, and compare.
    for guess in RULES.focal_guesses:
        pair = [
            recording.lenses[c] or initial_camera(recording.blobs.cameras[c], recording.sizes[c], guess * recording.sizes[c][0])
            for c in (a, b)
        ]
        for rotation, translation, turned in _poses(xy, pair, recording.wand, epipolar):
            posed = [pair[0], replace(pair[1], rotation=rotation, translation=translation)]
            fitted = _fit_pair(xy, posed, lenses, recording.wand, turned, RULES.coarse_steps)
            if fitted is not None:
                tried.append((_median_error(fitted), len(tried), fitted, turned))
        if lenses[0] is not None and lenses[1] is not None:
            # Two known lenses leave nothing to guess.
            break
    best: Pair | None = None
    # A few coarse steps rank the starts; only the best are worth the rest.
    for _, _, fitted, turned in sorted(tried, key=lambda one: one[:2])[: RULES.refined]:
        full = _fit_pair(xy, list(fitted.cameras), lenses, recording.wand, turned, RULES.fine_steps)
        if full is None or (best is not None and _median_error(full) >= best.error):
            continue
        # Pairs whose lenses are well determined by themselves make the better beginning of a rig.
        uncertainty = float((full.sigma[:, 6] / [camera.focal[0] for camera in full.cameras]).max())
        best = Pair({a: full.cameras[0], b: full.cameras[1]}, _median_error(full), uncertainty)
    return best


def _poses(xy: Floats, pair: Sequence[Camera], wand: Wand, epipolar: tuple[Floats, Bools] | None) -> list[tuple[Floats, Floats, Bools]]:
    """Poses of the second camera to begin with: rotation, translation (m), and in which frames (n,) its markers come in reverse order."""
    poses = []
    # An inner marker off the middle shows by perspective which end is nearer, in each image alone.
    if len(wand) == 3 and not wand.symmetric:
        poses.append(_pose_by_depths(xy, pair, wand))
    if epipolar is not None:
        poses.append(_pose_by_epipolar_geometry(xy, pair, wand, epipolar))
    return [pose for pose in poses if pose is not None]


def _median_error(fitted: Adjustment) -> float:
    """px, the median distance of an adjustment's residuals."""
    return float(np.nanmedian(np.linalg.norm(fitted.residuals, axis=1)))


def _fit_pair(
    xy: Floats, cameras: list[Camera], known: Sequence[Camera | None], wand: Wand, turned: Bools, steps: int
) -> Adjustment | None:
    """Adjust two cameras to the wand's images (n, 2, K, 2) px; `turned` (n,): where the second camera's order is the reverse one."""
    xy = xy.copy()
    xy[turned, 1] = xy[turned, 1, ::-1]
    sightings = Sightings.from_array(xy)
    # Markers by themselves give the first placement of the wand; from then on it is rigid.
    points = triangulate(cameras, sightings, len(xy), len(wand))
    rotations, translations = _placed(wand, points)
    good: Bools = np.asarray(np.isfinite(translations).all(axis=1))
    if good.sum() < RULES.least_frames // 2:
        return None
    sightings, kept = sightings.select(good[sightings.frame]).compact()
    free = free_parameters(2, "pose", "focal", "k1")
    prior = priors(cameras, known, RULES.noise)
    # A pair alone hardly determines its focal lengths: kept near the guess, they cannot run away to a telescope's.
    prior[1][:, 6] = np.minimum(prior[1][:, 6], RULES.focal_spread * np.array([camera.focal[0] for camera in cameras]) / RULES.noise)
    settings = AdjustSettings(loss="cauchy", scale=RULES.loss_noises, tolerance=1e-4, steps=steps, covariance=steps == RULES.fine_steps)
    return adjust(cameras, wand.template, sightings, rotations[kept], translations[kept], free=free, prior=prior, settings=settings)


def _placed(wand: Wand, points: Floats) -> tuple[Floats, Floats]:
    """The wand in each frame by its markers' positions (T, K, 3) m; a single dot is where it is."""
    if len(wand) == 1:
        return np.tile(np.eye(3), (len(points), 1, 1)), points[:, 0]
    return place_objects(wand.template, points)


def _pose_by_depths(xy: Floats, pair: Sequence[Camera], wand: Wand) -> tuple[Floats, Floats, Bools] | None:
    """The second camera's pose (rotation, translation m) in the first one's axes, from the wand as each camera alone sees it.

    Where the inner marker is seen between the others tells how much farther one end is than the other, and the length how far both are:
    the wand's ends in each camera's own axes, noisy in depth. One set is laid on the other, reweighted.
    """
    share, whole = float(wand.lengths[1] / wand.lengths[2]), float(wand.lengths[2])
    ends = []
    for c, camera in enumerate(pair):
        flat = camera.undistort(xy[:, c])
        ray = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=2)
        # The three rays lie in one plane, so the inner one divides the angle; with the known lengths that gives the ratio of depths.
        near, far = np.cross(ray[:, 0], ray[:, 1]), np.cross(ray[:, 2], ray[:, 1])
        ratio = -(1.0 - share) * (near * far).sum(axis=1) / np.maximum(share * (far * far).sum(axis=1), 1e-15)
        ratio = np.clip(ratio, 1.0 / RULES.depth_ratio, RULES.depth_ratio)
        depth = whole / np.linalg.norm(ratio[:, None] * ray[:, 2] - ray[:, 0], axis=1)
        ends.append(np.stack([depth[:, None] * ray[:, 0], (depth * ratio)[:, None] * ray[:, 2]], axis=1))
    one, other = ends
    good = np.isfinite(one).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
    if good.sum() < RULES.least_frames // 2:
        return None
    one, other = one[good].reshape(-1, 3), other[good].reshape(-1, 3)
    weight = np.ones(len(one))
    for _ in range(RULES.depth_rounds):
        rotation, translation = fit_rigid(one, other, weight)
        miss = np.linalg.norm(other - one @ rotation.T - translation, axis=1)
        # Depths from one image are wrong by a lot now and then; weights by the miss let the bulk decide.
        weight = 1.0 / (1.0 + np.square(miss / max(float(np.median(miss)), 1e-9)))
    return rotation, translation, np.zeros(len(xy), dtype=bool)


def _fundamental(xy: Floats, wand: Wand, gate: float) -> tuple[Floats, Bools] | None:
    """The fundamental matrix of two cameras by RANSAC, and in which frames (n,) the second one's markers come in reverse order.

    Where images leave the order open, first by the middle of the wand, whose images belong together (exactly with three markers, nearly
    with two); then each frame takes the order that fits.
    """
    turned = np.zeros(len(xy), dtype=bool)
    if not wand.symmetric or len(wand) == 1:
        points = xy.transpose(1, 0, 2, 3).reshape(2, -1, 2)
        matrix = _ransac(points[0], points[1], gate)
        return None if matrix is None else (matrix, turned)
    # The middle is the same whichever end comes first. With two markers the mean is a little off by perspective: a wider gate.
    middle = xy[:, :, 1] if len(wand) == 3 else xy.mean(axis=2)
    matrix = _ransac(middle[:, 0], middle[:, 1], RULES.middle_gate * gate)
    # The first round sorts most frames by a rough matrix, the second all of them by a good one.
    for _ in range(2):
        if matrix is None:
            return None
        straight = _off_the_lines(matrix, xy[:, 0], xy[:, 1]).sum(axis=1)
        turned = _off_the_lines(matrix, xy[:, 0], xy[:, 1, ::-1]).sum(axis=1) < straight
        second = np.where(turned[:, None, None], xy[:, 1, ::-1], xy[:, 1])
        matrix = _ransac(xy[:, 0].reshape(-1, 2), second.reshape(-1, 2), gate)
    return None if matrix is None else (matrix, turned)


def _ransac(one: Floats, other: Floats, gate: float) -> Floats | None:
    if len(one) < RULES.fewest_points:
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
    if good.sum() < RULES.fewest_points:
        return None
    essential = pair[1].matrix.T @ matrix @ pair[0].matrix
    _, rotation, translation, _ = cv2.recoverPose(essential, flat[0][good], flat[1][good], np.eye(3))
    translation = translation.ravel()
    # Epipolar geometry knows directions only; the wand's length gives the metres.
    if len(wand) > 1:
        cameras = [pair[0], replace(pair[1], rotation=rotation, translation=translation)]
        points = triangulate(cameras, Sightings.from_array(ordered), len(xy), len(wand))
        seen = np.linalg.norm(points[:, -1] - points[:, 0], axis=1)
        length = float(np.nanmedian(seen)) if np.isfinite(seen).any() else 0.0
        if not length > 1e-9:
            return None
        translation = translation * (wand.lengths[-1] / length)
    return rotation, translation, turned
