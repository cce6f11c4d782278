"""The synthetic trial of GaMoCap 4.1."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from asterism.motion.analysis import joint_angles
from asterism.motion.rigid import METHODS, estimate_limb_motion
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

LIMB = (3, 6)
"""Points across and along a limb of 0.1 x 0.4 m, as in the paper's figure 11."""


def toy(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Section 4.1: limb B turns from 0 to -90 degrees, two of its points at the joint are labelled A."""
    across, along = np.meshgrid(np.linspace(-0.05, 0.05, LIMB[0]), np.linspace(0.03, 0.4, LIMB[1]))
    flat = np.stack([across.ravel(), np.zeros(across.size), along.ravel()], axis=1)
    flat[:, 1] = 0.02 * np.cos(np.arange(len(flat)))
    angles = np.radians(np.linspace(0, 90, 91))
    fixed = np.tile(flat, (91, 1, 1))
    moving = np.einsum("tij,nj->tni", Rotation.from_rotvec(-angles[:, None] * [0, 1, 0]).as_matrix(), flat * [1, 1, -1])
    nearest = np.argsort(np.abs(moving[0, :, 2]), kind="stable")[:2]
    for method in METHODS:
        wrong = estimate_limb_motion(np.concatenate([fixed, moving[:, nearest]], axis=1), method)
        rest = estimate_limb_motion(np.delete(moving, nearest, axis=1), method)
        error = np.degrees(joint_angles(wrong, rest).angle - angles)
        asked = "< 0.5" if method == "robust" else "none"
        yield Figure(f"synthetic trial of 4.1, {method}: largest error of the angle", asked, float(np.abs(error).max()), "degrees", 91)
        if method == "svd":
            share = float(1 - (np.degrees(angles[-1]) + error[-1]) / 90)
            yield Figure("synthetic trial of 4.1, svd: underestimates by (10 % printed)", "none", share, "fraction", 91)
