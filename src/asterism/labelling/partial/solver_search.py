"""Mining: labelled frames in; small partial solvers with high hit rates that together cover the marker set out (thesis 4.5.2, 4.5.3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.labelling.partial._evaluation_kernels import EvaluationLimits, ProposalCounts, ValidationFrames, evaluate_solver
from asterism.labelling.partial._pair_search_kernels import make_search_workspace
from asterism.labelling.partial.features import FEATURES as REGISTRY
from asterism.labelling.partial.features import MANY_MARKERS, members
from asterism.labelling.partial.matrix import BUDGET, PartialSolvers, whole_model
from asterism.labelling.partial.solver import Solver, pack, plant, replacements, share_pairs
from asterism.labelling.partial.weak import Spread, Trial
from asterism.progress import Progress
from asterism.recording import Floats, Ints

FEATURES = ("g1", "g2", "g4", "g6", "g7", "g8", "g9")
"""Of a few markers, all that can be measured helps: with the thesis' three features, solvers of six markers fail three times as often."""

FEATURES_OF_MANY = ("g2", "g4", "g7", "g9")
"""With more than `features.MANY_MARKERS` markers, whose triples and quadruples are too many to weigh them all."""

Subset = tuple[int, ...]

LOST, MOST_LOST = 0.08, 0.5
"""In an exposure, the share of the points whose motion is not known per hidden marker, and at most: ends of tracks beside the gaps."""

MINERS = ("bottom-up", "top-down", "genetic")


ANSWERS = 0.3
"""A solver that proposes a marker less often than this, its markers all in sight, is none for it: too little is known of its hit rate."""


@dataclass(frozen=True)
class Mining:
    """How a mine is worked.

    weak_classifiers  most classifiers of a solver, boosted from those over its markers (a small subset has fewer, and takes all); those of
                      two points' motion come on top
    glance, exposures frames on which every subset is tried, and those on which a promising one is judged
    proof             frames on which those finally chosen are judged once more
    most_hidden       exposures hide 0 to so many markers
    breadth           subsets that a level keeps (bottom-up, top-down), or the population (genetic)
    largest           markers of the largest partial solver
    most_solvers      solvers of the ensemble
    """

    weak_classifiers: int = 200
    glance: int = 300
    exposures: int = 2000
    proof: int = 12000
    most_hidden: int = 5
    breadth: int = 300
    largest: int = 8
    most_solvers: int = 120


@dataclass(frozen=True)
class Assessed:
    """A partial solver and what its exposure to frames showed.

    hit_rates (M,) share of its proposals that are right, NaN for other markers (1st property); answers (M,) share of the frames with all
    its markers in sight in which it proposes the right point; judged, whether on all exposures or on a glance
    """

    solver: Solver
    hit_rates: Floats
    answers: Floats
    judged: bool


