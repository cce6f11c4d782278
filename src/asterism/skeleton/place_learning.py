"""Labelled recordings of people who wear a marker set in; where each marker of the set sits on the body, out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.recording import (
    Floats,
    MarkerSet,
    Place,
    Recording,
    canonical,
    is_unnamed,
    landmarks,
    shipped_sets,
    subject_of,
    without_subject,
)
from asterism.recording.place import LIMBS, SEGMENTS, other_side
from asterism.skeleton.joints import LENGTHS, scales_of
from asterism.skeleton.place_fit import RULES as FIT_RULES
from asterism.skeleton.place_fit import PlacedBody, PlaceFitRules, fit_places, size_against_standing


@dataclass(frozen=True)
class PlaceRules:
    """How places are learned. Round numbers, chosen on the recordings that docs/marker-sets.md names.

    frames      frames of each recording that count, evenly spread and each the fullest of its neighbours
    least       markers that must be known beforehand, and seen in a frame that counts: fewer do not turn a body
    own         a place of the set's own table is doubted by so many of its spreads
    named       m, doubt of a place that a shipped set tells by the marker's name
    loose       m, doubt along the bone of a marker on a wand or plate, and of one whose segment is all that is known
    spread      m, of a learned place where there are fewer than three people to see it
    alike       m, up to which the two sides count as one place and its mirror image
    far         m, from which a known landmark is reported: a wrong name, or another set; three spreads where that is more
    astray      share of the known landmarks that may be far: of 28 recordings of 16 people none had more than 0.17, of their mirror images
                none fewer than 0.38
    sizes       of the known markers' extent, against that of a body of 1.70 m that stands: a crouching child, a tall man with wide arms
    stiff       m, how much a marker moves on its own bone at most, in the choice of a segment
    reach       m, how much farther from the bone a segment is less likely by a standard deviation
    """

    frames: int = 10
    least: int = 6
    own: float = 1.5
    named: float = 0.020
    loose: float = 0.060
    spread: float = 0.012
    alike: float = 0.030
    far: float = 0.060
    astray: float = 0.25
    sizes: tuple[float, float] = (0.25, 2.0)
    stiff: float = 0.008
    reach: float = 0.030


RULES = PlaceRules()


@dataclass(frozen=True)
class LearnedPlaces:
    """Where the markers of a set sit.

    marker_set  the set, with its places
    known       markers whose landmark or segment was known beforehand, by the set's own table or by their names
    people      how many people showed the places
    miss        m, median distance of a marker from its place over all frames: how well the skeleton fits
    findings    what a person should know
    """

    marker_set: MarkerSet
    known: tuple[str, ...]
    people: int
    miss: float
    findings: tuple[Finding, ...]


def learn_places(
    marker_set: MarkerSet, recordings: Sequence[Recording], *, rules: PlaceRules = RULES, fit: PlaceFitRules = FIT_RULES
) -> LearnedPlaces:
    """Where a set's markers sit, from labelled recordings of one or several people: a standing trial, or any movement.

    A skeleton is laid on frames of each recording by the markers that are known: those with a place in the set, and those whose names
    shipped sets know. All others sit where they are seen on it. The two sides of a pair count as mirror images where they nearly are.
    Recordings of one subject (`subject_of`) are of one person. Raises AsterismError where too few markers are known or seen.
    """
    if not recordings:
        raise AsterismError("places are learned from a labelled recording; give one.")
    guessed, doubts = guess_places(marker_set, rules)
    people: dict[str, list[dict[str, tuple[str, Floats]]]] = {}
    misses: list[float] = []
    for recording in recordings:
        body, markers, places = lay_skeleton(marker_set, recording, guessed, doubts, rules, fit)
        seen = {name: (place.segment, np.array(place.at) + shift) for name, place, shift in zip(markers, places, body.shifts, strict=True)}
        people.setdefault(subject_of(recording), []).append(seen)
        misses.append(float(np.nanmedian(body.misses)))
    places_of, findings = _pooled(marker_set, people, guessed, rules)
    _check_names(recordings, guessed, places_of, findings, rules)
    findings += _supported(places_of, guessed, marker_set)
    known = tuple(name for name in marker_set.names if name in guessed)
    return LearnedPlaces(replace(marker_set, places=places_of), known, len(people), float(np.median(misses)), tuple(findings))


def guess_places(marker_set: MarkerSet, rules: PlaceRules, loose_names: float = 0.0) -> tuple[dict[str, Place], dict[str, float]]:
    """Markers whose place is about known, and how far it is doubted, m.

    loose_names: share of the names that a set must know for its markers to count that are on no landmark.
    """
    guessed, doubts = dict(marker_set.places), {name: rules.own * place.spread for name, place in marker_set.places.items()}
    spelled = {name: (name, *marker_set.aliases.get(name, ())) for name in marker_set.names}
    # Names mean different things in different sets: the set with most names in common is asked first.
    common = {
        other.title: np.mean([any(map(other.name_of, spelled[name])) for name in marker_set.names]) for other in shipped_sets().values()
    }
    shipped = sorted(shipped_sets().values(), key=lambda other: -common[other.title])
    for name in marker_set.names:
        for other in shipped:
            meant = next((found for s in spelled[name] if (found := other.name_of(s)) is not None and found in other.places), None)
            if name in guessed or meant is None:
                continue
            place = other.places[meant]
            if common[other.title] < loose_names and not _on_landmark(place):
                continue
            # A plate of a set that is not wholly worn is a group of markers.
            guessed[name] = place if common[other.title] == 1.0 else replace(place, plate="")
            doubts[name] = rules.loose if place.plate else rules.named
    return guessed, doubts


def _on_landmark(place: Place) -> bool:
    left = place.mirrored() if place.side == "right" or (not place.side and place.at[1] < 0) else place
    return any((known.segment, known.at) == (left.plain_segment, left.at) for known in landmarks().values())


def lay_skeleton(
    marker_set: MarkerSet,
    recording: Recording,
    guessed: Mapping[str, Place],
    doubts: Mapping[str, float],
    rules: PlaceRules,
    fit: PlaceFitRules,
) -> tuple[PlacedBody, list[str], list[Place]]:
    """The skeleton laid on a recording by the known markers, then by all: the body, its markers, and their guessed places."""
    where = str(recording.metadata.get("file", "the recording"))
    columns = marker_set.columns_of(recording.labels)
    positions = rotate_z_up(recording.positions, recording.vertical)
    worn = [name for name, column in zip(marker_set.names, columns, strict=True) if column >= 0]
    points = positions[:, columns[columns >= 0]]
    some = np.nonzero(np.isfinite(points[:, :, 0]).any(axis=0))[0]
    worn, points = [worn[i] for i in some], points[:, some]
    known = [name in guessed for name in worn]
    if sum(known) < rules.least:
        raise AsterismError(
            f"{where}: of its markers only {sum(known)} have a known place{_list([n for n, k in zip(worn, known, strict=True) if k])}, "
            f"{rules.least} are needed; write landmarks for more into the set's table [places], or give --landmark."
        )
    points = _full_frames(points, np.array(known), rules)
    if not len(points):
        raise AsterismError(f"{where}: no frame shows {rules.least} of the known markers; give a trial in which they are seen together.")
    column = [i for i, there in enumerate(known) if there]
    places = [guessed[worn[i]] for i in column]
    low, high = rules.sizes
    if not low < (size := size_against_standing(points[:, column], places)) < high:
        raise AsterismError(
            f"{where}: the markers are {size:,.2f} times as far apart as on a person of 1.70 m; check the unit of length, and the names."
        )
    doubt = np.array([_doubt(guessed[worn[i]], doubts[worn[i]], rules) for i in column])
    body = fit_places(points[:, column], places, doubt, fit)
    if all(known):
        return body, worn, places
    # What is not known by its name sits where it is seen on the skeleton.
    sides = {**{left: right for left, right in marker_set.pairs}, **{right: left for left, right in marker_set.pairs}}
    groups = _groups(marker_set, guessed)
    everything, all_doubts = [], []
    for i, name in enumerate(worn):
        if name in guessed:
            everything.append(guessed[name])
            all_doubts.append(_doubt(guessed[name], doubts[name], rules))
            continue
        other = sides.get(name)
        partner = points[:, worn.index(other)] if other in worn and other not in guessed else None
        place = _seen_place(body, points[:, i], partner, groups.get(name), rules)
        everything.append(place)
        all_doubts.append(_doubt(place, rules.loose, rules))
    return fit_places(points, everything, np.array(all_doubts), fit), worn, everything


def _full_frames(points: Floats, known: np.ndarray, rules: PlaceRules) -> Floats:
    """(F, M, 3): one frame of each of so many stretches, the one that shows most; only those that show enough known markers."""
    seen = np.isfinite(points[:, :, 0])
    stretches = [part for part in np.array_split(np.arange(len(points)), rules.frames) if len(part)]
    chosen = [part[int(np.argmax(seen[part].sum(axis=1)))] for part in stretches]
    return points[[t for t in chosen if seen[t, known].sum() >= rules.least]]


def _doubt(place: Place, metres: float, rules: PlaceRules) -> Floats:
    """(3,) standard deviations in the units of the place; wands stand anywhere along the bone."""
    doubt = np.full(3, metres)
    if place.limb:
        doubt[2] = (max(metres, rules.loose) if place.wand else metres) / LENGTHS[place.plain_segment]
    return doubt


def _groups(marker_set: MarkerSet, guessed: Mapping[str, Place]) -> dict[str, str]:
    """For markers without a place the segment on which the known ones of their group in the set's `segments` sit."""
    out: dict[str, str] = {}
    for members in marker_set.segments.values():
        on = Counter(guessed[name].segment for name in members if name in guessed)
        if on:
            out.update({name: on.most_common(1)[0][0] for name in members if name not in guessed})
    return out


