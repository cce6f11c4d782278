"""A marker set that says where its markers sit in; labelled frames of virtual people who wear it, and models of them, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints, MarkerSet, Place, Recording, worn_marker_sets

VIRTUAL_PEOPLE = 80
"""Virtual people who teach a model. With 20, 40 and 80 of them 1, 10 and 60 % of the labels of real people reached a confidence of 0.99,
with 39 markers; forty are learned from in 3 s, eighty in 5 s."""

RATE = 50.0
"""Frames per second of virtual people. Not tuned: bodies are learned from single frames."""

FRAMES_EACH = 200
"""Frames of each virtual person: four of each of some fifty postures. Not tuned; people tell more than frames."""

STRANGERS_SEED = 1_000_003
"""What is added to the seed for people who teach nothing, and on whom the usual score is taken."""

STRANGERS = 10
"""Such people. The usual score of ten differs from that of forty by less than 0.1 nats a label."""

NEIGHBOUR_SPREAD = 0.015
"""m, standard deviation among people of a marker whose place was taken from the recordings: twice that of one on a bony point, since one or
two people have shown it. At half, people who wear it elsewhere are foreign; at double, neighbours on a segment are exchanged."""

NEIGHBOURS = 6
"""Placed markers among which three are sought to put a marker by. Not tuned."""

FEWEST_FRAMES = 10
"""Frames that must show a marker beside three others. Not tuned: as many as a training needs."""

STEADY = 0.02
"""Share of a distance by which distances within a segment vary on their own, so that of steady markers the nearest is taken. Not tuned."""

LEAST_SINE = 0.2
"""Of the angle in a triangle by which a marker is put: below 12 degrees its axes are noise. Not tuned."""


@dataclass(frozen=True)
class VirtualFrames:
    """Frames of virtual people: frames (N, M, 3) m, z up, NaN where the set does not say where a marker sits; people (N,) whose each is."""

    frames: Floats
    people: Ints


def virtual_frames(marker_set: MarkerSet, people: int, seed: int) -> VirtualFrames:
    """Labelled frames of so many virtual people, not to be written to. The same arguments give the same frames, bit for bit. O(people)."""
    return _drawn(_SetByText(repr(marker_set), marker_set), people, seed)


@dataclass(frozen=True)
class _SetByText:
    """A marker set by which frames are kept."""

    text: str
    marker_set: MarkerSet = field(compare=False)


# Whoever teaches a model again and again draws the same people each time, which takes a second; two sets' frames are 40 MB at most.
@lru_cache(maxsize=2)
def _drawn(worn_set: _SetByText, people: int, seed: int) -> VirtualFrames:
    from asterism.skeleton import virtual_people

    marker_set = worn_set.marker_set
    placed = tuple(name for name in marker_set.names if name in marker_set.places)
    worn = marker_set if len(placed) == len(marker_set) else with_only(marker_set, placed)
    recordings: Sequence[Recording] = virtual_people(worn, people=people, frames=FRAMES_EACH, rate=RATE, seed=seed)
    frames = np.full((sum(len(recording) for recording in recordings), len(marker_set), 3), np.nan)
    frames[:, [marker_set.names.index(name) for name in placed]] = np.concatenate([recording.positions for recording in recordings])
    names = [str(recording.metadata["subject"]) for recording in recordings]
    number = {name: i for i, name in enumerate(sorted(set(names)))}
    whose = np.repeat([number[name] for name in names], [len(recording) for recording in recordings]).astype(np.int64)
    for kept in (frames, whose):
        kept.flags.writeable = False
    return VirtualFrames(frames, whose)


def with_known_places(marker_set: MarkerSet) -> MarkerSet:
    """The marker set with places: its own, or those of the shipped set that knows most of its names; as it is where none knows half."""
    if marker_set.places:
        return marker_set
    known: dict[str, Place] = {}
    for worn in worn_marker_sets(marker_set.names):
        shipped = MarkerSet.load(worn.name)
        meant = {name: shipped.name_of(name) for name in marker_set.names}
        places = {name: shipped.places[marker] for name, marker in meant.items() if marker is not None and marker in shipped.places}
        # Of sets that know as many, the first is the one whose spelling the names have.
        if len(places) > len(known):
            known = places
    return replace(marker_set, places=known) if 2 * len(known) >= len(marker_set) else marker_set


def placed_by_neighbours(virtual: VirtualFrames, frames: Floats, seed: int) -> VirtualFrames:
    """The frames of virtual people with the markers that have no place put where real people wear them.

    virtual  with NaN for these markers
    frames   (N, M, 3) m, of real people

    A marker sits where it does in the axes of the three placed markers from which its distances vary least, scaled by their triangle, and
    `NEIGHBOUR_SPREAD` away from there for each person. One that is never seen beside three of them stays NaN. O(M^2 N).
    """
    filled, rng = virtual.frames.copy(), np.random.default_rng(seed)
    placed: NDArray[np.bool_] = np.asarray(~np.isnan(virtual.frames[:, :, 0]).all(axis=0), dtype=np.bool_)
    for marker in np.nonzero(~placed)[0].tolist():
        three = _steadiest_three(frames, marker, placed)
        if three is None:
            continue
        axes, origin, size = _triangle_axes(frames[:, three])
        at = np.einsum("nij,ni->nj", axes, frames[:, marker] - origin) / size[:, None]
        place = np.nanmedian(at, axis=0)
        axes, origin, size = _triangle_axes(virtual.frames[:, three])
        apart = rng.normal(0.0, NEIGHBOUR_SPREAD, (int(virtual.people.max()) + 1, 3))[virtual.people]
        filled[:, marker] = origin + np.einsum("nij,nj->ni", axes, size[:, None] * place + apart)
    return VirtualFrames(filled, virtual.people)


def _steadiest_three(frames: Floats, marker: int, placed: NDArray[np.bool_]) -> Ints | None:
    """Three placed markers from which a marker's distances vary least, and which span a triangle; None where it is hardly seen by them."""
    distance = np.linalg.norm(frames - frames[:, marker : marker + 1], axis=2)
    often = (~np.isnan(distance)).sum(axis=0) >= FEWEST_FRAMES
    candidates = np.nonzero(placed & often)[0]
    spread = np.nanstd(distance[:, candidates], axis=0) / np.nanmean(distance[:, candidates], axis=0)
    # The nearest of those that are as steady: far ones turn small errors into large ones.
    score = (spread + STEADY) * np.nanmean(distance[:, candidates], axis=0)
    near = candidates[np.argsort(score, kind="stable")[:NEIGHBOURS]]
    for three in combinations(near.tolist(), 3):
        beside = ~np.isnan(frames[:, [*three, marker], 0]).any(axis=1)
        if beside.sum() < FEWEST_FRAMES:
            continue
        sides = np.stack(
            [frames[beside][:, three[1]] - frames[beside][:, three[0]], frames[beside][:, three[2]] - frames[beside][:, three[0]]]
        )
        lengths = np.linalg.norm(sides, axis=2)
        sine = np.linalg.norm(np.cross(*sides), axis=1) / (lengths[0] * lengths[1])
        if np.median(sine) > LEAST_SINE:
            return np.array(three, dtype=np.int64)
    return None


