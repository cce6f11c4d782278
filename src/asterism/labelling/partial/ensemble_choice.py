"""Partial solvers of a search in; those that together cover the marker set out, by what the matrix or each of them gives (thesis 4.5.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.partial._evaluation_kernels import ValidationFrames
from asterism.labelling.partial.matrix import PartialSolvers, classifiers_by_marker
from asterism.labelling.partial.matrix_choice import Matrix, Points, choose_solvers
from asterism.labelling.partial.solver import pack_solvers
from asterism.labelling.partial.solver_search import EvaluatedSolver, MarkerSubset, SolverSearch, random_occlusions
from asterism.progress import Progress

MOST_IN_A_WORD = 64
"""Markers up to which the points that a solver hands in fit the bits of a word. Larger sets are chosen by coverage."""

FIRST_CHOICES = 3
"""How often solvers are chosen on few patterns of hidden markers, for the choice on many. Not tuned."""

Trusted = tuple[EvaluatedSolver, NDArray[np.bool_]]
"""A solver of the ensemble, and (M,) the markers that it may propose."""


def choose_ensemble(search: SolverSearch, found: list[EvaluatedSolver], progress: Progress) -> PartialSolvers:
    """The ensemble: of the solvers found those that, over random patterns of hidden markers, leave the fewest markers without a proposal.

    Chosen one after the other by how much each adds, small ones first among equals; each is evaluated on the validation frames before it
    is taken. For a marker that no solver reaches the target of, the best known solvers are taken, and the marker is not `covered`.
    """
    n = search.n_markers
    # The points of a solver must fit the bits of a word.
    if search.settings.for_printed_matrix and n <= MOST_IN_A_WORD:
        chosen = _choose_for_matrix(search, sorted(_all_that_reach(search, found), key=_smallest_first), progress)
    else:
        chosen = _choose_for_coverage(search, sorted(found, key=_smallest_first), progress)
    covered = np.any(np.array([reaches for _, reaches in chosen], dtype=np.bool_).reshape(-1, n), axis=0)
    # A marker without a solver would never be labelled: the best known ones stand in.
    for marker in np.nonzero(~covered)[0]:
        able = [e for _, e in sorted(search.evaluated.items()) if e.hit_rates[marker] > 0]
        best = sorted(able, key=lambda e: (-e.hit_rates[marker], len(e.solver.markers)))[: search.settings.substitutes]
        chosen += [(e, np.arange(n) == marker) for e in best]
    progress(1.0, f"{len(chosen)} solvers")
    return PartialSolvers(
        pack_solvers([e.solver for e, _ in chosen]),
        np.array([e.hit_rates for e, _ in chosen]).reshape(-1, n),
        np.array([e.trials for e, _ in chosen], dtype=np.int64).reshape(-1, n),
        search.targets,
        covered,
        np.concatenate([np.empty(0, dtype=np.bool_), *(trusted[e.solver.markers] for e, trusted in chosen)]),
        classifiers_by_marker(search.weak, search.table),
    )


def _smallest_first(evaluated: EvaluatedSolver) -> tuple[int, MarkerSubset]:
    return len(evaluated.solver.markers), evaluated.subset


def _all_that_reach(search: SolverSearch, found: list[EvaluatedSolver]) -> list[EvaluatedSolver]:
    """What a miner found, what reached the target on its way, and subsets too large for it, drawn at random.

    With few markers hidden, large solvers label most: a hidden marker's neighbours leave them no second labelling.
    """
    for size in range(search.settings.max_markers + 1, search.n_markers):
        for _ in range(search.settings.large_subsets):
            search.evaluate(search.rng.permutation(search.n_markers)[:size].tolist())
    known = {e.subset: e for e in found}
    return [*(known | {s: e for s, e in search.evaluated.items() if search.reaches_target(e).any()}).values()]


def _choose_for_matrix(search: SolverSearch, found: list[EvaluatedSolver], progress: Progress) -> list[Trusted]:
    """Choice by what the printed matrix gives on frames with hidden markers, each solver validated before it is taken.

    What many patterns of hidden markers tell of thousands of candidates costs minutes and gigabytes, and what few tell is partly luck. So
    candidates are chosen on few patterns, and again from those left, `FIRST_CHOICES` times. Among these the choice is made on many.

    A solver is trusted with the markers for which it reaches the target both times: what it proposes for another one had no part in the
    choice, and would take other solvers' labels away.
    """
    s = search.settings
    # Few patterns first: thousands of candidates on all of them would take gigabytes.
    matrix, points = _handed_in(search, found, max(1, s.coverage_patterns // 4))
    kept: list[int] = []
    for _ in range(FIRST_CHOICES):
        # Again from those left: what few patterns tell is partly luck.
        kept += choose_solvers(matrix.emptied(), [e.solver.markers for e in found], points, s.max_solvers, without=kept)
    del points
    candidates = [found[i] for i in sorted(kept)]
    matrix, points = _handed_in(search, candidates, s.coverage_patterns)
    again: dict[int, EvaluatedSolver] = {}

    def confirm(i: int) -> NDArray[np.bool_]:
        markers = candidates[i].solver.markers
        # Validation costs most, and a candidate may be asked for several times.
        if i not in again:
            validated = search.evaluate(candidates[i].subset, validate=True)
            assert validated is not None
            again[i] = validated
            progress(len(again) / s.max_solvers, f"{len(again)} solvers validated")
        return search.reaches_target(again[i])[markers]

    chosen = choose_solvers(matrix, [e.solver.markers for e in candidates], points, s.max_solvers, confirm=confirm)
    return [(again[i], search.reaches_target(candidates[i]) & search.reaches_target(again[i])) for i in chosen]


def _handed_in(search: SolverSearch, found: list[EvaluatedSolver], patterns: int) -> tuple[Matrix, list[Points]]:
    """The empty matrices of frames with hidden markers, and what each solver hands in for the markers for which it reaches the target."""
    n, s = search.n_markers, search.settings
    trial = ValidationFrames(
        search.frames,
        search.rng.integers(len(search.frames), size=patterns),
        random_occlusions(patterns, n, s.max_hidden, search.rng, least=1),
        search.motion_unknown[np.arange(patterns) % len(search.motion_unknown)],
    )
    points = search.handed_in([e.solver for e in found], trial)
    for e, own in zip(found, points, strict=True):
        # What a solver proposes without reaching the target would take labels from others.
        own[~search.reaches_target(e)[e.solver.markers]] = 0
    return Matrix(trial.hidden.T, s.wrong_cost / max(1.0 - float(search.targets.mean()), 1e-6)), points


def _choose_for_coverage(search: SolverSearch, found: list[EvaluatedSolver], progress: Progress) -> list[Trusted]:
    """Greedy choice by the markers that a solver adds over patterns of hidden markers, each solver validated before it is taken."""
    n, settings = search.n_markers, search.settings
    patterns = settings.coverage_patterns
    hidden = random_occlusions(patterns, n, settings.max_hidden + 1, search.rng)
    lacking = (~hidden).astype(np.float64)
    rates = np.array([search.reaches_target(e) * e.response_rates for e in found]).reshape(-1, n)
    # A solver is ready where none of its markers is hidden.
    ready = np.array([~hidden[:, e.solver.markers].any(axis=1) for e in found], dtype=np.float64).reshape(-1, patterns)
    cost = 1.0 + settings.marker_cost * np.array([len(e.solver.markers) for e in found])
    chosen: list[Trusted] = []
    while len(chosen) < settings.max_solvers and len(found):
        gain = ((ready @ lacking) * rates).sum(axis=1) / cost
        best = int(np.argmax(gain))
        if gain[best] < settings.min_gain:
            break
        validated = search.evaluate(found[best].subset, validate=True)
        assert validated is not None
        reaches = search.reaches_target(validated)
        rate = reaches * validated.response_rates
        # Its rate on the search's frames was luck: it goes back with the true one.
        if (rate < rates[best] - settings.max_rate_drop).any():
            rates[best] = rate
            continue
        # What it gives is no longer lacking, in proportion to its rate.
        lacking *= 1.0 - ready[best][:, None] * rate
        rates[best] = 0.0
        chosen.append((validated, reaches))
        progress(len(chosen) / settings.max_solvers, f"{len(chosen)} solvers chosen")
    return chosen
