"""Labels and the truth in; false assignments, false occlusions, and missed markers out (thesis 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.recording import NULL, Clouds, Ints, Labelling
from benchmarks.figures import Figure


@dataclass
class Tally:
    """Counts that add up over recordings; the rates are fractions of them.

    frames    all that were labelled, as often as they were
    counted_once, recordings  different frames: those of nothing that was hidden anew, and those of each recording that was
    visible   markers whose point is in the cloud
    given     labels that were given
    right     labels that were given rightly
    missed    visible markers that got no label
    """

    frames: int = 0
    counted_once: int = 0
    recordings: dict[str, int] = field(default_factory=dict)
    visible: int = 0
    hidden: int = 0
    given: int = 0
    right: int = 0
    missed: int = 0

    def add(self, labelling: Labelling, truth: Ints, recording: str = "") -> None:
        """Count one labelling, truth (T, M) as `simulate_occlusions` gives it.

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

    def __iadd__(self, other: Tally) -> Tally:
        for recording, frames in other.recordings.items():
            self.recordings[recording] = max(frames, self.recordings.get(recording, 0))
        for name in ("frames", "counted_once", "visible", "hidden", "given", "right", "missed"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
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
