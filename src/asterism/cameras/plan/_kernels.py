"""What each of many cameras would add to a rig. Twin: tests/test_plan.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import cofactors

COVERED = (0.0, 0.1, 0.4, 1.0)
"""What a place is worth that none, one, two, or three cameras and more see."""
_NOTHING = np.zeros(6)
WORST_DECADE, DECADES = -2.0, 2.0
"""Log10 of the error in metres that is worth nothing, and how many decades less are worth all."""


@kernel(inline=True)
def _quality(a, b, c, d, e, f):
    """What precision is worth, 0 to 1, of a point with information ((a, b, c), (b, d, e), (c, e, f)) 1/m2."""
    determinant, aa, _, _, dd, _, ff = cofactors(a, b, c, b, d, e, c, e, f)
    trace = a + d + f
    # Cameras in line with the place leave one direction open: no precision at all.
    if not determinant > 1e-12 * trace * trace * trace:
        return 0.0
    worth = (WORST_DECADE - 0.5 * math.log10((aa + dd + ff) / determinant)) / DECADES
    return min(max(worth, 0.0), 1.0)


@kernel(inline=True)
def _side(count, information, more):
    """The worth, 0 to 2, of a place that so many cameras see from one side with information + more (6,) 1/m2."""
    # One camera sees a place, and two make it a point.
    if count < 2:
        return 0.5 * count
    return 1.0 + _quality(
        information[0] + more[0],
        information[1] + more[1],
        information[2] + more[2],
        information[3] + more[3],
        information[4] + more[4],
        information[5] + more[5],
    )


@kernel
def worth_with(count, facing_count, facing_information, sees, information, faces, mount, out):
    """The worth of a rig to which each candidate is added, see `Plan`.

    IN  the rig so far: count (P,) cameras that see each place; facing_count (P, D) those on the side of each facing; facing_information
        (P, D, 6) their information on the place, 1/m2, as xx, xy, xz, yy, yz, zz. Candidates: sees (K, P) bool; information (K, P, 6) 1/m2;
        faces (M, P, D) bool, whether a mount is on the side of a facing; mount (K,) of each candidate
    OUT out (K,) 0 to 1
    O(P D) and, for every candidate, O(what it sees and faces).
    """
    places, facings = facing_count.shape
    so_far, covered_so_far, worth_so_far = np.zeros((places, facings)), 0.0, 0.0
    for p in range(places):
        covered_so_far += COVERED[min(count[p], 3)]
        for d in range(facings):
            # The rig without a candidate is worked out once, so that a candidate costs only what it changes.
            so_far[p, d] = _side(facing_count[p, d], facing_information[p, d], _NOTHING)
            worth_so_far += so_far[p, d]
    for k in range(len(out)):
        covered, sided = covered_so_far, worth_so_far
        for p in range(places):
            # What it does not see it does not change.
            if sees[k, p]:
                covered += COVERED[min(count[p] + 1, 3)] - COVERED[min(count[p], 3)]
                for d in range(facings):
                    if faces[mount[k], p, d]:
                        sided += _side(facing_count[p, d] + 1, facing_information[p, d], information[k, p]) - so_far[p, d]
        out[k] = 0.5 * covered / places + 0.25 * sided / (places * facings)