# m, the bone of each segment: two ends, left side, and how thick the body is about it. Limbs go from their origin down.
_BONES: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "pelvis": ((0.0, -0.06, 0.06), (0.0, 0.06, 0.06), 0.11),
    "thorax": ((-0.01, 0.0, 0.08), (-0.01, 0.0, 0.40), 0.12),
    "head": ((0.01, 0.0, 0.10), (0.01, 0.0, 0.16), 0.10),
    "clavicle": ((0.0, 0.10, 0.02), (0.0, 0.16, 0.02), 0.05),
    "upper arm": ((0.0, 0.0, -0.05), (0.0, 0.0, -0.295), 0.05),
    "forearm": ((0.0, 0.0, -0.03), (0.0, 0.0, -0.25), 0.04),
    "hand": ((0.0, 0.0, -0.03), (0.0, 0.0, -0.16), 0.03),
    "thigh": ((0.0, 0.0, -0.03), (0.0, 0.0, -0.42), 0.08),
    "shank": ((0.0, 0.0, -0.03), (0.0, 0.0, -0.41), 0.05),
    "foot": ((-0.03, 0.0, -0.04), (0.15, 0.0, -0.05), 0.05),
}


def _seen_place(body: PlacedBody, points: Floats, partner: Floats | None, segment: str | None, rules: PlaceRules) -> Place:
    """Where a marker (F, 3) sits: on the segment on which it moves least and whose bone is nearest; with its partner of the other side."""
    best, found = np.inf, None
    for name in SEGMENTS if segment is None else (segment,):
        costs, at = _cost_on(body, points, name, rules)
        mirrored = other_side(name)
        if partner is not None and np.isfinite(partner).any():
            costs += _cost_on(body, partner, mirrored, rules)[0]
        if costs < best:
            best, found = costs, (name, at)
    assert found is not None
    name, at = found
    limits = [(-0.6, 0.6), (-0.6, 0.6), (-1.5, 0.5) if name.split()[-1] in ("arm", "forearm", "thigh", "shank") else (-0.6, 0.6)]
    ahead, left, up = (float(np.clip(value, low, high)) for value, (low, high) in zip(at, limits, strict=True))
    return Place(name, (ahead, left, up), rules.spread)


