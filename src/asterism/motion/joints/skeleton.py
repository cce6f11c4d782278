"""The motions and points of all limbs in; which limbs are joined, as a tree, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from asterism.errors import AsterismError
from asterism.motion.joints.joint import LEAST_FRAMES, Joint, JointRules, Motion, fit_joint
from asterism.recording import Floats

_NEAREST = 0.1
"""Share of a limb's points that count as near to another limb; at least three."""


@dataclass(frozen=True)
class Skeleton:
    """Limbs joined to a tree.

    parents  (L,) the limb to which each is joined, -1 for a root: the limb with the most points, and each that shares too few frames with
             the others to be joined to one
    joints   (L,) the joint to the parent, None for a root
    """

    parents: tuple[int, ...]
    joints: tuple[Joint | None, ...]

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(parent, child) of each joint, from the root outwards."""
        pairs: list[tuple[int, int]] = []
        known = [limb for limb, parent in enumerate(self.parents) if parent < 0]
        while known:
            limb = known.pop(0)
            children = [child for child, parent in enumerate(self.parents) if parent == limb]
            pairs += [(limb, child) for child in children]
            known += children
        return tuple(pairs)


def find_skeleton(
    motions: Sequence[Motion], points: Sequence[Floats], *, method: str = "score", rules: JointRules | None = None
) -> Skeleton:
    """Join limbs where they turn about a common point that lies between them.

    motions of the limbs, and points (T, N, 3) m of each. Of all trees the one is taken whose joints together lie nearest to both limbs'
    points and drift least: cost of a joint is its residual and its distance from the place between the limbs (Prim's algorithm). Limbs that
    are known together in fewer than three frames are not joined: the skeleton is then of several trees.
    Raises AsterismError where there is no limb, or the lists differ in length. O(L^2 (T + N^2 / 100)).
    """
    if not motions or len(motions) != len(points):
        raise AsterismError(
            f"{len(motions)} motions and {len(points)} sets of points; give one set of points for each of one or more limbs."
        )
    rules = rules or JointRules()
    joints: dict[tuple[int, int], tuple[float, Joint]] = {}
    known = [np.isfinite(motion.translations).all(axis=1) for motion in motions]
    for one, other in combinations(range(len(motions)), 2):
        if (known[one] & known[other]).sum() < LEAST_FRAMES:
            continue
        near, gap = between(points[one], points[other])
        # Both ways: the covariance is in the parent's axes, and which limb is the parent is not known yet.
        for parent, child in ((one, other), (other, one)):
            joint = fit_joint(motions[parent], motions[child], near=near, points=points[child], method=method, rules=rules)
            aside = np.linalg.norm(joint.centres(motions[parent], motions[child]) - near, axis=1)
            aside = aside[np.isfinite(aside)]
            # Where nothing says what lies between two limbs, any other joint of theirs is better.
            joints[parent, child] = (joint.residual + gap + (float(aside.mean()) if len(aside) else np.inf), joint)
    parents, joined = [-1] * len(motions), [None] * len(motions)
    sizes = [one.shape[1] for one in points]
    waiting = set(range(len(motions)))
    while waiting:
        reached = {limb for limb in range(len(motions)) if limb not in waiting}
        # Prim: of all joints from the tree to a limb outside, the best.
        costs = [(joints[pair][0], *pair) for pair in joints if pair[0] in reached and pair[1] in waiting]
        if costs:
            _, parent, limb = min(costs)
            parents[limb], joined[limb] = parent, joints[parent, limb][1]  # type: ignore[call-overload]
        else:
            limb = max(waiting, key=lambda one: (sizes[one], -one))
        waiting.remove(limb)
    return Skeleton(tuple(parents), tuple(joined))


def between(one: Floats, other: Floats) -> tuple[Floats, float]:
    """(T, 3) m: the middle between the points of two limbs (T, N, 3) m that are nearest to the other limb, and how far apart those are (m).

    Which points are near is decided once, in the frame with the most points of those that show both limbs. NaN in frames without these
    points. Raises AsterismError where no frame shows both.
    """
    seen = np.array([np.isfinite(limb[:, :, 0]).sum(axis=1) for limb in (one, other)])
    frame = int(np.argmax(np.where(seen.all(axis=0), seen.sum(axis=0), 0)))
    if not seen[:, frame].all():
        raise AsterismError("two limbs are never seen in one frame, so nothing says how they are joined.")
    sides, apart = [], 0.0
    # Of each limb the points that are nearest to the other: the joint lies between them.
    for mine, theirs in ((one, other), (other, one)):
        here = np.nonzero(np.isfinite(mine[frame, :, 0]))[0]
        there = theirs[frame][np.isfinite(theirs[frame, :, 0])]
        distance = cKDTree(there).query(mine[frame, here])[0]
        few = max(3, round(_NEAREST * len(here)))
        chosen = here[np.argsort(distance, kind="stable")[:few]]
        apart = float(distance.min())
        points = mine[:, chosen]
        present = np.isfinite(points[:, :, :1])
        count = present.sum(axis=1)
        sides.append(np.where(count > 0, np.where(present, points, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan))
    return np.asarray((sides[0] + sides[1]) / 2), apart
