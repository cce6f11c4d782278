"""Features of motion: what tracks tell, that no rigid motion or reversal changes it, and that training, search and models take it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import twins
from hypothesis import given, settings
from hypothesis import strategies as st
from models import BRIEF

from asterism import AsterismError, Clouds, MarkerModel, Recording
from asterism.labelling.features.feature_kernels import feature_value
from asterism.labelling.features.motion_kernels import WIDTH
from asterism.labelling.features.motion_points import frames_with_motion, motion_of_points
from asterism.labelling.features.registry import FEATURES, TEMPORAL, feature_pool, kinds_of, needs_motion
from asterism.labelling.features.search_kernels import search
from asterism.labelling.marker_model import TrainingRules
from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.partial.search_strategies import search_partial_solvers
from asterism.labelling.partial.solver import FullSolver, FullSolverRules, stack_frames
from asterism.labelling.partial.solver_search import SearchSettings
from asterism.labelling.partial.weak import FeatureRanges, StrongClassifier
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.simulation import simulate_walks

pytestmark = pytest.mark.kernels

WALKS = simulate_walks(subjects=3, frames=120, seed=2)
QUICK = SearchSettings(screening_frames=60, evaluation_frames=200, validation_frames=300, beam_width=20, max_markers=5, max_solvers=25)
BOTH = ("g2", "g4", "g9", *TEMPORAL)


def wandering(frames=80, markers=3, rate=100.0, seed=0):
    """A recording of points on random parabolas with a little noise, one with a gap."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(frames)[:, None, None] / rate
    place, speed, pull = rng.normal(size=(3, markers, 3))
    positions = place + speed * seconds + 0.5 * pull * seconds**2 + rng.normal(scale=1e-3, size=(frames, markers, 3))
    positions[30:34, 0] = np.nan
    return Recording(positions, tuple("ABCDEFGH"[:markers]), rate), speed, pull


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0, 240.0])
def test_motion_equals_its_twin(rate):
    recording, _, _ = wandering(frames=120, rate=rate)
    frames = frames_with_motion(recording)
    for marker in range(3):
        np.testing.assert_allclose(frames[:, marker], twins.motion(recording.positions[:, marker], rate), rtol=1e-6, atol=1e-6)


def test_motion_is_that_of_the_body():
    """Of a point at 2 m/s that speeds up by 3 m/s2, in the middle: velocity, acceleration, and where it was and will be."""
    seconds = np.arange(61) / 100.0 - 0.3
    positions = np.zeros((61, 1, 3))
    positions[:, 0, 0] = 2.0 * seconds + 1.5 * seconds**2
    middle = frames_with_motion(Recording(positions, ("A",), 100.0))[30, 0]
    assert middle[9:12] == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)
    assert middle[12:15] == pytest.approx([3.0, 0.0, 0.0], abs=1e-7)
    assert middle[[3, 6]] == pytest.approx([-0.4 + 0.06, 0.4 + 0.06])


def test_motion_is_unknown_beside_a_gap_and_without_tracks():
    recording, _, _ = wandering()
    frames = frames_with_motion(recording)
    known = ~np.isnan(frames)
    assert known[30:34, 0].sum() == 0
    assert known[[29, 34], 0, :3].all()
    assert not known[[25, 29, 34, 38], 0, 9:].any(), "no parabola reaches over the gap"
    assert known[[24, 39], 0, 9:].all()
    assert not known[[0, 19, 60], 1, 3:9].all(axis=1)[[0, 1, 2]].any()
    assert known[20:60, 1].all()
    slow = motion_of_points(replace(recording.clouds(), rate=10.0))
    assert np.isnan(slow[:, 3:]).all(), "ten frames a second do not say how a point moves"
    assert np.isfinite(slow[:, :3]).all()


def rigid(positions, angle, shift):
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return positions @ turn.T + shift


