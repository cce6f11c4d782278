"""Labelled frames in; small partial solvers with high hit rates that together cover the marker set out (thesis 4.5.3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.labelling.partial.ensemble_choice import choose_ensemble
from asterism.labelling.partial.matrix import PartialSolvers
from asterism.labelling.partial.solver_search import EvaluatedSolver, MarkerSubset, SearchSettings, SolverSearch
from asterism.progress import Progress
from asterism.recording import Floats, Ints

MINERS = ("bottom-up", "top-down", "genetic", "genetic-all")
"""The strategies of section 4.5.3; "genetic-all" also keeps what reached a target and died out later."""


def check_miner(miner: str | None) -> None:
    """Raise AsterismError for a miner that is not one of `MINERS`, or None."""
    if miner is not None and miner not in MINERS:
        raise AsterismError(f"miner {miner!r} is not known; choose among {', '.join(MINERS)}.")


def search_partial_solvers(
    frames: Floats,
    groups: Ints,
    *,
    targets: ArrayLike = 0.9999,
    miner: str = "bottom-up",
    features: Sequence[str] | None = None,
    settings: SearchSettings | None = None,
    seed: int | np.random.Generator = 0,
    progress: Progress | None = None,
) -> PartialSolvers:
    """Find partial solvers that reach the target hit rates and together cover the markers.

    frames (N, M, 3) m, z up, NaN where missing, for features of motion (N, M, WIDTH); groups (N,) whose frame each is; targets a number or
    (M,); miner one of `MINERS`; features by name, or None for `FEATURES` (`FEATURES_OF_MANY`), all of single frames.

    A hit rate is measured on frames of the ground truth with 0 to 5 markers hidden: of the points that the solver proposes for a marker,
    the share that is right. The thesis measures on whole frames. Hidden markers are stricter: they show a solver that takes another
    marker's point where it should propose nothing. Where a solver finds several labellings, it proposes nothing for the markers in which
    they differ; how often is in `EvaluatedSolver.response_rates`, which guides the choice of solvers and not the trust in them.

    Equal seeds give equal solvers. Raises AsterismError for an unknown miner or fewer than three markers.
    """
    check_miner(miner)
    if frames.shape[1] < 3:
        raise AsterismError(f"{frames.shape[1]} markers cannot be told apart by distances and heights; a marker set needs at least three.")
    search = SolverSearch(frames, groups, targets=targets, features=features, settings=settings, seed=seed)
    report = progress or (lambda fraction, doing: None)
    strategy = {"bottom-up": bottom_up, "top-down": top_down, "genetic": genetic, "genetic-all": genetic_all}[miner]
    found = strategy(search, lambda fraction, doing: report(0.8 * fraction, doing))
    return choose_ensemble(search, found, lambda fraction, doing: report(0.8 + 0.2 * fraction, doing))


def bottom_up(search: SolverSearch, progress: Progress) -> list[EvaluatedSolver]:
    """Algorithm 4.1: start with one marker each, add markers until a target is reached.

    A solver that reaches the target in one of its markers joins the result and grows no further. Of the others, a level keeps the
    `beam_width` best, an equal share for every marker, so that no part of the body is forgotten.
    """
    level: set[MarkerSubset] = {(marker,) for marker in range(search.n_markers)}
    found: list[EvaluatedSolver] = []
    largest = min(search.settings.max_markers, search.n_markers)
    for size in range(2, largest + 1):
        # Each subset once, whatever the order in which its markers came.
        grown = sorted({tuple(sorted((*subset, m))) for subset in level for m in range(search.n_markers) if m not in subset})
        # Neighbours that keep their distances make the best solvers.
        grown = _most_rigid(search, grown, 4 * search.settings.beam_width)
        waiting: list[EvaluatedSolver] = []
        for number, subset in enumerate(grown):
            if number % 16 == 0:
                progress((size - 2 + number / len(grown)) / (largest - 1), f"solvers of {size} markers")
            evaluated = search.evaluate(subset)
            if evaluated is None:
                continue
            # A solver that reaches the goal grows no further: a larger one would only cost more.
            (found if search.reaches_goal(evaluated) else waiting).append(evaluated)
        if not waiting:
            break
        level = {e.subset for e in _best_per_marker(search, waiting, search.settings.beam_width)}
    progress(1.0, "searched")
    return found


def top_down(search: SolverSearch, progress: Progress) -> list[EvaluatedSolver]:
    """Algorithm 4.2: start with all markers, take markers out as long as a target is reached.

    A solver joins the result when none of its children reaches a target. (As printed, step 2d drops the child instead of keeping the
    parent, which would return the solvers that fail.) A level keeps the `beam_width` best, an equal share for every marker; what reaches a
    target and is not followed further joins the result too.
    """
    whole = search.evaluate(range(search.n_markers))
    level = [] if whole is None else [whole]
    found, size = list(level), search.n_markers
    while level and size > 2:
        parents: list[tuple[EvaluatedSolver, list[MarkerSubset]]] = []
        wanted: set[MarkerSubset] = set()
        for parent in level:
            children = [tuple(m for m in parent.subset if m != out) for out in parent.subset]
            parents.append((parent, children))
            wanted.update(children)
        # Children of several parents are tried once.
        tried = set(_most_rigid(search, sorted(wanted), 2 * search.settings.beam_width))
        survivors: dict[MarkerSubset, EvaluatedSolver] = {}
        for number, (parent, children) in enumerate(parents):
            if number % 16 == 0:
                progress(1.0 - size / search.n_markers + number / len(parents) / search.n_markers, f"solvers of {size - 1} markers")
            able = _that_reach(search, [child for child in children if child in tried])
            survivors.update(able)
            # The smallest that reaches a target is what the search is after.
            if not able:
                found.append(parent)
        following = [survivors[key] for key in sorted(survivors)]
        level = _best_per_marker(search, following, search.settings.beam_width)
        kept = {id(evaluated) for evaluated in level}
        found += [evaluated for evaluated in following if id(evaluated) not in kept]
        size -= 1
    progress(1.0, "searched")
    return found + level


def _that_reach(search: SolverSearch, subsets: Iterable[MarkerSubset]) -> dict[MarkerSubset, EvaluatedSolver]:
    """Of some subsets the solvers that reach a target."""
    evaluated = {subset: search.evaluate(subset) for subset in subsets}
    return {subset: one for subset, one in evaluated.items() if one is not None and search.reaches_goal(one)}


def genetic(search: SolverSearch, progress: Progress) -> list[EvaluatedSolver]:
    """The genetic search: those of the last population that reach a target."""
    return list(_that_reach(search, sorted(evolve(search, progress))).values())


def genetic_all(search: SolverSearch, progress: Progress) -> list[EvaluatedSolver]:
    """The genetic search, with all that ever reached a target: what died out later costs nothing to keep."""
    evolve(search, progress)
    return [evaluated for _, evaluated in sorted(search.evaluated.items()) if search.reaches_target(evaluated).any()]


def evolve(search: SolverSearch, progress: Progress) -> set[MarkerSubset]:
    """The population after the last generation: subsets as chromosomes, crossover, mutation, and a quarter that dies out per generation.

    Fitness is the best hit rate of the solver, capped at the target; among equals the smaller solver wins. Mutations are permutation,
    addition and subtraction. Subtraction is drawn twice as often as the other mutations, which favours small solvers. At most twice
    `beam_width` subsets live on.
    """
    rng, n, size = search.rng, search.n_markers, search.settings.beam_width
    generations = search.settings.generations
    # Six markers on average: smaller solvers fail, larger ones cost.
    genes = rng.random((size, n)) < np.minimum(6.0 / n, 0.8)
    population = {subset for row in genes if len(subset := _subset_of(row)) > 2}
    for generation in range(generations):
        progress(generation / generations, f"generation {generation + 1} of {generations}")
        parents = sorted(population)
        drawn = rng.integers(len(parents), size=(size // 2, 2))
        for first, second in drawn:
            mother, father = _genes_of(parents[first], n), _genes_of(parents[second], n)
            crossed = np.where(rng.random(n) < 0.5, mother, father)
            mutant = _mutated(mother, rng)
            population.update(s for s in (_subset_of(crossed), _subset_of(mutant)) if 2 < len(s) <= search.settings.max_markers)
        ranked = sorted(population, key=lambda subset: _rank_key(search, subset))
        population = set(ranked[: max(size, int(0.75 * len(ranked)))][: 2 * size])
    progress(1.0, "searched")
    return population


def _genes_of(subset: MarkerSubset, n: int) -> NDArray[np.bool_]:
    genes = np.zeros(n, dtype=np.bool_)
    genes[list(subset)] = True
    return genes


def _subset_of(genes: NDArray[np.bool_]) -> MarkerSubset:
    return tuple(np.nonzero(genes)[0].tolist())


def _mutated(genes: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """A permutation (0), an addition (1) or a subtraction (2 and 3) of one marker."""
    child = genes.copy()
    ones, zeros = np.nonzero(genes)[0], np.nonzero(~genes)[0]
    mutation = rng.integers(4)
    if mutation != 1 and len(ones):
        child[rng.choice(ones)] = False
    if mutation <= 1 and len(zeros):
        child[rng.choice(zeros)] = True
    return child


def _rank_key(search: SolverSearch, subset: MarkerSubset) -> tuple[float, int, float, MarkerSubset]:
    """Sorts the fittest subset first."""
    evaluated = search.evaluate(subset)
    if evaluated is None:
        # Nothing can be built of it: it ranks last.
        return (1.0, len(subset), 0.0, subset)
    shortfall = np.maximum(search.targets - evaluated.hit_rates, 0.0)
    return (float(np.nanmin(shortfall)), len(subset), -float(evaluated.response_rates.max()), subset)


def _most_rigid(search: SolverSearch, subsets: list[MarkerSubset], limit: int) -> list[MarkerSubset]:
    """Of many subsets those whose pairs of markers keep the most constant distances: rigid neighbours are told apart best."""
    if len(subsets) <= limit:
        return subsets
    width = search.weak.high - search.weak.low
    narrowest = np.full((search.n_markers, search.n_markers), np.inf)
    for row in np.nonzero((search.point_counts == 2) & ~search.moving)[0]:
        a, b = np.nonzero(search.reads[row])[0]
        narrowest[a, b] = narrowest[b, a] = min(narrowest[a, b], width[row])
    np.fill_diagonal(narrowest, 0.0)
    # Pairs without an interval count as far from rigid, not as impossible.
    narrowest[np.isinf(narrowest)] = 10.0
    markers = np.array(subsets)
    cost = sum(narrowest[markers[:, [i]], markers].sum(axis=1) for i in range(markers.shape[1]))
    # A subset is compared with those that hold the same marker only.
    holds = (markers[:, :, None] == np.arange(search.n_markers)).any(axis=1)
    return [subsets[i] for i in _equal_shares(np.where(holds, cost[:, None], np.inf), limit)]


def _best_per_marker(search: SolverSearch, candidates: list[EvaluatedSolver], limit: int) -> list[EvaluatedSolver]:
    """The candidates with the highest hit rates, an equal share for every marker."""
    if len(candidates) <= limit:
        return candidates
    hit_rates = np.nan_to_num(np.array([c.hit_rates for c in candidates]), nan=-1.0)
    # The response rate decides among equals.
    rates = hit_rates + 1e-3 * np.array([c.response_rates for c in candidates])
    return [candidates[i] for i in _equal_shares(-rates, limit)]


def _equal_shares(costs: Floats, limit: int) -> list[int]:
    """Rows of costs (C, M), `limit` at most: for each marker as many of the cheapest, so that none is forgotten; inf is no cost."""
    most = max(1, limit // costs.shape[1])
    cheapest = np.argsort(costs, axis=0, kind="stable")[:most]
    return np.unique(cheapest[np.isfinite(np.take_along_axis(costs, cheapest, axis=0))]).tolist()
