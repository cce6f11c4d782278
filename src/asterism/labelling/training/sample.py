"""Labelled recordings in; the bounded sample of them that a model carries, so that it can learn on without its training files, out.

A recording is cut into clips of half a second on a grid of 1/32768 m, z up. Which clips are kept is decided by an order that each clip
carries with it, never by when it came: of each person the first ones in an order that spreads over each recording and treats the
recordings alike, up to a level at which the sample is full. So a sample of a sample and more is the sample of all:

    sample(sample(A) + B) = sample(A + B)

whatever was dropped on the way had so many clips before it that it would have been dropped from the whole, too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.recording import Floats, Ints, MarkerSet, Recording

Counts = NDArray[np.int32]

GRID = 2.0**-15
"""What the sample's positions are rounded to, in metres: 0.03 mm, a tenth of what cameras resolve."""
FARTHEST = 1e4
"""Positions beyond this (m) are refused: the unit of length is wrong."""
CLIP_SECONDS = 0.5
FEWEST_SHOWN = 3
"""Markers that a frame must show to be used: three points place a body."""
_MISSING = np.int32(-(2**31))


@dataclass(frozen=True)
class Clip:
    """Some consecutive frames of a recording.

    subject    who moves
    recording  the recording's digest: what it holds is who it is
    first      frame of the recording that the clip begins with
    rank       place in the order in which clips of a recording are kept
    rate       frames per second
    counts     (n, M, 3) positions in steps of `GRID`, z up; the least int32 where missing
    """

    subject: str
    recording: str
    first: int
    rank: int
    rate: float
    counts: Counts

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def positions(self) -> Floats:
        """(n, M, 3) m, z up, NaN where missing."""
        return np.where(self.counts == _MISSING, np.nan, self.counts * GRID)


