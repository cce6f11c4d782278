"""Labelled recordings and a marker set that says where its markers sit in; names that virtual people wear otherwise out.

A few dozen frames of each recording are labelled anew, as if no point had a name, by a model of virtual people. Where most frames give
markers' points the names of each other, the two ways to name them are held against each other by how likely they make the frames. Names
are right in most recordings, and few of the ways to exchange them are likely: an exchange is told where the frames say more than that, and
where they fit the other names as people usually fit theirs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from asterism.geometry import rotate_z_up
from asterism.labelling.audit.errors import ALWAYS, EXCHANGED, NAMED_OTHERWISE, LabelError
from asterism.labelling.body._score_kernels import best_pose
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.training.virtual import with_only
from asterism.labelling.virtual_model import virtual_model
from asterism.recording import NULL, Floats, Ints, MarkerSet, Recording, subject_of, worn_marker_sets
from asterism.recording.known_labels import marker_of_columns
from asterism.skeleton import place_by_name

EXCHANGED_RECORDINGS = 0.01
"""Share of recordings in which names are exchanged, before any is looked at. Not tuned: half or double of it moves what an exchange must
gain by 0.7 of some 10 nats."""

FRAMES = 400
"""Frames of all recordings together that are labelled anew, about. Bounds the time: two seconds at most with 40 markers."""

FRAMES_EACH = 40
"""Of one recording at most, evenly spread. Half as many find the same on the recordings of movement."""

FEWEST_EACH = 8
"""Of one recording at least, however many there are. Not tuned: a majority of them is no accident of one posture."""

FEWEST_MARKERS = 4
"""Markers that a frame must show to be labelled."""

ROUNDS_SHOWN = 4
"""Exchanges that the sentence about a recording lists; the others are counted."""


@dataclass(frozen=True)
class NamesAsked:
    """What virtual people say of names.

    errors  names that they wear otherwise, at most one for each recording
    worn    the marker set by which they were asked; None where they were not
    why     why they were not asked, as half a sentence; empty where they were
    """

    errors: tuple[LabelError, ...]
    worn: MarkerSet | None
    why: str = ""


def check_names(
    recordings: Sequence[Recording],
    marker_set: MarkerSet | None = None,
    *,
    subjects: Sequence[str] | None = None,
    known: Sequence[LabelError] = (),
) -> NamesAsked:
    """Names that are exchanged throughout recordings, by how virtual people wear the marker set. One recording is enough.

    marker_set  by default the shipped one that the labels of all recordings wear
    subjects    whose each is, for the errors; by default as `subject_of` says
    known       what `audit` found by real people: an exchange that they have told is not told again

    Markers without a place are left alone. The errors are hints, which remove nothing. O(frames labelled), besides the model of
    virtual people, which is made where `virtual_model` keeps none.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=60, seed=0)[0]
    >>> left, right = walk.labels.index("LKNE"), walk.labels.index("RKNE")
    >>> walk.positions[:, [left, right]] = walk.positions[:, [right, left]]
    >>> [error.markers for error in check_names([walk]).errors]
    [('RKNE', 'LKNE')]
    """
    worn, why = _placed_set(recordings, marker_set)
    if worn is None:
        return NamesAsked((), None, why)
    model, each = virtual_model(worn), max(FEWEST_EACH, min(FRAMES_EACH, FRAMES // max(1, len(recordings))))
    mirrored = {frozenset(worn.names.index(name) for name in pair) for pair in worn.pairs}
    errors = []
    for number, recording in enumerate(recordings):
        subject = subject_of(recording) if subjects is None else subjects[number]
        label_of = {marker: recording.labels[at] for at, marker in enumerate(marker_of_columns(worn, recording.labels)) if marker >= 0}
        found = _exchanged(model.body_labeller, _some_frames(recording, worn, each), mirrored)
        rounds = [([label_of[marker] for marker in cycle.tolist()], gain) for cycle, gain in found]
        told = [set(error.markers) for error in known if error.recording == number and error.kind in (EXCHANGED, ALWAYS)]
        rounds = [(names, gain) for names, gain in rounds if not any(set(names) <= markers for markers in told)]
        if rounds:
            errors.append(_error(recording, number, subject, rounds))
    return NamesAsked(tuple(errors), worn)


def _placed_set(recordings: Sequence[Recording], marker_set: MarkerSet | None) -> tuple[MarkerSet | None, str]:
    """The markers that have a place, or None and why virtual people cannot wear them."""
    if marker_set is None:
        labels = tuple(dict.fromkeys(label for recording in recordings for label in recording.labels))
        worn = worn_marker_sets(labels)
        if not worn:
            return None, "no shipped marker set has these names"
        marker_set = MarkerSet.load(worn[0].name)
    placed = place_by_name(marker_set)
    names = [name for name in placed.names if name in placed.places]
    # Where few names are known, those that are may mean something else.
    if len(names) < FEWEST_MARKERS or 2 * len(names) < len(placed):
        return None, f"{marker_set.title or 'the marker set'} does not say where at least half of its markers sit"
    return placed if len(names) == len(placed) else with_only(placed, names), ""


def _some_frames(recording: Recording, worn: MarkerSet, most: int) -> Floats:
    """At most so many frames (N, M, 3) m, z up, evenly spread over those that show half of the markers that are ever seen."""
    columns = marker_of_columns(worn, recording.labels)
    known = np.nonzero(columns >= 0)[0]
    frames = np.full((len(recording), len(worn), 3), np.nan)
    frames[:, columns[known]] = rotate_z_up(recording.positions[:, known], recording.vertical)
    shown = ~np.isnan(frames[:, :, 0])
    enough = np.nonzero(shown.sum(axis=1) >= max(FEWEST_MARKERS, 0.5 * shown.any(axis=0).sum()))[0]
    chosen = np.unique(np.linspace(0, len(enough) - 1, min(len(enough), most)).round().astype(np.int64)) if len(enough) else enough
    return np.ascontiguousarray(frames[enough[chosen]])


def _exchanged(labeller: BodyLabeller, frames: Floats, mirrored: set[frozenset[int]]) -> list[tuple[Ints, float]]:
    """Markers that carry each other's names: the point of each is the next one's, the last one's the first's; and nats a frame.

    mirrored: pairs of a left and a right marker.
    """
    order = _usual_names(labeller, frames)
    cycles = _cycles(order)
    while cycles:
        named = _named_by(cycles, len(order))
        all_right = _scores(labeller, frames[:, named])
        gains = []
        for left_out in range(len(cycles)):
            # Beside the others, for a body of which much is wrong explains nothing.
            but = _named_by([*cycles[:left_out], *cycles[left_out + 1 :]], len(order))
            gains.append(float(np.median(all_right - _scores(labeller, frames[:, but]))))
        lacking = [_least_gain(cycle, mirrored, len(order)) - gain for cycle, gain in zip(cycles, gains, strict=True)]
        worst = int(np.argmax(lacking))
        if lacking[worst] <= 0.0:
            # A body upside down fits no names, and the least bad ones prove nothing.
            usual = labeller.settings.usual_score * (~np.isnan(frames[:, :, 0])).sum(axis=1)
            return list(zip(cycles, gains, strict=True)) if np.median(all_right - usual) >= 0.0 else []
        # The others are judged again without it.
        del cycles[worst]
    return []


def _least_gain(cycle: Ints, mirrored: set[frozenset[int]], markers: int) -> float:
    """Nats a frame from which an exchange is more likely than none.

    All frames of a person count as one: that he wears a marker elsewhere is one event. Left and right are exchanged as often as all other
    names together, so that there are about as many likely exchanges of two as markers, and of others as many as ways to choose them.
    """
    ways = 1 if len(cycle) == 2 and frozenset(cycle.tolist()) in mirrored else len(cycle)
    return ways * math.log(markers) - math.log(EXCHANGED_RECORDINGS)


def _usual_names(labeller: BodyLabeller, frames: Floats) -> Ints:
    """For each marker the one whose points most frames give its name: (M,), itself where none has a majority."""
    markers = frames.shape[1]
    shown = ~np.isnan(frames[:, :, 0])
    # Frames lie too far apart for their rate to matter.
    clouds = Recording(frames, tuple(map(str, range(markers))), rate=1.0).clouds()
    found = labeller.label(clouds).point_of
    votes = np.zeros((markers, markers))
    frame, given = np.nonzero(found != NULL)
    np.add.at(votes, (given, clouds.columns[clouds.offsets[frame] + found[frame, given]]), 1.0)
    # Points that got no name in most frames keep theirs; of equal votes, too.
    votes = np.where(votes > 0.5 * shown.sum(axis=0), votes, 0.0)
    votes[np.arange(markers), np.arange(markers)] += 0.5
    # A marker without a point took part in no exchange.
    seen = np.nonzero(shown.any(axis=0))[0]
    order = np.arange(markers)
    own, points = linear_sum_assignment(-votes[np.ix_(seen, seen)])
    order[seen[own]] = seen[points]
    return order


def _cycles(order: Ints) -> list[Ints]:
    """The rounds of two and more in which markers take each other's points."""
    cycles, left = [], set(np.nonzero(order != np.arange(len(order)))[0].tolist())
    while left:
        cycle = [min(left)]
        while (following := int(order[cycle[-1]])) != cycle[0]:
            cycle.append(following)
        left -= set(cycle)
        cycles.append(np.array(cycle, dtype=np.int64))
    return cycles


