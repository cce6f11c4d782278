"""The models of the lower body by one name each: a recording in; its segments and its angles out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.motion.clinical._kernels import any_known
from asterism.motion.clinical.hip import REGRESSIONS, regression_of
from asterism.motion.clinical.landmark_body import (
    StandingTrial,
    landmark_angles,
    landmark_body,
    landmarks_displaced,
    segment_of,
    with_plug_in_gait_names,
    worn_landmarks,
)
from asterism.motion.clinical.measures import SIDES, SubjectMeasures
from asterism.motion.clinical.plug_in_gait import LowerBody, angles_of, lower_body, thorax_axes, walking_axes
from asterism.motion.clinical.upper_body import upper_body_angles
from asterism.recording import Floats, Recording

MODELS = ("plug-in-gait", "landmarks")
"""The models by name: wands and measures of the person; both sides of knee and ankle, see `landmark_body`."""
_LEG = ("KNE", "TIB", "ANK")
"""Markers of Plug-in-Gait without which a leg still has a hip: LTHI and LKNE tell the thigh; the others the shank."""
_ON = {"ASI": "pelvis", "PSI": "pelvis", "THI": "thigh", "KNE": "thigh", "TIB": "shank", "ANK": "shank", "TOE": "foot"}
_SEGMENT_OF = {"SACR": "pelvis", **{side + name: segment for side in SIDES for name, segment in _ON.items()}}
"""Of Plug-in-Gait's markers."""
_STANDING = 20
"""Frames of a standing trial that are enough to see what a marker does."""
_MEDIAL = ("LE", "ME", "LM", "MM")


@dataclass(frozen=True)
class ClinicalModel:
    """How a lower body is made of markers.

    name      one of `MODELS`; measures of the person; sides of Plug-in-Gait's legs, "L", "R" or "LR"
    static    a standing trial, whose medial markers the landmarks' model carries over; None without one
    """

    name: str = "plug-in-gait"
    measures: SubjectMeasures = field(default_factory=SubjectMeasures)
    sides: str = "LR"
    static: Recording | None = None

    @property
    def hip(self) -> str:
        """Whose regression tells the hip centres: "Davis et al. (1991)"."""
        return REGRESSIONS[regression_of(self.measures, davis=self.name == "plug-in-gait")]

    def title(self, recording: Recording) -> str:
        """Whose definitions these are, in words."""
        made = landmark_body(recording, self.measures, self.static) if self.name == "landmarks" else None
        return "Plug-in-Gait" if made is None else made.title

    def body(self, recording: Recording) -> LowerBody:
        """Joint centres and segments, NaN where a marker is missing. Raises AsterismError where the pelvis has no markers."""
        if self.name == "plug-in-gait":
            return self._by_wands(with_plug_in_gait_names(recording))
        made = landmark_body(recording, self.measures, self.static)
        if made is None:
            raise AsterismError(f"{recording.metadata.get('file', 'the recording')} has no markers on both anterior iliac spines.")
        return replace(made.body, legs={side: leg for side, leg in made.body.legs.items() if side in self.sides})

    def _by_wands(self, named: Recording) -> LowerBody:
        """The body by the markers that have Plug-in-Gait's names."""
        return lower_body(with_leg_markers(named, self.sides), self.measures, self.sides)

    def outputs(
        self, recording: Recording, *, upper: bool = True, room: Floats | None = None, static: StandingTrial | None = None
    ) -> dict[str, Floats]:
        """Angles (T, 3) rad by Plug-in-Gait's names, see `ClinicalAngles.outputs`; without those that are known in no frame.

        upper  also those of head and arms; room  (3, 3), in whose axes pelvis, feet, thorax and head turn; by default `walking_axes`
        static  the standing trial as `standing_trial` made it, for who asks again and again
        """
        named = with_plug_in_gait_names(recording)
        thorax = thorax_axes(named) if upper or self.name == "plug-in-gait" else None
        if self.name == "plug-in-gait":
            body = self._by_wands(named)
            room = walking_axes(body) if room is None else room
            found = angles_of(named, body, room, thorax)
        else:
            made = landmark_body(recording, self.measures, static or self.static)
            if made is None:
                return {}
            body = made.body
            room = walking_axes(body) if room is None else room
            found = landmark_angles(made, room)
        if upper:
            found |= upper_body_angles(named, self.measures, room, thorax)
        return {name: angles for name, angles in found.items() if any_known(angles)}

    def carries(self, recording: Recording) -> bool:
        """Whether a landmark comes from the standing trial alone."""
        made = landmark_body(recording, self.measures, self.static) if self.name == "landmarks" else None
        return made is not None and bool(made.carried or made.clusters)

    def markers(self, recording: Recording) -> dict[int, tuple[str, str]]:
        """Column -> name and segment ("pelvis", "thigh", "shank", "foot") of each marker that the recording's angles come from."""
        if self.name == "plug-in-gait":
            named = enumerate(with_plug_in_gait_names(recording).labels)
            return {column: (name, _SEGMENT_OF[name]) for column, name in named if name in _SEGMENT_OF}
        return {column: (role, segment_of(role)) for role, column in worn_landmarks(recording).roles.items()}

    def placed_anew(self, recording: Recording, step: float) -> Iterator[dict[str, Floats]]:
        """The outputs with one landmark after the other `step` m along each axis of its segment, in the standing trial, too."""
        still = self.static
        if still is not None and len(still) > _STANDING:
            still = still.frames(np.unique(np.linspace(0, len(still) - 1, _STANDING).astype(int)))
        for moved, static in landmarks_displaced(recording, self.measures, still, step):
            yield replace(self, static=static).outputs(moved, upper=False)

    def with_feet_named(self, recording: Recording) -> Recording:
        """The recording whose heels and toes have Plug-in-Gait's names, by which inverse dynamics asks for them."""
        named = with_plug_in_gait_names(recording)
        roles, labels = worn_landmarks(recording).roles, list(named.labels)
        for side in SIDES:
            column = next((roles[side + role] for role in ("SM", "TOE", "FM", "VM") if side + role in roles), None)
            if column is not None and f"{side}TOE" not in labels:
                labels[column] = f"{side}TOE"
        return replace(named, labels=tuple(labels))


def wears_medial_markers(recording: Recording) -> bool:
    """Whether a recording itself shows the pelvis, and both sides of a knee and of its ankle."""
    return wears_both_sides(recording) and {"LASI", "RASI"} <= _shown(recording)


def wears_both_sides(recording: Recording) -> bool:
    """Whether a recording itself shows both sides of a knee and of its ankle."""
    shown = _shown(recording)
    return any(all(side + role in shown for role in _MEDIAL) for side in SIDES)


def _shown(recording: Recording) -> set[str]:
    seen = np.asarray(recording.visible.any(axis=0))
    return {role for role, column in worn_landmarks(recording).roles.items() if seen[column]}


def with_leg_markers(recording: Recording, sides: str) -> Recording:
    """The recording with a column for each marker of these legs, without a sample where the recording has none."""
    absent = [side + name for side in sides for name in _LEG if side + name not in recording.labels]
    if not absent:
        return recording
    empty = np.full((len(recording), len(absent), 3), np.nan)
    positions = np.concatenate([recording.positions, empty], axis=1)
    return replace(recording, positions=positions, labels=(*recording.labels, *absent), source=None, origin=None, taken=())
