"""A recording, its person's standing trial and measures that were given, in; the measures that count, and what is doubtful of them, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.motion.clinical.estimated import MeasurePriors
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names, worn_landmarks
from asterism.motion.clinical.measures import MARKER_RADIUS, SIDES, SubjectMeasures, named_radius, subject_measures
from asterism.motion.clinical.plug_in_gait import radius_by_the_file
from asterism.motion.clinical.static import StaticRules, with_static_offsets
from asterism.recording import Floats, Recording
from asterism.recording.arrays import nan_quantile
from asterism.recording.display import significant

_SAME_LEG = 0.07
"""Of a leg's length, by which markers may show another one: they show 0.4 % less to 2.5 % more on four people of three laboratories."""
_SAME_PERSON = 0.045
"""RMS of the logarithms of distances between markers on one segment, standing against moving, also at 7 m/s: to 0.037
for the same person, 0.055 and more for another. At half it tells skin and gaps, at double it misses people of one size."""
_LIMBS = ("pelvis", "left thigh", "right thigh", "left shank", "right shank")
_STEPS = 0.15
"""m, by which one ankle may move past the other while a person stands: 0.007 at most on 17 standing trials of four laboratories, 0.75 and
more on 28 walks. At half it tells a foot that was put straight, at double a small child's steps come near."""
_LOW, _LIFTED = 0.08, 0.1
"""Of the frames, in which a foot stands at least; rad, by which a heel may stand higher above the toe than in the walk: -0.06 to 0.04 on 15
people of six laboratories. At half, skin tells it; at double, 11 degrees of the ankle are not."""
_OFFSETS = ("thigh_rotation", "shank_rotation", "tibial_torsion", "foot_flexion", "foot_rotation")
_SAME_OFFSET = 0.05
"""rad, by which an offset of the file may differ from that which its standing trial shows: up to 0.001 on 11 trials of four laboratories,
by the rule that fits, and 0.24 on one computed as a walk. At half, rules of other programs are told; at double, 6 degrees are not."""
_ROUNDED = 0.5
"""mm, degrees or kg, by which what is given may differ from what a file holds without a word: a rounded number."""
_USUAL = 2.5
"""Standard deviations of `MeasurePriors` within which a width lies, of the leg's length: knees 0.06 to 0.19, ankles 0.056 to 0.106;
25 people have 0.10 to 0.16 and 0.07 to 0.103. At half, one person in five is told; at double, no mistake is."""
_SAME_WIDTH = 0.2
"""By which the wider of two knees or ankles is wider: a swollen one is by less. At half, people with arthritis are told; at double, a
knee's width typed as an ankle's (0.6 of it) is just told."""
_FEW = 4
"""Distances, at least, that tell a person."""


def gathered_measures(
    recording: Recording, static: Recording | None = None, given: Mapping[str, float] | None = None, rules: StaticRules | None = None
) -> tuple[SubjectMeasures, tuple[Finding, ...]]:
    """The measures of the person: those given, over those that the standing trial tells and holds, over those of the recording's file.

    static  a standing trial; given  by Plug-in-Gait's names, as `SubjectMeasures.with_values` has them

    The marker's diameter is that given; else that with which the files' own angles were computed; else that which the files name.
    Findings say where measures or the standing trial seem to be another person's. Raises AsterismError as `with_static_offsets` does.
    """
    given = given or {}
    found: list[Finding] = []
    measures = subject_measures(recording)
    if static is not None:
        measures = _over(subject_measures(static), measures)
    if not any(name.upper() == "MARKERDIAMETER" for name in given):
        radii = (radius_by_the_file(one, subject_measures(one)) for one in (recording, static) if one is not None)
        fitted = next((radius for radius in radii if radius is not None), None)
        if fitted is not None and abs(fitted - measures.marker_radius) > 1e-4:
            found.append(_another_radius(recording, measures.marker_radius, fitted))
        measures = measures if fitted is None else replace(measures, marker_radius=fitted)
    found += _differing(recording, measures, given)
    measures = measures.with_values(given)
    if static is not None:
        # a set without wands has no such offsets
        if any(label in ("LTHI", "RTHI") for label in with_plug_in_gait_names(recording).labels):
            measures, differs = _with_offsets(static, measures, rules or StaticRules(), given)
            found += differs
        found += static_of_another(recording, static) + (_steps(static) or _lifted(recording, static))
    return measures, (*found, *_implausible(recording, measures), *_other_length(recording, measures))


