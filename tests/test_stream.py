"""Live points: labels with a fixed delay, against walkers whose truth is known."""

from __future__ import annotations

import gc
import sys
from dataclasses import replace

import numpy as np
import pytest
from models import trained
from scipy.special import logit

import asterism
from asterism.labelling.body._score_kernels import best_pose
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.body.model import BodyRules, factors
from asterism.labelling.body.subject import SubjectRules, adapt_body
from asterism.labelling.live import stream as stream_module
from asterism.labelling.live._evidence_kernels import add_up_evidence, margins_of_frame
from asterism.labelling.live.body import LiveBody, LiveRules
from asterism.labelling.live.stream import FrameLabels, Stream, StreamModel, StreamRules, _assign
from asterism.labelling.live.tracks import TrackEvidence
from asterism.labelling.live.twins import LiveTwins
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Recording
from asterism.simulation import simulate_walks
from asterism.tracking.linking import LinkRules

pytestmark = pytest.mark.kernels


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=6, frames=200, seed=11)


@pytest.fixture(scope="module")
def ensemble(walks: list[Recording]) -> asterism.MarkerModel:
    return trained(walks[:5], miner=None, subjects=list("abcde"))


def run(stream: Stream, clouds: Clouds) -> list[FrameLabels]:
    out = [frame for points in clouds if (frame := stream.push(points)) is not None]
    return out + stream.flush()


def indices(frames: list[FrameLabels]) -> np.ndarray:
    return np.array([frame.indices for frame in frames])


@pytest.mark.parametrize("delay", [0, 1, 20])
def test_labels_come_for_every_frame_with_the_stated_delay(walks, ensemble, delay: int) -> None:
    clouds = walks[5].frames(slice(50)).clouds()
    stream = ensemble.stream(100.0, delay)
    for t, points in enumerate(clouds):
        frame = stream.push(points)
        assert (frame is None) == (t < delay)
        assert frame is None or frame.frame == t - delay
    assert [frame.frame for frame in stream.flush()] == list(range(50 - delay, 50))
    assert stream.flush() == []


@pytest.mark.parametrize(("hidden", "ghosts", "right", "wrong"), [(0, 0, 0.999, 0.0), (3, 0, 0.99, 0.002), (3, 3, 0.96, 0.02)])
def test_someone_unseen_is_labelled_live(walks, ensemble, hidden: int, ghosts: int, right: float, wrong: float) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[5], hidden, ghosts, 2, number_tracks=False)
    shares = []
    for delay in (0, 20):
        got = indices(run(ensemble.stream(100.0, delay), clouds))
        given = got >= 0
        assert (got == truth).mean() >= right, f"delay {delay}: {(got == truth).mean():.4f} right"
        assert (got != truth)[given].mean() <= wrong, f"delay {delay}: {(got != truth)[given].mean():.4f} wrong"
        shares.append((got == truth).mean())
    assert shares[1] >= shares[0] - 0.002


def test_a_stream_says_that_markers_are_placed_elsewhere_and_is_not_certain(walks, ensemble) -> None:
    aside = np.random.default_rng(0).normal(0.0, 0.04, (1, len(walks[5].labels), 3))
    own, other = (
        run(ensemble.stream(100.0), Clouds.from_points(list(positions), 100.0))
        for positions in (walks[5].positions, walks[5].positions + aside)
    )
    assert all(frame.fits for frame in own) and max(frame.confidence.max() for frame in own) >= 0.99
    assert not any(frame.fits for frame in other[20:])
    assert max(frame.confidence.max() for frame in other[20:]) < 0.99


def test_no_point_is_two_markers_and_confidence_is_a_probability(walks, ensemble) -> None:
    clouds, _ = simulate_gaps_and_ghosts(walks[5], 2, 3, 0)
    for frame in run(ensemble.stream(100.0, 5), clouds):
        given = frame.indices[frame.indices >= 0]
        assert len(set(given.tolist())) == len(given)
        assert ((frame.confidence >= 0) & (frame.confidence <= 1)).all()
        assert (frame.confidence[frame.indices >= 0] >= ensemble.least_confidence).all()


