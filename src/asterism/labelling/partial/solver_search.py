"""Labelled frames in; the partial solver of any subset of markers and its hit rates out (thesis 4.5.1, 4.5.2)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.labelling.features.registry import FEATURES as REGISTRY
from asterism.labelling.features.registry import MANY_MARKERS, markers_read
from asterism.labelling.partial._evaluation_kernels import (
    EvaluationLimits,
    ProposalCounts,
    ValidationFrames,
    evaluate_solver,
    handed_in_points,
)
from asterism.labelling.partial._pair_search_kernels import make_search_workspace
from asterism.labelling.partial.matrix import VotingRules
from asterism.labelling.partial.matrix_choice import Points, word_for
from asterism.labelling.partial.solver import Solver, build_search_tree, factor_pair_rules, pack_solvers, replacement_table
from asterism.labelling.partial.weak import FeatureRanges, WrongLabellings
from asterism.recording import Floats, Ints

FEATURES = ("g1", "g2", "g4", "g6", "g7", "g8", "g19")
"""Of a few markers, every feature helps: with the thesis' three features, solvers of six markers fail three times as often."""

FEATURES_OF_MANY = ("g2", "g4", "g7", "g19")
"""With more than `features.MANY_MARKERS` markers, whose triples and quadruples are too many to weigh them all."""

HANDED_IN_TOGETHER = 32
"""Solvers whose points are worked out together: their classifiers fit the cache, and a frame is loaded once for all."""

MarkerSubset = tuple[int, ...]


FEWEST_VALIDATION_FRAMES = 12_000
"""Frames on which solvers are validated, whatever the target. Chosen by hand."""


@dataclass(frozen=True)
class SearchSettings:
    """How partial solvers are searched. Chosen by hand on the gait subjects, where no other source is named.

    max_classifiers      most classifiers of a solver, boosted from those over its markers (a small subset has fewer, and takes all);
                         those of two points' motion are added
    screening_frames     frames on which every subset is evaluated
    evaluation_frames    frames on which a promising one is evaluated
    validation_frames    frames at most on which the solvers finally chosen are evaluated once more. `FEWEST_VALIDATION_FRAMES`, or more
                         where the target needs them: 3 / (1 - target) without a miss show it with 95 % confidence
    max_hidden           0 to so many markers are hidden in these frames (thesis 4.5.1)
    beam_width           subsets that a level keeps (bottom-up, top-down), or the population (genetic)
    max_markers          markers of the largest partial solver
    max_solvers          solvers of the ensemble
    generations          generations of the genetic search
    motion_loss          share of the points whose motion is not known per hidden marker: tracks end beside gaps. Not tuned
    max_motion_loss      the same at most. Not tuned
    min_response_rate    share; a solver that proposes a marker less often, its markers all in sight, is not counted for it: its hit rate is
                         known too badly
    widen                intervals move out by this many standard deviations of their ends over the people. 0.1 measured best on the gait
                         recordings for people in training, 1.5 for others (`TrainingRules.solver_widen`)
    coverage_patterns    patterns of hidden markers on which the choice of the ensemble rests
    marker_cost          relative cost of a solver per marker, in the choice
    min_gain             expected number of further markers per pattern, in sum over all patterns, below which the choice ends
    max_rate_drop        a solver whose rate falls by more than this on the validation frames is put back
    substitutes          solvers taken for a marker for which none reaches the target
    search_target        hit rate up to which a miner searches on where the target is lower: what reaches but the target is found too
    screening_target     hit rate on the screening frames from which a subset is evaluated on the evaluation frames, where the target is
                         higher: a level then keeps the best by rates that are known better
    for_printed_matrix   whether solvers are chosen by what the printed matrix gives with them (`matrix_choice`), else by what each knows
    wrong_cost           false occlusions that a false assignment weighs in that choice, times the share that may be wrong
    large_subsets        subsets of each size above `max_markers` that are tried at random for the printed matrix
    minimal              whether boosting ends where every wrong labelling that can be rejected is, as section 4.3 prints it (step 3)
    """

    max_classifiers: int = 200
    screening_frames: int = 300
    evaluation_frames: int = 2000
    validation_frames: int = 300_000
    max_hidden: int = 5
    beam_width: int = 300
    max_markers: int = 8
    max_solvers: int = 120
    generations: int = 12
    motion_loss: float = 0.08
    max_motion_loss: float = 0.5
    min_response_rate: float = 0.3
    widen: float = 0.25
    coverage_patterns: int = 1500
    marker_cost: float = 0.02
    min_gain: float = 0.02
    max_rate_drop: float = 0.05
    substitutes: int = 3
    search_target: float = 0.0
    screening_target: float = 1.0
    for_printed_matrix: bool = False
    wrong_cost: float = 0.01
    large_subsets: int = 40
    minimal: bool = False


