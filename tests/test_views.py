"""Labelling in the images of few cameras: simulated people before simulated cameras, with known truth."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from computed import computed
from counting import calls

from asterism.cameras import Rig
from asterism.cameras.files import write_rig
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.files.journal import Journal
from asterism.formats import read, write, write_blobs
from asterism.recording import Blobs, MarkerSet, Recording
from asterism.report.views import views_report
from asterism.simulation import simulate_standing, simulate_walks
from asterism.simulation.cameras import Capsules
from asterism.simulation.views_laboratory import ViewsSession, simulate_views
from asterism.simulation.views_motion import simulate_motion
from asterism.skeleton import ArticulatedBody, fit_body, load_body, save_body, shipped_bodies
from asterism.skeleton.posing import posed_points
from asterism.views import checks, label, label_views
from asterism.views.frame import FrameLabeller
from asterism.views.passes import DirectionalTracker, Starts, _best_path, joined, seen
from asterism.views.personal import PERSONAL
from asterism.views.plain import label_stepwise, minimise_plain
from asterism.views.result import ViewsLabelling
from asterism.views.rig_fit import CameraAgreement
from asterism.views.rules import QUICK, RULES, ViewsRules
from asterism.views.scene import scene_of
from asterism.views.sights import FROM_BOTH_SIDES

GAIT = MarkerSet.load("helen-hayes")


@pytest.fixture(autouse=True)
def _half_as_many_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """The person is learned, and cameras compared, by half as many frames, each searched from nothing: fewer make nothing easier."""
    monkeypatch.setattr(label, "PERSONAL", replace(PERSONAL, frames=PERSONAL.frames // 2))


def labels_of(blobs: Blobs, rig: Rig, body: ArticulatedBody | str, rules: ViewsRules = RULES) -> ViewsLabelling:
    """What `label_views` gives; seconds for most recordings, so that it is worked out once for the same sources."""
    return computed(label_views, blobs, rig, body, rules=rules, beside=label.PERSONAL)


@cache
def body_of_four() -> ArticulatedBody:
    """The mean of four simulated people, none of whom is tested."""
    standing, walking = simulate_standing(4, 20, seed=5), simulate_walks(4, 120, seed=5)
    people = [str(trial.metadata["subject"]) for trial in (*standing, *walking)]
    return fit_body(standing, walking, markers=GAIT, people=people, title="four walkers")


@cache
def session(cameras: int = 4) -> ViewsSession:
    walk = simulate_walks(2, 110, seed=31)[1]
    return simulate_views(walk, body_of_four().labels, rng=np.random.default_rng(3), cameras=cameras)


@cache
def labelled(cameras: int = 4) -> ViewsLabelling:
    given = session(cameras)
    return labels_of(given.blobs, given.rig, body_of_four())


def right_and_wrong(result: ViewsLabelling, truth: ViewsSession) -> tuple[float, float]:
    """Shares of the blobs that show one marker: labelled as it, and labelled as another; strays with a label count as wrong."""
    marker, clear = truth.identity >= 0, truth.identity != -2
    right = (result.labels == truth.identity) & marker
    wrong = (result.labels >= 0) & (result.labels != truth.identity) & clear
    return right.sum() / marker.sum(), wrong.sum() / marker.sum()


@pytest.mark.parametrize(
    ("cameras", "least", "most"), [(4, 0.99, 0.005), pytest.param(3, 0.985, 0.01, marks=pytest.mark.slow), (2, 0.95, 0.01)]
)
def test_blobs_of_a_walk_are_labelled_from_nothing(cameras: int, least: float, most: float) -> None:
    right, wrong = right_and_wrong(labelled(cameras), session(cameras))
    assert right >= least, f"{cameras} cameras: {right:.4f} of the visible markers are labelled right"
    assert wrong <= most, f"{cameras} cameras: {wrong:.4f} of the labels are wrong"
    assert labelled(cameras).findings == ()


@cache
def people_before_two_cameras() -> tuple[tuple[ViewsSession, ViewsLabelling], ...]:
    """Two people whom labelling that hangs on its first frame gets wrong: 95 % and 10 % of the labels, at a confidence above 0.9."""
    walks = {(42, 0): simulate_walks(3, 90, seed=42)[0], (40, 1): simulate_walks(3, 90, seed=40)[1]}
    seen = [simulate_views(walk, body_of_four().labels, rng=np.random.default_rng([*key, 2]), cameras=2) for key, walk in walks.items()]
    return tuple((each, labels_of(each.blobs, each.rig, body_of_four())) for each in seen)


def test_a_wrong_start_before_two_cameras_gives_no_confident_wrong_labels() -> None:
    (first, doubtful), (second, result) = people_before_two_cameras()
    right, wrong = right_and_wrong(result, second)
    assert right > 0.97, f"{right:.4f} right"
    both = 0.5 * (wrong + right_and_wrong(doubtful, first)[1])
    assert both <= 0.003, f"{both:.4f} wrong"


def test_a_frame_that_another_explanation_explains_as_well_is_not_confident() -> None:
    margin, none = np.array([10.0, 10.0, 10.0]), np.zeros(3, dtype=bool)
    sure = RULES.confidence(margin, none, np.array([np.inf, 20.0, 0.5]))
    assert sure[0] > 0.999 and sure[1] > 0.99 and sure[2] < 0.6
    assert (RULES.confidence(margin, ~none, np.full(3, np.inf)) < sure[0]).all()


def test_a_start_that_faces_the_wrong_way_is_turned_by_the_frames_that_follow() -> None:
    given = session(2)
    labeller = FrameLabeller(scene_of(given.blobs.frames(slice(0, 30)), given.rig), body_of_four())
    starts = Starts(labeller)
    right = starts.at(0)
    assert right is not None
    half, middle, pose = np.diag([-1.0, -1.0, 1.0]), labeller.placed(right.labels).mean(axis=0), right.labels.pose.copy()
    pose[3:6] = middle + half @ (pose[3:6] - middle)
    wrong = labeller.from_start(0, pose, half @ right.labels.rotation)
    assert (wrong.labels != right.labels.labels).mean() > 0.3 and wrong.gain < right.labels.gain
    forward, backward = DirectionalTracker(labeller, starts, 1), DirectionalTracker(labeller, starts, -1)
    forward.seen[0], backward.seen[29] = seen(labeller, wrong), starts.at(29)
    for t in range(1, 30):
        forward.take(t)
        backward.take(29 - t)
    both = joined(forward, backward)
    assert all(each is not None for each in both)
    first = both[0]
    assert first is not None and (first.labels.labels == right.labels.labels).mean() > 0.9
    assert np.isfinite(first.labels.rival_margin).any(), "the other explanation must be known as a rival"


def test_a_marker_that_one_camera_shows_is_placed_within_its_stated_deviation() -> None:
    result, truth = labelled(), session().recording.positions
    away = np.linalg.norm(result.positions - truth, axis=2)
    for views, most in ((1, 0.05), (2, 0.012)):
        chosen = result.views == views
        assert chosen.sum() > 20
        assert np.median(away[chosen]) < most, f"{views} views: {1e3 * np.median(away[chosen]):.1f} mm"
        inside = (away[chosen] < 3 * result.deviations[chosen]).mean()
        assert inside > 0.9, f"{views} views: {inside:.3f} within three deviations"


@cache
def whole_body() -> tuple[ViewsSession, ViewsLabelling]:
    rng = np.random.default_rng([3, 77])
    recording, capsules = simulate_motion(load_body("body26"), 60, rng=rng)
    given = simulate_views(recording, recording.labels, rng=rng, body=capsules)
    return given, labels_of(given.blobs, given.rig, load_body("body26"), rules=QUICK)


def test_a_whole_body_that_raises_its_arms_is_labelled_with_its_hands() -> None:
    """The start, raised arms and both sides of the wrists; `QUICK`, so that it takes a second."""
    given, result = whole_body()
    right, wrong = right_and_wrong(result, given)
    assert right > 0.97 and wrong < 0.02, f"{right:.4f} right, {wrong:.4f} wrong"
    hands = np.isin(given.identity, [list(result.body.labels).index(name) for name in ("LWRA", "LWRB", "RWRA", "RWRB", "LFIN", "RFIN")])
    assert (result.labels[hands] == given.identity[hands]).mean() > 0.93
    assert result.person is result.body


def test_a_single_frame_names_both_sides_of_a_wrist_and_the_finger_in_their_order() -> None:
    """In these frames the three markers of one hand once went round in a circle: no exchange of two of them leads back."""
    rng = np.random.default_rng([9, 26])
    body = load_body("body26")
    recording, capsules = simulate_motion(body, 180, rng=rng)
    given = simulate_views(recording, recording.labels, rng=rng, body=capsules)
    labeller = FrameLabeller(scene_of(given.blobs, given.rig), body)
    hand = [body.labels.index(name) for name in ("LWRA", "LWRB", "LFIN", "RWRA", "RWRB", "RFIN")]
    for t in (80, 139):
        shown = given.identity[given.blobs.offsets[4 * t] : given.blobs.offsets[4 * t + 4]]
        found = labeller.from_nothing(t)
        assert (found.labels == shown)[np.isin(shown, hand)].all(), f"frame {t}"


@pytest.mark.parametrize(("seed", "t"), [(1015, 159), (1046, 159), (1028, 0)], ids=["crossed arms", "crossed shanks", "bent trunk"])
def test_parts_that_were_once_taken_for_those_of_the_other_side_are_named_from_nothing(seed: int, t: int) -> None:
    rng = np.random.default_rng([seed, 26])
    body = load_body("body26")
    recording, capsules = simulate_motion(body, 180, rng=rng)
    given = simulate_views(recording, recording.labels, rng=rng, body=capsules)
    shown = given.identity[given.blobs.offsets[4 * t] : given.blobs.offsets[4 * t + 4]]
    found = FrameLabeller(scene_of(given.blobs, given.rig), body).from_nothing(t)
    assert (found.labels == shown)[shown >= 0].mean() > 0.95


def test_a_start_that_is_far_off_ends_at_the_right_labels() -> None:
    """45 degrees, 40 % too small and 0.5 m off along two axes: one labelling alone gets these frames wrong."""
    given = session()
    labeller = FrameLabeller(scene_of(given.blobs, given.rig), body_of_four())
    cos = np.sqrt(0.5)
    turn = np.array([[cos, -cos, 0.0], [cos, cos, 0.0], [0.0, 0.0, 1.0]])
    lost = 0
    for t in range(0, 50, 10):
        true = labeller.from_nothing(t)
        pose = true.pose.copy()
        pose[:3], pose[9:] = 0.6, body_of_four().arrays.usual
        pose[3:6] += [0.5, -0.5, 0.3]
        shown = given.identity[given.blobs.offsets[4 * t] : given.blobs.offsets[4 * t + 4]]
        alone, found = (each(t, pose, turn @ true.rotation).labels for each in (labeller.from_start, labeller.from_near))
        lost += (alone == shown)[shown >= 0].mean() < 0.9
        assert (found == shown)[shown >= 0].mean() > 0.9, f"frame {t}"
    assert lost > 0, "no start was far enough off to lead one labelling astray"


def test_a_start_that_explains_the_blobs_as_well_as_usual_is_labelled_once() -> None:
    given = session()
    labeller = FrameLabeller(scene_of(given.blobs, given.rig), body_of_four())
    near = [labeller.from_nothing(t) for t in range(0, 50, 10)]
    sought = calls(lambda: [labeller.from_near(10 * n, each.pose, each.rotation) for n, each in enumerate(near)])
    assert sought["from_start"] >= len(near) and sought["from_nothing"] < len(near), "every start was doubted"


def standing_person(seed: int) -> ViewsSession:
    """A person of `body26` who stands still for 26 frames, with the marker of the neck 5 cm off its usual place."""
    rng = np.random.default_rng([seed, 1])
    body = load_body("body26")
    off = {"C7": np.array([0.035, 0.0, 0.035])}
    places = [np.array(m.place) + m.spread * np.clip(rng.normal(size=3), -2, 2) + off.get(m.name, 0.0) for m in body.markers]
    person = replace(body, markers=tuple(replace(m, place=(x, y, z)) for m, (x, y, z) in zip(body.markers, places, strict=True)))
    held = {"forearm flexion": 15.0, "forearm turn": 30.0, "upper arm abduction": 8.0}
    angles = [np.radians(held[plain]) if (plain := h.name.partition(" ")[2]) in held else h.usual for h in body.hinges]
    posed = posed_points(person, np.concatenate([np.ones(3), np.zeros(6), angles]), np.eye(3))
    points, starts, ends = (np.repeat(each[None], 26, axis=0) for each in posed)
    hiding = Capsules(starts, ends, person.arrays.radii.mean(axis=1), tuple(part.name for part in body.capsules))
    recording = Recording(points, body.labels, 60.0, np.array([0.0, 0.0, 1.0]))
    return simulate_views(recording, body.labels, rng=rng, body=hiding)


@pytest.mark.slow
def test_a_person_who_stands_still_keeps_the_names_of_both_sides_of_a_wrist() -> None:
    """A marker that is sought elsewhere must not cost the wrists their names: the whole person's body is learned, which takes 5 s."""
    given = standing_person(0)
    right, wrong = right_and_wrong(labels_of(given.blobs, given.rig, "body26"), given)
    assert right > 0.98 and wrong < 0.002, f"{right:.4f} right, {wrong:.4f} wrong"


