"""Posed cameras and their images of a wand in; the final adjustment of everything, and which blobs it uses, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.calibration.wand.diagnose import RULES as DIAGNOSIS
from asterism.calibration.wand.diagnose import diagnose_detection, inner_marker_shares
from asterism.calibration.wand.frames import spread_frames, widest_image
from asterism.calibration.wand.identify import Wand
from asterism.calibration.wand.initialise import adjust_subset, robust_noise
from asterism.calibration.wand.recording import WandRecording
from asterism.calibration.wand.two_view import RULES as TWO_VIEW
from asterism.calibration.wand.two_view import priors
from asterism.cameras.bundle import Adjustment, AdjustSettings, Sightings, adjust, free_parameters
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class FinalRules:
    """How the final adjustment chooses blobs.

    frames         at most, evenly spread over the recording; more add little
    wide           blobs are searched for within this share of the image's width at first,
    reach          or within so many standard deviations of the noise
    least_reach    px, at least
    narrow         blobs within so many standard deviations of where they should be are kept
    noise_range    a camera may be so many times as noisy as the others, or as quiet
    subset_frames  frames of each camera for the first round
    k3_frames      frames on which a third radial coefficient is tried
    loss_noises    the robust loss grows linearly from so many standard deviations on

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    frames: int = 3000
    wide: float = 0.0036
    reach: float = 6.0
    least_reach: float = 1.5
    narrow: float = 4.5
    noise_range: float = 6.0
    subset_frames: int = 60
    k3_frames: int = 400
    loss_noises: float = 3.0


RULES = FinalRules()
_GROUPS = ("pose", "focal", "aspect", "centre", "k1", "k2", "tangential")


@dataclass(frozen=True)
class FinalAdjustment:
    """The final adjustment and what it rests on.

    result     cameras, residuals and covariance
    sightings  that were used, frames counted without holes
    used       (m,) the frames that these numbers stand for
    offered    the frames from which they were chosen
    """

    result: Adjustment
    sightings: Sightings
    used: Ints
    offered: Ints

    @property
    def recorded(self) -> Sightings:
        """The sightings with the frames of the recording."""
        return replace(self.sightings, frame=self.used[self.sightings.frame])