PRINTED_FEATURES = ("g1", "g2", "g3", "g4", "g5", "g6", "g7", "g8", "g9")
"""What the thesis' solvers read, up to `features.MANY_MARKERS` markers: table 4.1. With the three of its full solver, solvers that reach
0.9999 on the gait recordings have eight markers instead of five, and two thirds of the nulls are visible markers instead of a third."""

PRINTED = SearchSettings(
    max_classifiers=1000,
    widen=0.001,
    beam_width=360,
    evaluation_frames=1500,
    validation_frames=30_000,
    max_solvers=250,
    search_target=0.9999,
    screening_target=0.99,
    for_printed_matrix=True,
    coverage_patterns=24_000,
    large_subsets=100,
)
"""The thesis' solvers: intervals from the smallest to the largest value of the training (eq. 4.4), and so little more that the frames with
these values lie inside in spite of rounding. With 200 classifiers a solver of 14 markers finds a second labelling in 2.4 % of the frames
of the training, with 1000 in none."""

MINIMAL = replace(PRINTED, minimal=True)
"""The thesis' solvers as section 4.3 prints them: with as few classifiers as reject what can be rejected. Fewer classifiers reject fewer
right labellings and leave more wrong ones. With 60 instead of 1,000, for 14 markers and blocks that made no interval, 18 instead of 44 % of
the frames have no labelling, and 7 % instead of none a second one."""


@dataclass(frozen=True)
class EvaluatedSolver:
    """A partial solver and its rates on labelled frames.

    hit_rates       (M,) share of its proposals that are right, NaN for other markers (1st property)
    trials          (M,) proposals behind them
    response_rates  (M,) share of the frames with all its markers in sight in which it proposes the right point
    """

    solver: Solver
    hit_rates: Floats
    trials: Ints
    response_rates: Floats

    @property
    def subset(self) -> MarkerSubset:
        """Its markers in rising order; the solver has them in the order of assignment."""
        return tuple(sorted(self.solver.markers.tolist()))


