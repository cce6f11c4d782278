"""Limbs from trajectories: the kernel against its twin, known limbs, gaps, order, careless input."""

from __future__ import annotations

import numpy as np
import pytest
import twins_motion as twins
from scipy.optimize import linear_sum_assignment

from asterism import AsterismError
from asterism.motion.segmentation import segment_limbs
from asterism.motion.segmentation._kernels import stray_from_motions
from asterism.motion.segmentation.affinity import fill_trajectories, local_subspaces, subspace_affinity
from asterism.simulation.soft_tissue import SoftTissueTrial, TrialPlan, simulate_soft_tissue

pytestmark = pytest.mark.kernels


def share_right(limb_of: np.ndarray, truth: np.ndarray) -> float:
    """The share of points on the right limb, limbs named as fits best."""
    count = int(max(limb_of.max(), truth.max())) + 1
    pairs = np.zeros((count, count))
    np.add.at(pairs, (limb_of[limb_of >= 0], truth[limb_of >= 0]), 1)
    rows, columns = linear_sum_assignment(-pairs)
    return float(pairs[rows, columns].sum() / len(truth))


def trial(joint: str = "knee", points: int = 300, **options: object) -> SoftTissueTrial:
    return simulate_soft_tissue(TrialPlan(joint, points=points, **options), seed=7)


@pytest.mark.parametrize(
    ("joint", "limbs", "options"),
    [("shoulder", 2, {}), ("knee", 2, {"missing": 0.2}), ("hip", 2, {}), ("leg", 3, {"missing": 0.1}), ("rigid", 1, {})],
)
def test_dense_limbs_and_their_number_are_found(joint: str, limbs: int, options: dict[str, float]) -> None:
    given = trial(joint, **options)
    found = segment_limbs(given.recording.positions)
    assert found.limbs == limbs
    assert share_right(found.limb_of, given.limb_of) >= 0.99


@pytest.mark.parametrize("missing", [0.0, 0.15])
def test_sparse_limbs_are_found(missing: float) -> None:
    given = trial(points=8, sparse=True, missing=missing)
    found = segment_limbs(given.recording.positions)
    assert found.limbs == 2 and share_right(found.limb_of, given.limb_of) == 1.0


def test_affinity_alone_mixes_points_at_the_joint_and_rigidity_does_not() -> None:
    given = trial()
    shares = {m: share_right(segment_limbs(given.recording.positions, 2, method=m).limb_of, given.limb_of) for m in ("lsa", "lsa+rigidity")}
    assert shares["lsa"] < 0.97 < 0.99 <= shares["lsa+rigidity"], shares


def test_the_same_trajectories_give_the_same_limbs_in_any_order_of_the_points() -> None:
    given = trial(points=150)
    order = np.random.default_rng(0).permutation(150)
    first, again = (segment_limbs(given.recording.positions) for _ in range(2))
    shuffled = segment_limbs(given.recording.positions[:, order])
    assert (first.limb_of == again.limb_of).all() and (first.stray == again.stray).all()
    assert share_right(shuffled.limb_of, first.limb_of[order]) >= 0.99


def test_points_that_are_missing_for_half_the_recording_are_used_and_those_never_seen_are_not() -> None:
    given = trial(points=200)
    positions = given.recording.positions.copy()
    positions[:50, ::5] = np.nan
    positions[:, 7] = np.nan
    found = segment_limbs(positions, 2)
    assert found.limb_of[7] == -1 and (np.delete(found.limb_of, 7) >= 0).all()
    assert share_right(np.delete(found.limb_of, 7), np.delete(given.limb_of, 7)) >= 0.99
    assert found.points(-1).tolist() == [7]


def test_the_number_of_limbs_that_is_asked_for_is_given() -> None:
    positions = trial("leg", points=200).recording.positions
    for limbs in (1, 2, 3):
        assert segment_limbs(positions, limbs).limbs == limbs


def test_straying_is_that_of_the_twin() -> None:
    rng = np.random.default_rng(4)
    given = trial(points=6)
    positions = given.recording.positions.copy()
    positions[rng.random(positions.shape[:2]) < 0.3] = np.nan
    rotations, translations = given.rotations.copy(), given.translations.copy()
    rotations[1, 10:20] = np.nan
    out = np.empty((6, 2))
    stray_from_motions(positions, rotations, translations, out)
    for limb in (0, 1):
        known = np.isfinite(rotations[limb, :, 0, 0])
        squares = twins.point_spread(positions[known], rotations[limb][known], translations[limb][known])[1]
        np.testing.assert_allclose(out[:, limb], np.sqrt(squares), atol=1e-12)


def test_gaps_of_rigid_trajectories_are_filled_where_the_points_were() -> None:
    given = simulate_soft_tissue(TrialPlan("rigid", points=40, noise_m=0.0), seed=1)
    positions = given.recording.positions
    hidden = positions.copy()
    hidden[20:45, 3] = np.nan
    filled = fill_trajectories(hidden, 3, 60)
    whole = fill_trajectories(positions, 3, 60)
    miss = np.abs((filled - filled.mean(axis=0)) - (whole - whole.mean(axis=0))).max()
    assert miss < 0.003, f"{1000 * miss:.1f} mm"


def test_affinity_is_one_for_equal_subspaces_and_falls_with_their_angle() -> None:
    bases = np.zeros((3, 4, 2))
    bases[0, :2], bases[1, :2], bases[2, 2:] = np.eye(2), [[0, 1], [1, 0]], np.eye(2)
    np.testing.assert_allclose(subspace_affinity(bases, np.array([0]))[:, 0], [1.0, 1.0, np.exp(-2.0)])
    spanned = local_subspaces(np.random.default_rng(0).normal(size=(20, 5)), 6, 3)
    np.testing.assert_allclose(spanned.swapaxes(1, 2) @ spanned, np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)


def test_input_without_limbs_is_refused_in_a_sentence() -> None:
    good = trial(points=9).recording.positions
    cases = [
        (good[:, :2], {}, "three points and two frames"),
        (good[:1], {}, "three points and two frames"),
        (good[..., 0], {}, "expected"),
        (np.full_like(good, np.nan), {}, "only 0 points"),
        (np.where(good > 1, np.inf, good), {}, "infinite"),
        (good, {"limbs": 0}, "one or more"),
        (good, {"limbs": 4}, "cannot form 4 limbs"),
        (good, {"method": "guess"}, "no method"),
    ]
    for positions, options, sentence in cases:
        with pytest.raises(AsterismError, match=sentence):
            segment_limbs(positions, **options)
