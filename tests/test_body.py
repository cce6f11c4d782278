"""The whole-body kernels against their plain twins on random models; what the body model and the anchors learn, against known truth."""

from __future__ import annotations

import numpy as np
import pytest
import twins_body as twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.geometry import align_about_z
from asterism.geometry import shared_kernels as geometry_kernels
from asterism.labelling.body._anchor_kernels import anchor_key_pose, score_from_anchor
from asterism.labelling.body._assignment_kernels import assign_greedily, assign_unambiguous
from asterism.labelling.body._score_kernels import _cholesky, evidence, leave_one_out_scores, predict_markers
from asterism.labelling.body._search_kernels import MAX_LABELLINGS
from asterism.labelling.body._workspace_kernels import FrameModel, make_body_workspace
from asterism.labelling.body.anchors import AnchorRules, Anchors, choose_anchors, with_intervals
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyModel, BodyRules, fit_body, length_scale, names_of, subsample
from asterism.labelling.features.search_kernels import search

pytestmark = pytest.mark.kernels

SETTINGS = FrameLabellingSettings().with_usual_score(1.0)
MARKERS, LATENTS, POSES = 6, 5, 2
races = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)


def turn(angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def random_model(rng):
    """Two key poses of six markers, half a metre apart; each varies by some centimetres, of which a part together."""
    noise = rng.normal(0.0, 0.03, (POSES, MARKERS, 3, 3))
    return BodyModel(
        mean=rng.normal(0.0, 0.4, (POSES, MARKERS, 3)),
        load=rng.normal(0.0, 0.04, (POSES, MARKERS, 3, LATENTS)),
        noise=noise @ noise.transpose(0, 1, 3, 2) + 0.01**2 * np.eye(3),
        log_weight=np.log(rng.dirichlet(np.ones(POSES))),
    )


def random_frame(model, rng, least=1):
    """A pose's body, turned and shifted: points (n, 3), some of them ghosts; rows (M,), some -1; outlier flags of some labelled ones."""
    body = rng.multivariate_normal(model.mean[0].reshape(-1), model.covariance(0)).reshape(-1, 3)
    shown = rng.permutation(MARKERS)[: rng.integers(least, MARKERS + 1)]
    ghosts = rng.normal(0.0, 0.4, (rng.integers(0, 3), 3))
    points = np.concatenate([body[shown], ghosts]) @ turn(rng.uniform(-4, 4)).T + rng.normal(0.0, 3.0, 3)
    order = rng.permutation(len(points))
    rows = np.full(MARKERS, -1)
    rows[shown] = np.argsort(order)[: len(shown)]
    outlier = (rows >= 0) & (rng.random(MARKERS) < 0.2)
    return np.ascontiguousarray(points[order]), rows, outlier


def ready(points, outlier):
    workspace = make_body_workspace(len(points), MARKERS, LATENTS)
    workspace.outlier[:] = outlier
    return workspace


def frame_model(model, anchors, settings=SETTINGS):
    return FrameModel(anchors.solvers(), anchors.arrays(model), model.arrays(), settings, np.empty((0, MARKERS), dtype=np.int64))


# --- kernels and twins


@given(seed=seeds)
@races
def test_placing(seed):
    rng = np.random.default_rng(seed)
    points, rows, _ = random_frame(random_model(rng), rng, least=2)
    mean, out = rng.normal(0.0, 0.4, (MARKERS, 3)), np.empty_like(points)
    geometry_kernels.align_about_z(points, rows, mean, np.arange(MARKERS), out)
    np.testing.assert_allclose(out, twins.place_points(points, rows, mean, range(MARKERS)), atol=1e-9)


@pytest.mark.parametrize(
    "points", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0]] * 3, [[1.0, 2.0, 3.0], [1.0, 2.0, 4.0]]], ids=["one", "equal", "upright"]
)
def test_placing_where_no_heading_can_be_told(points):
    """Nothing turns, the centres meet."""
    points, out = np.array(points), np.empty((len(points), 3))
    mean = np.arange(9.0).reshape(3, 3)
    geometry_kernels.align_about_z(points, np.arange(len(points)), mean, np.arange(len(points)), out)
    np.testing.assert_allclose(out, points - points.mean(axis=0) + mean[: len(points)].mean(axis=0))


