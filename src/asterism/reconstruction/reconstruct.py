"""Blobs and a calibrated rig in; 3D points with residual, covariance and cameras out (thesis 3.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from asterism.cameras import Rig
from asterism.detection.static_lights import without_static_lights
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.progress import Progress
from asterism.reconstruction._frame_kernels import PointArrays, reconstruct_frames
from asterism.reconstruction._input_kernels import RigArrays
from asterism.reconstruction._plain_kernels import reconstruct_frame_plain
from asterism.reconstruction.observation_model import RULES, estimate_observation_model
from asterism.reconstruction.problem import ObservationModel, ReconstructionProblem, common_view, image_bounds
from asterism.reconstruction.rays import BlobRays, to_rays
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.settings import ReconstructionSettings
from asterism.recording import Blobs, Clouds, Floats, Ints, as_vertical
from asterism.synchronization import to_common_clock

STATIC_SHARE = 0.75
"""The share of a camera's frames in which a light must stay at one place to be masked: people hide lamps for a while."""
_CHUNK = 64
"""Frames that are reconstructed between two calls of the progress function."""
_FEW_LEFT = 0.1
"""Where masking leaves a smaller share of the blobs than this, it has probably taken markers."""
_MANY_BLOBS = 100
"""Where the frames that are looked at have fewer blobs, these are too few to tell the noise; where they have more, they do not fit."""
_FIRST_CAPACITY = 1024
"""Versions of points in a frame for which the plain method has room at first."""


def reconstruct(
    blobs: Blobs, rig: Rig, settings: ReconstructionSettings | None = None, *, progress: Progress | None = None
) -> Reconstruction:
    """The 3D points that the blobs of each frame show.

    settings  see `ReconstructionSettings`; None: the default
    progress  called with the share done and what is being done

    The rig's cameras are found by the blobs' names for them. Cameras that are not triggered together are brought to a common clock
    first (`asterism.synchronization.to_common_clock`). The clouds' vertical is the rig's, z where it has none. Each frame is
    reconstructed by itself: the same blobs give the same points.

    Cameras without a pose are left out. Raises AsterismError where the rig lacks a camera of the blobs, fewer than two cameras are left, or
    a setting is out of range.

    >>> from asterism.cameras import Camera
    >>> left = Camera("left", (640, 480), (500.0, 500.0), (319.5, 239.5))
    >>> right = Camera("right", (640, 480), (500.0, 500.0), (319.5, 239.5), translation=[-0.5, 0.0, 0.0])
    >>> rig = Rig((left, right))
    >>> marker = [[0.2, 0.1, 2.0]]
    >>> blobs = Blobs.from_rows([0, 0], [0, 1], rig.project(marker).reshape(2, 2), rig.names, rate=100.0)
    >>> reconstruct(blobs, rig, ReconstructionSettings(noise=0.3)).clouds.xyz.round(6)
    array([[0.2, 0.1, 2. ]])
    """
    settings = ReconstructionSettings() if settings is None else settings
    findings: list[Finding] = []
    blobs, rig = _posed(blobs, rig, findings)
    settings.check(len(rig))
    # Before cameras are brought to one clock: a lamp that stays would be followed as well as any marker.
    blobs, masked = _masked(blobs, settings.mask_static, findings)
    rays = _rays(_on_common_clock(blobs, findings), rig, findings)
    bounds, corners = image_bounds(rays.blobs, rig), settings.corners
    problem = ReconstructionProblem(rig, bounds, corners, common_view(rig, bounds, corners), settings.min_cameras, settings.gate)
    run = partial(points_and_residuals, rays)
    # Gates and prices depend on the noise, which the blobs themselves tell.
    model, noise_known, looked_at = estimate_observation_model(problem, rays.blobs.counts, run, settings.noise)
    if not noise_known:
        findings.append(noise_unknown_finding(looked_at))
    parts = _run_all(problem.arrays(model), rays, settings.method, progress)
    empty = [name for name, total in zip(blobs.cameras, rays.blobs.counts.sum(axis=0), strict=True) if not total]
    if empty:
        names = ", ".join(empty)
        findings.append(
            Finding(
                "reconstruct-empty-camera",
                Severity.WARNING,
                names,
                f"camera {names} saw nothing at all.",
                "Check that it recorded, and that its blobs are in the file.",
            )
        )
    return assemble(parts, rays.blobs, problem, model, settings.method, masked, tuple(findings), noise_known)


