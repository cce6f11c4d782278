"""Labelled positions over time, with everything that must survive until they are written again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording.arrays import Floats, Ints, as_vertical, checked_rate, same_values
from asterism.recording.clouds import NULL, Clouds, Labelling
from asterism.recording.display import Rows, as_html, as_text, duration, listed, significant
from asterism.recording.marker_set import MarkerSet, is_unnamed
from asterism.recording.processing import ProcessingStep, labelled_live

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(frozen=True)
class Event:
    """Something that happens at one instant of a recording, such as a heel strike.

    `time` is in seconds on the file's clock (0 is the first sample of the trial, which need not be the first frame
    that is stored); `context` is the side or subject that the file names ("Left", "Right", "General", or empty).

    >>> Event("Foot Strike", time=1.25, context="Left")
    Event(label='Foot Strike', time=1.25, context='Left')
    """

    label: str
    time: float
    context: str = ""


def _kind_of(event: Event) -> tuple[str, str]:
    # Programs write Left, LEFT and L.
    return event.label.casefold(), event.context.casefold()[:1]


@dataclass(frozen=True, repr=False, eq=False)
class Recording:
    """Labelled positions over time, and everything that must survive until they are written again.

    positions  (T, M, 3) m, NaN where missing; the given array itself where it needs no change
    labels     (M,) names of the columns; markers of a set, or the names in a file
    rate       frames per second
    vertical   (3,) unit vector, up
    events     instants that the file marks
    metadata   values worth showing: file, format, units, subject, ...; `first_time`, in seconds, where a file
               gives its first frame another time than (first_frame - 1) / rate; `findings`, what its reader found out about a file
    source     the whole content of the file, for its writer, or None (belongs to `formats`)
    origin     (T, M) int: the point column of `source` that each sample came from, -1 where it came from none
    taken      the point columns of `source` that this recording replaces when it is written; the others stay
    first_frame  the number that the file gives the first frame; 1 for a trial that is stored from its start
    log        what was done to the recording since it was captured, oldest step first

    `asterism.report.plot_recording` plays one.

    Two recordings are equal if they show the same: positions, labels, rate, vertical, events and number of the first frame.

    >>> walk = Recording(np.zeros((200, 2, 3)), ("LKNE", "RKNE"), rate=100.0)
    >>> walk
    Recording(frames: 200 at 100 Hz (2 s), labels: LKNE, RKNE)
    >>> walk.select(["RKNE"]).frames(slice(50, 150)).times[[0, -1]]
    array([0.5 , 1.49])
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
    first_frame: int = 1
    log: tuple[ProcessingStep, ...] = ()

    def __post_init__(self) -> None:
        positions = np.asarray(self.positions, dtype=np.float64)
        if positions.ndim != 3 or positions.shape[2] != 3:
            raise AsterismError(f"positions have shape {positions.shape}, expected (frames, markers, 3).")
        if positions.shape[1] != len(self.labels):
            raise AsterismError(f"{len(self.labels)} labels for {positions.shape[1]} columns of positions; give one label per column.")
        known = np.isfinite(positions)
        # Each change of a recording makes a new one, so that what is whole is told at once.
        if not known.all():
            if np.isinf(positions).any():
                frame = int(np.nonzero(np.isinf(positions).any(axis=(1, 2)))[0][0])
                raise AsterismError(f"frame {frame}: a coordinate is infinite; write missing samples as NaN.")
            x, y, z = np.moveaxis(known, 2, 0)
            partly = (x | y | z) & ~(x & y & z)
            # A sample with one coordinate missing has no place: it is missing as a whole.
            if partly.any():
                positions = positions.copy()
                positions[partly] = np.nan
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "labels", tuple(self.labels))
        object.__setattr__(self, "rate", checked_rate(self.rate))
        object.__setattr__(self, "vertical", as_vertical(self.vertical))
        object.__setattr__(self, "first_frame", int(self.first_frame))

    @classmethod
    def from_clouds(cls, clouds: Clouds, labelling: Labelling | None = None) -> Recording:
        """Clouds as a recording that can be written to a file.

        Without a labelling its columns are *1, *2, ...: column n has the n-th point of each frame. Its `clouds()` are equal to the given
        ones, so a labelling of them fits `with_labelling`. With a labelling of these clouds the markers come first, and the
        points that no marker took follow.
        """
        column = np.arange(len(clouds.xyz)) - np.repeat(clouds.offsets[:-1], clouds.counts)
        positions = np.full((len(clouds), int(clouds.counts.max(initial=0)), 3), np.nan)
        positions[clouds.frame_of, column] = clouds.xyz
        labels = tuple(f"*{i + 1}" for i in range(positions.shape[1]))
        recording = cls(positions, labels, clouds.rate, clouds.vertical)
        return recording if labelling is None else recording.with_labelling(labelling)

    def __len__(self) -> int:
        return len(self.positions)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recording):
            return NotImplemented
        return same_values(self, other, ("labels", "rate", "first_frame", "events", "vertical", "positions"))

    __hash__ = None  # type: ignore[assignment]

    def _facts(self) -> Rows:
        file = str(self.metadata.get("file", ""))
        visible = self.visible
        missing = f"{significant(100 * (1 - visible.mean()), 2)} % of the samples" if visible.size and not visible.all() else ""
        return (
            ("file", file),
            ("frames", duration(len(self), self.rate)),
            ("first frame", str(self.first_frame) if self.first_frame != 1 else ""),
            ("labels", listed(self.labels)),
            ("missing", missing),
            ("events", str(len(self.events)) if self.events else ""),
            ("log", "; ".join(map(str, self.log))),
        )

    def __repr__(self) -> str:
        return as_text("Recording", self._facts())

    def _repr_html_(self) -> str:
        return as_html("Recording", self._facts())

    @property
    def times(self) -> Floats:
        """(T,) s on the file's clock, on which the events are: the first frame's time is that of its number, or `first_time`."""
        start = self.metadata.get("first_time")
        begin = float(start) if isinstance(start, int | float) and np.isfinite(start) else (self.first_frame - 1) / self.rate
        return begin + np.arange(len(self)) / self.rate

    def logged(self, action: str, by: str = "", **settings: Any) -> Recording:
        """The same recording with one more step in its processing log, see `ProcessingStep`."""
        return replace(self, log=(*self.log, ProcessingStep(action, by, settings)))

    def with_found(self, events: Sequence[Event]) -> Recording:
        """The same recording with events that were found, on its file's clock, in place of those of the same label and context.

        Only those within the frames are replaced: what lies outside was told from what is no longer here.
        """
        begin, end = self.times[[0, -1]] + np.array([-0.5, 0.5]) / self.rate
        told = {_kind_of(event) for event in events}
        kept = [event for event in self.events if _kind_of(event) not in told or not begin <= event.time <= end]
        return replace(self, events=tuple(sorted([*kept, *events], key=lambda event: event.time)))

    def to_dataframe(self) -> pandas.DataFrame:
        """The positions as a pandas table: an index of times in seconds, columns (label, axis), metres.

        Needs pandas, which Asterism does not install. Raises AsterismError where it is missing.
        """
        try:
            import pandas
        except ImportError:
            raise AsterismError("a data frame needs pandas; install it with `pip install pandas`.") from None
        columns = pandas.MultiIndex.from_product([self.labels, ["x", "y", "z"]], names=["label", "axis"])
        return pandas.DataFrame(self.positions.reshape(len(self), -1), pandas.Index(self.times, name="time_s"), columns)

    def to_xarray(self) -> xarray.DataArray:
        """The positions as an xarray array with the dimensions time (s), label and axis, metres; rate and vertical are attributes.

        Needs xarray, which Asterism does not install. Raises AsterismError where it is missing.
        """
        try:
            import xarray
        except ImportError:
            raise AsterismError("an xarray array needs xarray; install it with `pip install xarray`.") from None
        return xarray.DataArray(
            self.positions,
            dims=("time", "label", "axis"),
            coords={"time": self.times, "label": list(self.labels), "axis": ["x", "y", "z"]},
            name="position",
            attrs={"units": "m", "rate": self.rate, "vertical": self.vertical.tolist()},
        )

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What the reader of its file found, without its notes, which `asterism info` shows."""
        return tuple(finding for finding in self.metadata.get("findings", ()) if finding.severity > Severity.NOTE)

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(T, M) whether a sample is present."""
        return ~np.isnan(self.positions[:, :, 0])

    def clouds(self) -> Clouds:
        """The recording without its labels: the visible points of each frame, in column order.

        Each column is a track, unless the labels were given live: then a column has what was held for one marker, frame by frame.
        """
        visible = self.visible
        counts = np.concatenate([[0], visible.sum(axis=1)])
        return Clouds(
            xyz=np.ascontiguousarray(self.positions[visible]),
            offsets=np.cumsum(counts).astype(np.int64),
            rate=self.rate,
            vertical=self.vertical,
            columns=np.nonzero(visible)[1].astype(np.int64),
            tracks=None if labelled_live(self.log) is not None else np.nonzero(visible)[1].astype(np.int64),
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
        """Some of the frames as a new recording, without the source file (its analog data would no longer fit).

        `first_frame`, times and events follow. Frames at equal steps, such as every second one, keep the clock, and the rate falls with
        the step. Any other choice joins pieces: their frames follow each other at the old rate, and each event stays at its frame.
        Events whose frame is not chosen are left out.
        """
        chosen = np.arange(len(self))[which]
        kept = replace(self, positions=self.positions[which], source=None, origin=None, taken=())
        if not len(chosen):
            return replace(kept, events=())
        # Equal steps keep the clock: the rate falls with the step.
        steps = np.unique(np.diff(chosen))
        evenly = len(steps) == 0 or (len(steps) == 1 and steps[0] > 0)
        step = int(steps[0]) if evenly and len(steps) else 1
        times, first, metadata = self.times[chosen], self.first_frame + int(chosen[0]), dict(self.metadata)
        if step > 1:
            first = (first - 1) // step + 1
        if step > 1 or "first_time" in metadata:
            metadata["first_time"] = float(times[0])
        kept = replace(kept, rate=self.rate / step, first_frame=first, metadata=metadata)
        # Joined pieces follow each other at the old rate: each event moves with its frame.
        later = np.zeros(len(times)) if evenly else kept.times - times
        return replace(kept, events=_events_at(self.events, times, later, kept.rate))

    def with_labelling(self, labelling: Labelling, clouds: Clouds | None = None, *, keep_names: bool = False, by: str = "") -> Recording:
        """This recording's points under the labels that `labelling` gives them.

        The columns are the labelling's markers, then, as unlabelled columns *1, *2, ..., the samples that no marker took, each
        still apart from samples of other columns. With `keep_names`, such a column that had a name keeps it, if no marker has
        that name. `clouds` are the clouds that were labelled, by default `self.clouds()`. The source, events and metadata stay,
        and `by`, such as the model's file, goes into the processing log.
        Raises AsterismError where the clouds are not this recording's.

        >>> from asterism.recording import Labelling
        >>> cloud = Recording(np.array([[[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]]]), ("*1", "*2"), rate=100.0)
        >>> given = Labelling(np.array([[1]]), np.array([[0.998]]), ("LKNE",))
        >>> cloud.with_labelling(given).labels
        ('LKNE', '*1')
        """
        clouds = self.clouds() if clouds is None else clouds
        frames, markers = np.nonzero(labelling.indices >= 0)
        columns = clouds.columns[clouds.offsets[frames] + labelling.indices[frames, markers]]
        if (columns < 0).any():
            frame = frames[np.argmax(columns < 0)]
            raise AsterismError(
                f"frame {frame}: a labelled point came from no column of this recording; label the recording's own clouds(), "
                "or make one of the clouds with Recording.from_clouds()."
            )
        origin = self.origin if self.origin is not None else np.full(self.visible.shape, -1, dtype=np.int64)
        shape = labelling.indices.shape
        positions, new_origin = np.full((*shape, 3), np.nan), np.full(shape, -1, dtype=np.int64)
        positions[frames, markers] = self.positions[frames, columns]
        new_origin[frames, markers] = origin[frames, columns]
        # What no marker took stays in its column: nothing that was measured is lost.
        left = self.positions.copy()
        left[frames, columns] = np.nan
        rest = np.nonzero(~np.isnan(left[:, :, 0]).all(axis=0))[0]
        rest_origin = np.where(np.isnan(left[:, rest, 0]), -1, origin[:, rest])
        names = [f"*{i + 1}" for i in range(len(rest))]
        # A column keeps its name only where no marker of the labelling has it.
        if keep_names:
            before = [self.labels[column] for column in rest]
            names = [new if is_unnamed(old) or old in labelling.names else old for new, old in zip(names, before, strict=True)]
        return replace(
            self,
            positions=np.concatenate([positions, left[:, rest]], axis=1),
            labels=(*labelling.names, *names),
            origin=np.concatenate([new_origin, rest_origin], axis=1),
        ).logged("labelled", by)


def subject_of(recording: Recording) -> str:
    """The subject of a recording: `metadata["subject"]`, else the folder of its file."""
    return str(recording.metadata.get("subject") or PurePath(str(recording.metadata.get("file", ""))).parent)


def _events_at(events: Sequence[Event], times: Floats, later: Floats, rate: float) -> tuple[Event, ...]:
    """The events within half a frame of the chosen frames, each as much later as its frame.

    times (n,) s of the chosen frames on the old clock, later (n,) s by which each is later on the new one; `rate` frames per second.
    """
    moved = list[Event]()
    for event in events:
        nearest = int(np.argmin(np.abs(times - event.time)))
        # Half a frame: an event between two frames belongs to the nearer one.
        if abs(times[nearest] - event.time) <= 0.5 / rate:
            moved.append(replace(event, time=event.time + float(later[nearest])))
    return tuple(moved)


def keep_labels(labelling: Labelling, recording: Recording, clouds: Clouds, marker_set: MarkerSet) -> Labelling:
    """The labelling with the labels that the recording already has: only points without a name get one from the model.

    clouds      the clouds that were labelled: `recording.clouds()`, whose `columns` say where each point came from
    marker_set  its names are the labelling's, in order; its aliases say which of the recording's labels mean a marker

    Where a column of the recording is a marker of the set, its samples are that marker, with confidence 1. A label of the model
    is removed where it gives such a sample another name, gives the marker another point, or is on a column that has a name.
    Raises AsterismError where two columns of the recording have one marker's label.
    """
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    marker_of_column = np.full(len(recording.labels), -1, dtype=np.int64)
    columns = marker_set.columns_of(recording.labels)
    marker_of_column[columns[columns >= 0]] = np.nonzero(columns >= 0)[0]
    # Names that are no markers of the set are names, too: the model must not give them away.
    named = (marker_of_column >= 0) | np.array([not is_unnamed(label) for label in recording.labels], dtype=np.bool_)
    frame_of_point = clouds.frame_of
    marker_of_point = marker_of_column[clouds.columns]
    kept = np.nonzero(marker_of_point >= 0)[0]
    frames, markers = frame_of_point[kept], marker_of_point[kept]

    given_frames, given_markers = np.nonzero(indices >= 0)
    points = clouds.offsets[given_frames] + indices[given_frames, given_markers]
    # A label on a named column would contradict its name.
    removed = named[clouds.columns[points]]
    indices[given_frames[removed], given_markers[removed]] = NULL
    indices[frames, markers] = kept - clouds.offsets[frames]
    confidence[frames, markers] = 1.0
    return replace(labelling, indices=indices, confidence=confidence)
