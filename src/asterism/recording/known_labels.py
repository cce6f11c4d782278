"""A labelling and the names that a file has already in; the labelling with the names that hold, and where the two disagree, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.recording.arrays import Ints
from asterism.recording.clouds import NULL, Clouds, Labelling
from asterism.recording.marker_set import MarkerSet, is_unnamed
from asterism.recording.trajectories import Recording


@dataclass(frozen=True)
class Disagreement:
    """Points that a file names otherwise than the model does.

    name         the marker that the file names
    given        the marker that the model's label names; None where it gives these points no label, but the file's marker to others
    first_frame  first frame concerned, counted from 0
    last_frame   last frame concerned
    frames       number of frames concerned
    """

    name: str
    given: str | None
    first_frame: int
    last_frame: int
    frames: int


def marker_of_columns(marker_set: MarkerSet, labels: Sequence[str]) -> Ints:
    """For each column the marker of the set that its label means: (C,), -1 for none, and where several columns have that marker's label."""
    index = {name: m for m, name in enumerate(marker_set.names)}
    markers = np.array([index.get(marker_set.name_of(label) or "", -1) for label in labels], dtype=np.int64)
    # A name that two columns have is of neither: which one is right is not known.
    counts = np.bincount(markers[markers >= 0], minlength=len(index))
    return np.where((markers >= 0) & (counts[markers] == 1), markers, -1)


def is_partly_labelled(recording: Recording, marker_set: MarkerSet) -> bool:
    """Whether a recording has points with names of the set, and points without a name.

    >>> half = Recording(np.zeros((1, 2, 3)), ("LKNE", "*2"), rate=100.0)
    >>> is_partly_labelled(half, MarkerSet(("LKNE", "RKNE")))
    True
    """
    shown = recording.visible.any(axis=0)
    named = marker_of_columns(marker_set, recording.labels) >= 0
    unnamed = np.array([is_unnamed(label) for label in recording.labels], dtype=np.bool_)
    return bool((named & shown).any() and (unnamed & shown).any())


def check_labels(
    labelling: Labelling, recording: Recording, clouds: Clouds, marker_set: MarkerSet
) -> tuple[Labelling, tuple[Disagreement, ...]]:
    """The labelling with those names of the recording that nothing contradicts, and the names that the labelling contradicts.

    clouds      the clouds that were labelled: `recording.clouds()`
    marker_set  its names are the labelling's, in order; its aliases say which of the recording's labels mean a marker

    A point keeps its name where the labelling gives neither the point another marker nor the marker another point. Its confidence is that
    of the labelling where this point was its best candidate, else NaN: not known. A name that two columns have counts for neither. O(P).
    """
    marker_of_column = marker_of_columns(marker_set, recording.labels)
    own = np.where(clouds.columns >= 0, marker_of_column[clouds.columns], -1)
    given_frames, given_markers = np.nonzero(labelling.indices >= 0)
    label = np.full(len(clouds.xyz), NULL, dtype=np.int64)
    label[clouds.offsets[given_frames] + labelling.indices[given_frames, given_markers]] = given_markers
    named = np.nonzero(own >= 0)[0]
    frames, places = clouds.frame_of[named], named - clouds.offsets[clouds.frame_of[named]]
    elsewhere = labelling.indices[frames, own[named]] >= 0
    # A name stays only where the model gave neither the point nor the marker another label.
    kept = (label[named] == NULL) & ~elsewhere
    against = (label[named] != own[named]) & ~kept
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    at = frames[kept], own[named][kept]
    proposed = np.full(len(at[0]), NULL) if labelling.candidates is None else labelling.candidates[at]
    # The confidence is that of this point; where it was not the best candidate, nothing is known.
    confidence[at] = np.where(proposed == places[kept], confidence[at], np.nan)
    indices[at] = places[kept]
    found = _grouped(own[named][against], label[named][against], frames[against], labelling.names)
    return replace(labelling, indices=indices, confidence=confidence), found


def _grouped(own: Ints, given: Ints, frames: Ints, names: Sequence[str]) -> tuple[Disagreement, ...]:
    """Disagreements by pairs of markers, those of most frames first."""
    found = []
    for marker, other in sorted(set(zip(own.tolist(), given.tolist(), strict=True))):
        here = np.unique(frames[(own == marker) & (given == other)])
        found.append(Disagreement(names[marker], names[other] if other >= 0 else None, int(here[0]), int(here[-1]), len(here)))
    return tuple(sorted(found, key=lambda each: -each.frames))
