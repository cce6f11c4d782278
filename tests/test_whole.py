"""Whole recordings: known truth from the simulation, gaps and ghosts that last, points in any order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from models import trained
from scipy.spatial.transform import Rotation

import asterism
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.marker_model import OTHER_SUBJECT_FIT
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.labelling.whole import joint
from asterism.labelling.whole._kernels import FrameScores
from asterism.labelling.whole.fits import point_fits
from asterism.labelling.whole.joint import voting_frames
from asterism.labelling.whole.scene import SceneScores, prepare_scene, score_scene
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.upright import turned, upright_turns
from asterism.recording import Clouds
from asterism.simulation import simulate_walks
from asterism.tracking.linking import find_tracklets

pytestmark = pytest.mark.kernels


@pytest.fixture(scope="module")
def walks() -> list[asterism.Recording]:
    return simulate_walks(subjects=5, frames=120, seed=4)


@pytest.fixture(scope="module")
def ensemble(walks: list[asterism.Recording]) -> asterism.MarkerModel:
    return trained(walks[:4], miner=None)


@pytest.mark.parametrize("number_tracks", [True, False], ids=["with tracks", "raw clouds"])
def test_a_stranger_with_gaps_is_labelled_right(
    ensemble: asterism.MarkerModel, walks: list[asterism.Recording], number_tracks: bool
) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[4], 3, 0, seed=1, number_tracks=number_tracks)
    labelling = ensemble.label(clouds)
    given = labelling.indices >= 0
    assert (labelling.indices == truth)[given].mean() > 0.999
    assert (given & (truth >= 0)).sum() > 0.97 * (truth >= 0).sum()


def test_a_marker_seen_for_long_does_not_yield_to_short_ghosts_beside_it(walks: list[asterism.Recording]) -> None:
    """A camera system that composes a marker twice now and then: 12 single points 2 cm beside LTIB, one person in the training."""
    one = trained(walks[:1], miner=None)
    marker = one.marker_set.names.index("LTIB")
    walk = walks[0].positions[:, [walks[0].labels.index(name) for name in one.marker_set.names]]
    rng = np.random.default_rng(0)
    double = {int(t): walk[t, marker] + 0.02 * rng.normal(size=3) / np.sqrt(3) for t in range(5, 120, 10)}
    frames = [np.concatenate([frame, double[t][None]]) if t in double else frame for t, frame in enumerate(walk)]
    numbers = [np.concatenate([np.arange(15), [100 + t]]) if t in double else np.arange(15) for t in range(len(walk))]
    labelling = one.label(Clouds.from_points(frames, walks[0].rate, walks[0].vertical, tracks=numbers))
    assert (labelling.indices[:, marker] == marker).mean() > 0.95


@pytest.mark.parametrize(("name", "aside"), [("LTIB", 0.15), ("RTHI", 0.25), ("SACR", 0.25)])
def test_a_point_that_is_not_where_the_marker_was_in_training_is_not_given_its_label(
    walks: list[asterism.Recording], name: str, aside: float
) -> None:
    """It goes with the body, it is the only one left over, and most of the frame explains it; but its distances are not the marker's."""
    one = trained(walks[4:], miner=None)
    names = one.marker_set.names
    others = np.arange(len(names)) != names.index(name)
    walk = walks[4].positions[:, [walks[4].labels.index(marker) for marker in names]]
    for up, given in ((0.0, True), (aside, False)):
        moved = walk + np.where(others[:, None], 0.0, up * walks[4].vertical)
        clouds = Clouds.from_points(list(moved), walks[4].rate, walks[4].vertical, tracks=[np.arange(len(names))] * len(moved))
        right = one.label(clouds).indices == np.arange(len(names))
        assert right[:, others].mean() > 0.95
        assert right[:, ~others].mean() == given


def leaning(walk: asterism.Recording, degrees: np.ndarray) -> asterism.Recording:
    """A walk whose body leans by so much in each frame (T,), about a horizontal axis through its middle; z is up."""
    middle = walk.positions.mean(axis=1, keepdims=True)
    turns = Rotation.from_rotvec(np.radians(degrees)[:, None] * [1.0, 0.0, 0.0]).as_matrix()
    return replace(walk, positions=middle + np.einsum("tij,tmj->tmi", turns, walk.positions - middle))