class Mine:
    """Frames, classifiers and wrong labellings, prepared once, from which the strong classifier of any subset of markers follows quickly.

    All subsets share one set of wrong labellings of the whole model: a partial solver meets the points of all markers, so restricted to its
    markers they are just what it must reject.
    """

    def __init__(
        self,
        frames: Floats,
        groups: Ints,
        *,
        targets: ArrayLike = 0.9999,
        features: Sequence[str] | None = None,
        rule: str = "widened",
        widen: float = 0.25,
        settings: Mining | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        """Upright frames (N, M, 3) m, or (N, M, WIDTH) with their motion, groups (N,) whose each is; targets one or one per marker."""
        self.settings = Mining() if settings is None else settings
        self.rng = np.random.default_rng(seed)
        self.frames = np.ascontiguousarray(frames)
        self.n_markers = frames.shape[1]
        self.targets = np.broadcast_to(np.asarray(targets, dtype=np.float64), (self.n_markers,)).copy()
        if not ((self.targets > 0) & (self.targets <= 1)).all():
            raise AsterismError("a target hit rate lies above 0 and is at most 1, such as 0.9999.")
        if features is None:
            features = FEATURES if self.n_markers <= MANY_MARKERS else FEATURES_OF_MANY
        weak = Spread.measure(self.frames, groups, features, self.rng).weak(rule, widen)
        self.weak = weak.take(np.isfinite(weak.low))
        self.reads = members(self.weak.kinds, self.weak.slots, self.n_markers)
        self.points = self.reads.sum(axis=1)
        self.moving = np.array([feature.moving for feature in REGISTRY])[self.weak.kinds]
        self.spread = self.weak.high - self.weak.low
        self.table = replacements(self.frames, self.weak, self.rng)
        self.trial = Trial.draw(self.frames, self.weak, self.rng, 2048)
        s = self.settings
        self.choice = self.rng.integers(len(self.frames), size=max(s.exposures, s.proof))
        self.hidden = hide(len(self.choice), self.n_markers, s.most_hidden, self.rng)
        self.lost = self.hidden
        if self.frames.shape[2] > 3:
            share = np.minimum(LOST * self.hidden.sum(axis=1), MOST_LOST)
            self.lost = self.rng.random(self.hidden.shape) < share[:, None]
        n, moving = self.n_markers, len(np.unique(self.weak.kinds[self.moving & (self.points == 2)]))
        self.bench, self.now = make_search_workspace(n, n, n, self.frames.shape[2], moving), 0
        self.known: dict[Subset, Assessed] = {}

    def build(self, markers: Subset) -> Solver | None:
        """The solver of a subset: boosted classifiers in a search tree. None where no classifier reads its markers alone."""
        own = np.array(markers, dtype=np.int64)
        rows = np.nonzero(self.reads[:, own].sum(axis=1) == self.points)[0]
        if not len(rows):
            return None
        most = self.settings.weak_classifiers
        if len(rows) > most:
            pairs = self.points[rows] == 2
            left = most - int((pairs & ~self.moving[rows]).sum())
            rows = np.concatenate([rows[pairs], self.trial.boost(rows[~pairs], own, max(1, left))[0]])
        table = self.table[rows]
        bits = np.unpackbits(np.ascontiguousarray(table[:, own]).view(np.uint8), axis=2).sum(axis=(0, 2))
        return plant(self.weak.take(rows), table, own, int(own[np.argmax(bits)]))

    def assess(self, markers: Iterable[int], proof: bool = False) -> Assessed | None:
        """Hit rates of a subset's solver; judged on all exposures where a glance leaves hope. None where no solver can be built."""
        subset = tuple(sorted(markers))
        known = self.known.get(subset)
        if known is not None and not proof:
            return known
        solver = self.build(subset) if known is None else known.solver
        if solver is None:
            return None
        if proof:
            return self._expose(solver, self.settings.proof)
        assessed = self._expose(solver, self.settings.glance)
        if self.reaches(assessed).any():
            assessed = self._expose(solver, self.settings.exposures)
        self.known[subset] = assessed
        return assessed

    def _expose(self, solver: Solver, exposures: int) -> Assessed:
        hits, failures, silent = (np.zeros(self.n_markers, dtype=np.int64) for _ in range(3))
        allowed = max(2 if exposures > self.settings.glance else 8, int((1 - self.targets.min()) * exposures * 2))
        arrays, pairs = share_pairs(pack([solver]), self.n_markers)
        now, self.now = self.now, self.now + exposures
        validation = ValidationFrames(self.frames, self.choice[:exposures], self.hidden[:exposures], self.lost[:exposures])
        counts, limits = ProposalCounts(hits, failures, silent), EvaluationLimits(BUDGET, allowed)
        evaluate_solver(arrays, pairs, 0, validation, limits, self.bench, now, counts)
        own = np.zeros(self.n_markers, dtype=np.bool_)
        own[solver.markers] = True
        rates = np.where(own, hits / np.maximum(hits + failures, 1), np.nan)
        answers = np.where(own, hits / np.maximum(hits + silent, 1), 0.0)
        return Assessed(solver, rates, answers, exposures > self.settings.glance)

    def reaches(self, assessed: Assessed) -> NDArray[np.bool_]:
        """(M,) where a solver's hit rate reaches the target."""
        return (np.nan_to_num(assessed.hit_rates, nan=-1.0) >= self.targets) & (assessed.answers >= ANSWERS)


def hide(count: int, n_markers: int, most: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(count, n_markers) which markers each exposure hides: 0 to `most` of them, each number as often, at random."""
    number = np.arange(count) % (min(most, max(n_markers - 1, 0)) + 1)
    ranks = np.argsort(np.argsort(rng.random((count, n_markers)), axis=1), axis=1)
    hidden: NDArray[np.bool_] = ranks < number[:, None]
    return hidden


def mine(
    frames: Floats,
    groups: Ints,
    *,
    targets: ArrayLike = 0.9999,
    miner: str = "bottom-up",
    features: Sequence[str] | None = None,
    rule: str = "widened",
    widen: float = 0.25,
    settings: Mining | None = None,
    seed: int | np.random.Generator = 0,
    progress: Progress | None = None,
) -> PartialSolvers:
    """Find partial solvers that reach the target hit rates and together cover the markers.

    frames (N, M, 3) m, z up, NaN where missing, for features of motion (N, M, WIDTH); groups (N,) whose frame each is; targets a number or
    (M,); miner one of `MINERS`; features by name, or None for `FEATURES` (`FEATURES_OF_MANY`), all of single frames; rule and widen as in
    `weak.Spread.weak`. On the gait recordings a factor of 0.1 measured best for people in training, 1.5 for people that are not.

    A hit rate is measured on frames of the ground truth with 0 to 5 markers hidden: of the points that the solver proposes for a marker,
    the share that is right. The thesis exposes its solvers to whole frames; with markers hidden, a solver that takes a stranger's point
    where it should stay silent is found out, which is stricter. Where a solver finds several labellings, it is silent about the markers
    in which they differ; how often is in `Assessed.answers`, and guides the choice, not the trust.

    Equal seeds give equal solvers. Raises AsterismError for an unknown miner or fewer than three markers.
    """
    if miner not in MINERS:
        raise AsterismError(f"miner {miner!r} is not known; choose among {', '.join(MINERS)}.")
    if frames.shape[1] < 3:
        raise AsterismError(f"{frames.shape[1]} markers cannot be told apart by distances and heights; a marker set needs at least three.")
    quarry = Mine(frames, groups, targets=targets, features=features, rule=rule, widen=widen, settings=settings, seed=seed)
    tell = progress or (lambda fraction, doing: None)
    dig = {"bottom-up": bottom_up, "top-down": top_down, "genetic": genetic}[miner]
    found = dig(quarry, lambda fraction, doing: tell(0.8 * fraction, doing))
    return choose(quarry, found, lambda fraction, doing: tell(0.8 + 0.2 * fraction, doing))


def bottom_up(quarry: Mine, progress: Progress) -> list[Assessed]:
    """Algorithm 4.1: start with one marker each, add markers until a target is reached.

    A solver that reaches the target in one of its markers joins the result and grows no further. Of the others, a level keeps the `breadth`
    best, an equal share for every marker, so that no part of the body is forgotten.
    """
    level: set[Subset] = {(marker,) for marker in range(quarry.n_markers)}
    found: list[Assessed] = []
    largest = min(quarry.settings.largest, quarry.n_markers)
    for size in range(2, largest + 1):
        grown = sorted({tuple(sorted((*subset, m))) for subset in level for m in range(quarry.n_markers) if m not in subset})
        grown = _nearest(quarry, grown, 4 * quarry.settings.breadth)
        waiting: list[Assessed] = []
        for number, subset in enumerate(grown):
            if number % 16 == 0:
                progress((size - 2 + number / len(grown)) / (largest - 1), f"solvers of {size} markers")
            assessed = quarry.assess(subset)
            if assessed is None:
                continue
            (found if quarry.reaches(assessed).any() else waiting).append(assessed)
        if not waiting:
            break
        level = {tuple(sorted(a.solver.markers.tolist())) for a in _best(quarry, waiting, quarry.settings.breadth)}
    progress(1.0, "mined")
    return found


def top_down(quarry: Mine, progress: Progress) -> list[Assessed]:
    """Algorithm 4.2: start with all markers, take markers out as long as a target is reached.

    A solver joins the result when none of its children reaches a target. (As printed, step 2d drops the child instead of keeping the
    parent, which would return the solvers that fail.) A level keeps the `breadth` best, an equal share for every marker; what reaches a
    target and is not followed further joins the result too.
    """
    whole = quarry.assess(range(quarry.n_markers))
    level = [] if whole is None else [whole]
    found, last = list(level), quarry.n_markers
    while level and last > 2:
        parents: list[tuple[Assessed, list[Subset]]] = []
        wanted: set[Subset] = set()
        for parent in level:
            markers = sorted(parent.solver.markers.tolist())
            children = [tuple(m for m in markers if m != out) for out in markers]
            parents.append((parent, children))
            wanted.update(children)
        tried = set(_nearest(quarry, sorted(wanted), 2 * quarry.settings.breadth))
        survivors: dict[Subset, Assessed] = {}
        for number, (parent, children) in enumerate(parents):
            if number % 16 == 0:
                progress(1.0 - last / quarry.n_markers + number / len(parents) / quarry.n_markers, f"solvers of {last - 1} markers")
            living = False
            for child in children:
                assessed = quarry.assess(child) if child in tried else None
                if assessed is not None and quarry.reaches(assessed).any():
                    survivors[child] = assessed
                    living = True
            if not living:
                found.append(parent)
        living_on = [survivors[key] for key in sorted(survivors)]
        level = _best(quarry, living_on, quarry.settings.breadth)
        kept = {id(assessed) for assessed in level}
        found += [assessed for assessed in living_on if id(assessed) not in kept]
        last -= 1
    progress(1.0, "mined")
    return found + level


def genetic(quarry: Mine, progress: Progress) -> list[Assessed]:
    """The genetic search: subsets as chromosomes, crossover, mutation, and a quarter that dies out per generation.

    Fitness is the best hit rate of the solver, capped at the target; among equals the smaller solver wins. Mutations are
    permutation, addition and subtraction. Subtraction is drawn twice as often
    as the other mutations, which drives towards small solvers. All that ever reached a target are returned.
    """
    rng, n, size = quarry.rng, quarry.n_markers, quarry.settings.breadth
    generations = 12
    genes = rng.random((size, n)) < np.minimum(6.0 / n, 0.8)
    population = {subset for row in genes if len(subset := _subset(row)) > 2}
    for generation in range(generations):
        progress(generation / generations, f"generation {generation + 1} of {generations}")
        parents = sorted(population)
        drawn = rng.integers(len(parents), size=(size // 2, 2))
        for first, second in drawn:
            mother, father = _genes(parents[first], n), _genes(parents[second], n)
            crossed = np.where(rng.random(n) < 0.5, mother, father)
            mutant = _mutated(mother, rng)
            population.update(subset for subset in (_subset(crossed), _subset(mutant)) if 2 < len(subset) <= quarry.settings.largest)
        ranked = sorted(population, key=lambda subset: _fitness(quarry, subset))
        population = set(ranked[: max(size, int(0.75 * len(ranked)))][: 2 * size])
    progress(1.0, "mined")
    return [assessed for _, assessed in sorted(quarry.known.items()) if quarry.reaches(assessed).any()]


def _genes(subset: Subset, n: int) -> NDArray[np.bool_]:
    genes = np.zeros(n, dtype=np.bool_)
    genes[list(subset)] = True
    return genes


def _subset(genes: NDArray[np.bool_]) -> Subset:
    return tuple(np.nonzero(genes)[0].tolist())


def _mutated(genes: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    child = genes.copy()
    ones, zeros = np.nonzero(genes)[0], np.nonzero(~genes)[0]
    way = rng.integers(4)
    if way != 1 and len(ones):
        child[rng.choice(ones)] = False
    if way <= 1 and len(zeros):
        child[rng.choice(zeros)] = True
    return child


def _fitness(quarry: Mine, subset: Subset) -> tuple[float, int, float, Subset]:
    assessed = quarry.assess(subset)
    if assessed is None:
        return (1.0, len(subset), 0.0, subset)
    short = np.maximum(quarry.targets - assessed.hit_rates, 0.0)
    return (float(np.nanmin(short)), len(subset), -float(assessed.answers.max()), subset)


def _nearest(quarry: Mine, subsets: list[Subset], limit: int) -> list[Subset]:
    """Of many subsets those whose pairs of markers keep the steadiest distances: rigid neighbours are told apart best."""
    if len(subsets) <= limit:
        return subsets
    pairs = (quarry.points == 2) & ~quarry.moving
    steady = np.full((quarry.n_markers, quarry.n_markers), np.inf)
    for row in np.nonzero(pairs)[0]:
        a, b = np.nonzero(quarry.reads[row])[0]
        steady[a, b] = steady[b, a] = min(steady[a, b], quarry.spread[row])
    np.fill_diagonal(steady, 0.0)
    steady[np.isinf(steady)] = 10.0
    members_of = np.array(subsets)
    cost = sum(steady[members_of[:, [i]], members_of].sum(axis=1) for i in range(members_of.shape[1]))
    kept: set[int] = set()
    per_marker = max(1, limit // quarry.n_markers)
    order = np.argsort(cost, kind="stable")
    for marker in range(quarry.n_markers):
        kept.update(order[(members_of[order] == marker).any(axis=1)][:per_marker].tolist())
    return [subsets[i] for i in sorted(kept)]


def _best(quarry: Mine, candidates: list[Assessed], limit: int) -> list[Assessed]:
    """The candidates with the highest hit rates, an equal share for every marker."""
    if len(candidates) <= limit:
        return candidates
    rates = np.nan_to_num(np.array([c.hit_rates for c in candidates]), nan=-1.0) + 1e-3 * np.array([c.answers for c in candidates])
    kept: set[int] = set()
    per_marker = max(1, limit // quarry.n_markers)
    for marker in range(quarry.n_markers):
        kept.update(np.argsort(-rates[:, marker], kind="stable")[:per_marker].tolist())
    return [candidates[i] for i in sorted(kept)]


def choose(quarry: Mine, found: list[Assessed], progress: Progress, patterns: int = 1500) -> PartialSolvers:
    """The ensemble: of the solvers found those that, over random patterns of hidden markers, leave the fewest markers without a proposal.

    Chosen one after the other by how much each adds, small ones first among equals; each is judged once more on `proof` exposures before
    it is in. For a marker that no solver reaches the target of, the best that is known is taken, and the marker flagged.
    """
    n, settings = quarry.n_markers, quarry.settings
    found = sorted(found, key=lambda a: (len(a.solver.markers), sorted(a.solver.markers.tolist())))
    chosen: list[Assessed] = []
    hidden = hide(patterns, n, settings.most_hidden + 1, quarry.rng)
    lacking = (~hidden).astype(np.float64)
    rates = np.array([quarry.reaches(a) * a.answers for a in found]).reshape(-1, n)
    ready = np.array([~hidden[:, a.solver.markers].any(axis=1) for a in found], dtype=np.float64).reshape(-1, patterns)
    cost = 1.0 + 0.02 * np.array([len(a.solver.markers) for a in found])
    while len(chosen) < settings.most_solvers and len(found):
        gain = ((ready @ lacking) * rates).sum(axis=1) / cost
        best = int(np.argmax(gain))
        if gain[best] < 0.02:
            break
        proven = quarry.assess(found[best].solver.markers.tolist(), proof=True)
        assert proven is not None
        now = quarry.reaches(proven) * proven.answers
        if (now < rates[best] - 0.05).any():
            rates[best] = now
            continue
        lacking *= 1.0 - ready[best][:, None] * now
        rates[best] = 0.0
        chosen.append(proven)
        progress(len(chosen) / settings.most_solvers, f"{len(chosen)} solvers chosen")
    covered = np.any(np.array([quarry.reaches(a) for a in chosen], dtype=np.bool_).reshape(-1, n), axis=0)
    trusted = [quarry.reaches(a) for a in chosen]
    for marker in np.nonzero(~covered)[0]:
        able = [a for _, a in sorted(quarry.known.items()) if a.hit_rates[marker] > 0]
        for stopgap in sorted(able, key=lambda a: (-a.hit_rates[marker], len(a.solver.markers)))[:3]:
            chosen.append(stopgap)
            trusted.append(np.arange(n) == marker)
    arrays = pack([a.solver for a in chosen])
    by_depth = [may[a.solver.markers] for a, may in zip(chosen, trusted, strict=True)]
    progress(1.0, f"{len(chosen)} solvers")
    return PartialSolvers(
        arrays,
        np.array([a.hit_rates for a in chosen]).reshape(-1, n),
        quarry.targets,
        covered,
        np.concatenate([np.empty(0, dtype=np.bool_), *by_depth]),
        whole_model(quarry.weak, quarry.table),
    )
