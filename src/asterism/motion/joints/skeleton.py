"""The motions and points of all limbs in; which limbs are joined, as a tree, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.motion.joints.joint import Joint, JointRules, Motion, fit_joint
from asterism.recording import Floats

_NEAREST = 0.1
"""Share of a limb's points that count as near to another limb; at least three."""


@dataclass(frozen=True)
class Skeleton:
    """Limbs joined to a tree.

    parents  (L,) the limb to which each is joined, -1 for the root, which is the limb with the most points
    joints   (L,) the joint to the parent, None for the root
    """

    parents: tuple[int, ...]
    joints: tuple[Joint | None, ...]

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(parent, child) of each joint, from the root outwards."""
        found: list[tuple[int, int]] = []
        known = [limb for limb, parent in enumerate(self.parents) if parent < 0]
        while known:
            limb = known.pop(0)
            children = [child for child, parent in enumerate(self.parents) if parent == limb]
            found += [(limb, child) for child in children]
            known += children
        return tuple(found)


def find_skeleton(
    motions: Sequence[Motion], points: Sequence[Floats], *, method: str = "score", rules: JointRules | None = None
) -> Skeleton:
    """Join limbs where they turn about a common point that lies between them.

    motions of the limbs, and points (T, N, 3) m of each. Of all trees the one is taken whose joints together lie nearest to both limbs'
    points and drift least: cost of a joint is its residual and its distance from the place between the limbs (Prim's algorithm).
    Raises AsterismError where there is no limb, or the lists differ in length. O(L^2 (T + N^2 / 100)).
    """
    if not motions or len(motions) != len(points):
        raise AsterismError(
            f"{len(motions)} motions and {len(points)} sets of points; give one set of points for each of one or more limbs."
        )
    rules = rules or JointRules()
    joints: dict[tuple[int, int], tuple[float, Joint]] = {}
    for one in range(len(motions)):
        for other in range(one + 1, len(motions)):
            near, gap = between(points[one], points[other])
            for parent, child in ((one, other), (other, one)):
                joint = fit_joint(motions[parent], motions[child], near=near, points=points[child], method=method, rules=rules)
                centres = joint.centres(motions[parent], motions[child])
                aside = float(np.nanmean(np.linalg.norm(centres - near, axis=1)))
                joints[parent, child] = (joint.residual + aside + gap, joint)
    parents, found = [-1] * len(motions), [None] * len(motions)
    root = int(np.argmax([one.shape[1] for one in points]))
    reached = [root]
    while len(reached) < len(motions):
        waiting = [limb for limb in range(len(motions)) if limb not in reached]
        _, parent, child = min((joints[parent, child][0], parent, child) for parent in reached for child in waiting)
        parents[child] = parent
        found[child] = joints[parent, child][1]  # type: ignore[call-overload]
        reached.append(child)
    return Skeleton(tuple(parents), tuple(found))


def between(one: Floats, other: Floats) -> tuple[Floats, float]:
    """(T, 3) m: the middle between the points of two limbs (T, N, 3) m that are nearest to the other limb, and how far apart those are (m).

    Which points are near is decided once, in the frame with the most points. NaN in frames without these points.
    """
    seen = np.isfinite(one[:, :, 0]).sum(axis=1) + np.isfinite(other[:, :, 0]).sum(axis=1)
    frame = int(np.argmax(seen))
    from scipy.spatial import cKDTree

    sides, apart = [], 0.0
    for mine, theirs in ((one, other), (other, one)):
        here = np.nonzero(np.isfinite(mine[frame, :, 0]))[0]
        there = theirs[frame][np.isfinite(theirs[frame, :, 0])]
        if not len(here) or not len(there):
            raise AsterismError("two limbs are never seen in one frame, so nothing says how they are joined.")
        distance = cKDTree(there).query(mine[frame, here])[0]
        few = max(3, round(_NEAREST * len(here)))
        chosen = here[np.argsort(distance, kind="stable")[:few]]
        apart = float(distance.min())
        points = mine[:, chosen]
        present = np.isfinite(points[:, :, :1])
        count = present.sum(axis=1)
        sides.append(np.where(count > 0, np.where(present, points, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan))
    return np.asarray((sides[0] + sides[1]) / 2), apart
