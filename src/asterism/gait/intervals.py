"""An analysed walk in; for each angle over the cycle two intervals, and what makes them as wide as they are, out (GUM, first order)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from asterism.errors import AsterismError
from asterism.gait.cycles import POINTS, Cycle
from asterism.gait.feet import SIDES
from asterism.geometry import rotate_z_up
from asterism.motion.clinical import ArmMeasures, ClinicalAngles, LegMeasures, SubjectMeasures, complete_legs
from asterism.motion.clinical.estimated import MeasurePriors, WalkEstimator
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names
from asterism.motion.clinical.plug_in_gait import angles_of, lower_body, radius_by_the_file, trunk_angles, walking_axes
from asterism.motion.clinical.upper_body import HEAD, THORAX, upper_body_angles
from asterism.motion.joints.anatomy import sacrum_markers
from asterism.recording import Floats, Recording

SOURCES = ("measures", "fills", "events", "placement")
"""What makes a curve uncertain; see `angle_bands`. All but the last are open while the markers stay where they are."""
COVERAGE = 1.96
"""Standard uncertainties to each side of the middle of a band: 95 % of a normal distribution."""
PLACED = 0.005
"""m, standard deviation of a marker's place along each direction from session to session. By propagation that is 2 to 5 degrees, as between
sessions of one laboratory (McGinley et al. 2009); between examiners of several it is double (Della Croce et al. 1999). Bands are in
proportion to it where all measures are known"""
_CYCLES, _ROWS = 1, 34
"""Cycles of each side, and frames of each, at which angles are computed again: cycles of one walk differ by less than a tenth of a band,
and 40 frames of two give the same to a tenth of a degree."""
_STEP = 0.001
"""m, by which a marker is moved to see what it does."""
_CALIBRATED = {"THI": "thigh_rotation", "TIB": "shank_rotation", "TOE": "foot_flexion"}
"""The measure that a standing trial takes of a marker: with it, the marker counts as well placed."""
_LEG_ANGLES = ("HipAngles", "KneeAngles", "AnkleAngles", "FootProgressAngles")
_OF_LEGS = ("THI", "KNE", "TIB", "ANK", "TOE")
_OF_ARMS = ("SHO", "ELB", "WRA", "WRB", "FIN")


_NEEDED = frozenset(
    {"SACR", "LASI", "RASI", "LPSI", "RPSI", *HEAD, *THORAX, *(side + name for side in SIDES for name in (*_OF_LEGS, *_OF_ARMS))}
)
"""Markers on which the angles hang."""


class AnalysedWalk(Protocol):
    """What bands need of an analysis, see `asterism.gait.GaitAnalysis`."""

    @property
    def recording(self) -> Recording:
        """Which was analysed."""

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """Whole ones."""

    @property
    def clinical(self) -> ClinicalAngles | None:
        """Angles over time."""

    @property
    def curves(self) -> Mapping[str, Floats]:
        """Angles over the cycles, rad."""

    @property
    def fill_sigmas(self) -> Mapping[str, Floats]:
        """What fills add, rad."""


@dataclass(frozen=True)
class AngleBand:
    """The 95 % bands of one curve, the mean over the cycles of its side, (101, 3) rad each.

    low, high  ends of the band of another session, in which markers are placed anew; they need not lie evenly about the curve, which
               takes usual measures where nobody gave some
    standard   source, one of `SOURCES` -> standard uncertainty from it alone
    """

    low: Floats
    high: Floats
    standard: Mapping[str, Floats]

    @property
    def same_placement(self) -> tuple[Floats, Floats]:
        """Low and high: the band of this session, in which the markers stay where they are."""
        middle, half = (self.low + self.high) / 2, _half({name: part for name, part in self.standard.items() if name != "placement"})
        return middle - half, middle + half


def angle_bands(
    analysis: AnalysedWalk, sources: Sequence[str] = SOURCES, *, placed: float = PLACED, priors: MeasurePriors | None = None
) -> dict[str, AngleBand]:
    """Bands of all angles over the cycle, by Plug-in-Gait's names.

    The band of this session (`AngleBand.same_placement`) holds, with 95 %, the mean curve that these markers give once what nobody measured
    of the person is measured ("measures"), nothing is filled ("fills"), and the steps begin when they truly do ("events"). That is what the
    vendor's program would give of the same recording. The band of another session holds the mean curve that the same walk would give with
    the markers placed anew as well ("placement", standard deviation `placed` in m). How soft tissue moves is the same in both and no part
    of it; see `clinical_uncertainty` for bones.

    What is not measured of the legs is estimated from the walk (`WalkEstimator`); the arms take an adult's measures. Measures with which
    the file's program computed its own angles count as known. What is left open by more than a right angle has no band (NaN). Without
    angles or whole cycles there are no bands. O(1): some 70 times the angles of 70 frames where all is measured, else twice as much.
    """
    clinical = analysis.clinical
    if clinical is None or not analysis.curves:
        return {}
    recording, times = _some(analysis)
    known = _known(analysis) if "measures" in sources else None
    priors, anew = priors or MeasurePriors(), placed if "placement" in sources else 0.0
    # The measures that nobody gave, and the markers that are moved, are those of Plug-in-Gait's whole legs.
    sides = "".join(complete_legs(analysis.recording))
    if clinical.model.name != "plug-in-gait":
        parts = [_of_landmarks(clinical, recording, anew)]
    else:
        parts = [_of_wands(clinical, recording, sides, known, priors, anew)] if sides else []
    parts.append(_of_trunk_and_arms(clinical, recording, known, priors, anew))
    found = {}
    for name, curves in analysis.curves.items():
        if own := [part for part in parts if name in part.apart]:
            found[name] = _band(analysis, name, curves, sources, times, own)
    return found


@dataclass(frozen=True)
class _Known:
    """The measures, with what somebody measured in their `from_file`, and whether the head's offset is among it."""

    subject: SubjectMeasures
    head: bool


