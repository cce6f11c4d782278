"""The decisions of the whole-body kernels against their plain twins and against all labellings of small frames."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
import twins_body as twins
from hypothesis import given, settings
from hypothesis import strategies as st
from test_body import LATENTS, MARKERS, POSES, SETTINGS, random_frame, random_model, ready

from asterism.labelling.body._anchor_kernels import _keep_likely, search_anchor
from asterism.labelling.body._frame_kernels import label_clouds, nearest_changes, retry_doubtful
from asterism.labelling.body._refine_kernels import refine
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._search_kernels import (
    MAX_LABELLINGS,
    LikelyTriples,
    add_twins,
    find_labellings,
    make_candidates,
    make_search_workspace,
    propose,
)
from asterism.labelling.body._workspace_kernels import FrameLabelling, FrameModel, make_body_workspace
from asterism.labelling.body.anchors import AnchorRules, Anchors, with_intervals
from asterism.labelling.body.model import BodyModel
from asterism.labelling.features.feature_kernels import point_distances
from asterism.labelling.features.search_kernels import search

pytestmark = pytest.mark.kernels

races = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)


def anchors_for(model: BodyModel, rng: np.random.Generator, count: int = 6) -> Anchors:
    """Anchors whose intervals hold what two people of the model did in 40 frames each."""
    bodies = [rng.multivariate_normal(model.mean[k].reshape(-1), model.covariance(k), 40) for k in range(POSES)]
    frames = np.concatenate(bodies).reshape(-1, MARKERS, 3)
    triples = np.array(list(combinations(range(MARKERS), 3)))[rng.permutation(20)[:count]]
    return with_intervals(triples, frames, np.arange(len(frames)) % 2, AnchorRules())


TWINS = np.array([[1, 0, 3, 2, 5, 4], [1, 2, 0, 3, 4, 5], [1, 0, 3, 2, -1, -1], [0, 1, 2, 4, 5, 3]])
"""What labellings of six markers are held against in these tests: all pairs exchanged, thirds of turns, and a twin that leaves two open."""


def frame_model(model: BodyModel, anchors: Anchors, table: np.ndarray = TWINS) -> FrameModel:
    return FrameModel(anchors.solvers(), anchors.arrays(model), model.arrays(), SETTINGS, table)


def workspace_for(points: np.ndarray):
    body = make_body_workspace(len(points), MARKERS, LATENTS)
    return make_search_workspace(body, make_candidates(MAX_LABELLINGS, MARKERS), SETTINGS.proposals_per_anchor)


def empty_labelling() -> FrameLabelling:
    return FrameLabelling(np.full(MARKERS, -1), np.zeros(MARKERS), np.zeros(4, dtype=np.int64), np.zeros(MARKERS))


def label_alone(arrays: FrameModel, points: np.ndarray) -> FrameLabelling:
    """`label_frame` of one frame, called by `label_clouds`, which is compiled anyway. Compiled alone, it would take as long again."""
    labelling = empty_labelling()
    label_clouds(arrays, points, np.array([0, len(points)]), 0, 1, FrameLabelling(*(part[None] for part in labelling)))
    return labelling


def interpreted(step):
    """A step of `label_clouds` as Python, as `step.py_func` is: it compiles within `label_clouds`, which `test_a_whole_frame` checks."""

    def run(*arguments):
        with np.errstate(all="ignore"):
            return getattr(step, "py_func", step)(*arguments)

    return run


def spoilt(rows: np.ndarray, points: int, rng: np.random.Generator) -> np.ndarray:
    """A labelling with two markers exchanged, or one label lost, or one label put onto a free point, or none of these."""
    rows, labelled = rows.copy(), np.nonzero(rows >= 0)[0]
    free = np.setdiff1d(np.arange(points), rows)
    match rng.integers(4):
        case 0 if len(labelled) >= 2:
            one, other = rng.permutation(labelled)[:2]
            rows[[one, other]] = rows[[other, one]]
        case 1 if len(labelled):
            rows[rng.choice(labelled)] = -1
        case 2 if len(free):
            rows[rng.integers(MARKERS)] = rng.choice(free)
    return rows


@given(seed=seeds)
@races
def test_rescoring_finds_the_outliers(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, outlier = random_frame(model, rng)
    points[0] += rng.choice([0.0, 0.1, 0.3])
    workspace = ready(points, outlier)
    score = rescore(model.arrays(), 1, points, rows, SETTINGS, workspace)
    # the twin begins with the same outliers
    expected, scores, outliers = twins.rescore(model, 1, points, rows, outlier, SETTINGS)
    np.testing.assert_array_equal(workspace.outlier, outliers)
    np.testing.assert_allclose(workspace.scores, scores, rtol=1e-6, atol=1e-4)
    assert score == pytest.approx(expected, rel=1e-7, abs=1e-5)


@given(seed=seeds)
@races
def test_the_best_key_pose(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, outlier = random_frame(model, rng)
    k, score = best_pose(model.arrays(), points, rows, SETTINGS, ready(points, outlier))
    assert k == twins.best_pose(model, points, rows, outlier, SETTINGS)
    assert score == pytest.approx(twins.evidence(model, k, points, rows, outlier, SETTINGS), rel=1e-7, abs=1e-5)


@given(seed=seeds)
@settings(races, max_examples=60)
def test_refinement(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, _ = random_frame(model, rng, least=2)
    for _ in range(3):
        rows = spoilt(rows, len(points), rng)
    k = int(rng.integers(POSES))
    expected, refined = twins.refine(model, k, points, rows.tolist(), SETTINGS)
    score = refine(model.arrays(), k, points, rows, SETTINGS, ready(points, False))
    np.testing.assert_array_equal(rows, refined)
    assert score == pytest.approx(expected, rel=1e-7, abs=1e-5)


@given(seed=seeds, budget=st.sampled_from([0, 3, 20, 60, 10**6]))
@races
def test_an_anchor_keeps_the_likeliest_triples_of_its_partial_solver(seed, budget):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    anchors = anchors_for(model, rng)
    points, _, _ = random_frame(model, rng, least=3)
    workspace = workspace_for(points)
    arrays = frame_model(model, anchors)._replace(settings=SETTINGS._replace(max_evaluations=budget))
    point_distances(points, len(points), workspace.distance)
    for a, triple in enumerate(anchors.triples):
        counters, evaluations, room = np.zeros(2, dtype=np.int64), np.zeros(1, dtype=np.int64), np.empty((200, 3), dtype=np.int64)
        found = search(arrays.solvers, a, points, np.arange(len(points)), budget, room, counters)
        kept = search_anchor(arrays, a, points, workspace, evaluations)
        assert evaluations[0] == counters[0]
        assert (kept < 0) == (found < 0)
        triples = twins.anchor_triples(anchors, a, points)
        expected = twins.likely_triples(model, triple, points, triples if found >= 0 else [], SETTINGS)
        likely = workspace.likely
        got = [(likely.pose[s], tuple(likely.points[s].tolist())) for s in range(kept)]
        assert got == [(k, rows) for _, k, rows in expected]
        np.testing.assert_allclose(likely.density[: max(0, kept)], [density for density, _, _ in expected], rtol=1e-6, atol=1e-6)


def test_of_equally_likely_triples_the_first_stay():
    likely = LikelyTriples(np.full((2, 3), -1), np.full(2, -1), np.full(2, np.nan))
    kept = 0
    for number, density in enumerate([1.0, 1.0, 2.0, 1.0]):
        kept = interpreted(_keep_likely)(likely, kept, np.full(3, number), number, density)
    assert kept == 2
    assert likely.pose.tolist() == [2, 0]
    assert likely.points[:, 0].tolist() == [2, 0]


@given(seed=seeds)
@races
def test_proposals_of_an_anchor(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    anchors = anchors_for(model, rng)
    points, _, _ = random_frame(model, rng, least=4)
    workspace = workspace_for(points)
    point_distances(points, len(points), workspace.distance)
    arrays = frame_model(model, anchors)
    for a, triple in enumerate(anchors.triples):
        expected = twins.propose(model, triple, points, twins.anchor_triples(anchors, a, points), SETTINGS)
        kept = search_anchor(arrays, a, points, workspace, np.zeros(1, dtype=np.int64))
        chosen = interpreted(propose)(arrays, a, points, kept, workspace)
        likely, best = workspace.likely, workspace.best_triple[:chosen]
        assert [(likely.pose[s], tuple(likely.points[s].tolist())) for s in best] == [(k, rows) for _, k, rows in expected]
        np.testing.assert_allclose(workspace.best_score[:chosen], [score for score, _, _ in expected], rtol=1e-6, atol=1e-4)


@given(seed=seeds, least_found=st.sampled_from([SETTINGS.min_found_share, 0.8]))
@races
def test_the_labellings_that_anchors_lead_to(seed, least_found):
    rng = np.random.default_rng(seed)
    model, rules = random_model(rng), SETTINGS._replace(min_found_share=least_found)
    anchors = anchors_for(model, rng)
    points, _, _ = random_frame(model, rng, least=3)
    workspace = workspace_for(points)
    expected, best_expected = twins.find_labellings(model, anchors, points, rules)
    arrays, counters = frame_model(model, anchors)._replace(settings=rules), np.zeros(4, dtype=np.int64)
    count, best = find_labellings(arrays, points, workspace, counters)
    if best_expected is not None and expected[best_expected][0] > -np.inf:
        expected, best_expected = twins.add_twins(model, TWINS, expected, best_expected, points, rules)
        count, best = add_twins(arrays, points, workspace, count, best, counters)
    found = workspace.candidates
    got = {tuple(found.labellings[h].tolist()): (found.votes_needed[h], found.votes[h]) for h in range(count)}
    assert got == {rows: (needed, len(votes)) for rows, (_, needed, votes) in expected.items()}
    assert (tuple(found.labellings[best].tolist()) if best >= 0 else None) == best_expected
    np.testing.assert_allclose(found.scores[:count], [score for score, _, _ in expected.values()], rtol=1e-6, atol=1e-4)


def test_the_search_ends_with_its_budget():
    rng = np.random.default_rng(0)
    model = random_model(rng)
    arrays = frame_model(model, anchors_for(model, rng))
    points, _, _ = random_frame(model, rng, least=6)
    short = arrays._replace(settings=SETTINGS._replace(max_evaluations=10))
    counters = np.zeros(4, dtype=np.int64)
    assert find_labellings(short, points, workspace_for(points), counters) == (0, -1)
    assert counters[1] <= 2, "an anchor runs after the budget is spent"


@given(seed=seeds)
@settings(races, max_examples=60)
def test_the_nearest_changes(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, _ = random_frame(model, rng, least=3)
    labelling = empty_labelling()
    labelling.point_of[:] = spoilt(rows, len(points), rng)
    expected, better, margins = twins.nearest_changes(model, points, labelling.point_of.tolist(), SETTINGS)
    top = interpreted(nearest_changes)(model.arrays(), points, SETTINGS, ready(points, False), labelling)
    np.testing.assert_array_equal(labelling.point_of, better)
    np.testing.assert_allclose(labelling.margins, margins, rtol=1e-6, atol=1e-4)
    assert top == pytest.approx(expected, rel=1e-7, abs=1e-5)


@given(seed=seeds)
@races
def test_doubtful_labels_are_tried_again(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, _ = random_frame(model, rng, least=3)
    rows = spoilt(rows, len(points), rng)
    margins = rng.uniform(0.0, 2.0 * SETTINGS.exact_margin, MARKERS)
    none = np.zeros(MARKERS, dtype=bool)
    top = twins.evidence(model, twins.best_pose(model, points, rows, none, SETTINGS), points, rows, none, SETTINGS)
    labelling = FrameLabelling(rows.copy(), margins, np.zeros(4, dtype=np.int64), np.zeros(MARKERS))
    better = interpreted(retry_doubtful)(model.arrays(), points, top, SETTINGS, ready(points, False), labelling)
    expected = twins.retry_doubtful(model, points, top, rows.tolist(), margins, SETTINGS)
    assert better == (expected is not None)
    np.testing.assert_array_equal(labelling.point_of, expected if better else rows)


UNUSUAL = {
    "no point": np.empty((0, 3)),
    "two points": np.array([[0.0, 0, 1], [0.1, 0, 1]]),
    "one place": np.tile([[0.3, 0.1, 1.0]], (12, 1)),
    "on a vertical": np.arange(9)[:, None] * [0.0, 0.0, 0.1],
    "a crowd": np.random.default_rng(0).uniform(-0.6, 0.6, (120, 3)),
    "far away": 1e9 * np.random.default_rng(1).normal(size=(MARKERS, 3)),
    "beyond numbers": 1e200 * np.random.default_rng(2).normal(size=(MARKERS, 3)),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_an_unusual_frame_gives_each_point_to_one_marker_at_most(name):
    rng = np.random.default_rng(5)
    model = random_model(rng)
    labelling = label_alone(frame_model(model, anchors_for(model, rng)), UNUSUAL[name])
    given_points = labelling.point_of[labelling.point_of >= 0]
    assert (given_points < len(UNUSUAL[name])).all() and len(set(given_points.tolist())) == len(given_points)


@given(seed=seeds)
@settings(races, max_examples=8)
def test_a_whole_frame(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    anchors = anchors_for(model, rng)
    points, _, _ = random_frame(model, rng)
    labelling = label_alone(frame_model(model, anchors), points)
    rows, margins = twins.label_frame(model, anchors, points, SETTINGS, TWINS)
    np.testing.assert_array_equal(labelling.point_of, rows)
    np.testing.assert_allclose(labelling.margins, margins, rtol=1e-6, atol=1e-4)
    if max(rows) >= 0:
        fits = twins.fits(model, points, rows, twins.crowded(SETTINGS, len(points), MARKERS))
        np.testing.assert_allclose(labelling.fits, fits, rtol=1e-6, atol=1e-4)


def all_labellings(points: int):
    """Every labelling of at least three markers by different points: (M,), -1 for none."""
    for count in range(3, MARKERS + 1):
        for markers in combinations(range(MARKERS), count):
            for chosen in permutations(range(points), count):
                rows = np.full(MARKERS, -1)
                rows[list(markers)] = chosen
                yield rows


def test_hardly_any_labelling_of_a_small_frame_is_better():
    """Five points of six markers, in 20 frames: against all 3,720 labellings of at least three markers.

    The search is no exhaustive one. It may miss the best labelling of a frame only where that one, too, explains the frame poorly.
    """
    missed = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        model = random_model(rng)
        anchors = anchors_for(model, rng, 20)
        body = rng.multivariate_normal(model.mean[0].reshape(-1), model.covariance(0)).reshape(-1, 3)
        points = np.ascontiguousarray(body[rng.permutation(MARKERS)[:5]])
        arrays = frame_model(model, anchors)
        labelling = label_alone(arrays, points)
        workspace = ready(points, False)
        best = max(best_pose(arrays.body, points, rows, SETTINGS, workspace)[1] for rows in all_labellings(5))
        found = best_pose(arrays.body, points, labelling.point_of, SETTINGS, workspace)[1]
        if found < best - 1e-6:
            missed += 1
            assert best < 10.0, f"frame {seed}: a labelling of {best:.1f} nats was missed, the one found has {found:.1f}"
        assert not np.isnan(labelling.margins).any()
    assert missed <= 4, f"{missed} of 20 best labellings missed"


@pytest.mark.parametrize("points", [0, 1, 2])
def test_fewer_than_three_points_are_nobody(points: int):
    rng = np.random.default_rng(0)
    model = random_model(rng)
    labelling = label_alone(frame_model(model, anchors_for(model, rng)), model.mean[0, :points].copy())
    assert (labelling.point_of == -1).all() and (labelling.margins == -np.inf).all()


@pytest.mark.parametrize("case", ["coincident", "nan", "double", "far"])
def test_hostile_frames(case: str):
    """No point is given twice, no point that is NaN is given, of two coincident points either may be; and the kernel comes back."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        model = random_model(rng)
        points, _, _ = random_frame(model, rng, least=6)
        match case:
            case "coincident":
                points[:] = points[0]
            case "nan":
                points[1] = np.nan
            case "double":
                points = np.concatenate([points, points[:1]])
            case "far":
                points[0] += 1e6
        labelling = label_alone(frame_model(model, anchors_for(model, rng)), points)
        given_points = labelling.point_of[labelling.point_of >= 0]
        assert len(set(given_points.tolist())) == len(given_points)
        assert np.isfinite(points[given_points]).all()
        if case == "double" and {0, len(points) - 1} & set(given_points.tolist()):
            m = int(np.nonzero(np.isin(labelling.point_of, (0, len(points) - 1)))[0][0])
            assert labelling.margins[m] < 1.0, "one of two coincident points is preferred to the other"


def test_clouds_are_labelled_as_their_frames_are():
    rng = np.random.default_rng(0)
    model = random_model(rng)
    arrays = frame_model(model, anchors_for(model, rng))
    frames = [random_frame(model, rng)[0] for _ in range(6)] + [np.empty((0, 3))]
    offsets = np.concatenate([[0], np.cumsum([len(frame) for frame in frames])])
    together = FrameLabelling(np.full((7, MARKERS), -1), np.zeros((7, MARKERS)), np.zeros((7, 4), dtype=np.int64), np.zeros((7, MARKERS)))
    label_clouds(arrays, np.concatenate(frames), offsets, 0, 7, together)
    for t, points in enumerate(frames):
        for part, whole in zip(label_alone(arrays, points), together, strict=True):
            np.testing.assert_array_equal(part, whole[t])
