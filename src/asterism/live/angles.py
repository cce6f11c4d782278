"""Labelled frames in, one after the other; the angles of the person's joints at once, out.

The models are those of recordings: Plug-in-Gait and landmarks of `motion.clinical` where the set has their markers, a skeleton of the
person by inverse kinematics else. Nothing is filtered, so nothing is late: a frame's angles are those that its own labels give.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.live._angle_kernels import nearer_triples
from asterism.motion.clinical import ClinicalAngles, ClinicalModel, SubjectMeasures, clinical_angles, complete_legs
from asterism.motion.clinical.landmark_body import standing_trial, with_plug_in_gait_names, worn_landmarks
from asterism.motion.joints.anatomy import sacrum_markers
from asterism.recording import Floats, MarkerSet, Recording
from asterism.recording.arrays import nan_median
from asterism.skeleton import FollowedTree, fit_person

NAMES: Mapping[str, tuple[str, ...]] = {
    "Pelvis": ("pelvis tilt", "pelvis obliquity", "pelvis rotation"),
    "Hip": ("hip flexion", "hip adduction", "hip rotation"),
    "Knee": ("knee flexion", "knee adduction", "knee rotation"),
    "Ankle": ("ankle flexion", "ankle adduction", "ankle rotation"),
    "FootProgress": ("", "", "foot progression"),
    "Thorax": ("thorax tilt", "thorax obliquity", "thorax rotation"),
    "Spine": ("spine flexion", "spine bending", "spine rotation"),
    "Head": ("head tilt", "head bending", "head rotation"),
    "Neck": ("neck flexion", "neck bending", "neck rotation"),
    "Shoulder": ("shoulder flexion", "shoulder abduction", "shoulder rotation"),
    "Elbow": ("elbow flexion", "", ""),
    "Wrist": ("wrist flexion", "wrist deviation", "wrist rotation"),
}
"""What the three angles of Plug-in-Gait's names are called while they come, after "left" or "right"; "" for one that says nothing."""
_MIDDLE_ONES = ("Pelvis", "Thorax", "Spine", "Head", "Neck")
"""There is one of them: the left side's signs count."""
_BEGIN = (1.0, 3.0, 9.0)
"""s of frames that show the person, after which the angles' model is made, and made again where more of them can be known by then. With
half of it a person who comes in is half seen; with twice as much the first angles wait for nothing."""
_SKELETON_BEGIN = 3.0
"""s, the same for a skeleton, which is told by how joints move. At half, joints of people who begin to walk lie where they are usual."""
_MOST_FRAMES = 600
"""Frames that a model is made of at least, evenly spread, and twice as many at most: a skeleton takes 35 of them, the pelvis' size is a
median. At half the same; at double memory for nothing."""
_TURNED = np.radians(60.0)
"""By which a pelvis turns out of the room's axis along which its rotation counts, until that is the next one: 45 degrees lie between two.
At 45 a person who walks along a diagonal makes it jump with each step; at 90 a turn around is a rotation of a right angle for ever."""
_PAUSE = 0.5
"""s between two frames that are no pause: cameras of 2 images/s. At half, those of 3 have no angles; at double the same."""
_SHOWN = 0.5
"""Of the markers that were ever seen, in a frame that tells the model something. At half, people who step in count; at double, one hidden
marker spoils the second."""


def name_of(output: str, column: int) -> str:
    """What an angle of Plug-in-Gait's names is called while it comes; "" for one that is not given.

    >>> name_of("LKneeAngles", 0), name_of("RPelvisAngles", 0)
    ('left knee flexion', '')
    """
    part = output[1:].removesuffix("Angles")
    name = NAMES.get(part, ("", "", ""))[column]
    if part in _MIDDLE_ONES:
        return name if output[0] == "L" else ""
    return f"{'left' if output[0] == 'L' else 'right'} {name}" if name else ""


MeasuresOf = Callable[[Recording], tuple[SubjectMeasures | None, Sequence[Finding]]]
"""The measures of the person whose first frames these are; None for those that the frames show."""


@dataclass(frozen=True, eq=False)
class AngleOptions:
    """How live angles are computed.

    static    a standing trial of the person; model  of the legs, see `clinical_angles`; measures  of the person
    vertical  (3,) what points up in the frames
    waits     whether the frame at which a model is made waits for it: a file can. A camera's frames go on meanwhile, without angles
    """

    static: Recording | None = None
    model: str | None = None
    measures: MeasuresOf | None = None
    vertical: Floats | None = None
    waits: bool = False


class _FrameAngles(Protocol):
    """Angles by one model of the person, frame by frame."""

    @property
    def names(self) -> tuple[str, ...]:
        """What is told."""

    @property
    def findings(self) -> Sequence[Finding]:
        """What a person should know of the model."""

    def push(self, points: Floats) -> Floats:
        """(N,) degrees, by the markers (M, 3) m; NaN where some are missing."""


