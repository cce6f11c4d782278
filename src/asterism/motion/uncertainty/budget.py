"""A motion analysis and error sources in; each joint angle with intervals, and what each source adds to it, out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from asterism.findings import Finding, Severity
from asterism.geometry import best_rotation
from asterism.motion.analysis import JointAngles, MotionAnalysis
from asterism.motion.joints.angles import joint_rotation
from asterism.motion.rigid.limb import LimbMotion, refit_limb_motion
from asterism.motion.rigid.rotations import rotation_vectors
from asterism.motion.segmentation._kernels import stray_from_motions
from asterism.motion.uncertainty.first_order import FirstOrder, first_order_angles
from asterism.motion.uncertainty.monte_carlo import MonteCarlo, MonteCarloRules, run_by_source
from asterism.motion.uncertainty.sources import CalibrationField, ErrorSources, MeasurementNoise
from asterism.progress import Progress
from asterism.recording import Floats

SOURCES = ("cameras", "soft tissue")

TRIED_ON = (
    "Intervals are those of a model of errors. They were tried on simulated people, whose skin slides smoothly over the bone in step with "
    "the joint; on skin that moves otherwise, the wider one was seen to hold the angle in 61 to 98 % of the frames."
)
"""What stands beside intervals wherever they are shown."""


@dataclass(frozen=True)
class AngleUncertainty:
    """A joint's angles with their uncertainty, in rad.

    joint      parent, child and angles, see `JointAngles`
    angle      (T,) since frame zero; angle_intervals {probability: (low, high)}, each (T,)
    flexion    (T,) about the joint's main axis, which is found from the motion, so that no palpated landmark turns it; flexion_intervals
               likewise
    angle_standard, flexion_standard  (T,) standard uncertainties
    budget     {source: (T,)} standard uncertainty of the flexion from each source alone, and of "all" together, in the same trials
    angle_budget  the same of the angle since frame zero
    first_order   of the angle, from the measurement noise, and where it holds
    """

    joint: JointAngles
    angle: Floats
    angle_intervals: dict[float, tuple[Floats, Floats]]
    angle_standard: Floats
    flexion: Floats
    flexion_intervals: dict[float, tuple[Floats, Floats]]
    flexion_standard: Floats
    budget: dict[str, Floats]
    angle_budget: dict[str, Floats]
    first_order: FirstOrder


@dataclass(frozen=True)
class UncertaintyResult:
    """The uncertainty of all joints; how many trials were made and whether they were enough; the noise (m) that was taken."""

    joints: tuple[AngleUncertainty, ...]
    trials: int
    converged: bool
    noise: float
    findings: tuple[Finding, ...]


def estimate_uncertainty(
    analysis: MotionAnalysis,
    sources: ErrorSources | None = None,
    *,
    seed: int = 0,
    workers: int = 1,
    rules: MonteCarloRules | None = None,
    budget_trials: int = 200,
    reassign: bool = True,
    progress: Progress | None = None,
) -> UncertaintyResult:
    """The uncertainty of all joint angles by Monte Carlo through the whole chain, and a budget by source.

    Each trial draws the points' noise, the calibration's errors (triangulated anew) and the skin's motion;
    assigns the points to limbs again (`reassign`), fits limbs and computes the angles. The budget repeats this with one source at a
    time, in `budget_trials` trials. Trial k has a generator of its own, so workers change nothing. Intervals are about the estimate: the
    trials' deviations from their own mean, added to it. All are NaN exactly in the frames in which the angle is; without a joint there is
    nothing to tell, and no trial is made.
    Raises AsterismError where a calibration does not fit. O(trials T N), some 60 ms a trial for 3,000 points in 100 frames.

    >>> from asterism.motion import analyse_motion
    >>> from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue
    >>> knee = simulate_soft_tissue(TrialPlan("knee", points=40, frames=20), seed=1).recording
    >>> certain = estimate_uncertainty(analyse_motion(knee, 2), rules=MonteCarloRules(most=50), budget_trials=50)
    >>> low, high = certain.joints[0].angle_intervals[0.95]
    >>> bool((low <= certain.joints[0].angle).all() and (certain.joints[0].angle <= high).all())
    True
    """
    sources = sources or ErrorSources()
    rules = rules or MonteCarloRules()
    noise = sources.noise or MeasurementNoise(_measured_noise(analysis))
    complete = replace(sources, noise=noise)
    if not analysis.angles:
        return UncertaintyResult((), 0, True, noise.typical, ())
    chain = _Chain.of(analysis, complete, reassign)
    runs = run_by_source(chain.trial, SOURCES, budget_trials, seed=seed, workers=workers, rules=rules, progress=progress)
    total = runs[0]
    joints = tuple(_of_joint(analysis, j, runs, noise.typical) for j in range(len(analysis.angles)))
    return UncertaintyResult(joints, total.trials, total.converged, noise.typical, tuple(_findings(complete, total, joints)))


def _measured_noise(analysis: MotionAnalysis) -> float:
    """m per coordinate: the residual of the tenth of the points that follow their limbs best. It has some soft tissue in it, if little."""
    best = [np.nanquantile(motion.rms, 0.1) for motion in analysis.motions]
    frames, points = analysis.recording.positions.shape[:2]
    # A fit takes six freedoms, a template one mean: what is left of the noise is smaller than the noise.
    lost = max(1 - 6 / max(3 * points / max(len(analysis.motions), 1), 7), 0.3)
    return float(np.median(best) / np.sqrt(3 * lost * max(1 - 1 / frames, 0.5)))


@dataclass(frozen=True)
class _Chain:
    """Everything that a trial needs: the nominal result, the sources made ready, and which points are where."""

    analysis: MotionAnalysis
    sources: ErrorSources
    field: CalibrationField | None
    points: tuple[np.ndarray, ...]
    courses: tuple[tuple[Floats, ...], ...]
    amplitudes: tuple[Floats, ...]
    reassign: bool

    @classmethod
    def of(cls, analysis: MotionAnalysis, sources: ErrorSources, reassign: bool) -> _Chain:
        points = tuple(np.nonzero(analysis.limb_of == limb)[0] for limb in range(len(analysis.names)))
        courses, amplitudes = [], []
        for limb, motion in enumerate(analysis.motions):
            bends = [_course(joint) for joint in analysis.angles if limb in (joint.parent, joint.child)]
            courses.append(tuple(bends))
            amplitudes.append(_amplitude(motion, bends, sources))
        field = None if sources.calibration is None else sources.calibration.field(analysis.recording.positions)
        return cls(analysis, sources, field, points, tuple(courses), tuple(amplitudes), reassign)

    def trial(self, active: tuple[str, ...]) -> Callable[[np.random.Generator], Floats]:
        """One trial with these sources: a function of its generator that gives (J, 2, T) rad, angle since zero and flexion."""

        def run(rng: np.random.Generator) -> Floats:
            # Streams of their own, spawned always: a source that is off must not shift the others' draws.
            return self._angles(self._fitted(self._drawn(active, *rng.spawn(2))))

        return run

    def _drawn(self, active: tuple[str, ...], of_cameras: np.random.Generator, of_skin: np.random.Generator) -> Floats:
        """The points with the errors of one trial: (T, N, 3) m."""
        given = self.analysis.recording.positions
        positions = given.copy()
        if "cameras" in active:
            assert self.sources.noise is not None
            # Errors of single points, then those that all points share.
            positions += self.sources.noise.draw(given.shape, of_cameras)
            if self.field is not None:
                positions += self.field.draw(of_cameras)
        if "soft tissue" in active and self.sources.soft_tissue is not None:
            for limb, motion in enumerate(self.analysis.motions):
                # Without a joint nothing bends, and skin stays.
                if not self.courses[limb]:
                    continue
                skin = self.sources.soft_tissue.draw(motion.template, self.amplitudes[limb], self.courses[limb], of_skin)
                positions[:, self.points[limb]] += skin @ motion.rotations.swapaxes(1, 2)
        return positions

    def _fitted(self, positions: Floats) -> list[Floats]:
        """Rotations (T, 3, 3) of all limbs, points that now stray less on another limb left out of their own."""
        motions = self.analysis.motions
        moved = np.zeros(positions.shape[1], dtype=bool)
        if self.reassign and len(motions) > 1 and self.analysis.segmentation is not None:
            stray = np.empty((positions.shape[1], len(motions)))
            rotations = np.stack([motion.rotations for motion in motions])
            # A point that now fits another limb better would have been assigned there.
            stray_from_motions(positions, rotations, np.stack([motion.translations for motion in motions]), stray)
            moved = (np.argmin(stray, axis=1) != self.analysis.limb_of) & (self.analysis.limb_of >= 0)
        fitted = []
        for columns, motion in zip(self.points, motions, strict=True):
            points = positions[:, columns]
            if not (moved[columns].any() and (~moved[columns]).sum() >= 4):
                fitted.append(refit_limb_motion(points, motion)[0])
                continue
            rotations = refit_limb_motion(np.where(moved[columns][:, None], np.nan, points), motion)[0]
            # Without the points that strayed a frame may keep fewer than three: there all of them count.
            lost = np.isnan(rotations) & np.isfinite(motion.rotations)
            if lost.any():
                rotations = np.where(lost, refit_limb_motion(points, motion)[0], rotations)
            fitted.append(rotations)
        return fitted

    def _angles(self, rotations: list[Floats]) -> Floats:
        out = []
        for joint in self.analysis.angles:
            parent, child = rotations[joint.parent], rotations[joint.child]
            since = rotation_vectors(joint_rotation(parent, child, zero=joint.zero))
            out.append([signed_angle(since, joint), self._flexion(joint, parent, child)])
        return np.array(out).reshape(len(self.analysis.angles), 2, -1)

    def _flexion(self, joint: JointAngles, parent: Floats, child: Floats) -> Floats:
        """(T,) rad: the turn about the joint's axis, counted from the mean rotation of the nominal result."""
        motions = self.analysis.motions
        nominal = joint_rotation(motions[joint.parent].rotations, motions[joint.child].rotations)
        # Counted from the nominal mean in all trials: else a trial's own mean would hide a shift.
        mean = best_rotation(nominal[np.isfinite(nominal[:, 0, 0])].sum(axis=0))
        vectors = rotation_vectors(joint_rotation(parent, child) @ mean.T)
        angle = np.linalg.norm(vectors, axis=1)
        return np.asarray(2 * np.arctan2(np.sinc(angle / (2 * np.pi)) / 2 * (vectors @ joint.axis), np.cos(angle / 2)))


