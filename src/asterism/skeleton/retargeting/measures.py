"""A skeleton that walks, and when its feet stand, in; how far they slide and go below the floor, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Floats, SkeletonMotion
from asterism.skeleton.retargeting.contacts import FootContacts, Sole, sole_points, stretches


@dataclass(frozen=True)
class FeetErrors:
    """What is wrong with the feet of a skeleton.

    slips        (K,) m, of each contact of a heel or ball: its largest distance, over the floor, from its median place in that contact
    penetration  (T,) m, how far the lowest point of the soles is below what it should stand on; 0 where it is not
    """

    slips: Floats
    penetration: Floats

    @property
    def slip(self) -> float:
        """m, the largest slip; 0 where nothing stands."""
        return float(self.slips.max(initial=0.0))

    @property
    def deepest(self) -> float:
        """m, the largest penetration."""
        return float(self.penetration.max(initial=0.0))

    def to_dict(self) -> dict[str, float | int]:
        """Plain values: mm."""
        return {
            "contacts": len(self.slips),
            "slip_mm": round(1e3 * self.slip, 3),
            "median_slip_mm": round(1e3 * float(np.median(self.slips)) if len(self.slips) else 0.0, 3),
            "penetration_mm": round(1e3 * self.deepest, 3),
        }


def feet_errors(motion: SkeletonMotion, soles: dict[str, Sole], contacts: FootContacts) -> FeetErrors:
    """The errors of the feet of a motion in a room with z up, whose contacts are these, and its floor at z = 0."""
    slips, below = list[float](), np.zeros(len(motion))
    travelled = np.arange(len(motion))[:, None] / motion.rate * contacts.belt
    for side, sole in soles.items():
        points, standing = sole_points(motion, sole), contacts.standing[side]
        ground = np.where(standing, np.nan_to_num(contacts.level[side]), 0.0)
        depth = np.column_stack([ground, ground[:, 1]]) - points[:, :, 2]
        below = np.maximum(below, depth.max(axis=1))
        for p in range(2):
            for a, b in stretches(standing[:, p]):
                path = (points[a:b, p] - travelled[a:b])[:, :2]
                slips.append(float(np.linalg.norm(path - np.median(path, axis=0), axis=1).max()))
    return FeetErrors(np.array(slips), np.maximum(below, 0.0))
