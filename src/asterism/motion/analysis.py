"""A recording in; its limbs, their motion, the skeleton and the angles of its joints out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.files.text import some_of
from asterism.findings import Finding, Severity
from asterism.motion.joints.angles import functional_flexion, joint_rotation
from asterism.motion.joints.skeleton import Skeleton, find_skeleton
from asterism.motion.rigid.limb import LimbMotion, LimbRules, estimate_limb_motion
from asterism.motion.rigid.rotations import rotation_vectors
from asterism.motion.segmentation.limbs import Segmentation, SegmentationRules, segment_limbs
from asterism.progress import Progress
from asterism.recording import Floats, Ints, Recording

OFTEN_MISSING = 0.5
"""Share of the frames in which a point is missing: from here on it is named."""
STILL = np.radians(5.0)
"""rad: a joint that never turns farther is named."""


@dataclass(frozen=True)
class MotionRules:
    """How a recording's motion is analysed: `method` of `estimate_limb_motion`, and the rules of each step."""

    method: str = "robust"
    joint_method: str = "score"
    limb: LimbRules = field(default_factory=LimbRules)
    segmentation: SegmentationRules = field(default_factory=SegmentationRules)


@dataclass(frozen=True)
class JointAngles:
    """A joint's angles over time.

    parent, child  numbers of limbs; name "limb 1 / limb 2"
    vectors        (T, 3) rad, rotation vector of the child in the parent's axes since frame `zero` (GaMoCap eq. 5, its order corrected)
    flexion        (T,) rad, the turn about the joint's main axis, from its mean
    axis           (3,) that axis in the parent's axes
    zero           the frame from which the rotation vectors count: the first in which both limbs are known
    """

    parent: int
    child: int
    name: str
    vectors: Floats
    flexion: Floats
    axis: Floats
    zero: int

    @property
    def angle(self) -> Floats:
        """(T,) rad, 0 to pi: how far the joint has turned since frame `zero`, which is what GaMoCap compares."""
        return np.asarray(np.linalg.norm(self.vectors, axis=1))

    @property
    def directions(self) -> Floats:
        """(T, 3) the axes about which the joint has turned since frame `zero`; its main axis where that is less than 0.06 degrees."""
        angle = self.angle[:, None]
        return np.where(angle > 1e-3, self.vectors / np.maximum(angle, 1e-12), self.axis)


@dataclass(frozen=True)
class MotionAnalysis:
    """What moved how.

    recording  as it was given, with the analysis in its processing log
    limb_of    (N,) int, the limb of each point, -1 for none; names (L,) of the limbs
    motions    (L,) of the limbs; skeleton, how they are joined; angles of each joint, from the root outwards
    centres    (J, T, 3) m of the joints, as `angles`
    segmentation  how the limbs were found; None where they were given
    findings   what to know before using the result
    """

    recording: Recording
    limb_of: Ints
    names: tuple[str, ...]
    motions: tuple[LimbMotion, ...]
    skeleton: Skeleton
    angles: tuple[JointAngles, ...]
    centres: Floats
    segmentation: Segmentation | None
    findings: tuple[Finding, ...]


def analyse_motion(
    recording: Recording,
    limbs: Mapping[str, Sequence[str]] | int | None = None,
    *,
    rules: MotionRules | None = None,
    progress: Progress | None = None,
) -> MotionAnalysis:
    """Limbs, their motion, joints and angles of a recording of points, garment or markers (GaMoCap chapter 3).

    limbs  which markers are on which limb, such as `MarkerSet.segments`; or how many limbs there are; or None to find them all

    A limb that never shows three points at once that are not in a line is left out, with a finding, where two or more others remain.
    Angles are NaN in frames that do not show both limbs.
    Raises AsterismError where a marker is absent, a limb is given fewer than three, no limb is found, or fewer than two limbs remain.
    For costs see `segment_limbs` and `estimate_limb_motion`.

    >>> from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue
    >>> knee = simulate_soft_tissue(TrialPlan("knee", points=40, frames=30), seed=1).recording
    >>> analysis = analyse_motion(knee, limbs=2)
    >>> [joint.name for joint in analysis.angles]
    ['limb 1 / limb 2']
    >>> bool(90 < np.degrees(analysis.angles[0].angle.max()) < 100)
    True
    """
    rules = rules or MotionRules()
    segmentation = None
    # Limbs that are given are not questioned: a person knows which marker they put where.
    if isinstance(limbs, Mapping):
        names, limb_of = _given_limbs(recording, limbs)
    else:
        segmentation = segment_limbs(recording.positions, limbs, rules=rules.segmentation, progress=progress)
        limb_of, names = segmentation.limb_of, tuple(f"limb {i + 1}" for i in range(segmentation.limbs))
    file = str(recording.metadata.get("file", "recording"))
    fewer = [] if segmentation is None or isinstance(limbs, Mapping) else segmentation.fewer_than(limbs, file)
    motions, kept, left_out, problems = [], [], [], []
    # One limb that cannot be told must not cost the angles of the others.
    for limb, name in enumerate(names):
        points_of_limb = recording.positions[:, limb_of == limb]
        try:
            motions.append(estimate_limb_motion(points_of_limb, rules.method, rules=rules.limb))
            kept.append(limb)
        except AsterismError as error:
            problems.append(f"{file}, {name}: {error}")
            if points_of_limb.shape[1] < 3:
                raise AsterismError(problems[-1]) from None
            left_out.append(_left_out(name, str(error)))
        if progress is not None:
            progress((limb + 1) / len(names), "following limbs")
    if problems and len(kept) < 2:  # one limb alone has no joint, so there is no angle to give in spite of the other
        raise AsterismError(problems[0])
    # Numbers without holes, so that a limb has the same number in all results.
    limb_of = np.array([kept.index(limb) if limb in kept else -1 for limb in limb_of])
    names = tuple(names[limb] for limb in kept)
    points = [recording.positions[:, limb_of == limb] for limb in range(len(names))]
    # Joints from the motion, not from the names: it works for garments and unnamed points alike.
    skeleton = find_skeleton(motions, points, method=rules.joint_method)
    angles = tuple(joint_angles(motions[a], motions[b], (a, b), f"{names[a]} / {names[b]}") for a, b in skeleton.pairs)
    joints = [skeleton.joints[child] for _, child in skeleton.pairs]
    centres = np.array([joint.centres(motions[a], motions[b]) for (a, b), joint in zip(skeleton.pairs, joints, strict=True) if joint])
    findings = (*fewer, *left_out, *_findings(recording, limb_of, angles), *_apart(names, skeleton))
    # The log says what made the angles, in the file that keeps them.
    logged = recording.logged("motion estimated", "asterism", method=rules.method, joints=rules.joint_method, limbs=len(names))
    return MotionAnalysis(
        logged, limb_of, names, tuple(motions), skeleton, angles, centres.reshape(len(angles), len(recording), 3), segmentation, findings
    )