def _cost_on(body: PlacedBody, points: Floats, segment: str, rules: PlaceRules) -> tuple[float, Floats]:
    """How badly a marker fits a segment, and its mean place there in the units of places."""
    posed, scales = body.segments(), scales_of(body.sizes, segment)
    local = np.einsum("tji,tj->ti", posed.rotations[segment], points - posed.origins[segment])
    mean = np.nanmean(local, axis=0)
    # Farther from the joint skin and pose err more, so a marker may move by more there.
    moves = float(np.sqrt(np.nanmean(((local - mean) ** 2).sum(axis=1))))
    plain = segment.removeprefix("left ").removeprefix("right ")
    start, end, thick = _BONES[plain]
    side = -1.0 if segment.startswith("right ") else 1.0
    begin, along = np.array(start) * (1.0, side, 1.0), (np.array(end) - np.array(start)) * (1.0, side, 1.0)
    metres = mean / (scales[0], scales[1] if plain != "clavicle" else scales[0], scales[2] / (LENGTHS[plain] if plain in LIMBS else 1.0))
    share = float(np.clip((metres - begin) @ along / (along @ along), 0.0, 1.0))
    away = max(0.0, float(np.linalg.norm(metres - begin - share * along)) - thick)
    return (moves / rules.stiff) ** 2 + (away / rules.reach) ** 2, mean / scales


