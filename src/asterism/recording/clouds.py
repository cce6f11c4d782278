"""Unlabelled points of each frame, and labels for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording.arrays import Floats, Ints, as_vertical, check_offsets, checked_rate, frame_rows, same_values
from asterism.recording.display import Rows, as_html, as_text, duration, listed, significant
from asterism.recording.verdict import Verdict

NULL = -1
"""The null candidate: this marker has no point in this frame (the thesis' label 0)."""


@dataclass(frozen=True, repr=False, eq=False)
class Clouds:
    """Unlabelled points, frame by frame, in one flat array.

    xyz       (P, 3) m, all points of all frames one after the other, all finite
    offsets   (T + 1,) int: frame t has xyz[offsets[t]:offsets[t + 1]]
    rate      frames per second
    vertical  (3,) unit vector, up
    columns   (P,) int: the column of the recording that each point came from, -1 where it came from no column
    tracks    (P,) int: the track of each point by the camera system, -1 for none; None where the system gave no tracks.
              A track has at most one point in a frame. It may jump from one marker to another

    Two clouds are equal if all of these are.

    >>> clouds = Clouds.from_points([[[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]], [[0.0, 0.0, 1.1]]], rate=100.0)
    >>> clouds[1]
    array([[0. , 0. , 1.1]])
    >>> clouds.frames([0]).counts
    array([2])
    """

    xyz: Floats
    offsets: Ints
    rate: float
    vertical: Floats
    columns: Ints
    tracks: Ints | None = None

    def __post_init__(self) -> None:
        check_offsets(self.offsets, len(self.xyz), "points")

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

        >>> clouds = Clouds.from_points([[[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]], [[0.0, 0.0, 1.0]]], rate=100.0)
        >>> len(clouds), clouds.counts.tolist()
        (2, [2, 1])
        """
        frames = []
        for t, given in enumerate(points):
            frame = np.asarray(given, dtype=np.float64)
            if frame.size == 0:
                # An empty list has no second dimension of its own.
                frame = frame.reshape(0, 3)
            if frame.ndim != 2 or frame.shape[1] != 3:
                raise AsterismError(f"frame {t}: points have shape {frame.shape}, expected (points, 3); transpose or split them.")
            if not np.isfinite(frame).all():
                raise AsterismError(f"frame {t}: a point is NaN or infinite; leave missing points out of the cloud.")
            frames.append(frame)
        counts = np.array([0, *map(len, frames)], dtype=np.int64)
        xyz = np.concatenate(frames) if frames else np.empty((0, 3))
        # No point came from a column: the clouds were not made of a recording.
        numbers = None if tracks is None else _checked_tracks(tracks, counts[1:])
        return cls(xyz, np.cumsum(counts), checked_rate(rate), as_vertical(vertical), np.full(len(xyz), -1, dtype=np.int64), numbers)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Clouds):
            return NotImplemented
        return same_values(self, other, ("rate", "vertical", "offsets", "xyz", "columns", "tracks"))

    __hash__ = None  # type: ignore[assignment]

    def __getitem__(self, frame: int) -> Floats:
        """The points of one frame, (N_t, 3) m."""
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame {frame} of {len(self)}")
        # Negative frames count from the end, as in lists.
        frame %= len(self)
        return self.xyz[self.offsets[frame] : self.offsets[frame + 1]]

    def __iter__(self) -> Iterator[Floats]:
        return (self[t] for t in range(len(self)))

    @property
    def counts(self) -> Ints:
        """(T,) points per frame."""
        return np.diff(self.offsets)

    @property
    def frame_of(self) -> Ints:
        """(P,) the frame of each point."""
        return np.repeat(np.arange(len(self)), self.counts)

    def select(self, kept: NDArray[np.bool_]) -> Clouds:
        """The clouds with the points that `kept` (P,) marks. All frames stay, also those without a point."""
        # Frames stay also without a point: time must not be lost.
        before = np.concatenate([[0], np.cumsum(kept)])
        return replace(
            self,
            xyz=self.xyz[kept],
            offsets=before[self.offsets].astype(np.int64),
            columns=self.columns[kept],
            tracks=None if self.tracks is None else self.tracks[kept],
        )

    def frames(self, which: slice | ArrayLike) -> Clouds:
        """Some of the frames, in the order given: a slice, frame numbers or a mask (T,). The rate stays as it is."""
        rows, offsets = frame_rows(self.offsets, np.arange(len(self))[_index(which)])
        return replace(
            self,
            xyz=self.xyz[rows],
            offsets=offsets,
            columns=self.columns[rows],
            tracks=None if self.tracks is None else self.tracks[rows],
        )

    def _facts(self) -> Rows:
        counts = self.counts
        spread = f"{counts.min()} to {counts.max()}" if len(counts) else ""
        return (
            ("frames", duration(len(self), self.rate)),
            ("points per frame", spread),
            ("tracks", "" if self.tracks is None else str(len(np.unique(self.tracks[self.tracks >= 0])))),
        )

    def __repr__(self) -> str:
        return as_text("Clouds", self._facts())

    def _repr_html_(self) -> str:
        return as_html("Clouds", self._facts())


def _index(which: Any) -> Any:
    return which if isinstance(which, slice) else np.asarray(which)


@dataclass(frozen=True)
class Evidence:
    """The evidence of each point of clouds that cameras measured.

    residual      (P,) px, its reprojection error: RMS over its cameras of the distance between blob and projection
    covariance    (P, 3, 3) m2
    cameras       (P, C) bool: whether the point was computed from this camera
    camera_names  (C,)
    depth_scale   (P,) m/px: the length at the point that a pixel shows, mean over its cameras
    """

    residual: Floats
    covariance: Floats
    cameras: NDArray[np.bool_]
    camera_names: tuple[str, ...]
    depth_scale: Floats


@dataclass(frozen=True, repr=False, eq=False)
class Labelling:
    """Which candidate of its frame's cloud each marker is (the thesis' L, section 4.1).

    indices     (T, M) int, the candidate's place in the frame, -1 for none ("I do not know" or occluded)
    confidence  (T, M) in [0, 1]: the probability that this entry is right; for -1, that of the best candidate, which was not accepted;
                NaN where nothing is known about it
    names       (M,) marker names
    candidates  (T, M) int, for -1 the place of the best candidate, which was not accepted, or -1; None where they were not kept
    verdict     whether the recording shows what the model was trained on; None where it was not judged
    bodies      how many bodies with these markers the recording certainly shows; the labels are those of one of them
    stretches   in how many stretches a long recording was labelled

    Two labellings are equal if they give the same labels the same confidence: names, indices and confidence.
    """

    indices: Ints
    confidence: Floats
    names: tuple[str, ...]
    candidates: Ints | None = None
    verdict: Verdict | None = None
    bodies: int = 1
    stretches: int = 1

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Labelling):
            return NotImplemented
        return same_values(self, other, ("names", "indices", "confidence"))

    __hash__ = None  # type: ignore[assignment]

    def _facts(self) -> Rows:
        given = self.indices >= 0
        share = f"{significant(100 * given.mean(), 4)} % of {given.size}" if given.size else ""
        # Labels without a known confidence have none to be the lowest.
        stated = self.confidence[given & ~np.isnan(self.confidence)]
        lowest = f"{stated.min():.3f}" if stated.size else ""
        return (("frames", str(len(self.indices))), ("markers", listed(self.names)), ("labelled", share), ("lowest confidence", lowest))

    def __repr__(self) -> str:
        return as_text("Labelling", self._facts())

    def _repr_html_(self) -> str:
        return as_html("Labelling", self._facts())

    def findings(self, where: str = "the recording") -> list[Finding]:
        """What a person should know before they use the labels. where: the file."""
        found = list[Finding]()
        if self.bodies > 1:
            sentence = f"{where}: two bodies wear the model's markers, and only one of them was labelled."
            found.append(
                Finding("label-two-bodies", Severity.WARNING, where, sentence, "Give --model, or --markers without one, once for each.")
            )
        if self.verdict is not None:
            found += self.verdict.findings(where, labels=bool((self.indices >= 0).any()))
        if self.stretches > 1:
            sentence = f"{where} is long: it was labelled in {self.stretches} stretches, which were joined where they overlap."
            mend = "Nothing need be done; a label differs from that of the whole only where a stretch alone does not show what it is."
            found.append(Finding("label-in-stretches", Severity.NOTE, where, sentence, mend))
        return found

    def positions(self, clouds: Clouds) -> Floats:
        """The labelled trajectories: (T, M, 3) m, NaN where a marker has no candidate.

        >>> clouds = Clouds.from_points([[[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]]], rate=100.0)
        >>> labelling = Labelling(np.array([[1, -1]]), np.array([[0.998, 0.02]]), ("LKNE", "RKNE"))
        >>> labelling.positions(clouds)
        array([[[0.3, 0. , 1. ],
                [nan, nan, nan]]])
        """
        out = np.full((*self.indices.shape, 3), np.nan)
        frames, markers = np.nonzero(self.indices >= 0)
        out[frames, markers] = clouds.xyz[clouds.offsets[frames] + self.indices[frames, markers]]
        return out


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
        # -1 stands for no track and may repeat.
        if len(np.unique(numbered)) < len(numbered):
            raise AsterismError(f"frame {t}: two points have the same track number; a track has at most one point in a frame.")
    return np.concatenate([np.zeros(0, dtype=np.int64), *(frame.ravel().astype(np.int64) for frame in frames)])
