"""Posed cameras and their images of a wand in; the images with each camera's lag taken out, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.calibration.wand.frames import evenly, widest_image
from asterism.calibration.wand.identify import Wand
from asterism.calibration.wand.initialise import adjust_subset, resect, resect_camera
from asterism.calibration.wand.recording import WandRecording
from asterism.calibration.wand.two_view import RULES as TWO_VIEW
from asterism.calibration.wand.two_view import initial_camera
from asterism.cameras.bundle import AdjustSettings, Sightings
from asterism.cameras.camera import Camera
from asterism.recording import Floats, Ints
from asterism.synchronization.residual_lags import LagRules, image_velocities, lags_from_residuals


@dataclass(frozen=True)
class SynchroniseRules:
    """How lags are found, in frames.

    reach            how far blobs may be off where a camera sees another moment, in widths of the image
    least, remaining lags below `least` are left; of larger ones, what is below `remaining` is left
    rounds           of shifting images and adjusting cameras to them
    least_drift      between the first and the last third of the recording
    echo             a camera that drifts makes the others seem to, by up to this share of it
    certain          standard deviations of a lag that is not zero
    farthest, stride how far cameras that do not fit at all are shifted, and in which steps
    least_share      share of the wand's places that a shifted camera must explain
    frames           frames that lags are fitted to, evenly spread over the recording
    resection_frames frames that a shifted camera is posed from

    Checked on the simulated wands with lagging, drifting and unsynchronised cameras of tests/test_wand.py.
    """

    reach: float = 0.012
    least: float = 0.08
    remaining: float = 0.008
    rounds: int = 12
    least_drift: float = 0.2
    echo: float = 0.3
    certain: float = 6.0
    farthest: int = 120
    stride: int = 2
    least_share: float = 0.4
    frames: int = 600
    resection_frames: int = 60


RULES = SynchroniseRules()


@dataclass(frozen=True)
class CameraLags:
    """By how many frames each camera (C,) lags behind the others.

    lag_frames  whole frames
    fraction    the part of a frame that is left
    drift       by how many frames more in the last third of the recording than in the first; 0 where nothing is certain
    """

    lag_frames: Ints
    fraction: Floats
    drift: Floats

    def select(self, cameras: Ints) -> CameraLags:
        """Those of some cameras only."""
        return CameraLags(self.lag_frames[cameras], self.fraction[cameras], self.drift[cameras])


def synchronise(recording: WandRecording, cameras: Sequence[Camera | None]) -> tuple[WandRecording, list[Camera | None], CameraLags]:
    """Shift the images of lagging cameras, by whole frames, then by what is left, until all cameras see the same wand.

    Returns the shifted recording, the cameras, and how far each lagged.
    """
    lag_frames = _coarse_lags(recording, cameras)
    recording = recording.shifted(lag_frames) if lag_frames.any() else recording
    found = _resect_shifted(recording, cameras, lag_frames)
    posed = np.array([c for c, camera in enumerate(found) if camera is not None])
    fraction, drift = np.zeros(len(found)), np.zeros(len(found))
    whole_frames = recording
    # A late camera bends the poses that its lag is measured by, so lags come out short at first: shift, adjust, measure again.
    for _ in range(RULES.rounds):
        step = _lag_step(recording, found, posed, np.where(fraction[posed] != 0.0, RULES.remaining, RULES.least))
        if step is None:
            break
        if not step.lags.any():
            # Only where no constant lag is left can a change of the lag be told from one.
            drift[posed] = step.drift
            break
        found = step.cameras
        fraction[posed] += step.lags
        whole = np.rint(fraction).astype(np.int64)
        # Whole frames are shifted without a trace; what is left is interpolated from the unshifted images once, never twice.
        if whole.any():
            lag_frames, fraction = lag_frames + whole, np.zeros(len(found))
            whole_frames = whole_frames.shifted(whole)
        recording = whole_frames
        if fraction.any():
            rate, frames = recording.blobs.rate, np.arange(len(recording))
            times = (frames[:, None] + fraction) / rate
            recording = replace(recording, blobs=replace(recording.blobs, times=times)).on_common_clock()
    return recording, found, CameraLags(lag_frames, fraction, drift)


@dataclass(frozen=True)
class _LagStep:
    """Cameras adjusted to the images as they are; the lags that these images still show (n,) of the posed ones; where none, the drift."""

    cameras: list[Camera | None]
    lags: Floats
    drift: Floats


def _lag_step(recording: WandRecording, cameras: Sequence[Camera | None], posed: Ints, least: Floats) -> _LagStep | None:
    """Adjust the cameras and fit their lags; None where too few frames agree. least (n,): smaller lags of the posed cameras are left."""
    wand, gate = recording.wand, RULES.reach * widest_image(cameras)
    poses = recording.locate(cameras, gate)
    settings = AdjustSettings(loss="cauchy", scale=0.5 * gate, tolerance=1e-4, steps=20, covariance=False)
    adjusted = adjust_subset(recording, poses, cameras, ("pose", "focal", "k1", "k2"), 60, settings)
    if adjusted is None:
        return None
    found, own = list(cameras), adjusted[0].cameras
    for c, camera in zip(posed, own, strict=True):
        found[c] = camera
    poses = recording.locate(found, gate)
    seen = poses.sightings(recording.blobs).among(found)
    lags = _significant(*estimate_lags(own, wand, seen, poses.starts, poses.directions), least)
    drift = np.zeros(len(posed))
    if not lags.any():
        first, last = (
            estimate_lags(own, wand, seen.select(part), poses.starts, poses.directions)
            for part in (3 * seen.frame < len(recording), 3 * seen.frame >= 2 * len(recording))
        )
        drift = _significant(last[0] - first[0], np.hypot(first[1], last[1]), RULES.least_drift)
        # Lags count from the median camera, so one that drifts makes the others seem to run the other way.
        drift[np.abs(drift) < RULES.echo * np.abs(drift).max()] = 0.0
    return _LagStep(found, lags, drift)


def _significant(lags: Floats, sigma: Floats, least: Floats | float) -> Floats:
    """Lags (C,), 0 where they are unknown, smaller than what matters, or not certain."""
    return np.where(np.isfinite(lags) & (np.abs(lags) > np.maximum(least, RULES.certain * sigma)), lags, 0.0)


def _coarse_lags(recording: WandRecording, cameras: Sequence[Camera | None]) -> Ints:
    """(C,) by how many frames cameras that could not be posed lag: with that lag they see the wand where the others do; else 0."""
    blobs, wand = recording.blobs, recording.wand
    lag_frames = np.zeros(len(cameras), dtype=np.int64)
    others = [camera for camera in cameras if camera is not None and camera.size is not None]
    poses = recording.locate(cameras, RULES.reach * widest_image(others))
    # Cameras of one room mostly have one kind of lens, and the guess need only be near.
    focal = float(np.median([camera.focal[0] / (camera.size or (1280, 0))[0] for camera in others]))
    for c, size in enumerate(recording.sizes):
        frames = np.nonzero(recording.shows_wand[:, c])[0]
        if cameras[c] is not None or len(frames) < TWO_VIEW.least_frames:
            continue
        best = (RULES.least_share, 0)
        for lag in range(-RULES.farthest, RULES.farthest + 1, RULES.stride):
            # This camera's frame t shows what the others saw in frame t + lag.
            at = frames[(frames + lag >= 0) & (frames + lag < len(recording))]
            at = at[np.isfinite(poses.starts[at + lag, 0])]
            if len(at) < TWO_VIEW.least_frames:
                continue
            at = evenly(at, RULES.resection_frames)
            world, xy = poses.markers(wand, at + lag), recording.images(at, c)
            if wand.symmetric:
                # Either end may come first; the middle is the middle.
                world, xy = world.mean(axis=1, keepdims=True), xy.mean(axis=1, keepdims=True)
            guess = recording.lenses[c] or initial_camera(blobs.cameras[c], size, focal * size[0])
            share = resect(world.reshape(-1, 3), xy.reshape(-1, 2), blobs.cameras[c], size, guess)[1]
            best = max(best, (share, lag))
        lag_frames[c] = best[1]
    return lag_frames


def _resect_shifted(recording: WandRecording, cameras: Sequence[Camera | None], lag_frames: Ints) -> list[Camera | None]:
    """The cameras, with those posed too that were shifted. The lag of a camera that still cannot be posed is set to 0, in place."""
    if not lag_frames.any():
        return list(cameras)
    poses = recording.locate(cameras, RULES.reach * widest_image(cameras))
    posed = [resect_camera(recording, poses, c) if lag_frames[c] else None for c in range(len(lag_frames))]
    for c in np.nonzero(lag_frames)[0]:
        lag_frames[c] = lag_frames[c] if posed[c] is not None else 0
    return [camera or other for camera, other in zip(cameras, posed, strict=True)]


def estimate_lags(cameras: Sequence[Camera], wand: Wand, sightings: Sightings, starts: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """By how many frames each camera lags (C,), counted from the median one, and the standard deviation of that; NaN where unknown.

    sightings  of neighbouring frames: each camera's images of the wand's markers; starts, directions (T, 3) m: where the wand lay
    """
    velocity = image_velocities(_without_flips(sightings, directions) if wand.symmetric else sightings)
    moving = np.isfinite(velocity[:, 0]) & np.isfinite(starts[sightings.frame, 0])
    # A lag shows only where markers move in the image, and some hundred frames determine it.
    moving &= np.isin(sightings.frame, evenly(np.unique(sightings.frame[moving]), RULES.frames))
    seen, frames = sightings.select(moving).compact()
    if len(seen) < LagRules().least_sightings:
        return np.full(len(cameras), np.nan), np.full(len(cameras), np.nan)
    residuals, by_wand = _linearised(cameras, wand, seen, starts[frames], directions[frames])
    return lags_from_residuals(seen, residuals, velocity[moving], by_wand, len(cameras))


def _without_flips(sightings: Sightings, directions: Floats) -> Sightings:
    """The same with markers named so that a symmetric wand does not turn around from frame to frame."""
    back = (directions[1:] * directions[:-1]).sum(axis=1) < 0.0
    # Each turn exchanges the ends from there on, so an odd number of them means exchanged.
    turned = np.concatenate([[0], np.cumsum(back)])[sightings.frame] % 2 == 1
    return replace(sightings, point=np.where(turned, sightings.point.max(initial=0) - sightings.point, sightings.point))


def _linearised(cameras: Sequence[Camera], wand: Wand, seen: Sightings, starts: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """What each sighting misses (n, 2) px, and how a shift (m) and a turn (rad) of its frame's wand move it, (n, 2, 6)."""
    along = wand.lengths[seen.point][:, None] * directions[seen.frame]
    world = starts[seen.frame] + along
    residuals, by_point = np.empty((len(seen), 2)), np.empty((len(seen), 2, 3))
    for c, camera in enumerate(cameras):
        own = seen.camera == c
        residuals[own] = seen.xy[own] - camera.project(world[own])
        for axis, step in enumerate(1e-4 * np.eye(3)):
            # Central differences: a tenth of a millimetre is small against the room and large against rounding.
            by_point[own, :, axis] = (camera.project(world[own] + step) - camera.project(world[own] - step)) / 2e-4
    turned = np.cross(np.eye(3)[None], along[:, None])
    return residuals, np.concatenate([by_point, np.einsum("nij,nkj->nik", by_point, turned)], axis=2)
