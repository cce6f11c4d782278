"""How `asterism label` labels a C3D file of an hour: its frames in by ranges; the labelled file, written by ranges, and its row out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from asterism.cli._labelling import Labeller, findings_on_names, held_against_names, names_in_set, settled_names
from asterism.cli._options import KnownLabels
from asterism.findings import Finding
from asterism.formats import LabelConfidence
from asterism.formats.c3d import LabelledRanges, LabelSummary, LongRecording, ranges
from asterism.labelling import ReviewItem
from asterism.labelling.review_in_pieces import ReviewInPieces
from asterism.labelling.stretches import StretchRules, join_verdicts, label_in_stretches, stretches_of
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Disagreement, Floats, Ints, Labelling, MarkerSet, Recording, label_states
from asterism.recording.verdict import Verdict

_COMPACT = np.int32
"""Places of points in their frame: half of the memory."""


@dataclass(frozen=True)
class LongLabelled:
    """A file's labelling.

    labelling  of all frames
    counted    clouds of as many points, which are nowhere: what counts them takes no memory for their places
    subject    the trial by which the model was narrowed to the person; None where none was used
    known      what was done with the names of the file's points
    items      what a person should check first; without the points
    findings   what a person should know
    """

    labelling: Labelling
    counted: Clouds
    subject: Path | None
    known: KnownLabels | None
    items: Sequence[ReviewItem]
    findings: Sequence[Finding]


@dataclass
class _Found:
    """What labelling stretch by stretch has found so far.

    indices, confidence  (T, M) of all frames
    origins              (M, points of the file): how many samples of each marker came from each of them
    rest                 points of the file of which some samples have no label
    """

    marker_set: MarkerSet
    indices: Ints
    confidence: Floats
    origins: Ints
    review: ReviewInPieces
    rest: set[int] = field(default_factory=set)
    against: list[Disagreement] = field(default_factory=list)
    verdicts: list[tuple[int, Verdict]] = field(default_factory=list)

    @classmethod
    def of(cls, marker_set: MarkerSet, frames: int, points: int) -> _Found:
        shape = (frames, len(marker_set))
        origins = np.zeros((len(marker_set), points), dtype=np.int64)
        return cls(marker_set, np.full(shape, NULL, dtype=_COMPACT), np.zeros(shape), origins, ReviewInPieces(marker_set.names))

    def add(self, begin: int, labelling: Labelling, recording: Recording, clouds: Clouds) -> None:
        """Take in the labels of the frames from `begin` on, held against the names of the file; recording: these frames, so named."""
        some, markers = slice(begin, begin + len(clouds)), len(self.marker_set)
        self.indices[some], self.confidence[some] = labelling.indices, labelling.confidence
        origin = recording.with_labelling(labelling, clouds).origin
        if origin is not None:
            frame, marker = np.nonzero(origin[:, :markers] >= 0)
            np.add.at(self.origins, (marker, origin[frame, marker]), 1)
            self.rest |= set(origin[:, markers:].max(axis=0, initial=NULL).tolist())
        self.review.add(labelling, clouds)
        if labelling.verdict is not None:
            self.verdicts.append((int((labelling.indices >= 0).sum()), labelling.verdict))

    def labelling(self) -> Labelling:
        """The labels of all frames."""
        return Labelling(self.indices, self.confidence, self.marker_set.names, verdict=join_verdicts(self.verdicts))

    def disagreements(self) -> list[Disagreement]:
        """Those of all stretches, each pair of names once, those of most frames first."""
        joined = dict[tuple[str, str | None], Disagreement]()
        for each in self.against:
            pair = each.name, each.given
            before = joined.get(pair)
            joined[pair] = each if before is None else replace(before, last_frame=each.last_frame, frames=before.frames + each.frames)
        return sorted(joined.values(), key=lambda each: -each.frames)


def label_long_file(
    labeller: Labeller,
    path: Path,
    long: LongRecording,
    rules: StretchRules,
    *,
    known: KnownLabels | None = None,
    by: str = "",
    progress: Progress | None = None,
) -> tuple[LongLabelled, LabelledRanges]:
    """Label a recording by stretches, as `labelled_file` does as a whole; and the recording under its labels, for `write_long`.

    Raises SeveralBodies where a stretch shows two bodies.
    """
    counts, shown = long.shown()
    one_frame = long.one_frame(shown)
    parts = stretches_of(counts, one_frame.rate, rules)
    model, trial, findings = labeller.model_of(path, (long.frames(part).clouds() for part in parts))
    known = settled_names(one_frame, model.marker_set, known)
    found = _Found.of(model.marker_set, len(long), long.file.layout.points)
    for begin, labelling in label_in_stretches(
        partial(model.label_one_body, workers=labeller.workers), lambda part: long.frames(part).clouds(), parts, progress=progress
    ):
        recording = long.frames(slice(begin, begin + len(labelling.indices)))
        clouds = recording.clouds()
        held, named, against = held_against_names(path, recording, clouds, labelling, model.marker_set, known)
        found.against += [replace(d, first_frame=d.first_frame + begin, last_frame=d.last_frame + begin) for d in against]
        found.add(begin, held, named, clouds)
    labelling, counted = replace(found.labelling(), stretches=len(parts)), _counted(counts, one_frame)
    findings += labelling.findings(str(path))
    findings += findings_on_names(path, long.sampled, found.disagreements(), known)
    written = _written(long, found, labelling, counted, one_frame, known, by)
    return LongLabelled(labelling, counted, trial, known, found.review.items(), findings), written


def _counted(counts: Ints, recording: Recording) -> Clouds:
    """Clouds of so many points in each frame (T,), all at the origin."""
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    nowhere = np.broadcast_to(np.zeros(3), (int(offsets[-1]), 3))
    return Clouds(nowhere, offsets, recording.rate, recording.vertical, np.broadcast_to(np.int64(NULL), len(nowhere)))


def _written(
    long: LongRecording, found: _Found, labelling: Labelling, counted: Clouds, one_frame: Recording, known: KnownLabels | None, by: str
) -> LabelledRanges:
    """The recording under its labels: what `Recording.with_labelling` gives for all of it."""
    keep, marker_set = known is not KnownLabels.IGNORE, found.marker_set
    names = names_in_set(one_frame, marker_set, known)
    rest = sorted(found.rest - {NULL})
    blank = Labelling(np.full((1, len(marker_set)), NULL), np.zeros((1, len(marker_set))), marker_set.names)
    left = replace(long.one_frame(np.isin(long.columns, rest)), labels=names)
    head = left.with_labelling(blank, keep_names=keep, by=by)
    main = [int(counts.argmax()) if counts.any() else NULL for counts in found.origins] + rest

    def frames(some: slice) -> tuple[Recording, Floats]:
        here = replace(labelling, indices=labelling.indices[some], confidence=labelling.confidence[some])
        part = long.frames(some).with_labelling(here)
        origin = np.full((len(part), len(main)), NULL, dtype=np.int64)
        positions = np.full((*origin.shape, 3), np.nan)
        own = np.arange(len(marker_set))
        if part.origin is not None:
            own = np.concatenate([own, len(own) + np.searchsorted(rest, part.origin[:, len(own) :].max(axis=0, initial=NULL))])
            positions[:, own], origin[:, own] = part.positions, part.origin
        return replace(head, positions=positions, origin=origin), LabelConfidence.of_labelling(here).values

    return LabelledRanges(head, main, frames, marker_set.names, _summary(labelling, counted))


def _summary(labelling: Labelling, counted: Clouds) -> LabelSummary:
    """What the labels amount to, added up range by range."""
    summary = None
    for some in ranges(len(counted)):
        here = replace(labelling, indices=labelling.indices[some], confidence=labelling.confidence[some])
        part = LabelSummary.of(LabelConfidence.of_labelling(here), label_states(here, counted.frames(some)))
        summary = part if summary is None else summary.plus(part)
    if summary is None:
        raise ValueError("a recording without frames has no labels to sum up")
    return summary
