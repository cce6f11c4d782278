"""Labelled frames in; which weak classifiers boosting chooses first, and what more of them gain, out (thesis table 5.1, figure 5.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.features.registry import describe
from asterism.labelling.partial._full_solver_kernels import label_by_full_solver
from asterism.labelling.partial.solver import BUDGET, FullSolver, FullSolverRules, build_search_tree, pack_solvers, replacement_table
from asterism.labelling.partial.weak import StrongClassifier
from asterism.recording import Floats, Ints

SIZES = (1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 15, 20, 25, 30, 35, 40)
"""Numbers of weak classifiers that `solver_sizes` tries."""

PRINTED_RULES = FullSolverRules(rule="range", widen=None, rounds=1)
"""The full solver as section 4.4.1 trains it: 40 weak classifiers of g2, g4 and g9, with the intervals of eq. 4.4."""

FEWEST_FRAMES = 50
"""Frames searched for each size. A search with few classifiers may spend its whole budget."""


@dataclass(frozen=True)
class ChosenClassifier:
    """A weak classifier in order of choice: in words, and the share of wrong labellings that it rejects and none before it does."""

    description: str
    score: float


@dataclass(frozen=True)
class SolverSize:
    """A full solver of the first weak classifiers.

    classifiers  how many
    accuracy     share of wrong labellings, from two to all labels permuted, that they reject
    evaluations  mean feature evaluations until the first feasible labelling; the budget where a search ended without one
    """

    classifiers: int
    accuracy: float
    evaluations: float


def fit_printed(frames: Floats, groups: Ints, names: Sequence[str], seed: int = 0) -> FullSolver:
    """The full solver of section 5.2 from frames (N, M, 3) m, z up. Raises AsterismError as `FullSolver.fit_frames`."""
    return FullSolver.fit_frames(frames, groups, names, rules=PRINTED_RULES, seed=seed)


def boosting_table(solver: FullSolver, frames: Floats, most: int = 9, wrong: int = 20_000, seed: int = 0) -> list[ChosenClassifier]:
    """Table 5.1: the first weak classifiers, tried on wrong labellings of these frames. O(most wrong)."""
    rows, weak, before = [], solver.strong.weak, 0.0
    for count in range(1, min(most, len(weak)) + 1):
        accuracy = _first(solver, count).accuracy(frames, wrong, seed)
        # Each classifier is credited with what none before it rejects.
        rows.append(ChosenClassifier(describe(int(weak.kinds[count - 1]), weak.slots[count - 1], solver.names), accuracy - before))
        before = accuracy
    return rows


def solver_sizes(solver: FullSolver, frames: Floats, wrong: int = 20_000, seed: int = 0) -> list[SolverSize]:
    """Figure 5.1: accuracy and evaluations of the solvers of the first 1, 2, ... weak classifiers.

    Raises AsterismError where no frame shows all markers.
    """
    complete = np.ascontiguousarray(frames[~np.isnan(frames[:, :, 0]).any(axis=1)])
    if not len(complete):
        raise AsterismError("no frame shows all markers, so no full solver can be tried; give frames without gaps.")
    few, rng = complete[:: max(1, len(complete) // FEWEST_FRAMES)], np.random.default_rng(seed)
    found = []
    for count in SIZES:
        # Boosting may have taken fewer than were asked for.
        if count > len(solver.strong.weak):
            break
        strong = _first(solver, count)
        found.append(
            SolverSize(count, strong.accuracy(complete, wrong, seed), _evaluations(strong, few, int(solver.solver.markers[0]), rng))
        )
    return found


def _first(solver: FullSolver, count: int) -> StrongClassifier:
    rows = np.arange(count)
    return StrongClassifier(solver.strong.weak.take(rows), solver.strong.weights[rows], len(solver.names))


def _evaluations(strong: StrongClassifier, frames: Floats, start: int, rng: np.random.Generator) -> float:
    """Mean evaluations until the first feasible labelling; the search takes points by height, whatever their order."""
    markers = np.arange(strong.n_markers)
    # The tree is built anew for each size, as a solver of this size would have been.
    tree = build_search_tree(strong.weak, replacement_table(frames, strong.weak, rng), markers, start)
    count, m = frames.shape[:2]
    offsets = np.arange(0, count * m + 1, m, dtype=np.int64)
    first, total = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    given = np.empty((count, m), dtype=np.int64)
    label_by_full_solver(
        pack_solvers([tree]), False, np.ascontiguousarray(frames[:, :, :3]).reshape(-1, 3), offsets, BUDGET, given, first, total
    )
    # Without a labelling the whole search is what it cost.
    return float(np.where(first < 0, total, first).mean())