def test_the_order_of_points_and_a_second_run_change_nothing(walks, ensemble) -> None:
    rng = np.random.default_rng(0)
    clouds, _ = simulate_gaps_and_ghosts(walks[5].frames(slice(80)), 3, 2, 1)
    one = run(ensemble.stream(100.0, 3), clouds)
    again = run(ensemble.stream(100.0, 3), clouds)
    orders = [rng.permutation(n) for n in clouds.counts]
    shuffled = Clouds.from_points([points[order] for points, order in zip(clouds, orders, strict=True)], rate=100.0)
    for first, second, other, order in zip(one, again, run(ensemble.stream(100.0, 3), shuffled), orders, strict=True):
        np.testing.assert_array_equal(first.indices, second.indices)
        np.testing.assert_array_equal(first.confidence, second.confidence)
        np.testing.assert_array_equal(first.indices, np.where(other.indices >= 0, order[other.indices], -1))
        np.testing.assert_array_equal(first.confidence, other.confidence)


def test_another_vertical_gives_the_same_labels(walks, ensemble) -> None:
    clouds = walks[5].frames(slice(40)).clouds()
    lying = [points[:, [1, 2, 0]] for points in clouds]  # x, y, z become z, x, y: what was z is y
    got = indices(run(ensemble.stream(100.0), clouds))
    other = ensemble.stream(100.0, vertical="y")
    np.testing.assert_array_equal(got, [other.push(points).indices for points in lying])


def test_a_stream_begins_anew_after_everybody_left_and_after_a_flush(walks, ensemble) -> None:
    clouds = walks[5].frames(slice(40)).clouds()
    stream = ensemble.stream(100.0)
    first = indices([stream.push(points) for points in clouds])
    assert (stream.push([]).indices == -1).all()
    assert (stream.push(np.zeros((2, 3))).indices == -1).all()
    backwards = [stream.push(points).indices for points in list(clouds)[::-1]][::-1]
    assert (np.array(backwards)[:-15] == first[:-15]).mean() > 0.99
    stream.flush()
    np.testing.assert_array_equal(indices([stream.push(points) for points in clouds]), first)


def test_labels_join_what_motion_leaves_open() -> None:
    # Three points in a row move on to each other's places, so that nothing tells which goes on where.
    row, step = np.array([[0.0, 0.0, 1.0], [0.03, 0.0, 1.0], [0.06, 0.0, 1.0]]), np.array([0.03, 0.0, 0.0])
    tracks, markers = TrackEvidence(3, LinkRules(), 100.0, 0.9, 0.1), np.arange(3)
    tracks.link(row, [])
    tracks.add(5.0 * np.eye(3))
    begun = tracks.serial[tracks.current].tolist()
    assert (tracks.link(row + step, []) < 0).all()
    tracks.fade()
    tracks.join(np.array([0, 1, -1]), markers)
    assert tracks.serial[tracks.current].tolist()[:2] == begun[:2] and tracks.serial[tracks.current][2] not in begun
    np.testing.assert_allclose(tracks.totals(tracks.current)[0], np.diag([4.5, 4.5, 0.0]))
    assert len(set(tracks.current.tolist())) == 3 and not set(tracks.current.tolist()) & set(tracks._free)
    # They have a velocity from now on.
    assert tracks.link(row + 2 * step, []).tolist()[:2] == [0, 1]
    # What has a velocity, and what lies too far away, is not joined.
    tracks.link(row + 0.5, [])
    serials = tracks.serial[tracks.current].copy()
    tracks.join(markers, markers)
    np.testing.assert_array_equal(tracks.serial[tracks.current], serials)


@pytest.mark.parametrize(
    ("delay", "shown", "followed", "labelled"),
    [(0, range(60), range(40, 80), 0), (10, range(70, 90), range(50, 90), 5)],
    ids=["hidden meanwhile", "back meanwhile"],
)
def test_what_was_seen_beside_a_marker_does_not_get_its_label(walks, ensemble, delay: int, shown, followed, labelled: int) -> None:
    walk, knee = walks[5].frames(slice(90)), walks[5].labels.index("LKNE")
    ghost = walk.positions[:, knee] + [0.05, 0.03, 0.03]
    markers = [[m for m in range(15) if m != knee or t in shown] for t in range(90)]
    points = [np.concatenate([walk.positions[t, markers[t]], ghost[t : t + (t in followed)]]) for t in range(90)]
    got = indices(run(ensemble.stream(100.0, delay), Clouds.from_points(points, 100.0)))[:, knee]
    hidden = [t for t in followed if t not in shown and abs(t - 70) <= 10]
    assert (got[hidden] >= 0).sum() <= labelled, f"{(got[hidden] >= 0).sum()} of {len(hidden)} frames"
    assert all(got[t] == markers[t].index(knee) for t in shown if t < 80)