def _with_offsets(
    static: Recording, measures: SubjectMeasures, rules: StaticRules, given: Mapping[str, float]
) -> tuple[SubjectMeasures, list[Finding]]:
    """The measures with the offsets of the standing trial, by the rules that its own program followed, where its file tells; and doubts.

    That program reads standing trials with the marker's diameter that the file names, and walks with another one.
    """
    named = None if any(name.upper() == "MARKERDIAMETER" for name in given) else named_radius(static)
    held, still = subject_measures(static), replace(measures, marker_radius=named or measures.marker_radius)
    own = [(side, name) for side in SIDES for name in _OFFSETS if name in held.of(side).from_file]
    ways = [rules, replace(rules, tilted=True), replace(rules, flat_foot=False)] if own else [rules]
    told = [with_static_offsets(static, still, way).with_values(given) for way in ways]

    def apart(one: SubjectMeasures) -> list[float]:
        return [abs(getattr(one.of(side), name) - getattr(held.of(side), name)) for side, name in own]

    nearest = min(range(len(ways)), key=lambda place: sum(apart(told[place])))
    # Where no rule gives the file's offsets, they tell none.
    fits = max(apart(told[nearest]), default=0.0) <= _SAME_OFFSET
    way, best = (ways[nearest], told[nearest]) if fits else (rules, told[0])
    best = replace(best, marker_radius=measures.marker_radius)
    if fits and way == rules:
        return best, []
    if fits:
        how = "the ankle's axis through both malleoli as it is" if way.tilted else "heel and toe marker as high as they are"
        sentence = f"{_file(static)}: read with {how}, as its own program did: the offsets that its file holds follow so."
        mend = "Nothing, where they are to be those of that program."
        return best, [Finding("clinical-static-rule", Severity.NOTE, _file(static), sentence, mend)]
    off = apart(best)
    worst = int(np.argmax(off))
    side, name = own[worst]
    sentence = f"{_file(static)}: the offsets that its file holds are not those that the trial shows: the {SIDES[side]} "
    sentence += f"{name.replace('_', ' ')} differs by {np.degrees(off[worst]):.0f} degrees. Its program took them from another standing "
    sentence += "trial, or a marker was moved since; those of the trial are taken."
    mend = "Give the standing trial that the program used; or leave it out, where the walk's file holds the offsets."
    return best, [Finding("clinical-static-differs", Severity.WARNING, _file(static), sentence, mend)]


def _over(upper: SubjectMeasures, lower: SubjectMeasures) -> SubjectMeasures:
    """The upper measures where their file holds them, else the lower ones."""
    merged = lower
    for side in SIDES:
        leg, arm = upper.of(side), upper.arm(side)
        merged = merged.with_leg(side, merged.of(side).with_values({name: getattr(leg, name) for name in leg.from_file}))
        merged = merged.with_arm(side, merged.arm(side).with_values({name: getattr(arm, name) for name in arm.from_file}))
    return replace(
        merged,
        inter_asis=upper.inter_asis or lower.inter_asis,
        mass=upper.mass or lower.mass,
        head_offset=upper.head_offset or lower.head_offset,
        marker_radius=upper.marker_radius if lower.marker_radius == MARKER_RADIUS else lower.marker_radius,
    )


def _file(recording: Recording) -> str:
    return str(recording.metadata.get("file", "the recording"))


def _another_radius(recording: Recording, named: float, fitted: float) -> Finding:
    return Finding(
        "clinical-marker-diameter",
        Severity.NOTE,
        _file(recording),
        f"{_file(recording)}: its own angles were computed with markers of {2000 * fitted:g} mm, not {2000 * named:g} mm; so are these.",
        "Give MarkerDiameter if another one is right.",
    )