def test_what_the_frame_before_showed_foresees_visibility_better_than_the_body_alone() -> None:
    result, given = labelled(), session()
    alone, both = (((told > 0.5) == given.in_view).mean() for told in (result.expected, result.predict_visibility()))
    assert both > 0.97 > alone > 0.9, f"right: {alone:.4f} by the body, {both:.4f} with the frame before"
    after = ((result.predict_visibility(FROM_BOTH_SIDES) > 0.5) == given.in_view).mean()
    assert after > both, f"right: {after:.4f} with the frame after, too"
    assert np.array_equal(result.shown.sum(axis=1), result.views)


def test_a_frames_own_labels_take_no_part_in_what_is_predicted_of_it() -> None:
    result = labelled()
    whole = result.predict_visibility()
    t = 40
    without = replace(result, labels=np.where(result.blobs.frame_of == t, -1, result.labels)).predict_visibility()
    assert np.array_equal(whole[: t + 1], without[: t + 1]) and np.array_equal(whole[t + 2 :], without[t + 2 :])
    assert (without[t + 1] <= whole[t + 1]).all() and (without[t + 1] < whole[t + 1]).any()
    lost = replace(result, poses=np.where(np.arange(len(result.poses))[:, None] == t, np.nan, result.poses)).predict_visibility()
    assert (lost[t] == 0.0).all() and (np.abs(lost[t + 1] - 0.5) < np.abs(whole[t + 1] - 0.5)).mean() > 0.8


