"""A walk, and the measures of a person as far as they are known, in; the others as the walk shows them, and how certain, out.

Each measure that nobody gave has a wide prior. What people's walks have in common says more: how far the knee's adduction follows its
flexion, and the mean rotations of hip, knee and ankle. Both are put together as Kalman's filter does, to first order, about the estimate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from asterism.motion.clinical.measures import SubjectMeasures
from asterism.motion.clinical.plug_in_gait import LowerBody, angles_of, lower_body, marker_of, turned_foot
from asterism.recording import Floats, Recording
from asterism.recording.arrays import nan_median

Prior = tuple[float, float]
"""Mean and standard deviation."""
Made = tuple[SubjectMeasures, LowerBody]
"""Measures, and the body that they make of the markers of pelvis and legs."""


@dataclass(frozen=True)
class MeasurePriors:
    """What is expected of measures that nobody gave: mean and standard deviation. m and rad.

    They are those of people of several laboratories, each person once, whose files hold the measure or who wear markers on both sides of
    the joint; larger by what n people leave open: by the root of 1 + 1/n, and by Student's t over that of a normal distribution. Half of
    one narrows the angles that hang on it by up to half, and people beside it are missed; double widens them.

    leg           length, of the way from the anterior iliac spine by the knee's marker to the ankle's (n = 4)
    knee, ankle   widths, of the length of the leg (n = 10, 11)
    trochanter    m, beyond the regression of Davis et al. (1991) (n = 4)
    radius        m, of the markers: those of 9.5 to 19 mm are usual
    thigh, shank  rad, the wands' angles: next to nothing is known of where somebody puts a wand
    torsion       rad, from the ankle's axis to the knee's (n = 5)
    tilt          rad, of the ankle's axis
    sole          rad, of the foot's line against what heel and toe marker show, beside the choice between a flat and a sloped foot (n = 3)
    sole_alone    rad, of the foot's line, where no heel marker shows the sole
    sole_turn     rad, the same seen from above (n = 4)
    head          rad, by which the head's markers look up: 15 degrees in both standing trials, give or take three, and none where nobody
                  takes it off
    arms          m, standard deviations about an adult's measures (`ArmMeasures`), by hand: files of two people differ by as much
    """

    leg: Prior = (1.002, 0.033)
    knee: Prior = (0.123, 0.025)
    ankle: Prior = (0.081, 0.010)
    trochanter: Prior = (0.0057, 0.012)
    radius: Prior = (0.007, 0.0015)
    thigh: Prior = (0.0, np.radians(20.0))
    shank: Prior = (0.0, np.radians(20.0))
    torsion: Prior = (np.radians(-18.0), np.radians(10.0))
    tilt: Prior = (np.radians(6.9), np.radians(8.2))
    sole: Prior = (0.0, np.radians(2.0))
    sole_alone: Prior = (np.radians(13.3), np.radians(10.5))
    sole_turn: Prior = (0.0, np.radians(2.9))
    head: Prior = (np.radians(7.5), np.radians(6.5))
    arms: Mapping[str, float] = field(
        default_factory=lambda: {"shoulder_offset": 0.012, "elbow_width": 0.015, "wrist_width": 0.02, "hand_thickness": 0.008}
    )


@dataclass(frozen=True)
class WalkPriors:
    """What is expected of the angles of a walk, rad, as programs give them that know the person's measures: mean and standard deviation.

    slope      of the knee's adduction over the sine of its flexion: what of the flexion an axis that is turned takes for adduction
    hip_turn   mean internal rotation; straight, the adduction of the straight knee; knee_turn, ankle_turn  mean internal rotations
    axis       standard deviation, error of the knee's axis, which slope and hip_turn have in common

    Of 83 children without complaints (Schwartz et al. 2008), and of five people of other laboratories (slope 6, sd 6; hip 6, sd 5; knee 0;
    ankle 0, sd 4), between whose means these lie. The axis is that of knee devices from session to session. Of people who turn their legs
    far in or out the estimate is drawn towards the usual by half of what they differ, and the band does not hold them at twice its width.
    """

    slope: Prior = (np.radians(2.0), np.radians(9.3))
    hip_turn: Prior = (np.radians(1.0), np.radians(9.6))
    straight: Prior = (np.radians(0.4), np.radians(3.5))
    knee_turn: Prior = (np.radians(2.0), np.radians(6.5))
    ankle_turn: Prior = (0.0, np.radians(6.0))
    axis: float = np.radians(6.0)

    @property
    def mean(self) -> Floats:
        """(5,) rad, in this order."""
        return np.array([one[0] for one in (self.slope, self.hip_turn, self.straight, self.knee_turn, self.ankle_turn)])

    @property
    def covariance(self) -> Floats:
        """(5, 5) rad2."""
        spread = np.diag([one[1] ** 2 for one in (self.slope, self.hip_turn, self.straight, self.knee_turn, self.ankle_turn)])
        spread[0, 1] = spread[1, 0] = self.axis**2
        return spread


_MEASURE_OF = {
    "leg": "leg_length",
    "knee": "knee_width",
    "ankle": "ankle_width",
    "trochanter": "asis_trochanter",
    "thigh": "thigh_rotation",
    "shank": "shank_rotation",
    "torsion": "tibial_torsion",
    "tilt": "ankle_tilt",
    "sole": "foot_flexion",
    "sole_turn": "foot_rotation",
}
"""Which measure each prior stands for."""
_BENT = 0.5
"""rad, from the 5th to the 95th percentile: a knee that bends less does not show its axis. At half, a person who stands seems to."""
_FEW = 10
"""Frames: fewer show no walk."""
_ROUNDS = 2
"""In which the estimate is made better: a third moves no band by a tenth of a degree, after one alone it is off by some degrees."""
_AHEAD = 0.5
"""Standard deviations by which a prior is moved to see what it does to a walk; half and double give the same to a tenth of a degree."""
_LEG = ("ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")


@dataclass(frozen=True)
class WalkEstimator:
    """Estimates what `measures` do not hold (`LegMeasures.from_file`) from a recording of somebody who walks.

    recording  with Plug-in-Gait's markers, z up, some fifty frames: the estimate computes all angles of the legs some fifty times
    """

    recording: Recording
    measures: SubjectMeasures
    sides: str
    priors: MeasurePriors = MeasurePriors()
    walks: WalkPriors = WalkPriors()

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """The priors that count: those of measures that a leg lacks; the radius where neither leg has a width."""
        lacking = [
            source for source, name in _MEASURE_OF.items() if any(name not in self.measures.of(side).from_file for side in self.sides)
        ]
        return (*lacking, *(["radius"] if {"knee", "ankle"} <= set(lacking) else []))

    def estimate(self) -> SubjectMeasures:
        """The measures with all that is lacking. O(T)."""
        return self._made({side: state for side, (state, _) in self._known.items()})[0]

    def apart(self) -> Iterator[tuple[Made, Made]]:
        """Pairs of measures with their bodies, a standard deviation to both sides of the estimate, along each of independent directions."""
        for column in range(len(self.sources)):
            ends = ({side: state + sign * root[:, column] for side, (state, root) in self._known.items()} for sign in (1.0, -1.0))
            one, other = (self._made(end) for end in ends)
            yield one, other

    def drawn(self, rng: np.random.Generator) -> SubjectMeasures:
        """Measures that may be the person's, drawn from what is known of them."""
        return self._made({side: state + root @ rng.standard_normal(len(state)) for side, (state, root) in self._known.items()})[0]

    @cached_property
    def _known(self) -> Mapping[str, tuple[Floats, Floats]]:
        """By side: what is known of `sources`, in standard deviations of their priors: estimate, and a root of its covariance."""
        count = len(self.sources)
        known = {side: (np.zeros(count), np.eye(count)) for side in self.shown}
        for _ in range(_ROUNDS if known else 0):
            state = {side: estimate for side, (estimate, _) in known.items()}
            middle = self._walk(state)
            moved = [self._walk({side: one + _AHEAD * np.eye(count)[place] for side, one in state.items()}) for place in range(count)]
            for side, estimate in state.items():
                slopes = np.array([one[side] - middle[side] for one in moved]).T / _AHEAD
                told = np.isfinite(middle[side]) & np.isfinite(slopes).all(axis=1)
                slopes, noise = slopes[told], self.walks.covariance[np.ix_(told, told)]
                gain = slopes.T @ np.linalg.inv(slopes @ slopes.T + noise)
                better = gain @ ((self.walks.mean - middle[side])[told] + slopes @ estimate)
                variance, directions = np.linalg.eigh(np.eye(count) - gain @ slopes)
                known[side] = (better, directions * np.sqrt(np.maximum(variance, 0.0)))
        return known

    def _walk(self, state: Mapping[str, Floats]) -> dict[str, Floats]:
        """By side (5,) rad: what `WalkPriors` expects, NaN where the walk does not tell it."""
        angles, found = angles_of(self.legs, self._made(state)[1]), {}
        for side in state:
            hip, knee, ankle = (angles.get(f"{side}{joint}Angles", np.full((1, 3), np.nan)) for joint in ("Hip", "Knee", "Ankle"))
            knee = knee[np.isfinite(knee).all(axis=1)]
            slope = straight = np.nan
            if len(knee) >= _FEW and np.subtract(*np.percentile(knee[:, 0], [95, 5])) > _BENT:
                bend = np.sin(knee[:, 0])
                slope = float(np.mean((bend - bend.mean()) * knee[:, 1]) / bend.var())
                straight = float(knee[:, 1].mean() - slope * bend.mean())
            found[side] = np.array([slope, _mean(hip[:, 2]), straight, _mean(knee[:, 2]), _mean(ankle[:, 2])])
        return found

    @cached_property
    def legs(self) -> Recording:
        """The recording with the markers of pelvis and legs alone."""
        return self.recording.select([name for name in self.recording.labels if name == "SACR" or name[1:] in _LEG])

    @cached_property
    def shown(self) -> list[str]:
        """Sides whose thigh, and way from the spine to the ankle, are known in `_FEW` frames or more; of others nothing can be told."""
        legs, marker = lower_body(self.legs, self.measures, self.sides).legs, marker_of(self.legs)

        def seen(values: Floats) -> bool:
            return int(np.isfinite(values).reshape(len(values), -1).all(axis=1).sum()) >= _FEW

        return [side for side, leg in legs.items() if seen(leg.thigh) and seen(marker(f"{side}ASI") + marker(f"{side}ANK"))]

    def _made(self, state: Mapping[str, Floats]) -> Made:
        """The measures at a place of the priors, and the body that they make."""
        given, shifts = self.measures, {side: dict(zip(self.sources, own.tolist(), strict=True)) for side, own in state.items()}

        def prior(side: str, name: str, of: str = "", also: float = 0.0) -> float:
            mean, deviation = getattr(self.priors, of or name)
            # One of two places `also` to both sides, and normal about it: that holds 95 % within as many deviations as a normal one does.
            return float(mean + shifts[side].get(name, 0.0) * max(deviation, (abs(also) + 1.645 * deviation) / 1.96))

        for side in state:
            leg = given.of(side)
            length = leg.leg_length
            if length is None or "leg_length" not in leg.from_file:
                length = prior(side, "leg") * self._chains[side]
            # A width has a millimetre at least, wherever the estimate goes.
            widths = {f"{joint}_width": max(prior(side, joint) * length, 0.001) for joint in ("knee", "ankle")}
            others = {_MEASURE_OF[name]: prior(side, name) for name in ("thigh", "shank", "torsion", "tilt")}
            trochanter = 0.1288 * length - 0.04856 + prior(side, "trochanter")
            given = _with_lacking(given, side, {"leg_length": length, "asis_trochanter": trochanter, **widths, **others})
        if "radius" in self.sources and state:
            given = replace(given, marker_radius=max(float(np.mean([prior(side, "radius") for side in state])), 0.001))
        bare = given
        for side in state:
            bare = bare.with_leg(side, replace(bare.of(side), foot_flexion=0.0, foot_rotation=0.0))
        body = lower_body(self.legs, bare, self.sides)
        legs = dict(body.legs)
        for side in state:
            line = legs[side].foot
            if line is None:
                continue
            if side in self._soles:
                flat, sloped, turn = self._sole(line, side)
                flexion, turn = (flat + sloped) / 2 + prior(side, "sole", also=(flat - sloped) / 2), turn + prior(side, "sole_turn")
            else:
                flexion, turn = prior(side, "sole", of="sole_alone"), prior(side, "sole_turn")
            given = _with_lacking(given, side, {"foot_flexion": flexion, "foot_rotation": turn})
            legs[side] = replace(legs[side], foot=turned_foot(line, side, given.of(side)))
        return given, replace(body, legs=legs)

    @cached_property
    def _chains(self) -> dict[str, float]:
        """m, from the anterior iliac spine by the knee's marker to the ankle's."""
        marker = marker_of(self.recording)
        ways = {
            side: [np.linalg.norm(marker(side + one) - marker(side + other), axis=1) for one, other in (("ASI", "KNE"), ("KNE", "ANK"))]
            for side in self.shown
        }
        return {side: float(sum(nan_median(way, axis=0) for way in pair)) for side, pair in ways.items()}

    @cached_property
    def _soles(self) -> dict[str, tuple[Floats, float]]:
        """By side whose heel and toe are seen: the way from toe to heel (T, 3) m, and by what angle the sole of a level foot slopes."""
        found = {}
        for side in self.shown:
            names = [side + name for name in ("HEE", "TOE")]
            if not all(name in self.recording.labels for name in names):
                continue
            heel, toe = (marker_of(self.recording)(name) for name in names)
            if np.isfinite(heel + toe).all(axis=1).sum() >= _FEW:
                long = float(nan_median(np.linalg.norm(heel - toe, axis=1), axis=0))
                higher = float(np.nanpercentile(heel[:, 2], 8) - np.nanpercentile(toe[:, 2], 8))
                found[side] = (heel - toe, float(np.arctan2(higher, long)))
        return found

    def _sole(self, line: Floats, side: str) -> tuple[float, float, float]:
        """rad: the foot's line against the sole, by heel and toe marker as high as they are when they stand, and by a level sole; and the
        line's turn against them, seen from above."""
        back, slope = self._soles[side]
        x, y, z = np.einsum("tji,tj->it", line, back)
        flat = -_mean(np.arctan2(x, z))
        return flat, flat + slope, (1.0 if side == "L" else -1.0) * _mean(np.arctan2(y, z))


def _with_lacking(given: SubjectMeasures, side: str, values: Mapping[str, float]) -> SubjectMeasures:
    """With those of the values that the leg lacks, which then count as given."""
    leg = given.of(side)
    return given.with_leg(side, leg.with_values({name: float(value) for name, value in values.items() if name not in leg.from_file}))


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
