"""Kernels that build a solver: which weak classifiers it takes, and the order in which its search assigns markers and evaluates them."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.labelling.partial._bit_kernels import popcount


@kernel
def choose_covering(table, wrong, weight, most, chosen, gains):
    """Greedy choice of weak classifiers that together reject as many wrong labellings as they can (section 4.4.1).

    Weights are whole numbers, so that equal inputs give equal choices. When nothing is left to gain, a second round goes over all samples
    with the classifiers that remain: then each sample is rejected twice, and so on.

    IN  table (F, W) uint64 which samples each classifier rejects; wrong (W,) which samples count; weight (W,) int of a word's samples
        most, how many to choose
    OUT chosen (>= most,) rows of table in order; gains (>= most,) weight of the samples that each adds in its round
    Returns how many were chosen, and how many of these the first round took. O(most F W). Twin: `choose_covering` in tests/twins_partial.py

    Bounds: it ends at `most`; a classifier is taken once, so fewer where there are fewer.
    """
    features, words = table.shape
    left = wrong.copy()
    taken = np.zeros(features, dtype=np.bool_)
    count, first_round, fresh = 0, -1, True
    while count < most:
        best, best_gain = -1, 0
        for f in range(features):
            # Each classifier once.
            if taken[f]:
                continue
            gain = 0
            for w in range(words):
                # Only what is not rejected yet counts.
                gain += weight[w] * popcount(table[f, w] & left[w])
            # Strictly more: of equals the first stays, whatever the order of summation.
            if gain > best_gain:
                best, best_gain = f, gain
        if best < 0:
            if first_round < 0:
                first_round = count
            # A round that adds nothing ends the choice, or the rounds would go on for ever.
            if fresh:
                break
            # A second round, so that each sample is rejected twice: one classifier may fail on a new person.
            left[:] = wrong
            fresh = True
            continue
        fresh = False
        taken[best] = True
        chosen[count], gains[count] = best, best_gain
        count += 1
        # What this classifier rejects needs no other one in this round.
        for w in range(words):
            left[w] &= ~table[best, w]
    return count, first_round if first_round >= 0 else count


@kernel
def order_tests(table, reads, markers, start, order, rank, first_feature):
    """In which order to assign markers and to evaluate weak classifiers, so that wrong branches die early.

    From the first marker on, the next is always the one for which the classifiers that it makes computable reject the largest share of
    wrong points; at each depth the classifier that rejects most comes first, then the one that adds most, and so on.

    IN  table (F, M, R) uint64 bits: does classifier f reject when marker m alone is given a wrong point; reads (F, M) bool
        markers (D,) of the solver, start its first one
    OUT order (D,) markers by depth; rank (F,) classifiers by depth; first_feature (D + 1,)
    O(D^2 F R). Twin: `order_tests` in tests/twins_partial.py
    """
    features, all_markers, words = table.shape
    placed = np.zeros(features, dtype=np.bool_)
    open_marker = np.zeros(all_markers, dtype=np.bool_)
    for m in markers:
        open_marker[m] = True
    missing = np.zeros(features, dtype=np.int64)
    for f in range(features):
        # From all markers that a classifier reads, so that it is computable when the last of them is placed.
        for m in range(all_markers):
            missing[f] += reads[f, m]
    left = np.empty(words, dtype=np.uint64)
    count = 0
    for depth in range(len(markers)):
        # The first marker is given; each later one is the one that is checked best.
        best, best_share = start, -1
        if depth > 0:
            for m in range(all_markers):
                if open_marker[m]:
                    share = _share_rejected(table, reads, placed, missing, m)
                    # Where most wrong points are rejected at once, the fewest branches live on.
                    if share > best_share:
                        best, best_share = m, share
        order[depth] = best
        open_marker[best] = False
        first_feature[depth] = count
        # A classifier becomes computable with the last of its markers.
        for f in range(features):
            missing[f] -= reads[f, best]
        count = _rank_tests(table, reads, placed, missing, best, left, rank, count)
    first_feature[len(markers)] = count


@kernel
def _share_rejected(table, reads, placed, missing, m):
    """Wrong points of marker m that the classifiers reject which m alone is missing from: a count of bits. O(F R)."""
    share = 0
    for w in range(table.shape[2]):
        any_bits = np.uint64(0)
        for f in range(len(table)):
            if not placed[f] and missing[f] == 1 and reads[f, m]:
                any_bits |= table[f, m, w]
        share += popcount(any_bits)
    return share


# Only classifiers that this marker completes say anything about it now.
@kernel
def _rank_tests(table, reads, placed, missing, marker, left, rank, count):
    """Append the classifiers that a marker makes computable to `rank`, those that reject most of what is left first.

    IN  left (R,) uint64 is memory. OUT placed (F,) bool; rank from `count` on. Returns the new count. O(F^2 R).

    Bounds: a classifier is placed once, so `rank` needs F.
    """
    # All wrong points are still there at this depth.
    left[:] = ~np.uint64(0)
    while True:
        chosen, most = -1, -1
        for f in range(len(table)):
            if placed[f] or missing[f] > 0 or not reads[f, marker]:
                continue
            gain = 0
            for w in range(len(left)):
                gain += popcount(table[f, marker, w] & left[w])
            # First what rejects most of what the classifiers before let through.
            if gain > most:
                chosen, most = f, gain
        if chosen < 0:
            return count
        placed[chosen] = True
        rank[count] = chosen
        count += 1
        # The next one is chosen for what the ones before it let through.
        for w in range(len(left)):
            left[w] &= ~table[chosen, marker, w]
