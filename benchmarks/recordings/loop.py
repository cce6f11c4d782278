"""From one trial to all subjects: label, let a person settle what review flags, learn, go on to what is least in doubt.

The model sees the truth of the others through the person's answers only. A label is *touched* where an answer changed it, on the piece
looked at or on a point that had its marker; *looked at* where the piece was flagged, right or not. All are shares of all samples to be
labelled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

import asterism
from asterism.labelling import ReviewItem, apply_answers, review
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import NULL, Clouds, Ints, Labelling, MarkerSet, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import file_of, gait
from benchmarks.figures import Figure
from benchmarks.score import Tally

HIDDEN, GHOSTS = 3, 3
"""Markers hidden in gaps, and ghost tracks there, at every moment."""
STARTS = 2
"""Subjects whose straight walk is the one trial, evenly spread."""
WORTH = 1.0
"""Samples that a look must be expected to mend, else the piece is not looked at."""
HASTE = 1
"""So many trials are done for each one with flagged pieces that is taken on before the model learns again."""

Answer = tuple[ReviewItem, str | None]


@dataclass(frozen=True)
class Trial:
    """One recording without labels, and the truth (T, M) about its clouds; the person asked knows it, the model never."""

    subject: str
    recording: Recording
    clouds: Clouds
    truth: Ints

    @property
    def samples(self) -> int:
        """Markers in view, over all frames."""
        return int((self.truth >= 0).sum())

    def marker_of_points(self, labels: Ints) -> Ints:
        """(P,) the marker of each point by labels (T, M), -1 for none."""
        marker_of = np.full(len(self.clouds.xyz), NULL, dtype=np.int64)
        frames, markers = np.nonzero(labels >= 0)
        marker_of[self.clouds.offsets[frames] + labels[frames, markers]] = markers
        return marker_of

    def answer(self, points: Ints) -> str | None:
        """What a person says of a piece: the marker that most of its points are, None for a ghost."""
        own = self.marker_of_points(self.truth)[points]
        known = own[own >= 0]
        return self.recording.labels[int(np.bincount(known).argmax())] if 2 * len(known) > len(own) else None

    def labelled(self, labelling: Labelling) -> Recording:
        """The recording as it is handed on to be learned."""
        return Recording(labelling.positions(self.clouds), labelling.names, self.clouds.rate, self.clouds.vertical)


@dataclass
class Course:
    """What a whole loop took and gave; before: by the one trial's model alone."""

    samples: int
    before: Tally = field(default_factory=Tally)
    after: dict[str, Tally] = field(default_factory=dict)
    looks: int = 0
    looked_at: int = 0
    touches: int = 0
    touched: int = 0

    @property
    def worst(self) -> float:
        """Share right of the subject that came off worst."""
        return min(tally.right_share for tally in self.after.values())


