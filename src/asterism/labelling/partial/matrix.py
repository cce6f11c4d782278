"""The labelling matrix (thesis 4.5.4): clouds and an ensemble of partial solvers in; labels by safe rules, votes and evaluations out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from asterism.errors import AsterismError
from asterism.labelling.features.motion_points import feature_points
from asterism.labelling.features.registry import FEATURES, markers_read, needs_motion
from asterism.labelling.features.search_kernels import SolverArrays
from asterism.labelling.partial import _matrix_kernels
from asterism.labelling.partial._matrix_kernels import MatrixRules, StrongClassifierArrays, VoteArrays
from asterism.labelling.partial.solver import angles_to_cosines, factor_pair_rules
from asterism.labelling.partial.weak import Bits, WeakClassifiers
from asterism.recording import Clouds, Floats, Ints


@dataclass(frozen=True)
class VotingRules:
    """How the proposals of an ensemble become labels. Chosen by hand on the gait recordings.

    budget           feature evaluations that a partial solver may spend on one frame. Exhausted, it proposes nothing: deterministic,
                     unlike a limit in seconds
    min_tests        classifiers with known values that a label of the strong classifier takes
    outvote          a proposal stands where it has more than this many times the votes of all others
    rounds           completions at most. Not tuned
    max_classifiers  classifiers of the strong classifier per marker, those that reject most
    """

    budget: int = 20_000
    min_tests: int = 20
    outvote: int = 5
    rounds: int = 3
    max_classifiers: int = 1500


@dataclass(frozen=True)
class PartialSolvers:
    """An ensemble of partial solvers.

    solvers    flat arrays of S solvers
    hit_rates  (S, M) of each solver's proposals the share that was right, NaN for markers it does not know (1st property)
    trials     (S, M) the proposals behind each hit rate; 0 where a model of an earlier Asterism does not say
    targets    (M,) a solver proposes a marker only where its hit rate reaches the marker's target
    covered    (M,) bool: a solver reaches the target. For a marker that none reaches, the best solvers are taken and trusted nevertheless
    trusted    (D,) bool by depth of all solvers: may this solver propose this marker
    strong     the strong classifier of all markers, marker by marker, which completes the labels after the vote
    """

    solvers: SolverArrays
    hit_rates: Floats
    trials: Ints
    targets: Floats
    covered: NDArray[np.bool_]
    trusted: NDArray[np.bool_]
    strong: StrongClassifierArrays

    def __len__(self) -> int:
        return len(self.solvers.first_depth) - 1

    @property
    def reads_motion(self) -> bool:
        """Whether any of its classifiers reads the points' motion."""
        return needs_motion(self.solvers.kinds) or needs_motion(self.strong.kinds)

    @property
    def shown_hit_rates(self) -> Floats:
        """(M,) the hit rate that the trials have shown of the best solver trusted with each marker; 0 where there is none.

        The lower end of the exact 95 % interval: after n trials without a miss 0.05 ** (1 / n), about 1 - 3 / n (the rule of three).
        """
        right = np.nan_to_num(self.hit_rates) * self.trials
        # The exact interval, since rates near 1 make the normal one run over.
        shown = np.where(right > 0, betaincinv(np.maximum(right, 1.0), self.trials - right + 1.0, 0.05), 0.0)
        best = np.zeros(len(self.targets))
        owner = np.repeat(np.arange(len(self)), np.diff(self.solvers.first_depth))
        # Of several solvers that may propose a marker, the best one is what a person can rely on.
        np.maximum.at(best, self.solvers.markers[self.trusted], shown[owner, self.solvers.markers][self.trusted])
        return best

    def summary(self, names: Sequence[str]) -> dict[str, Any]:
        """What a person should know of it, in plain values, by the names of its markers."""
        shown = self.shown_hit_rates
        return {
            "solvers": len(self),
            "uncovered": [name for name, covered in zip(names, self.covered, strict=True) if not covered],
            "targets": dict(zip(names, self.targets.tolist(), strict=True)),
            "shown_hit_rates": dict(zip(names, shown.tolist(), strict=True)),
        }

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as plain arrays, for a file."""
        arrays: dict[str, NDArray[Any]] = {f"solver_{name}": array for name, array in self.solvers._asdict().items()}
        arrays |= {f"whole_{name}": array for name, array in self.strong._asdict().items()}
        own = {name: getattr(self, name) for name in ("hit_rates", "trials", "targets", "covered", "trusted")}
        return arrays | own

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> PartialSolvers:
        """What `to_arrays` gave. Raises AsterismError where an array is missing or they do not fit each other."""
        try:
            solvers = SolverArrays(*(_typed(arrays[f"solver_{name}"], name) for name in SolverArrays._fields))
            strong = StrongClassifierArrays(*(_typed(arrays[f"whole_{name}"], name) for name in StrongClassifierArrays._fields))
            hit_rates, targets = (np.asarray(arrays[name], dtype=np.float64) for name in ("hit_rates", "targets"))
            covered, trusted = (np.asarray(arrays[name], dtype=np.bool_) for name in ("covered", "trusted"))
            # Older models kept no trials.
            trials = np.asarray(arrays.get("trials", np.zeros(hit_rates.shape)), dtype=np.int64)
        except (KeyError, ValueError, TypeError) as problem:
            raise AsterismError(f"the partial solvers cannot be read ({problem}); train the model again.") from problem
        sizes = hit_rates.shape == (len(solvers.first_depth) - 1, len(targets)) and targets.ndim == 1
        sizes = sizes and trials.shape == hit_rates.shape and bool((trials >= 0).all())
        sizes = sizes and covered.shape == targets.shape and trusted.shape == solvers.markers.shape
        # The kernels do not check what they index, so that a damaged file must end here.
        if not sizes or not _walkable(solvers, len(targets)) or not _testable(strong, len(targets)):
            raise AsterismError("the partial solvers do not fit together; the model is damaged, train it again.")
        return cls(solvers, hit_rates, trials, targets, covered, trusted, strong)


def _typed(array: NDArray[Any], name: str) -> NDArray[Any]:
    return np.ascontiguousarray(array, dtype=np.float64 if name in ("low", "high") else np.int64)


def _classifiers(kinds: Ints, slots: Ints, low: Floats, high: Floats) -> bool:
    count = len(kinds)
    sizes = kinds.shape == low.shape == high.shape == (count,) and slots.shape == (count, 4)
    return sizes and bool(((kinds >= 0) & (kinds < len(FEATURES))).all())


def _rising(first: Ints, count: int, end: int, step: int) -> bool:
    return first.shape == (count + 1,) and first[0] == 0 and first[-1] == end and bool((np.diff(first) >= step).all())


def _walkable(solvers: SolverArrays, markers: int) -> bool:
    """Whether the kernels stay within the arrays of the solvers."""
    first, depths = solvers.first_depth, len(solvers.markers)
    if not _classifiers(solvers.kinds, solvers.slots, solvers.low, solvers.high) or not len(first):
        return False
    if not _rising(first, len(first) - 1, depths, 1) or not _rising(solvers.first_feature, depths, len(solvers.kinds), 0):
        return False
    # A slot may point at its own depth or an earlier one.
    place = np.arange(depths) - np.repeat(first[:-1], np.diff(first))
    reach = np.repeat(place, np.diff(solvers.first_feature))
    known = (solvers.markers >= 0) & (solvers.markers < markers)
    return bool(known.all() and ((solvers.slots >= 0) & (solvers.slots <= reach[:, None])).all())


def _testable(strong: StrongClassifierArrays, markers: int) -> bool:
    """Whether the kernels stay within the arrays of a strong classifier."""
    if not _classifiers(strong.kinds, strong.slots, strong.low, strong.high) or strong.points.shape != strong.kinds.shape:
        return False
    known = ((strong.slots >= 0) & (strong.slots < markers)).all()
    return bool(known) and (len(strong.first) == 1 or _rising(strong.first, markers, len(strong.kinds), 0))


def classifiers_by_marker(weak: WeakClassifiers, table: Bits) -> StrongClassifierArrays:
    """The strong classifier of all markers: for each marker the `max_classifiers` that reject most wrong points of it, most first.

    table as from `solver.replacement_table`.
    """
    share = np.unpackbits(np.ascontiguousarray(table).view(np.uint8), axis=2).sum(axis=2)
    reads = markers_read(weak.kinds, weak.slots, table.shape[1])
    rows = []
    for marker in range(table.shape[1]):
        # Only classifiers that read the marker can judge it.
        own = np.nonzero(reads[:, marker])[0]
        # Those that reject most come first: most wrong points end at the first one.
        rows.append(own[np.argsort(-share[own, marker].astype(np.int64), kind="stable")[: VotingRules().max_classifiers]])
    chosen = np.concatenate(rows)
    points = np.array([feature.points for feature in FEATURES], dtype=np.int64)[weak.kinds[chosen]]
    low, high = angles_to_cosines(weak.kinds[chosen], weak.low[chosen], weak.high[chosen])
    first = np.cumsum([0, *map(len, rows)]).astype(np.int64)
    return StrongClassifierArrays(first, weak.kinds[chosen], np.ascontiguousarray(weak.slots[chosen]), points, low, high)


def no_classifiers() -> StrongClassifierArrays:
    """A strong classifier without markers: then the thesis' rules decide alone."""
    none = np.empty(0, dtype=np.int64)
    return StrongClassifierArrays(np.zeros(1, dtype=np.int64), none, np.empty((0, 4), dtype=np.int64), none, np.empty(0), np.empty(0))


