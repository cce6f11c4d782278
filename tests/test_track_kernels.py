"""The kernels of whole recordings against their plain twins, on random bodies, tracklets and gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import twins_tracks as twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.labelling.body._search_kernels import LAID
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyModel
from asterism.labelling.whole import _kernels as kernels
from asterism.labelling.whole import assignment
from asterism.labelling.whole._distance_kernels import DistanceLimits, TrackedPoints, rigid_deviations, training_deviations
from asterism.labelling.whole._residual_kernels import ResidualLimits, prediction_residuals, residual_deviations
from asterism.labelling.whole._short_kernels import Expected, ShortLabels, ShortLimits, label_short, take_best_pairs
from asterism.labelling.whole._twin_kernels import TwinScores, score_exchanges, score_twins
from asterism.labelling.whole.assignment import assign_tracklets
from asterism.labelling.whole.short import ShortTrackletRules, expect_by_motion, marker_shares
from asterism.recording.verdict import FITS, OTHER_BODY, Verdict

pytestmark = pytest.mark.kernels

SETTINGS = FrameLabellingSettings().with_usual_score(1.0)
MARKERS, LATENTS, POSES = 6, 4, 2
races = settings(max_examples=25, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)


def random_body(rng: np.random.Generator) -> BodyModel:
    """Two key poses of six markers, each of which varies by some centimetres."""
    noise = rng.normal(0.0, 0.03, (POSES, MARKERS, 3, 3))
    return BodyModel(
        mean=rng.normal(0.0, 0.4, (POSES, MARKERS, 3)),
        load=rng.normal(0.0, 0.04, (POSES, MARKERS, 3, LATENTS)),
        noise=noise @ noise.transpose(0, 1, 3, 2) + 0.01**2 * np.eye(3),
        log_weight=np.log(rng.dirichlet(np.ones(POSES))),
    )


def random_tracklets(rng: np.random.Generator, tracklets: int, frames: int = 30) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First and last frames (J,), and labels (J,) that give one marker to one tracklet at a time."""
    first = rng.integers(0, frames, tracklets)
    last = np.minimum(first + rng.integers(0, frames // 2, tracklets), frames - 1)
    label = rng.integers(-1, MARKERS, tracklets)
    for j in range(tracklets):
        if any(label[i] == label[j] and twins.together(first, last, i, j) for i in range(j)):
            label[j] = -1
    return first, last, label


def labelled_frames(rng: np.random.Generator, model: BodyModel) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Four frames of a body and of ghosts, the tracklet of each of their points, and the tracklets' labels."""
    label = np.concatenate([rng.permutation(MARKERS), [-1, -1, -1]])
    label[rng.random(len(label)) < 0.25] = -1
    frames, tracks = [], []
    for _ in range(4):
        body = rng.multivariate_normal(model.mean[0].reshape(-1), model.covariance(0)).reshape(-1, 3)
        track = rng.permutation(len(label))[: rng.integers(0, len(label) + 1)]
        points = [body[label[j]] if label[j] >= 0 and rng.random() < 0.9 else rng.normal(0.0, 0.3, 3) for j in track]
        frames.append(np.array(points).reshape(-1, 3))
        tracks.append(track)
    return frames, tracks, label


@given(seeds)
@races
def test_scores_of_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_body(rng)
    frames, tracks, label = labelled_frames(rng, model)
    offsets = np.concatenate([[0], np.cumsum([len(points) for points in frames])])
    xyz, track = np.concatenate(frames), np.concatenate(tracks)
    scores, totals, poses = np.empty((len(xyz), MARKERS)), np.empty(4), np.empty(4, dtype=np.int64)
    kernels.score_frames(xyz, offsets, track, label, model.arrays(), SETTINGS, kernels.FrameScores(scores, totals, poses))
    wanted, sums, chosen = twins.score_frames(model, frames, tracks, label, SETTINGS)
    np.testing.assert_allclose(scores, wanted, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(totals, sums, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(poses, chosen)


@given(seeds, st.sampled_from([5.0, 1e6]))
@races
def test_twins_of_labelled_frames(seed: int, gap: float) -> None:
    """With pairs exchanged, a third of a turn, and two markers left open; only near ones, or all of them refined."""
    rng = np.random.default_rng(seed)
    model = random_body(rng)
    frames, tracks, label = labelled_frames(rng, model)
    table = np.arange(MARKERS) + np.zeros((3, 1), dtype=np.int64)
    table[0, :4], table[1, :3], table[2, -2:] = [1, 0, 3, 2], [1, 2, 0], -1
    offsets = np.concatenate([[0], np.cumsum([len(points) for points in frames])])
    out = TwinScores(np.empty((3 + LAID + 1, 4)), np.empty((3 + LAID + 1, 4, MARKERS), dtype=np.int64))
    xyz, track = np.concatenate(frames), np.concatenate(tracks)
    done = np.zeros(3 + LAID, dtype=bool)
    score_twins(xyz, offsets, track, label, table, model.arrays(), SETTINGS, gap, 10.0, len(done), done, out)
    scores, rows = twins.score_twins(model, frames, tracks, label, table, SETTINGS, gap, 10.0)
    np.testing.assert_allclose(out.scores, scores, rtol=1e-6, atol=1e-5)
    np.testing.assert_array_equal(out.point_of, rows)
    assert done.all()
    # one frame, one refinement at a time: nearest first, and all together the same
    done[:], last, found = False, slice(offsets[-2], offsets[-1]), np.full(3 + LAID, np.nan)
    alone = TwinScores(np.empty((3 + LAID + 1, 1)), np.empty((3 + LAID + 1, 1, MARKERS), dtype=np.int64))
    for _ in range(len(done) + 1):
        before = done.copy()
        ends = np.array([0, len(xyz[last])])
        score_twins(xyz[last], ends, track[last], label, table, model.arrays(), SETTINGS, gap, 10.0, 1, done, alone)
        seen = ~np.isnan(alone.scores[:-1, 0])
        assert not (seen & before).any()
        assert done[before | seen].all()
        found[seen] = alone.scores[:-1, 0][seen]
        np.testing.assert_array_equal(alone.point_of[:-1, 0][seen], rows[:-1, -1][seen])
        if done.all():
            break
    assert done.all()
    np.testing.assert_allclose(found, scores[:-1, -1], rtol=1e-6, atol=1e-5)


@given(seeds)
@races
def test_what_scores_say_of_exchanges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_body(rng)
    frames, tracks, label = labelled_frames(rng, model)
    offsets = np.concatenate([[0], np.cumsum([len(points) for points in frames])])
    apart, both, shown = (np.empty((MARKERS, MARKERS), dtype=kind) for kind in (float, np.int64, np.int64))
    score_exchanges(np.concatenate(frames), offsets, np.concatenate(tracks), label, model.arrays(), SETTINGS, apart, both, shown)
    for found, expected in zip((apart, both, shown), twins.score_exchanges(model, frames, tracks, label, SETTINGS), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-5)


@given(seeds)
@races
def test_how_far_points_lie_from_where_the_others_predict_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_body(rng)
    frames, tracks, label = labelled_frames(rng, model)
    offsets = np.concatenate([[0], np.cumsum([len(points) for points in frames])])
    xyz, track = np.concatenate(frames), np.concatenate(tracks)
    out = np.empty((len(xyz), 3))
    prediction_residuals(xyz, offsets, track, label, model.arrays(), SETTINGS, out)
    np.testing.assert_allclose(out, twins.prediction_residuals(model, frames, tracks, label, SETTINGS), rtol=1e-6, atol=1e-9)


@given(seeds)
@races
def test_tracklets_that_lie_elsewhere_than_their_marker_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    track, label = rng.integers(0, 8, 60), rng.integers(-1, 3, 8)
    residuals = rng.normal(0.0, 0.01, (60, 3))
    residuals[rng.random(60) < 0.2] = np.nan
    out = np.empty(8)
    residual_deviations(residuals, track, label, ResidualLimits(0.004, 5), out)
    np.testing.assert_allclose(out, twins.residual_deviations(residuals, track, label, 0.004, 5))


def test_a_ghost_beside_its_marker_deviates_and_the_marker_that_comes_back_does_not() -> None:
    """A marker seen for 20 frames, then a point 40 mm beside its place for 5, then the marker again for 5; noise of 5 mm."""
    rng = np.random.default_rng(0)
    track = np.repeat([0, 1, 2], [20, 5, 5])
    residuals = rng.normal(0.0, 0.005, (30, 3)) + np.where(track == 1, 0.04, 0.0)[:, None] * np.array([1.0, 0.0, 0.0])
    out = np.empty(3)
    residual_deviations(residuals, track, np.zeros(3, dtype=np.int64), ResidualLimits(0.004, 5), out)
    assert out[1] > 2.0 and out[2] < 1.0, out
    assert np.isnan(out[0]), "the others were seen less often than this one"


@given(seeds)
@races
def test_sums_over_tracklets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    track, scores = rng.integers(0, 5, 40), rng.normal(0.0, 20.0, (40, MARKERS))
    scores[rng.random(scores.shape) < 0.2] = -np.inf
    sums, counts = np.zeros((6, MARKERS)), np.zeros(6)
    kernels.sum_scores(track, scores, -4.0, 15.0, sums, counts)
    wanted, points = twins.sum_scores(track, scores, -4.0, 15.0, 6)
    np.testing.assert_allclose(sums, wanted)
    np.testing.assert_array_equal(counts, points)


@given(seeds, st.integers(0, 12))
@races
def test_tracklets_that_may_conflict(seed: int, tracklets: int) -> None:
    rng = np.random.default_rng(seed)
    first, last, _ = random_tracklets(rng, tracklets)
    gain = rng.normal(-1.0, 1.0, (tracklets, MARKERS))
    pairs = kernels.overlaps(gain, first, last, np.argsort(first, kind="stable"))
    assert len({frozenset(pair) for pair in pairs.tolist()}) == len(pairs)
    assert {frozenset(pair) for pair in pairs.tolist()} == twins.overlaps(gain, first, last)


def test_overlaps_of_more_markers_than_a_word_has_bits() -> None:
    """A marker each in the middle, at the end and beyond the end of a word of 32 bits, and of 64."""
    first, last = np.zeros(4, dtype=np.int64), np.ones(4, dtype=np.int64)
    for marker in (0, 31, 32, 63, 64, 69):
        gain = np.full((4, 70), -1.0)
        gain[[0, 2], marker] = 1.0
        gain[1, (marker + 32) % 70] = 1.0
        pairs = kernels.overlaps(gain, first, last, np.arange(4))
        assert pairs.tolist() == [[0, 2]], marker


@given(seeds, st.integers(0, 12))
@races
def test_margins_and_rivals(seed: int, tracklets: int) -> None:
    rng = np.random.default_rng(seed)
    first, last, label = random_tracklets(rng, tracklets)
    gain = rng.normal(0.0, 8.0, (tracklets, MARKERS))
    gain[rng.random(gain.shape) < 0.1] = -np.inf
    labelled = np.nonzero(label >= 0)[0]
    gain[labelled, label[labelled]] = np.abs(rng.normal(10.0, 5.0, len(labelled)))
    margin, rival = kernels.margins_of(gain, label, first, last, np.argsort(first, kind="stable"))
    wanted, rivals = twins.margins(gain, label, first, last)
    np.testing.assert_allclose(margin, wanted, rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(rival, rivals)


@given(seeds)
@races
def test_the_best_assignment(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = rng.integers(0, 30, rng.integers(1, 25))
    last = first + rng.integers(0, 20, len(first))
    gain = rng.normal(0.0, 5.0, (len(first), rng.integers(1, 6)))
    label, by_highs = assign_tracklets(gain, first, last).label, assignment._solve_by_highs(gain, first, last)
    assert by_highs is not None
    for frame in range(60):
        there = label[(first <= frame) & (frame <= last) & (label >= 0)]
        assert len(np.unique(there)) == len(there)
    total, wanted = (gain[found >= 0, found[found >= 0]].sum() for found in (label, by_highs))
    assert np.isclose(total, wanted)


@given(seeds)
@races
def test_the_best_assignment_of_many_tracklets_at_one_time(seed: int) -> None:
    """More than branch and bound can search, as in a crowd of reflections."""
    rng = np.random.default_rng(seed)
    gain = rng.normal(0.2, 1.0, (60, 12))
    first, last = rng.integers(0, 10, 60), rng.integers(10, 20, 60)
    label, by_highs = assign_tracklets(gain, first, last).label, assignment._solve_by_highs(gain, first, last)
    assert by_highs is not None
    assert len(np.unique(label[label >= 0])) == (label >= 0).sum()
    total, wanted = (gain[found >= 0, found[found >= 0]].sum() for found in (label, by_highs))
    assert np.isclose(total, wanted)


@given(seeds)
@settings(races, max_examples=10)
def test_more_than_can_be_compared_exactly_is_nearly_the_best(seed: int) -> None:
    """Every tracklet could be every marker, as of a body that the model does not know."""
    rng = np.random.default_rng(seed)
    first = rng.integers(0, 300, rng.integers(20, 60))
    last = first + rng.integers(0, 80, len(first))
    gain = rng.normal(20.0, 8.0, len(first))[:, None] + rng.normal(0.0, 5.0, (len(first), rng.integers(2, 12)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assignment, "EXACT_CHOICES", 0)
        patch.setattr(assignment, "BRANCHES", 0)
        rough = assign_tracklets(gain, first, last)
    exact = assign_tracklets(gain, first, last)
    for frame in range(380):
        there = rough.label[(first <= frame) & (frame <= last) & (rough.label >= 0)]
        assert len(np.unique(there)) == len(there)
    total, wanted = (gain[found >= 0, found[found >= 0]].sum() for found in (rough.label, exact.label))
    assert 0.85 * wanted <= total <= wanted + 1e-6
    assert not exact.rough.any()
    assert rough.rough.any() or np.array_equal(rough.label, exact.label)
    again = rng.permutation(len(first))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assignment, "EXACT_CHOICES", 0)
        patch.setattr(assignment, "BRANCHES", 0)
        shuffled = assign_tracklets(gain[again], first[again], last[again]).label
    assert gain[again][shuffled >= 0, shuffled[shuffled >= 0]].sum() >= 0.85 * wanted


def test_a_program_of_thousands_of_choices_ends() -> None:
    """500 tracklets of which each could be any of 40 markers: exactly, hours."""
    rng = np.random.default_rng(0)
    first = np.sort(rng.integers(0, 3000, 500))
    last = first + rng.integers(20, 400, 500)
    gain = rng.normal(20.0, 8.0, (500, 1)) + rng.normal(0.0, 5.0, (500, 40))
    found = assign_tracklets(gain, first, last)
    assert found.rough.any()
    assert (found.label >= 0).mean() > 0.7


def test_a_verdict_names_what_was_not_compared_exactly() -> None:
    verdict = Verdict(FITS, 0.01, 0.06, 1.0, 1.0, 0.0, rough=12)
    (finding,) = verdict.findings("run.c3d")
    assert finding.code == "label-rough"
    assert "12 pieces of tracks" in finding.sentence
    assert all(each.code != "label-rough" for each in replace(verdict, kind=OTHER_BODY).findings()), "no label was given there"


@given(seeds)
@settings(races, max_examples=40)
def test_what_dominates_is_in_the_best_of_all_labellings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracklets, markers = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    first = rng.integers(0, 6, tracklets)
    last = first + rng.integers(0, 6, tracklets)
    gain = np.round(rng.normal(1.0, 3.0, (tracklets, markers)) * rng.choice([1.0, 10.0], tracklets)[:, None])
    left = gain.copy()
    kernels.settle_dominant(left, kernels.overlaps(gain, first, last, np.argsort(first, kind="stable")), 20)
    assert twins.best_total(left, first, last) == twins.best_total(gain, first, last)
    assert ((left == gain) | ((left == 0) & (gain > 0))).all()


@given(seeds, st.integers(0, 12))
@races
def test_how_much_shorter_rivals_amount_to(seed: int, tracklets: int) -> None:
    rng = np.random.default_rng(seed)
    first, last, _ = random_tracklets(rng, tracklets)
    gain, samples, independent = rng.normal(0.0, 1.0, (tracklets, 3)), rng.integers(0, 9, tracklets), rng.uniform(0.5, 3.0, tracklets)
    pairs = kernels.overlaps(gain, first, last, np.argsort(first, kind="stable"))
    found = kernels.rivals_weight(gain, pairs, first, last, samples, independent)
    assert np.isclose(found, twins.rivals_weight(gain, first, last, samples, independent))


@given(seeds)
@races
def test_points_of_short_tracklets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, limits = random_body(rng), ShortLimits(3, -4.0, 15.0, 0.03, 0.01)
    frames, labels, candidates = [], [], []
    for _ in range(4):
        body = rng.multivariate_normal(model.mean[0].reshape(-1), model.covariance(0)).reshape(-1, 3)
        label = np.where(rng.random(MARKERS) < 0.7, np.arange(MARKERS), -1)
        extra = body[rng.integers(0, MARKERS, 4)] + rng.normal(0.0, 0.1, (4, 3))
        frames.append(np.concatenate([body, extra]))
        labels.append(np.concatenate([label, np.full(4, -1)]))
        candidates.append((labels[-1] < 0) & (rng.random(MARKERS + 4) < 0.8))
    offsets, label = np.arange(5) * (MARKERS + 4), np.concatenate(labels)
    place = np.stack([points[:MARKERS] for points in frames]) + rng.normal(0.0, 0.02, (4, MARKERS, 3))
    spread = np.where(rng.random((4, MARKERS)) < 0.5, rng.uniform(0.005, 0.1, (4, MARKERS)), np.inf)
    hits, near = np.zeros((2, MARKERS, 4), dtype=np.int64)
    out = ShortLabels(label.copy(), np.zeros(len(label)), np.zeros(len(label), bool), np.zeros(4, bool), hits, near)
    label_short(np.concatenate(frames), offsets, np.concatenate(candidates), model.arrays(), SETTINGS, limits, Expected(place, spread), out)
    given, alone, wanted_hits, wanted_near = twins.label_short(model, frames, candidates, labels, place, spread, SETTINGS, limits)
    np.testing.assert_array_equal(out.alone, alone)
    np.testing.assert_array_equal(hits, wanted_hits)
    np.testing.assert_array_equal(near, wanted_near)
    for t, pairs in enumerate(given):
        new = {c: out.label[offsets[t] + c] for c in range(MARKERS + 4) if out.label[offsets[t] + c] != labels[t][c]}
        assert new == {c: m for c, (m, _) in pairs.items()}
        for c, (m, margin) in pairs.items():
            assert np.isclose(out.margin[offsets[t] + c], margin, rtol=1e-6, atol=1e-6)
            assert out.by_motion[offsets[t] + c] == (spread[t, m] <= limits.motion_spread)


@given(seeds)
@races
def test_the_best_pairs_of_a_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scores = np.where(rng.random((5, 7)) < 0.3, -np.inf, rng.normal(0.0, 3.0, (5, 7)))
    label, margin = np.full(7, -1), np.zeros(7)
    take_best_pairs(scores, label, margin)
    wanted = twins.best_pairs(scores)
    assert {c: m for c, m in enumerate(label.tolist()) if m >= 0} == {c: m for c, (m, _) in wanted.items()}
    assert np.allclose([margin[c] for c in wanted], [its for _, its in wanted.values()])


@given(seeds, st.integers(2, 12))
@races
def test_a_marker_is_expected_on_the_line_across_its_gap(seed: int, gap: int) -> None:
    rng = np.random.default_rng(seed)
    path = rng.normal(size=3) + np.arange(gap + 1)[:, None] * 0.01 * rng.normal(size=3)
    frame_of = np.array([0, gap, 0])
    rules = ShortTrackletRules()
    found = expect_by_motion(np.array([path[0], path[-1], path[0]]), frame_of, np.array([1, 1, 0]), (gap + 1, 2), 100.0, rules)
    inside = np.arange(1, gap)
    np.testing.assert_allclose(found.place[inside, 1], path[inside])
    std = np.hypot(rules.noise, 0.5 * rules.acceleration * inside * (gap - inside) / 100.0**2)
    np.testing.assert_allclose(found.spread[inside, 1], np.where(std <= rules.max_spread, std, np.inf))
    assert np.isinf(found.spread[[0, -1], 1]).all() and np.isinf(found.spread[:, 0]).all()


def test_hits_that_ghosts_explain_are_no_markers() -> None:
    """As often as while another point is the marker; far oftener; never; and as often as the others, for markers that were always free."""
    counts = np.array([(300, 9, 900, 27), (300, 60, 900, 27), (300, 0, 900, 27), (100, 3, 0, 0), (100, 40, 0, 0)])
    share = marker_shares(counts, ShortTrackletRules())
    np.testing.assert_array_equal(share > 0.5, [False, True, False, False, True])
    assert (share[[0, 2, 3]] < 0.1).all()


def test_one_hit_counts_where_no_ghost_was_ever_seen() -> None:
    assert marker_shares(np.array([(5, 1, 240, 0)]), ShortTrackletRules())[0] > 0.9


@given(seeds, st.integers(0, 12))
@races
def test_where_a_tracklet_goes_over_to_another_marker(seed: int, samples: int) -> None:
    rng = np.random.default_rng(seed)
    scores = rng.normal(-1.0, 4.0, (samples, 3))
    gain, at = kernels.best_split(scores)
    assert np.isclose(gain, twins.best_split(scores))
    if gain > 0:
        both = max(0.0, *scores[:at].sum(axis=0)) + max(0.0, *scores[at:].sum(axis=0))
        assert np.isclose(both - max(0.0, *scores.sum(axis=0)), gain)


@given(seeds)
@settings(races, max_examples=40)
def test_branch_and_bound_finds_the_best_of_all_labellings(seed: int) -> None:
    """Ties and gains of 0 and below among them."""
    rng = np.random.default_rng(seed)
    tracklets, markers = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    first = rng.integers(0, 6, tracklets)
    last = first + rng.integers(0, 6, tracklets)
    gain = np.round(rng.normal(1.0, 3.0, (tracklets, markers)))
    gain[rng.random(gain.shape) < 0.1] = -np.inf
    label = np.empty(tracklets, dtype=np.int64)
    assert kernels.branch_and_bound(gain, first, last, 100_000, label)
    found = sum(gain[j, m] for j, m in enumerate(label) if m >= 0)
    assert found == twins.best_total(gain, first, last)
    for j in range(tracklets):
        assert label[j] < 0 or gain[j, label[j]] > 0
        assert not any(label[i] == label[j] >= 0 and twins.together(first, last, i, j) for i in range(j))


def test_branch_and_bound_says_where_it_gave_up() -> None:
    gain, frames = np.ones((12, 6)), np.zeros(12, dtype=np.int64)
    assert not kernels.branch_and_bound(gain, frames, frames, 20, np.empty(12, dtype=np.int64))


def _tracklets_of_one_body(seed):
    """A rigid body in 24 frames whose tracklets come and go, one of them 3 cm aside: body, xyz, frame, track, label."""
    rng = np.random.default_rng(seed)
    body = rng.normal(0.0, 0.3, (MARKERS, 3))
    label = np.concatenate([np.arange(MARKERS), rng.integers(-1, MARKERS, 6)])
    points, frames, tracks = [], [], []
    for t in range(24):
        taken = set()
        for j in rng.permutation(len(label)):
            if label[j] in taken or rng.random() < 0.4:
                continue
            taken |= {label[j]} - {-1}
            points.append(body[label[j]] + rng.normal(0.0, 0.004, 3) + (0.03 if j == MARKERS else 0.0))
            frames.append(t)
            tracks.append(j)
    return body, np.array(points), np.array(frames), np.array(tracks), label


@given(seeds)
@races
def test_misfits_of_near_rigid_distances(seed: int) -> None:
    _, *scene, label = _tracklets_of_one_body(seed)
    out = np.empty(len(label))
    least_std = np.random.default_rng(seed).choice([0.0, 0.002, 0.01], (MARKERS, MARKERS))
    rigid_deviations(TrackedPoints(*scene, 24), label, least_std, DistanceLimits(0.006, 0.0, 0.02, 5, 3, 8.0), out)
    np.testing.assert_allclose(out, twins.rigid_deviations(*scene, label, least_std, 0.006, 0.02, 5, 3, 8.0))


def test_a_distance_seen_in_one_pose_is_no_steadier_than_the_key_poses_say() -> None:
    """A marker seen twice, 20 mm nearer to its three partners the second time: a ghost if these are rigid, another pose if they are not."""
    partners = np.array([[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3]])
    xyz = np.concatenate([np.concatenate([[np.full(3, 0.0 if t < 20 else 0.012)], partners]) for t in range(30)])
    frame, track = np.repeat(np.arange(30), 4), np.tile(np.arange(4), 30)
    track[frame >= 20] += (track[frame >= 20] == 0) * 4
    label, out = np.array([0, 1, 2, 3, 0]), np.empty(5)
    for least_std, ghost in ((0.0, True), (0.02, False)):
        limits = DistanceLimits(0.004, 0.0, 0.02, 5, 3, 8.0)
        rigid_deviations(TrackedPoints(xyz, frame, track, 30), label, np.full((4, 4), least_std), limits, out)
        assert (out[4] > 1.2) == ghost, f"{out[4]:.2f} standard deviations"


@given(seeds, st.floats(0.8, 1.2))
@races
def test_distances_that_are_not_those_of_the_training(seed: int, larger: float) -> None:
    body, *scene, label = _tracklets_of_one_body(seed)
    apart = np.linalg.norm(body[:, None] - body[None], axis=2) / larger
    low, high = 0.98 * apart, 1.02 * apart
    out = np.empty(len(label))
    usual = training_deviations(TrackedPoints(*scene, 24), label, low, high, DistanceLimits(0.01, 0.06, 0.02, 5, 3, 8.0), out)
    wanted, wanted_usual = twins.training_deviations(*scene, label, 24, low, high, 0.01, 0.06, 0.02, 5, 3, 8.0)
    np.testing.assert_allclose(out, wanted)
    np.testing.assert_allclose(usual, wanted_usual)
