"""Capturability (thesis 4.5.2, 6.1): labelled recordings in; whether their marker set can be labelled, and what would help, out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.labelling.partial._matrix_kernels import count_confusions
from asterism.labelling.partial.ensemble_choice import choose_ensemble
from asterism.labelling.partial.full_solver_study import ChosenClassifier, SolverSize, boosting_table, fit_printed, solver_sizes
from asterism.labelling.partial.matrix import PartialSolvers, classifiers_by_marker, label_by_matrix
from asterism.labelling.partial.search_strategies import bottom_up
from asterism.labelling.partial.solver import FullSolver, FullSolverRules, stack_frames
from asterism.labelling.partial.solver_search import EvaluatedSolver, MarkerSubset, SearchSettings, SolverSearch, random_occlusions
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Recording

Half = tuple[Floats, Ints]


JUDGED = (
    "Judged are single frames and partial solvers that know these people. `asterism label` also uses the paths of points and the whole "
    "body, and finds more; how much is measured by `asterism evaluate`, on people that its model does not know."
)
"""What the figures are about, said wherever they stand."""

_SEARCH = SearchSettings(screening_frames=200, evaluation_frames=800, validation_frames=2000, beam_width=60, max_markers=8, max_solvers=50)


@dataclass(frozen=True)
class CapturabilityRules:
    """How a marker set is examined. Chosen by hand, to keep the examination at a few minutes.

    frames           frames used, evenly spread, half of them for learning
    search           how partial solvers are searched; no solver has more markers than the set
    change_frames    frames from which solvers learn where a change of the marker set is tried, and by which they are validated
    max_hidden       by_occlusions and by_target go up to so many hidden markers
    targets          hit rates of by_target: those of the thesis' tables 5.4 and 5.5
    compared_hidden  two marker sets are compared on frames with 0 to so many markers hidden
    step             m that a marker is moved, and that an added one stands off the plane of its neighbours
    hardest          markers that are moved and given a new neighbour
    """

    frames: int = 3000
    search: SearchSettings = _SEARCH
    change_frames: int = 800
    max_hidden: int = 5
    targets: tuple[float, ...] = (0.99, 0.999, 0.9999, 0.99999)
    compared_hidden: int = 4
    step: float = 0.03
    hardest: int = 4


@dataclass(frozen=True)
class MarkerSetChange:
    """What one change of the marker set would do.

    action      "drop", "move" or "add"
    hit rates   share of the markers in sight (those of the set before and after the change) that get their label, with 0 to 4 hidden
    """

    action: str
    marker: str
    description: str
    hit_rate_before: float
    hit_rate_after: float


@dataclass(frozen=True)
class TargetRates:
    """What a model of partial solvers with one target hit rate gives with so many markers hidden.

    target  hit rate that each solver reaches for the markers that it votes on
    hidden  markers hidden in each frame
    false_assignments, false_occlusions  wrong labels among those given; visible markers among the nulls (thesis 5.3)
    """

    target: float
    hidden: int
    false_assignments: float
    false_occlusions: float


@dataclass(frozen=True)
class Capturability:
    """Whether a marker set can be labelled.

    markers        (M,) names
    hit_rates      (M,) share of frames with all markers in sight in which the full solver names it (4.5.2, property 4: 1 is the best)
    confusion      (M, M) how often the row marker's point could be taken for the column marker when a third of the labels are known, as a
                   share of all that it could be taken for, itself included: rows sum to 1
    by_occlusions  (hidden, share of the markers in sight that get their label, the same per marker (M,)) for 0, 1, 2, ... hidden
    changes        what dropping, moving or adding a marker would do, the most helpful first
    verdict        all this in plain words
    by_target      false assignments and false occlusions by target hit rate and number of hidden markers (thesis figure 5.2)
    first_classifiers  the weak classifiers that boosting chooses first (thesis table 5.1)
    solver_sizes   what more weak classifiers gain (thesis figure 5.1)
    judged         what the figures are about, in plain words
    """

    markers: tuple[str, ...]
    hit_rates: Floats
    confusion: Floats
    by_occlusions: list[tuple[int, float, Floats]]
    changes: list[MarkerSetChange]
    verdict: str
    by_target: list[TargetRates] = field(default_factory=list)
    first_classifiers: list[ChosenClassifier] = field(default_factory=list)
    solver_sizes: list[SolverSize] = field(default_factory=list)
    judged: str = JUDGED

    def to_dict(self) -> dict[str, Any]:
        """Everything in lists and plain values, for JSON."""
        return {
            "judged": self.judged,
            "markers": list(self.markers),
            "hit_rates": self.hit_rates.tolist(),
            "confusion": self.confusion.tolist(),
            "by_occlusions": [
                {"hidden": hidden, "hit_rate": rate, "per_marker": dict(zip(self.markers, own.tolist(), strict=True))}
                for hidden, rate, own in self.by_occlusions
            ],
            "changes": [asdict(change) for change in self.changes],
            "verdict": self.verdict,
            "by_target": [asdict(rates) for rates in self.by_target],
            "first_classifiers": [asdict(chosen) for chosen in self.first_classifiers],
            "solver_sizes": [asdict(size) for size in self.solver_sizes],
        }


def capturability(
    recordings: Sequence[Recording],
    *,
    subjects: Sequence[str] | None = None,
    seed: int = 0,
    rules: CapturabilityRules | None = None,
    progress: Progress | None = None,
) -> Capturability:
    """Examine whether the markers of labelled recordings can be told apart frame by frame, which are confused, and what would help.

    With markers hidden, solvers learn from even blocks of ten frames and are tested on odd ones, of the same people: the question is
    about the markers, not about new people.
    `subjects` names the person of each recording. Deterministic by seed. Raises AsterismError for fewer than four markers, for columns that
    differ, for a marker that is never there, or where no frame shows all markers.
    """
    rules = rules or CapturabilityRules()
    report = progress or (lambda fraction, doing: None)
    frames, groups = stack_frames(recordings, subjects)
    names, markers = recordings[0].labels, frames.shape[1]
    if markers < 4:
        raise AsterismError(f"{markers} markers are too few to say which of them can be told apart; give at least four.")
    # Taught and tested on the same people: the question is about the markers, not about new people.
    teach, test = _halves(frames, groups, rules.frames)
    report(0.0, "full solver")
    hit_rates = _whole_hit_rates(np.concatenate([teach[0], test[0]]), np.concatenate([teach[1], test[1]]), names, seed)
    report(0.1, "confusions")
    # No solver has more markers than there are.
    settings = replace(rules.search, max_markers=min(rules.search.max_markers, markers))
    search = SolverSearch(*teach, settings=settings, seed=seed)
    confusion = _confusion(search, test[0], np.random.default_rng(seed))
    found = bottom_up(search, lambda fraction, doing: report(0.15 + 0.35 * fraction, doing))
    chosen = choose_ensemble(search, found, lambda fraction, doing: None)
    report(0.55, "hidden markers")
    by_target = _by_target(search, found, test[0], names, rules, seed)
    # Fewer than three visible markers cannot be labelled.
    by_occlusions = []
    for hidden in range(min(rules.max_hidden, markers - 3) + 1):
        clouds, truth = simulate_occlusions(Recording(test[0], names, 1.0), hidden, 0, seed)
        given = label_by_matrix(clouds, chosen).indices
        there = truth != NULL
        right = (given == truth) & there
        per_marker: Floats = right.sum(axis=0) / np.maximum(there.sum(axis=0), 1)
        by_occlusions.append((hidden, float(right.sum() / max(there.sum(), 1)), per_marker))
    # What is lost most with many hidden, and confused most, is what a change could help.
    hardest = np.argsort(by_occlusions[-1][2] + np.diagonal(confusion), kind="stable")[: rules.hardest]
    changes = _changes(chosen, search, (teach, test), names, hardest, seed, rules, lambda share, doing: report(0.6 + 0.4 * share, doing))
    printed = fit_printed(*teach, names, seed)
    first, sizes = boosting_table(printed, test[0], seed=seed), solver_sizes(printed, test[0], seed=seed)
    report(1.0, "done")
    verdict = _verdict(names, hit_rates, confusion, by_occlusions, changes)
    return Capturability(names, hit_rates, confusion, by_occlusions, changes, verdict, by_target, first, sizes)


def _by_target(
    search: SolverSearch, found: list[EvaluatedSolver], frames: Floats, names: tuple[str, ...], rules: CapturabilityRules, seed: int
) -> list[TargetRates]:
    """Both rates of the models that other targets make of what was found, labelled by the labelling matrix alone."""
    rates = []
    for target in rules.targets:
        model = choose_ensemble(search.with_targets(target), found, lambda fraction, doing: None)
        for hidden in range(1, min(rules.max_hidden, len(names) - 3) + 1):
            clouds, truth = simulate_occlusions(Recording(frames, names, 1.0), hidden, 0, seed)
            # "agreed" is the thesis' matrix without our completion, which would hide the effect of the target.
            indices = label_by_matrix(clouds, model, rules="agreed").indices
            given, there = indices != NULL, truth != NULL
            wrong, missed = (given & (indices != truth)).sum(), (~given & there).sum()
            rates.append(TargetRates(target, hidden, float(wrong / max(given.sum(), 1)), float(missed / max((~given).sum(), 1))))
    return rates


def _halves(frames: Floats, groups: Ints, most: int) -> tuple[Half, Half]:
    """Even and odd blocks of ten frames, `most` of them together."""
    odd = (np.arange(len(frames)) // 10) % 2 == 1
    # A recording shorter than a block has no odd ones.
    if odd.all() or not odd.any():
        odd = np.arange(len(frames)) % 2 == 1
    if len(frames) == 1:
        return (frames, groups), (frames, groups)
    halves = []
    for half in (~odd, odd):
        rows = np.nonzero(half)[0]
        # Evenly spread, so that no trial decides for all.
        rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), most // 2)).round().astype(np.int64)]
        halves.append((np.ascontiguousarray(frames[rows]), groups[rows]))
    return halves[0], halves[1]


def _whole_hit_rates(frames: Floats, groups: Ints, names: Sequence[str], seed: int) -> Floats:
    """Share of the frames that a full solver names uniquely; it has learned from all of them, so only ambiguity lowers the share."""
    complete = ~np.isnan(frames[:, :, 0]).any(axis=1)
    if not complete.any():
        raise AsterismError("no frame shows all markers, so they cannot be compared; give recordings with fewer gaps, or fewer markers.")
    # More markers need more classifiers for the same rate.
    rules = FullSolverRules(weak_classifiers=max(40, 3 * len(names)), widen=0.25)
    solver = FullSolver.fit_frames(frames, groups, names, rules=rules, seed=seed)
    clouds, truth = simulate_occlusions(Recording(frames[complete], tuple(names), 1.0), 0, 0, seed)
    rates: Floats = (solver.label(clouds).indices == truth).mean(axis=0)
    return rates


def _confusion(search: SolverSearch, frames: Floats, rng: np.random.Generator) -> Floats:
    n = search.n_markers
    taken_for, shown = np.zeros((n, n), dtype=np.int64), np.zeros(n, dtype=np.int64)
    # A third of the labels known is where ambiguity shows: with more, all is clear.
    known = np.argsort(rng.random((len(frames), n)), axis=1) < max(2, n // 3)
    count_confusions(classifiers_by_marker(search.weak, search.table), frames, np.arange(len(frames)), known, taken_for, shown)
    for marker in np.nonzero(shown == 0)[0]:
        # A marker that was never shown is confused with none.
        taken_for[marker, marker] = 1
    confusion: Floats = taken_for / taken_for.sum(axis=1, keepdims=True)
    return confusion


def _rebuilt(search: SolverSearch, subsets: Sequence[MarkerSubset]) -> PartialSolvers:
    """The model of the given subsets' solvers, on the frames of the search."""
    return choose_ensemble(
        search, [evaluated for subset in subsets if (evaluated := search.evaluate(subset)) is not None], lambda fraction, doing: None
    )


