"""The nouns of the house: arrays in; recordings, clouds, labellings and marker sets out."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_UNNAMED = re.compile(
    r"|\*.*|\d+|u\d+|x\d{2,}|(?:uname|unnamed|noname|unl|unlab|unlabel|unlabell?ed|unk|unknown|unid|unident|unidentified|ghost)[\s_:#-]*\d*\*?\d*",
    re.IGNORECASE,
)

NULL = -1
"""The null candidate: this marker has no point in this frame (the thesis' label 0)."""


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
class MarkerSet:
    """Which markers a body wears, and what laboratories call them.

    names     marker names in order: the columns of every `Labelling` made with this set
    aliases   for each name its other spellings; case, punctuation and a subject prefix never matter
    pairs     (left, right) names that mirror each other
    segments  segment name -> names of the markers on it
    """

    names: tuple[str, ...]
    title: str = ""
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    pairs: tuple[tuple[str, str], ...] = ()
    segments: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.names:
            raise AsterismError(f"marker set {self.title or '(unnamed)'} has no markers; list them under `markers`.")
        spelled: dict[str, str] = {}
        for name in self.names:
            for spelling in (name, *self.aliases.get(name, ())):
                known = spelled.setdefault(canonical(spelling), name)
                if known != name:
                    raise AsterismError(
                        f"marker set {self.title or '(unnamed)'}: {spelling!r} stands for both {known} and {name}; keep it for one."
                    )
        if len(set(self.names)) != len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise AsterismError(f"marker set {self.title or '(unnamed)'}: {twice} is listed twice; keep it once.")
        strangers = {m for pair in self.pairs for m in pair} | {m for ms in self.segments.values() for m in ms}
        strangers = (strangers | set(self.aliases)) - set(self.names)
        if strangers:
            raise AsterismError(
                f"marker set {self.title or '(unnamed)'}: {sorted(strangers)[0]} is named in aliases, pairs or segments "
                "but not among the markers; add it there or drop it here."
            )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def _name_of_spelling(self) -> dict[str, str]:
        return {canonical(s): name for name in self.names for s in (name, *self.aliases.get(name, ()))}

    def name_of(self, label: str) -> str | None:
        """The marker that a file's label means, or None. A subject prefix ("Ann:LKNE", "Ann_LKNE:") is looked through."""
        return self._name_of_spelling.get(canonical(label)) or self._name_of_spelling.get(canonical(without_subject(label)))

    def columns_of(self, labels: Sequence[str]) -> Ints:
        """For each marker the column that carries its label: (M,), -1 where there is none.

        Raises AsterismError where two columns claim one marker: it would be a guess which of them is right.
        """
        columns = np.full(len(self.names), -1, dtype=np.int64)
        index = {name: i for i, name in enumerate(self.names)}
        for column, label in enumerate(labels):
            name = self.name_of(label)
            if name is None:
                continue
            if columns[index[name]] >= 0:
                raise AsterismError(
                    f"points {columns[index[name]] + 1} and {column + 1} are both labelled {name}; rename or remove one of them."
                )
            columns[index[name]] = column
        return columns

    @classmethod
    def load(cls, source: str | Path | MarkerSet | Sequence[str]) -> MarkerSet:
        """A shipped set by name ("helen-hayes"), a TOML file by path, a list of names, or a set as it is.

        Raises AsterismError where the name is not shipped, or the file is missing or not a marker set.
        """
        if isinstance(source, MarkerSet):
            return source
        if not isinstance(source, str | Path):
            return cls(tuple(source), title="given names")
        if isinstance(source, str) and source in shipped_marker_sets():
            text = resources.files("asterism").joinpath("marker_sets", f"{source}.toml").read_text(encoding="utf-8")
            return cls.from_toml(text, origin=source)
        path = Path(source)
        if not path.is_file():
            raise AsterismError(
                f"marker set {str(source)!r} is neither shipped ({', '.join(shipped_marker_sets())}) nor a TOML file that exists."
            )
        return cls.from_toml(path.read_text(encoding="utf-8", errors="replace"), origin=str(path))

    @classmethod
    def from_toml(cls, text: str, origin: str) -> MarkerSet:
        """A marker set from its TOML text; `origin` names it in messages."""
        try:
            table = tomllib.loads(text)
            return cls(
                names=tuple(str(name) for name in table["markers"]),
                title=str(table.get("title", origin)),
                aliases={k: tuple(v) for k, v in table.get("aliases", {}).items()},
                pairs=tuple((str(left), str(right)) for left, right in table.get("pairs", [])),
                segments={k: tuple(v) for k, v in table.get("segments", {}).items()},
            )
        except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError) as problem:
            raise AsterismError(
                f"{origin} is not a marker set ({problem}); it is TOML with a list `markers`, perhaps `aliases`, `pairs` and `segments`."
            ) from problem


def shipped_marker_sets() -> tuple[str, ...]:
    """Names of the marker sets that come with Asterism."""
    folder = resources.files("asterism").joinpath("marker_sets")
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


def canonical(label: str) -> str:
    """A label without case and punctuation: R.ASIS, r_asis and RASIS are one."""
    return re.sub(r"[^\w*]|_", "", label.casefold())


def is_unnamed(label: str) -> bool:
    """Whether a label only counts points that nobody named: *12, uname*3, U7, Unlabeled:108, 20100, Unidentified, or nothing at all."""
    return _UNNAMED.fullmatch(without_subject(label).strip()) is not None


def without_subject(label: str) -> str:
    """A label without the subject's name before the last colon."""
    return label.rsplit(":", 1)[-1]


