"""Foreign recordings: the body is not turned round, doubtful labels are less certain, and the evidence is what it claims to be."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from models import trained

import asterism
from asterism.labelling.recording_labeller import RecordingLabeller
from asterism.labelling.whole.foreign import (
    ForeignConfidence,
    Samples,
    _placed_on,
    _scores,
    _starts,
    distance_gains,
    distance_margins,
    forward_share,
    hidden_margins,
)
from asterism.labelling.whole.relabel import LabelledTracklets
from asterism.labelling.whole.scene import prepare_scene
from asterism.labelling.whole.settings import ForeignRules, RecordingLabellingSettings
from asterism.labelling.whole.verdict import RigidDistances, VerdictRules
from asterism.recording import Recording
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from asterism.tracking.linking import find_tracklets

RULES = ForeignRules()
SIDES = [(0, 1)]


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=3, frames=120, seed=4)


def tracklets_of(trained: asterism.MarkerModel, recording: Recording) -> LabelledTracklets:
    """A recording labelled, with what labelling it again begins with."""
    tracklets = RecordingLabeller(trained).label_bodies(recording.clouds(), keep_tracklets=True).tracklets
    assert tracklets is not None
    return tracklets


@pytest.fixture(scope="module")
def one(walks: list[Recording]) -> asterism.MarkerModel:
    """A model of one person."""
    return trained(walks[:1], miner=None)


def hips(direction: tuple[float, float]) -> np.ndarray:
    """A left and a right hip that face along y and travel 1 m in a second: (11, 2, 3)."""
    way = np.linspace(0.0, 1.0, 11)[:, None] * np.array([*direction, 0.0])
    return way[:, None] + np.array([[-0.1, 0.0, 1.0], [0.1, 0.0, 1.0]])


@pytest.mark.parametrize(("turn", "size"), [(0.0, 1.0), (2.0, 1.1), (-1.2, 0.8)])
def test_a_body_is_placed_on_its_points(turn: float, size: float) -> None:
    """Four of six markers have points: the body turned about the vertical, scaled and moved there comes to lie on them."""
    body = np.random.default_rng(3).normal(0.0, 0.3, (6, 3))
    c, s = np.cos(turn), np.sin(turn)
    there = size * body @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + [1.0, -2.0, 0.9]
    assert _placed_on(body, body[:4], there[:4]) == pytest.approx(there)


@pytest.mark.parametrize(
    ("direction", "share"),
    [((0.0, 1.0), 1.0), ((0.0, -1.0), -1.0), ((1.0, 0.0), 0.0), ((0.0, 0.1), 0.0)],
    ids=["forward", "back", "aside", "slow"],
)
def test_a_body_travels_forward(direction: tuple[float, float], share: float) -> None:
    assert forward_share(hips(direction), np.linspace(0.0, 1.0, 11), SIDES, RULES.min_speed) == pytest.approx(share, abs=1e-9)


def test_exchanged_sides_travel_backwards() -> None:
    assert forward_share(hips((0.0, 1.0))[:, ::-1], np.linspace(0.0, 1.0, 11), SIDES, RULES.min_speed) == pytest.approx(-1.0)


BODY = np.random.default_rng(3).normal(0.0, 0.2, (12, 3))


def in_all_frames(points: np.ndarray) -> Samples:
    """Twenty frames in which the same points (n, 3) lie, each a tracklet."""
    n = len(points)
    return Samples(np.repeat(np.arange(20), n), np.tile(np.arange(n), 20), np.tile(points, (20, 1)), 20, n)


def test_distances_favour_the_right_labels() -> None:
    """Twelve rigid points: the right label of each leads, and two exchanged ones do not."""
    reference = RigidDistances.of_training(np.tile(BODY, (20, 1, 1)), np.zeros(20, dtype=np.int64), 1.0, VerdictRules())
    samples, first, last = in_all_frames(1.1 * BODY), np.zeros(12, dtype=np.int64), np.full(12, 19)
    right = np.arange(12)
    gain = distance_gains(right, samples, 12, reference, RULES)
    assert (gain.argmax(axis=1) == right).all()
    assert distance_margins(gain, right, first, last).min() > 0.0
    exchanged = right.copy()
    exchanged[[2, 7]] = 7, 2
    lead = distance_margins(distance_gains(exchanged, samples, 12, reference, RULES), exchanged, first, last)
    assert lead[2] < 0.0 and lead[7] < 0.0


def test_a_label_of_a_foreign_recording_is_the_more_certain_the_more_speaks_for_it() -> None:
    evidence = ForeignConfidence(np.array([2.0, 2.0, 2.0, 4.0]), np.ones(4), False, RULES)
    given = evidence.by_evidence(np.array([0.9, 0.999, 0.999, 0.999]), np.array([0.0, 0.0, 2.0, 2.0]))
    assert (np.diff(given) > 0.0).all()
    assert replace(evidence, crowded=True).least_confidence > evidence.least_confidence


def test_the_evidence_of_tracklets_is_that_of_their_points() -> None:
    of_tracks = ForeignConfidence(np.array([1.0, 3.0]), np.array([0.5, 1.0]), False, RULES)
    of_points = of_tracks.of_points(5, np.array([0, 2, 4]), np.array([1, 0, 1]))
    np.testing.assert_array_equal(of_points.log_odds, [3.0, 2.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(of_points.limit, [1.0, 1.0, 0.5, 1.0, 1.0])


def test_tracklets_of_other_times_are_no_rivals() -> None:
    gain = np.array([[1.0, 0.0], [5.0, 0.0]])
    label, first = np.array([0, -1]), np.array([0, 10])
    assert distance_margins(gain, label, first, np.array([9, 19]))[0] == 60.0
    assert distance_margins(gain, label, first, np.array([10, 19]))[0] == -4.0


def test_a_label_leads_by_what_the_best_exchange_would_lose() -> None:
    """Exchanged, the first two tracklets gain 5 + 0 instead of 1 + 3; the third has no label, and would gain 0.5 as the first one's."""
    gain, first, last = np.array([[1.0, 0.0], [5.0, 3.0], [0.5, 0.0]]), np.array([0, 0, 5]), np.array([9, 9, 9])
    np.testing.assert_array_equal(distance_margins(gain, np.array([0, 1, -1]), first, last), [-1.0, -1.0, 0.0])
    np.testing.assert_array_equal(distance_margins(gain, np.array([0, -1, -1]), first, last), [-4.0, 0.0, 0.0])