@dataclass(frozen=True)
class Sample:
    """Clips in the order of subject, recording and frame."""

    clips: tuple[Clip, ...] = ()

    @property
    def subjects(self) -> tuple[str, ...]:
        """Whose clips these are, in order."""
        return tuple(dict.fromkeys(clip.subject for clip in self.clips))

    @property
    def recordings(self) -> tuple[str, ...]:
        """Digests of the recordings that the clips are from, in order."""
        return tuple(dict.fromkeys(clip.recording for clip in self.clips))

    def frames(self) -> tuple[Floats, Ints]:
        """All frames (N, M, 3) m, z up, and whose each is (N,): a number that counts `subjects`."""
        number = {subject: i for i, subject in enumerate(self.subjects)}
        people = np.repeat([number[clip.subject] for clip in self.clips], [len(clip) for clip in self.clips])
        return np.concatenate([clip.positions for clip in self.clips]), people.astype(np.int64)

    def stretches(self, labels: Sequence[str]) -> tuple[list[Recording], list[str]]:
        """Unbroken stretches of the recordings, clips that follow each other joined, and whose each is; z up."""
        joined: list[list[Clip]] = []
        for clip in self.clips:
            last = joined[-1][-1] if joined else None
            # Clips of a recording that follow each other are one stretch: gaps and ghosts last longer than a clip.
            if last is not None and (last.recording, last.first + len(last)) == (clip.recording, clip.first):
                joined[-1].append(clip)
            else:
                joined.append([clip])
        stretches = [
            Recording(np.concatenate([clip.positions for clip in run]), tuple(labels), run[0].rate, metadata={"subject": run[0].subject})
            for run in joined
        ]
        return stretches, [run[0].subject for run in joined]

    def with_recordings(
        self, recordings: Iterable[Recording], subjects: Iterable[str], marker_set: MarkerSet, per_person: int, in_all: int
    ) -> Sample:
        """The sample of these recordings and what is here already: about `per_person` frames of each person, about `in_all` of all.

        A recording given twice counts once, under the name that comes first in the alphabet. Raises AsterismError where a recording
        has none of the markers, or lies farther than `FARTHEST` from the origin.
        """
        clips = list(self.clips)
        for recording, subject in zip(recordings, subjects, strict=True):
            clips += _clips(recording, subject, marker_set)
        return Sample(tuple(_kept(clips, per_person, in_all)))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """As plain arrays that compress well: second differences along time, the bytes of equal weight together."""
        lengths = np.array([len(clip) for clip in self.clips], dtype=np.int64)
        counts = np.concatenate([clip.counts for clip in self.clips])
        missing = counts[:, :, 0] == _MISSING
        steps = np.concatenate([_differences(clip.counts) for clip in self.clips])
        # Bytes of equal weight together: the high ones are nearly all 0, which packs well.
        planes = np.ascontiguousarray(steps.reshape(-1, 1)).view(np.uint8).reshape(-1, 4).T
        return {
            "texts": np.frombuffer(
                "\n".join(f"{clip.recording} {_one_line(clip.subject)}" for clip in self.clips).encode(), dtype=np.uint8
            ),
            "numbers": np.stack([[clip.first for clip in self.clips], [clip.rank for clip in self.clips], lengths]),
            "rates": np.array([clip.rate for clip in self.clips]),
            "missing": np.packbits(missing),
            "planes": np.ascontiguousarray(planes),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], markers: int) -> Sample:
        """The inverse of `to_arrays`. Raises ValueError where the arrays do not fit each other or the number of markers."""
        lengths = arrays["numbers"][2]
        shape = (int(lengths.sum()), markers, 3)
        steps = np.ascontiguousarray(arrays["planes"].T).view(np.int32).reshape(shape)
        missing = np.unpackbits(arrays["missing"], count=shape[0] * shape[1]).reshape(shape[:2]).astype(np.bool_)
        first, rank, _ = arrays["numbers"]
        # Lengths of 0 would make two clips share their place.
        if (lengths < 1).any():
            raise ValueError("lengths of the clips disagree")
        clips = []
        texts = arrays["texts"].tobytes().decode().split("\n")
        ends = np.cumsum(lengths)
        for i, (text, rate) in enumerate(zip(texts, arrays["rates"].tolist(), strict=True)):
            rows = slice(ends[i] - lengths[i], ends[i])
            recording, subject = text.split(" ", 1)
            counts = np.where(missing[rows, :, None], _MISSING, _sums(steps[rows]))
            clips.append(Clip(subject, recording, int(first[i]), int(rank[i]), float(rate), counts))
        return cls(tuple(clips))


def _one_line(name: str) -> str:
    """A subject's name without line breaks, and with question marks for what is no character, as in file names that are not UTF-8."""
    return " ".join(name.encode("utf-8", "replace").decode().splitlines())


def _clips(recording: Recording, subject: str, marker_set: MarkerSet) -> list[Clip]:
    """A recording in clips that show something, each with its rank."""
    counts = _counts(recording, marker_set)
    # What a recording holds is who it is: the same file under another name counts once.
    digest = hashlib.sha256(counts.tobytes() + np.float64(recording.rate).tobytes()).hexdigest()[:20]
    length = max(1, round(CLIP_SECONDS * recording.rate))
    number = max(1, round(len(counts) / length))
    edges = (np.arange(number + 1) * len(counts)) // number
    shown = (counts[:, :, 0] != _MISSING).sum(axis=1) >= FEWEST_SHOWN
    # A clip without a usable frame teaches nothing and would fill the sample.
    some = [i for i in range(number) if shown[edges[i] : edges[i + 1]].any()]
    name = " ".join(str(subject).split())
    return [
        Clip(name, digest, int(edges[i]), rank, recording.rate, counts[edges[i] : edges[i + 1]])
        for i, rank in zip(some, _spreading_order(len(some)), strict=True)
    ]