def test_the_better_explanation_of_a_frame_leads_the_other_one_only_where_they_differ() -> None:
    given = session(2)
    labeller = FrameLabeller(scene_of(given.blobs, given.rig), body_of_four())
    found = replace(labeller.from_nothing(3), rival_margin=np.full(len(given.blobs.frames(slice(3, 4)).xy), np.inf))
    first, last = np.nonzero(found.labels >= 0)[0][[0, -1]]
    other = found.labels.copy()
    other[[first, last]] = other[[last, first]]
    worse = replace(found, labels=other, gain=found.gain - 4.0, rival_margin=np.full(len(other), 3.0))
    expected = np.full(len(other), 7.0)
    expected[[first, last]] = 4.0
    for better in (found.against(worse), worse.against(found)):
        assert np.array_equal(better.labels, found.labels)
        np.testing.assert_allclose(better.rival_margin, expected, err_msg="what was nearly as good as the worse one is worse by both")


def test_a_path_goes_over_to_the_other_explanation_only_where_that_gains_more_than_the_jump() -> None:
    differ = np.ones(6, dtype=bool)
    assert _best_path(np.array([3.0, 3.0, -2.0, -2.0, 3.0, 3.0]), differ, 10.0).all()
    assert _best_path(np.array([30.0, 30.0, -30.0, -30.0, 30.0, 30.0]), differ, 10.0).tolist() == [True, True, False, False, True, True]
    agreeing = np.array([True, True, False, True, True, True])
    assert _best_path(np.array([3.0, 3.0, 0.0, -3.0, -3.0, -3.0]), agreeing, 10.0).tolist()[-1] is False


