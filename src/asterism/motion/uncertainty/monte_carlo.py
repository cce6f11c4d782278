"""A model that draws its inputs in; the distribution of its outputs, from as many trials as these need, out (GUM Supplement 1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Floats


@dataclass(frozen=True)
class MonteCarloRules:
    """How many trials are made, and what is stated of them.

    block     trials between two looks at whether they are enough
    most      trials at most; 100, as in GaMoCap, gives the ends of a 95 % interval to a tenth of its width only
    digits    significant digits of the standard uncertainty that must be certain (Supplement 1, 7.9.2)
    coverage  probabilities of the stated intervals
    """

    block: int = 100
    most: int = 1000
    digits: int = 1
    coverage: tuple[float, ...] = (0.65, 0.95)


RULES = MonteCarloRules()


@dataclass(frozen=True)
class MonteCarlo:
    """What the trials gave.

    estimate     (...) mean of the outputs; standard (...) their standard uncertainty. Of the trials in which an output is known (not NaN);
                 NaN where it is never known, `standard` also where it is known in one trial only
    intervals    {probability: (low, high)} shortest coverage intervals, each (...)
    trials       how many were made; tolerance (...) what counts as certain; converged whether they were enough
    values       (trials, ...) all outputs, in the order of the trials
    """

    estimate: Floats
    standard: Floats
    intervals: dict[float, tuple[Floats, Floats]]
    trials: int
    tolerance: float
    converged: bool
    values: Floats


def run_monte_carlo(
    model: Callable[[np.random.Generator], Floats],
    *,
    seed: int = 0,
    workers: int = 1,
    rules: MonteCarloRules = RULES,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Run a model with drawn inputs until its outputs are known well enough.

    model  takes the generator of one trial and gives an array, of the same shape each time. Trial k has the generator of (seed, k), so
           the result does not depend on `workers`, threads that share the trials

    Adaptive as in Supplement 1, 7.9.4: after each block the means over the blocks of estimate, standard uncertainty and interval ends must
    have twice their standard deviation below the tolerance, which is half a unit of the last of `digits` digits of the standard
    uncertainty (its median over the outputs). Blocks are smaller than the Supplement's 10,000, because a trial is a whole analysis;
    intervals are therefore taken from all trials together. Raises AsterismError where the rules make no sense.

    >>> length = run_monte_carlo(lambda rng: np.linalg.norm(rng.normal([3.0, 4.0], 0.01), keepdims=True), seed=1)
    >>> round(float(length.estimate[0]), 1), round(float(length.standard[0]), 2)
    (5.0, 0.01)
    """
    _check(rules, workers)
    values: list[Floats] = []
    blocks: list[Floats] = []
    tolerance, converged = np.inf, False
    with ThreadPoolExecutor(workers) as pool:
        while len(values) < rules.most and not converged:
            # Trial k always has the generator (seed, k), whoever computes it.
            numbers = range(len(values), min(len(values) + rules.block, rules.most))
            new = list(pool.map(lambda k: np.asarray(model(np.random.default_rng([seed, k]))), numbers))
            values += new
            blocks.append(_summary(np.array(new), rules))
            standard = mean_and_standard(np.array(values))[1]
            known = standard[np.isfinite(standard)]
            if not len(known):  # no output is ever known: more trials would not tell it
                tolerance, converged = np.inf, True
                break
            tolerance = numerical_tolerance(float(np.median(known)), rules.digits)
            if len(blocks) > 1:
                spread = 2 * mean_and_standard(np.array(blocks))[1] / np.sqrt(len(blocks))
                converged = bool(np.max(spread[np.isfinite(spread)], initial=0.0) < tolerance)
            if progress is not None:
                progress(len(values) / rules.most, "Monte Carlo trials")
    every = np.array(values)
    intervals = {p: shortest_interval(every, p) for p in rules.coverage}
    return MonteCarlo(*mean_and_standard(every), intervals, len(values), tolerance, converged, every)


def run_by_source(
    trial: Callable[[tuple[str, ...]], Callable[[np.random.Generator], Floats]],
    sources: Sequence[str],
    budget_trials: int,
    **options: Any,
) -> tuple[MonteCarlo, dict[str, MonteCarlo], Floats]:
    """A Monte Carlo with all sources of error; one with each alone; and the standard uncertainty (...) of all in as many trials as one.

    trial    makes the model of `run_monte_carlo` with only these sources
    options  of `run_monte_carlo`: seed, workers, rules, progress
    """
    total = run_monte_carlo(trial(tuple(sources)), **options)
    few = {**options, "rules": replace(options["rules"], most=budget_trials, block=budget_trials)}
    alone = {name: run_monte_carlo(trial((name,)), **few) for name in sources}
    return total, alone, mean_and_standard(total.values[:budget_trials])[1]


def _check(rules: MonteCarloRules, workers: int) -> None:
    if rules.block < 2 or rules.most < 2 or rules.digits < 1 or workers < 1:
        raise AsterismError("a Monte Carlo needs two trials or more in a block and in all, a digit to be certain of, and one worker.")
    if not all(0 < p < 1 for p in rules.coverage):
        raise AsterismError(f"coverage probabilities {rules.coverage} are not all between 0 and 1; give for example 0.65 and 0.95.")


def _summary(values: Floats, rules: MonteCarloRules) -> Floats:
    ends = [end for p in rules.coverage for end in shortest_interval(values, p)]
    return np.array([*mean_and_standard(values), *ends])


def mean_and_standard(values: Floats) -> tuple[Floats, Floats]:
    """Mean and standard deviation (...) of values (M, ...) over those that are not NaN: NaN of none, and the deviation of one."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean = np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    # About the mean of the known ones, so that a gap adds nothing.
    squares = (np.where(known, values - mean, 0.0) ** 2).sum(axis=0)
    return mean, np.where(count > 1, np.sqrt(squares / np.maximum(count - 1, 1)), np.nan)


def numerical_tolerance(standard: float, digits: int = 1) -> float:
    """Half a unit of the last significant digit of a standard uncertainty (Supplement 1, 7.9.2): 0.05 for 0.4 and one digit."""
    # A certain output has no digit that could be uncertain.
    if not standard > 0 or not np.isfinite(standard):
        return np.inf
    return float(0.5 * 10.0 ** (np.floor(np.log10(standard)) - digits + 1))


def shortest_interval(values: Floats, probability: float) -> tuple[Floats, Floats]:
    """The shortest interval that holds this share of the values (M, ...) along the first axis (Supplement 1, 7.7.2 and note 3).

    Of the M values that are not NaN q = pM, rounded, lie above the lower end and up to the upper one. NaN where all values are. Raises
    AsterismError where there is no value.

    >>> shortest_interval([0.0, 1.0, 1.1, 1.2, 9.0], 0.4)
    (array(1.), array(1.2))
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=0)  # NaN last
    if not len(ordered):
        raise AsterismError("an interval of no values was asked for; give one value or more.")
    count = np.isfinite(ordered).sum(axis=0)
    low, high = np.full(ordered.shape[1:], np.nan), np.full(ordered.shape[1:], np.nan)
    # Outputs that are known in equally many trials share a span, so all of them are searched at once.
    for size in np.unique(count[count > 0]):
        own = count == size
        known = ordered[:size, own]
        span = min(int(np.floor(probability * size + 0.5)), int(size) - 1)
        first = np.argmin(known[span:] - known[: size - span], axis=0)[None]
        low[own] = np.take_along_axis(known, first, axis=0)[0]
        high[own] = np.take_along_axis(known, first + span, axis=0)[0]
    return low, high
