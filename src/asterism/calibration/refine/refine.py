"""A rig and any recording of markers in; which camera was moved, and the rig corrected from the recording itself, out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from asterism.calibration.refine.adjustment import RigFit, adjust_rig
from asterism.calibration.refine.compare import CameraComparison, compare_camera
from asterism.calibration.refine.result import CameraCheck, Refinement
from asterism.calibration.refine.rules import RULES
from asterism.calibration.refine.subset import estimate_noise, reconstruct_by, some_frames
from asterism.cameras import Camera, Rig
from asterism.errors import AsterismError
from asterism.geometry import vector_from_rotation
from asterism.progress import Progress
from asterism.reconstruction.camera_fit import frames_behind, match_radius, misfit_limit
from asterism.recording import Blobs, Floats, Ints
from asterism.synchronization import to_common_clock

_CONTRADICT = "the cameras contradict each other so much that none can be trusted; calibrate the rig again."


def refine_rig(blobs: Blobs, rig: Rig, *, frames: int = RULES.frames, progress: Progress | None = None) -> Refinement:
    """Check every camera of a rig against what the others see, and correct the poses of those that were moved.

    blobs   any recording of markers, taken after the camera was moved; the more markers move all over the volume, the better
    frames  how many of its frames to use

    Each camera in turn is left out, and the points that the others compose are searched for in its images: near where they should be, or
    anywhere that all of them together have moved to. The camera that has moved and fits best in a new place is corrected first; then the
    others are compared without it, and again, until those that are left agree. A camera that would fit at another frame is out of step and
    left as it is. At last the new poses, and focal lengths that certainly changed, are adjusted to all sightings, the others held; a camera
    that is still off is lost. Raises AsterismError where fewer than three cameras of the rig have blobs, no points can be composed, or no
    few cameras agree with each other.
    """
    report: Progress = progress or (lambda fraction, doing: None)
    blobs = to_common_clock(blobs) if blobs.times is not None else blobs
    rig = rig.select(blobs.cameras)
    seeing = [c for c in range(len(rig)) if rig[c].posed and blobs.counts[:, c].any()]
    if len(seeing) < 3:
        raise AsterismError(f"only {len(seeing)} cameras of the rig have blobs and a pose; to tell which one was moved takes three.")
    some, picked = some_frames(blobs, seeing, frames)
    report(0.0, "measuring the noise")
    problem = _RefinementProblem(some, rig, seeing, estimate_noise(some, rig, seeing))
    reference, comparisons = _find_reference(problem, report)
    if len(reference) < max(2, len(seeing) / 2):
        raise AsterismError(_CONTRADICT)
    others = [c for c in seeing if c not in reference]
    lags = {c: _lag(problem, blobs, picked, c, reference) for c in others}
    moved = [c for c in others if comparisons[c].camera is not None and not lags[c]]
    report(0.9, "adjusting")
    fitted = _adjust_moved(problem, moved, {c: comparisons[c].camera for c in moved}, reference)
    last = _final_fit(problem, fitted, moved, reference)
    states = _states(problem, reference, comparisons, lags, last.off)
    if 2 * sum(states[c] == "lost" for c in reference) >= len(reference):
        raise AsterismError(_CONTRADICT)
    fitted = replace(fitted, cameras=tuple(fitted[c] if states[c] == "moved" else rig[c] for c in range(len(rig))))
    checks = [
        replace(_check_camera(rig, c, fitted[c], comparisons.get(c), states[c]), rms_px=float(last.errors[c]), lag_frames=lags.get(c, 0))
        for c in range(len(rig))
    ]
    report(1.0, "done")
    return Refinement(fitted, tuple(checks), problem.noise, len(some))


@dataclass(frozen=True)
class _RefinementProblem:
    """Some frames of a recording, the rig as it was calibrated, the cameras (by number) that see something, and the noise, px."""

    blobs: Blobs
    rig: Rig
    seeing: list[int]
    noise: float


def _find_reference(problem: _RefinementProblem, report: Progress) -> tuple[list[int], dict[int, CameraComparison]]:
    """The cameras that agree with each other as the rig has them, and how each camera compares with them."""
    rig, seeing = problem.rig, problem.seeing
    reference = list(seeing)
    comparisons: dict[int, CameraComparison] = {}
    while len(reference) >= 2:
        comparisons = {}
        for n, c in enumerate(seeing):
            done = 1 - (len(reference) - n / len(seeing)) / (len(seeing) + 1)
            report(0.1 + 0.8 * done, f"comparing camera {rig[c].name}")
            others = [other for other in reference if other != c]
            if len(others) >= 2:
                comparisons[c] = compare_camera(problem.blobs, rig, c, others, problem.noise)
        moved = [
            c
            for c in reference
            if c in comparisons and comparisons[c].moved > _least_move(comparisons[c], problem.noise, len(reference) - 1)
        ]
        if not moved:
            break
        reference.remove(_most_likely_moved(problem, moved, comparisons, reference))
    return reference, comparisons


def _least_move(comparison: CameraComparison, noise: float, others: int) -> float:
    """px that a view must have moved by to be called moved, by what noise makes of a pose from so many points of so many cameras."""
    least = max(misfit_limit(noise), RULES.certain * noise * math.sqrt(6.0 / max(comparison.shown * comparison.points, 1.0)))
    return least if others >= 3 else RULES.by_two * least


def _most_likely_moved(
    problem: _RefinementProblem, moved: list[int], comparisons: dict[int, CameraComparison], reference: list[int]
) -> int:
    """Of cameras that seem to have moved, the one that did: with its new pose all agree best. One moved camera makes others seem moved."""
    likely = sorted((c for c in moved if comparisons[c].camera is not None), key=lambda c: -comparisons[c].shown)[:3]
    if len(likely) < 2:
        return likely[0] if likely else max(moved, key=lambda c: -comparisons[c].shown)
    merit = {}
    for c in likely:
        cameras = tuple(comparisons[c].camera or camera if i == c else camera for i, camera in enumerate(problem.rig))
        fit = adjust_rig(problem.blobs, replace(problem.rig, cameras=cameras), [c], reference, problem.noise)
        merit[c] = fit.sightings * (1.0 - float(np.nanmean(fit.errors)) / (8.0 * problem.noise)) if fit.sightings else -math.inf
    return max(likely, key=lambda c: merit[c])


def _lag(problem: _RefinementProblem, blobs: Blobs, picked: Ints, camera: int, reference: list[int]) -> int:
    """By how many frames a camera, as the rig has it, is behind the reference cameras; picked: the numbers of the frames used."""
    clouds = list(reconstruct_by(problem.blobs, problem.rig, reference, problem.noise).clouds)
    return frames_behind(clouds, picked.tolist(), blobs, camera, problem.rig[camera], match_radius(problem.noise))


def _adjust_moved(problem: _RefinementProblem, moved: list[int], poses: dict[int, Camera | None], reference: list[int]) -> Rig:
    """The rig with its moved cameras adjusted, twice since what they are seen to show changes; focal lengths only where they changed."""
    rig, blobs, noise = problem.rig, problem.blobs, problem.noise
    fitted = replace(rig, cameras=tuple(poses.get(c) or rig[c] for c in range(len(rig))))
    cameras = [*reference, *moved]
    for _ in range(2 if moved else 0):
        trial = adjust_rig(blobs, fitted, moved, cameras, noise, zoomed=moved)
        least = np.maximum(RULES.least_zoom * np.array([camera.focal[0] for camera in rig]), RULES.certain * trial.focal_sigma)
        zoomed = [c for c in moved if abs(trial.rig[c].focal[0] - rig[c].focal[0]) > least[c] and np.isfinite(trial.off[c])]
        start = tuple(trial.rig[c] if c in zoomed else replace(fitted[c], focal=rig[c].focal) for c in range(len(rig)))
        fitted = adjust_rig(blobs, replace(rig, cameras=start), moved, cameras, noise, zoomed=zoomed).rig
    return fitted


def _final_fit(problem: _RefinementProblem, fitted: Rig, moved: list[int], reference: list[int]) -> RigFit:
    """How all cameras fit; again without moved ones that do not, since they spoil the points of the others."""
    last = adjust_rig(problem.blobs, fitted, [], [*reference, *moved], problem.noise)
    unfit = [c for c in moved if not last.off[c] <= misfit_limit(problem.noise)]
    if unfit:
        last = adjust_rig(problem.blobs, fitted, [], [c for c in (*reference, *moved) if c not in unfit], problem.noise)
    return last


def _states(
    problem: _RefinementProblem, reference: list[int], comparisons: dict[int, CameraComparison], lags: dict[int, int], off: Floats
) -> list[str]:
    """What became of each camera. Two reference cameras can only be compared with each other."""
    limit = misfit_limit(problem.noise)
    states = []
    for c in range(len(problem.rig)):
        if c not in problem.seeing:
            states.append("unknown")
        elif c in reference:
            known = np.isfinite(off[c]) and (len(reference) < 3 or np.isfinite(comparisons[c].moved))
            states.append("unknown" if not known else "good" if off[c] <= limit else "lost")
        elif lags[c]:
            states.append("out of step")
        else:
            states.append("moved" if off[c] <= limit else "lost")
    return states


def _check_camera(rig: Rig, c: int, now: Camera, comparison: CameraComparison | None, state: str) -> CameraCheck:
    was = rig[c]
    turned, shifted = _pose_difference(was, now)
    moved, shown, points = (comparison.moved, comparison.shown, comparison.points) if comparison is not None else (math.nan, math.nan, 0)
    place_of = next((other.name for other in rig if other.name != was.name and _same_pose(other, now)), "") if state == "moved" else ""
    zoomed = now.focal[0] / was.focal[0] - 1.0
    return CameraCheck(was.name, moved, math.nan, turned, shifted, zoomed, shown, points, state, 0, place_of)


def _same_pose(one: Camera, other: Camera) -> bool:
    turned, shifted = _pose_difference(one, other)
    return turned < RULES.same_pose[0] and shifted < RULES.same_pose[1]


def _pose_difference(one: Camera, other: Camera) -> tuple[float, float]:
    """rad and m by which two cameras are turned and shifted against each other."""
    turned = float(np.linalg.norm(vector_from_rotation(other.rotation @ one.rotation.T)))
    return turned, float(np.linalg.norm(other.position - one.position))