def test_labelling_and_recording_say_the_same_as_the_labels() -> None:
    result = labelled()
    assert np.allclose(result.labelling.positions(result.clouds), result.positions, equal_nan=True)
    assert (result.views == _views_by_counting(result)).all()
    exact = result.recording(least_views=2)
    assert (np.isfinite(exact.positions[:, :, 0]) == (result.views >= 2)).all()
    none = result.recording(most_deviation=1e-6)
    assert np.isnan(none.positions).all()


def _views_by_counting(result: ViewsLabelling) -> np.ndarray:
    views = np.zeros(result.views.shape, dtype=int)
    for frame, marker in zip(result.blobs.frame_of, result.labels, strict=True):
        if marker >= 0:
            views[frame, marker] += 1
    return views


def test_the_same_blobs_give_the_same_labels_and_are_left_as_they_came() -> None:
    given = session()
    blobs, before = given.blobs.frames(slice(0, 4)), given.blobs.xy.copy()
    again, once = (label_views(blobs, given.rig, body_of_four()) for _ in range(2))
    assert (given.blobs.xy == before).all() and np.isfinite(given.recording.positions).all()
    assert (again.labels == once.labels).all() and (again.confidence == once.confidence).all()


def test_a_rig_that_does_not_match_the_images_gets_no_label() -> None:
    given = session()
    names = given.rig.names
    exchanged = given.rig.select((names[1], names[0], names[3], names[2]))
    renamed = type(given.rig)(
        tuple(type(c)(**{**c.__dict__, "name": n}) for c, n in zip(exchanged, names, strict=True)), vertical=given.rig.vertical
    )
    result = labels_of(given.blobs.frames(slice(0, 1)), renamed, body_of_four())
    assert (result.labels >= 0).mean() < 0.02
    assert "views-no-body" in [finding.code for finding in result.findings]