def _named_by(cycles: Sequence[Ints], markers: int) -> Ints:
    """(M,) the marker whose points each gets where these exchanges are undone."""
    order = np.arange(markers)
    for cycle in cycles:
        order[cycle] = np.roll(cycle, -1)
    return order


def _scores(labeller: BodyLabeller, frames: Floats) -> Floats:
    """(N,) nats, how likely frames are under their names. No point may be an outlier: a wrong name shows its full loss."""
    scores = np.zeros(len(frames))
    for number, frame in enumerate(frames):
        shown = ~np.isnan(frame[:, 0])
        rows = np.where(shown, np.cumsum(shown) - 1, NULL)
        workspace = make_body_workspace(int(shown.sum()), len(rows), labeller.body.load.shape[3])
        scores[number] = best_pose(labeller.body, np.ascontiguousarray(frame[shown]), rows, labeller.settings, workspace)[1]
    return scores


def _error(recording: Recording, number: int, subject: str, rounds: Sequence[tuple[list[str], float]]) -> LabelError:
    """All exchanges of a recording as one hint; rounds: the labels of each exchange, and its gain."""
    listed = "; ".join(f"{', '.join(names[:-1])} and {names[-1]}" for names, _ in rounds[:ROUNDS_SHOWN])
    listed += f"; and {len(rounds) - ROUNDS_SHOWN} such exchanges more" if len(rounds) > ROUNDS_SHOWN else ""
    words = f"{listed} carry each other's names in the whole recording, by where virtual people wear these markers"
    file = str(recording.metadata.get("file", f"recording {number + 1}"))
    names, gain = tuple(name for some, _ in rounds for name in some), sum(gain for _, gain in rounds)
    return LabelError(number, file, subject, 0, len(recording) - 1, names, NAMED_OTHERWISE, gain, words)