def _hit_rate(model: PartialSolvers, frames: Floats, hidden: NDArray[np.bool_], judged: NDArray[np.bool_]) -> float:
    """Share of the judged markers in sight that get their label; hidden (N, M) bool."""
    # Truth counts the points in sight: a hidden marker has none.
    there = ~np.isnan(frames[:, :, 0]) & ~hidden
    truth = np.where(there, np.cumsum(there, axis=1) - 1, NULL)
    given = label_by_matrix(Clouds.from_points([frame[seen] for frame, seen in zip(frames, there, strict=True)], 1.0), model).indices
    asked = there & judged
    return float((asked & (given == truth)).sum() / max(asked.sum(), 1))


def _changes(
    chosen: PartialSolvers,
    search: SolverSearch,
    halves: tuple[Half, Half],
    names: Sequence[str],
    hardest: Ints,
    seed: int,
    rules: CapturabilityRules,
    progress: Progress,
) -> list[MarkerSetChange]:
    """Every marker dropped, the hardest ones moved and given a neighbour; each judged by the markers that the set had before."""
    n, (teach, test) = len(names), halves
    hidden = random_occlusions(len(test[0]), n, rules.compared_hidden, np.random.default_rng(seed))
    everyone = np.ones(n, dtype=np.bool_)
    before = _hit_rate(chosen, test[0], hidden, everyone)
    changes = []
    for marker in range(n):
        progress(0.3 * marker / n, "markers dropped")
        gone, others = hidden.copy(), everyone.copy()
        gone[:, marker], others[marker] = True, False
        # Judged by the others on both sides, since the marker itself is no longer asked for.
        alone = _hit_rate(chosen, test[0], hidden, others)
        changes.append(MarkerSetChange("drop", names[marker], "without it", alone, _hit_rate(chosen, test[0], gone, others)))

    # Changes are tried on few frames: a full search for each would take hours.
    few = slice(None, None, max(1, len(teach[0]) // rules.change_frames))
    settings = replace(rules.search, validation_frames=rules.change_frames)
    subsets = [tuple(np.sort(own).tolist()) for own in np.split(chosen.solvers.markers, chosen.solvers.first_depth[1:-1])]

    def found(alter: Callable[[Floats], Floats], more: Sequence[MarkerSubset] = ()) -> float:
        changed, tested = alter(teach[0][few]), alter(test[0])
        extra = tested.shape[1] - n
        altered = _rebuilt(SolverSearch(changed, teach[1][few], settings=settings, seed=seed), [*subsets, *more])
        return _hit_rate(altered, tested, np.pad(hidden, ((0, 0), (0, extra))), np.pad(everyone, (0, extra)))

    # Without a change, but by the same shortened search: only like may be compared with like.
    before = found(lambda frames: frames)
    near = _neighbours(search)
    for number, marker in enumerate(hardest.tolist()):
        progress(0.3 + 0.7 * number / len(hardest), "markers moved and added")
        one, two = int(near[marker, 0]), int(near[marker, 1])
        text = f"{rules.step * 100:.0f} cm away from its neighbour {names[one]}"
        changes.append(
            MarkerSetChange("move", names[marker], text, before, found(partial(_moved, marker=marker, other=one, step=rules.step)))
        )
        text = f"a new marker between {names[marker]}, {names[one]} and {names[two]}"
        # The new marker takes part in solvers beside the one that it is to help.
        joined = [tuple(sorted({*subset[1:], n})) for subset in subsets] + [(*subset, n) for subset in subsets if marker in subset]
        added = partial(_added, triple=(marker, one, two), step=rules.step)
        changes.append(MarkerSetChange("add", names[marker], text, before, found(added, joined)))
    return sorted(changes, key=lambda change: change.hit_rate_before - change.hit_rate_after)


def _moved(frames: Floats, marker: int, other: int, step: float) -> Floats:
    moved = frames.copy()
    apart = frames[:, marker] - frames[:, other]
    moved[:, marker] += step * apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
    return moved


def _added(frames: Floats, triple: tuple[int, int, int], step: float) -> Floats:
    a, b, c = (frames[:, marker] for marker in triple)
    side = np.cross(b - a, c - a)
    # Points in a line have no side; the new marker then stands among them.
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return np.concatenate([frames, ((a + b + c) / 3 + step * side)[:, None]], axis=1)


def _neighbours(search: SolverSearch) -> NDArray[np.int64]:
    """(M, M - 1) the other markers, those that keep the steadiest distance first: what sits on the same segment."""
    between = search.frames[:, :, None] - search.frames[:, None]
    distance = np.sqrt((between**2).sum(axis=3))
    seen = ~np.isnan(distance)
    count = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, distance, 0.0).sum(axis=0) / count
    spread = np.sqrt(np.where(seen, (distance - mean) ** 2, 0.0).sum(axis=0) / count)
    # No marker is its own neighbour.
    np.fill_diagonal(spread, np.inf)
    return np.argsort(spread, axis=1, kind="stable")[:, :-1]


def _verdict(
    names: Sequence[str],
    hit_rates: Floats,
    confusion: Floats,
    by_occlusions: list[tuple[int, float, Floats]],
    changes: list[MarkerSetChange],
) -> str:
    worst, mean = int(hit_rates.argmin()), float(hit_rates.mean())
    # Limits of the words, chosen by hand: 1 % is what a person corrects without complaint.
    if mean >= 0.99:
        opening = f"These {len(names)} markers can be labelled"
    elif mean >= 0.8:
        opening = f"These {len(names)} markers can be labelled in most frames, not in all"
    else:
        opening = f"These {len(names)} markers cannot be labelled reliably as they are"
    least = f" ({names[worst]} least often, {100 * hit_rates[worst]:.1f} %)" if hit_rates[worst] < mean - 0.001 else ""
    words = [f"{opening}: with all in sight, {100 * mean:.1f} % of the labels are found{least}."]
    if len(by_occlusions) > 1:
        hidden, rate, own = by_occlusions[min(3, len(by_occlusions) - 1)]
        weak = int(own.argmin())
        words.append(f"With {hidden} hidden, {100 * rate:.1f} % of the others are; {names[weak]} suffers most ({100 * own[weak]:.1f} %).")
    apart = confusion - np.diag(np.diagonal(confusion))
    row, column = divmod(int(apart.argmax()), len(names))
    # Half a percent is below what the sample can tell.
    if apart[row, column] >= 0.005:
        words.append(f"{names[row]} is the one most easily taken for another: {names[column]}.")
    else:
        words.append("No marker is easily taken for another.")
    helpful = changes[0] if changes else None
    if helpful is not None and helpful.hit_rate_after > helpful.hit_rate_before + 0.005:
        what = helpful.description if helpful.action == "add" else f"{helpful.action} {helpful.marker} ({helpful.description})"
        words.append(f"What would help most: {what}.")
    return " ".join(words)