def _pooled(
    marker_set: MarkerSet,
    people: Mapping[str, Sequence[Mapping[str, tuple[str, Floats]]]],
    guessed: Mapping[str, Place],
    rules: PlaceRules,
) -> tuple[dict[str, Place], list[Finding]]:
    """The mean place of each marker over the people, both sides together where they are alike; and what is missing or far away."""
    findings: list[Finding] = []
    right_of = dict(marker_set.pairs)
    segments: dict[str, str] = {}
    seen: dict[str, Floats] = {}
    for name in marker_set.names:
        on = Counter(recording[name][0] for recordings in people.values() for recording in recordings if name in recording)
        if not on:
            findings.append(
                Finding(
                    "place-marker-unseen",
                    Severity.WARNING,
                    name,
                    f"{name} is seen in no recording and has no place.",
                    "Give a recording that shows it, or write its place by hand.",
                )
            )
            continue
        segments[name] = on.most_common(1)[0][0]
        # Each person once, however many recordings there are.
        seen[name] = np.array(
            [
                np.mean([recording[name][1] for recording in own], axis=0)
                for recordings in people.values()
                if (own := [r for r in recordings if name in r and r[name][0] == segments[name]])
            ]
        )
    places: dict[str, Place] = {}
    for name, at in seen.items():
        guess = guessed.get(name)
        spread = _spread(at, segments[name], guess, rules)
        wand, plate = (guess.wand, guess.plate) if guess is not None else (False, "")
        ahead, aside, up = (round(float(value), 4) for value in at.mean(axis=0))
        away = 0.0 if guess is None or guess.wand else metres_apart((ahead, aside, up), guess)
        try:
            places[name] = Place(segments[name], (ahead, aside, up), spread, wand, plate)
        except AsterismError:
            # No marker stands that far off a body: it is on something else, or on somebody else.
            away = np.inf
        if away > (rules.far if guess is None else max(rules.far, 3.0 * guess.spread)):
            findings.append(
                Finding(
                    "place-far-from-landmark",
                    Severity.WARNING,
                    name,
                    f"{name} sits {f'{1000 * away:.0f} mm from where its name says' if name in places else 'on no part of this body'}.",
                    "Check its label in the recordings, or what it is in the set's table [places].",
                )
            )
    for left, right in right_of.items():
        if left in places and right in places:
            _join_sides(places, left, right, rules)
    return {name: places[name] for name in marker_set.names if name in places}, findings


def _check_names(
    recordings: Sequence[Recording],
    guessed: Mapping[str, Place],
    places: Mapping[str, Place],
    findings: Sequence[Finding],
    rules: PlaceRules,
) -> None:
    """Raise AsterismError where so many markers are far from where their names say that the names are not of this body."""
    judged = [name for name in places if name in guessed and not guessed[name].wand]
    far = [finding.where for finding in findings if finding.code == "place-far-from-landmark" and finding.where in judged]
    if len(far) > max(2.0, rules.astray * len(judged)):
        where = str(recordings[0].metadata.get("file", "the recording"))
        raise AsterismError(
            f"{where}: {len(far)} of {len(judged)} markers ({', '.join(far[:5])}, ...) are far from where their names say: "
            "left and right are exchanged, the recording is mirrored, or the names are of another set; "
            "correct them, or say with --landmark what the markers are."
        )


