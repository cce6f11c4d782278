"""Points and a rig in; how well each camera fits what the other cameras say about the points, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera, Rig
from asterism.cameras.accuracy.jacobian_kernels import pixel_jacobians
from asterism.findings import Finding, Severity
from asterism.reconstruction.problem import image_bounds
from asterism.reconstruction.result import Reconstruction
from asterism.recording import Blobs, Floats, Ints
from asterism.synchronization.lags import out_of_step


@dataclass(frozen=True)
class CameraFitRules:
    """How a camera is judged.

    What it must give (tests/test_camera_fit.py): no finding in rings of 3, 4 and 8 cameras with 0.1 to 1 px of noise; in rings of 4 and 8,
    the camera that was turned by 0.1 degrees or more, or zoomed by 0.6 %, and no other.

    misfit_px, misfit_noises  a camera does not fit whose systematic residual is more than both: in px, and in standard deviations of the
                              noise
    max_points    points that are looked at for each camera
    min_points    points that a judgement needs
    min_places, place_size    different places of its image, and their size in focal lengths, in which a camera must show points
    border_px     a point nearer to the image border need not be seen
    rounds        of the robust fit
    outlier       residuals of so many times the median have half the weight
    noise_sigmas  standard deviations of the systematic residual that noise may cause
    max_lag       frames
    lag_frames, lag_points    how many frames, and points of each, are tried at every lag
    match_share, match_gain   the share of the points that a camera must show at another lag or as another camera, and by how much more
    """

    misfit_px: float = 0.3
    misfit_noises: float = 0.5
    max_points: int = 4000
    min_points: int = 50
    min_places: int = 12
    place_size: float = 0.02
    border_px: float = 3.0
    rounds: int = 4
    outlier: float = 3.0
    noise_sigmas: float = 2.0
    max_lag: int = 20
    lag_frames: int = 40
    lag_points: int = 60
    match_share: float = 0.25
    match_gain: float = 0.15


RULES = CameraFitRules()


@dataclass(frozen=True)
class CameraFit:
    """One camera against the others.

    expected    points of three other cameras (of two, in a rig of three) that lie inside its image, of those looked at
    seen        the share of them that it shows, NaN where there are fewer than 50
    systematic  px, how far its whole image is shifted, turned, scaled or bent against where the others put the points: the part of its
                residuals that noise does not explain (RMS); NaN where fewer than 50 of its blobs, or than 12 places in its image, say so
    """

    expected: int
    seen: float
    systematic: float


def misfit_limit(noise: float) -> float:
    """px, the largest systematic residual of a camera that fits, at this pixel noise."""
    return max(RULES.misfit_px, RULES.misfit_noises * noise)


def fit_of_cameras(result: Reconstruction, rig: Rig) -> tuple[CameraFit, ...]:
    """How each camera of a reconstruction fits the others, in the order of the blobs' cameras.

    Looks at 4,000 points for each camera, evenly spread, and makes no new ones. O(cameras * points).
    """
    rig = rig.select(result.blobs.cameras)
    bounds = image_bounds(result.blobs, rig)
    fits = []
    for c, camera in enumerate(rig):
        # Points that the camera helped to make would excuse it, so the others alone must show them.
        points = _evenly(np.flatnonzero(_shown_by_others(result, c)), RULES.max_points)
        pixels = camera.project(result.clouds.xyz[points])
        # Near the border a marker may be half out of the image, and missing it is no fault.
        inside = ((pixels > bounds[0, c] + RULES.border_px) & (pixels < bounds[1, c] - RULES.border_px)).all(axis=1)
        seen = result.cameras[points[inside], c]
        share = float(seen.mean()) if len(seen) >= RULES.min_points else float("nan")
        fits.append(CameraFit(len(seen), share, _systematic_residual(result, camera, c)))
    return tuple(fits)


def _shown_by_others(result: Reconstruction, c: int) -> NDArray[np.bool_]:
    """(P,) the points that three other cameras show, or two in a rig of three."""
    others = result.cameras.sum(axis=1) - result.cameras[:, c]
    enough: NDArray[np.bool_] = others >= min(3, result.cameras.shape[1] - 1)
    return enough


def confusion(result: Reconstruction, rig: Rig, c: int) -> Finding | None:
    """Whether camera c, which does not fit the others, is out of step with them or is another camera of the rig; else None."""
    rig = rig.select(result.blobs.cameras)
    good, offsets = _shown_by_others(result, c), result.clouds.offsets
    clouds = [result.clouds.xyz[a:b][good[a:b]] for a, b in pairwise(offsets)]
    frames, radius = range(len(clouds)), match_radius(float(result.noise[c]))
    name = rig[c].name
    behind = frames_behind(clouds, frames, result.blobs, c, rig[c], radius)
    if behind:
        sentence, mend = out_of_step(name, behind)
        return Finding("reconstruct-out-of-step", Severity.WARNING, name, sentence, mend)
    share = [shown_share(clouds, frames, result.blobs, c, camera, radius, [0])[0] for camera in rig]
    other = int(np.argmax(share))
    if share[other] > max(RULES.match_share, share[c] + RULES.match_gain):
        return Finding(
            "reconstruct-exchanged-names",
            Severity.WARNING,
            name,
            f"camera {name} shows what camera {rig[other].name} of the rig should show.",
            "Were their names exchanged?",
        )
    return None


def match_radius(noise: float) -> float:
    """px, how near to where a point should show its blob is, at this pixel noise."""
    return max(4.0 * noise, 1.0)


def frames_behind(clouds: Sequence[Floats], frames: Sequence[int], blobs: Blobs, number: int, camera: Camera, radius: float) -> int:
    """By how many frames a camera is behind the others, up to 20; 0 where it is in step or nothing tells.

    At the right lag a camera shows more of the points that others compose than at any other lag, and markedly more than at lag 0.
    Arguments are those of `shown_share`.
    """
    lags = list(range(-RULES.max_lag, RULES.max_lag + 1))
    share = shown_share(clouds, frames, blobs, number, camera, radius, lags)
    best = int(np.argmax(share))
    return lags[best] if share[best] > max(RULES.match_share, share[RULES.max_lag] + RULES.match_gain) else 0


def shown_share(
    clouds: Sequence[Floats], frames: Sequence[int], blobs: Blobs, number: int, camera: Camera, radius: float, lags: Sequence[int]
) -> Floats:
    """(lags,) the share of points that have a blob nearby, so many frames later; 0 where few frames are there to look at.

    clouds  for each of `frames` the points (P, 3) m that the other cameras compose; at most 40 frames and 60 points of each are looked at
    blobs   the whole recording, of which the camera is the `number`-th; camera: the model with which it is tried
    radius  px, how near a blob must be to where a point should show
    """
    filled = [n for n in range(len(clouds)) if len(clouds[n])]
    hits, tried = np.zeros(len(lags)), np.zeros(len(lags))
    for n in _evenly(np.array(filled, dtype=np.int64), RULES.lag_frames):
        pixels = camera.project(clouds[n][: RULES.lag_points])
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        for k, lag in enumerate(lags):
            if 0 <= frames[n] + lag < len(blobs) and len(pixels):
                xy = blobs.of(frames[n] + lag, number)
                nearest = np.linalg.norm(pixels[:, None] - xy[None], axis=2).min(axis=1, initial=np.inf)
                hits[k] += (nearest < radius).sum()
                tried[k] += len(pixels)
    share: Floats = np.where(tried > 0.5 * tried.max(initial=1.0), hits / np.maximum(tried, 1.0), 0.0)
    return share


def _evenly(which: Ints, most: int) -> Ints:
    """At most so many of them, evenly spread."""
    return which[np.unique(np.linspace(0, len(which) - 1, min(most, len(which))).astype(np.int64))]


def _systematic_residual(result: Reconstruction, camera: Camera, c: int) -> float:
    """The smooth part of a camera's residuals (px, RMS): a shift, a linear map and a cubic radial term, over its image.

    A residual r of a point that all its cameras made is (1 - H) of what it would be without this camera, H = J S J' / noise² with the
    point's covariance S; (1 - H) / noise² is also the weight of that. So the smooth field a with A a = (1 - H)^-1 r has the normal
    equations A' (1 - H) A a = A' r. Blobs that fit far worse than most have little weight. What noise may cause is taken off.
    """
    points_of = _evenly(np.flatnonzero(result.cameras[:, c] & (result.cameras.sum(axis=1) >= 3)), RULES.max_points)
    points = np.ascontiguousarray(result.clouds.xyz[points_of])
    residual = result.blobs.xy[result.rays[points_of, c]] - camera.project(points)
    jacobian = np.empty((len(points), 2, 3))
    pixel_jacobians(camera.lens, camera.rotation, camera.translation, points, jacobian)
    known = np.isfinite(residual).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    residual, jacobian, points_of = residual[known], jacobian[known], points_of[known]
    normalised = (result.blobs.xy[result.rays[points_of, c]] - camera.centre) / camera.focal
    if len(points_of) < RULES.min_points or len(np.unique(np.rint(normalised / RULES.place_size), axis=0)) < RULES.min_places:
        return float("nan")
    noise = result.noise[c]
    without_own: Floats = np.eye(2) - jacobian @ result.covariance[points_of] @ jacobian.transpose(0, 2, 1) / noise**2
    basis = _smooth_basis(normalised)
    weights, a, normal = np.ones(len(points_of)), np.zeros(basis.shape[2]), np.eye(basis.shape[2])
    for _ in range(RULES.rounds):
        weighted = weights[:, None, None] * basis
        normal = np.einsum("nij,nik,nkl->jl", weighted, without_own, basis, optimize=True)
        a = np.linalg.lstsq(normal, np.einsum("nij,ni->j", weighted, residual), rcond=1e-9)[0]
        left = np.square(residual - np.einsum("nik,nkl,l->ni", without_own, basis, a, optimize=True)).sum(axis=1)
        weights = 1.0 / (1.0 + left / (RULES.outlier**2 * np.median(left) + 1e-12))
    spread = np.einsum("nij,jk,nik->n", basis, np.linalg.pinv(normal), basis, optimize=True).mean() * noise**2
    explained = RULES.noise_sigmas**2 * float(spread)
    return float(np.sqrt(max(float(np.square(basis @ a).sum(axis=1).mean()) - explained, 0.0)))


def _smooth_basis(normalised: Floats) -> Floats:
    """(n, 2, 7) what a shift, a linear map and a cubic radial term do at places (n, 2) of the normalised plane."""
    basis = np.zeros((len(normalised), 2, 7))
    linear = np.column_stack([np.ones(len(normalised)), normalised])
    basis[:, 0, :3], basis[:, 1, 3:6] = linear, linear
    basis[:, :, 6] = normalised * np.square(normalised).sum(axis=1)[:, None]
    return basis
