"""Labelling again with a person's labels held: they win, nothing said changes nothing, and the result is that of the slow way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from correcting import model, recorded, truth_of_points, walks
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.correction.pieces import cut_before
from asterism.labelling.review import labels_of_points
from asterism.labelling.whole import point_labels
from asterism.labelling.whole.label import label_all_points
from asterism.labelling.whole.point_labels import PointLabels, labelling_of
from asterism.labelling.whole.relabel import FREE, LabelledTracklets, label_tracklets, marker_chances, relabel_tracklets
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.verdict import confidence_limit
from asterism.recording import Clouds, Ints, Labelling
from asterism.recording.verdict import OTHER_BODY, Verdict
from asterism.tracking.linking import Tracklets


def labelled(clouds: Clouds) -> LabelledTracklets:
    return label_tracklets(model().in_recording(), clouds, RecordingLabellingSettings(), SubjectRules(), model().state.body_rules)


@pytest.fixture(scope="module")
def walk() -> tuple[LabelledTracklets, Ints]:
    """A walk with gaps and ghosts, labelled; and the true marker of each point."""
    recording, marker_of_column = recorded(walks()[4])
    clouds = recording.clouds()
    return labelled(clouds), truth_of_points(clouds, marker_of_column)


def nothing_known(tracklets: Tracklets) -> Ints:
    return np.full(len(tracklets), FREE, dtype=np.int64)


def marker_of_points(labelling: Labelling, clouds: Clouds) -> Ints:
    return labels_of_points(labelling, clouds)[0]


def same(one: Labelling, other: Labelling) -> bool:
    return (
        np.array_equal(one.indices, other.indices)
        and np.array_equal(one.confidence, other.confidence)
        and np.array_equal(one.candidates, other.candidates)
    )


def longest(tracklets: Tracklets) -> int:
    return int(np.argmax(tracklets.last - tracklets.first))


def test_the_first_labelling_is_that_of_label(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, _ = walk
    assert same(before.labelling, model().label(before.clouds))


def test_nothing_known_gives_back_the_first_labelling(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, _ = walk
    assert same(relabel_tracklets(before, before.long.tracklets, nothing_known(before.long.tracklets)), before.labelling)


def labelled_plainly(before: LabelledTracklets, points: PointLabels, verdict: Verdict | None) -> Labelling:
    """The labelling of `points`, point by point: each marker's most certain candidate in each frame, of equal ones the last in space."""
    body, clouds = before.body, before.clouds
    certainty, least = points.confidence(body.certainty, body.frame_certainty)
    certainty = np.minimum(certainty, confidence_limit(verdict))
    least = np.full_like(least, np.inf) if verdict is not None and verdict.kind == OTHER_BODY else least
    shape = (len(clouds), len(body.names))
    indices, candidates, confidence = np.full(shape, -1), np.full(shape, -1), np.zeros(shape)
    for t, (begin, end) in enumerate(pairwise(clouds.offsets)):
        found: dict[int, list[tuple[float, tuple[float, ...], int]]] = {}
        for p in range(begin, end):
            column = points.label[p] if points.label[p] >= 0 else points.rival[p]
            if column < 0:
                continue
            marker = body.markers[column]
            chance = certainty[p] if points.label[p] >= 0 else 0.5 * np.exp(min(points.margin[p], 0.0))
            found.setdefault(marker, []).append((chance, tuple(clouds.xyz[p, ::-1]), p - begin))
            if points.label[p] >= 0 and certainty[p] >= least[p]:
                indices[t, marker], confidence[t, marker] = p - begin, certainty[p]
        for marker, some in found.items():
            if indices[t, marker] < 0:
                confidence[t, marker], _, candidates[t, marker] = max(some)
    return Labelling(indices, confidence, body.names, candidates)


