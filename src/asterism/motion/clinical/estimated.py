"""A walk, and the measures of a person as far as they are known, in; the others as the walk shows them, and how certain, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from asterism.motion.clinical.measures import SubjectMeasures
from asterism.motion.clinical.plug_in_gait import Leg, along, angles_of, lower_body, marker_of
from asterism.recording import Floats, Recording
from asterism.recording.arrays import nan_median

Prior = tuple[float, float]
"""Mean and standard deviation."""


@dataclass(frozen=True)
class MeasurePriors:
    """What is expected of measures that nobody gave: mean and standard deviation. m and rad.

    Means and deviations are those of the legs of three people of three laboratories whose files hold measures and whose walks, where they
    walk, were looked at as here; deviations are larger by what so few people leave open (Student's t: 1.4 for six legs, 1.8 for four).
    Those of the mean rotations and of the radius are set by hand.

    leg           length, of the way from the anterior iliac spine by the knee's marker to the ankle's
    knee, ankle   widths, of the length of the leg
    trochanter    m, beyond the regression of Davis et al. (1991)
    radius        m, of the markers: those of 9.5 to 19 mm are usual
    thigh         rad, the wand's angle beyond that at which the knee's adduction varies least over the walk
    thigh_alone   rad, the wand's angle where the knee bends too little to tell it
    knee_turn, ankle_turn  rad, mean internal rotation of knee and ankle over the walk: they tell torsion and the shank's wand
    tilt          rad, of the ankle's axis
    sole          rad, of the foot's line against what heel and toe marker show, beside the choice between a flat and a sloped foot
    sole_alone    rad, of the foot's line, where no heel marker shows the sole
    sole_turn     rad, the same seen from above
    """

    leg: Prior = (1.007, 0.014)
    knee: Prior = (0.138, 0.028)
    ankle: Prior = (0.082, 0.020)
    trochanter: Prior = (0.0076, 0.009)
    radius: Prior = (0.007, 0.0015)
    thigh: Prior = (np.radians(6.7), np.radians(5.8))
    thigh_alone: Prior = (np.radians(-3.1), np.radians(11.5))
    knee_turn: Prior = (0.0, np.radians(6.0))
    ankle_turn: Prior = (0.0, np.radians(6.0))
    tilt: Prior = (np.radians(6.9), np.radians(8.2))
    sole: Prior = (0.0, np.radians(2.5))
    sole_alone: Prior = (np.radians(13.3), np.radians(10.5))
    sole_turn: Prior = (np.radians(1.5), np.radians(4.0))


_NEEDED = {
    "leg": "leg_length",
    "knee": "knee_width",
    "ankle": "ankle_width",
    "trochanter": "asis_trochanter",
    "thigh": "thigh_rotation",
    "ankle_turn": "shank_rotation",
    "knee_turn": "tibial_torsion",
    "tilt": "ankle_tilt",
    "sole": "foot_flexion",
    "sole_turn": "foot_rotation",
}
"""Which measure each prior stands for."""
_TRIED = np.radians(np.arange(-40.0, 41.0, 5.0))
"""rad: wand angles of the thigh that are tried."""
_BENT = 0.5
"""rad, from the 5th to the 95th percentile: a knee that bends less does not show its axis. At half, a person who stands seems to."""


_FEW = 10
"""Frames: fewer show no walk."""


@dataclass(frozen=True)
class WalkEstimator:
    """Estimates what `measures` do not hold (`LegMeasures.from_file`) from a recording of somebody who walks.

    recording  with some 100 frames: each estimate computes all angles some hundred times
    """

    recording: Recording
    measures: SubjectMeasures
    sides: str
    priors: MeasurePriors = MeasurePriors()

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """The priors that count: those of measures that a leg lacks; the radius where neither leg has a width."""
        lacking = [source for source, name in _NEEDED.items() if any(name not in self.measures.of(side).from_file for side in self.sides)]
        return (*lacking, *(["radius"] if {"knee", "ankle"} <= set(lacking) else []))

    def estimate(self, shifts: Mapping[str, float] | None = None) -> SubjectMeasures:
        """The measures with all that is lacking; `shifts` moves a prior by so many of its standard deviations. O(T)."""
        given = self.measures
        shift = {name: float((shifts or {}).get(name, 0.0)) for name in (*_NEEDED, "radius")}
        expected = {name: getattr(self.priors, name)[0] + shift[name] * getattr(self.priors, name)[1] for name in shift}
        if "radius" in self.sources:
            given = replace(given, marker_radius=expected["radius"])
        for side in self._shown:
            given = self._with_lengths(given, side, expected)
        for side in self._shown:
            given = self._with_turns(given, side, expected, shift)
        return given

    @cached_property
    def _shown(self) -> list[str]:
        """Sides whose angles are known in `_FEW` frames or more; of others nothing can be told."""
        return [side for side in self.sides if np.isfinite(self._angles(self.measures, side, "Knee")).all(axis=1).sum() >= _FEW]

    def _see(self, side: str, names: Sequence[str]) -> bool:
        """Whether markers are seen together in `_FEW` frames or more."""
        columns = [self.recording.labels.index(side + name) for name in names if side + name in self.recording.labels]
        return len(columns) == len(names) and int(self.recording.visible[:, columns].all(axis=1).sum()) >= _FEW

    def _lacks(self, side: str, name: str) -> bool:
        return name not in self.measures.of(side).from_file

    def _with_lengths(self, given: SubjectMeasures, side: str, expected: Mapping[str, float]) -> SubjectMeasures:
        leg = given.of(side).leg_length
        length = leg if leg is not None and not self._lacks(side, "leg_length") else expected["leg"] * self._chains[side]
        values = {
            "leg_length": length,
            "knee_width": expected["knee"] * length,
            "ankle_width": expected["ankle"] * length,
            "asis_trochanter": 0.1288 * length - 0.04856 + expected["trochanter"],
            "ankle_tilt": expected["tilt"],
        }
        return self._with(given, side, values)

    def _with(self, given: SubjectMeasures, side: str, values: Mapping[str, float]) -> SubjectMeasures:
        lacking = {name: float(value) for name, value in values.items() if self._lacks(side, name)}
        return given.with_leg(side, given.of(side).with_values(lacking))

    def _with_turns(self, given: SubjectMeasures, side: str, expected: Mapping[str, float], shift: Mapping[str, float]) -> SubjectMeasures:
        if self._lacks(side, "thigh_rotation"):
            least = self._steadiest[side]
            alone = self.priors.thigh_alone[0] + shift["thigh"] * self.priors.thigh_alone[1]
            given = self._with(given, side, {"thigh_rotation": alone if least is None else least + expected["thigh"]})
        if self._lacks(side, "shank_rotation") and self._see(side, ["TOE"]):
            given = self._with(given, side, {"shank_rotation": self._shank_turn(given, side, expected["ankle_turn"])})
        if self._lacks(side, "tibial_torsion"):
            # The knee's rotation is the last of its turns, about the shank: torsion adds to it as it is.
            turned = float(np.nanmean(self._angles(given, side, "Knee")[:, 2]))
            torsion = given.of(side).tibial_torsion + turned - expected["knee_turn"]
            given = self._with(given, side, {"tibial_torsion": float(np.clip(torsion, -1.2, 1.2))})
        if not self._see(side, ["HEE", "TOE"]):
            alone = self.priors.sole_alone[0] + shift["sole"] * self.priors.sole_alone[1]
            return self._with(given, side, {"foot_flexion": alone, "foot_rotation": expected["sole_turn"]})
        flat, sloped, turn = self._sole(lower_body(self.recording, given, side).legs[side], side)
        either = float(np.hypot(self.priors.sole[1], (flat - sloped) / 2))
        values = {"foot_flexion": (flat + sloped) / 2 + shift["sole"] * either, "foot_rotation": turn + expected["sole_turn"]}
        return self._with(given, side, values)

    def _angles(self, given: SubjectMeasures, side: str, joint: str) -> Floats:
        return angles_of(self.recording, lower_body(self.recording, given, side))[f"{side}{joint}Angles"]

    @cached_property
    def _chains(self) -> dict[str, float]:
        """m, from the anterior iliac spine by the knee's marker to the ankle's."""
        marker = marker_of(self.recording)
        ways = {
            side: [np.linalg.norm(marker(side + one) - marker(side + other), axis=1) for one, other in (("ASI", "KNE"), ("KNE", "ANK"))]
            for side in self._shown
        }
        return {side: float(sum(nan_median(way, axis=0) for way in pair)) for side, pair in ways.items()}

    @cached_property
    def _steadiest(self) -> dict[str, float | None]:
        """rad: the wand angle of each thigh at which the knee's adduction varies least (as Baker, Finney and Orr 1999 turn it); None where
        the knee does not bend enough, or no angle that is tried is best."""
        given, found = self.measures, dict[str, float | None]()
        for side in self._shown:
            given = self._with_lengths(given, side, {name: getattr(self.priors, name)[0] for name in _NEEDED})
        for side in self._shown:
            flexion = self._angles(given, side, "Knee")[:, 0]
            found[side] = None
            if np.nanpercentile(flexion, 95) - np.nanpercentile(flexion, 5) < _BENT:
                continue
            turned = [given.with_leg(side, given.of(side).with_values({"thigh_rotation": turn})) for turn in _TRIED.tolist()]
            varies = np.array([np.nanvar(self._angles(one, side, "Knee")[:, 1]) for one in turned])
            place = int(np.argmin(varies))
            if 0 < place < len(_TRIED) - 1:
                bend, slope, _ = np.polyfit(_TRIED[place - 1 : place + 2], varies[place - 1 : place + 2], 2)
                found[side] = float(-slope / (2 * bend))
        return found

    def _shank_turn(self, given: SubjectMeasures, side: str, wanted: float) -> float:
        """rad: the wand angle of the shank with which the ankle's mean rotation is what is wanted, by the secant method."""
        turn, before = 0.0, (0.0, 0.0)
        for step in range(4):
            one = given.with_leg(side, given.of(side).with_values({"shank_rotation": turn}))
            rotation = self._angles(one, side, "Ankle")[:, 2]
            if not np.isfinite(rotation).any():  # the toe is not seen with the leg
                return 0.0
            off = float(np.nanmean(rotation)) - wanted
            slope = (off - before[1]) / (turn - before[0]) if step and turn != before[0] else -1.0
            before = (turn, off)
            turn = float(np.clip(turn - off / (slope if abs(slope) > 0.2 else -1.0), -1.2, 1.2))
        return turn

    def _sole(self, leg: Leg, side: str) -> tuple[float, float, float]:
        """rad: the foot's line against the sole, by heel and toe marker as high as they are when they stand, and by a level sole; and the
        line's turn against them, seen from above."""
        marker, outwards = marker_of(self.recording), 1.0 if side == "L" else -1.0
        heel, toe = marker(f"{side}HEE"), marker(f"{side}TOE")
        axes = along(leg.ankle - toe, leg.shank[:, :, 1])
        seen = np.einsum("tji,tj->ti", axes, heel - toe)
        line = -float(nan_median(np.arctan2(seen[:, 0], seen[:, 2]), axis=0))
        long = float(nan_median(np.linalg.norm(heel - toe, axis=1), axis=0))
        higher = float(np.nanpercentile(heel[:, 2], 8) - np.nanpercentile(toe[:, 2], 8))
        turn = outwards * float(nan_median(np.arctan2(seen[:, 1], seen[:, 2]), axis=0))
        return line, line + float(np.arctan2(higher, long)), turn