@pytest.mark.parametrize("shown", [slice(0, 6), slice(2, 8)], ids=["without its top", "without its feet"])
def test_a_body_is_laid_onto_points_by_its_lowest_and_by_its_highest_marker(shown: slice) -> None:
    """A pole of eight markers, 0.2 m apart, two of which have no point at one end: by the other end every point gets its marker."""
    aside = np.random.default_rng(2).normal(0.0, 0.02, (8, 2))
    pole = np.column_stack([aside, 0.2 * np.arange(8.0)])
    starts = _starts(pole[None], in_all_frames(pole[shown] + np.array([2.0, -1.0, 0.5])), RULES)
    assert np.arange(8)[shown].tolist() in [start.tolist() for start in starts]


@pytest.mark.parametrize("crowded", [False, True])
def test_of_two_labellings_that_explain_a_recording_alike_the_labels_so_far_are_ahead(
    one: asterism.MarkerModel, walks: list[Recording], crowded: bool
) -> None:
    found = tracklets_of(one, walks[2]).long.found
    reference = RigidDistances.of_training(walks[0].positions, np.zeros(120, dtype=np.int64), 1.0, VerdictRules())
    scores = _scores(one.body_labeller, [found, found, found], Samples.of_scene(found.scene), walks[0].labels, reference, crowded, RULES)
    np.testing.assert_allclose(scores - scores[1], [(RULES.prior_crowded if crowded else RULES.prior), 0.0, 0.0], atol=1e-9)