def _posed(blobs: Blobs, rig: Rig, findings: list[Finding]) -> tuple[Blobs, Rig]:
    """The rig's cameras in the blobs' order, both without cameras that have no pose.

    Raises AsterismError where fewer than two cameras have one, or only one camera has blobs.
    """
    rig = rig.select(blobs.cameras)
    posed = [camera.name for camera in rig if camera.posed]
    if len(posed) < len(rig):
        names = ", ".join(camera.name for camera in rig if not camera.posed)
        findings.append(
            Finding(
                "reconstruct-no-pose",
                Severity.WARNING,
                names,
                f"camera {names} has no pose in the rig and was left out.",
                "`asterism calibrate wand` gives it one.",
            )
        )
        rig, blobs = (rig.select(posed), blobs.select_cameras(posed)) if posed else (rig, blobs)
    seeing = [name for name, count in zip(blobs.cameras, blobs.counts.sum(axis=0), strict=True) if count]
    #
    if len(posed) >= 2 and len(seeing) == 1:
        raise AsterismError(f"all blobs are of camera {seeing[0]}, and points need two cameras; add the others' blobs.")
    if len(posed) < 2:
        raise AsterismError(
            f"points need two calibrated cameras or more; of the blobs' cameras ({', '.join(blobs.cameras) or 'none'}) "
            f"the rig has a pose for {len(posed)}. Add the others' blobs, or calibrate them."
        )
    return blobs, rig


def _masked(blobs: Blobs, mask_static: bool, findings: list[Finding]) -> tuple[Blobs, Ints]:
    """The blobs without static lights where that is asked for; how many places of each camera (C,) were masked."""
    if not mask_static:
        return blobs, np.zeros(len(blobs.cameras), dtype=np.int64)
    before = len(blobs.xy)
    blobs, masked = without_static_lights(blobs, STATIC_SHARE)
    if len(blobs.xy) < _FEW_LEFT * before:
        findings.append(
            Finding(
                "reconstruct-mostly-static",
                Severity.WARNING,
                "",
                f"{100 - 100 * len(blobs.xy) / before:.0f} % of the blobs never move and were left out as reflections or lamps.",
                "Where these are markers, do not mask what is static.",
            )
        )
    return blobs, masked


def _on_common_clock(blobs: Blobs, findings: list[Finding]) -> Blobs:
    if blobs.times is None:
        return blobs
    before, blobs = len(blobs.xy), to_common_clock(blobs)
    if len(blobs.xy) < before:
        findings.append(
            Finding(
                "reconstruct-not-followed",
                Severity.WARNING,
                "",
                f"the cameras are not triggered together: {before - len(blobs.xy)} of {before} blobs could not be followed from frame to "
                "frame and brought to the common clock; they were left out.",
                "Trigger the cameras together, or record at a higher frame rate.",
            )
        )
    return blobs


def _rays(blobs: Blobs, rig: Rig, findings: list[Finding]) -> BlobRays:
    rays, no_ray, duplicates = to_rays(blobs, rig)
    if no_ray:
        findings.append(
            Finding(
                "reconstruct-no-ray",
                Severity.WARNING,
                "",
                f"{no_ray} blobs lie where the lens model has no ray; they were left out.",
                "Check the rig's distortion.",
            )
        )
    if duplicates:
        findings.append(
            Finding(
                "reconstruct-duplicate-blobs",
                Severity.WARNING,
                "",
                f"{duplicates} blobs stand twice in one image; one of each was used.",
                "Check how the file of blobs was written.",
            )
        )
    return rays


def noise_unknown_finding(blobs: int) -> Finding:
    """What to say where so many blobs did not tell the noise."""
    if blobs < _MANY_BLOBS:
        return Finding(
            "reconstruct-noise-unknown",
            Severity.WARNING,
            "",
            f"too few points to estimate the pixel noise from; {RULES.start_noise:.2f} px was assumed.",
            "Give the noise, or record more markers or frames.",
        )
    return Finding(
        "reconstruct-no-fit",
        Severity.ERROR,
        "",
        f"the blobs do not fit the rig at any noise up to {RULES.max_noise:g} px: do not use these points.",
        "Is it the rig of this recording, with its image size, its cameras' names, and y counted from the top?",
    )


@dataclass(frozen=True)
class FramesPart:
    """What a run of frames gave: counts (T,) points of each frame; notes (T, 2), see `reconstruct_frames`."""

    points: PointArrays
    counts: Ints
    notes: Ints


def _run_all(arrays: RigArrays, rays: BlobRays, method: str, progress: Progress | None) -> list[FramesPart]:
    run = run_global if method == "global" else partial(_run_plain, method == "plain-covariance")
    parts = []
    for begin in range(0, len(rays.blobs), _CHUNK):
        end = min(begin + _CHUNK, len(rays.blobs))
        parts.append(run(arrays, rays, begin, end))
        if progress is not None:
            progress(end / len(rays.blobs), f"frame {end} of {len(rays.blobs)}")
    return parts