@given(seed=seeds, size=st.integers(1, 24))
@races
def test_cholesky(seed, size):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size + 2))
    matrix = root @ root.T + 0.1 * np.eye(size)
    factor = matrix.copy()
    log_det = _cholesky(factor)
    np.testing.assert_allclose(np.triu(factor).T, np.linalg.cholesky(matrix), rtol=1e-7, atol=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(matrix)[1], abs=1e-8)


def test_the_determinant_of_a_large_matrix_does_not_overflow():
    matrix = np.diag(np.full(40, 1e20))
    assert _cholesky(matrix) == pytest.approx(40 * np.log(1e20))


@given(seed=seeds)
@races
def test_evidence_is_the_joint_density_of_all_labelled_points(seed):
    """The kernel integrates the latents out by Woodbury; the twin evaluates the full Gaussian."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, outlier = random_frame(model, rng)
    for k in range(POSES):
        score = evidence(model.arrays(), k, points, rows, SETTINGS, ready(points, outlier))
        assert score == pytest.approx(twins.evidence(model, k, points, rows, outlier, SETTINGS), rel=1e-8, abs=1e-6)


def test_evidence_counts_the_ghost_once():
    rng = np.random.default_rng(0)
    model = random_model(rng)
    points = np.ascontiguousarray(model.mean[0])
    scores = []
    for ghosts in range(3):
        cloud = np.concatenate([points, rng.normal(size=(ghosts, 3))])
        scores.append(evidence(model.arrays(), 0, cloud, np.arange(MARKERS), SETTINGS, ready(cloud, False)))
    assert scores[0] - scores[1] == pytest.approx(SETTINGS.first_ghost_cost)
    assert scores[1] == pytest.approx(scores[2])


@given(seed=seeds)
@races
def test_all_markers_are_predicted_from_the_posterior_of_the_latents(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, outlier = random_frame(model, rng)
    workspace, body = ready(points, outlier), model.arrays()
    evidence(body, 1, points, rows, SETTINGS, workspace)
    predict_markers(body, 1, workspace)
    latent, covariance = twins.posterior(model, 1, points, rows, outlier)
    np.testing.assert_allclose(workspace.centre.reshape(3, -1).T, body.load[1] @ latent, atol=1e-6)
    variance = np.einsum("mai,ij,mbj->mab", body.load[1], covariance, body.load[1])
    np.testing.assert_allclose(workspace.variance.T, variance[:, *np.triu_indices(3)], atol=1e-6)


@given(seed=seeds)
@races
def test_scores_leave_the_marker_itself_out(seed):
    """The kernel downdates the posterior; the twin conditions on all other points by the full covariance, marker by marker."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, outlier = random_frame(model, rng)
    workspace = ready(points, outlier)
    evidence(model.arrays(), 0, points, rows, SETTINGS, workspace)
    predict_markers(model.arrays(), 0, workspace)
    leave_one_out_scores(model.arrays(), 0, rows, SETTINGS, workspace)
    np.testing.assert_allclose(
        workspace.scores, twins.leave_one_out_scores(model, 0, points, rows, outlier, SETTINGS), rtol=1e-6, atol=1e-4
    )