def test_the_labelling_is_the_one_by_points(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, _ = walk
    assert same(before.labelling, labelled_plainly(before, before.points, before.labelling.verdict))


def test_the_verdict_on_a_few_frames_is_that_of_their_points() -> None:
    """Four frames, too few to see which distances are rigid: the training's are taken, of all points that have a label."""
    before = labelled(recorded(walks()[4], hidden=1, ghosts=0)[0].frames(slice(0, 4)).clouds())
    verdict = before.labelling.verdict
    assert verdict is not None
    assert verdict.labelled == 1.0 and np.isfinite(verdict.scatter)


@cache
def another_walk() -> LabelledTracklets:
    recording, _ = recorded(walks()[4], ghosts=3)
    return labelled(recording.clouds())


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.sampled_from([3, 2000]))
def test_the_labelling_is_the_one_by_points_for_any_margins(seed: int, at_once: int) -> None:
    """Also where several points are the best candidate of one marker, and a candidate beats a label that is taken back."""
    before = another_walk()
    rng, track = np.random.default_rng(seed), before.points.track
    of_track = np.where(track >= 0, track, track.max() + 1 + np.arange(len(track)))
    margin = rng.choice([-3.0, -0.5, 0.0, 0.4, 9.0], of_track.max() + 1)[of_track]
    lost = rng.random(of_track.max() + 1)[of_track] < 0.3
    label = np.where(lost, -1, before.points.label)
    rival = np.where(rng.random(of_track.max() + 1) < 0.8, rng.integers(0, 15, of_track.max() + 1), -1)[of_track]
    points = replace(before.points, label=label, rival=rival, margin=np.where(label < 0, np.minimum(margin, 0.0), margin))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(point_labels, "FRAMES_AT_ONCE", at_once)
        found = labelling_of(before.body, 0, before.clouds, points, np.array([0, len(before.body.markers)]), before.settings)
    assert same(found, labelled_plainly(before, points, found.verdict))