@pytest.mark.slow
def test_a_camera_that_was_knocked_gets_no_labels_and_is_named() -> None:
    given = session()
    first = given.rig.cameras[0]
    turn = np.array([[0.94, 0.0, 0.3412], [0.0, 1.0, 0.0], [-0.3412, 0.0, 0.94]])
    turn = np.linalg.svd(turn)[0] @ np.linalg.svd(turn)[2]
    knocked = replace(first, rotation=turn @ first.rotation, translation=turn @ first.translation)
    few = given.blobs.frames(slice(0, 40))
    result = labels_of(few, replace(given.rig, cameras=(knocked, *given.rig.cameras[1:])), body_of_four())
    identity = given.identity[: len(few.xy)]
    assert [finding.where for finding in result.findings if finding.code == "views-camera-misfit"] == [first.name]
    assert (result.labels[few.camera_of == 0] == -1).all()
    others = (few.camera_of != 0) & (identity >= 0)
    assert (result.labels[others] == identity[others]).mean() > 0.95


def without(*markers: str) -> ViewsLabelling:
    """A few frames of the walk by somebody who does not wear these markers."""
    given, labels = session(), body_of_four().labels
    worn = ~np.isin(given.identity, [labels.index(name) for name in markers])
    return labels_of(given.blobs.select(worn).frames(slice(0, 8)), given.rig, body_of_four())


def test_markers_that_are_not_worn_are_said_and_where_they_are_many_no_label_is_given() -> None:
    assert [(finding.code, finding.where) for finding in without("LTIB").findings] == [("views-markers-absent", "LTIB")]
    other = without("LTHI", "RTHI", "LTIB", "RTIB", "SACR", "LHEE", "RHEE")
    assert (other.labels == -1).all() and "views-no-body" in [finding.code for finding in other.findings]


@pytest.mark.slow
def test_another_body_gets_no_label() -> None:
    given = session()
    other = labels_of(given.blobs.frames(slice(0, 10)), given.rig, load_body("body26"))
    assert (other.labels == -1).all() and "views-no-body" in [finding.code for finding in other.findings]


def test_markers_that_are_there_but_in_doubt_are_not_said_to_be_absent() -> None:
    found = labelled()
    one = list(found.body.labels).index("LTIB")
    doubted = replace(found, labels=np.where(found.labels == one, -1, found.labels))
    assert (doubted.candidates == one).any()
    none = CameraAgreement(RULES.noise, np.empty(0, dtype=np.int64), 0.0, {})
    assert [(each.code, each.where) for each in checks.findings(doubted, none, np.zeros(4))] == [("views-markers-in-doubt", "LTIB")]
    gone = replace(doubted, candidates=doubted.labels)
    assert [(each.code, each.where) for each in checks.findings(gone, none, np.zeros(4))] == [("views-markers-absent", "LTIB")]


def test_a_mirrored_body_and_one_with_exchanged_names_are_refused() -> None:
    given = session()
    with pytest.raises(AsterismError, match="right side"):
        label_views(given.blobs, given.rig, body_of_four().mirrored())
    twice = body_of_four().mirrored().mirrored()
    assert np.abs(twice.places - body_of_four().places).max() < 1e-12


def test_a_camera_without_blobs_is_said_and_the_others_are_labelled() -> None:
    given = session()
    dark = given.blobs.select(given.blobs.camera_of != 1)
    result = labels_of(dark.frames(slice(0, 15)), given.rig, body_of_four())
    assert "views-empty-camera" in [finding.code for finding in result.findings]
    assert (result.labels >= 0).mean() > 0.75


def test_blobs_of_one_camera_alone_are_not_labelled() -> None:
    given = session()
    alone = given.blobs.select(given.blobs.camera_of == 1).frames(slice(0, 10))
    result = labels_of(alone, given.rig, body_of_four())
    assert (result.labels == -1).all() and "views-no-body" in [finding.code for finding in result.findings]