@pytest.mark.slow
def test_tracks_go_on_behind_lost_frames_as_at_a_lower_rate(walks) -> None:
    whole, half = (TrackEvidence(1, LinkRules(), rate, 1.0, 1.0) for rate in (100.0, 50.0))
    links = 0
    for points in list(walks[5].clouds())[::2]:
        xyz = points[np.argsort(points[:, 0])]
        previous = whole.link(xyz, [])
        whole.lose()
        np.testing.assert_array_equal(previous, half.link(xyz, []))
        links += int((previous >= 0).sum())
    assert links > 0.95 * 99 * len(walks[5].labels)


@pytest.mark.parametrize("lost", [lambda t: t % 2 == 1, lambda t: t % 20 < 4], ids=["every second", "four in twenty"])
def test_lost_frames_cost_no_labels(walks, ensemble, lost) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[5], 2, 1, 2, number_tracks=False)
    stream, right, seen = ensemble.stream(100.0), 0, 0
    for t, points in enumerate(clouds):
        frame = stream.push(np.empty((0, 3)) if t > 20 and lost(t) else points)
        if t > 20 and not lost(t):
            right, seen = right + int((frame.indices == truth[t]).sum()), seen + len(truth[t])
    assert right > 0.975 * seen


def test_labels_are_sure_where_only_they_tell_which_point_goes_on(walks, ensemble) -> None:
    # At 20 frames per second the points of a walk step farther than they are apart: without labels, four of five labels are sure.
    stream = ensemble.stream(20.0)
    found = [stream.push(points) for points in list(walks[5].clouds())[::5]]
    sure = np.mean([labels.confidence > 0.99 for labels in found])
    assert sure > 0.92, sure


def test_memory_does_not_grow_with_time(walks, ensemble) -> None:
    clouds, _ = simulate_gaps_and_ghosts(walks[5], 2, 3, 0)
    stream = ensemble.stream(100.0, 10)

    def walk_on(times: int) -> int:
        for _ in range(times):
            for points in clouds:
                stream.push(points)
        gc.collect()
        return sys.getallocatedblocks()

    # Python and Numba keep some objects of their first calls.
    before, size = walk_on(2), len(stream._tracks)
    grown = walk_on(5) - before
    assert len(stream._tracks) <= 2 * size
    assert grown < 500, f"{grown} objects more after 1,000 frames more"


def test_bad_input_is_named_and_the_stream_goes_on(walks, ensemble) -> None:
    for rate in (0, -1.0, np.nan, np.inf):
        with pytest.raises(asterism.AsterismError, match="frame rate"):
            ensemble.stream(rate)
    for delay in (-1, 0.5, True):
        with pytest.raises(asterism.AsterismError, match="delay"):
            ensemble.stream(100.0, delay)
    with pytest.raises(asterism.AsterismError, match="vertical"):
        ensemble.stream(100.0, vertical="up")
    clouds = walks[5].frames(slice(20)).clouds()
    stream, calm = ensemble.stream(100.0), ensemble.stream(100.0)
    for points in clouds:
        with pytest.raises(asterism.AsterismError, match=r"frame .*shape"):
            stream.push(points.T)
        with pytest.raises(asterism.AsterismError, match="NaN or infinite"):
            stream.push(np.full((3, 3), np.nan))
        np.testing.assert_array_equal(stream.push(points).indices, calm.push(points).indices)


def test_a_poor_labelling_is_held_against_its_twins_part_by_part(walks, ensemble) -> None:
    """All twins come near labels of which half are missing: some in each frame, in the end as far ahead as of all at once."""
    labeller, points = ensemble.body_labeller, np.ascontiguousarray(walks[5].positions[50])
    point_of = np.where(np.arange(len(points)) % 2, -1, np.arange(len(points)))
    whole, parts = LiveTwins(labeller, 10**6), LiveTwins(labeller, 2)
    better, found, pushes = whole.compare(points, point_of), [], 0
    while parts.lead is None:
        assert (parts.limits(len(points)) < 0.99).all(), "sure before all were looked at"
        found.append(parts.compare(points, point_of))
        pushes += 1
        assert pushes < 50
    assert pushes > 1
    np.testing.assert_array_equal(parts.lead, whole.lead)
    assert better is not None, "nothing explains the frame better than half of its labels"
    assert any(np.array_equal(better, one) for one in found if one is not None)
    # labels that explain more begin anew
    parts.compare(points, point_of)
    parts.compare(points, np.arange(len(points)))
    assert parts._begun_with == len(points)