@dataclass(frozen=True)
class _Open:
    """What is open of angles by their names, (T, 3) at some frames.

    apart  rad, from the reported ones to the likeliest; measures, placement  variances, rad2
    """

    apart: dict[str, Floats]
    measures: dict[str, Floats] = field(default_factory=dict)
    placement: dict[str, Floats] = field(default_factory=dict)

    def add_measure(self, one: Mapping[str, Floats], other: Mapping[str, Floats], middle: Mapping[str, Floats]) -> None:
        """What a measure leaves open that is one standard deviation more, and less."""
        more, less = _apart(one, middle), _apart(other, middle)
        for name in more:
            # The mean square of slope and bend under a normal distribution: near the best wand the slope is nought.
            slope, bend = (more[name] - less[name]) / 2, (more[name] + less[name]) / 2
            self.measures[name] = self.measures.get(name, 0.0) + slope**2 + 3.0 * bend**2

    def add_placement(self, copies: Mapping[str, Floats], middle: Mapping[str, Floats], placed: float) -> None:
        """What markers leave open that are moved by `_STEP` in copies of the recording, as `_placed_anew` has them."""
        for name, values in middle.items():
            each = copies[name].reshape(-1, *values.shape).copy()
            each[1::2] = each[1::2, ::-1]
            self.placement[name] = self.placement.get(name, 0.0) + ((_turn(each - values) * placed / _STEP) ** 2).sum(axis=0)


def _of_wands(
    clinical: ClinicalAngles, recording: Recording, sides: str, known: _Known | None, priors: MeasurePriors, placed: float
) -> _Open:
    """Of pelvis, legs and spine by Plug-in-Gait."""
    recording, subject = with_plug_in_gait_names(recording), clinical.subject
    body = lower_body(recording, subject, sides)
    room, reported = walking_axes(body), angles_of(recording, body)
    estimator = None if known is None else WalkEstimator(recording, known.subject, sides, priors)
    middle, taken = reported, subject
    if estimator is not None and estimator.sources:
        taken = estimator.estimate()
        middle = angles_of(recording, lower_body(recording, taken, sides), room)
    found = _Open(_apart(middle, reported))
    if estimator is not None and estimator.sources:
        for pair in estimator.apart():
            one, other = (angles_of(estimator.legs, made, room) for _, made in pair)
            found.add_measure(one, other, middle)
        # Of a leg that is hardly seen nothing is estimated, and what is open of it is not known.
        unseen = [side + name for side in sides if side not in estimator.shown for name in _LEG_ANGLES]
        found.measures.update({name: np.full_like(middle[name], np.nan) for name in unseen if name in middle})
    if placed:
        groups = [[name] for name in ("LASI", "RASI", *sacrum_markers(recording))]
        for name in _OF_LEGS:
            groups.append([side + name for side in sides if _CALIBRATED.get(name) not in subject.of(side).from_file])
        anew = _placed_anew(recording, groups)
        found.add_placement(angles_of(anew, lower_body(anew, taken, sides), room), middle, placed)
    return found


def _of_landmarks(clinical: ClinicalAngles, recording: Recording, placed: float) -> _Open:
    """Of angles that come from landmarks: of no measures, but of where each landmark was felt."""
    middle = clinical.model.outputs(recording, upper=False)
    found = _Open(_apart(middle, middle))
    for moved in clinical.model.placed_anew(recording, _STEP) if placed else ():
        found.add_placement({name: moved.get(name, values) for name, values in middle.items()}, middle, placed)
    return found