def test_a_body_that_falls_keeps_its_labels(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    """Nobody leans in the training. Here a stranger falls to the side, by 80 degrees in the second half of the walk."""
    fall = leaning(walks[4], np.clip(np.arange(120) - 60, 0, 40) * 2.0)
    clouds, truth = simulate_gaps_and_ghosts(fall, 2, 0, seed=1)
    labelling = ensemble.label(clouds)
    given, lies = labelling.indices >= 0, np.arange(120) >= 100
    assert (labelling.indices == truth)[given].all()
    assert given[lies].sum() > 0.9 * (truth[lies] >= 0).sum()


def test_only_frames_that_lean_are_turned(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    """By the right labels: the turn takes back the lean, up to what a step of a walk differs from its key pose, and the heading."""
    rules, labeller = RecordingLabellingSettings(), ensemble.body_labeller
    for degrees in (0.0, 80.0):
        clouds = leaning(walks[4], np.full(120, degrees)).select(list(ensemble.marker_set.names)).clouds()
        scene = prepare_scene(clouds, find_tracklets(clouds), rules)
        marker = np.empty(len(scene.first), dtype=np.int64)
        marker[scene.track] = (np.arange(len(clouds.xyz)) % 15)[scene.order]
        turns = upright_turns(labeller, SceneScores(scene, labeller.body, labeller.settings), marker, rules)
        if not degrees:
            assert turns is None
        else:
            assert turns is not None
            up = turns @ Rotation.from_rotvec([np.radians(degrees), 0.0, 0.0]).as_matrix()
            assert np.degrees(np.arccos(np.clip(up[:, 2, 2], -1.0, 1.0))).max() < 25.0


def test_scores_that_are_kept_are_those_of_scoring_all_frames_again(
    ensemble: asterism.MarkerModel, walks: list[asterism.Recording]
) -> None:
    rng, labeller = np.random.default_rng(0), ensemble.body_labeller
    clouds, _ = simulate_gaps_and_ghosts(walks[4], 3, 1, seed=2)
    scene = prepare_scene(clouds, find_tracklets(clouds), RecordingLabellingSettings())
    label = rng.permutation(np.arange(len(scene.first)) % 16) - 1
    kept = SceneScores(scene, labeller.body, labeller.settings)
    for changed in (0, 1, 0, 5, len(label)):
        label = label.copy()
        label[rng.permutation(len(label))[:changed]] = -1
        found, wanted = kept.of(label), score_scene(scene, label, labeller.body, labeller.settings)
        for part, fresh in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(part, fresh)
    frames = np.zeros(len(scene.sampled_frames), dtype=np.bool_)
    frames[3:5] = True
    moved = replace(scene, sampled_xyz=scene.sampled_xyz + 0.01 * frames[scene.sampled_frame, None])
    for part, fresh in zip(
        kept.with_frames(moved, frames).of(label), score_scene(moved, label, labeller.body, labeller.settings), strict=True
    ):
        np.testing.assert_array_equal(part, fresh)


def test_a_body_that_explains_less_changes_nothing(
    ensemble: asterism.MarkerModel, walks: list[asterism.Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its scores are written over those of the labels that stay."""
    labeller, rules = ensemble.body_labeller, RecordingLabellingSettings()
    clouds, _ = simulate_gaps_and_ghosts(walks[4], 5, 3, seed=2)
    scene = prepare_scene(clouds, find_tracklets(clouds), rules)
    twice = replace(labeller.model, mean=2.0 * labeller.model.mean)
    monkeypatch.setattr(joint, "_adapted_body", lambda *_: twice)
    tried = joint.label_scene([labeller], scene, rules, SubjectRules(), ensemble.state.body_rules)
    plain = joint.label_scene([labeller], scene, replace(rules, adapt_rounds=0), SubjectRules(), ensemble.state.body_rules)
    assert tried.bodies == [labeller.model]
    assert (plain.margin < rules.no_adapt_margin).any(), "there is something to adapt for"
    for name in ("label", "margin", "rival", "by_body"):
        np.testing.assert_array_equal(getattr(tried, name), getattr(plain, name))


def test_scores_are_written_over_those_of_an_earlier_recording(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    labeller, rules, arrays = ensemble.body_labeller, RecordingLabellingSettings(), list[FrameScores]()
    for walk, seed in ((walks[4], 2), (walks[4], 3), (walks[3].frames(slice(0, 200)), 4)):
        clouds, _ = simulate_gaps_and_ghosts(walk, 5, 3, seed=seed)
        scene = prepare_scene(clouds, find_tracklets(clouds), rules)
        plain = joint.label_scene([labeller], scene, rules, SubjectRules(), ensemble.state.body_rules)
        found = joint.label_scene([labeller], scene, rules, SubjectRules(), ensemble.state.body_rules, work=joint.SceneWork(arrays=arrays))
        assert len(arrays) == 1
        for name in ("label", "margin", "rival", "by_body"):
            np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))


def test_points_turn_with_their_frames() -> None:
    rng = np.random.default_rng(0)
    xyz, frame, turns = rng.normal(size=(50, 3)), rng.integers(0, 4, 50), Rotation.random(4, random_state=0).as_matrix()
    turns[2] = np.eye(3)
    found = turned(xyz, frame, turns)
    np.testing.assert_allclose(found, [turns[t] @ point for t, point in zip(frame, xyz, strict=True)])
    np.testing.assert_array_equal(found[frame == 2], xyz[frame == 2])


def test_the_order_of_the_points_plays_no_part(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    clouds, _ = simulate_gaps_and_ghosts(walks[4], 2, 2, seed=2)
    assert clouds.tracks is not None
    rng = np.random.default_rng(0)
    order = np.concatenate([a + rng.permutation(b - a) for a, b in zip(clouds.offsets[:-1], clouds.offsets[1:], strict=True)])
    shuffled = Clouds(clouds.xyz[order], clouds.offsets, clouds.rate, clouds.vertical, clouds.columns, clouds.tracks[order])
    one, other = ensemble.label(clouds), ensemble.label(shuffled)
    assert np.array_equal(one.positions(clouds), other.positions(shuffled), equal_nan=True)
    assert np.array_equal(one.confidence, other.confidence)


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_a_recording_of_few_frames_is_labelled_as_its_frames_are(
    ensemble: asterism.MarkerModel, walks: list[asterism.Recording], frames: int
) -> None:
    """No tracklet is long: labels and confidence are those of single frames, and the verdict is said."""
    clouds, _ = simulate_gaps_and_ghosts(walks[4].frames(slice(40, 40 + frames)), 3, 1, seed=3)
    whole, single = ensemble.label(clouds), ensemble.label(clouds)
    assert whole.verdict is not None and whole.verdict.fits and whole.verdict.scatter > 0.0
    assert (whole.indices >= 0).sum() > 8 * frames
    np.testing.assert_array_equal(whole.indices, single.indices)
    given = whole.indices >= 0
    np.testing.assert_allclose(whole.confidence[given], single.confidence[given], atol=1e-6)


def test_empty_frames_are_fine(ensemble: asterism.MarkerModel) -> None:
    nothing = Clouds.from_points([np.empty((0, 3))] * 4, 100.0)
    assert (ensemble.label_one_body(nothing).indices == -1).all()
    with pytest.raises(asterism.AsterismError, match="no points to label"):
        ensemble.label(nothing)


def test_options_of_before_keep_their_meaning(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    clouds = walks[4].frames(slice(0, 40)).clouds()
    assert ensemble.label(clouds, time=True) == ensemble.label(clouds) == ensemble.label(walks[4].frames(slice(0, 40)))
    with pytest.warns(DeprecationWarning, match="label_frames"):
        assert ensemble.label(clouds, time=False) == ensemble.label_frames(clouds)
    with pytest.raises(asterism.AsterismError, match="whole-body"):
        ensemble.label(clouds, time=True, rules="thesis")
    with pytest.raises(TypeError, match="not minutes"):
        ensemble.label(clouds, minutes=3)
    with pytest.warns(DeprecationWarning, match="now called MarkerModel"):
        assert asterism.SolverEnsemble is asterism.MarkerModel
    with pytest.warns(DeprecationWarning, match="now called MarkerModel"):
        from asterism.labelling import SolverEnsemble
    assert SolverEnsemble is asterism.MarkerModel


def test_a_saved_model_labels_whole_recordings_alike(
    ensemble: asterism.MarkerModel, walks: list[asterism.Recording], tmp_path: Path
) -> None:
    path = tmp_path / "walk.model"
    ensemble.save(path)
    clouds, _ = simulate_gaps_and_ghosts(walks[4], 3, 1, seed=3)
    one, other = ensemble.label(clouds), asterism.MarkerModel.load(path).label(clouds)
    assert np.array_equal(one.indices, other.indices)
    assert np.array_equal(one.confidence, other.confidence)


def test_a_trial_of_the_person_makes_single_frames_surer(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    adapted = ensemble.adapt(walks[4].frames(slice(0, 60)))
    clouds, truth = simulate_gaps_and_ghosts(walks[4].frames(slice(60, 120)), 3, 0, seed=5)
    own, general = adapted.label_frames(clouds), ensemble.label_frames(clouds)
    assert (own.indices == truth)[own.indices >= 0].all()
    assert own.confidence[truth >= 0].mean() > general.confidence[truth >= 0].mean()


def test_an_unlabelled_trial_with_markers_missing_adapts_too(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    anonymous = asterism.Recording(walks[4].positions[:60, 2:], tuple(f"*{i}" for i in range(13)), walks[4].rate)
    clouds, truth = simulate_gaps_and_ghosts(walks[4].frames(slice(60, 120)), 3, 0, seed=5)
    labelling = ensemble.adapt(anonymous).label(clouds)
    given = labelling.indices >= 0
    assert (labelling.indices == truth)[given].all()
    assert given.sum() > 0.97 * (truth >= 0).sum()


def test_the_body_of_someone_else_is_told_apart(ensemble: asterism.MarkerModel, walks: list[asterism.Recording], tmp_path: Path) -> None:
    clouds = walks[4].frames(slice(60, 120)).clouds()
    fits = []
    for person in range(5):
        adapted = ensemble.adapt(walks[person].frames(slice(0, 60)))
        adapted.save(tmp_path / "one.model")
        again = asterism.MarkerModel.load(tmp_path / "one.model")
        labelling = again.label(clouds)
        fits.append(again.subject_fit(clouds, labelling))
        assert fits[-1] == adapted.subject_fit(clouds, labelling)
    assert fits[4] > max(OTHER_SUBJECT_FIT, *fits[:4])
    assert sum(fit < OTHER_SUBJECT_FIT for fit in fits[:4]) >= 3  # two of them are much alike
    assert np.isnan(ensemble.subject_fit(clouds, labelling))


def test_trials_that_show_no_body_are_refused(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    mixed = asterism.Recording(walks[4].positions, tuple(reversed(walks[4].labels)), walks[4].rate)
    with pytest.raises(asterism.AsterismError, match="fit no body"):
        ensemble.adapt(mixed)
    nothing = asterism.Recording(np.full((10, 15, 3), np.nan), walks[4].labels, 100.0)
    with pytest.raises(asterism.AsterismError, match="no frame"):
        ensemble.adapt(nothing)


def test_two_points_tell_no_body(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    labelling = ensemble.label(walks[4].select(walks[4].labels[:2]).clouds())
    assert (labelling.indices == -1).all()


def test_a_ghost_in_a_hidden_markers_stead_is_not_given(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    walk, marker = walks[4], walks[4].labels.index("LTIB")
    positions = walk.positions.copy()
    positions[40:70, marker] = np.nan
    frames = [frame[~np.isnan(frame[:, 0])] for frame in positions]
    for t in range(40, 70):  # it rides along 8 cm beside the hidden marker; another, seen apart, says that there are ghosts
        beside, apart = walk.positions[t, marker] + np.array([[0.0, 0.05, 0.06], [0.0, 0.55, 0.86]])
        frames[t] = np.concatenate([frames[t], [beside, apart]])
    labelling = ensemble.label(Clouds.from_points(frames, walk.rate))
    assert (labelling.indices[40:70, marker] == -1).all()
    assert (labelling.indices[:40, marker] >= 0).mean() > 0.9


def test_a_tracklet_that_goes_over_to_another_marker_is_cut_there(
    ensemble: asterism.MarkerModel, walks: list[asterism.Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two knees that exchange their tracklets half-way, as wrong links would have it: no motion shows that to the labelling."""
    names = list(walks[4].labels)
    one, other = names.index("LKNE"), names.index("RKNE")
    clouds = walks[4].clouds()
    tracklets = find_tracklets(clouds)
    of_point = clouds.columns.copy()
    late = clouds.frame_of >= 60
    of_point[late & (clouds.columns == one)], of_point[late & (clouds.columns == other)] = other, one
    frames = np.arange(len(names))
    wrong = replace(tracklets, of_point=of_point, first=0 * frames, last=0 * frames + len(clouds) - 1)
    monkeypatch.setattr("asterism.labelling.whole.label.find_tracklets", lambda _: wrong)
    labelling = ensemble.label(clouds)
    truth = np.stack([np.arange(len(names))[[names.index(name) for name in ensemble.marker_set.names]]] * len(clouds))
    assert (labelling.indices == truth).mean() > 0.98
    given = labelling.indices >= 0
    assert (labelling.indices == truth)[given].mean() > 0.99


def test_a_ghost_fits_worse_than_the_markers(ensemble: asterism.MarkerModel, walks: list[asterism.Recording]) -> None:
    """LKNE is hidden, and a point rides 12 cm beside it: labelled as LKNE it fits worse than nearly all others. Any order, same fits."""
    names, labeller = ensemble.marker_set.names, ensemble.body_labeller
    walk = walks[4]
    positions = walk.positions[:, [walk.labels.index(name) for name in names]].copy()
    positions[:, names.index("LKNE")] += np.array([0.08, 0.09, 0.0])
    clouds = replace(walk, positions=positions, labels=names).clouds()
    label = np.tile(np.arange(len(names)), len(clouds))
    every = np.ones(len(clouds), dtype=bool)

    def fits(order: np.ndarray) -> np.ndarray:
        return point_fits(clouds, clouds.xyz[order], label[order], labeller.body, labeller.settings, every, label[order])

    own = fits(np.arange(len(label)))[: len(names)]
    assert own.argmin() == names.index("LKNE")
    assert own[names.index("LKNE")] < np.median(own) - 4.0
    order = np.concatenate([np.arange(len(names))[::-1] + t * len(names) for t in range(len(clouds))])
    np.testing.assert_array_equal(fits(order), fits(np.arange(len(label)))[order])


def sampled(shows):
    """A scene of as many sampled frames, each of which shows some tracklets."""
    frame, track = np.array([(e, j) for e, tracks in enumerate(shows) for j in tracks]).T
    offsets = np.concatenate([[0], np.cumsum([*map(len, shows)])])
    return SimpleNamespace(
        sampled_frames=np.arange(len(shows)),
        sampled_frame=frame,
        sampled_track=track,
        sampled_offsets=offsets,
        first=np.zeros(1 + track.max()),
    )


def test_so_many_frames_vote_and_one_of_each_tracklet_that_they_do_not_show():
    rules = RecordingLabellingSettings(least_voting=2, voting_interval=5)
    shows = [[0], [0, 1], [0, 1, 2], [0, 2], [0, 3], [0, 3, 4], [0]]
    assert voting_frames(sampled(shows), rules).tolist() == [0, 1, 2, 4, 5, 6]
    assert voting_frames(sampled([[0]] * 2), rules).tolist() == [0, 1]
    assert voting_frames(sampled([[0]] * 30), rules).tolist() == [0, 6, 12, 17, 23, 29], "one in five"