def test_only_markers_hidden_for_most_of_the_time_are_rivals_without_a_point() -> None:
    """Marker 2 has no point; marker 1 is held by the second tracklet, of which the first one sees 4 or 5 of its 10 frames."""
    gain, label = np.array([[3.0, 2.5, 1.0], [0.0, 9.0, 0.0]]), np.array([0, 1])
    first, last = np.array([0, 5]), np.array([9, 19])
    np.testing.assert_array_equal(hidden_margins(gain, label, first, last), [2.0, 9.0])
    np.testing.assert_array_equal(hidden_margins(gain, label, np.array([0, 6]), last), [0.5, 9.0])
    np.testing.assert_array_equal(hidden_margins(gain, np.array([0, -1]), first, last), [0.5, np.inf])


def test_a_marker_beside_a_hidden_one_is_less_certain() -> None:
    """Of two markers 2 cm apart one is hidden: distances do not tell which. One far from all others stays certain."""
    body = np.concatenate([BODY, BODY[:1] + np.array([0.02, 0.0, 0.0])])
    reference = RigidDistances.of_training(np.tile(body, (20, 1, 1)), np.zeros(20, dtype=np.int64), 1.0, VerdictRules())
    samples, first, last = in_all_frames(1.1 * body[:12]), np.zeros(12, dtype=np.int64), np.full(12, 19)
    over = hidden_margins(distance_gains(np.arange(12), samples, 13, reference, RULES), np.arange(12), first, last)
    assert over[0] < RULES.hidden_margin < over[1:].min()


def test_a_person_worn_otherwise_is_labelled_right_and_not_certain(one: asterism.MarkerModel, walks: list[Recording]) -> None:
    aside = np.random.default_rng(1).normal(0.0, 0.025, (1, 15, 3))
    clouds = replace(walks[2], positions=walks[2].positions + aside).clouds()
    labelling = one.label(clouds)
    assert labelling.verdict is not None and not labelling.verdict.fits
    given = labelling.indices >= 0
    assert (labelling.indices == np.arange(15))[given].mean() > 0.995
    assert given.mean() > 0.5
    assert labelling.confidence.max() < 0.99


def test_only_a_recording_of_another_body_is_labelled_again(one: asterism.MarkerModel, walks: list[Recording]) -> None:
    aside = np.random.default_rng(1).normal(0.0, 0.025, (1, 15, 3))
    for recording, foreign in ((walks[0], False), (replace(walks[2], positions=walks[2].positions + aside), True)):
        again = tracklets_of(one, recording).long.foreign
        assert (again is not None) == foreign


def test_the_order_of_the_points_plays_no_part(one: asterism.MarkerModel, walks: list[Recording]) -> None:
    aside = np.random.default_rng(1).normal(0.0, 0.025, (1, 15, 3))
    recording = replace(walks[2], positions=walks[2].positions + aside)
    turned = recording.select(recording.labels[::-1])
    there, back = one.label(recording.clouds()), one.label(turned.clouds())
    np.testing.assert_array_equal(np.where(back.indices >= 0, 14 - back.indices, -1), there.indices)
    np.testing.assert_allclose(back.confidence, there.confidence)


def test_points_left_over_cost_a_person_of_the_training_no_label(one: asterism.MarkerModel, walks: list[Recording]) -> None:
    """A third as many points as markers ride along that have no name; the distances are those of the training."""
    own = walks[0]
    more = own.positions[:, ::3] + np.random.default_rng(5).normal(0.0, 0.03, (1, 5, 3))
    names = (*own.labels, *(f"*{number}" for number in range(5)))
    labelling = one.label(replace(own, positions=np.concatenate([own.positions, more], axis=1), labels=names).clouds())
    assert labelling.verdict is not None and labelling.verdict.surplus == 5.0
    assert (labelling.indices == np.arange(15)).mean() > 0.99


def test_memory_grows_with_the_points_and_not_with_frames_times_tracklets(walks: list[Recording]) -> None:
    there_and_back = np.concatenate([walks[0].positions, walks[0].positions[::-1]])
    clouds, _ = simulate_gaps_and_ghosts(replace(walks[0], positions=np.tile(there_and_back, (20, 1, 1))), 3, 0, seed=1)
    scene = prepare_scene(clouds, find_tracklets(clouds), RecordingLabellingSettings())
    tracemalloc.start()
    Samples.of_scene(scene).positions(np.zeros(len(scene.first), dtype=np.int64), 15)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200 * len(scene.sampled_xyz) < 16 * len(scene.sampled_frames) * len(scene.first)