def _differing(recording: Recording, held: SubjectMeasures, given: Mapping[str, float]) -> list[Finding]:
    """Measures that were given in place of others, which files hold."""
    both = {name: held.value_of(name) for name in given}
    # files hold some digits more than people type
    told = [
        f"{name} {significant(given[name], 4)}, not {significant(own, 4)}"
        for name, own in both.items()
        if own is not None and abs(given[name] - own) >= _ROUNDED
    ]
    if not told:
        return []
    sentence = f"{_file(recording)}: measures that were given are taken in place of those that its files hold: {', '.join(told)}."
    mend = "Leave the option out where the file is right."
    return [Finding("clinical-measure-differs", Severity.NOTE, _file(recording), sentence, mend)]


def _implausible(recording: Recording, measures: SubjectMeasures) -> list[Finding]:
    """Widths that hardly anybody has whose leg is so long, or whose other leg is so wide."""
    told, priors, legs = list[str](), MeasurePriors(), {side: measures.of(side) for side in SIDES}
    for joint, (mean, spread) in (("knee", priors.knee), ("ankle", priors.ankle)):
        widths = {side: getattr(leg, f"{joint}_width") for side, leg in legs.items() if f"{joint}_width" in leg.from_file}
        odd = [
            (side, width, length)
            for side, width in widths.items()
            if (length := legs[side].leg_length) is not None and abs(width / length - mean) > _USUAL * spread
        ]
        told += [
            f"the {SIDES[side]} {joint}'s width is {1000 * width:.0f} mm, the leg's length {1000 * length:.0f} mm"
            for side, width, length in odd
        ]
        if not odd and len(widths) == 2 and max(widths.values()) > (1.0 + _SAME_WIDTH) * min(widths.values()):
            told.append(f"the {joint}s' widths are {1000 * widths['L']:.0f} mm on the left and {1000 * widths['R']:.0f} mm on the right")
    if not told:
        return []
    sentence = f"{_file(recording)}: {'; '.join(told)}: hardly anybody is built so. Half of an error of a width moves the joint's centre."
    mend = "Look whether a measure is another one's, or mistyped, and correct it with --measure."
    return [Finding("clinical-measure-implausible", Severity.WARNING, _file(recording), sentence, mend)]


def _distances(recording: Recording, pairs: Sequence[tuple[str, str]], *shares: float) -> Floats:
    """(shares, pairs) m between two markers: what so much of the frames stays below; NaN where they are never seen together."""
    column = {name: place for place, name in reversed([*enumerate(recording.labels)])}
    apart = np.full((len(recording), len(pairs)), np.nan)
    known = [place for place, pair in enumerate(pairs) if set(pair) <= column.keys()]
    one, other = (recording.positions[:, [column[pairs[place][end]] for place in known]] for end in (0, 1))
    apart[:, known] = np.sqrt(((one - other) ** 2).sum(axis=2))
    return nan_quantile(apart, shares, axis=0)


def _on_segments(recording: Recording) -> list[list[str]]:
    """Names of the markers on pelvis, thighs, shanks and feet."""
    segments = worn_landmarks(recording).segments
    limbs = [[recording.labels[column] for column in segments.get(limb, ())] for limb in _LIMBS]
    return [*limbs, *([name for name in (f"{side}HEE", f"{side}TOE") if name in recording.labels] for side in SIDES)]


def _steps(static: Recording) -> list[Finding]:
    """Where a person walks in what was given as the standing trial: offsets of feet and wands are means over it."""
    named = with_plug_in_gait_names(static)
    if not {"LANK", "RANK"} <= set(named.labels):
        return []
    left, right = (named.positions[:, named.labels.index(name)] for name in ("LANK", "RANK"))
    past = (left - right)[np.isfinite(left - right).all(axis=1)]
    moved = float(np.linalg.norm(np.ptp(np.percentile(past, (5.0, 95.0), axis=0), axis=0))) if len(past) else 0.0
    if moved <= _STEPS:
        return []
    sentence = f"{_file(static)} is no standing trial: its ankles move past each other by {1000 * moved:.0f} mm, and offsets of feet and "
    sentence += "wands are taken from it."
    return [Finding("clinical-static-moves", Severity.WARNING, _file(static), sentence, "Give a trial in which the person stands.")]