def test_a_first_comparison_that_said_little_does_not_outweigh_all_later_ones(walks, ensemble) -> None:
    """Markers that are hidden from the second frame on leave less to compare, and take nothing back; what they say more counts."""
    labeller, points = ensemble.body_labeller, np.ascontiguousarray(walks[5].positions[50])
    twins = LiveTwins(labeller, 10**6)
    twins.compare(points, np.arange(len(points)))
    said = twins.lead.copy()
    twins._labelled = len(points) + 1
    twins.lead = np.zeros(len(points))
    for _ in range(8):
        twins.compare(points, np.arange(len(points)))
    assert (twins.lead[np.isfinite(said)] > 0.9 * said[np.isfinite(said)]).all()
    twins.lead = 10.0 * said
    twins.compare(points, np.arange(len(points)))
    assert (twins.lead >= 10.0 * said).all()


def test_three_markers_that_stay_in_view_stay_as_certain(walks, ensemble) -> None:
    """Three labels are enough for the body to confirm them: the evidence of the frames with all markers fades."""
    stream = ensemble.stream(100.0, 0)
    frames = [stream.push(points if t < 60 else points[:3]) for t, points in enumerate(walks[5].positions)]
    assert all(frame.indices[:3].tolist() == [0, 1, 2] for frame in frames[60:])
    assert frames[-1].confidence[:3].min() >= frames[60].confidence[:3].min()


def test_coincident_points_and_ghosts_alone_are_nobody(ensemble) -> None:
    stream = ensemble.stream(100.0, 2)
    rng = np.random.default_rng(0)
    for _ in range(20):
        stream.push(np.zeros((40, 3)))
    for _ in range(20):
        frame = stream.push(rng.normal(size=(150, 3)) * 3)
        assert frame is not None
    frames = [stream.push(rng.normal(size=(10, 3)) * 3) for _ in range(20)]
    assert np.mean([frame.indices >= 0 for frame in frames[5:]]) < 0.05


def test_who_comes_after_somebody_else_is_labelled_too(walks, ensemble) -> None:
    """One walks off and another one, of another size, is there in the next frame."""
    stream = ensemble.stream(100.0)
    first, second = walks[5], max(walks[:5], key=lambda walk: abs(walk.positions[..., 2].max() - walks[5].positions[..., 2].max()))
    moved = second.positions + np.array([1.5, 0.5, 0.0])
    got = indices([stream.push(points) for points in np.concatenate([first.positions, moved])])
    right = (got == np.arange(15)).mean(axis=1)
    assert right[:200].mean() > 0.99
    assert right[240:].mean() > 0.99, f"{right[240:].mean():.3f} right after 0.4 s"
    assert ((got[200:] >= 0) & (got[200:] != np.arange(15))).mean() < 0.01


def test_the_body_that_a_stream_learns_is_the_one_that_is_there(walks, ensemble) -> None:
    walk, model = walks[5].positions, ensemble.state.body
    live = LiveBody(model, BodyRules(), 100.0, LiveRules(adapt_after=(3, 6)))
    settings, found, steps = ensemble.body_labeller.settings, [], 0
    rng = np.random.default_rng(0)

    def look(body, t: int) -> tuple[int, float]:
        workspace = make_body_workspace(15, *model.load.shape[1::2])
        return best_pose(body, np.ascontiguousarray(walk[t]), np.arange(15), settings, workspace)

    for t in range(0, 160, 2):
        if live.needs(t):
            shown = np.where(rng.random((15, 1)) < 0.2, np.nan, walk[t])
            live.add(t, shown, look(model.arrays(), t)[0])
        steps += live._steps is not None
        if (body := live.step()) is not None:
            found.append(body)
    assert len(found) == 2
    assert steps > 10  # the work came in small pieces
    assert not live.needs(1000)

    def score(body) -> float:
        return sum(look(body, t)[1] for t in range(165, 200, 5))

    assert score(found[0]) > score(model.arrays()) + 5.0
    assert score(found[1]) > score(found[0])
    live.restart()
    assert live.needs(0)