def _triangle_axes(corners: Floats) -> tuple[Floats, Floats, Floats]:
    """Axes (N, 3, 3) by column, middle (N, 3) and size (N,) of triangles with these corners (N, 3, 3) m."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first = one / np.linalg.norm(one, axis=1, keepdims=True)
    third = np.cross(one, other)
    third = third / np.linalg.norm(third, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(third, first), third], axis=2)
    size = np.linalg.norm(one, axis=1) + np.linalg.norm(other, axis=1)
    return axes, corners.mean(axis=1), size


def with_only(marker_set: MarkerSet, names: Sequence[str]) -> MarkerSet:
    """A marker set of some of the markers."""
    return MarkerSet(
        tuple(names),
        marker_set.title,
        {name: others for name, others in marker_set.aliases.items() if name in names},
        tuple(pair for pair in marker_set.pairs if pair[0] in names and pair[1] in names),
        {segment: own for segment, members in marker_set.segments.items() if (own := tuple(m for m in members if m in names))},
        {name: place for name, place in marker_set.places.items() if name in names},
        tuple(name for name in marker_set.optional if name in names),
    )


def check_places(marker_set: MarkerSet) -> None:
    """Raise AsterismError where the set does not say of every marker where it sits."""
    absent = [name for name in marker_set.names if name not in marker_set.places]
    if absent:
        few = ", ".join(absent[:6]) + (", ..." if len(absent) > 6 else "")
        raise AsterismError(
            f"{marker_set.title or 'the marker set'} does not say where {few} sit{'s' if len(absent) == 1 else ''}, so that no virtual "
            "person can wear it; add a line for each to the table [places] of its TOML file (`asterism body place` helps), or train on "
            "labelled recordings."
        )
