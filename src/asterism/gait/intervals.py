"""An analysed walk in; for each angle over the cycle an interval, and what makes it as wide as it is, out (GUM, first order)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from asterism.gait.cycles import POINTS, Cycle
from asterism.gait.feet import SIDES
from asterism.geometry import rotate_z_up
from asterism.motion.clinical import ClinicalAngles, ClinicalModel, LegMeasures, SubjectMeasures, complete_legs
from asterism.motion.clinical.estimated import MeasurePriors, WalkEstimator
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names
from asterism.motion.clinical.plug_in_gait import LowerBody, angles_of, lower_body, radius_by_the_file
from asterism.motion.joints.anatomy import sacrum_markers
from asterism.recording import Floats, Recording

SOURCES = ("measures", "placement", "fills")
"""What makes a curve uncertain; see `angle_bands`."""
COVERAGE = 1.96
"""Standard uncertainties to each side of the middle of a band: 95 % of a normal distribution."""
PLACED = 0.005
"""m, standard deviation of a marker's place along each direction from session to session. By propagation that is 2 to 5 degrees, as between
sessions of one laboratory (McGinley et al. 2009); between examiners of several it is double (Della Croce et al. 1999). Bands are in
proportion to it where all measures are known"""
BANDED = ("Pelvis", "Hip", "Knee", "Ankle", "FootProgress")
"""Quantities whose angles have bands, by Plug-in-Gait's names."""
_CYCLES, _ROWS = 2, 40
"""Cycles of each side, and frames of each, at which angles are computed again: cycles of one walk differ by less than a tenth of a band."""
_STEP = 0.001
"""m, by which a marker is moved to see what it does."""
_CALIBRATED = {"THI": "thigh_rotation", "TIB": "shank_rotation", "TOE": "foot_flexion"}
"""The measure that a standing trial takes of a marker: with it, the marker counts as well placed."""


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
    """The 95 % band of one curve, the mean over the cycles of its side, (101, 3) rad each.

    low, high  its ends; they need not lie evenly about the curve, which takes usual measures where nobody gave some
    standard   source, one of `SOURCES` -> standard uncertainty from it alone
    """

    low: Floats
    high: Floats
    standard: Mapping[str, Floats]


def angle_bands(
    analysis: AnalysedWalk, sources: Sequence[str] = SOURCES, *, placed: float = PLACED, priors: MeasurePriors | None = None
) -> dict[str, AngleBand]:
    """Bands of the angles of legs and pelvis over the cycle, by Plug-in-Gait's names.

    A band holds, with 95 %, the mean curve that another session with this person would give, of the same walk: what nobody measured of the
    person is measured then ("measures"), markers are placed anew ("placement", standard deviation `placed` in m), and nothing is filled
    ("fills"). With the source "measures" alone it holds the curve that the vendor's program gives of the same markers once the person is
    measured. How soft tissue moves is the same in both sessions and no part of it; see `clinical_uncertainty` for bones.

    What is not measured is estimated from the walk (`WalkEstimator`). Measures with which the file's program computed its own angles count
    as known. What is left open by more than a right angle has no band (NaN). Without angles or whole cycles there are no bands. O(1): some
    200 times the angles of 160 frames.
    """
    clinical = analysis.clinical
    curves = {name: values for name, values in analysis.curves.items() if name.removesuffix("Angles")[1:] in BANDED}
    wands = clinical is not None and clinical.model.name == "plug-in-gait"
    # The measures that nobody gave, and the markers that are moved, are those of Plug-in-Gait's whole legs.
    sides = "".join(complete_legs(analysis.recording)) if wands else "LR"
    curves = {name: values for name, values in curves.items() if name[0] in sides}
    if clinical is None or not curves:
        return {}
    if not wands:
        return _of_landmarks(analysis, clinical.model, curves, sources, placed)
    recording, times = _some(analysis)
    recording = _without_trunk(with_plug_in_gait_names(recording))
    reported = _angles(recording, clinical.subject, sides)
    curves = {name: values for name, values in curves.items() if name in reported}
    middle, parts = reported, {source: {name: np.zeros_like(values) for name, values in reported.items()} for source in SOURCES}
    estimator = WalkEstimator(recording, _as_known(analysis), sides, priors or MeasurePriors())
    subject = estimator.estimate() if estimator.sources and "measures" in sources else clinical.subject
    if estimator.sources and "measures" in sources:
        middle = _angles(recording, subject, sides)
        for source in estimator.sources:
            ends = [_angles(recording, estimator.estimate({source: shift}), sides) for shift in (1.0, -1.0)]
            _add(parts["measures"], _apart(*ends), 0.5)
    if "placement" in sources:
        for moved in _displaced(recording, lower_body(recording, subject, sides), clinical.subject):
            _add(parts["placement"], _apart(_angles(moved, subject, sides), middle), placed / _STEP)
    return _bands(analysis, curves, sources, times, parts, _apart(middle, reported))