@given(seed=st.integers(0, 50), angle=st.floats(-3, 3), backwards=st.booleans())
@settings(max_examples=25, deadline=None)
def test_neither_heading_nor_place_nor_direction_of_time_changes_a_feature(seed, angle, backwards):
    recording, _, _ = wandering(seed=seed)
    positions = rigid(recording.positions, angle, [3.0, -2.0, 0.7])
    other = frames_with_motion(replace(recording, positions=positions[::-1] if backwards else positions))
    other = other[::-1] if backwards else other
    frames = frames_with_motion(recording)
    kinds, slots = feature_pool(3, [feature.name for feature in FEATURES if feature.points < 4])
    for kind, slot in zip(kinds, slots, strict=True):
        for t in (22, 55):
            before, after = (feature_value(kind, np.ascontiguousarray(f[t]), *slot) for f in (frames, other))
            assert after == pytest.approx(before, rel=1e-6, abs=1e-6, nan_ok=True), FEATURES[kind].name


def test_a_vertical_of_its_own():
    recording, _, _ = wandering()
    tipped = replace(recording, positions=recording.positions[..., [1, 2, 0]], vertical=np.array([0.0, 1.0, 0.0]))
    frames, other = frames_with_motion(recording), frames_with_motion(tipped)
    for kind in kinds_of(TEMPORAL):
        values = [feature_value(kind, np.ascontiguousarray(f[55]), 0, 1, 2, 0) for f in (frames, other)]
        assert values[0] == pytest.approx(values[1])


def test_intervals_and_rejections_of_motion():
    """The rate at which a distance changes tells a rigid pair from a pair of two limbs where lengths alone do not."""
    rng = np.random.default_rng(0)
    seconds = np.arange(200) / 100.0
    swing = 0.3 + 0.1 * np.sin(2 * np.pi * seconds)
    positions = np.zeros((200, 3, 3)) + rng.normal(scale=2e-4, size=(200, 3, 3))
    positions[:, 1, 0] += 0.3
    positions[:, 2, 1] += swing
    frames, groups = stack_frames([Recording(positions, ("A", "B", "C"), 100.0, metadata={"subject": "S"})], motion=True)
    inner = slice(25, 175)
    plain, moving = (FeatureRanges.measure(frames, groups, names).classifiers("range") for names in (("g2",), ("g2", "g11", "g15")))
    swap = np.tile([0, 2, 1], (200, 1))
    caught = [(~StrongClassifier(weak, np.ones(len(weak)), 3).accepts(frames, swap))[inner].mean() for weak in (plain, moving)]
    assert caught[0] < 0.995
    assert caught[1] == 1.0
    right = np.tile([0, 1, 2], (200, 1))
    assert StrongClassifier(moving, np.ones(len(moving)), 3).accepts(frames, right).all()


def test_frames_without_motion_are_refused_where_it_is_needed():
    frames, groups = stack_frames(WALKS)
    with pytest.raises(AsterismError, match="motion"):
        FeatureRanges.measure(frames, groups, BOTH)
    wide, _ = stack_frames(WALKS, motion=True)
    assert wide.shape == (*frames.shape[:2], WIDTH)
    weak = FeatureRanges.measure(wide, groups, ("g10",)).classifiers("range")
    with pytest.raises(AsterismError, match="motion"):
        StrongClassifier(weak, np.ones(len(weak)), 15).accepts(frames, np.tile(np.arange(15), (len(frames), 1)))


@pytest.fixture(scope="module")
def mined():
    frames, groups = stack_frames(WALKS, motion=True)
    return search_partial_solvers(frames, groups, targets=0.98, features=BOTH, settings=replace(QUICK, widen=0.5), seed=0)


def test_miners_and_searches_take_features_of_motion(mined):
    used = {FEATURES[kind].name for kind in np.unique(mined.solvers.kinds)}
    assert set(TEMPORAL) - {"g18"} <= used
    assert mined.reads_motion
    clouds, truth = simulate_gaps_and_ghosts(WALKS[1], 2, 0, seed=1)
    indices = label_by_matrix(clouds, mined).indices
    right = ((indices == truth) & (indices >= 0)).sum()
    assert right / (indices >= 0).sum() > 0.99
    assert right / (truth >= 0).sum() > 0.6