class LiveAngles:
    """Angles of a person, frame by frame: about half a millisecond for a whole body.

    The model is made of the first second of frames that show the person, as off-line of a recording, and the pelvis measured anew of nine.
    Until the first second is over no angle is known. Bounded memory.
    """

    def __init__(self, options: AngleOptions | None = None) -> None:
        self._options = options or AngleOptions()
        self._markers: tuple[str, ...] = ()
        self._first: list[Floats] = []
        self._seen = np.zeros(0, dtype=np.bool_)
        self._seconds, self._before, self._tries = 0.0, float("nan"), 0
        self._made: _FrameAngles | None = None
        self._making: threading.Thread | None = None
        self._refusal = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the angles, all in degrees; () while no model is made."""
        return () if self._made is None else self._made.names

    @property
    def are_awaited(self) -> bool:
        """Whether no model is made yet, and the first three seconds may still tell one."""
        return self._made is None and (self._tries < 2 or (self._making is not None and self._making.is_alive()))

    def findings(self) -> list[Finding]:
        """What a person should know of the angles."""
        if self._made is not None:
            return list(self._made.findings)
        if not self._refusal:
            return []
        mend = "Wear a set that the models know (docs/motion.md), or leave angles out with --no-analysis."
        return [Finding("live-no-angles", Severity.NOTE, "angles", f"No angles were given: {self._refusal}", mend)]

    def push(self, time: float, markers: tuple[str, ...], points: Floats) -> dict[str, float]:
        """Degrees of each angle, by the markers (M, 3) m of a frame at `time` s; NaN where one is missing, {} while no model is made."""
        if markers != self._markers:
            self._begin_with(markers)
        if self._tries < len(_BEGIN) and len(markers):
            self._collect(time, points)
        # Read once: another thread may have made one meanwhile.
        made = self._made
        return {} if made is None else dict(zip(made.names, made.push(points).tolist(), strict=True))

    def _begin_with(self, markers: tuple[str, ...]) -> None:
        """Another set of markers is another person."""
        self._markers, self._seen = markers, np.zeros(len(markers), dtype=np.bool_)
        self._first, self._seconds, self._before, self._tries, self._made = [], 0.0, float("nan"), 0, None

    def _collect(self, time: float, points: Floats) -> None:
        shown = np.isfinite(points[:, 0])
        self._seen |= shown
        step, self._before = time - self._before, time
        if shown.sum() < max(3, _SHOWN * self._seen.sum()):
            return
        # A pause is no second of frames.
        self._seconds += step if 0.0 < step < _PAUSE else 0.0
        self._first.append(points)
        if len(self._first) >= 2 * _MOST_FRAMES:
            self._first = self._first[::2]
        if self._seconds < _BEGIN[self._tries] or (self._making is not None and self._making.is_alive()):
            return
        self._tries += 1
        positions = np.array(self._first)
        rate = max(len(positions) / self._seconds, 1.0)
        vertical = np.array([0.0, 0.0, 1.0]) if self._options.vertical is None else self._options.vertical
        recording = Recording(positions, self._markers, rate, vertical=vertical, metadata={"file": "the session"})
        if self._options.waits:
            self._make(recording)
        else:
            self._making = threading.Thread(target=self._make, args=(recording,), name="live angles")
            self._making.start()
        if self._tries == len(_BEGIN):
            self._first = []

    def _make(self, recording: Recording) -> None:
        """Take a model that knows as much as the one before: a clinical one, whose sizes more frames tell better; a skeleton stays."""
        try:
            made = _frame_angles(recording, self._options, self._seconds)
        except Exception as problem:  # a body that no model can be made of must not end the labels
            self._refusal = str(problem)
            return
        # A skeleton that is fitted anew would turn all angles by some degrees.
        least = len(self.names) + isinstance(self._made, _SkeletonFrames)
        if recording.labels == self._markers and len(made.names) >= least:
            self._made = made


def _frame_angles(recording: Recording, options: AngleOptions, seconds: float) -> _FrameAngles:
    """The model of the person's first frames. Raises AsterismError where there is none yet."""
    measures, told = (None, ()) if options.measures is None else options.measures(recording)
    try:
        found = clinical_angles(recording, measures=measures, static=options.static, model=options.model)
    except AsterismError:
        if options.model is not None:
            raise
        return _by_skeleton(recording, options, seconds)
    legs = found.joints and (found.model.name == "landmarks" or complete_legs(recording))
    if not legs and options.model is None:
        return _by_skeleton(recording, options, seconds)
    return _ClinicalFrames(recording, replace(found, findings=(*told, *found.findings)), options.static is None and measures is None)


def _by_skeleton(recording: Recording, options: AngleOptions, seconds: float) -> _FrameAngles:
    if options.static is None and seconds < _SKELETON_BEGIN:
        raise AsterismError(f"a skeleton needs {_SKELETON_BEGIN:g} s of frames that show the person.")
    return _SkeletonFrames(recording, options.static)


