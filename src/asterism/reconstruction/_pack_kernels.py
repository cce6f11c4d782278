"""Weighted set packing on flat arrays: hypotheses that want the same blobs in, the set without a conflict that is worth most out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.reconstruction._hypothesis_kernels import holders_by_blob
from asterism.reconstruction._order_kernels import ascending

MOST_WORK = 5_000_000
"""How many times the search in one component may look at a rival before it stops with the best set found so far, and how many times the
exchanges that follow may: some 15 ms, for recordings."""
TOLERANCE = 1e-9
"""nats: a set must be better by more to replace another, so that rounding does not decide."""


class Packing(NamedTuple):
    """A packing problem of n hypotheses and B blobs.

    rays       (n, C) blob of each camera or -1
    scores     (n,) > 0
    starts     (B + 1,), holders: blob b is held by the hypotheses holders[starts[b]:starts[b + 1]]
    most_work  looks at a rival, after which the search in one component stops, and the exchanges that follow
    """

    rays: np.ndarray
    scores: np.ndarray
    starts: np.ndarray
    holders: np.ndarray
    most_work: float


class Component(NamedTuple):
    """Hypotheses that are connected by common blobs: m of the n.

    members   (m,) by falling score
    place     (n,) the place of each hypothesis among the members, -1 for all others
    """

    members: np.ndarray
    place: np.ndarray


@kernel
def pack(rays, scores, count, blobs, most_work):
    """Choose hypotheses of the greatest total score, no two with a blob in common.

    IN  rays (n, C) blob numbers below `blobs` or -1; scores (n,) > 0; the first `count` rows count
    Returns chosen (count,) bool, and for how many components the search ended before the choice was proved to be the best.

    A hypothesis that is worth no less than the best that its rivals can be worth together is taken at once. What is left falls into
    components without common blobs, each solved by branch and bound. Within `most_work` the choice is the best there is; beyond, it is the
    best found, improved by exchanges of one for several. O(n log n), and `most_work` for each component.
    Twins: an integer program (tests/test_reconstruction.py), all sets (tests/test_reconstruction_twins.py)
    """
    # The best come first: early sets are then worth much, and the bound cuts more of the others.
    order = ascending(-scores, count)
    starts, holders = holders_by_blob(rays, order, blobs)
    problem = Packing(rays, scores, starts, holders, most_work)
    chosen, open_ = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    # Most hypotheses of a frame have no serious rival, and need no search.
    _take_dominant(problem, order, open_, chosen)
    unproved = 0
    members, falling, place = np.empty(count, np.int64), np.empty(count), np.full(count, -1, np.int64)
    for n in order:
        if not open_[n]:
            continue
        many = _conflict_component(problem, open_, n, members, place)
        for k in range(many):
            falling[k] = -scores[members[k]]
        component = Component(members[ascending(falling, many)], place)
        for k in range(many):
            # Places by score, as `_search` and `_bound` go through the members.
            place[component.members[k]] = k
        if not _search(problem, component, chosen):
            unproved += 1
        for k in range(many):
            # Its places are cleared one by one: to clear the whole array would cost n for each component.
            open_[component.members[k]] = False
            place[component.members[k]] = -1
    return chosen, unproved


@kernel
def _take_dominant(problem, order, open_, chosen):
    """Take each hypothesis that is worth no less than the sum, over its blobs, of the best rival there; repeat while one is found.

    IN  order (n,) by falling score
    OUT open_ (n,), False for hypotheses that are taken or lost; chosen (n,)
    O(rounds * n * C * rivals of a blob).
    """
    counted = np.full(len(order), -1, np.int64)
    stamp = 0
    changed = True
    while changed:
        changed = False
        for n in order:
            if not open_[n]:
                continue
            # A number for each look instead of an array to clear: a rival of several blobs is counted once.
            stamp += 1
            rivals = 0.0
            for c in range(problem.rays.shape[1]):
                blob = problem.rays[n, c]
                if blob < 0:
                    continue
                best = 0.0
                for at in range(problem.starts[blob], problem.starts[blob + 1]):
                    other = problem.holders[at]
                    if open_[other] and other != n and counted[other] != stamp:
                        counted[other] = stamp
                        best = max(best, problem.scores[other])
                # Of the rivals at one blob at most one can be chosen, so the best of each blob bounds what they are worth together.
                rivals += best
            # Any set with rivals of n can put n in their place and be worth no less.
            if problem.scores[n] >= rivals:
                chosen[n] = True
                changed = True
                _remove_with_rivals(problem, open_, n)


@kernel
def _remove_with_rivals(problem, open_, n):
    """OUT open_ (n,): False for a hypothesis and all its rivals. O(rivals)."""
    open_[n] = False
    for c in range(problem.rays.shape[1]):
        blob = problem.rays[n, c]
        if blob >= 0:
            for at in range(problem.starts[blob], problem.starts[blob + 1]):
                open_[problem.holders[at]] = False


@kernel
def _conflict_component(problem, open_, n, members, place):
    """All open hypotheses that are connected with hypothesis n by common blobs.

    OUT members, the first of which they are; place, not -1 for them
    Returns how many. O(members * rivals), no allocation: frames can have thousands of components.

    Bounds: a hypothesis has one place, so there are no more members than hypotheses.
    """
    place[n] = 0
    members[0] = n
    many, at = 1, 0
    while at < many:
        for c in range(problem.rays.shape[1]):
            blob = problem.rays[members[at], c]
            if blob >= 0:
                for k in range(problem.starts[blob], problem.starts[blob + 1]):
                    other = problem.holders[k]
                    if open_[other] and place[other] < 0:
                        # A place marks it as found, so that it comes once.
                        place[other] = many
                        members[many] = other
                        many += 1
        at += 1
    return many


@kernel
def _search(problem, component, chosen):
    """Branch and bound over one component, which begins with the greedy choice.

    OUT chosen (n,), the best set added
    Returns whether that set is proved to be the best. O(2^m), at most `most_work` looks at rivals.
    Twin: all sets (tests/test_reconstruction_twins.py)

    Bounds: `depth` counts members that are taken, each once, m at most; path has one more.
    """
    scores, members = problem.scores, component.members
    many = len(members)
    blocked, covered = np.zeros(many, np.int64), np.full(many, -1, np.int64)
    taken, best = np.zeros(many, np.bool_), np.zeros(many, np.bool_)
    path = np.empty(many + 1, np.int64)
    # The greedy set is the first to be beaten: with it the bound cuts from the beginning.
    best_value = _greedy(problem, component, best)
    depth, at, value, work, stamp = 0, 0, 0.0, 0, 0
    proved, going = True, True
    while going:
        stamp += 1
        # What cannot become better than the best set is left at once.
        bound, looks = _bound(problem, component, at, value, blocked, covered, stamp)
        work += looks
        # A member with a rival in the set cannot come in.
        while at < many and blocked[at] != 0:
            at += 1
        # Take it first: with members in order of score the best sets come early.
        if bound > best_value + TOLERANCE and at < many and work <= problem.most_work:
            taken[at] = True
            value += scores[members[at]]
            path[depth] = at
            depth += 1
            _count_conflicts(problem, component, at, blocked, 1)
            at += 1
            continue
        if at >= many and value > best_value + TOLERANCE:
            best_value = value
            for k in range(many):
                best[k] = taken[k]
        # Counted in looks, not in seconds, so that every machine stops at the same set.
        if work > problem.most_work:
            proved = False
            break
        going = depth > 0
        if going:
            # Back to the last one taken, and on without it.
            depth -= 1
            at = path[depth]
            taken[at] = False
            value -= scores[members[at]]
            _count_conflicts(problem, component, at, blocked, -1)
            at += 1
    # The best set so far is often one exchange away from the best of all.
    if not proved:
        _exchange(problem, component, best)
    for k in range(many):
        if best[k]:
            chosen[members[k]] = True
    return proved


@kernel
def _bound(problem, component, at, value, blocked, covered, stamp):
    """What a set can be worth at most: its value, and what the members from place `at` on can add.

    Each blob is used once but no more: a cover of the members by blobs, each blob at the worth of its best member.

    IN  blocked (m,) how many rivals are in the set; covered (m,), stamp: a workspace, and a number that is not yet in it
    Returns the bound and how many times it looked at a rival. O(m * C * rivals of a blob).
    """
    rays, starts, holders = problem.rays, problem.starts, problem.holders
    bound, looks = value, 0
    for k in range(at, len(component.members)):
        # Members that are covered by an earlier one's blob are rivals of it: the better one stands for both.
        if blocked[k] != 0 or covered[k] == stamp:
            continue
        n = component.members[k]
        bound += problem.scores[n]
        widest_blob, widest = -1, 0
        for c in range(rays.shape[1]):
            blob = rays[n, c]
            if blob >= 0:
                wide = 0
                looks += starts[blob + 1] - starts[blob]
                for place in range(starts[blob], starts[blob + 1]):
                    j = component.place[holders[place]]
                    wide += j >= at and blocked[j] == 0 and covered[j] != stamp
                # Of its blobs the one that covers most members bounds them at the worth of one.
                if wide > widest:
                    widest_blob, widest = blob, wide
        for place in range(starts[widest_blob], starts[widest_blob + 1]):
            j = component.place[holders[place]]
            if j >= 0:
                covered[j] = stamp
    return bound, looks


@kernel
def _greedy(problem, component, best):
    """Take the members of a component in their order where no rival was taken, into best (m,). Returns what they are worth. O(m)."""
    blocked = np.zeros(len(component.members), np.int64)
    value = 0.0
    for k in range(len(component.members)):
        if blocked[k] == 0:
            best[k] = True
            value += problem.scores[component.members[k]]
            _count_conflicts(problem, component, k, blocked, 1)
    return value


@kernel
def _count_conflicts(problem, component, k, blocked, by):
    """OUT blocked (m,): `by` more for each member that shares a blob with member k, for each such blob. O(rivals)."""
    n = component.members[k]
    for c in range(problem.rays.shape[1]):
        blob = problem.rays[n, c]
        if blob >= 0:
            for at in range(problem.starts[blob], problem.starts[blob + 1]):
                j = component.place[problem.holders[at]]
                if j >= 0:
                    # A count, not a flag: a member may have several rivals in the set, and is free when the last has left.
                    blocked[j] += by


@kernel
def _exchange(problem, component, best):
    """Improve a set while it is worth more to put one member in, its rivals out, and then in what became free.

    OUT best (m,) bool, changed in place
    O(m * rivals^2) a round, about `most_work` looks at rivals at most. Twin: tests/twins_reconstruction.py
    """
    many = len(component.members)
    blocked = np.zeros(many, np.int64)
    for k in range(many):
        if best[k]:
            _count_conflicts(problem, component, k, blocked, 1)
    removed, added = np.empty(many, np.int64), np.empty(many, np.int64)
    improved = True
    work = 0
    while improved and work <= problem.most_work:
        improved = False
        # A member that lost to a rival by score may win with what else becomes free.
        for k in range(many):
            if best[k] or work > problem.most_work:
                continue
            leaving, lost, looks = _remove_rivals(problem, component, k, best, blocked, removed)
            work += looks
            _set_member(problem, component, k, best, blocked, True)
            won = problem.scores[component.members[k]]
            coming, won = _add_freed(problem, component, removed[:leaving], won, best, blocked, added)
            # Strictly better, so that it ends.
            if won > lost + TOLERANCE:
                improved = True
                continue
            # Not better: all goes back as it was.
            for n in range(coming):
                _set_member(problem, component, added[n], best, blocked, False)
            _set_member(problem, component, k, best, blocked, False)
            for n in range(leaving):
                _set_member(problem, component, removed[n], best, blocked, True)


@kernel
def _set_member(problem, component, k, best, blocked, chosen):
    """OUT best (m,), blocked (m,): member k is put into a set or out of it. O(rivals)."""
    best[k] = chosen
    _count_conflicts(problem, component, k, blocked, 1 if chosen else -1)


@kernel
def _remove_rivals(problem, component, k, best, blocked, removed):
    """Put all rivals of member k out of a set, into removed (m,). Returns how many, their worth, and the looks. O(rivals^2).

    Bounds: a rival is out of the set once it is removed, so each comes once: m.
    """
    leaving, lost, looks = 0, 0.0, 0
    for c in range(problem.rays.shape[1]):
        blob = problem.rays[component.members[k], c]
        if blob >= 0:
            # Looks are counted for all of its rivals, taken or not, since each is looked at.
            looks += problem.starts[blob + 1] - problem.starts[blob]
            for at in range(problem.starts[blob], problem.starts[blob + 1]):
                j = component.place[problem.holders[at]]
                if j >= 0 and best[j]:
                    _set_member(problem, component, j, best, blocked, False)
                    removed[leaving] = j
                    leaving += 1
                    lost += problem.scores[component.members[j]]
    return leaving, lost, looks


@kernel
def _add_freed(problem, component, removed, worth, best, blocked, added):
    """Put in all members that share a blob with a removed one and have no rival in the set any more, into added (m,).

    Returns how many, and `worth` with what they are worth added. O(removed * rivals^2).

    Bounds: a member is in the set once it is added, so each comes once: m.
    """
    coming = 0
    for r in removed:
        for c in range(problem.rays.shape[1]):
            blob = problem.rays[component.members[r], c]
            if blob >= 0:
                for at in range(problem.starts[blob], problem.starts[blob + 1]):
                    j = component.place[problem.holders[at]]
                    if j >= 0 and not best[j] and blocked[j] == 0:
                        _set_member(problem, component, j, best, blocked, True)
                        added[coming] = j
                        coming += 1
                        worth += problem.scores[component.members[j]]
    return coming, worth