def test_no_blobs_at_all_give_no_labels() -> None:
    given = session()
    empty = given.blobs.select(np.zeros(len(given.blobs.xy), dtype=bool)).frames(slice(0, 5))
    result = labels_of(empty, given.rig, body_of_four())
    assert len(result.labels) == 0 and np.isnan(result.positions).all()


def test_a_rig_without_the_camera_or_the_vertical_is_refused() -> None:
    given = session()
    with pytest.raises(AsterismError, match="no camera c4"):
        label_views(given.blobs, given.rig.select(given.rig.names[:3]), body_of_four())
    flat = type(given.rig)(given.rig.cameras)
    with pytest.raises(AsterismError, match="which way is up"):
        label_views(given.blobs, flat, body_of_four())


def test_shipped_bodies_load_and_are_written_back(tmp_path: Path) -> None:
    assert {name: len(load_body(name).labels) for name in shipped_bodies()} == {"body26": 26, "gait15": 15, "plug-in-gait": 34}
    for name in shipped_bodies():
        body = load_body(name)
        save_body(body, tmp_path / "body.toml")
        again = load_body(tmp_path / "body.toml")
        assert again.labels == body.labels and again.hinge_names == body.hinge_names
        assert np.abs(again.places - body.places).max() < 1e-4
        assert np.abs(again.start_angles - body.start_angles).max() < np.radians(0.1)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("version = 1", "version = 9"), "version"),
        (('parent = "pelvis"', 'parent = "tail"'), "parent"),
        (('bone = "pelvis"', 'bone = "wing"'), "no bone"),
        (("[[markers]]", "[[marker]]"), "markers"),
        (("place = [", "place = [1.0, "), "place"),
        (("height = ", "height = nan #"), "height"),
        (('name = "LKNE"', 'name = "RKNE"'), "twice"),
        (("radii = [", "radii = [-"), "radius"),
    ],
)
def test_a_damaged_body_is_refused_with_its_name(tmp_path: Path, change: tuple[str, str], sentence: str) -> None:
    save_body(load_body("gait15"), tmp_path / "body.toml")
    text = (tmp_path / "body.toml").read_text()
    assert change[0] in text
    (tmp_path / "body.toml").write_text(text.replace(*change))
    with pytest.raises(AsterismError, match=sentence):
        load_body(tmp_path / "body.toml")


def test_a_standing_trial_becomes_a_body_with_the_markers_where_they_are(tmp_path: Path) -> None:
    standing = simulate_standing(1, 20, seed=8)[0]
    write(tmp_path / "static.c3d", standing)
    assert main(["body", "fit", str(tmp_path / "static.c3d"), "-o", str(tmp_path / "body.toml")]) == 0
    body = load_body(tmp_path / "body.toml")
    assert body.labels == standing.labels
    middle = np.median(standing.positions, axis=0)
    own = np.linalg.norm(body.places[:, None] - body.places[None], axis=2)
    assert np.abs(own - np.linalg.norm(middle[:, None] - middle[None], axis=2)).max() < 0.002
    assert body.places[list(body.labels).index("LKNE"), 1] > 0 > body.places[list(body.labels).index("RKNE"), 1]


def test_an_elbow_bends_backward_by_ten_degrees_beyond_the_straight_arm() -> None:
    standing = simulate_motion(load_body("body26"), 2, rng=np.random.default_rng(4))[0]
    body = fit_body([standing], markers=load_body("body26").labels)
    for side in ("left", "right"):
        pivots = {bone.name: np.array(bone.pivot) for bone in body.bones}
        upper = pivots[f"{side} forearm"] - pivots[f"{side} upper arm"]
        lower = pivots[f"{side} hand"] - pivots[f"{side} forearm"]
        bend = np.degrees(np.arctan2(lower[0], -lower[2]) - np.arctan2(upper[0], -upper[2]))
        hinge = next(hinge for hinge in body.hinges if hinge.name == f"{side} forearm flexion")
        assert np.degrees(hinge.low) == pytest.approx(-max(bend, 0.0) - 10.0, abs=0.1)
        assert np.degrees(hinge.high) == pytest.approx(150.0)