class _ClinicalFrames:
    """Angles by Plug-in-Gait or by landmarks."""

    def __init__(self, first: Recording, found: ClinicalAngles, estimated: bool) -> None:
        self._labels, self._rate, self._up = first.labels, first.rate, first.vertical
        # A model asks which markers are worn: a frame that shows all of them stands before each one.
        self._worn = rotate_z_up(np.asarray(nan_median(first.positions, axis=0)), self._up)
        self._model = _fixed(found.model, first)
        given = self._model.static if self._model.name == "landmarks" else None
        self._static = None if given is None else standing_trial(given, self._model.measures)
        self._room = np.eye(3)
        self._outputs = tuple(name for name in found.outputs if any(name_of(name, column) for column in range(3)))
        named = [name_of(name, column) for name in self._outputs for column in range(3)]
        self._told = np.array([bool(name) for name in named], dtype=np.bool_)
        self.names = tuple(name for name in named if name)
        self._pelvis = self._outputs.index("LPelvisAngles") if "LPelvisAngles" in self._outputs else -1
        self._middle = np.array([_middle_turn(name, self._model.name) for name in self._outputs])
        self._last = np.full((len(self._outputs), 3), np.nan)
        # Compiled before the first frame, which must not wait for it.
        nearer_triples(np.zeros_like(self._last), self._middle, self._last)
        self._last[:] = np.nan
        # A recording's gaps could be filled; here only what is worn and labelled helps.
        mend = "Look whether these markers are worn and labelled; medial ones may be in the standing trial (--static) alone."
        self.findings = [
            replace(one, severity=Severity.NOTE, mend=mend) if one.code == "clinical-left-out" else one
            for one in found.findings
            if not (estimated and one.code == "clinical-measures")
        ]
        if estimated:
            sentence = "No standing trial: the pelvis is as wide as the first seconds show it, knees, ankles and arms are an adult's."
            mend = "Give the person's standing trial with --static, or measures with --measure."
            self.findings.append(Finding("live-angles-estimated", Severity.NOTE, "angles", sentence, mend))

    def push(self, points: Floats) -> Floats:
        """See `_FrameAngles.push`."""
        # Turned once, which each part of the model would do for itself.
        recording = Recording(np.array([self._worn, rotate_z_up(points, self._up)]), self._labels, self._rate)
        found = self._radians(recording)
        rotation = found[self._pelvis, 2] if self._pelvis >= 0 else np.nan
        if abs(rotation) > _TURNED:
            # The left side's rotation is positive to the right.
            steps = round(-rotation / (np.pi / 2))
            self._room = self._room @ np.linalg.matrix_power(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), steps % 4)
            found = self._radians(recording)
        return np.degrees(self._steady(found)).ravel()[self._told]

    def _radians(self, recording: Recording) -> Floats:
        outputs = self._model.outputs(recording, room=self._room, static=self._static)
        missing = np.full((2, 3), np.nan)
        return np.array([outputs.get(name, missing)[1] for name in self._outputs])

    def _steady(self, found: Floats) -> Floats:
        """Of the two triples of turns that make one rotation the one nearer to the frame before, as `turns` of a recording chooses."""
        nearer_triples(found, self._middle, self._last)
        return found


def _middle_turn(name: str, model: str) -> int:
    """Which of the three angles is the turn about the middle axis, half a turn from which the other triple has it; -1 for a hinge."""
    part = name[1:].removesuffix("Angles")
    if part == "Elbow":
        return -1
    if part == "Shoulder":
        return 0
    return 2 if part in ("Ankle", "FootProgress") and model == "plug-in-gait" else 1


def _fixed(model: ClinicalModel, first: Recording) -> ClinicalModel:
    """The model with the sizes of the pelvis as the first frames show them, which a recording's medians tell off-line."""
    named, up = with_plug_in_gait_names(first), rotate_z_up(first.positions, first.vertical)
    places = dict(worn_landmarks(first).roles) | {name: column for column, name in enumerate(named.labels)}
    if not {"LASI", "RASI"} <= places.keys():
        return model
    left, right = up[:, places["LASI"]], up[:, places["RASI"]]
    measures = model.measures
    if measures.inter_asis is None:
        measures = replace(measures, inter_asis=float(nan_median(np.linalg.norm(left - right, axis=1), axis=0)))
    back = [places[name] for name in sacrum_markers(named) if name in places]
    if back:
        depth = np.linalg.norm((left + right) / 2 - up[:, back].mean(axis=1), axis=1)
        measures = replace(measures, pelvis_depth=float(nan_median(depth, axis=0)))
    return replace(model, measures=measures)


class _SkeletonFrames:
    """Angles by inverse kinematics of a skeleton that is fitted to the person."""

    def __init__(self, first: Recording, static: Recording | None) -> None:
        person = fit_person([] if static is None else [static], [first])
        tree = person.tree
        self.names, self.findings = tuple(one.name for one in tree.coordinates), person.findings
        self._columns = MarkerSet(tree.labels).columns_of(first.labels)
        self._up, self._followed = first.vertical, FollowedTree(tree)
        some = first.positions[:: max(len(first) // 50, 1)]
        self._followed.learn(rotate_z_up(some, first.vertical)[:, self._columns])

    def push(self, points: Floats) -> Floats:
        """See `_FrameAngles.push`."""
        return np.degrees(self._followed.push(rotate_z_up(points[self._columns], self._up)))