def test_a_body_learned_from_a_few_frames_of_whatever_markers_is_a_body(ensemble, walks) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        frames = walks[5].positions[rng.integers(0, 200, 6)] + rng.normal(scale=0.002, size=(6, 15, 3))
        frames[rng.random((6, 15)) < rng.uniform(0.0, 0.6)] = np.nan
        poses = rng.integers(0, len(ensemble.state.body.mean), 6)
        body = adapt_body(ensemble.state.body, frames, poses, np.ones(6), SubjectRules(), BodyRules())
        assert body.between is not None
        assert min(np.linalg.eigvalsh(between).min() for between in body.between) > -1e-9
        body.arrays()  # refuses what is no covariance


def test_near_factors_leave_over_hardly_more(ensemble) -> None:
    body = ensemble.state.body
    covariance = body.within[0] + body.between[0]
    left = []
    for near in (False, True):
        load, noise = factors(body.mean[0], covariance, BodyRules(), near=near)
        main = load[:, :, :-4].reshape(len(covariance), -1)
        rest = covariance - main @ main.T
        np.testing.assert_allclose(noise[3], rest[9:12, 9:12])
        left.append(np.trace(rest))
    assert 0 < left[0] <= left[1] < 1.1 * left[0]


def test_margins_are_those_of_all_labellings_of_a_small_frame() -> None:
    """Against every labelling that moves one marker, or exchanges two."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        scores = rng.normal(scale=4.0, size=(4, 3))
        rows = _assign(scores)
        margins = np.empty(3)
        margins_of_frame(scores, scores, np.ones(4, dtype=np.bool_), rows, margins)

        def value(labels, scores=scores):
            return sum(scores[c, m] for m, c in enumerate(labels) if c >= 0)

        for m in np.nonzero(rows >= 0)[0]:
            best = -np.inf
            for c in [-1, *range(4)]:
                if c == rows[m]:
                    continue
                other = rows.copy()
                other[m] = c
                holder = np.nonzero((rows == c) & (c >= 0))[0]
                if len(holder):
                    for instead in (-1, rows[m]):
                        other[holder[0]] = instead
                        best = max(best, value(other))
                else:
                    best = max(best, value(other))
            # a hidden marker may take the point, too
            for hidden in np.nonzero(rows < 0)[0]:
                other = rows.copy()
                other[hidden], other[m] = rows[m], -1
                best = max(best, value(other))
            for k in np.nonzero(rows >= 0)[0]:
                other = rows.copy()
                if k != m:
                    other[k], other[m] = rows[m], -1
                    best = max(best, value(other))
                    other[m] = rows[k]
                    best = max(best, value(other))
            takes_free = margins[m] - (value(rows) - best)
            assert takes_free >= -1e-9
            assert margins[m] <= scores[rows[m], m] + 1e-9


def _plain_margins(scores, limited, point_of):
    """What `margins_of_frame` gives where all points count."""
    free = np.ones(len(scores), dtype=np.bool_)
    free[point_of[point_of >= 0]] = False
    best_free = limited[free].max(axis=0, initial=-np.inf)
    margins = np.minimum(best_free, 0.0)
    given = np.nonzero(point_of >= 0)[0]
    here = limited[point_of[given], given]
    margins[given] = np.minimum(here, here - np.maximum(best_free[given], 0.0))
    held, takes = scores[point_of[given], given], scores[point_of[given]]
    cost = held[:, None] - takes
    cost[:, given] += held[None, :] - np.maximum(takes[:, given].T, 0.0)
    cost[np.arange(len(given)), given] = np.inf
    margins[given] = np.minimum(margins[given], cost.min(axis=1, initial=np.inf))
    return margins


@pytest.mark.parametrize(("points", "markers"), [(0, 3), (1, 1), (4, 7), (9, 5)])
def test_margins_of_a_frame_are_those_of_the_plain_twin_without_the_points_that_do_not_count(points, markers) -> None:
    rng = np.random.default_rng(points)
    for _ in range(20):
        scores, limited = rng.normal(scale=4.0, size=(2, points, markers))
        point_of = _assign(scores)
        counts = rng.random(points) < 0.7
        counts[point_of[point_of >= 0]] = True
        margins, number = np.empty(markers), np.cumsum(counts) - 1
        margins_of_frame(scores, limited, counts, point_of, margins)
        among = np.where(point_of >= 0, number[point_of] if points else -1, -1)
        np.testing.assert_array_equal(margins, _plain_margins(scores[counts], limited[counts], among))


def test_points_are_given_to_markers_best_score_first() -> None:
    rng = np.random.default_rng(0)
    for shape in ((0, 2), (3, 3), (8, 5), (5, 8)):
        scores = rng.normal(scale=4.0, size=shape)
        expected, left = np.full(shape[1], -1), scores.copy()
        while left.size and left.max() > 0.0:
            point, marker = np.unravel_index(left.argmax(), shape)
            expected[marker] = point
            left[point], left[:, marker] = -np.inf, -np.inf
        np.testing.assert_array_equal(_assign(scores), expected)


def test_evidence_adds_up_as_much_as_so_many_independent_frames_say() -> None:
    rng = np.random.default_rng(0)
    evidence, prior, excluded = table = tuple(rng.normal(size=(3, 6, 4)))
    frames, rows = np.array([0.0, 0.5, 1.0, 3.0, 30.0, 7.0]), np.array([4, 0, 3, 1])
    totals, limited = np.empty((4, 4)), np.empty((4, 4))
    add_up_evidence(table, frames, rows, 0.1, 2.5, totals, limited)
    for most, found in ((np.inf, totals), (2.5, limited)):
        share = np.minimum(1.0 + 0.1 * np.maximum(frames - 1.0, 0.0), most) / np.maximum(frames, 1.0)
        np.testing.assert_array_equal(found, (evidence * share[:, None] + prior - excluded)[rows])


def test_a_lost_frame_is_told_without_labels_and_costs_little(walks, ensemble) -> None:
    stream = ensemble.stream(100.0)
    for points in list(walks[1].clouds())[:30]:
        stream.push(points)
    weighed = []
    stream._chances = lambda *of: weighed.append(of)  # Frames are lost where the chain is too slow: nothing must be weighed then.
    lost = stream.push(np.empty((0, 3)))
    assert not weighed and lost.frame == 30 and (lost.indices == -1).all() and not lost.confidence.any()


def _stream(model, rules: StreamRules, **changes) -> Stream:
    """A stream of the model at 100 Hz, with a frame's search changed."""
    state, labeller = model.state, model.body_labeller
    labeller = replace(labeller, settings=labeller.settings._replace(**changes))
    known = StreamModel(labeller, state.markers, len(model.marker_set), state.calibrations, model.least_confidence, state.body_rules)
    return Stream(known, 100.0, rules=rules)