def _lifted(recording: Recording, static: Recording) -> list[Finding]:
    """Where a person who stands lifts a heel that comes down further in the walk: a level sole is taken from how the foot stands there."""
    found = []
    for side, word in SIDES.items():
        stands, walks = (_sole(trial, side, share) for trial, share in ((static, 0.5), (recording, _LOW)))
        if stands - walks > _LIFTED:
            sentence = (
                f"{_file(static)}: the {word} heel stands {np.degrees(stands - walks):.0f} degrees higher above the toe than it comes "
            )
            sentence += "down in the walk: the person stands on the toes, or leans; the ankle's flexion is off by as much."
            mend = "Give a trial in which both feet stand flat, or --sloped-foot, where heel and toe markers are meant to differ in height."
            found.append(Finding("clinical-static-lifted", Severity.WARNING, _file(static), sentence, mend))
    return found


def _sole(recording: Recording, side: str, share: float) -> float:
    """rad, of the line from toe to heel marker, up: by heights below which each is in so much of the frames; NaN where one is not seen."""
    named = with_plug_in_gait_names(recording)
    long = _distances(named, [(f"{side}HEE", f"{side}TOE")], 0.5)[0, 0]
    if not long > 0.0:
        return float("nan")
    heel, toe = (rotate_z_up(named.positions[:, named.labels.index(side + name)], named.vertical)[:, 2] for name in ("HEE", "TOE"))
    return float(np.arcsin(np.clip((np.nanquantile(heel, share) - np.nanquantile(toe, share)) / long, -1.0, 1.0)))


def other_person(recording: Recording, first: Recording) -> list[Finding]:
    """Where two moving trials, which are taken for one person's, show different bodies."""
    told = _body_differs(recording, first)
    mend = "Analyse each person alone; a band of several is made with --save-band."
    said = "they are of two persons, or markers were placed anew."
    return [Finding("clinical-other-person", Severity.WARNING, _file(recording), f"{told}: {said}", mend)] if told else []


def static_of_another(recording: Recording, static: Recording) -> list[Finding]:
    """Where a standing trial shows another body than a moving one."""
    told = _body_differs(recording, static)
    said, mend = "the standing trial is another person's, or markers were placed anew.", "Give the standing trial of this session."
    return [Finding("clinical-other-person", Severity.WARNING, _file(recording), f"{told}: {said}", mend)] if told else []


def _body_differs(recording: Recording, static: Recording) -> str:
    """What two recordings differ by in the lengths of segments, as the beginning of a sentence; empty where they may be one person's."""
    columns = [_on_segments(with_plug_in_gait_names(trial)) for trial in (recording, static)]
    pairs = [pair for one, other in zip(*columns, strict=True) for pair in combinations([name for name in one if name in other], 2)]
    recording, static = with_plug_in_gait_names(recording), with_plug_in_gait_names(static)
    # what slides over a joint, as on the kneecap, tells no person
    low, middle, high = _distances(recording, pairs, 0.25, 0.5, 0.75)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (middle / _distances(static, pairs, 0.5)[0])[high < (1.0 + _SAME_PERSON) * low]
    known = np.log(ratios[np.isfinite(ratios) & (ratios > 0.0)])
    off = float(np.sqrt(np.mean(known**2))) if len(known) >= _FEW else 0.0
    if off <= _SAME_PERSON:
        return ""
    return f"{_file(recording)} and {_file(static)} differ by {100 * off:.0f} % (RMS) in distances between markers on one segment"


def _other_length(recording: Recording, measures: SubjectMeasures) -> list[Finding]:
    """Where a leg is as long as no leg that wears these markers."""
    found, recording = [], with_plug_in_gait_names(recording)
    for side, word in SIDES.items():
        given = measures.of(side).leg_length
        thigh = _distances(recording, [(f"{side}ASI", f"{side}KNE")], 0.95)[0, 0]
        shown = thigh + _distances(recording, [(f"{side}KNE", f"{side}ANK")], 0.5)[0, 0]
        if given is not None and np.isfinite(shown) and abs(shown / given - 1.0) > _SAME_LEG:
            sentence = f"{_file(recording)}: the {word} leg's length is given as {1000 * given:.0f} mm, and its markers show about "
            sentence += f"{1000 * shown:.0f} mm: the measures are another person's, or the length was measured otherwise."
            found.append(Finding("clinical-other-person", Severity.WARNING, _file(recording), sentence, "Look the measure up."))
    return found