def points_and_residuals(rays: BlobRays, arrays: RigArrays, begin: int, end: int) -> tuple[Ints, Floats, Floats]:
    """Rays (P, C), points (P, 3) m and residuals (P,) px of frames from begin to end, as `estimate_observation_model` asks for them."""
    points = run_global(arrays, rays, begin, end).points
    return points.rays, points.points, points.residual


def run_global(arrays: RigArrays, rays: BlobRays, begin: int, end: int) -> FramesPart:
    """The likeliest points of frames from begin to end, each frame by itself."""
    offsets, cameras = rays.blobs.offsets, len(rays.blobs.cameras)
    # A point takes two blobs at least, so half of them bound the number of points.
    out = _empty_points(int(offsets[end * cameras] - offsets[begin * cameras]) // 2, cameras)
    counts, notes = np.zeros(end - begin, dtype=np.int64), np.zeros((end - begin, 2), dtype=np.int64)
    total = reconstruct_frames(arrays, rays.arrays, begin, end, out, counts, notes)
    return FramesPart(_first_points(out, total), counts, notes)


def _run_plain(by_covariance: bool, arrays: RigArrays, rays: BlobRays, begin: int, end: int) -> FramesPart:
    cameras, capacity = len(rays.blobs.cameras), _FIRST_CAPACITY
    frames = []
    notes = np.zeros((end - begin, 2), dtype=np.int64)
    for t in range(begin, end):
        # The plain method keeps all versions of a point at first, whose number only a run tells: run again with room for that many.
        while True:
            out = _empty_points(capacity, cameras)
            kept, versions = reconstruct_frame_plain(arrays, rays.arrays, t, by_covariance, out)
            if versions <= capacity:
                break
            capacity = 2 * versions
        frames.append(_first_points(out, kept))
        notes[t - begin] = versions, 1
    counts = np.array([len(frame.rays) for frame in frames], dtype=np.int64)
    return FramesPart(_joined(frames, cameras), counts, notes)


def _empty_points(size: int, cameras: int) -> PointArrays:
    return PointArrays(np.empty((size, cameras), dtype=np.int64), np.empty((size, 3)), np.empty((size, 3, 3)), np.empty(size))


def _first_points(points: PointArrays, count: int) -> PointArrays:
    return PointArrays(*(column[:count] for column in points))


def _joined(parts: list[PointArrays], cameras: int) -> PointArrays:
    return PointArrays(*(np.concatenate(column) for column in zip(_empty_points(0, cameras), *parts, strict=True)))


def assemble(
    parts: list[FramesPart],
    blobs: Blobs,
    problem: ReconstructionProblem,
    model: ObservationModel,
    method: str,
    masked: Ints,
    findings: tuple[Finding, ...],
    noise_known: bool,
) -> Reconstruction:
    """The reconstruction of all frames, whose parts follow each other."""
    cameras, rig = len(blobs.cameras), problem.rig
    points = _joined([part.points for part in parts], cameras)
    notes = np.concatenate([np.empty((0, 2), dtype=np.int64), *(part.notes for part in parts)])
    counts = np.concatenate([np.zeros(1, dtype=np.int64), *(part.counts for part in parts)])
    used = np.zeros(len(blobs.xy), dtype=np.bool_)
    #
    used[points.rays[points.rays >= 0]] = True
    cell = blobs.frame_of * cameras + blobs.camera_of
    vertical = as_vertical("z" if rig.vertical is None else rig.vertical)
    return Reconstruction(
        clouds=Clouds(points.points, np.cumsum(counts), blobs.rate, vertical, np.full(len(points.points), -1, dtype=np.int64)),
        residual=points.residual,
        covariance=points.covariance,
        scale=_scale(points.rays, points.points, rig),
        rays=points.rays,
        blobs=blobs,
        noise=model.noise,
        method=method,
        unused=np.bincount(cell[~used], minlength=len(blobs) * cameras).reshape(len(blobs), cameras),
        gated=notes[:, 0],
        proved=notes[:, 1] == 0,
        masked_places=masked,
        findings=findings,
        noise_known=noise_known,
    )


def _scale(rays: Ints, xyz: Floats, rig: Rig) -> Floats:
    """(P,) m/px, depth over focal length, the mean over each point's cameras."""
    total = np.zeros(len(xyz))
    for c, camera in enumerate(rig):
        # The geometric mean of the focal lengths keeps the area of a pixel.
        depth = xyz @ camera.rotation[2] + camera.translation[2]
        total += np.where(rays[:, c] >= 0, depth / math.sqrt(camera.focal[0] * camera.focal[1]), 0.0)
    mean: Floats = total / np.maximum((rays >= 0).sum(axis=1), 1)
    return mean
