"""Labels and the truth in; false assignments, false occlusions, missed markers and the worth of the confidence out (thesis 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.reliability import ConfidenceTally
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from benchmarks.figures import Figure

BINS = 20
"""Bins of equal width between confidence 0 and 1."""


@dataclass
class Tally:
    """Counts that add up over recordings; the rates are fractions of them.

    frames    all that were labelled, as often as they were
    counted_once, recordings  different frames: those of nothing that was hidden anew, and those of each recording that was
    visible   markers whose point is in the cloud
    given     labels that were given
    right     labels that were given rightly
    missed    visible markers that got no label
    perfect   frames in which every visible marker got its point, and nothing else was labelled
    bins      (BINS, 3) of the given labels, by confidence: how many, sum of confidence, how many right
    by_confidence  the given labels for reliability, log score and Brier score: `by_confidence.score()`
    """

    frames: int = 0
    counted_once: int = 0
    recordings: dict[str, int] = field(default_factory=dict)
    visible: int = 0
    hidden: int = 0
    given: int = 0
    right: int = 0
    missed: int = 0
    perfect: int = 0
    bins: Floats = field(default_factory=lambda: np.zeros((BINS, 3)))
    by_confidence: ConfidenceTally = field(default_factory=ConfidenceTally)

    def add(self, labelling: Labelling, truth: Ints, person: str = "", recording: str = "") -> None:
        """Count one labelling, truth (T, M) as `simulate_occlusions` gives it.

        person     whose it is, for the intervals of the reliability
        recording  which one it is, where the same one is hidden anew and counted several times
        """
        given, there = labelling.indices != NULL, truth != NULL
        right = given & (labelling.indices == truth)
        self.frames += len(truth)
        if recording:
            self.recordings[recording] = max(len(truth), self.recordings.get(recording, 0))
        else:
            self.counted_once += len(truth)
        self.visible += int(there.sum())
        self.hidden += int((~there).sum())
        self.given += int(given.sum())
        self.right += int(right.sum())
        self.missed += int((there & ~given).sum())
        self.perfect += int((labelling.indices == truth).all(axis=1).sum())
        confidence = np.nan_to_num(labelling.confidence[given])
        which = np.clip((confidence * BINS).astype(np.int64), 0, BINS - 1)
        for column, weights in enumerate((np.ones(len(which)), confidence, right[given].astype(np.float64))):
            self.bins[:, column] += np.bincount(which, weights=weights, minlength=BINS)
        self.by_confidence.add(labelling.confidence, given, right, person)

    def __iadd__(self, other: Tally) -> Tally:
        for recording, frames in other.recordings.items():
            self.recordings[recording] = max(frames, self.recordings.get(recording, 0))
        for name in ("frames", "counted_once", "visible", "hidden", "given", "right", "missed", "perfect", "bins"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.by_confidence += other.by_confidence
        return self

    @property
    def distinct(self) -> int:
        """Different frames, however often each was hidden anew."""
        return self.counted_once + sum(self.recordings.values())

    def figure(self, row: str, asked: str, share: float) -> Figure:
        """A share of this tally as a figure, with the different frames behind it."""
        return Figure(row, asked, share, "fraction", self.distinct)

    @property
    def false_assignments(self) -> float:
        """Wrong labels among the labels given (FA)."""
        return _share(self.given - self.right, self.given)

    @property
    def false_occlusions(self) -> float:
        """Visible markers among the nulls (FO)."""
        return _share(self.missed, self.visible + self.hidden - self.given)

    @property
    def missed_share(self) -> float:
        """Visible markers that got no label, among the visible ones."""
        return _share(self.missed, self.visible)

    @property
    def right_share(self) -> float:
        """Visible markers that got their own point, among the visible ones."""
        return _share(self.right, self.visible)

    @property
    def perfect_share(self) -> float:
        """Frames without any mistake or omission."""
        return _share(self.perfect, self.frames)

    @property
    def calibration_error(self) -> float:
        """Expected calibration error of the given labels: |mean confidence - share right| over the bins, weighted by their counts."""
        return _share(float(np.abs(self.bins[:, 1] - self.bins[:, 2]).sum()), self.given)


def some_frames(clouds: Clouds, truth: Ints, frames: NDArray[np.int64]) -> tuple[Clouds, Ints]:
    """The clouds and the truth of these frames only, in this order."""
    counts = clouds.counts[frames]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    points = np.repeat(clouds.offsets[frames] - offsets[:-1], counts) + np.arange(offsets[-1])
    tracks = None if clouds.tracks is None else clouds.tracks[points]
    some = Clouds(clouds.xyz[points], offsets.astype(np.int64), clouds.rate, clouds.vertical, clouds.columns[points], tracks)
    return some, truth[frames]


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 0.0