def test_what_motion_rules_out_is_what_each_search_would_find(mined):
    """Rules shared by all solvers of a frame give the proposals that each solver's own search gives with its own classifiers."""
    clouds, _ = simulate_gaps_and_ghosts(WALKS[0].frames(slice(0, 60)), 2, 1, seed=3)
    points = motion_of_points(clouds)
    few = PartialSolvers(
        mined.solvers, mined.hit_rates, mined.trials, mined.targets, mined.covered, np.ones_like(mined.trusted), mined.strong
    )  # every solver may propose
    votes = label_by_matrix(clouds, few, budget=10**7, rules="agreed").indices
    for t in range(0, 60, 12):
        frame, proposals = points[clouds.offsets[t] : clouds.offsets[t + 1]], []
        for s in range(len(few)):
            begin, end = few.solvers.first_depth[s : s + 2]
            found = np.empty((5000, end - begin), dtype=np.int64)
            count = search(few.solvers, s, frame, np.arange(len(frame)), 10**7, found, np.zeros(2, dtype=np.int64))
            agreed = [set(found[: max(count, 0), depth].tolist()) for depth in range(end - begin)]
            markers = few.solvers.markers[begin:end].tolist()
            proposals.append({m: a for m, a in zip(markers, agreed, strict=True) if len(a) == 1 and count <= 32})
        assert votes[t].tolist() == twins.matrix(proposals, 15)


def test_clouds_without_tracks_or_with_one_frame_still_get_labels(mined):
    clouds, truth = simulate_gaps_and_ghosts(WALKS[1].frames(slice(50, 51)), 0, 0, seed=1)
    for tracks in (clouds.tracks, None, np.full(len(clouds.xyz), -1)):
        indices = label_by_matrix(replace(clouds, tracks=tracks), mined).indices
        assert ((indices == truth) | (indices < 0)).all()
        assert (indices >= 0).any()
    empty = Clouds.from_points([np.empty((0, 3))] * 3, 100.0)
    assert (label_by_matrix(empty, mined).indices == -1).all()


def test_the_order_of_the_points_does_not_matter(mined):
    clouds, truth = simulate_gaps_and_ghosts(WALKS[2], 1, 0, seed=5)
    other, again = simulate_gaps_and_ghosts(WALKS[2], 1, 0, seed=5)
    rng = np.random.default_rng(0)
    order = np.concatenate([clouds.offsets[t] + rng.permutation(clouds.counts[t]) for t in range(len(clouds))])
    mixed = replace(other, xyz=other.xyz[order], tracks=other.tracks[order])
    place = np.argsort(order) - np.repeat(clouds.offsets[:-1], clouds.counts)
    one, two = label_by_matrix(clouds, mined).indices, label_by_matrix(mixed, mined).indices
    frames, markers = np.nonzero(one >= 0)
    assert np.array_equal(two >= 0, one >= 0)
    assert np.array_equal(two[frames, markers], place[clouds.offsets[frames] + one[frames, markers]])
    assert np.array_equal(truth, again)


def test_full_solver_with_motion_labels_and_rejects():
    clouds, truth = simulate_gaps_and_ghosts(WALKS[0], 0, 0, seed=2)
    solver = FullSolver.fit(WALKS, rules=FullSolverRules(features=("g2", "g4", "g18"), weak_classifiers=30), seed=0)
    labelling = solver.label(clouds)
    given_labels = labelling.indices >= 0
    assert (labelling.indices == truth)[given_labels].all()
    assert given_labels.mean() > 0.9
    assert needs_motion(solver.strong.weak.kinds)
    assert solver.accuracy(WALKS, wrong=20_000) > 0.99


def test_a_model_with_features_of_motion_is_saved_and_read_again(tmp_path):
    features = ("g2", "g4", "g9", "g11", "g16")
    walks = [walk.select(walk.labels[:5]) for walk in WALKS]
    ensemble = MarkerModel.fit(walks, seed=0, training=replace(BRIEF, trial_frames=20, features=features))
    assert ensemble.about["features"] == list(features)
    ensemble.save(tmp_path / "moving.model")
    again = MarkerModel.load(tmp_path / "moving.model")
    clouds, truth = simulate_gaps_and_ghosts(walks[0], 1, 0, seed=1)
    for rules in ("thesis", "partial-solvers"):
        one, two = ensemble.label_frames(clouds, method=rules), again.label_frames(clouds, method=rules)
        assert np.array_equal(one.indices, two.indices)
        assert ((one.indices == truth) | (one.indices < 0)).mean() > 0.98
    with pytest.raises(AsterismError, match="g99"):
        MarkerModel.fit(walks, training=TrainingRules(virtual_people=0, features=("g99",)))
