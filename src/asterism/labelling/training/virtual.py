"""A marker set that says where its markers sit in; labelled frames of virtual people who wear it, and models of them, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints, MarkerSet, Recording, worn_marker_sets

RATE = 50.0
"""Frames per second of virtual people. Not tuned: bodies are learned from single frames."""

FRAMES_EACH = 200
"""Frames of each virtual person: four of each of some fifty postures. Not tuned; people tell more than frames."""

STRANGERS_SEED = 1_000_003
"""What is added to the seed for people who teach nothing, and on whom the usual score is taken."""

STRANGERS = 10
"""Such people. The usual score of ten differs from that of forty by less than 0.1 nats a label."""


@dataclass(frozen=True)
class VirtualFrames:
    """Frames of virtual people: frames (N, M, 3) m, z up, NaN where the set does not say where a marker sits; people (N,) whose each is."""

    frames: Floats
    people: Ints


def virtual_frames(marker_set: MarkerSet, people: int, seed: int) -> VirtualFrames:
    """Labelled frames of so many virtual people. The same arguments give the same frames, bit for bit. O(people)."""
    from asterism.skeleton import virtual_people

    placed = tuple(name for name in marker_set.names if name in marker_set.places)
    worn = marker_set if len(placed) == len(marker_set) else _with_only(marker_set, placed)
    recordings: Sequence[Recording] = virtual_people(worn, people=people, frames=FRAMES_EACH, rate=RATE, seed=seed)
    frames = np.full((sum(len(recording) for recording in recordings), len(marker_set), 3), np.nan)
    frames[:, [marker_set.names.index(name) for name in placed]] = np.concatenate([recording.positions for recording in recordings])
    names = [str(recording.metadata["subject"]) for recording in recordings]
    number = {name: i for i, name in enumerate(sorted(set(names)))}
    whose = np.repeat([number[name] for name in names], [len(recording) for recording in recordings])
    return VirtualFrames(frames, whose.astype(np.int64))


def _with_only(marker_set: MarkerSet, names: Sequence[str]) -> MarkerSet:
    """A marker set of some of the markers."""
    return MarkerSet(
        tuple(names),
        marker_set.title,
        {name: others for name, others in marker_set.aliases.items() if name in names},
        tuple(pair for pair in marker_set.pairs if pair[0] in names and pair[1] in names),
        {segment: own for segment, members in marker_set.segments.items() if (own := tuple(m for m in members if m in names))},
        {name: place for name, place in marker_set.places.items() if name in names},
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
