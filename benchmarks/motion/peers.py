"""Others in the same run: SciPy's alignment, and spectral clustering on distances between points as scikit-learn has it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError
from asterism.motion.rigid._kernels import fit_frames
from asterism.motion.segmentation import segment_limbs
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.motion.trials import plans, share_right, trial_of

POINTS = 300
"""On dense limbs: scikit-learn's affinities are those of all pairs."""


def peers(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Raises AsterismError where scikit-learn is not installed, after what needs it not."""
    yield Figure("weighted fit, largest difference from SciPy's align_vectors", "< 1e-8", _difference(), "fraction", 200)
    try:
        from sklearn.cluster import SpectralClustering
    except ImportError:
        raise AsterismError("scikit-learn is not installed; the row `peers` compares with it (pip install scikit-learn).") from None
    for name, few in (("sparse", True), ("dense", False)):
        ours, theirs = [], []
        for plan in plans(few, benchmark.quick, POINTS):
            trial = trial_of(plan)
            positions = trial.recording.positions
            each = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=3)
            affinity = np.exp(-((each.std(axis=0) / max(float(np.median(each.std(axis=0))), 1e-9)) ** 2))
            distances = np.exp(-((each.mean(axis=0) / float(np.median(each.mean(axis=0)))) ** 2))
            shares = []
            for matrix in (distances, affinity):
                label = SpectralClustering(2, affinity="precomputed", random_state=0).fit_predict(matrix)
                shares.append(share_right(label, trial.limb_of))
            theirs.append(shares)
            ours.append(share_right(segment_limbs(positions, 2).limb_of, trial.limb_of))
        n = len(ours)
        row = f"{name}, two limbs given: points on the right limb"
        yield Figure(f"{row}, ours", "none", float(np.mean(ours)), "fraction", n)
        yield Figure(f"{row}, scikit-learn on mean distances", "none", float(np.mean([one for one, _ in theirs])), "fraction", n)
        yield Figure(f"{row}, scikit-learn on how distances change", "none", float(np.mean([other for _, other in theirs])), "fraction", n)


def _difference() -> float:
    """The largest difference of an entry of 200 rotations from `Rotation.align_vectors` with the same weights."""
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(200):
        template, turn = rng.normal(0, 0.1, (8, 3)), Rotation.random(random_state=rng).as_matrix()
        points, weights = template @ turn.T + rng.normal(0, 0.02, (8, 3)), rng.random(8) + 0.01
        rotations, translations = np.empty((1, 3, 3)), np.empty((1, 3))
        fit_frames(template, points[None].copy(), weights[None], 1e-9, rotations, translations)
        here, there = weights @ template / weights.sum(), weights @ points / weights.sum()
        scipys = Rotation.align_vectors(points - there, template - here, weights=weights)[0].as_matrix()
        worst = max(worst, float(np.abs(rotations[0] - scipys).max()))
    return worst