def _counts(recording: Recording, marker_set: MarkerSet) -> Counts:
    columns = marker_set.columns_of(recording.labels)
    if (columns < 0).all():
        raise AsterismError(
            f"{recording.metadata.get('file', 'a recording')} has none of the model's markers ({', '.join(marker_set.names[:6])}, ...); "
            "give its points these names, or leave it out."
        )
    positions = rotate_z_up(recording.positions, recording.vertical)[:, columns]
    positions[:, columns < 0] = np.nan
    if np.nanmax(np.abs(positions), initial=0.0) > FARTHEST:
        raise AsterismError(
            f"{recording.metadata.get('file', 'a recording')} has positions beyond {FARTHEST / 1000:.0f} km; check its unit of length."
        )
    missing = np.isnan(positions)
    return np.where(missing, _MISSING, np.round(np.where(missing, 0.0, positions) / GRID).astype(np.int32))


def _spreading_order(number: int) -> Ints:
    """Each clip's place in an order whose beginnings are spread evenly over the recording: (number,)."""
    # Reversing the bits of the place puts any beginning of the order evenly over the recording.
    bits = max(1, int(number - 1).bit_length())
    at = np.arange(number) * 2**bits // max(1, number)
    reversed_at = sum(((at >> bit) & 1) << (bits - 1 - bit) for bit in range(bits))
    return np.argsort(np.argsort(reversed_at)).astype(np.int64)


def _kept(clips: Iterable[Clip], per_person: int, in_all: int) -> list[Clip]:
    """The clips that a full sample keeps: of each person those that begin below a level, frames counted in the order of ranks.

    The level is the lowest at which the sample holds `in_all` frames, `per_person` at most. More clips can only lower it and put others
    farther back, so what is dropped stays dropped.
    """
    once: dict[tuple[str, int], Clip] = {}
    for clip in clips:
        # The alphabet decides whose recording it is, not the order in which files were given.
        known = once.setdefault((clip.recording, clip.first), clip)
        if clip.subject < known.subject:
            once[clip.recording, clip.first] = clip
    queue = sorted(once.values(), key=lambda clip: (clip.subject, clip.rank, clip.recording))
    begins: list[int] = []
    totals: list[int] = []
    for _, own in groupby(queue, key=lambda clip: clip.subject):
        # Frames before each clip in its person's order: where it begins decides whether it is kept.
        ends = np.cumsum([len(clip) for clip in own]).tolist()
        begins += [0, *ends[:-1]]
        totals.append(ends[-1])
    level = min(per_person, _water_level(totals, in_all))
    kept = [clip for clip, begin in zip(queue, begins, strict=True) if begin < level]
    return sorted(kept, key=lambda clip: (clip.subject, clip.recording, clip.first))


def _water_level(totals: Sequence[int], in_all: int) -> int:
    """The lowest level up to which people's frames together reach `in_all`; beyond the largest total where they never do."""
    left = in_all
    for i, total in enumerate(sorted(totals)):
        people = len(totals) - i
        # People with fewer frames than their share leave the rest of it to the others.
        if total * people >= left:
            return -(-left // people)
        left -= total
    return max(totals, default=0) + 1


def _differences(counts: Counts) -> Counts:
    """Second differences along time, missing samples held; wraps around like all int32, and back again."""
    missing = counts == _MISSING
    last = np.where(missing, -1, np.arange(len(counts))[:, None, None])
    last = np.maximum.accumulate(last, axis=0)
    # A gap is held, since a jump to 0 and back would cost more bytes than it says.
    held = np.where(last >= 0, np.take_along_axis(counts, np.maximum(last, 0), axis=0), 0).astype(np.int32)
    steps = np.diff(held, axis=0, prepend=np.zeros_like(held[:1]))
    return np.diff(steps, axis=0, prepend=np.zeros_like(held[:1])).astype(np.int32)


def _sums(steps: Counts) -> Counts:
    return np.cumsum(np.cumsum(steps, axis=0, dtype=np.int32), axis=0, dtype=np.int32)