def test_tracks_of_the_first_frame_are_surer_than_those_that_begin_later(walks, ensemble) -> None:
    clouds = [np.array(points) for points in walks[5].frames(slice(30)).clouds()]

    def gain(begins: int, last: int) -> float:
        """Log odds that a marker gains in the last of so many frames, which is seen from one of them on."""
        found = []
        for rules in (StreamRules(first_gain=0.0), StreamRules()):
            stream = _stream(ensemble, rules)
            pushed = [
                stream.push(np.delete(points, 9, axis=0) if number < begins else points) for number, points in enumerate(clouds[:last])
            ]
            found.append(logit(pushed[-1].confidence[9]))
        return float(found[1] - found[0])

    assert gain(0, 6) == pytest.approx(StreamRules().first_gain)
    # One that begins later gains nothing, nor does any one after the beginning.
    assert gain(3, 6) == gain(0, 30) == 0.0


@pytest.mark.parametrize(("budget", "first"), [(120, 3), (250, 1)])
def test_a_body_that_a_frames_search_does_not_reach_is_sought_longer(walks, ensemble, budget, first) -> None:
    """It takes 300 to 400 evaluations: the second search may make twice, the fourth four times as many as the first."""
    clouds = list(walks[5].clouds())[:6]
    for most, found in ((1, len(clouds)), (StreamRules().most_effort, first)):
        stream = _stream(ensemble, StreamRules(most_effort=most), max_evaluations=budget)
        given = [int((stream.push(points).indices >= 0).sum()) for points in clouds]
        assert given == [0] * found + [15] * (len(clouds) - found)


def test_what_many_searches_do_not_explain_is_sought_more_seldom(walks, ensemble, monkeypatch) -> None:
    searches = list[int]()
    search = stream_module.find_labellings
    monkeypatch.setattr(stream_module, "find_labellings", lambda *given: searches.append(1) or search(*given))
    stream, counts = ensemble.stream(100.0), []
    for points in np.tile(walks[5].positions[:100], (2, 1, 1)):
        searches.clear()
        stream.push(np.concatenate([points[3:], [[9.0, 0.0, 1.0], [9.0, 1.0, 1.0], [9.0, 2.0, 1.0]]]))
        counts.append(len(searches))
    assert 1 <= sum(counts[50:100]) <= 4 and 1 <= sum(counts[120:]) <= 4, counts