@dataclass(frozen=True)
class Clouds:
    """Unlabelled points, frame by frame, in one flat array.

    xyz       (P, 3) m, all points of all frames one after the other, all finite
    offsets   (T + 1,) int: frame t owns xyz[offsets[t]:offsets[t + 1]]
    rate      frames per second
    vertical  (3,) unit vector, up
    columns   (P,) int: the column of the recording that each point came from, -1 where it came from none
    tracks    (P,) int: the track that the camera system put each point into, -1 for none; or None where it gave no tracks at all.
              A track holds at most one point of a frame; it is a hint that may be wrong, never an identity
    """

    xyz: Floats
    offsets: Ints
    rate: float
    vertical: Floats
    columns: Ints
    tracks: Ints | None = None

    @classmethod
    def from_points(
        cls,
        points: Iterable[ArrayLike],
        rate: float,
        vertical: ArrayLike = (0.0, 0.0, 1.0),
        tracks: Iterable[ArrayLike] | None = None,
    ) -> Clouds:
        """Clouds from one (N_t, 3) array in metres per frame; N_t may be 0.

        tracks: one (N_t,) array of whole numbers per frame, the track that each point belongs to, -1 for none.
        Raises AsterismError where an array has another shape, a coordinate is not finite, or two points of a frame share a track.
        """
        frames = []
        for t, given in enumerate(points):
            frame = np.asarray(given, dtype=np.float64)
            if frame.size == 0:
                frame = frame.reshape(0, 3)
            if frame.ndim != 2 or frame.shape[1] != 3:
                raise AsterismError(f"frame {t}: points have shape {frame.shape}, expected (points, 3); transpose or split them.")
            if not np.isfinite(frame).all():
                raise AsterismError(f"frame {t}: a point is NaN or infinite; leave missing points out of the cloud.")
            frames.append(frame)
        counts = np.array([0, *map(len, frames)], dtype=np.int64)
        xyz = np.concatenate(frames) if frames else np.empty((0, 3))
        numbers = None if tracks is None else _checked_tracks(tracks, counts[1:])
        return cls(xyz, np.cumsum(counts), _checked_rate(rate), as_vertical(vertical), np.full(len(xyz), -1, dtype=np.int64), numbers)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, frame: int) -> Floats:
        """The points of one frame, (N_t, 3) m."""
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame {frame} of {len(self)}")
        frame %= len(self)
        return self.xyz[self.offsets[frame] : self.offsets[frame + 1]]

    def __iter__(self) -> Iterator[Floats]:
        return (self[t] for t in range(len(self)))

    @property
    def counts(self) -> Ints:
        """(T,) points per frame."""
        return np.diff(self.offsets)


@dataclass(frozen=True)
class Labelling:
    """Which candidate of its frame's cloud each marker is (the thesis' L, section 4.1).

    indices     (T, M) int, the candidate's place in the frame, -1 for none ("I do not know" or occluded)
    confidence  (T, M) in [0, 1]: the probability that this entry is right; for -1, the confidence of the best candidate that was not given
    names       (M,) marker names
    """

    indices: Ints
    confidence: Floats
    names: tuple[str, ...]

    def positions(self, clouds: Clouds) -> Floats:
        """The labelled trajectories: (T, M, 3) m, NaN where a marker has no candidate."""
        out = np.full((*self.indices.shape, 3), np.nan)
        frames, markers = np.nonzero(self.indices >= 0)
        out[frames, markers] = clouds.xyz[clouds.offsets[frames] + self.indices[frames, markers]]
        return out


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
        object.__setattr__(self, "rate", _checked_rate(self.rate))
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
                "or make one of the clouds with asterism.hiding.anonymous()."
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


def as_vertical(vertical: ArrayLike | str) -> Floats:
    """The unit vector that points up, from a vector or an axis name ("z", "-y").

    Raises AsterismError for anything else.
    """
    if isinstance(vertical, str):
        match = re.fullmatch(r"([+-]?)([xyz])", vertical.strip().casefold())
        if not match:
            raise AsterismError(f"vertical {vertical!r} is no axis; give x, y, z, -x, -y or -z.")
        vector = np.zeros(3)
        vector["xyz".index(match[2])] = -1.0 if match[1] == "-" else 1.0
        return vector
    vector = np.asarray(vertical, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or np.linalg.norm(vector) == 0:
        raise AsterismError("the vertical must be three finite numbers, not all zero; it points up.")
    return vector / np.linalg.norm(vector)


def _checked_tracks(tracks: Iterable[ArrayLike], counts: Ints) -> Ints:
    frames = [np.asarray(given) for given in tracks]
    if len(frames) != len(counts):
        raise AsterismError(f"tracks for {len(frames)} frames, points for {len(counts)}; give one array of track numbers per frame.")
    for t, (frame, count) in enumerate(zip(frames, counts, strict=True)):
        if frame.shape != (count,) and not frame.size == count == 0:
            raise AsterismError(f"frame {t}: track numbers have shape {frame.shape}, expected ({count},); give one per point.")
        if frame.size and not np.issubdtype(frame.dtype, np.integer):
            raise AsterismError(f"frame {t}: track numbers are {frame.dtype}, expected whole numbers; -1 is for none.")
        numbered = frame[frame >= 0]
        if len(np.unique(numbered)) < len(numbered):
            raise AsterismError(f"frame {t}: two points have the same track number; a track holds one point of a frame.")
    return np.concatenate([np.zeros(0, dtype=np.int64), *(frame.ravel().astype(np.int64) for frame in frames)])


def _checked_rate(rate: float) -> float:
    if not np.isfinite(rate) or rate <= 0:
        raise AsterismError(f"frame rate {rate} is not a positive number of frames per second; pass the right one.")
    return float(rate)