def _of_trunk_and_arms(clinical: ClinicalAngles, recording: Recording, known: _Known | None, priors: MeasurePriors, placed: float) -> _Open:
    """Of thorax, spine, head, neck and arms; what markers of the pelvis do to the spine is told with the legs."""
    try:
        body = clinical.model.body(recording)
    except AsterismError:  # no spine is seen in these frames
        return _Open({})
    recording, room = with_plug_in_gait_names(recording), walking_axes(body)

    def angles(one: Recording, measures: SubjectMeasures) -> dict[str, Floats]:
        # as copies run, see `_placed_anew`
        pelvis = np.concatenate([body.pelvis[:: -1 if number % 2 else 1] for number in range(len(one) // len(recording))])
        return upper_body_angles(one, measures, room) | trunk_angles(one, pelvis, room)

    taken = clinical.subject
    reported = angles(recording, taken)
    if known is not None and not known.head:
        taken = replace(taken, head_offset=priors.head[0])
    middle = angles(recording, taken)
    found = _Open(_apart(middle, reported))
    if not middle:
        return found
    for one, other in () if known is None else _upper_ends(taken, known, priors):
        found.add_measure(angles(recording, one), angles(recording, other), middle)
    if placed:
        anew = _placed_anew(recording, [[name] for name in (*HEAD, *THORAX)] + [[side + name for side in SIDES] for name in _OF_ARMS])
        found.add_placement(angles(anew, taken), middle, placed)
    return found


def _upper_ends(taken: SubjectMeasures, known: _Known, priors: MeasurePriors) -> Iterator[tuple[SubjectMeasures, SubjectMeasures]]:
    """Pairs of measures, each with one that nobody gave a standard deviation more, and less; that of both arms at once."""
    if not known.head:
        one, other = (replace(taken, head_offset=taken.head_offset + sign * priors.head[1]) for sign in (1.0, -1.0))
        yield one, other
    for name, deviation in priors.arms.items():
        ends = [taken, taken]
        for side in SIDES:
            if name not in known.subject.arm(side).from_file:
                value = getattr(taken.arm(side), name)
                more = (max(value + sign * deviation, 0.0) for sign in (1.0, -1.0))
                ends = [end.with_arm(side, replace(end.arm(side), **{name: one})) for end, one in zip(ends, more, strict=True)]
        if ends[0] is not taken:
            yield ends[0], ends[1]


def _placed_anew(recording: Recording, groups: Sequence[Sequence[str]]) -> Recording:
    """Copies of the recording, one after the other, in each of which one group of markers is moved by `_STEP` along one axis of the room.

    As a marker may be off by as much in each direction, it does not matter along which axes. Every second copy runs backwards, so that
    angles that turn by more than a right angle go on from copy to copy.
    """
    # Many recordings have as many markers again that no angle hangs on.
    recording = recording.select([name for name in recording.labels if name in _NEEDED])
    columns = [[recording.labels.index(name) for name in group if name in recording.labels] for group in groups]
    columns = [group for group in columns if group]
    positions = np.repeat(recording.positions[None], 3 * len(columns), axis=0)
    for number, group in enumerate(columns):
        for axis in range(3):
            positions[3 * number + axis, :, group, axis] += _STEP
    positions[1::2] = positions[1::2, ::-1]
    return replace(recording, positions=positions.reshape(-1, *recording.positions.shape[1:]))


def _band(analysis: AnalysedWalk, name: str, curves: Floats, sources: Sequence[str], times: Floats, parts: Sequence[_Open]) -> AngleBand:
    """The band of a curve (cycles, 101, 3) from what is open of it at some frames."""
    shown = _shown(analysis, name[0])
    spread = {}
    for source in ("measures", "placement"):
        if source in sources:
            own = [variance[name] for part in parts if name in (variance := getattr(part, source))]
            spread[source] = np.sqrt(_over(sum(own), times, shown)) if own else np.zeros((POINTS, 3))
    if "fills" in sources and name in analysis.fill_sigmas:
        # Gaps differ from cycle to cycle: of independent ones the mean is known better.
        filled = np.nan_to_num(analysis.fill_sigmas[name])
        spread["fills"] = np.sqrt((filled**2).sum(axis=0)) / len(filled)
    own_cycles = [cycle for cycle in analysis.cycles if cycle.side == name[0]]
    if "events" in sources and len(own_cycles) == len(curves):
        spread["events"] = moved_by_events(curves, own_cycles)
    seen = np.isfinite(curves)
    mean = np.where(seen.any(axis=0), np.nansum(curves, axis=0) / np.maximum(seen.sum(axis=0), 1), np.nan)
    centre = mean + sum(_over(part.apart[name], times, shown) for part in parts if part.apart[name].any())
    wide = _half(spread)
    return AngleBand(centre - wide, centre + wide, spread)


def _half(spread: Mapping[str, Floats]) -> Floats:
    """rad, half of a band's width. Near a right angle of the middle turn the other two run away, and first order tells nothing of them."""
    wide = COVERAGE * np.sqrt(sum((part**2 for part in spread.values()), np.zeros((POINTS, 3))))
    return np.where(wide < np.pi / 2, wide, np.nan)


def moved_by_events(curves: Floats, cycles: Sequence[Cycle]) -> Floats:
    """(101, 3) rad: how far the mean moves where the strikes are not when they are said to be; a strike may end one cycle and begin one."""
    share = np.linspace(0.0, 1.0, POINTS)[:, None]
    moves: dict[float, list[Floats]] = {}
    sigmas: dict[float, float] = {}
    for curve, cycle in zip(curves, cycles, strict=True):
        speed = np.nan_to_num(np.gradient(curve, cycle.duration / (POINTS - 1), axis=0))
        for strike, weight in ((cycle.strike, 1.0 - share), (cycle.next_strike, share)):
            moves.setdefault(strike.time, []).append(weight * speed)
            sigmas[strike.time] = strike.sigma
    return np.sqrt(sum((sigmas[time] * sum(own)) ** 2 for time, own in moves.items())) / len(curves)


def _shown(analysis: AnalysedWalk, side: str) -> list[Cycle]:
    """`_CYCLES` cycles of a side at most, those in which most is known of the knee."""
    own = [cycle for cycle in analysis.cycles if cycle.side == side]
    knee = analysis.curves.get(f"{side}KneeAngles", np.zeros((len(own), 1)))
    known = [int(np.isfinite(curve).sum()) for curve in knee]
    return [own[place] for place in sorted(range(len(own)), key=lambda place: -known[place])[:_CYCLES]]


def _some(analysis: AnalysedWalk) -> tuple[Recording, Floats]:
    """The recording at `_ROWS` frames of each cycle that is shown, and their times in s."""
    recording, last = analysis.recording, len(analysis.recording) - 1
    rows = set[int]()
    for cycle in (cycle for side in SIDES for cycle in _shown(analysis, side)):
        begin, end = (min(max(round(event.time * recording.rate), 0), last) for event in (cycle.strike, cycle.next_strike))
        rows.update(np.linspace(begin, end, _ROWS).astype(int).tolist())
    chosen = np.array(sorted(rows))
    positions = rotate_z_up(recording.positions[chosen], recording.vertical)
    return replace(
        recording, positions=positions, vertical=np.array([0.0, 0.0, 1.0]), source=None, origin=None, taken=()
    ), chosen / recording.rate


def _known(analysis: AnalysedWalk) -> _Known:
    """Where the file's own angles follow from the measures, also those that it left at zero count as given."""
    assert analysis.clinical is not None
    subject = analysis.clinical.subject
    if radius_by_the_file(analysis.recording, subject) is None:
        return _Known(subject, subject.head_offset != 0.0)
    legs, arms = (tuple(kind.__dataclass_fields__) for kind in (LegMeasures, ArmMeasures))
    for side in SIDES:
        subject = subject.with_leg(side, replace(subject.of(side), from_file=legs)).with_arm(
            side, replace(subject.arm(side), from_file=arms)
        )
    return _Known(subject, True)


def _turn(apart: Floats) -> Floats:
    """rad, the shorter way round."""
    return np.asarray((apart + np.pi) % (2 * np.pi) - np.pi)


def _apart(one: Mapping[str, Floats], other: Mapping[str, Floats]) -> dict[str, Floats]:
    return {name: _turn(values - other[name]) for name, values in one.items()}


def _over(values: Floats, times: Floats, cycles: Sequence[Cycle]) -> Floats:
    """(101, 3): values (T, 3) at times over the cycle, the mean over several."""
    share = np.linspace(0.0, 1.0, POINTS)
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return np.full((POINTS, 3), np.nan)
    values, times = values[known], times[known]
    places = np.concatenate([cycle.strike.time + share * cycle.duration for cycle in cycles])
    after = np.clip(np.searchsorted(times, places), 1, max(len(times) - 1, 1)) % len(times)
    step = np.maximum(times[after] - times[after - 1], 1e-9)
    weight = np.clip((places - times[after - 1]) / step, 0.0, 1.0)[:, None]
    found = (1.0 - weight) * values[after - 1] + weight * values[after]
    return np.asarray(found.reshape(len(cycles), POINTS, 3).mean(axis=0))