def test_a_body_of_one_standing_trial_moves_as_the_shipped_one_and_nobody_who_walks_stands() -> None:
    standing, walking = simulate_standing(1, 20, seed=8)[0], simulate_walks(1, 120, seed=8)[0]
    body, shipped = fit_body([standing], markers=GAIT), load_body("gait15")
    spreads = {hinge.name: hinge.spread for hinge in shipped.hinges}
    assert all(hinge.spread == spreads[hinge.name] for hinge in body.hinges) and len(body.poses) == len(shipped.poses)
    with pytest.raises(AsterismError, match="nobody stands still"):
        fit_body([walking], markers=GAIT)


def test_a_body_without_a_pelvis_is_refused() -> None:
    standing = simulate_standing(1, 5, seed=8)[0]
    legs = standing.select([name for name in standing.labels if name not in ("LASI", "SACR")])
    with pytest.raises(AsterismError, match="pelvis"):
        fit_body([legs])


def test_the_command_labels_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = session()
    write_blobs(given.blobs.frames(slice(0, 20)), tmp_path / "2d.csv")
    write_rig(given.rig, tmp_path / "rig.toml")
    save_body(body_of_four(), tmp_path / "body.toml")
    words = ["label-views", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "--body", str(tmp_path / "body.toml")]
    out = ["-o", str(tmp_path / "out.c3d"), "--labels", str(tmp_path / "labels.csv"), "--json", str(tmp_path / "out.json")]
    assert main([*words, *out]) == 0
    assert "blobs labelled" in capsys.readouterr().out
    told = json.loads((tmp_path / "out.json").read_text())
    rows = (tmp_path / "labels.csv").read_text().splitlines()
    assert len(rows) == told["blobs"] + 1 and sum(bool(row.split(",")[4]) for row in rows[1:]) == told["labelled_blobs"]
    written = read(tmp_path / "out.c3d")
    apart = np.linalg.norm(written.positions - given.recording.positions[:20], axis=2)
    assert np.nanmedian(apart) < 0.02 and np.isfinite(apart).mean() > 0.9
    assert main([*words, *out]) == 2
    assert "exists" in capsys.readouterr().err
    # a table without a line
    (tmp_path / "2d.csv").write_text("frame,camera,x,y\n", encoding="utf-8")
    assert main([*words, "-o", str(tmp_path / "none.c3d")]) == 2
    assert "2d.csv holds no image" in capsys.readouterr().err


def test_the_papers_algorithm_labels_a_standing_person_from_a_near_start_and_ours_labels_more() -> None:
    given = session()
    labeller = FrameLabeller(scene_of(given.blobs, given.rig), body_of_four())
    plain = ours = shown = 0
    for t in range(0, len(given.blobs), 20):
        near = labeller.from_nothing(t)
        identity = given.identity[given.blobs.offsets[4 * t] : given.blobs.offsets[4 * t + 4]]
        pose, rotation = minimise_plain(labeller, t, near.pose, near.rotation)
        labels = label_stepwise(labeller, t, pose, rotation)
        cameras = np.split(labels, given.blobs.offsets[4 * t + 1 : 4 * t + 4] - given.blobs.offsets[4 * t])
        assert all(len(np.unique(own[own >= 0])) == (own >= 0).sum() for own in cameras)
        plain += ((labels == identity) & (identity >= 0)).sum()
        ours += ((near.labels == identity) & (identity >= 0)).sum()
        shown += (identity >= 0).sum()
    assert 0.8 * shown < plain < ours, f"the paper's {plain}, ours {ours} of {shown}"