def joint_angles(parent: LimbMotion, child: LimbMotion, pair: tuple[int, int] = (0, 1), name: str = "") -> JointAngles:
    """The angles of the joint between two limbs. Raises AsterismError where they are never known in one frame."""
    turned = joint_rotation(parent.rotations, child.rotations)
    present = np.nonzero(np.isfinite(turned[:, 0, 0]))[0]
    if not len(present):
        raise AsterismError(f"{name or 'the joint'}: its two limbs are never known in one frame.")
    # Angles count from the first common frame: before it there is nothing to compare with.
    zero = int(present[0])
    since = joint_rotation(parent.rotations, child.rotations, zero=zero)
    # The flexion is about the mean pose, not about frame zero: it does not change when the first frame is hidden.
    flexion, axis = functional_flexion(turned)
    return JointAngles(*pair, name, rotation_vectors(since), flexion, axis, zero)


def _given_limbs(recording: Recording, limbs: Mapping[str, Sequence[str]]) -> tuple[tuple[str, ...], Ints]:
    limb_of, taken = np.full(len(recording.labels), -1), dict[str, str]()
    file = recording.metadata.get("file", "the recording")
    for number, (name, markers) in enumerate(limbs.items()):
        for marker in markers:
            if marker not in recording.labels:
                raise AsterismError(f"{file} has no marker {marker}, which the limb {name} names; correct the limb's list.")
            # A marker on two limbs would tie them together and hide their joint.
            if marker in taken:
                raise AsterismError(f"the marker {marker} is on two limbs, {taken[marker]} and {name}; give it to one.")
            taken[marker] = name
            limb_of[recording.labels.index(marker)] = number
    if not limbs:
        raise AsterismError("no limb was named; name the markers of one or more, or let them be found.")
    return tuple(limbs), limb_of


def _left_out(name: str, why: str) -> Finding:
    sentence = f"{name} is left out: {why}"
    return Finding("motion-limb-left-out", Severity.WARNING, name, sentence, "Fill the gaps of its markers, or leave it out of the limbs.")


def _apart(names: Sequence[str], skeleton: Skeleton) -> list[Finding]:
    """A finding for each limb without a joint, where there are others."""
    joined = {limb for pair in skeleton.pairs for limb in pair}
    alone = [name for limb, name in enumerate(names) if limb not in joined]
    said, mend = "is seen with no other limb in three frames, so it has no joint.", "Record or fill frames that show it with its neighbour."
    return [Finding("motion-limb-alone", Severity.WARNING, name, f"{name} {said}", mend) for name in alone if len(names) > 1]


def _findings(recording: Recording, limb_of: Ints, angles: Sequence[JointAngles]) -> list[Finding]:
    findings = []
    # Only points that are on a limb: the others do not touch the result.
    share = 1 - recording.visible.mean(axis=0)
    often = [label for label, missing, limb in zip(recording.labels, share, limb_of, strict=True) if missing > OFTEN_MISSING and limb >= 0]
    if often:
        sentence = f"{len(often)} points are missing in more than half of the frames ({some_of(often, 6)}); they count where they are seen."
        mend = "Fill or record them anew if a limb has few."
        findings.append(Finding("motion-points-missing", Severity.NOTE, "the points", sentence, mend))
    unseen = [label for label, limb in zip(recording.labels, limb_of, strict=True) if limb < 0 and label]
    if unseen:
        sentence = f"{len(unseen)} points belong to no limb ({some_of(unseen, 6)})."
        findings.append(Finding("motion-points-unused", Severity.NOTE, "the points", sentence))
    for joint in angles:
        # A joint that hardly turns has a centre and an axis all the same; they are noise.
        turned = float(np.nanmax(joint.angle))
        if turned < STILL:
            sentence = f"{joint.name} turns by {np.degrees(turned):.1f} degrees at most, which tells neither a centre nor an axis."
            mend = "Record a movement in which the joint turns."
            findings.append(Finding("motion-joint-still", Severity.WARNING, joint.name, sentence, mend))
    return findings