@given(seed=seeds)
@races
def test_an_anchor_predicts_the_whole_body(seed):
    """Scores equal the conditional Gaussian's wherever they are above 0; where the kernel skips, the twin has nothing above 0."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, _ = random_frame(model, rng, least=4)
    triple = rng.permutation(np.nonzero(rows >= 0)[0])[:3]
    ends = np.zeros((1, 6))
    anchors = Anchors(triple[None], ends, ends)
    workspace = ready(points, False)
    for k in range(POSES):
        score_from_anchor(frame_model(model, anchors), 0, k, points, rows[triple], workspace)
        expected = twins.score_from_anchor(model, k, points, rows[triple], triple, SETTINGS)
        others = np.isfinite(expected)
        assert others.sum() == (MARKERS - 3) * len(points)
        looked_at = np.isfinite(workspace.scores) & others
        np.testing.assert_allclose(workspace.scores[looked_at], expected[looked_at], rtol=1e-6, atol=1e-4)
        assert (expected[others & ~looked_at] <= 1e-6).all()
        assert (workspace.scores[triple].argmax(axis=1) == rows[triple]).all()
        assert np.isfinite(workspace.scores[triple]).sum() == 3


@given(seed=seeds)
@races
def test_an_anchor_knows_its_key_pose(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    points, rows, _ = random_frame(model, rng, least=3)
    triple = np.nonzero(rows >= 0)[0][:3]
    anchors = Anchors(triple[None], np.zeros((1, 6)), np.zeros((1, 6)))
    arrays, displacement = anchors.arrays(model), np.empty(9)
    ours = (arrays.mean, arrays.precision_factor, arrays.log_peak, 0, *map(tuple, points[rows[triple]]))
    k, log_density, distance = anchor_key_pose(*ours, -np.inf, displacement)
    expected, squares = zip(*(twins.anchor_density(model, pose, points, rows[triple], triple) for pose in range(POSES)), strict=True)
    assert k == np.argmax(expected)
    assert log_density == pytest.approx(expected[k], rel=1e-7, abs=1e-6)
    assert distance == pytest.approx(squares[k], rel=1e-7, abs=1e-6)
    assert anchor_key_pose(*ours, log_density - 1e-9, displacement) == (k, log_density, distance)
    assert anchor_key_pose(*ours, log_density + 1e-6, displacement)[1] < log_density


def random_scores(rng):
    """Scores of which some are far, few clear, and many slightly below 0, as in crowded frames."""
    shape = rng.integers(1, 7), rng.integers(1, 7)
    return np.where(rng.random(shape) < 0.2, -np.inf, rng.normal(0.0, 5.0, shape))


@given(seed=seeds)
@settings(races, max_examples=200)
def test_assignment(seed):
    scores = random_scores(np.random.default_rng(seed))
    rows = np.empty(len(scores), dtype=np.int64)
    assign_greedily(scores, 6.0, rows)
    np.testing.assert_array_equal(rows, twins.assign_greedily(scores, 6.0))
    assert len(set(rows[rows >= 0])) == (rows >= 0).sum()


@pytest.mark.parametrize(
    ("scores", "rows"),
    [
        ([[9.0, 8.0], [8.0, 1.0]], [0, 1]),  # best first, not best in sum
        ([[9.0, -1.0], [-1.0, -2.0]], [0, 1]),  # 2 nats are less than a ghost
        ([[9.0, -1.0], [-1.0, -7.0]], [0, -1]),  # 7 nats are more
        ([[9.0, -1.0, -np.inf], [-1.0, -2.0, -np.inf]], [0, -1]),  # a ghost is left anyway
        ([[-np.inf]], [-1]),
    ],
)
def test_assignment_by_hand(scores, rows):
    out = np.empty(len(scores), dtype=np.int64)
    assign_greedily(np.array(scores), 6.0, out)
    assert out.tolist() == rows


@given(seed=seeds, gap=st.floats(0.1, 6.0))
@settings(races, max_examples=200)
def test_clear_assignment(seed, gap):
    scores = random_scores(np.random.default_rng(seed))
    rows = np.empty(len(scores), dtype=np.int64)
    assign_unambiguous(scores, gap, rows)
    np.testing.assert_array_equal(rows, twins.assign_unambiguous(scores, gap))


# --- what is learned


@pytest.fixture(scope="module")
def people():
    """Three people of different size: the same body, swaying by 2 cm, anywhere, facing anywhere. Frames (N, M, 3), whose, and the body."""
    rng = np.random.default_rng(1)
    body = rng.normal(0.0, 0.4, (7, 3))
    frames, whose = [], []
    for person, size in enumerate((0.9, 1.0, 1.1)):
        for _ in range(150):
            sway = rng.normal(0.0, 0.02, (7, 3))
            frames.append((size * body + sway) @ turn(rng.uniform(-4, 4)).T + [*rng.normal(0.0, 3.0, 2), 1.0])
            whose.append(person)
    return np.array(frames), np.array(whose), body - body.mean(axis=0)


@pytest.fixture(scope="module")
def learned(people):
    return fit_body(people[0], people[1], BodyRules(), seed=0)


def test_frames_are_placed_onto_a_body(people):
    frames, _, body = people
    placed = align_about_z(frames[:20], body)
    for frame, got in zip(frames[:20], placed, strict=True):
        np.testing.assert_allclose(got, twins.place_points(frame, np.arange(7), body, range(7)), atol=1e-9)
    gone = frames[:20].copy()
    gone[:, 2] = np.nan
    assert np.isnan(align_about_z(gone, body)[:, 2]).all()
    assert np.isfinite(np.delete(align_about_z(gone, body), 2, axis=1)).all()


def test_the_mean_body_is_found(learned, people):
    assert learned.mean.shape == (1, 7, 3), "450 frames are one key pose"
    body = people[2]
    for mean in learned.mean:
        miss = np.linalg.norm(twins.place_points(mean, np.arange(7), body, range(7)) - body, axis=1).max()
        assert miss < 0.01, f"a marker of the mean body is {1000 * miss:.1f} mm off, allowed 10"


def test_the_model_expects_what_bodies_do(learned, people):
    """Squared distance of the training frames per coordinate: below 1, as the model allows more than it saw; wrong bodies far above."""
    frames = people[0]
    mean, full = learned.mean[0].reshape(-1), learned.covariance(0)
    precision = np.linalg.inv(full)

    def distance(of):
        flat = align_about_z(of, learned.mean[0]).reshape(len(of), -1) - mean
        return np.einsum("ni,ij,nj->n", flat, precision, flat).mean() / len(mean)

    assert 0.2 < distance(frames) < 1.0
    assert distance(frames[:, [1, 0, 2, 3, 4, 5, 6]]) > 10.0
    np.testing.assert_allclose(full, full.T)


def test_gaps_hardly_change_the_model(learned, people):
    frames, whose, _ = people
    rng = np.random.default_rng(2)
    holed = np.where(rng.random(frames.shape[:2])[:, :, None] < 0.15, np.nan, frames)
    model = fit_body(holed, whose, BodyRules(), seed=0)
    miss = np.linalg.norm(twins.place_points(model.mean[0], np.arange(7), learned.mean[0], range(7)) - learned.mean[0], axis=1).max()
    assert miss < 0.01, f"{1000 * miss:.1f} mm"


def test_gaps_leave_it_known_how_markers_move_together():
    """A body whose markers sway together by 4 cm; each is hidden for 0.2 of the time. It keeps nearly all of that."""
    rng = np.random.default_rng(4)
    body, way = rng.normal(0.0, 0.4, (7, 3)), rng.normal(0.0, 1.0, (7, 3))
    way -= way.mean(axis=0)
    frames = (
        body + 0.04 * rng.normal(size=(300, 1, 1)) * way / np.linalg.norm(way, axis=1, keepdims=True) + rng.normal(0.0, 0.002, (300, 7, 3))
    )
    holed = np.where(rng.random(frames.shape[:2])[:, :, None] < 0.2, np.nan, frames)
    whole, gappy = (fit_body(some, np.zeros(300, dtype=np.int64), BodyRules(), seed=0).within for some in (frames, holed))
    main = np.linalg.eigh(whole[0])[1][:, -1]
    kept = (main @ gappy[0] @ main) / (main @ whole[0] @ main)
    assert 0.8 < kept < 1.1, f"{kept:.2f} of the variance of the common motion is left"


def test_key_poses_are_told_apart():
    """A body and the same with one arm raised, in equal numbers: two key poses, half of the frames each."""
    rng = np.random.default_rng(3)
    one = rng.normal(0.0, 0.4, (7, 3))
    other = one.copy()
    other[:2, 2] += 1.0
    frames = np.concatenate([pose + rng.normal(0.0, 0.01, (320, 7, 3)) for pose in (one, other)])
    model = fit_body(frames, np.zeros(640, dtype=np.int64), BodyRules(poses=2), seed=0)
    np.testing.assert_allclose(np.exp(model.log_weight), 0.5, atol=0.01)
    raised = np.ptp(model.mean[:, 0, 2] - model.mean[:, 6, 2])
    assert raised == pytest.approx(1.0, abs=0.02)


def test_anchors_never_miss_the_right_triple_of_a_training_frame(people):
    frames, whose, _ = people
    triples = np.array([[0, 1, 2], [4, 2, 6], [5, 3, 0]])
    solvers = with_intervals(triples, frames, whose, AnchorRules()).solvers()
    found = np.empty((64, 3), dtype=np.int64)
    for frame in frames[::10]:
        for a, triple in enumerate(triples):
            solutions = search(solvers, a, frame, np.arange(7), 10**6, found, np.zeros(2, dtype=np.int64))
            assert triple.tolist() in found[:solutions].tolist()


@pytest.mark.filterwarnings("ignore:All-NaN slice")
def test_a_triple_never_seen_together_finds_nothing(people):
    frames, whose, _ = people
    apart = frames.copy()
    apart[::2, 0] = np.nan
    apart[1::2, 1] = np.nan
    anchors = with_intervals(np.array([[0, 1, 2]]), apart, whose, AnchorRules())
    found = np.empty((64, 3), dtype=np.int64)
    assert search(anchors.solvers(), 0, frames[0], np.arange(7), 10**6, found, np.zeros(2, dtype=np.int64)) == 0


def test_anchors_are_chosen_alike_each_time_and_cover_what_is_hidden(people, learned):
    frames, whose, _ = people
    one, two = (choose_anchors(frames, whose, learned, AnchorRules(count=12), np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.triples, two.triples)
    assert len(one.triples) == len({tuple(sorted(triple)) for triple in one.triples.tolist()}) == 12
    for hidden in range(7):
        assert (one.triples != hidden).all(axis=1).any(), f"every anchor needs marker {hidden}"


def test_anchors_of_a_large_marker_set_begin_with_neighbours_that_keep_their_distances():
    """Of 84 triples, too many to try each, one is rigid: three markers of nine that move apart."""
    rng = np.random.default_rng(7)
    rigid, (frames, whose) = np.array([2, 5, 7]), (rng.normal(0.0, 0.4, (60, 9, 3)), np.repeat([0, 1], 30))
    frames[:, rigid] = frames[:, rigid[:1]] + np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.15], [-0.1, 0.05, -0.1]])
    rules = AnchorRules(count=5, candidates=60)
    chosen = choose_anchors(frames, whose, fit_body(frames, whose, BodyRules(), 0), rules, np.random.default_rng(5)).triples
    assert sorted(chosen[0].tolist()) == rigid.tolist()
    assert len({tuple(sorted(triple)) for triple in chosen.tolist()}) == 5 and all(len(set(triple)) == 3 for triple in chosen.tolist())


# --- small ones


@pytest.mark.parametrize(("size", "scale"), [(0.5, 1.0), (0.25, 1.0), (0.1, 0.4), (0.02, 0.08)])
def test_lengths_chosen_on_people_shrink_with_smaller_bodies(size, scale):
    """`size`: root mean square from the body's middle; people have 0.25 m and more."""
    corners = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert length_scale(3.0 + size * corners, BodyRules()) == pytest.approx(scale)


def test_people_are_numbered_in_order_of_appearance():
    names, numbers = names_of(["Bo", "Al", "Bo", "Cy"])
    assert names == ("Bo", "Al", "Cy")
    assert numbers.tolist() == [0, 1, 0, 2]


def test_a_subsample_takes_the_same_number_of_everybody_evenly():
    rows = subsample(np.array([0] * 10 + [1] * 3), 4)
    assert rows.tolist() == [0, 3, 6, 9, 10, 11, 12]


@pytest.mark.parametrize("proposals", [0, MAX_LABELLINGS + 1])
def test_more_proposals_than_a_frame_keeps_are_refused(proposals: int) -> None:
    """No anchor would be run, and no frame labelled."""
    with pytest.raises(AsterismError, match=f"give 1 to {MAX_LABELLINGS}"):
        FrameLabellingSettings(proposals_per_anchor=proposals)
    assert FrameLabellingSettings(proposals_per_anchor=MAX_LABELLINGS).proposals_per_anchor == MAX_LABELLINGS