def _of_landmarks(
    analysis: AnalysedWalk, model: ClinicalModel, curves: Mapping[str, Floats], sources: Sequence[str], placed: float
) -> dict[str, AngleBand]:
    """Bands of angles that come from landmarks: of no measures, but of where each landmark was felt."""
    recording, times = _some(analysis)
    middle = model.outputs(recording)
    curves = {name: values for name, values in curves.items() if name in middle}
    parts = {source: {name: np.zeros_like(middle[name]) for name in curves} for source in SOURCES}
    for moved in model.placed_anew(recording, _STEP) if "placement" in sources else ():
        _add(parts["placement"], _apart({name: moved[name] for name in curves}, middle), placed / _STEP)
    return _bands(analysis, curves, sources, times, parts, {name: np.zeros_like(middle[name]) for name in curves})


def _bands(
    analysis: AnalysedWalk,
    curves: Mapping[str, Floats],
    sources: Sequence[str],
    times: Floats,
    parts: Mapping[str, Mapping[str, Floats]],
    shift: Mapping[str, Floats],
) -> dict[str, AngleBand]:
    """Variances (T, 3) rad2 of each source, and by how much the middle differs from what was reported, over the cycle."""
    found = {}
    for name in curves:
        own = _shown(analysis, name[0])
        spread = {source: np.sqrt(_over(parts[source][name], times, own)) for source in sources if source != "fills"}
        if "fills" in sources and name in analysis.fill_sigmas:
            # Gaps differ from cycle to cycle: of independent ones the mean is known better.
            filled = np.nan_to_num(analysis.fill_sigmas[name])
            spread["fills"] = np.sqrt((filled**2).sum(axis=0)) / len(filled)
        seen = np.isfinite(curves[name])
        mean = np.where(seen.any(axis=0), np.nansum(curves[name], axis=0) / np.maximum(seen.sum(axis=0), 1), np.nan)
        centre = mean + _over(shift[name], times, own)
        wide = COVERAGE * np.sqrt(sum(part**2 for part in spread.values()))
        # Near a right angle of the middle turn the other two run away, and first order tells nothing of them.
        wide = np.where(wide < np.pi / 2, wide, np.nan)
        found[name] = AngleBand(centre - wide, centre + wide, spread)
    return found


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
    return replace(recording, positions=positions, vertical=np.array([0.0, 0.0, 1.0]), source=None, origin=None), chosen / recording.rate


def _without_trunk(recording: Recording) -> Recording:
    """The recording without the markers of the trunk, whose angles have no band and would be computed each time."""
    places = [place for place, label in enumerate(recording.labels) if label not in ("CLAV", "C7", "STRN", "T10")]
    return replace(recording, positions=recording.positions[:, places], labels=tuple(recording.labels[place] for place in places))


def _as_known(analysis: AnalysedWalk) -> SubjectMeasures:
    """The measures; where the file's own angles follow from them, also those that it left at zero count as given."""
    assert analysis.clinical is not None
    subject = analysis.clinical.subject
    if radius_by_the_file(analysis.recording, subject) is None:
        return subject
    names = tuple(LegMeasures.__dataclass_fields__)
    return replace(subject, left=replace(subject.left, from_file=names), right=replace(subject.right, from_file=names))


def _angles(recording: Recording, measures: SubjectMeasures, sides: str) -> dict[str, Floats]:
    return angles_of(recording, lower_body(recording, measures, sides))


def _apart(one: Mapping[str, Floats], other: Mapping[str, Floats]) -> dict[str, Floats]:
    """rad, the shorter way round."""
    return {name: (values - other[name] + np.pi) % (2 * np.pi) - np.pi for name, values in one.items()}


def _add(variance: dict[str, Floats], apart: Mapping[str, Floats], factor: float) -> None:
    for name, values in apart.items():
        variance[name] += (factor * values) ** 2


def _displaced(recording: Recording, body: LowerBody, known: SubjectMeasures) -> Iterator[Recording]:
    """The recording with one marker moved by `_STEP` along one axis of its segment; those of both legs at once, which do not meet."""
    columns = {label: number for number, label in enumerate(recording.labels)}
    pelvis = [(name, body.pelvis) for name in ("LASI", "RASI", *sacrum_markers(recording))]
    legs = [[(side + name, getattr(leg, segment)) for side, leg in body.legs.items()] for name, segment in _MARKERS.items()]
    for together in [[pair] for pair in pelvis] + legs:
        worn = [
            (columns[name], np.nan_to_num(axes))
            for name, axes in together
            if name in columns and _CALIBRATED.get(name[1:]) not in known.of(name[0]).from_file
        ]
        for axis in range(3 if worn else 0):
            positions = recording.positions.copy()
            for column, axes in worn:
                positions[:, column] += _STEP * axes[:, :, axis]
            yield replace(recording, positions=positions)


_MARKERS = {"THI": "thigh", "KNE": "thigh", "TIB": "shank", "ANK": "shank", "TOE": "shank"}
"""Markers of a leg, and the segment along whose axes each is moved."""


def _over(values: Floats, times: Floats, cycles: Sequence[Cycle]) -> Floats:
    """(101, 3): values (T, 3) at times over the cycle, the mean over several."""
    share = np.linspace(0.0, 1.0, POINTS)
    places = [cycle.strike.time + share * cycle.duration for cycle in cycles]
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return np.full((POINTS, 3), np.nan)
    return np.mean([[np.interp(place, times[known], values[known, axis]) for axis in range(3)] for place in places], axis=0).T
