"""What GaMoCap prints: the synthetic trial of 4.1, the order of equation 5, the rotation of 3.1, the average of table 1."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from asterism.motion.analysis import joint_angles
from asterism.motion.rigid import METHODS, estimate_limb_motion, relative_rotations, rotation_vectors
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

TABLE_1 = {"LSA": (4.6, 3.0, 16.0, 7.9, 21.6, 5.3, 2.8, 4.2, 5.6, 3.6), "LSA+PCT": (1.1, 2.7, 0.8, 1.4, 0.3, 2.9, 0.3, 3.1, 0.1, 1.1)}
LIMB = (3, 6)
"""Points across and along a limb of 0.1 x 0.4 m, as in the paper's figure 11."""


def paper(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Table 1's averages from its rows, and what the printed formulas give."""
    yield Figure("table 1, LSA: average of its ten rows (7.46 printed)", "none", float(np.mean(TABLE_1["LSA"])), "degrees", 10)
    yield Figure("table 1, LSA+PCT: average of its ten rows (1.16 printed)", "none", float(np.mean(TABLE_1["LSA+PCT"])), "degrees", 10)
    rng = np.random.default_rng(0)
    points, turns = rng.normal(0, 0.1, (10, 3)), Rotation.from_rotvec(rng.normal(0, 1, (100, 3))).as_matrix()
    printed, transposed = 0, 0
    for turn in turns:
        u, _, vt = np.linalg.svd((points - points.mean(axis=0)).T @ ((points - points.mean(axis=0)) @ turn.T))
        printed += bool(np.allclose(u @ vt, turn))
        transposed += bool(np.allclose((u @ vt).T, turn))
    yield Figure("3.1 as printed, R = U V': rotations right", "none", printed / 100, "fraction", 100)
    yield Figure("3.1 transposed, R = V U': rotations right", "none", transposed / 100, "fraction", 100)
    body = Rotation.from_rotvec(np.linspace(0, 2, 50)[:, None] * [0, 0, 1]).as_matrix()
    child = body @ Rotation.from_rotvec(np.linspace(0, 1, 50)[:, None] * [1, 0, 0]).as_matrix()
    for name, turned in (
        ("R_A R_B' as printed", np.einsum("tij,tkj->tik", child, body)),
        ("R_B' R_A", relative_rotations(body, child)),
    ):
        wander = np.degrees(
            np.arccos(np.clip(rotation_vectors(turned)[-1] @ [1, 0, 0] / np.linalg.norm(rotation_vectors(turned)[-1]), -1, 1))
        )
        yield Figure(
            f"equation 5, {name}: a hinge's axis wanders while the body turns by 115 degrees", "none", float(wander), "degrees", 50
        )


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