def _spread(at: Floats, segment: str, guess: Place | None, rules: PlaceRules) -> float:
    """m: what three people or more differ by, else what is usual."""
    if len(at) < 3:
        return rules.spread if guess is None else guess.spread
    plain = segment.removeprefix("left ").removeprefix("right ")
    metres = (at - at.mean(axis=0)) * (1.0, 1.0, LENGTHS[plain] if plain in LIMBS else 1.0)
    # Wands differ in height by their nature, which is not this spread.
    varying = metres[:, :2] if guess is not None and guess.wand else metres
    return round(float(np.clip(np.sqrt((varying**2).sum(axis=0).mean() / (len(at) - 1)), 0.004, 0.05)), 4)


def metres_apart(at: Sequence[float] | Floats, place: Place) -> float:
    """m, how far a place (3,) in the units of `place` is from it."""
    scaled = np.subtract(at, place.at) * np.array([1.0, 1.0, LENGTHS[place.plain_segment] if place.limb else 1.0])
    return float(np.linalg.norm(scaled))


def _join_sides(places: dict[str, Place], left: str, right: str, rules: PlaceRules) -> None:
    """Make the two sides mirror images where they nearly are."""
    one, other = places[left], places[right].mirrored()
    if one.segment == other.segment and metres_apart(other.at, one) <= rules.alike:
        ahead, aside, up = (round(0.5 * (a + b), 4) for a, b in zip(one.at, other.at, strict=True))
        places[left] = replace(one, at=(ahead, aside, up), spread=max(one.spread, other.spread))
        places[right] = places[left].mirrored()


def _supported(places: Mapping[str, Place], guessed: Mapping[str, Place], marker_set: MarkerSet) -> list[Finding]:
    """Segments on which nothing was known beforehand: where their joints are is a guess."""
    known = {guessed[name].segment for name in marker_set.names if name in guessed}
    alone = sorted({place.segment for place in places.values()} - known)
    return [
        Finding(
            "place-segment-guessed",
            Severity.NOTE,
            segment,
            f"no marker of the {segment} was known beforehand: its pose is the usual one of a person who stands.",
            "Name a landmark of it in the set's table [places], or with --landmark.",
        )
        for segment in alone
    ]


def place_by_name(marker_set: MarkerSet) -> MarkerSet:
    """The set with places for those markers without one whose names, or aliases, a shipped set knows; others stay without.

    Names of markers on no landmark count only from a set that knows four fifths of the names: LTH1 is somewhere else in each laboratory.

    >>> place_by_name(MarkerSet(("LKNE", "RKNE", "hat"))).places["RKNE"].segment
    'right thigh'
    """
    guessed, _ = guess_places(marker_set, RULES, loose_names=0.8)
    return replace(marker_set, places={name: guessed[name] for name in marker_set.names if name in guessed})


def with_landmarks(marker_set: MarkerSet, given: Mapping[str, str]) -> MarkerSet:
    """The set with markers put on landmarks: {"MYKNEE": "left lateral epicondyle of femur"}.

    The left one of a pair stands for both, and its side need not be said. Raises AsterismError where the set has no such marker, or no
    landmark is called so.
    """
    text = "\n".join(f"{json.dumps(name)} = {json.dumps(landmark)}" for name, landmark in given.items())
    bare = replace(marker_set, places={})
    lines = bare.to_toml() + "\n[places]\n" + text
    told = MarkerSet.from_toml(lines, origin="--landmark").places
    places = {**marker_set.places, **told}
    return replace(marker_set, places={name: places[name] for name in marker_set.names if name in places})


def marker_set_of(recordings: Sequence[Recording], title: str) -> MarkerSet:
    """All named markers of recordings as a set; two whose names differ in a first L and R, or left and right, are a pair.

    Raises AsterismError where no point has a name.
    """
    labels = [without_subject(label) for recording in recordings for label in recording.labels if not is_unnamed(label)]
    names = {canonical(name): name for name in reversed(labels)}
    if not names:
        raise AsterismError("no point of the recordings has a name; label one of them, by hand in any program.")
    pairs = []
    for spelling, name in names.items():
        other = "right" + spelling[4:] if spelling.startswith("left") else "r" + spelling[1:] if spelling.startswith("l") else ""
        if other in names:
            pairs.append((name, names[other]))
    order = {name: i for i, name in reversed(list(enumerate(labels)))}
    listed = tuple(sorted(names.values(), key=lambda name: order[name]))
    return MarkerSet(listed, title=title, pairs=tuple(sorted(pairs, key=lambda pair: order[pair[0]])))


def _list(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""
