"""What is labelled live, frame by frame as a session plays a file, against what `asterism label` makes of the same file afterwards."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import asterism
from asterism.live import AnalysedFrame, LiveSession, Replay, make_labeller
from asterism.recording import NULL, Ints, Labelling, Recording
from asterism.session import FileLabeller, LabellingOptions
from asterism.simulation import simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, file_of, gait, is_unnamed
from benchmarks.figures import Figure
from benchmarks.recordings.walks import Condition, Markers, full_body_subjects, unnumbered, unseen_model
from benchmarks.score import Tally

CONDITIONS = {"as recorded": Condition(), "3 hidden + 3 ghosts": Condition(3, 3)}
TRAINED: Mapping[str, Markers] = {
    "59 markers": GAIT_BODY,
    "53 markers": tuple(name for name in GAIT_BODY if name[1:] not in ("WRA", "WRB", "FIN")),
    "15 markers": "helen-hayes",
}
VIRTUAL = {"39 markers, virtual people": "plug-in-gait", "15 markers, virtual people": "helen-hayes"}
ASKED = {0: 0.5, 10: 0.1}
"""Delay in frames, and the points by which labels that come so late may be behind those of the whole recording."""
SECOND = "after the first second"


@dataclass
class Shares:
    """Labels of the same frames by `asterism label`, and live by the delay; those after the first second once more."""

    whole: dict[tuple[int, str], Tally] = field(default_factory=dict)
    live: dict[tuple[int, str], Tally] = field(default_factory=dict)

    def add(self, delay: int, part: str, whole: tuple[Labelling, Ints], live: tuple[Labelling, Ints]) -> None:
        """Count the labels of the same frames, each with the truth."""
        for tallies, (labelling, truth) in ((self.whole, whole), (self.live, live)):
            tallies.setdefault((delay, part), Tally()).add(labelling, truth)

    def __iadd__(self, other: Shares) -> Shares:
        for own, more in ((self.whole, other.whole), (self.live, other.live)):
            for key, tally in more.items():
                own.setdefault(key, Tally()).__iadd__(tally)
        return self

    def figures(self, row: str, *, asked: bool = False) -> Iterator[Figure]:
        """The points by which live is behind in right labels and ahead in wrong ones, of the visible markers."""
        for (delay, part), live in self.live.items():
            whole = self.whole[delay, part]
            name = f"{row}, delay {delay}{', ' if part else ''}{part}"
            bounds = (f"<= {ASKED[delay]}", "<= 0") if asked and not part else ("none", "none")
            yield live.figure(f"{name}: right", "none", live.right_share)
            yield Figure(f"{name}: right, behind `label`", bounds[0], 100 * (whole.right_share - live.right_share), "points", live.distinct)
            yield Figure(f"{name}: wrong, more than `label`", bounds[1], 100 * (_wrong(live) - _wrong(whole)), "points", live.distinct)


def share(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The subjects of the row `full-body`, each trial once: models that have not seen them, and virtual people."""
    total = Shares()
    subjects = full_body_subjects()[: 1 if benchmark.quick else None]
    with tempfile.TemporaryDirectory() as scratch:
        for name, markers in [*TRAINED.items()][2 if benchmark.quick else 0 :] + [*VIRTUAL.items()][1 if benchmark.quick else 0 :]:
            for condition, wanted in CONDITIONS.items():
                of_set = Shares()
                # One person's model of many markers takes a minute to train.
                for subject in subjects[: 2 if name in VIRTUAL or markers == "helen-hayes" else 1]:
                    model = None if name in VIRTUAL else unseen_model(benchmark, subject, markers)
                    for seed, trial in enumerate(trials(subject, markers)):
                        of_set += _of_trial(Path(scratch), model, str(markers), trial, wanted, seed)
                total += of_set
                yield from of_set.figures(f"live share, {name}, {condition}")
    yield from total.figures("live share, all", asked=True)


def trials(subject: str, markers: Markers) -> list[Recording]:
    """The subject's trials: the markers of the set first, then the points that the file holds without a name."""
    found = []
    for trial in gait(markers)[subject]:
        whole = asterism.read(file_of(trial)) if file_of(trial).exists() else trial
        extra = [column for column, label in enumerate(whole.labels) if is_unnamed(label)]
        positions = np.concatenate([trial.positions, whole.positions[:, extra]], axis=1)
        labels = (*trial.labels, *(f"*{column}" for column in extra))
        found.append(Recording(positions, labels, trial.rate, trial.vertical))
    return found


def _of_trial(scratch: Path, model: asterism.MarkerModel | None, markers: str, trial: Recording, condition: Condition, seed: int) -> Shares:
    """The labels of one file, by `asterism label` and live."""
    clouds, truth = simulate_gaps_and_ghosts(trial, condition.hidden, condition.ghosts, seed=seed)
    truth = truth[:, : sum(not is_unnamed(label) for label in trial.labels)]
    path = scratch / "trial.c3d"
    asterism.write(path, Recording.from_clouds(unnumbered(clouds)))
    labeller = FileLabeller([model]) if model else FileLabeller([], LabellingOptions(markers=[markers]))
    whole, shares, rate = labeller.label(path).labelling, Shares(), round(trial.rate)
    for delay in ASKED:
        rows = _Rows(truth.shape[1])
        make = make_labeller(model, None if model else markers, delay, "push")
        LiveSession(Replay(path, speed=float("inf")), make, [rows], delay, waits=True).run()
        live = Labelling(np.array(rows.indices), np.array(rows.confidence), whole.names)
        for part, first in (("", 0), (SECOND, rate)):
            # A file that was labelled whole, of the frames that were labelled live.
            frames = np.array([number >= first for number in rows.numbers])
            of_whole = np.array(rows.numbers)[frames]
            shares.add(
                delay,
                part,
                (_frames(whole, of_whole), truth[of_whole]),
                (_frames(live, np.nonzero(frames)[0]), truth[of_whole]),
            )
    return shares


@dataclass
class _Rows:
    """An output that keeps the labels of each frame."""

    markers: int
    numbers: list[int] = field(default_factory=list)
    indices: list[Ints] = field(default_factory=list)
    confidence: list[Ints] = field(default_factory=list)

    def send(self, frame: AnalysedFrame) -> None:
        labelled = frame.labelled
        self.numbers.append(labelled.frame.number)
        self.indices.append(labelled.indices if len(labelled.indices) else np.full(self.markers, NULL))
        self.confidence.append(labelled.confidence if len(labelled.indices) else np.zeros(self.markers))

    def close(self) -> None:
        pass


def _frames(labelling: Labelling, frames: Ints) -> Labelling:
    return Labelling(labelling.indices[frames], labelling.confidence[frames], labelling.names)


def _wrong(tally: Tally) -> float:
    return (tally.given - tally.right) / max(1, tally.visible)
