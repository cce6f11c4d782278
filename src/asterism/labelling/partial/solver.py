"""Solvers: a strong classifier and a tree search in one (thesis 4.4.2, 4.5.1); the full solver that works on all markers at once (5.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.features.feature_kernels import G1, G2, G4, G6, G7, LAST_INLINED, mark_rejections
from asterism.labelling.features.motion_kernels import G14
from asterism.labelling.features.motion_points import feature_points, frames_with_motion
from asterism.labelling.features.registry import FEATURES, THESIS, kinds_of, markers_read, needs_motion
from asterism.labelling.features.search_kernels import SolverArrays, search
from asterism.labelling.partial._build_kernels import order_tests
from asterism.labelling.partial._full_solver_kernels import label_by_full_solver
from asterism.labelling.partial._pair_search_kernels import PairRules
from asterism.labelling.partial.weak import (
    Bits,
    FeatureRanges,
    StrongClassifier,
    WeakClassifiers,
    WrongLabellings,
    choose_widening,
    classifiers_over,
)
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording, subject_of

BUDGET = 200_000
"""Feature evaluations that a search may spend on one frame. Exhausted, it gives no label: deterministic, unlike a limit in seconds."""

REPLACEMENT_WORDS = 2
"""Replacements per marker that guide the order of a tree, in words of 64. Not tuned."""


@dataclass(frozen=True)
class FullSolverRules:
    """How a full solver is learned.

    weak_classifiers  boosted classifiers of the solver (thesis 5.2: 40)
    features          what they read, by name
    rule              "range" or "widened", see `weak.FeatureRanges.classifiers`
    widen             factor of rule "widened": small for people that training has seen; None: chosen on people left out. A larger
                      one leaves more frames with more than one feasible labelling
    sample_frames     training frames searched for wrong labellings that the solver accepts. Not tuned
    accepted_weight   weight of these against drawn ones, per marker. Not tuned
    rounds            how often they are searched and added. Chosen by hand
    """

    weak_classifiers: int = 40
    features: tuple[str, ...] = THESIS
    rule: str = "widened"
    widen: float | None = 0.25
    sample_frames: int = 2000
    accepted_weight: int = 64
    rounds: int = 3


@dataclass(frozen=True)
class Solver:
    """One tree search: markers (D,) in the order of assignment, classifiers by the depth at which they can be evaluated.

    weak.slots are depths, not markers; first_feature (D + 1,) classifiers first_feature[d]:first_feature[d + 1] belong to depth d
    lowest_first: a full solver tries low points first, because its tree starts at a low marker
    """

    markers: Ints
    weak: WeakClassifiers
    first_feature: Ints
    lowest_first: bool = False


def pack_solvers(solvers: Sequence[Solver]) -> SolverArrays:
    """Solvers in the flat arrays that the kernels walk over."""
    depths = [0, *(len(solver.markers) for solver in solvers)]
    counts = [len(solver.weak) for solver in solvers]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    first = [solver.first_feature[:-1] + start for solver, start in zip(solvers, starts, strict=False)]
    return SolverArrays(
        first_depth=np.cumsum(depths).astype(np.int64),
        markers=np.concatenate([np.empty(0, dtype=np.int64), *(solver.markers for solver in solvers)]),
        first_feature=np.concatenate([*first, starts[-1:]]).astype(np.int64),
        kinds=np.concatenate([np.empty(0, dtype=np.int64), *(solver.weak.kinds for solver in solvers)]),
        slots=np.concatenate([np.empty((0, 4), dtype=np.int64), *(solver.weak.slots for solver in solvers)]),
        low=np.concatenate([np.empty(0), *(solver.weak.low for solver in solvers)]),
        high=np.concatenate([np.empty(0), *(solver.weak.high for solver in solvers)]),
    )


def unpack_solvers(arrays: SolverArrays) -> list[Solver]:
    """The solvers of flat arrays, one by one."""
    solvers = []
    # Each solver has its depths, and each depth its classifiers.
    for begin, end in zip(arrays.first_depth[:-1], arrays.first_depth[1:], strict=True):
        first = arrays.first_feature[begin : end + 1]
        rows = slice(first[0], first[-1])
        weak = WeakClassifiers(arrays.kinds[rows], arrays.slots[rows], arrays.low[rows], arrays.high[rows])
        solvers.append(Solver(arrays.markers[begin:end], weak, first - first[0]))
    return solvers


def factor_pair_rules(arrays: SolverArrays, n_markers: int) -> tuple[SolverArrays, PairRules]:
    """Solvers without their classifiers of distance, height and two points' motion, and these as rules for pairs that all solvers share.

    The intervals of angles become those of their cosines, and kinds after LAST_INLINED come last at their depth, as `search_by_pairs` reads
    them. A solver from `solver_search` has all classifiers of pairs over its markers, so the labellings found are the same.
    """
    pairs = np.array([feature.moving and feature.points == 2 for feature in FEATURES])[arrays.kinds]
    used = np.unique(arrays.kinds[pairs])
    # Kinds 0 and 1 are distance and height, those of motion follow.
    kinds = np.array([G2, G4, *used])
    low, high = np.full((len(kinds), n_markers, n_markers), np.inf), np.full((len(kinds), n_markers, n_markers), -np.inf)
    depth_of = np.repeat(np.arange(len(arrays.markers)), np.diff(arrays.first_feature))
    start = np.repeat(arrays.first_depth[:-1], np.diff(arrays.first_depth))[depth_of]
    pairs |= (arrays.kinds == G2) | (arrays.kinds == G4)
    a, b = arrays.markers[start + arrays.slots[:, 0]][pairs], arrays.markers[start + arrays.slots[:, 1]][pairs]
    own = arrays.kinds[pairs]
    place = (own[:, None] == kinds).argmax(axis=1)
    ends = arrays.low[pairs], arrays.high[pairs]
    # The widest interval is the rule: it rejects what every solver rejects. A rule holds both ways round,
    for one, other, (low_end, high_end) in ((a, b, ends), (b, a, _exchanged(np.isin(own, (G4, G14)), *ends))):
        np.minimum.at(low, (place, one, other), low_end)
        np.maximum.at(high, (place, one, other), high_end)
    # What became a rule is no classifier of a solver any more; a narrower one still is.
    rest = ~pairs
    rest[pairs] = (ends[0] > low[place, a, b]) | (ends[1] < high[place, a, b])
    # Pairs without a classifier may be anywhere.
    low, high = np.where(low > high, -np.inf, low), np.where(low > high, np.inf, high)
    rules = PairRules(low[0], high[0], low[1], high[1], used, low[2:], high[2:])
    first = np.concatenate([[0], np.cumsum(rest)])[arrays.first_feature]
    low, high = angles_to_cosines(arrays.kinds, arrays.low, arrays.high)
    # At each depth the kinds that the kernel has inlined come first.
    inlined_first = np.lexsort((arrays.kinds[rest] > LAST_INLINED, depth_of[rest]))
    kept = np.nonzero(rest)[0][inlined_first]
    own = (arrays.kinds[kept], arrays.slots[kept], low[kept], high[kept])
    return SolverArrays(arrays.first_depth, arrays.markers, first.astype(np.int64), *own), rules


def _exchanged(antisymmetric: NDArray[np.bool_], low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Intervals with the two points exchanged: where `antisymmetric`, the value changes its sign."""
    return np.where(antisymmetric, -high, low), np.where(antisymmetric, -low, high)


