"""Clinical angles and errors of their markers in; intervals of the angles, and a budget by source, out (GUM, Supplement 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from asterism.motion.clinical.angles import ClinicalAngles, ClinicalJoint
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names
from asterism.motion.clinical.measures import SIDES
from asterism.motion.uncertainty.monte_carlo import MonteCarloRules, run_by_source
from asterism.motion.uncertainty.sources import CalibrationErrors, CalibrationField, MeasurementNoise
from asterism.progress import Progress
from asterism.recording import Floats, Recording

SOURCES = ("cameras", "soft tissue", "placement")

TRIED_ON = (
    "Intervals are those of a model of errors, in which skin slides in proportion to the joints' flexion; they have not been tried on "
    "bones."
)
"""What stands beside intervals wherever they are shown."""
"""What makes clinical angles uncertain; each can be looked at alone."""

_BENT_BY = {"pelvis": ("hip",), "thigh": ("hip", "knee"), "shank": ("knee", "ankle"), "foot": ("ankle",)}
_OFFSET_OF = {"THI": "thigh_rotation", "TIB": "shank_rotation", "TOE": "foot_flexion"}
"""The measure that a static trial takes of a marker, see `LegMeasures`."""
_FULL_BEND = np.radians(60.0)


@dataclass(frozen=True)
class SkinMotion:
    """Markers on skin that slides over bone in step with the flexion of the joints beside it, the same in each stride.

    pelvis_m, thigh_m, shank_m, foot_m  m: standard deviation of a marker's displacement along each direction at 60 degrees of flexion, in
    proportion below and above. For the thigh half of the 18 mm of Uchida and Seth (2022); the others are less, as in the review by
    Leardini et al. (2005), who find most at the thigh. Set by hand
    """

    pelvis_m: float = 0.004
    thigh_m: float = 0.009
    shank_m: float = 0.005
    foot_m: float = 0.002

    def times(self, factor: float) -> SkinMotion:
        """Larger or smaller by a factor."""
        return SkinMotion(self.pelvis_m * factor, self.thigh_m * factor, self.shank_m * factor, self.foot_m * factor)

    def of(self, segment: str) -> float:
        """m, of "pelvis", "thigh", "shank" or "foot"."""
        return float(getattr(self, f"{segment}_m"))


@dataclass(frozen=True)
class ClinicalErrors:
    """The sources that count; None for one that does not.

    noise        of single points; its `root`, where it has one, is that of the recording at hand
    calibration  errors of the rig
    skin         see `SkinMotion`
    placement_m  m: standard deviation of a marker's place along each direction, the same in all frames. Between examiners 13 to 25 mm, of
                 one examiner 6 to 21 mm (Della Croce, Cappozzo and Kerrigan 1999)
    """

    noise: MeasurementNoise | None = None
    calibration: CalibrationErrors | None = None
    skin: SkinMotion | None = SkinMotion()
    placement_m: float | None = 0.010


@dataclass(frozen=True)
class JointUncertainty:
    """The angles of a joint, rad, in the order of `CLINICAL`; NaN where the angles are.

    standard   (T, 3) standard uncertainty
    intervals  {probability: (low, high)}, each (T, 3), the shortest, about the angles
    budget     {source: (T, 3)} standard uncertainty from each source alone, and of "all" together, in the same trials
    """

    joint: ClinicalJoint
    standard: Floats
    intervals: dict[float, tuple[Floats, Floats]]
    budget: dict[str, Floats]


@dataclass(frozen=True)
class ClinicalUncertainty:
    """The uncertainty of all joints, in their order; how many trials were made, and whether they were enough."""

    joints: tuple[JointUncertainty, ...]
    trials: int
    converged: bool


def clinical_uncertainty(
    recording: Recording,
    clinical: ClinicalAngles,
    errors: ClinicalErrors | None = None,
    *,
    seed: int = 0,
    workers: int = 1,
    rules: MonteCarloRules | None = None,
    budget_trials: int = 200,
    progress: Progress | None = None,
) -> ClinicalUncertainty:
    """The uncertainty of clinical angles by Monte Carlo: each trial displaces the markers and computes the angles again.

    recording  the one that `clinical` was computed from, with the measures of its file. A wand or a toe marker whose offset the file holds
               counts as well placed: the static trial that gave the offset had the same error, and took it off

    Displacements by skin and by placement are drawn in the axes of the marker's segment. Trial k has a generator of its own, so workers
    change nothing; each source draws the same alone as with the others. Raises AsterismError where a calibration does not fit.
    O(trials T).
    """
    if clinical.model.name == "plug-in-gait":
        recording = with_plug_in_gait_names(recording)
    errors = errors or ClinicalErrors()
    rules = rules or MonteCarloRules()
    legs = _Legs.of(recording, clinical, errors)
    options = {"seed": seed, "workers": workers, "rules": rules, "progress": progress}
    total, alone, together = run_by_source(legs.trial, SOURCES, budget_trials, **options)
    standard = legs.by_joint(total.standard)
    ends = {p: tuple(legs.by_joint(end - total.estimate) for end in pair) for p, pair in total.intervals.items()}
    parts = {name: run.standard for name, run in alone.items()} | {"all": together}
    budgets = {name: legs.by_joint(part) for name, part in parts.items()}
    joints = tuple(
        JointUncertainty(
            joint,
            standard[number],
            {p: (joint.angles + low[number], joint.angles + high[number]) for p, (low, high) in ends.items()},
            {name: part[number] for name, part in budgets.items()},
        )
        for number, joint in enumerate(clinical.joints)
    )
    return ClinicalUncertainty(joints, total.trials, total.converged)


@dataclass(frozen=True)
class _Legs:
    """Everything that a trial needs: the markers in question, where their segments point, and how far the joints beside them are bent.

    columns  (K,) of the markers in the recording
    axes     (K, T, 3, 3) of each marker's segment; 0 where they are not known, so nothing is displaced there
    skin     (K,) m; courses (K, 2, T) share of 60 degrees of the joints beside the segment
    placed   (K,) m
    known    (J, T, 3) which angles are known
    """

    recording: Recording
    clinical: ClinicalAngles
    errors: ClinicalErrors
    columns: list[int]
    axes: Floats
    skin: Floats
    courses: Floats
    placed: Floats
    known: np.ndarray
    field: CalibrationField | None

    @classmethod
    def of(cls, recording: Recording, clinical: ClinicalAngles, errors: ClinicalErrors) -> _Legs:
        axes = {side: _axes_of(recording, side, clinical) for side in clinical.measures}
        bent = {joint.name: np.nan_to_num(joint.angles[:, 0]) / _FULL_BEND for joint in clinical.joints}
        still = np.zeros(len(recording))
        columns, turns, skin, courses, placed = [], [], [], [], []
        for column, (label, segment) in clinical.model.markers(recording).items():
            # The pelvis has no side; it takes the axes of any leg, which hold the same pelvis.
            side = SIDES.get(label[0], "") if label != "SACR" else ""
            side = side if side in axes else next(iter(axes))
            if segment != "pelvis" and SIDES.get(label[0]) != side:
                continue
            columns.append(column)
            turns.append(axes[side][segment])
            skin.append(errors.skin.of(segment) if errors.skin is not None else 0.0)
            bends = [bent.get(f"{side} {joint}", still) for joint in _BENT_BY[segment]]
            courses.append([*bends, still][:2])
            # A static trial took this marker's misplacement off, with the same markers on the skin.
            offset = _OFFSET_OF.get(label[1:]) if segment != "pelvis" else None
            placed.append(0.0 if offset in clinical.measures[side].from_file else errors.placement_m or 0.0)
        known = np.array([np.isfinite(joint.angles) for joint in clinical.joints])
        field = None if errors.calibration is None else errors.calibration.field(recording.positions)
        return cls(
            recording, clinical, errors, columns, np.array(turns), np.array(skin), np.array(courses), np.array(placed), known, field
        )  # fmt: skip

    def trial(self, active: tuple[str, ...]) -> Callable[[np.random.Generator], Floats]:
        """One trial with these sources: a function of its generator that gives the angles that are known, rad, one after another."""

        def run(rng: np.random.Generator) -> Floats:
            moved = replace(self.recording, positions=self._drawn(active, *rng.spawn(3)))
            letters = {name: letter for letter, name in SIDES.items()}
            outputs = self.clinical.model.outputs(moved, upper=False)
            joints = [outputs[f"{letters[joint.side]}{joint.joint.title()}Angles"] for joint in self.clinical.joints]
            # Differences, unrolled: an angle near half a turn must not jump by a whole one between trials.
            apart = np.array(joints) - np.array([joint.angles for joint in self.clinical.joints])
            return np.asarray((apart - 2 * np.pi * np.round(apart / (2 * np.pi)))[self.known])

        return run

    def _drawn(
        self, active: tuple[str, ...], of_cameras: np.random.Generator, of_skin: np.random.Generator, of_examiner: np.random.Generator
    ) -> Floats:
        """The points with the errors of one trial: (T, N, 3) m."""
        positions = self.recording.positions.copy()
        if "cameras" in active:
            if self.errors.noise is not None:
                positions += self.errors.noise.draw(positions.shape, of_cameras)
            if self.field is not None:
                positions += self.field.draw(of_cameras)
        count = len(self.columns)
        # In the axes of the segment: skin slides with the limb, not with the room.
        local = np.zeros((count, len(positions), 3))
        if "soft tissue" in active:
            along = of_skin.standard_normal((count, 2, 3)) * self.skin[:, None, None]
            local += np.einsum("kjt,kjx->ktx", self.courses, along)
        if "placement" in active:
            local += self.placed[:, None, None] * of_examiner.standard_normal((count, 1, 3))
        positions[:, self.columns] += np.einsum("ktxy,kty->tkx", self.axes, local)
        return positions

    def by_joint(self, values: Floats) -> list[Floats]:
        """What a trial gives, as (T, 3) of each joint, NaN where angles are not known."""
        out = np.full(self.known.shape, np.nan)
        out[self.known] = values
        return list(out)


def _axes_of(recording: Recording, side: str, clinical: ClinicalAngles) -> Mapping[str, Floats]:
    """The axes (T, 3, 3) of the segments of one side, 0 where they are not known; the foot's are the shank's."""
    letter = next(letter for letter, name in SIDES.items() if name == side)
    body = clinical.model.body(recording)
    leg = body.legs[letter]
    shank = np.nan_to_num(leg.shank)
    return {"pelvis": np.nan_to_num(body.pelvis), "thigh": np.nan_to_num(leg.thigh), "shank": shank, "foot": shank}