def test_what_is_known_wins_and_has_confidence_one(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, _ = walk
    tracklets, fixed = before.long.tracklets, nothing_known(before.long.tracklets)
    piece = longest(tracklets)
    points = np.nonzero(tracklets.of_point == piece)[0]
    wrong = (marker_of_points(before.labelling, before.clouds)[points[0]] + 1) % 15
    fixed[piece] = wrong
    found = relabel_tracklets(before, tracklets, fixed)
    marker, confidence = labels_of_points(found, before.clouds)
    assert (marker[points] == wrong).all() and (confidence[points] == 1.0).all()
    others = np.setdiff1d(np.nonzero(marker == wrong)[0], points)
    assert not np.isin(before.clouds.frame_of[others], before.clouds.frame_of[points]).any()
    assert not same(found, before.labelling)


def test_a_ghost_stays_without_a_label(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, truth = walk
    tracklets, fixed = before.long.tracklets, nothing_known(before.long.tracklets)
    fixed[longest(tracklets)] = -1
    points = tracklets.of_point == longest(tracklets)
    assert (truth[points] >= 0).all(), "the longest piece is a marker, which the model labels unless it is told otherwise"
    found = relabel_tracklets(before, tracklets, fixed)
    assert (marker_of_points(before.labelling, before.clouds)[points] >= 0).all()
    assert (marker_of_points(found, before.clouds)[points] == -1).all()


def test_saying_what_is_right_changes_no_label(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, _ = walk
    tracklets, fixed = before.long.tracklets, nothing_known(before.long.tracklets)
    marker = marker_of_points(before.labelling, before.clouds)
    for piece in range(len(tracklets)):
        of_piece = marker[tracklets.of_point == piece]
        if (of_piece == of_piece[0]).all() and of_piece[0] >= 0:
            fixed[piece] = of_piece[0]
    found = relabel_tracklets(before, tracklets, fixed)
    kept = marker >= 0
    assert np.array_equal(marker_of_points(found, before.clouds)[kept], marker[kept])


def test_what_is_said_of_one_piece_leaves_doubt_about_the_places_of_others() -> None:
    """Ghosts lie where markers are hidden: pieces whose distances are off are less certain, and stay so when another piece is confirmed."""
    before = labelled(recorded(walks()[4], hidden=3, ghosts=3, seed=2)[0].clouds())
    assert (before.penalty > 1.0).any()
    marker, confidence = labels_of_points(before.labelling, before.clouds)
    points = np.nonzero((before.long.tracklets.of_point == 3) & (marker >= 0))[0]
    assert len(points) > 40
    fixed = nothing_known(before.long.tracklets)
    fixed[3] = marker[points[0]]
    after = labels_of_points(relabel_tracklets(before, before.long.tracklets, fixed), before.clouds)[1]
    others = before.long.tracklets.of_point != 3
    np.testing.assert_allclose(after[others], confidence[others], atol=1e-6)


def test_the_order_of_the_points_does_not_matter(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, _ = walk
    clouds = before.clouds
    order = np.lexsort((np.random.default_rng(0).random(len(clouds.xyz)), clouds.frame_of))
    shuffled = labelled(replace(clouds, xyz=clouds.xyz[order], columns=clouds.columns[order], tracks=clouds.tracks[order]))  # type: ignore[index]
    results = []
    for one, back in ((before, np.arange(len(order))), (shuffled, np.argsort(order))):
        fixed = nothing_known(one.long.tracklets)
        fixed[one.long.tracklets.of_point[back[0]]] = 7
        results.append(labels_of_points(relabel_tracklets(one, one.long.tracklets, fixed), one.clouds))
    (marker, confidence), (other, other_confidence) = results
    assert np.array_equal(marker[order], other)
    np.testing.assert_allclose(confidence[order], other_confidence, atol=1e-12)


def test_cutting_a_swapped_track_mends_both_halves() -> None:
    """Two tracks exchange their markers in the middle, at a moment when the camera system lost both for a frame."""
    recording, marker = recorded(walks()[4], hidden=0, ghosts=0)
    positions = recording.positions.copy()
    one, other = (int(np.nonzero(marker == recording_marker)[0][0]) for recording_marker in (5, 6))  # the knees
    positions[60:, [one, other]] = positions[60:, [other, one]]
    clouds = replace(recording, positions=positions).clouds()
    before = labelled(clouds)
    whole = replace(before.long.tracklets, of_point=clouds.columns, first=np.zeros(15, dtype=np.int64), last=np.full(15, 119))
    swapped = label_of_whole_tracks(before, whole)
    right = np.where((clouds.frame_of >= 60) & np.isin(clouds.columns, (one, other)), 11 - marker[clouds.columns], marker[clouds.columns])
    assert (marker_of_points(swapped.labelling, clouds) != right).sum() >= 100, "half of each knee's track carries the other's label"
    cut = cut_before(whole, clouds, np.nonzero((clouds.frame_of == 60) & np.isin(clouds.columns, (one, other)))[0])
    assert len(cut) == 17
    found = relabel_tracklets(swapped, cut, nothing_known(cut))
    assert (marker_of_points(found, clouds) == right).all()


def label_of_whole_tracks(before: LabelledTracklets, tracklets: Tracklets) -> LabelledTracklets:
    """The recording as it is labelled where tracklets are not cut."""
    from asterism.labelling.whole.joint import label_scene
    from asterism.labelling.whole.label import LongTracklets
    from asterism.labelling.whole.scene import prepare_scene

    rules, labeller = RecordingLabellingSettings(), before.body.labeller
    scene = prepare_scene(before.clouds, tracklets, rules)
    found = label_scene([labeller], scene, rules, SubjectRules(), before.body_rules)
    long = LongTracklets(tracklets, np.ones(len(before.clouds.xyz), dtype=np.bool_), found, None)
    points = label_all_points([labeller], before.clouds, long, rules)
    labelling = labelling_of(before.body, 0, before.clouds, points, np.array([0, 15]), before.settings)
    return LabelledTracklets(before.body, before.clouds, long, points, labelling, before.body_rules, rules)


def test_a_short_tracklet_can_be_named() -> None:
    """A marker that shows for two frames only."""
    recording, marker = recorded(walks()[4], hidden=0, ghosts=0)
    positions = recording.positions.copy()
    column = int(np.nonzero(marker == 3)[0][0])
    positions[:, column] = np.nan
    positions[50:52, column] = recording.positions[50:52, column]
    clouds = replace(recording, positions=positions).clouds()
    before = labelled(clouds)
    points = np.nonzero(clouds.columns == column)[0]
    assert not before.long.kept[points].any()
    fixed = nothing_known(before.long.tracklets)
    fixed[before.long.tracklets.of_point[points]] = 4
    found = relabel_tracklets(before, before.long.tracklets, fixed)
    marker_now, confidence = labels_of_points(found, clouds)
    assert (marker_now[points] == 4).all() and (confidence[points] == 1.0).all()


def test_another_body_altogether_is_labelled_again() -> None:
    """A body whose proportions no training showed: its labels are limited, and what a person says is not."""
    recording, _ = recorded(walks()[4], hidden=0, ghosts=0)
    stretched = recording.positions * np.array([1.0, 1.0, 1.6])
    clouds = replace(recording, positions=stretched).clouds()
    before = labelled(clouds)
    assert before.labelling.verdict is not None and not before.labelling.verdict.fits
    fixed = nothing_known(before.long.tracklets)
    fixed[0] = 2
    marker, confidence = labels_of_points(relabel_tracklets(before, before.long.tracklets, fixed), clouds)
    own = before.long.tracklets.of_point == 0
    assert (marker[own] == 2).all() and (confidence[own] == 1.0).all()
    assert confidence[~own].max() < 0.99


def test_the_chances_of_a_piece_name_its_marker_first(walk: tuple[LabelledTracklets, Ints]) -> None:
    before, truth = walk
    tracklets = before.long.tracklets
    for piece in np.nonzero(tracklets.last - tracklets.first > 60)[0]:
        points = np.nonzero(tracklets.of_point == piece)[0]
        chance = marker_chances(before, before.labelling, points)
        assert chance.sum() <= 1.0 + 1e-9
        assert chance.argmax() == truth[points[0]]