def loop(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The loop from each start."""
    people = list(gait())
    starts = people[:: len(people) // STARTS][: 1 if benchmark.quick else STARTS]
    yield from _figures(f"loop, {HIDDEN} hidden + {GHOSTS} ghosts, one trial labelled", list(benchmark.each(run, starts)))


def _figures(row: str, courses: Sequence[Course]) -> Iterator[Figure]:
    first, last = Tally(), Tally()
    for course in courses:
        first += course.before
        for tally in course.after.values():
            last += tally
    samples = sum(course.samples for course in courses)
    yield first.figure(f"{row}: right, by its model alone", "none", first.right_share)
    yield last.figure(f"{row}: right at the end", "none", last.right_share)
    yield last.figure(f"{row}: wrong at the end", "none", last.false_assignments)
    yield last.figure(f"{row}: right, the worst subject of all starts", ">= 0.999", min(c.worst for c in courses))
    yield Figure(f"{row}: labels touched by hand", "< 0.005", sum(c.touched for c in courses) / samples, "fraction", samples)
    yield Figure(f"{row}: answers for a start", "none", sum(c.touches for c in courses) / len(courses), "answers", len(courses))
    yield Figure(f"{row}: labels looked at", "none", sum(c.looked_at for c in courses) / samples, "fraction", samples)
    yield Figure(f"{row}: looks for a start", "none", sum(c.looks for c in courses) / len(courses), "looks", len(courses))


def run(benchmark: BenchmarkRun, start: str) -> Course:
    """One loop from a subject's straight walk; it ends with all trials labelled.

    At its end all are labelled once more by the model that has seen all, the answers stand, and what is flagged anew is settled.
    """
    trials = _trials(benchmark)
    one = next(trial for trial in trials if trial.subject == start and file_of(trial.recording).stem == "straight")
    waiting = [trial for trial in trials if trial is not one]
    course = Course(sum(trial.samples for trial in waiting))
    ensemble = asterism.MarkerModel.fit([one.recording], subjects=[start], miner=None, marker_set=MarkerSet(one.recording.labels))
    done: list[tuple[Trial, list[Answer]]] = []
    while waiting:
        looks = [_look(ensemble, trial) for trial in waiting]
        if not done:
            for trial, (labelling, _) in zip(waiting, looks, strict=True):
                course.before.add(labelling, trial.truth, recording=str(file_of(trial.recording)))
        # all in which nothing is flagged, else those least in doubt: they teach the model before the hard ones come
        doubt = [sum(item.gain for item in items) / len(trial.clouds.xyz) for trial, (_, items) in zip(waiting, looks, strict=True)]
        chosen = [i for i, much in enumerate(doubt) if not much]
        chosen = chosen or sorted(range(len(waiting)), key=doubt.__getitem__)[: max(1, len(done) // HASTE)]
        corrected = []
        for i in chosen:
            trial = waiting[i]
            settled, answers = _settled(trial, *looks[i], course)
            done.append((trial, answers))
            corrected.append(trial.labelled(settled))
        ensemble = ensemble.learn(corrected, subjects=[waiting[i].subject for i in chosen])
        waiting = [trial for i, trial in enumerate(waiting) if i not in chosen]
    for trial, given in done:
        labelling = apply_answers(ensemble.label(trial.clouds), trial.clouds, given)
        answered = {int(item.points[0]) for item, _ in given}
        items = [item for item in review(labelling, trial.clouds, least_gain=WORTH) if int(item.points[0]) not in answered]
        settled, _ = _settled(trial, labelling, items, course)
        course.after.setdefault(trial.subject, Tally()).add(settled, trial.truth, recording=str(file_of(trial.recording)))
    right = sum(tally.right for tally in course.after.values())
    benchmark.report(
        f"{start}: right {course.before.right_share:.5f}, then {right / course.samples:.5f}, "
        f"worst {course.worst:.5f}; touched {course.touched / course.samples:.5f} by {course.touches} of {course.looks} looks"
    )
    return course


def _trials(benchmark: BenchmarkRun) -> list[Trial]:
    """Everyone's trials without their labels."""
    out = []
    for subject, recordings in list(gait().items())[: 3 if benchmark.quick else None]:
        for number, recording in enumerate(recordings):
            clouds, truth = simulate_gaps_and_ghosts(recording, HIDDEN, GHOSTS, seed=1000 + number)
            out.append(Trial(subject, recording, clouds, truth))
    return out


def _look(ensemble: asterism.MarkerModel, trial: Trial) -> tuple[Labelling, list[ReviewItem]]:
    """The trial's labels and what a person should look at."""
    labelling = ensemble.label(trial.clouds)
    return labelling, review(labelling, trial.clouds, least_gain=WORTH)


def _settled(trial: Trial, labelling: Labelling, items: Sequence[ReviewItem], course: Course) -> tuple[Labelling, list[Answer]]:
    """The labelling after a person has looked at all that is flagged, and the answers; the course counts it."""
    answers: list[Answer] = []
    for item in items:
        answers.append((item, trial.answer(item.points)))
        after = apply_answers(labelling, trial.clouds, answers[-1:])
        changed = int((trial.marker_of_points(after.indices) != trial.marker_of_points(labelling.indices)).sum())
        course.looks += 1
        course.looked_at += item.samples
        course.touches += changed > 0
        course.touched += changed
        labelling = after
    return labelling, answers