class SolverSearch:
    """Frames, classifiers and wrong labellings, prepared once, from which the solver of any subset of markers follows quickly.

    All subsets share one set of wrong labellings of all markers: a partial solver meets the points of all markers, so restricted to its
    markers they are just what it must reject.
    """

    def __init__(
        self,
        frames: Floats,
        groups: Ints,
        *,
        targets: ArrayLike = 0.9999,
        features: Sequence[str] | None = None,
        settings: SearchSettings | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        """Prepare a search.

        frames (N, M, 3) m, z up, or (N, M, WIDTH) with their motion; groups (N,) whose frame each is; targets hit rates, one or one per
        marker. Raises AsterismError for a target outside (0, 1] or an unknown feature.
        """
        s = self.settings = SearchSettings() if settings is None else settings
        self.rng = np.random.default_rng(seed)
        self.frames = np.ascontiguousarray(frames)
        self.n_markers = frames.shape[1]
        self.targets = np.broadcast_to(np.asarray(targets, dtype=np.float64), (self.n_markers,)).copy()
        if not ((self.targets > 0) & (self.targets <= 1)).all():
            raise AsterismError("a target hit rate lies above 0 and is at most 1, such as 0.9999.")
        if features is None:
            features = FEATURES if self.n_markers <= MANY_MARKERS else FEATURES_OF_MANY
        weak = FeatureRanges.measure(self.frames, groups, features, self.rng).classifiers("widened", s.widen)
        # An interval that accepts everything rejects nothing.
        self.weak = weak.take(np.isfinite(weak.low))
        self.reads = markers_read(self.weak.kinds, self.weak.slots, self.n_markers)
        self.point_counts = self.reads.sum(axis=1)
        self.moving = np.array([feature.moving for feature in REGISTRY])[self.weak.kinds]
        self.table = replacement_table(self.frames, self.weak, self.rng)
        self.wrong = WrongLabellings.draw(self.frames, self.weak, self.rng, 2048)
        # The rule of three: so many trials without a miss show the target.
        needed = np.round(3.0 / np.maximum(1.0 - self.targets.max(), 1e-9))
        self.validation_frames = int(min(s.validation_frames, max(FEWEST_VALIDATION_FRAMES, needed)))
        # Frames are drawn once, so that all solvers are compared on the same ones.
        self.chosen_frames = self.rng.integers(len(self.frames), size=max(s.evaluation_frames, self.validation_frames))
        self.hidden = random_occlusions(len(self.chosen_frames), self.n_markers, s.max_hidden, self.rng)
        self.motion_unknown = self.hidden
        if self.frames.shape[2] > 3:
            # Beside gaps tracks end, and with them what is known of the motion.
            share = np.minimum(s.motion_loss * self.hidden.sum(axis=1), s.max_motion_loss)
            self.motion_unknown = self.rng.random(self.hidden.shape) < share[:, None]
        n, pair_motions = self.n_markers, len(np.unique(self.weak.kinds[self.moving & (self.point_counts == 2)]))
        self.workspace = make_search_workspace(n, n, n, self.frames.shape[2], pair_motions)
        self.frame_ids = np.zeros(1, dtype=np.int64)  # an array: copies that share the workspace must not number two frames alike
        self.evaluated: dict[MarkerSubset, EvaluatedSolver] = {}

    def with_targets(self, targets: ArrayLike) -> SolverSearch:
        """The same frames, classifiers and evaluated solvers, with other targets."""
        other = copy(self)
        other.targets = np.broadcast_to(np.asarray(targets, dtype=np.float64), (self.n_markers,)).copy()
        return other

    def build_solver(self, markers: MarkerSubset) -> Solver | None:
        """The solver of a subset: boosted classifiers in a search tree. None where no classifier reads its markers alone."""
        own = np.array(markers, dtype=np.int64)
        # A classifier belongs to a subset when all its markers do.
        rows = np.nonzero(self.reads[:, own].sum(axis=1) == self.point_counts)[0]
        if not len(rows):
            return None
        most, minimal = self.settings.max_classifiers, self.settings.minimal
        # Pairs cost next to nothing, since solvers share them: boosting fills what is left.
        if minimal or len(rows) > most:
            pairs = self.point_counts[rows] == 2
            left = most - int((pairs & ~self.moving[rows]).sum())
            boosted, _, enough = self.wrong.boost(rows[~pairs], own, max(1, left))
            rows = np.concatenate([rows[pairs], boosted[:enough] if minimal else boosted])
        table = self.table[rows]
        bits = np.unpackbits(np.ascontiguousarray(table[:, own]).view(np.uint8), axis=2).sum(axis=(0, 2))
        # The marker whose exchange most classifiers notice is the best first one.
        return build_search_tree(self.weak.take(rows), table, own, int(own[np.argmax(bits)]))

    def evaluate(self, markers: Iterable[int], validate: bool = False) -> EvaluatedSolver | None:
        """Rates of a subset's solver, on all evaluation frames where the screening reaches a target.

        With `validate` on the validation frames. None where no solver can be built.
        """
        subset = tuple(sorted(markers))
        known = self.evaluated.get(subset)
        if known is not None and not validate:
            return known
        solver = self.build_solver(subset) if known is None else known.solver
        if solver is None:
            return None
        if validate:
            return self.evaluate_on(solver, self.validation_frames)
        result = self.evaluate_on(solver, self.settings.screening_frames)
        # Most subsets fail on few frames, which spares the many.
        if self._reaches(result, np.minimum(self.targets, self.settings.screening_target)).any():
            result = self.evaluate_on(solver, self.settings.evaluation_frames)
        self.evaluated[subset] = result
        return result

    def evaluate_on(self, solver: Solver, count: int) -> EvaluatedSolver:
        """Rates of a solver on the first `count` of the chosen frames."""
        counts = ProposalCounts(*(np.zeros(self.n_markers, dtype=np.int64) for _ in ProposalCounts._fields))
        # A solver that has missed so often can no longer reach the target.
        max_failures = max(2 if count > self.settings.screening_frames else 8, int((1 - self.targets.min()) * count * 2))
        arrays, pairs = factor_pair_rules(pack_solvers([solver]), self.n_markers)
        first_id = self._new_frame_ids(count)
        validation = ValidationFrames(self.frames, self.chosen_frames[:count], self.hidden[:count], self.motion_unknown[:count])
        limits = EvaluationLimits(VotingRules().budget, max_failures)
        evaluate_solver(arrays, pairs, 0, validation, limits, self.workspace, first_id, counts)
        own = np.zeros(self.n_markers, dtype=np.bool_)
        own[solver.markers] = True
        trials = counts.hits + counts.failures
        hit_rates = np.where(own, counts.hits / np.maximum(trials, 1), np.nan)
        response_rates = np.where(own, counts.hits / np.maximum(counts.hits + counts.abstentions, 1), 0.0)
        return EvaluatedSolver(solver, hit_rates, trials, response_rates)

    def _new_frame_ids(self, count: int) -> int:
        """The first of so many numbers that the workspace has had for no frame."""
        first = int(self.frame_ids[0])
        self.frame_ids[0] += count
        return first

    def handed_in(self, solvers: Sequence[Solver], trial: ValidationFrames) -> list[Points]:
        """For each solver (D, K) the points that it hands in for its markers, by depth, on frames with hidden markers."""
        step = HANDED_IN_TOGETHER
        return [points for i in range(0, len(solvers), step) for points in self._handed_in_together(solvers[i : i + step], trial)]

    def _handed_in_together(self, solvers: Sequence[Solver], trial: ValidationFrames) -> list[Points]:
        arrays, pairs = factor_pair_rules(pack_solvers(solvers), self.n_markers)
        first_id = self._new_frame_ids(len(trial.chosen))
        out = np.empty((len(trial.chosen), len(arrays.markers)), dtype=np.uint64)
        handed_in_points(arrays, pairs, trial, VotingRules().budget, self.workspace, first_id, out)
        by_depth = out.T.astype(word_for(self.n_markers), order="C")
        return [by_depth[begin:end] for begin, end in pairwise(arrays.first_depth)]

    def reaches_target(self, evaluated: EvaluatedSolver) -> NDArray[np.bool_]:
        """(M,) where a solver's hit rate reaches the target."""
        return self._reaches(evaluated, self.targets)

    def reaches_goal(self, evaluated: EvaluatedSolver) -> bool:
        """Whether a solver reaches, in one of its markers, what a miner searches for."""
        return bool(self._reaches(evaluated, np.maximum(self.targets, self.settings.search_target)).any())

    def _reaches(self, evaluated: EvaluatedSolver, rates: Floats) -> NDArray[np.bool_]:
        hit_rates = np.nan_to_num(evaluated.hit_rates, nan=-1.0)
        # A high rate on few proposals may be luck.
        return (hit_rates >= rates) & (evaluated.response_rates >= self.settings.min_response_rate)


def random_occlusions(count: int, n_markers: int, most: int, rng: np.random.Generator, least: int = 0) -> NDArray[np.bool_]:
    """(count, n_markers) markers to hide in each of `count` frames: `least` to `most` of them, each number equally often, at random."""
    # Each number of hidden markers is equally frequent.
    number = least + np.arange(count) % (min(most, max(n_markers - 1, 0)) + 1 - least)
    ranks = np.argsort(np.argsort(rng.random((count, n_markers)), axis=1), axis=1)
    hidden: NDArray[np.bool_] = ranks < number[:, None]
    return hidden
