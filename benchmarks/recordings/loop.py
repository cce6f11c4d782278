"""From one labelled trial to all subjects: label, let a person settle what review flags, learn, go on to whom the model doubts least."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import asterism
from asterism.hiding import hide_in_gaps
from asterism.labelling import Item, review, settle
from asterism.recording import Clouds, Ints, Labelling, Recording
from benchmarks.bench import Bench
from benchmarks.data import file_of, gait
from benchmarks.figures import Figure
from benchmarks.score import Tally

PICTURE = Path(__file__).parents[2] / "docs" / "loop.svg"
CONDITIONS = {"as recorded": (0, 0), "3 hidden": (3, 0)}
WORTH = 1.0
"""Samples that a look must be expected to mend, else the piece is not looked at."""
BUDGETS: dict[str, int | None] = {"nothing": 0, "3 pieces per recording": 3, "all that is flagged": None}
STARTS = 6
"""Subjects whose straight walk is the one labelled trial, each in turn: every second one."""


@dataclass(frozen=True)
class Trial:
    """One recording without labels, and the truth (T, M) about its clouds; the person asked knows it, the model never."""

    subject: str
    recording: Recording
    clouds: Clouds
    truth: Ints

    def answer(self, item: Item) -> str | None:
        """What a person says of a piece: the marker that most of its points are, None for a ghost."""
        frames = np.searchsorted(self.clouds.offsets, item.points, side="right") - 1
        at, markers = np.nonzero(self.truth[frames] == (item.points - self.clouds.offsets[frames])[:, None])
        return self.recording.labels[int(np.bincount(markers).argmax())] if 2 * len(at) > len(frames) else None

    def labelled(self, labelling: Labelling) -> Recording:
        """The recording as it is handed on to be learned."""
        return Recording(labelling.positions(self.clouds), labelling.names, self.clouds.rate, self.clouds.vertical)


@dataclass
class Course:
    """What a whole loop took and gave. Looked at: flagged; touched: flagged, and the person changed a label."""

    start: str
    condition: str
    budget: str
    before: Tally
    after: Tally
    worst: tuple[float, str] = (1.0, "")
    pieces: int = 0
    looked_pieces: int = 0
    looked_samples: int = 0
    touched_pieces: int = 0
    touched_samples: int = 0
    samples: int = 0

    @property
    def error(self) -> float:
        """Markers in view that are not right at the end, and wrong labels of hidden ones, among all samples."""
        return (self.after.missed + self.after.given - self.after.right) / max(1, self.samples)


def loop(bench: Bench) -> Iterator[Figure]:
    """The loop from each start; draws docs/loop.svg in a full run."""
    starts = list(gait())[:: 11 // STARTS + 1][: 1 if bench.quick else None]
    tasks = [
        (start, condition, budget)
        for condition in CONDITIONS
        for budget in (BUDGETS if condition == "3 hidden" else list(BUDGETS)[-1:])
        for start in starts
    ]
    courses = list(bench.each(run, tasks))
    for condition in CONDITIONS:
        whole = [c for c in courses if c.condition == condition and c.budget == list(BUDGETS)[-1]]
        samples = sum(c.samples for c in whole)
        row = f"loop, {condition}"
        for course in whole:
            own = f"{row}, from {course.start}"
            yield Figure(f"{own}: right, the worst subject", ">= 0.999", course.worst[0], "fraction", course.samples)
            yield Figure(f"{own}: samples touched by hand", "< 0.005", course.touched_samples / course.samples, "fraction", course.samples)
            yield Figure(f"{own}: samples looked at", "none", course.looked_samples / course.samples, "fraction", course.samples)
            yield Figure(f"{own}: labels touched by hand, one per piece", "none", course.touched_pieces, "labels", course.pieces)
        first = Tally()
        last = Tally()
        for course in whole:
            first += course.before
            last += course.after
        yield Figure(f"{row}: right, by the one trial's model alone", "none", first.right_share, "fraction", first.frames)
        yield Figure(f"{row}: right, all starts", "none", last.right_share, "fraction", last.frames)
        yield Figure(f"{row}: FA, all starts", "none", last.false_assignments, "fraction", last.frames)
        touched, looked = (sum(getattr(c, name) for c in whole) / samples for name in ("touched_samples", "looked_samples"))
        yield Figure(f"{row}: samples touched by hand, all starts", "< 0.005", touched, "fraction", samples)
        yield Figure(f"{row}: samples looked at, all starts", "none", looked, "fraction", samples)
    if not bench.quick:
        PICTURE.write_text(picture([c for c in courses if c.condition == "3 hidden"]), encoding="utf-8")


def run(bench: Bench, task: tuple[str, str, str]) -> Course:
    """One loop: start with the subject's straight walk, end with all trials of all subjects labelled."""
    start, condition, budget = task
    first = next(trial for trial in gait()[start] if file_of(trial).stem == "straight")
    waiting = _trials(bench, first, CONDITIONS[condition])
    ensemble = asterism.SolverEnsemble.fit([first], subjects=[start], miner=None)
    course = Course(start, condition, budget, Tally(), Tally())
    for trial in (trial for trials in waiting.values() for trial in trials):
        course.before.add(ensemble.label(trial.clouds, time=True), trial.truth)
    done = 0
    while waiting:
        looks = {subject: [_look(ensemble, trial) for trial in trials] for subject, trials in waiting.items()}
        doubts = {subject: sum(item.gain for _, items in found for item in items) for subject, found in looks.items()}
        ranked = sorted(waiting, key=lambda subject: (doubts[subject] / sum(len(trial.clouds.xyz) for trial in waiting[subject]), subject))
        corrected: list[Recording] = []
        people: list[str] = []
        for subject in ranked[: max(1, done // 2)]:
            own = Tally()
            for trial, (labelling, items) in zip(waiting.pop(subject), looks[subject], strict=True):
                settled = _corrected(trial, labelling, items, BUDGETS[budget], course)
                own.add(settled, trial.truth)
                corrected.append(trial.labelled(settled))
                people.append(subject)
            course.after += own
            course.worst = min(course.worst, (own.right_share, subject))
            done += 1
        if waiting:
            ensemble = ensemble.learn(corrected, subjects=people)
    bench.say(
        f"from {start}, {condition}, {budget}: right {course.before.right_share:.5f} then {course.after.right_share:.5f}, "
        f"worst {course.worst[0]:.5f} {course.worst[1]}; touched {course.touched_samples / course.samples:.5f} of the samples, "
        f"{course.touched_pieces} of {course.pieces} pieces; looked at {course.looked_samples / course.samples:.5f}, {course.looked_pieces}"
    )
    return course


def _trials(bench: Bench, first: Recording, hidden_and_ghosts: tuple[int, int]) -> dict[str, list[Trial]]:
    """Everyone's trials without their labels, but for the one that is labelled."""
    out: dict[str, list[Trial]] = {}
    for subject, recordings in list(gait().items())[: 3 if bench.quick else None]:
        for number, recording in enumerate(recordings):
            if recording is not first:
                clouds, truth = hide_in_gaps(recording, *hidden_and_ghosts, seed=1000 + number)
                out.setdefault(subject, []).append(Trial(subject, recording, clouds, truth))
    return out


def _look(ensemble: asterism.SolverEnsemble, trial: Trial) -> tuple[Labelling, list[Item]]:
    labelling = ensemble.label(trial.clouds, time=True)
    return labelling, review(labelling, trial.clouds, least_gain=0.0)


def _corrected(trial: Trial, labelling: Labelling, items: Sequence[Item], budget: int | None, course: Course) -> Labelling:
    """The labelling after a person has looked at what is flagged, within the budget; the course counts it."""
    settled = labelling
    course.samples += int((trial.truth >= 0).sum())
    course.pieces += len(np.unique(trial.clouds.tracks))
    for item in [item for item in items if item.gain >= WORTH][:budget]:
        after = settle(settled, trial.clouds, [(item, trial.answer(item))])
        course.looked_pieces += 1
        course.looked_samples += item.samples
        if (after.indices != settled.indices).any():
            course.touched_pieces += 1
            course.touched_samples += item.samples
        settled = after
    return settled


def picture(courses: Sequence[Course]) -> str:
    """Error against the samples touched by hand, one line per start, as SVG text; both scales are roots, so that small shares show."""
    width, height, left, low, right, top = 720, 400, 84, 348, 700, 48
    colors = ("#0f7b8a", "#d1495b", "#e09f3e", "#5b5f97", "#3a9d5d", "#8d5a97")
    widest = max([0.01, *(c.touched_samples / c.samples for c in courses)])
    highest = max([0.01, *(c.error for c in courses)])

    def at(touched: float, error: float) -> tuple[float, float]:
        return left + (right - left) * np.sqrt(touched / widest), low - (low - top) * np.sqrt(error / highest)

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif" font-size="12">',
        "<title>Labels touched by hand against error, from one labelled trial to all subjects</title>",
        f'<rect width="{width}" height="{height}" rx="12" fill="#ffffff"/>',
        f'<text x="{left}" y="26" fill="#16213a" font-size="14">From one labelled walk to 11 subjects, 3 of 15 markers hidden: what hand '
        "work does to the error</text>",
    ]
    for share in (0.0, 0.001, 0.005, 0.02, 0.05, 0.1, 0.2, 0.4):
        if share <= widest:
            x = at(share, 0.0)[0]
            out.append(f'<path d="M{x:.1f} {top}V{low}" stroke="#e6ebf2"/>')
            out.append(f'<text x="{x:.1f}" y="{low + 18}" fill="#5b6780" text-anchor="middle">{100 * share:g} %</text>')
        if share <= highest:
            y = at(0.0, share)[1]
            out.append(f'<path d="M{left} {y:.1f}H{right}" stroke="#e6ebf2"/>')
            out.append(f'<text x="{left - 8}" y="{y + 4:.1f}" fill="#5b6780" text-anchor="end">{100 * share:g} %</text>')
    out.append(f'<text x="{(left + right) / 2}" y="{height - 10}" fill="#16213a" text-anchor="middle">samples touched by hand</text>')
    out.append(
        f'<text x="20" y="{(low + top) / 2}" fill="#16213a" text-anchor="middle" transform="rotate(-90 20 {(low + top) / 2})">'
        "samples wrong or missing at the end</text>"
    )
    for number, start in enumerate(dict.fromkeys(c.start for c in courses)):
        color = colors[number % len(colors)]
        points = [at(c.touched_samples / c.samples, c.error) for c in courses if c.start == start]
        out.append(f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}" fill="none" stroke="{color}" stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="{color}"/>' for x, y in points]
        out.append(f'<circle cx="{right - 120}" cy="{top + 14 + 18 * number}" r="4.5" fill="{color}"/>')
        out.append(f'<text x="{right - 108}" y="{top + 18 + 18 * number}" fill="#16213a">from {start}</text>')
    return "\n".join([*out, "</svg>", ""])
