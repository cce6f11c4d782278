"""Labelled positions over time, with everything that must survive until they are written again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording.arrays import Floats, Ints, as_vertical, checked_rate
from asterism.recording.clouds import NULL, Clouds, Labelling
from asterism.recording.marker_set import MarkerSet, is_unnamed


@dataclass(frozen=True)
class Event:
    """Something that happens at one instant of a recording, such as a heel strike.

    `time` is in seconds on the file's own clock (0 is the first sample of the trial, which need not be the first frame
    that is stored); `context` is the side or subject that the file names ("Left", "Right", "General", or empty).
    """

    label: str
    time: float
    context: str = ""


@dataclass(frozen=True)
class Recording:
    """Labelled positions over time, and everything that must survive until they are written again.

    positions  (T, M, 3) m, NaN where missing
    labels     (M,) names of the columns; markers of a set, or a file's own names
    rate       frames per second
    vertical   (3,) unit vector, up
    events     instants that the file marks
    metadata   plain values worth showing: file, format, units, subject, first frame, ...
    source     the file's whole content as its format keeps it, or None (belongs to `formats`)
    origin     (T, M) int: the point column of `source` that each sample came from, -1 where it came from none
    taken      the point columns of `source` that this recording stands for: a writer replaces those and keeps the others
    """

    positions: Floats
    labels: tuple[str, ...]
    rate: float
    vertical: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    events: tuple[Event, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    source: Any = None
    origin: Ints | None = None
    taken: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        positions = np.asarray(self.positions, dtype=np.float64)
        if positions.ndim != 3 or positions.shape[2] != 3:
            raise AsterismError(f"positions have shape {positions.shape}, expected (frames, markers, 3).")
        if positions.shape[1] != len(self.labels):
            raise AsterismError(f"{len(self.labels)} labels for {positions.shape[1]} columns of positions; give one label per column.")
        if np.isinf(positions).any():
            frame = int(np.nonzero(np.isinf(positions).any(axis=(1, 2)))[0][0])
            raise AsterismError(f"frame {frame}: a coordinate is infinite; write missing samples as NaN.")
        positions = np.where(np.isnan(positions).any(axis=2, keepdims=True), np.nan, positions)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "labels", tuple(self.labels))
        object.__setattr__(self, "rate", checked_rate(self.rate))
        object.__setattr__(self, "vertical", as_vertical(self.vertical))

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(T, M) whether a sample is there."""
        return ~np.isnan(self.positions[:, :, 0])

    def clouds(self) -> Clouds:
        """The recording without its labels: the visible points of each frame, in column order."""
        visible = self.visible
        counts = np.concatenate([[0], visible.sum(axis=1)])
        return Clouds(
            xyz=np.ascontiguousarray(self.positions[visible]),
            offsets=np.cumsum(counts).astype(np.int64),
            rate=self.rate,
            vertical=self.vertical,
            columns=np.nonzero(visible)[1].astype(np.int64),
            tracks=np.nonzero(visible)[1].astype(np.int64),
        )

    def select(self, names: Sequence[str]) -> Recording:
        """The same recording with these columns in this order. Raises AsterismError where a name is absent."""
        absent = [name for name in names if name not in self.labels]
        if absent:
            raise AsterismError(
                f"{self.metadata.get('file', 'recording')} has no column {absent[0]}; it has {', '.join(self.labels[:8])}, ..."
            )
        columns = [self.labels.index(name) for name in names]
        return replace(
            self,
            positions=self.positions[:, columns],
            labels=tuple(names),
            origin=None if self.origin is None else self.origin[:, columns],
        )

    def frames(self, which: slice | Sequence[int] | NDArray[Any]) -> Recording:
        """Some of the frames as a recording of its own, without the source file (its analog data would no longer fit)."""
        return replace(self, positions=self.positions[which], source=None, origin=None, taken=())

    def with_labelling(self, labelling: Labelling, clouds: Clouds | None = None, *, keep_names: bool = False) -> Recording:
        """This recording's points under the labels that `labelling` gives them.

        The columns are the labelling's markers, then, as unlabelled columns *1, *2, ..., the samples that no marker took, each
        still apart from samples of other columns: nothing is lost. With `keep_names` such a column that had a name keeps it, as
        long as no marker has it. `clouds` are the clouds that were labelled, by default `self.clouds()`. What the recording carries
        besides (source, events, metadata) goes on. Raises AsterismError where the clouds are not this recording's.
        """
        clouds = self.clouds() if clouds is None else clouds
        frames, markers = np.nonzero(labelling.indices >= 0)
        columns = clouds.columns[clouds.offsets[frames] + labelling.indices[frames, markers]]
        if (columns < 0).any():
            frame = frames[np.argmax(columns < 0)]
            raise AsterismError(
                f"frame {frame}: a labelled point came from no column of this recording; label the recording's own clouds(), "
                "or make one of the clouds with asterism.labelling.simulated_occlusions.anonymous()."
            )
        origin = self.origin if self.origin is not None else np.full(self.visible.shape, -1, dtype=np.int64)
        shape = labelling.indices.shape
        positions, new_origin = np.full((*shape, 3), np.nan), np.full(shape, -1, dtype=np.int64)
        positions[frames, markers] = self.positions[frames, columns]
        new_origin[frames, markers] = origin[frames, columns]
        left = self.positions.copy()
        left[frames, columns] = np.nan
        rest = np.nonzero(~np.isnan(left[:, :, 0]).all(axis=0))[0]
        rest_origin = np.where(np.isnan(left[:, rest, 0]), -1, origin[:, rest])
        names = [f"*{i + 1}" for i in range(len(rest))]
        if keep_names:
            own = [self.labels[column] for column in rest]
            names = [new if is_unnamed(old) or old in labelling.names else old for new, old in zip(names, own, strict=True)]
        return replace(
            self,
            positions=np.concatenate([positions, left[:, rest]], axis=1),
            labels=(*labelling.names, *names),
            origin=np.concatenate([new_origin, rest_origin], axis=1),
        )