@dataclass(frozen=True)
class _WandProblem:
    """The wand's images to be explained: placements (rotations, translations) to begin with, known lenses, and each camera's noise."""

    wand: Wand
    sightings: Sightings
    placements: tuple[Floats, Floats]
    lenses: Sequence[Camera | None]
    noise: float
    relative: Floats

    def fit(self, cameras: Sequence[Camera], groups: tuple[str, ...], **settings: float | bool) -> Adjustment:
        """Adjust these groups of parameters of all cameras for blobs of this noise, px, times each camera's relative one (C,)."""
        chosen = AdjustSettings(scale=RULES.loss_noises * self.noise, relative_noise=self.relative)
        return adjust(
            cameras, self.wand.template, self.sightings, *self.placements, free=free_parameters(len(cameras), *groups),
            prior=priors(cameras, self.lenses, self.noise), settings=replace(chosen, **settings),  # type: ignore[arg-type]
        )  # fmt: skip

    def needs_k3(self, cameras: Sequence[Camera]) -> bool:
        """Whether a third radial coefficient explains more than noise would let it explain, on a part of the frames."""
        # Every n-th frame: a lens shows in few frames already, and the question is asked of two adjustments.
        some = self.sightings.frame % max(1, len(self.placements[0]) // RULES.k3_frames) == 0
        part, rows = self.sightings.select(some).compact()
        at = self.placements[0][rows], self.placements[1][rows]
        problem = replace(self, sightings=part, placements=at)
        without, with_it = (
            problem.fit(cameras, groups, tolerance=1e-5, steps=10, covariance=False).cost for groups in (_GROUPS, (*_GROUPS, "k3"))
        )
        n = len(cameras)
        # Noise alone lowers twice the cost by about one per camera, with a variance of two each: four standard deviations more is no noise.
        return bool(2.0 * (without - with_it) / self.noise**2 > n + 4.0 * np.sqrt(2.0 * n))


def adjust_cameras(recording: WandRecording, cameras: Sequence[Camera | None], noise: float) -> FinalAdjustment:
    """Free all parameters of all posed cameras, and leave out blobs that do not fit the others.

    Raises AsterismError where too few frames fit the wand.
    """
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    cameras, noise, relative = _refined(recording, cameras, posed, noise)
    poses = recording.locate(cameras, np.maximum(RULES.reach * noise * relative, RULES.least_reach))
    offered = spread_frames(recording.shows_wand, RULES.frames)
    sightings, used = poses.sightings(recording.blobs, offered).compact()
    if len(used) < TWO_VIEW.least_frames:
        _raise_too_few(recording, len(used))
    sightings = sightings.among(cameras)
    own = [camera for camera in cameras if camera is not None]
    rotations, translations = (part[used] for part in poses.placements())
    lenses = [recording.lenses[c] for c in posed]
    problem = _WandProblem(recording.wand, sightings, (rotations, translations), lenses, noise, relative[posed])
    # First with all blobs and a robust loss: it tells which of them do not fit, and how noisy the rest is.
    result = problem.fit(own, _GROUPS, tolerance=1e-5, covariance=False)
    each = problem.relative[sightings.camera]
    own, noise = list(result.cameras), max(robust_noise(result.residuals / each[:, None]), 1e-3)
    good = np.linalg.norm(result.residuals, axis=1) < RULES.narrow * noise * each
    sightings, rows = _determined(sightings.select(good), len(recording.wand)).compact()
    # Then with those that fit, whose residuals are noise, so that the covariance means something.
    problem = replace(problem, sightings=sightings, placements=(result.rotations[rows], result.translations[rows]), noise=noise)
    result = problem.fit(own, (*_GROUPS, "k3") if problem.needs_k3(own) else _GROUPS, tolerance=1e-7)
    return FinalAdjustment(result, sightings, used[rows], offered)


def _refined(
    recording: WandRecording, cameras: Sequence[Camera | None], posed: list[int], noise: float
) -> tuple[list[Camera | None], float, Floats]:
    """The cameras with all parameters adjusted on a part of the frames; the noise, px, and each camera's relative one (C,)."""
    found, relative = list(cameras), np.ones(len(cameras))
    poses = recording.locate(cameras, max(RULES.wide * widest_image(cameras), RULES.reach * noise))
    settings = AdjustSettings(loss="cauchy", scale=max(2.0 * noise, 0.2), tolerance=1e-4, steps=20, covariance=False)
    # The Cauchy loss hardly minds outliers; they are many as long as nothing has been left out.
    adjusted = adjust_subset(recording, poses, cameras, _GROUPS, RULES.subset_frames, settings)
    if adjusted is not None:
        result, seen = adjusted
        for c, camera in zip(posed, result.cameras, strict=True):
            found[c] = camera
        noise = max(robust_noise(result.residuals), 0.01)
        relative[posed] = _relative_noise(result.residuals, seen.camera, len(posed), noise)
    return found, noise, relative


def _raise_too_few(recording: WandRecording, frames: int) -> None:
    reason = diagnose_detection(recording.blobs, recording.wand)
    if reason:
        raise AsterismError(f"only {frames} frames fit the wand{reason}")
    raise AsterismError(
        f"only {frames} frames show the wand to two cameras that agree on it; wave it longer where cameras overlap, and check that "
        "they ran in step."
    )


def _relative_noise(residuals: Floats, camera: Ints, cameras: int, noise: float) -> Floats:
    """(C,) each camera's noise by all cameras'; 1 for two cameras, which share what they miss."""
    if cameras < 3:
        return np.ones(cameras)
    own = [residuals[camera == c] for c in range(cameras)]
    each = [robust_noise(part) / noise if len(part) > TWO_VIEW.least_frames else 1.0 for part in own]
    return np.clip(each, 1.0 / RULES.noise_range, RULES.noise_range)


def inner_marker_position(recording: WandRecording, frames: Ints, cameras: dict[int, Camera], positions: Floats) -> float:
    """Where single images of some frames (m,) put the inner marker, m from the first one.

    It is the median of where their rays pass the line of the measured wand, positions (m, K, 3) m. Of a symmetric wand it is where images
    usually show it, if that is far from what was given. Else NaN.
    """
    wand = recording.wand
    if len(wand) < 3:
        return float("nan")
    if wand.symmetric:
        # From a symmetric wand's images nobody knows which end is which, so rays cannot be laid on its line.
        share, given = inner_marker_shares(recording.blobs, wand)
        return share * float(wand.lengths[2]) if abs(share - given) > DIAGNOSIS.perspective else float("nan")
    start, along = positions[:, 0], positions[:, 2] - positions[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    shows = recording.shows_wand[frames]
    places = []
    for c, camera in cameras.items():
        rows = np.nonzero(shows[:, c] & np.isfinite(along[:, 0]))[0]
        ray, line = camera.rays(recording.images(frames[rows], c)[:, 1]), along[rows]
        to = camera.position - start[rows]
        across = (ray * line).sum(axis=1)
        # Where ray and wand come nearest to each other, measured along the wand.
        place = ((to * line).sum(axis=1) - across * (to * ray).sum(axis=1)) / (1.0 - across**2)
        # A ray almost along the wand meets it nowhere for certain.
        places.append(place[np.isfinite(place) & (across**2 < 0.9)])
    every = np.concatenate(places)
    return float(np.median(every)) if len(every) else float("nan")


def _determined(sightings: Sightings, markers: int) -> Sightings:
    """Those of frames that two cameras see, with more coordinates than a wand has freedoms."""
    frames = int(sightings.frame.max(initial=-1)) + 1
    count = np.bincount(sightings.frame, minlength=frames)
    # Frame and camera as one number, so that a camera with three markers counts once; no rig has 1,024 cameras.
    cameras = np.bincount(np.unique(sightings.frame * 1024 + sightings.camera) // 1024, minlength=frames)
    points = np.bincount(np.unique(sightings.frame * 8 + sightings.point) // 8, minlength=frames)
    good = (cameras >= 2) & (2 * count > (3 if markers == 1 else 5)) & (points >= min(2, markers))
    return sightings.select(good[sightings.frame])
