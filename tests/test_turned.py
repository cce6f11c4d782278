"""No body turned round: standing people by a model of walkers, in frames, whole recordings and streams; and what a body's twins are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from models import trained
from standing import MARKER_SET, standing_clouds

import asterism
from asterism.labelling import virtual_model
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.body.twins import neighbours_of, twins_of
from asterism.labelling.whole.joint import label_scene
from asterism.labelling.whole.scene import RecordingScene, prepare_scene
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.turned import Exchanges, hold_against_twins, is_poor, joint_evidence
from asterism.recording import Clouds, Ints, Labelling, MarkerSet
from asterism.simulation import simulate_walks
from asterism.skeleton import virtual_people
from asterism.tracking.linking import find_tracklets

NAMES = MARKER_SET.names


@pytest.fixture(scope="module")
def walkers() -> asterism.MarkerModel:
    """A model of six simulated walkers, who never stand with their feet apart."""
    return trained(simulate_walks(subjects=6, frames=120, seed=100))


def in_stream(model: asterism.MarkerModel, clouds: Clouds) -> Labelling:
    stream = model.stream(rate=clouds.rate)
    found = [stream.push(clouds.xyz[clouds.offsets[t] : clouds.offsets[t + 1]]) for t in range(len(clouds))]
    given = [labels for labels in found if labels is not None]
    return Labelling(np.array([labels.indices for labels in given]), np.array([labels.confidence for labels in given]), NAMES)


@pytest.mark.parametrize("how", ["whole", "frames", "stream"])
@pytest.mark.parametrize("seed", [1, 7, 33, 48])
def test_a_person_who_stands_with_the_feet_apart_is_not_labelled_turned_round(walkers: asterism.MarkerModel, seed: int, how: str) -> None:
    """Each of them was, in one of the three ways at least, with every marker in view; what is labelled is right, and most is."""
    clouds, order = standing_clouds(seed)
    found = in_stream(walkers, clouds) if how == "stream" else (walkers.label(clouds) if how == "whole" else walkers.label_frames(clouds))
    frame, marker = np.nonzero(found.indices >= 0)
    right = order[frame, found.indices[frame, marker]] == marker
    assert right.all(), f"{(~right).sum()} of {len(right)} labels wrong, as {sorted({NAMES[m] for m in marker[~right]})}"
    assert right.sum() >= (0.7 if how == "whole" else 0.2) * order.size


def named(twin: np.ndarray) -> dict[str, str]:
    """Whose point each marker that moves has in a twin; "-" where the other labels tell."""
    return {NAMES[m]: NAMES[other] if other >= 0 else "-" for m, other in enumerate(twin) if other != m}


def test_the_twins_of_a_body_are_turned_and_mirrored_as_a_whole_and_in_part(walkers: asterism.MarkerModel) -> None:
    found = [named(twin) for twin in twins_of(walkers.state.body)]
    sides = {name: other + name[1:] for name in NAMES for side, other in ("LR", "RL") if name[0] == side and other + name[1:] in NAMES}
    assert found[0] == sides, "mirrored"
    legs = {name: other for name, other in sides.items() if name[1:] != "ASI"}
    assert legs in found, "the legs mirrored"
    feet = {"LHEE": "RTOE", "RHEE": "LTOE", "LTOE": "RHEE", "RTOE": "LHEE"}
    assert {**sides, **feet} in found, "turned, with the pelvis mirrored"
    turned = [twin for twin in found if feet.items() <= twin.items()]
    assert any(twin["LASI"] == "-" for twin in turned), "turned, with the pelvis left open"
    thirds = [{"RASI": "LASI", "LASI": "SACR", "SACR": "RASI"}, {"RASI": "SACR", "SACR": "LASI", "LASI": "RASI"}]
    assert all(third in found for third in thirds), "the pelvis turned by a third"


def test_a_twin_gives_no_point_twice(walkers: asterism.MarkerModel) -> None:
    for twin in twins_of(walkers.state.body):
        given = twin[twin >= 0]
        assert len(np.unique(given)) == len(given)
        assert (twin != np.arange(len(NAMES))).sum() >= 3


def walk_of_a_stranger(frames: int = 60, beside: str = "", shown: slice = slice(None)) -> tuple[RecordingScene, Ints]:
    """A walk of a person whom the model does not know, every marker in view, and the right labels (J,) of its tracklets.

    beside: a marker 3 cm above which another one without a name is worn; shown: the frames that show it.
    """
    walk = simulate_walks(subjects=1, frames=frames, seed=300)[0]
    labels = [NAMES.index(name) for name in walk.labels]
    if beside:
        other = np.full((frames, 1, 3), np.nan)
        other[shown, 0] = walk.positions[shown, walk.labels.index(beside)] + [0.0, 0.0, 0.03]
        walk = replace(walk, positions=np.concatenate([walk.positions, other], axis=1), labels=(*walk.labels, "other"))
        labels.append(-1)
    clouds = walk.clouds()
    scene = prepare_scene(clouds, find_tracklets(clouds), RecordingLabellingSettings())
    right = np.empty(len(scene.first), dtype=np.int64)
    right[scene.track] = np.array(labels)[clouds.columns[scene.order]]
    return scene, right


CHANGES = [("LANK", "LHEE"), ("RTHI", "RKNE"), ("RTIB", "RANK", "RHEE"), ("RASI", "LASI", "SACR"), ("LANK", "LTOE", "LHEE")]


@pytest.mark.parametrize("markers", CHANGES, ids=" ".join)
def test_exchanged_neighbours_are_held_against_their_exchange(walkers: asterism.MarkerModel, markers: tuple[str, ...]) -> None:
    """Labels that go round among two or three neighbours are mended; the right ones stay, and are ahead of every other way."""
    scene, right = walk_of_a_stranger()
    settings, labeller = RecordingLabellingSettings(), walkers.body_labeller
    columns = [NAMES.index(name) for name in markers]
    exchanged = np.arange(len(NAMES))
    exchanged[columns] = columns[1:] + columns[:1]
    for start in (exchanged[right], right):
        held = hold_against_twins([labeller], scene, start, lambda label, _: label, settings.twins, settings)
        np.testing.assert_array_equal(held.label, right)
        assert (held.over_exchanges[columns] > 0.0).all()
        limits = held.limits(right, settings.twins, with_exchanges=True)
        assert (limits <= held.limits(right, settings.twins, with_exchanges=False)).all()


@pytest.mark.parametrize("seed", range(4))
def test_an_ascent_does_not_end_below_where_it_began(walkers: asterism.MarkerModel, seed: int) -> None:
    """By the joint evidence of labels that give points to the same tracklets, begun with some of the labels exchanged."""
    scene, right = walk_of_a_stranger()
    settings, rng, start = RecordingLabellingSettings(), np.random.default_rng(seed), right.copy()
    some = rng.choice(len(right), 2 + seed, replace=False)
    start[some] = right[np.roll(some, 1)]
    found = label_scene([walkers.body_labeller], scene, settings, SubjectRules(), walkers.state.body_rules, start=start)
    for label in (found.stages["tracks"], found.stages["twin"], found.label):
        np.testing.assert_array_equal(label >= 0, right >= 0)
        assert joint_evidence([walkers.body_labeller], scene, label) >= joint_evidence([walkers.body_labeller], scene, start) - 1e-6
    np.testing.assert_array_equal(found.label, right)


def test_better_permutations_are_taken_best_first_and_each_marker_once() -> None:
    table = np.array([[1, 0, 2, 3, 4], [0, 2, 1, 3, 4], [0, 1, 2, 4, 3], [2, 0, 1, 3, 4]])
    exchanges = Exchanges(table, np.array([-1.0, -3.0, 2.0, 5.0]), np.zeros((5, 5)))
    found = exchanges.best()
    assert found is not None
    assert found.tolist() == [0, 2, 1, 3, 4], "the first is worse than the second, with which it shares a marker"
    assert exchanges.lead().tolist() == [-1.0, -3.0, -3.0, 2.0, 2.0]
    assert Exchanges(table, np.ones(4), np.zeros((5, 5))).best() is None
    assert np.isinf(Exchanges(table[:0], np.ones(0), np.zeros((5, 5))).lead()).all()


def test_neighbours_are_groups_of_four(walkers: asterism.MarkerModel) -> None:
    groups = neighbours_of(walkers.state.body)
    assert groups.shape[1] == 4
    assert len(np.unique(groups, axis=0)) == len(groups)
    assert set(groups.ravel().tolist()) == set(range(len(NAMES)))
    assert any({"RASI", "LASI", "SACR"} <= {NAMES[m] for m in group} for group in groups)


def test_labels_that_leave_points_over_and_fit_poorly_are_never_sure(walkers: asterism.MarkerModel) -> None:
    """Each leg is labelled one marker along; the right labels are not poor, nor are they where four of them are left out."""
    scene, right = walk_of_a_stranger()
    settings, labeller = RecordingLabellingSettings(), walkers.body_labeller
    assert not is_poor([labeller], scene, right, 0, settings.twins)
    fewer = np.where(np.isin(right, [NAMES.index(name) for name in ("LTIB", "RTIB", "LHEE", "RHEE")]), -1, right)
    assert not is_poor([labeller], scene, fewer, 0, settings.twins)
    along = right.copy()
    for side in "LR":
        down = [NAMES.index(side + name) for name in ("THI", "KNE", "TIB", "ANK", "HEE", "TOE")]
        for one, other in zip(down, [*down[2:], -1, -1], strict=True):
            along[right == one] = other
    assert is_poor([labeller], scene, along, 0, settings.twins)

    held = hold_against_twins([labeller], scene, along, lambda label, _: label, replace(settings.twins, rounds=0), settings)
    assert held.poor.all()
    assert (held.limits(np.arange(len(NAMES)), settings.twins, with_exchanges=False) < 0.99).all()


@pytest.mark.parametrize("marker", ["SACR", "RTHI", "LKNE"])
def test_a_marker_beside_a_point_without_a_name_is_not_sure(walkers: asterism.MarkerModel, marker: str) -> None:
    """Once for the person: which of the two is the marker, no other frame tells. Its label stays, and far ones are as sure as before."""
    settings, column = RecordingLabellingSettings(), NAMES.index(marker)
    limits, found = {}, {}
    for which, shown in (("always", slice(None)), ("halves", slice(0, 45)), ("ghost", slice(0, 20))):
        scene, right = walk_of_a_stranger(beside=marker, shown=shown)
        held = hold_against_twins(
            [walkers.body_labeller], scene, right, lambda label, _: label, replace(settings.twins, rounds=0), settings
        )
        found[which] = held
        limits[which] = held.limits(np.arange(len(NAMES)), settings.twins, with_exchanges=True)
        np.testing.assert_array_equal(held.label, right)
    assert found["always"].over_others[column] < 5.0
    assert found["halves"].over_others[column] < 5.0, "a gap takes no point off"
    assert np.isinf(found["ghost"].over_others).all(), "which comes and goes"
    assert limits["always"][column] < 0.99
    without = replace(found["always"], over_others=np.full(len(NAMES), np.inf))
    before = without.limits(np.arange(len(NAMES)), settings.twins, with_exchanges=True)
    assert limits["always"][column] >= min(before[column], 0.98), "no label is taken back for it"
    assert (found["always"].over_others > 5.6).sum() >= len(NAMES) // 2


def test_a_body_is_tried_without_the_markers_that_many_leave_out() -> None:
    """Elbows are called markers of the upper arm, and wrists and hands have no name: no exchange gives them one."""
    marker_set = MarkerSet.load("plug-in-gait")
    names, labeller, settings = marker_set.names, virtual_model(marker_set).body_labeller, RecordingLabellingSettings()
    person = virtual_people(marker_set, 2, 60, seed=9)[0]
    clouds = person.select([name for name in names if name[1:] not in ("UPA", "FRM")]).clouds()
    scene = prepare_scene(clouds, find_tracklets(clouds), settings)
    place = {tuple(at): m for frame in person.positions for m, at in enumerate(frame)}
    right = np.empty(len(scene.first), dtype=np.int64)
    right[scene.track] = [place[tuple(at)] for at in scene.xyz]
    along = right.copy()
    for side in "LR":
        for one, other in (("ELB", "UPA"), ("WRA", None), ("WRB", None), ("FIN", None)):
            along[right == names.index(side + one)] = -1 if other is None else names.index(side + other)

    # an ascent that stays where it is, unless the upper arm's marker is out of the question
    def ascent(start: Ints, without: Ints) -> Ints:
        return right if names.index("LUPA") in without else start

    # no twin is completed, which would find wrists and hands by itself
    held = hold_against_twins([labeller], scene, along, ascent, replace(settings.twins, gap=-1e9), settings)
    np.testing.assert_array_equal(held.label, right)


def test_distances_may_be_those_of_all_people_where_many_taught_the_model() -> None:
    """Key poses are of the mean person: the rods and elbows of others sit elsewhere."""
    labeller = virtual_model("plug-in-gait").body_labeller
    low, high = labeller.distance_range
    least, most = replace(labeller, many_people=False).distance_range
    apart = ~np.eye(len(low), dtype=bool)
    assert (low[apart] < least[apart]).all()
    assert (high[apart] > most[apart]).all()
    names = MarkerSet.load("plug-in-gait").names
    rod, knee = names.index("LTHI"), names.index("LKNE")
    assert (high - low - (most - least))[rod, knee] > 0.05, "rods sit 14 % of the thigh higher or lower"


def test_frames_that_vote_search_farther_than_frames_by_themselves(walkers: asterism.MarkerModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """The votes of few frames begin all labels."""
    asked, label_frames = list[int](), BodyLabeller.label_frames

    def counted(labeller: BodyLabeller, *given: Any, **named: Any) -> Any:
        asked.append(labeller.settings.max_evaluations)
        return label_frames(labeller, *given, **named)

    monkeypatch.setattr(BodyLabeller, "label_frames", counted)
    walkers.label(simulate_walks(subjects=1, frames=30, seed=3)[0].clouds())
    assert min(asked) >= 10 * walkers.body_labeller.settings.max_evaluations