def keep_labels(labelling: Labelling, recording: Recording, clouds: Clouds, marker_set: MarkerSet) -> Labelling:
    """The labelling with the labels that the recording has already: only points without a name take one from the model.

    clouds      the clouds that were labelled: `recording.clouds()`, whose `columns` say where each point came from
    marker_set  its names are the labelling's, in order; its aliases say which of the recording's labels mean a marker

    Where a column of the recording is a marker of the set, its samples are that marker, with confidence 1. A label of the model
    yields where it names such a sample otherwise, gives the marker another point, or falls on a column with a name of its own.
    Raises AsterismError where two columns of the recording claim one marker.
    """
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    marker_of_column = np.full(len(recording.labels), -1, dtype=np.int64)
    columns = marker_set.columns_of(recording.labels)
    marker_of_column[columns[columns >= 0]] = np.nonzero(columns >= 0)[0]
    named = (marker_of_column >= 0) | np.array([not is_unnamed(label) for label in recording.labels], dtype=np.bool_)
    frame_of_point = np.repeat(np.arange(len(clouds)), clouds.counts)
    marker_of_point = marker_of_column[clouds.columns]
    kept = np.nonzero(marker_of_point >= 0)[0]
    frames, markers = frame_of_point[kept], marker_of_point[kept]

    given_frames, given_markers = np.nonzero(indices >= 0)
    points = clouds.offsets[given_frames] + indices[given_frames, given_markers]
    yields = named[clouds.columns[points]]
    indices[given_frames[yields], given_markers[yields]] = NULL
    indices[frames, markers] = kept - clouds.offsets[frames]
    confidence[frames, markers] = 1.0
    return replace(labelling, indices=indices, confidence=confidence)