def signed_angle(vectors: Floats, joint: JointAngles) -> Floats:
    """(T,) rad: rotation vectors along the direction that the nominal result has in each frame.

    To first order it is the change of the angle; unlike a length it is not folded at 0, so noise about a small angle has mean 0.
    """
    return np.asarray(np.einsum("ti,ti->t", vectors, joint.directions))


def _course(joint: JointAngles) -> Floats:
    """(T,) 0 to 1: the joint's angle by its largest, 0 where it is not known."""
    angle = np.where(np.isfinite(joint.angle), joint.angle, 0.0)
    return np.asarray(angle / max(float(angle.max()), 1e-9))


def _amplitude(motion: LimbMotion, courses: list[Floats], sources: ErrorSources) -> Floats:
    """(N,) m per axis: how far each point is displaced where a joint is bent most, from what its residuals show beside the noise.

    A fit takes a share of each point's displacement for motion of the limb: the share of its weight in the six freedoms (its leverage).
    """
    soft, noise = sources.soft_tissue, sources.noise
    if soft is None or noise is None or not courses:
        return np.zeros(len(motion.template))
    rms = motion.rms
    known = np.where(np.isfinite(rms), rms, np.nanmedian(rms))
    weights = motion.weights.mean(axis=0)
    # A point that dominates the fit shows hardly any residual, however far its skin slides.
    leverage = np.minimum(2 * weights / max(float(weights.sum()), 1e-9), 0.8)
    shown = np.sqrt(np.maximum(known**2 / (1 - leverage) - 3 * noise.typical**2, 0.0) / 3)
    # Residuals grow with the bend: the same sliding shows less where the joint moved less.
    swing = max(float(np.mean([course.std() for course in courses])), 0.1)
    return np.asarray(soft.scale_of(len(rms)) * np.maximum(shown / swing, soft.least_m))


