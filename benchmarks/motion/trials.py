"""What the rows about motion share: simulated people that nothing was tuned on, and how an analysis is compared with their bones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from asterism.motion.analysis import joint_angles
from asterism.motion.joints import find_skeleton
from asterism.motion.rigid import estimate_limb_motion
from asterism.simulation.soft_tissue import JOINTS, SoftTissueTrial, TrialPlan, simulate_soft_tissue

SEED = 20261123
"""Constants were chosen on subjects 100 to 109 with seed 1."""
SUBJECTS, MOTIONS = 10, 3
DENSE_POINTS, MARKERS = 3000, 8


def plans(sparse: bool, quick: bool = False, points: int = DENSE_POINTS) -> list[TrialPlan]:
    """Ten people, shoulder, knee and hip; sparse clusters in all three motions, dense points in one of them each, in turn."""
    people = range(1 if quick else SUBJECTS)
    if sparse:
        return [TrialPlan(j, s, m, MARKERS, True, noise_m=0.0005) for s in people for j in JOINTS for m in range(1 if quick else MOTIONS)]
    return [TrialPlan(j, s, (s + i) % MOTIONS, 300 if quick else points) for s in people for i, j in enumerate(JOINTS)]


def trial_of(plan: TrialPlan) -> SoftTissueTrial:
    """The simulated trial of a plan, of people that nothing was tuned on."""
    return simulate_soft_tissue(plan, SEED)


def share_right(limb_of: np.ndarray, truth: np.ndarray) -> float:
    """The share of points on the right limb, limbs named as fits best."""
    count = int(max(limb_of.max(), truth.max())) + 1
    pairs = np.zeros((count, count))
    np.add.at(pairs, (limb_of[limb_of >= 0], truth[limb_of >= 0]), 1)
    rows, columns = linear_sum_assignment(-pairs)
    return float(pairs[rows, columns].sum() / len(truth))


@dataclass(frozen=True)
class Errors:
    """An angle's errors in degrees: mean, largest, and how they grow with the angle (degrees per degree); the centre's in m."""

    mean: float
    worst: float
    slope: float
    centre: float


def errors_of(trial: SoftTissueTrial, limb_of: np.ndarray, method: str) -> Errors:
    """The angle and the centre of a trial's one joint by a method, from the limbs that were found, against the bones."""
    positions = trial.recording.positions
    points = [positions[:, limb_of == limb] for limb in (0, 1)]
    motions = [estimate_limb_motion(own, method) for own in points]
    joint = joint_angles(motions[0], motions[1])
    error = np.degrees(joint.angle - trial.angles[0])
    skeleton = find_skeleton(motions, points)
    (parent, child), *_ = skeleton.pairs
    fitted = skeleton.joints[child]
    assert fitted is not None
    centre = float(np.nanmean(np.linalg.norm(fitted.centres(motions[parent], motions[child]) - trial.centres[0], axis=1)))
    slope = float(np.polyfit(np.degrees(trial.angles[0]), error, 1)[0])
    return Errors(float(np.nanmean(np.abs(error))), float(np.nanmax(np.abs(error))), slope, centre)