def test_the_page_shows_each_camera_with_its_blobs_and_the_hidden_markers(tmp_path: Path) -> None:
    result = labelled()
    views_report(tmp_path / "views.html", result)
    page = (tmp_path / "views.html").read_text(encoding="utf-8")
    figure = json.loads(page.split('id="data">')[1].split("</script>")[0])["figures"]["figure-0"]
    steps, layout, traces = figure["layout"]["sliders"][0]["steps"], figure["layout"], figure["data"]
    # the slider goes from the first frame to the last, and shows one frame's traces at a time
    assert (steps[0]["label"], steps[-1]["label"]) == ("0", str(len(result.views) - 1))
    shown = np.array([step["args"][0]["visible"] for step in steps])
    assert (shown.sum(axis=0) == 1).all() and [bool(one["visible"]) for one in traces] == shown[layout["sliders"][0]["active"]].tolist()
    for step in steps:
        there = step["args"][1]
        names = [one for one in there["annotations"] if "ax" in one]
        titles = [one["text"] for one in there["annotations"] if "ax" not in one]
        assert titles == [f"Camera {name}" for name in session().rig.names]
        for c, axis in enumerate(("x", "x2", "x3", "x4")):
            (left, right), (bottom, top) = there[f"xaxis{axis[1:]}.range"], there[f"yaxis{axis[1:]}.range"]
            body = next(trace for trace, on in zip(traces, step["args"][0]["visible"], strict=True) if on and trace["xaxis"] == axis)
            y = [value for value in body["y"] if value is not None]
            # the person fills the picture, and no two names of a column are nearer than a line
            assert (max(y) - min(y)) / (bottom - top) > 0.75, f"camera {c}"
            own = [one for one in names if one["xref"] == axis]
            assert len(own) > 5 and all(left < one["ax"] < right for one in own)
            for column in {one["ax"] for one in own}:
                heights = np.sort([one["ay"] for one in own if one["ax"] == column])
                assert (np.diff(heights) > 0.9 * 16 / 560 * (bottom - top)).all()
    assert "four walkers" in page and "LKNE" in page
    nobody = replace(result, poses=np.full_like(result.poses, np.nan), labels=np.full_like(result.labels, -1))
    views_report(tmp_path / "nobody.html", replace(nobody, views=np.zeros_like(result.views)))
    assert "0.0 %" in (tmp_path / "nobody.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_demo_reaches_what_it_promises(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "views", "-o", str(tmp_path), "--json", str(tmp_path / "demo.json")]) == 0
    told = json.loads((tmp_path / "demo.json").read_text())
    assert told["reached"] and told["right"] > 0.99
    assert {path.name for path in tmp_path.iterdir()} >= {"2d.csv", "rig.toml", "body.toml", "labelled.c3d", "views.html"}
    again = ["label-views", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "--body", str(tmp_path / "body.toml")]
    assert main([*again, "-o", str(tmp_path / "again.c3d"), "--report", str(tmp_path / "again.html")]) == 0
    first, second = read(tmp_path / "labelled.c3d"), read(tmp_path / "again.c3d")
    assert np.nanmedian(np.linalg.norm(first.positions - second.positions, axis=2)) < 0.001
    assert "asterism label-views" in capsys.readouterr().out


@cache
def quick() -> ViewsLabelling:
    """Twelve frames of the walk."""
    given = session()
    return labels_of(given.blobs.frames(slice(0, 12)), given.rig, body_of_four(), rules=QUICK)


def test_labels_that_were_broken_off_go_on_and_come_out_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = session()
    blobs, whole = given.blobs.frames(slice(0, 12)), quick()
    taken: list[int] = []
    take = DirectionalTracker._take

    def interrupted(self: DirectionalTracker, t: int) -> None:
        if t == 7 and 7 not in taken:
            taken.append(t)
            raise KeyboardInterrupt
        taken.append(t)
        take(self, t)

    monkeypatch.setattr(DirectionalTracker, "_take", interrupted)
    journal = Journal(tmp_path / "a", "walk")
    with pytest.raises(KeyboardInterrupt):
        label_views(blobs, given.rig, body_of_four(), rules=QUICK, journal=journal)
    journal.close()
    journal = Journal(tmp_path / "a", "walk")
    again = label_views(blobs, given.rig, body_of_four(), rules=QUICK, journal=journal)
    journal.remove()
    assert taken == [*range(8), *range(7, 12)]
    for name in ("labels", "confidence", "positions", "covariances", "poses"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    assert again.restarts == whole.restarts and again.findings == whole.findings


def test_a_frame_that_fails_costs_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    given = session()
    blobs, whole = given.blobs.frames(slice(0, 12)), quick()
    take, broken = DirectionalTracker._take, {5}

    def failing(self: DirectionalTracker, t: int) -> None:
        if t in broken:
            raise np.linalg.LinAlgError("singular")
        take(self, t)

    monkeypatch.setattr(DirectionalTracker, "_take", failing)
    result = label_views(blobs, given.rig, body_of_four(), rules=QUICK)
    [finding] = [finding for finding in result.findings if finding.code == "views-frame-failed"]
    assert "frame 5 " in finding.sentence and "singular" in finding.sentence
    other = blobs.frame_of != 5
    assert (result.labels[~other] < 0).all() and not np.isfinite(result.poses[5]).any()
    # the frames around are labelled as they were, but for few: the body is sought anew after the broken one
    assert (result.labels[other] == whole.labels[other]).mean() > 0.97
    broken.update(range(12))
    with pytest.raises(AsterismError, match="no frame can be labelled"):
        label_views(blobs, given.rig, body_of_four(), rules=QUICK)