def near_miss_slack(targets: Floats) -> float:
    """The share of an interval by which a value may miss it and still forbid a completion: the higher the target hit rates (M,), the more.

    0 for a target of 0.999, 0.05 more for each further nine, 0.2 at most. Chosen by hand.
    """
    nines = -np.log10(np.maximum(1.0 - targets.mean(), 1e-7))
    return float(np.clip(0.05 * (nines - 3.0), 0.0, 0.2))


class Votes(NamedTuple):
    """What an ensemble says of each frame.

    indices      (T, M) candidate of each marker, -1 for none
    votes        (T, M) of the solvers trusted with a marker the share that propose its candidate; for a null, the most proposed
                 candidate. 0 for a label that completion gave without a proposal
    evaluations  (T,) feature evaluations
    """

    indices: Ints
    votes: Floats
    evaluations: Ints


MATRIX_RULES = ("printed", "agreed", "completed")
"""How `label_by_matrix` gets from labellings to labels: section 4.5.4 as it is printed; with solvers that keep silent about markers in
which their labellings differ; and this completed by the strong classifier of all markers."""


def label_by_matrix(clouds: Clouds, ensemble: PartialSolvers, budget: int | None = None, *, rules: str = "completed") -> Votes:
    """Label each frame by the proposals of all solvers.

    A marker gets the candidate on which all proposals for it agree. It gets none where there is no proposal, where two candidates are
    proposed, or where the candidate is proposed for another marker too. `budget` is in feature evaluations per frame and solver, by default
    `VotingRules.budget`: a solver that exhausts it proposes nothing, the same on every machine. Motion, where classifiers read it, comes
    from the tracks of the clouds. For points without a known motion those classifiers accept. rules is one of `MATRIX_RULES`:

    - "printed": a solver that finds several labellings hands in all of them. More than 32 count as an exhausted budget;
    - "agreed": it hands in the points on which all its labellings agree, and nothing for the other markers;
    - "completed": as "agreed", and a label takes two solvers that propose it, where there are two (on the gait recordings all wrong labels
      had a single one). A proposal that outvotes all others by `VotingRules.outvote` stands. The strong classifier of all markers decides
      last (a classifier whose points are not all labelled is ignored, section 4.4.2): a marker without a label gets the one free point that
      is accepted with the labels given, if no other marker nearly accepts that point (`near_miss_slack`). Then what a single solver
      proposed counts where it is accepted with the others.

    Raises AsterismError for unknown rules.
    """
    if rules not in MATRIX_RULES:
        raise AsterismError(f"there are no rules {rules!r} for the labelling matrix; choose from {', '.join(MATRIX_RULES)}.")
    xyz = feature_points(clouds, ensemble.reads_motion)
    frames, markers = len(clouds), len(ensemble.targets)
    votes = Votes(np.empty((frames, markers), dtype=np.int64), np.empty((frames, markers)), np.empty(frames, dtype=np.int64))
    # Without a strong classifier the printed rules decide alone.
    strong = ensemble.strong if rules == "completed" else no_classifiers()
    solvers, pairs = factor_pair_rules(ensemble.solvers, markers)
    r, slack = VotingRules(), near_miss_slack(ensemble.targets)
    how = MatrixRules(r.outvote, slack, r.min_tests, r.rounds, r.budget if budget is None else budget, rules == "printed")
    out = VoteArrays(votes.indices, votes.votes, votes.evaluations)
    _matrix_kernels.label_by_matrix(solvers, pairs, ensemble.trusted, strong, how, xyz, clouds.offsets, out)
    return votes
