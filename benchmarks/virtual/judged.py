"""Labels and the truth in; what became of each file, by how sure the labels were, out.

`python -m benchmarks.virtual.judged MODEL --split tune` judges any model file in a minute.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.labelling import virtual_model
from asterism.labelling.recording_labeller import RecordingLabeller
from asterism.recording import NULL, Ints, Labelling, MarkerSet
from asterism.session.wider import wider_model
from benchmarks.recordings.walks import silence
from benchmarks.virtual.worn import JUDGE, TUNE, Worn, anonymous, recordings_of, sets

BINS = ((0.90, 0.95), (0.95, 0.99), (0.99, 1.01))
"""Confidences in which reliability is told; the last one's labels are called sure."""
LEAST = 0.95
"""A file of which fewer markers in view are right is counted."""


@dataclass
class Counts:
    """Labels: `visible` markers in view, `given`, `right`; `bins` (3, 2) given and right of each of `BINS`, all and `of_person`."""

    visible: int = 0
    given: int = 0
    right: int = 0
    files: int = 0
    refused: int = 0
    below: int = 0
    bins: Ints = field(default_factory=lambda: np.zeros((len(BINS), 2), dtype=np.int64))
    of_person: dict[str, Ints] = field(default_factory=dict)

    def __iadd__(self, other: Counts) -> Counts:
        for name in ("visible", "given", "right", "files", "refused", "below"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.bins = self.bins + other.bins
        for person, bins in other.of_person.items():
            self.of_person[person] = self.of_person.get(person, 0) + bins
        return self

    @property
    def right_share(self) -> float:
        """Of the markers in view."""
        return self.right / max(self.visible, 1)

    @property
    def wrong_share(self) -> float:
        """Of the labels given."""
        return (self.given - self.right) / max(self.given, 1)

    @property
    def sure_and_wrong(self) -> int:
        """Wrong labels at 0.99 or more."""
        return int(self.bins[-1, 0] - self.bins[-1, 1])


def counted(labelling: Labelling, truth: Ints, refused: bool = False, person: str = "") -> Counts:
    """The counts of one file of a person."""
    given = labelling.indices != NULL
    right = given & (labelling.indices == truth)
    bins = np.zeros((len(BINS), 2), dtype=np.int64)
    for row, (low, high) in enumerate(BINS):
        here = given & (labelling.confidence >= low) & (labelling.confidence < high)
        bins[row] = here.sum(), (here & right).sum()
    visible = int((truth != NULL).sum())
    below = int(right.sum() < LEAST * visible)
    return Counts(visible, int(given.sum()), int(right.sum()), 1, int(refused), below, bins, {person: bins})


def judged(model: asterism.MarkerModel, worn: Worn, hidden: int = 0, *, raw: bool = False, longest: int = 300) -> Counts:
    """What the model makes of a file, labelled as a whole; every marker is missed where the file is refused.

    raw: with the file's other points, which another shipped set may explain, as `asterism label --markers` does.
    """
    clouds, truth = anonymous(worn, hidden, raw=raw, longest=longest)
    try:
        wider = wider_model(model, clouds) if raw else None
        return counted(RecordingLabeller(model, wider=wider).label(clouds), truth)
    except AsterismError:
        return counted(silence(truth, model.marker_set.names), truth, refused=True, person=worn.person)


def summed(counts: Iterable[Counts]) -> Counts:
    """All of them together."""
    total = Counts()
    for one in counts:
        total += one
    return total


def line_of(name: str, counts: Counts) -> str:
    """Counts as a line: right, wrong, labels sure and wrong, right of each bin."""
    bins = "  ".join(f"{right}/{given}" for given, right in counts.bins.tolist())
    return (
        f"{name:70} right {100 * counts.right_share:7.3f}  wrong {100 * counts.wrong_share:6.3f}  sure and wrong {counts.sure_and_wrong:5}"
        f"  below 95: {counts.below}/{counts.files}{'  refused' if counts.refused else ''}  bins {bins}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge a model file on the recordings that wear its set. Returns 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.virtual.judged", description="Right and wrong by file, of any model.")
    parser.add_argument("model", help="a model file, or the name of a shipped set: its model of virtual people")
    parser.add_argument("--split", choices=(TUNE, JUDGE), default=TUNE, help="tune: movement without clinics; judge: never choose on it")
    parser.add_argument("--markers", choices=sets(), help="the set, where the model's names do not tell it")
    parser.add_argument("--kind", help="recordings of one kind, such as children or statics")
    parser.add_argument("--hidden", type=int, nargs="+", default=[0, 3], help="markers hidden at every moment")
    parser.add_argument("--frames", type=int, default=150, help="of each file at most, from its middle")
    parser.add_argument("--raw", action="store_true", help="as recorded: the file's other points stay in")
    given = parser.parse_args(arguments)
    model = virtual_model(given.model) if given.model in sets() else asterism.MarkerModel.load(given.model)
    markers = given.markers or next((name for name in sets() if MarkerSet.load(name).names == model.marker_set.names), None)
    if markers is None:
        parser.error(f"no listed set has the markers of {given.model}")
    started, pooled = time.process_time(), {hidden: Counts() for hidden in given.hidden}
    for worn in recordings_of(markers, given.split, given.kind):
        for hidden, total in pooled.items():
            counts = judged(model, worn, hidden, raw=given.raw, longest=given.frames)
            total += counts
            print(line_of(f"{worn.file} ({worn.kind}), {hidden} hidden", counts), flush=True)
    for hidden, total in pooled.items():
        print(line_of(f"{markers}, {given.split}, {hidden} hidden: all", total))
    print(f"{time.process_time() - started:.0f} s of CPU", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