def angles_to_cosines(kinds: Ints, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Intervals, those of angles (rad) as those of their cosines. An end that reaches 0 or pi is open."""
    angle = np.isin(kinds, (G1, G6, G7))
    # The cosine falls as the angle rises, so that the ends change places.
    near = np.where(angle, np.where(high >= np.pi, -np.inf, np.cos(np.clip(high, 0.0, np.pi))), low)
    far = np.where(angle, np.where(low <= 0.0, np.inf, np.cos(np.clip(low, 0.0, np.pi))), high)
    return near, far


def replacement_table(frames: Floats, weak: WeakClassifiers, rng: np.random.Generator, words: int = REPLACEMENT_WORDS) -> Bits:
    """(F, M, words) bits: whether a classifier rejects when one marker alone is given another marker's point. For `build_search_tree`."""
    n = frames.shape[1]
    visible = ~np.isnan(frames[:, :, 0])
    # Frames without a gap test every classifier.
    complete = np.nonzero(visible.all(axis=1))[0]
    source = complete if len(complete) else np.nonzero(visible.any(axis=1))[0]
    size = n * words * 64
    marker = np.repeat(np.arange(n), words * 64)
    labels = np.tile(np.arange(n), (size, 1))
    # A marker gets another one's point: never its own, whatever was drawn.
    labels[np.arange(size), marker] = (marker + rng.integers(1, max(2, n), size=size)) % n
    table = np.zeros((len(weak), n * words), dtype=np.uint64)
    mark_rejections(np.ascontiguousarray(frames[rng.choice(source, size=size)]), labels, weak.kinds, weak.slots, weak.low, weak.high, table)
    return table.reshape(len(weak), n, words)


def build_search_tree(weak: WeakClassifiers, table: Bits, markers: Ints, start: int) -> Solver:
    """The search tree of some classifiers (slots: markers) over `markers`, from marker `start` on; `table` as from `replacements`."""
    order, rank = np.empty(len(markers), dtype=np.int64), np.empty(len(weak), dtype=np.int64)
    first = np.empty(len(markers) + 1, dtype=np.int64)
    order_tests(table, markers_read(weak.kinds, weak.slots, table.shape[1]), markers, start, order, rank, first)
    depth_of = np.zeros(table.shape[1], dtype=np.int64)
    depth_of[order] = np.arange(len(order))
    ordered = weak.take(rank)
    # Slots beyond a feature's points are never read, but must be valid.
    unused = np.arange(4) >= np.array([feature.points for feature in FEATURES])[ordered.kinds][:, None]
    return Solver(order, WeakClassifiers(ordered.kinds, np.where(unused, 0, depth_of[ordered.slots]), ordered.low, ordered.high), first)


def stack_frames(recordings: Sequence[Recording], subjects: Sequence[str] | None = None, *, motion: bool = False) -> tuple[Floats, Ints]:
    """Labelled recordings as upright frames (N, M, 3) m, with `motion` (N, M, WIDTH), and whose each frame is (N,).

    Without `subjects`, one name per recording, the person is `metadata["subject"]`, else the folder of the file.
    Raises AsterismError where there are no frames, the labels differ, or there is not one subject per recording.
    """
    if not recordings or not sum(map(len, recordings)):
        raise AsterismError("there are no frames to learn from; give at least one labelled recording.")
    # Columns are markers here: other columns would be other markers.
    for recording in recordings:
        if recording.labels != recordings[0].labels:
            name = recording.metadata.get("file", "a recording")
            raise AsterismError(f"{name} has other columns than the first recording; read all with the same `markers`.")
    if subjects is not None and len(subjects) != len(recordings):
        raise AsterismError(f"{len(subjects)} subjects for {len(recordings)} recordings; give one name per recording.")
    names = [subject_of(recording) for recording in recordings] if subjects is None else list(subjects)
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    frames = np.concatenate([frames_with_motion(r) if motion else rotate_z_up(r.positions, r.vertical) for r in recordings])
    return frames, np.repeat([number[name] for name in names], [len(recording) for recording in recordings]).astype(np.int64)


class FullSolver:
    """A solver for all markers at once: fast, rarely wrong, and without a label as soon as one marker is hidden (thesis 5.2).

    names           (M,) markers
    strong          the strong classifier; its slots are markers
    solver          its search tree
    hit_rates       (M,) share of training frames in which the marker was given its point
    evaluations     mean feature evaluations until the first feasible labelling, in the last `label` (frames without one left out)
    evaluations_in_all  mean until the search has shown that there is no other labelling
    """

    def __init__(self, names: Sequence[str], strong: StrongClassifier, solver: Solver, hit_rates: Floats) -> None:
        self.names, self.strong, self.solver, self.hit_rates = tuple(names), strong, solver, hit_rates
        self.evaluations = self.evaluations_in_all = float("nan")

    @classmethod
    def fit(
        cls,
        recordings: Sequence[Recording],
        *,
        subjects: Sequence[str] | None = None,
        rules: FullSolverRules | None = None,
        seed: int = 0,
    ) -> FullSolver:
        """Learn from labelled recordings with the same columns; `subjects` as for `stack_frames`.

        Raises AsterismError for recordings that differ, an unknown feature or rule, or fewer than three markers.
        """
        rules = rules or FullSolverRules()
        frames, groups = stack_frames(recordings, subjects, motion=needs_motion(kinds_of(rules.features)))
        return cls.fit_frames(frames, groups, recordings[0].labels, rules=rules, seed=seed)

    @classmethod
    def fit_frames(
        cls, frames: Floats, groups: Ints, names: Sequence[str], *, rules: FullSolverRules | None = None, seed: int = 0
    ) -> FullSolver:
        """Learn from frames (N, M, 3) m, z up, for features of motion (N, M, WIDTH); groups (N,) whose frame each is.

        Raises AsterismError as `fit` does, and for a marker that no frame shows.
        """
        rules = rules or FullSolverRules()
        # Two markers have one distance, the same both ways round.
        if frames.shape[1] < 3:
            raise AsterismError(
                f"{frames.shape[1]} markers cannot be told apart by distances and heights; a marker set needs at least three."
            )
        if np.isnan(frames[:, :, 0]).all(axis=0).any():
            name = names[int(np.argmax(np.isnan(frames[:, :, 0]).all(axis=0)))]
            raise AsterismError(f"marker {name} is never visible in the training recordings; leave it out of the marker set.")
        rng = np.random.default_rng(seed)
        markers = np.arange(frames.shape[1])
        weak = _weak_classifiers(frames, groups, rules, rng)
        table = replacement_table(frames, weak, rng)
        wrong = WrongLabellings.draw(frames, weak, rng)
        sample = np.ascontiguousarray(frames[np.sort(rng.permutation(len(frames))[: rules.sample_frames])])
        # Wrong labellings that a search finds are harder than any drawn ones: they are added, and boosting begins anew.
        for _ in range(rules.rounds):
            rows, gains, _ = wrong.boost(np.arange(len(weak)), markers, rules.weak_classifiers)
            solver = _fastest_tree(weak.take(rows), table[rows], markers, sample)
            accepted, labels = _wrong_accepted(solver, sample)
            if not len(accepted):
                break
            # Few were found: each counts as many of the drawn ones.
            weight = np.full(-(-len(labels) // 64), rules.accepted_weight * len(markers), dtype=np.int64)
            wrong = wrong.joined(WrongLabellings.from_labellings(sample[accepted], labels, weak, weight))
        strong = StrongClassifier(weak.take(rows), gains.astype(np.float64), len(markers))
        given = np.empty((len(sample), len(markers)), dtype=np.int64)
        truth = _label_frames(solver, sample, given)[0]
        return cls(names, strong, solver, (given == truth).mean(axis=0))

    def label(self, clouds: Clouds) -> Labelling:
        """The feasible labelling of each frame where there is only one; where several agree on a marker, that marker; else null.

        The confidence of a label is the marker's hit rate on training frames, that of a null is 0. O(frames times a search).
        """
        indices = np.empty((len(clouds), len(self.names)), dtype=np.int64)
        first, total = np.empty(len(clouds), dtype=np.int64), np.empty(len(clouds), dtype=np.int64)
        label_by_full_solver(
            pack_solvers([self.solver]),
            self.solver.lowest_first,
            feature_points(clouds, needs_motion(self.solver.weak.kinds)),
            clouds.offsets,
            BUDGET,
            indices,
            first,
            total,
        )
        solved = first >= 0
        # Frames without a labelling say nothing of the cost to the first one.
        self.evaluations = float(first[solved].mean()) if solved.any() else float("nan")
        self.evaluations_in_all = float(total.mean()) if len(total) else float("nan")
        return Labelling(indices, np.where(indices == NULL, 0.0, self.hit_rates), self.names)

    def accuracy(self, recordings: Sequence[Recording], *, wrong: int = 10**7, seed: int = 0) -> float:
        """Share of wrong labellings of the recordings' frames, from two to all labels permuted, that the strong classifier rejects."""
        return self.strong.accuracy(stack_frames(recordings, motion=needs_motion(self.strong.weak.kinds))[0], wrong, seed)


def _weak_classifiers(frames: Floats, groups: Ints, rules: FullSolverRules, rng: np.random.Generator) -> WeakClassifiers:
    """All weak classifiers that reject something, by the rule; `widen` chosen on people left out where it is None."""
    markers, widen = np.arange(frames.shape[1]), rules.widen
    ranges = FeatureRanges.measure(frames, groups, rules.features, rng)
    weak = ranges.classifiers("range")
    # The widening is chosen for the classifiers that boosting takes, not for the whole pool.
    if rules.rule == "widened" and widen is None:
        wrong = WrongLabellings.draw(frames, weak, rng)
        rows, _, _ = wrong.boost(classifiers_over(weak, len(markers), markers), markers, rules.weak_classifiers)
        widen = choose_widening(ranges, frames, groups, rows, rng)
    weak = ranges.classifiers(rules.rule, 0.0 if widen is None else widen)
    return weak.take(classifiers_over(weak, len(markers), markers))


def _label_frames(solver: Solver, frames: Floats, given: Ints) -> tuple[Ints, Ints, Ints]:
    """The truth as rows of each frame's cloud, and the evaluations to the first labelling and in all. OUT given (N, M)."""
    visible = ~np.isnan(frames[:, :, 0])
    offsets = np.concatenate([[0], np.cumsum(visible.sum(axis=1))]).astype(np.int64)
    first, total = np.empty(len(frames), dtype=np.int64), np.empty(len(frames), dtype=np.int64)
    label_by_full_solver(
        pack_solvers([solver]), solver.lowest_first, np.ascontiguousarray(frames[visible]), offsets, BUDGET, given, first, total
    )
    return np.where(visible, np.cumsum(visible, axis=1) - 1, NULL), first, total


def _fastest_tree(weak: WeakClassifiers, table: Bits, markers: Ints, sample: Floats) -> Solver:
    """The tree, among those from every first marker, with the fewest evaluations until the right labelling and in total, added up."""
    # Some two hundred frames rank the trees well enough.
    few = sample[:: max(1, len(sample) // 200)]
    given = np.empty((len(few), len(markers)), dtype=np.int64)
    best, fewest = None, float("inf")
    # The first marker decides the cost: few candidates at the top leave few branches.
    for start, lowest_first in product(markers, (False, True)):
        solver = replace(build_search_tree(weak, table, markers, start), lowest_first=lowest_first)
        _, first, total = _label_frames(solver, few, given)
        # Both until the first labelling and to the end: a search that proves there is no other goes on.
        cost = float(np.where(first < 0, total, first).mean() + total.mean())
        if cost < fewest:
            best, fewest = solver, cost
    assert best is not None
    return best


def _wrong_accepted(solver: Solver, sample: Floats) -> tuple[Ints, Ints]:
    """Wrong labellings that the solver finds feasible: (K,) frames of the sample, (K, M) labels."""
    arrays, depths = pack_solvers([solver]), len(solver.markers)
    found, counters = np.empty((64, depths), dtype=np.int64), np.zeros(2, dtype=np.int64)
    passed, labels = [], []
    for number, points in enumerate(sample):
        # With a gap the right labelling is not complete, and any other would count as wrong.
        if np.isnan(points[:, :3]).any():
            continue
        counters[0] = 0
        solutions = search(arrays, 0, points, np.argsort(-points[:, 2], kind="stable"), BUDGET, found, counters)
        by_marker = np.empty((max(solutions, 0), depths), dtype=np.int64)
        by_marker[:, solver.markers] = found[: max(solutions, 0)]
        # The rows are in the markers' order, so that counting up is the truth.
        wrong = by_marker[(by_marker != np.arange(depths)).any(axis=1)]
        passed.append(np.full(len(wrong), number))
        labels.append(wrong)
    return np.concatenate([np.empty(0, dtype=np.int64), *passed]), np.concatenate([np.empty((0, depths), dtype=np.int64), *labels])