def _of_joint(analysis: MotionAnalysis, j: int, runs: tuple[MonteCarlo, dict[str, MonteCarlo], Floats], sigma: float) -> AngleUncertainty:
    """One joint of all runs, see `run_by_source`."""
    joint, (total, alone, together) = analysis.angles[j], runs

    def about(estimate: Floats, which: int) -> dict[float, tuple[Floats, Floats]]:
        shift = estimate - total.estimate[j, which]
        return {p: (low[j, which] + shift, high[j, which] + shift) for p, (low, high) in total.intervals.items()}

    budgets = [{name: alone[name].standard[j, which] for name in SOURCES} | {"all": together[j, which]} for which in (0, 1)]
    cameras = alone["cameras"]
    check = replace(
        cameras,
        estimate=cameras.estimate[j, 0],
        standard=cameras.standard[j, 0],
        intervals={p: (low[j, 0], high[j, 0]) for p, (low, high) in cameras.intervals.items()},
    )
    order = first_order_angles(joint, analysis.motions[joint.parent], analysis.motions[joint.child], sigma, check)
    return AngleUncertainty(
        joint, joint.angle, about(joint.angle, 0), total.standard[j, 0], joint.flexion, about(joint.flexion, 1), total.standard[j, 1],
        budgets[1], budgets[0], order,
    )  # fmt: skip


def _findings(sources: ErrorSources, total: MonteCarlo, joints: tuple[AngleUncertainty, ...]) -> list[Finding]:
    findings = []
    if sources.calibration is None:
        sentence = "no covariance of the calibration was given: of the cameras only the noise of single points counts."
        mend = "Give the rig and its covariance, by --rig and --covariance."
        findings.append(Finding("motion-no-calibration", Severity.NOTE, "the cameras", sentence, mend))
    if not total.converged:
        sentence = f"{total.trials} trials do not fix a significant digit of every interval's ends."
        findings.append(Finding("motion-few-trials", Severity.NOTE, "the intervals", sentence, "Ask for more with --trials."))
    for one in joints:
        holds = one.first_order.holds
        holds = holds[np.isfinite(one.angle)] if holds is not None else None
        if holds is not None and not holds.mean() > 0.9:
            sentence = f"{one.joint.name}: first-order propagation does not hold in {100 * (1 - holds.mean()):.0f} % of the frames."
            findings.append(Finding("motion-not-linear", Severity.NOTE, one.joint.name, sentence, "Use the Monte Carlo intervals."))
    return findings
