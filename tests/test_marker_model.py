"""The solver ensemble's contract, on walkers whose truth is known: what may change nothing, what must end in nulls, what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import BRIEF, SHORT, trained

from asterism import AsterismError, Clouds, MarkerModel, MarkerSet, Recording
from asterism.labelling import TrainingRules
from asterism.labelling.partial.matrix import label_by_matrix
from asterism.labelling.partial.search_strategies import search_partial_solvers
from asterism.labelling.partial.solver import stack_frames
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES
from asterism.recording import subject_of
from asterism.simulation import simulate_occlusions, simulate_walks

QUICK = {"miner": None, "training": replace(SHORT, folds=5)}
QUICKEST = {"miner": None, "training": BRIEF}
rooms = settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def walkers():
    """Twelve people; the last two are never trained on."""
    return simulate_walks(subjects=12, frames=120, rate=30.0, seed=1)


@pytest.fixture(scope="module")
def model(walkers):
    return trained(walkers[:10], **QUICK)


@pytest.fixture(scope="module")
def stranger(walkers):
    """Every fourth frame of a person whom the model has not seen."""
    return walkers[11].frames(slice(None, None, 4))


@pytest.fixture(scope="module")
def hard(stranger):
    """Two markers hidden and a ghost in every frame: clouds and truth."""
    return simulate_occlusions(stranger, 2, 1, seed=4)


@pytest.fixture(scope="module")
def few():
    """Little to learn from: four people, forty frames each."""
    return simulate_walks(subjects=4, frames=40, rate=20.0, seed=2)


@pytest.fixture(scope="module")
def small(few):
    return trained(few, **QUICKEST)


@pytest.fixture(scope="module")
def saved(small, tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "small.model"
    small.save(path)
    return path


def rates(labelling, truth):
    """(share of the visible markers that got their point, share of wrong ones among the labels given)."""
    label = labelling.indices >= 0
    right = label & (labelling.indices == truth)
    return right.sum() / (truth >= 0).sum(), 1.0 - right.sum() / max(1, label.sum())


def check_well_formed(labelling, clouds):
    """No candidate twice in a frame, none that is not there, confidence a probability."""
    assert labelling.indices.shape == labelling.confidence.shape == (len(clouds), len(labelling.names))
    assert ((labelling.confidence >= 0.0) & (labelling.confidence <= 1.0)).all()
    for row, count in zip(labelling.indices, clouds.counts, strict=True):
        given = row[row >= 0]
        assert len(set(given)) == len(given), "one candidate under two labels"
        assert (row >= -1).all() and (row < count).all()


def turned(clouds, angle, shift):
    cos, sin = np.cos(angle), np.sin(angle)
    return replace(clouds, xyz=clouds.xyz @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + shift)


# --- how well it labels people whom it has not seen


@pytest.mark.parametrize(
    ("occlusions", "ghosts", "least_right", "most_wrong"),
    [(0, 0, 0.99, 0.001), (1, 0, 0.98, 0.003), (3, 0, 0.95, 0.01), (0, 3, 0.93, 0.005), (3, 3, 0.93, 0.02)],
)
def test_walkers_never_seen_are_labelled(model, walkers, occlusions, ghosts, least_right, most_wrong):
    for person, recording in enumerate(walkers[10:]):
        clouds, truth = simulate_occlusions(recording, occlusions, ghosts, seed=person)
        labelling = model.label_frames(clouds)
        check_well_formed(labelling, clouds)
        right, wrong = rates(labelling, truth)
        assert right >= least_right, f"{right:.2%} of the visible markers are right, at least {least_right:.0%} asked"
        assert wrong <= most_wrong, f"{wrong:.2%} of the labels are wrong, at most {most_wrong:.1%} allowed"


def test_exchanged_truth_is_noticed(model, hard):
    """The measure above can fail: with two markers' truth exchanged, they count as wrong."""
    clouds, truth = hard
    labelling = model.label_frames(clouds)
    swapped = truth[:, [1, 0, *range(2, truth.shape[1])]]
    assert rates(labelling, swapped)[1] > rates(labelling, truth)[1] + 0.1


def test_labels_given_are_at_least_as_sure_as_asked(model, hard):
    labelling = model.label_frames(hard[0])
    given = labelling.indices >= 0
    assert given.any() and not given.all()
    assert labelling.confidence[given].min() >= model.least_confidence
    assert labelling.confidence[~given].max() < model.least_confidence


# --- what must not change a label


@given(seed=st.integers(0, 2**31))
@rooms
def test_the_order_of_the_points_changes_nothing(model, hard, seed):
    clouds, _ = hard
    rng = np.random.default_rng(seed)
    order = np.concatenate([start + rng.permutation(n) for start, n in zip(clouds.offsets[:-1], clouds.counts, strict=True)])
    shuffled = replace(clouds, xyz=clouds.xyz[order])
    one, other = model.label_frames(clouds), model.label_frames(shuffled)
    np.testing.assert_array_equal(other.positions(shuffled), one.positions(clouds))
    np.testing.assert_array_equal(other.confidence, one.confidence)


@given(angle=st.floats(-7.0, 7.0), shift=st.tuples(*[st.floats(-20.0, 20.0)] * 3))
@rooms
def test_where_the_body_stands_and_faces_changes_nothing(model, hard, angle, shift):
    one, other = model.label_frames(hard[0]), model.label_frames(turned(hard[0], angle, shift))
    np.testing.assert_array_equal(other.indices, one.indices)
    np.testing.assert_allclose(other.confidence, one.confidence, atol=1e-5)


@given(direction=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1))
@rooms
def test_any_axis_may_be_up_if_it_is_told(model, hard, direction):
    """The room is turned so that its vertical points along `direction`."""
    clouds, _ = hard
    up = np.array(direction) / np.linalg.norm(direction)
    aside = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    aside /= np.linalg.norm(aside)
    axes = np.stack([aside, np.cross(up, aside), up])
    assert np.linalg.det(axes) == pytest.approx(1.0)
    told = replace(clouds, xyz=clouds.xyz @ axes, vertical=up)
    np.testing.assert_array_equal(model.label_frames(told).indices, model.label_frames(clouds).indices)


def test_a_wrong_vertical_is_not_labelled_away(model, hard):
    """The opposite of the above: a body that lies on its side, told to stand, is left unlabelled for the most part."""
    clouds, truth = hard
    lying = replace(clouds, vertical=np.array([1.0, 0.0, 0.0]))
    assert (model.label_frames(lying).indices >= 0).mean() < 0.2
    assert rates(model.label_frames(clouds), truth)[0] > 0.9


@pytest.mark.parametrize("workers", [2, 3, 50])
def test_the_number_of_workers_changes_nothing(model, hard, workers):
    one, other = model.label_frames(hard[0]), model.label_frames(hard[0], workers=workers)
    np.testing.assert_array_equal(other.indices, one.indices)
    np.testing.assert_array_equal(other.confidence, one.confidence)


def test_each_frame_stands_alone(model, hard):
    clouds, _ = hard
    whole = model.label_frames(clouds)
    alone = model.label_frames(Clouds.from_points([clouds[7]], clouds.rate))
    np.testing.assert_array_equal(alone.indices[0], whole.indices[7])
    np.testing.assert_array_equal(alone.confidence[0], whole.confidence[7])


def test_the_clouds_are_left_as_they_were(model, hard):
    before = hard[0].xyz.copy()
    model.label_frames(hard[0])
    np.testing.assert_array_equal(hard[0].xyz, before)


def test_a_mirrored_body_has_its_sides_exchanged(model, stranger):
    """A body and its mirror image differ in handedness alone: the mirrored left knee is where a right knee would be, never a left one."""
    mirrored = replace(stranger, positions=stranger.positions * np.array([1.0, -1.0, 1.0]))
    names = stranger.labels
    sides = {"L": "R", "R": "L"}
    partner = np.array([names.index(sides[name[0]] + name[1:]) if name[0] in sides else m for m, name in enumerate(names)])
    labelling = model.label_frames(mirrored.clouds())
    given = labelling.indices >= 0
    exchanged, kept = labelling.indices == partner, labelling.indices == np.arange(len(names))
    sided = partner != np.arange(len(names))
    assert given.mean() > 0.9
    assert exchanged[given].mean() > 0.99
    assert not kept[:, sided].any()


# --- odd frames


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_points_stay_unlabelled(model, stranger, count):
    clouds = Clouds.from_points([stranger.positions[0, :count], stranger.positions[5, :count]], 30.0)
    labelling = model.label_frames(clouds)
    check_well_formed(labelling, clouds)
    assert (labelling.indices == -1).all()


def test_no_frames_give_no_labels(model):
    clouds = Clouds.from_points([], 30.0)
    assert model.label_frames(clouds).indices.shape == (0, 15)
    assert model.label_frames(clouds, workers=3).confidence.shape == (0, 15)


def test_an_empty_frame_between_others_changes_nothing(model, stranger):
    full = Clouds.from_points([stranger.positions[0], stranger.positions[1]], 30.0)
    holed = Clouds.from_points([stranger.positions[0], [], stranger.positions[1]], 30.0)
    np.testing.assert_array_equal(model.label_frames(holed).indices[[0, 2]], model.label_frames(full).indices)
    assert (model.label_frames(holed).indices[1] == -1).all()


@pytest.mark.parametrize("count", [3, 15, 60])
def test_points_that_all_coincide_stay_unlabelled(model, count):
    clouds = Clouds.from_points([np.full((count, 3), 1.0)], 30.0)
    labelling = model.label_frames(clouds)
    check_well_formed(labelling, clouds)
    assert (labelling.indices == -1).all()


def test_a_marker_seen_twice_is_one_label(model, stranger):
    """Each point doubled, 1 mm apart: no label goes to both, and the ones given are at the right place."""
    twice = np.concatenate([stranger.positions[0], stranger.positions[0] + 0.001])
    clouds = Clouds.from_points([twice], 30.0)
    labelling = model.label_frames(clouds)
    check_well_formed(labelling, clouds)
    given = labelling.indices[0] >= 0
    assert (labelling.indices[0, given] % 15 == np.nonzero(given)[0]).all()


def test_five_hundred_points_that_are_nobody_are_not_a_body(model):
    rng = np.random.default_rng(3)
    clouds = Clouds.from_points([rng.uniform(-1.5, 1.5, (500, 3)) for _ in range(2)], 30.0)
    labelling = model.label_frames(clouds)
    check_well_formed(labelling, clouds)
    assert (labelling.indices >= 0).mean() < 0.2, "a crowd of random points was taken for a body"


def test_a_body_is_found_among_two_hundred_ghosts(model, stranger):
    clouds, truth = simulate_occlusions(stranger.frames(slice(0, 3)), 0, 200, seed=1)
    labelling = model.label_frames(clouds)
    check_well_formed(labelling, clouds)
    wrong = ((labelling.indices >= 0) & (labelling.indices != truth)).mean()
    assert wrong < 0.1, f"{wrong:.1%} of the markers got a ghost"


@given(seed=st.integers(0, 2**31), counts=st.lists(st.integers(0, 40), min_size=1, max_size=4))
@rooms
def test_whatever_comes_in_the_answer_is_well_formed(model, seed, counts):
    rng = np.random.default_rng(seed)
    clouds = Clouds.from_points([rng.normal(0.0, rng.choice([1e-9, 0.3, 1.0, 1e6]), (n, 3)).round(2) for n in counts], 30.0)
    check_well_formed(model.label_frames(clouds), clouds)


# --- training


@pytest.mark.usefixtures("training_anew")
def test_the_same_recordings_and_seed_give_the_same_model(few, saved, tmp_path):
    MarkerModel.fit(few, **QUICKEST).save(tmp_path / "again.model")
    assert (tmp_path / "again.model").read_bytes() == saved.read_bytes()


def test_another_seed_gives_another_model(few, saved, tmp_path):
    MarkerModel.fit(few, seed=1, **QUICKEST).save(tmp_path / "other.model")
    assert (tmp_path / "other.model").read_bytes() != saved.read_bytes()


def test_a_stricter_target_gives_no_more_labels(few, small):
    """Same seed, same margins: what the strict model labels the lenient one labels alike."""
    lenient = MarkerModel.fit(few, target_hit_rate=0.9, **QUICKEST)
    assert lenient.least_confidence < small.least_confidence
    clouds, _ = simulate_occlusions(few[0], 4, 2)
    strict, free = small.label_frames(clouds).indices, lenient.label_frames(clouds).indices
    assert (strict >= 0).sum() < (free >= 0).sum()
    np.testing.assert_array_equal(free[strict >= 0], strict[strict >= 0])


def test_recordings_in_rooms_with_different_verticals_are_one_training_set(few, small):
    """Half of the recordings told with Y up: the same bodies, the same model up to rounding."""
    other = simulate_walks(subjects=4, frames=40, rate=20.0, seed=2, vertical="y")
    mixed = MarkerModel.fit([few[0], other[1], few[2], other[3]], **QUICKEST)
    np.testing.assert_array_equal(mixed.label_frames(few[0].clouds()).indices, small.label_frames(few[0].clouds()).indices)


def test_gaps_in_the_training_data_are_bridged(few):
    """A tenth of all samples missing: still at least 90 % right on whole frames."""
    rng = np.random.default_rng(0)
    holed = [replace(r, positions=np.where(rng.random(r.visible.shape)[:, :, None] < 0.1, np.nan, r.positions)) for r in few]
    model = MarkerModel.fit(holed, **QUICKEST)
    right, wrong = rates(model.label_frames(few[0].clouds()), np.tile(np.arange(15), (40, 1)))
    assert right > 0.9
    assert wrong < 0.01


def test_a_marker_that_no_recording_shows_is_a_null_column(few):
    positions = [r.positions.copy() for r in few]
    for p in positions:
        p[:, 4] = np.nan
    bare = [replace(r, positions=p) for r, p in zip(few, positions, strict=True)]
    model = MarkerModel.fit(bare, **QUICKEST)
    assert model.marker_set.names == few[0].labels
    for recording in (few[0], bare[0]):
        labelling = model.label_frames(recording.clouds())
        assert (labelling.indices[:, 4] == -1).all()
        assert (labelling.confidence[:, 4] == 0.0).all()
    others = np.delete(np.arange(15), 4)
    assert (labelling.indices[:, others] == np.arange(14)).mean() > 0.95


def test_one_person_is_enough_to_train(few):
    model = MarkerModel.fit(few[:1], **QUICKEST)
    right, wrong = rates(model.label_frames(few[0].clouds()), np.tile(np.arange(15), (40, 1)))
    assert right > 0.9
    assert wrong == 0.0


@pytest.mark.parametrize("rate", [0.0, 0.3, 1.0, 1.5, float("nan")])
def test_a_target_that_makes_no_sense_is_refused(few, rate):
    with pytest.raises(AsterismError, match="target hit rate"):
        MarkerModel.fit(few, target_hit_rate=rate, **QUICKEST)


def test_nothing_to_learn_from_is_refused():
    with pytest.raises(AsterismError, match="no recording to learn from"):
        MarkerModel.fit([])


def test_too_few_frames_are_refused(few):
    with pytest.raises(AsterismError, match="9 frames show at least half"):
        MarkerModel.fit([few[0].frames(slice(0, 9))], **QUICKEST)


def test_frames_that_show_too_little_are_refused(few):
    bare = few[0].positions.copy()
    bare[:, 5:] = np.nan
    bare[0] = few[0].positions[0]
    with pytest.raises(AsterismError, match="1 frames show at least half"):
        MarkerModel.fit([replace(few[0], positions=bare)], **QUICKEST)


def test_too_few_markers_are_refused(few):
    with pytest.raises(AsterismError, match="training needs 4 markers"):
        MarkerModel.fit([few[0].select(few[0].labels[:3])], **QUICKEST)


def test_recordings_whose_markers_differ_teach_those_that_most_people_wear(few):
    """In the order of the first, whatever the columns of the others; what is left out is named."""
    names = few[0].labels
    assert len(few) == 4 and len({subject_of(recording) for recording in few}) == 4
    differing = [few[0], few[1].select(names[::-1]), few[2].select(names[1:-1]), replace(few[3], labels=(*names[:-1], "*7"))]
    model = MarkerModel.fit(differing, **QUICKEST)
    assert model.marker_set.names == names[:-1]
    assert model.about["left_out_markers"] == [names[-1]]
    given = MarkerModel.fit(differing, marker_set=MarkerSet(names[:-1]), **QUICKEST)
    clouds = few[0].clouds()
    np.testing.assert_array_equal(model.label_frames(clouds).indices, given.label_frames(clouds).indices)
    np.testing.assert_array_equal(model.label_frames(clouds).confidence, given.label_frames(clouds).confidence)
    assert MarkerModel.fit(few, **QUICKEST).about["left_out_markers"] == []


def test_recordings_that_share_too_few_markers_are_refused(few):
    names = few[0].labels
    other = replace(few[1], labels=tuple(name if i < 3 else f"other {i}" for i, name in enumerate(names)))
    with pytest.raises(AsterismError, match="share 3 labelled markers, fewer than 4; name the set"):
        MarkerModel.fit([few[0], other], **QUICKEST)


def test_subjects_are_one_per_recording(few):
    with pytest.raises(AsterismError, match="1 subjects for 4 recordings"):
        MarkerModel.fit(few, subjects=["Ann"], **QUICKEST)


def test_progress_never_goes_back_and_ends_at_one(few, small):
    told = []
    MarkerModel.fit(few, progress=lambda fraction, what: told.append((fraction, what)), **QUICKEST)
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 1.0
    assert all(what for _, what in told)
    told.clear()
    small.label_frames(few[0].clouds(), workers=2, progress=lambda fraction, what: told.append(fraction))
    assert told == sorted(told) and told[-1] == 1.0


def test_rules_that_do_not_exist_are_refused(small, few):
    with pytest.raises(AsterismError, match="choose from whole-body"):
        small.label_frames(few[0].clouds(), method="half-body")


def test_the_thesis_rules_need_their_solvers(small, few):
    with pytest.raises(AsterismError, match="train it again with --partial-solvers bottom-up"):
        small.label_frames(few[0].clouds(), method="thesis")


def test_confidence_by_the_thesis_rules_is_the_share_of_votes(small, few):
    """Of the solvers trusted with a marker, the share that propose the point; nothing where none proposes one."""
    frames, groups = stack_frames(few)
    settings = replace(
        PRINTED,
        screening_frames=60,
        evaluation_frames=100,
        validation_frames=100,
        beam_width=15,
        max_markers=5,
        max_solvers=60,
        coverage_patterns=500,
        large_subsets=5,
    )
    solvers = search_partial_solvers(frames, groups, targets=0.97, features=PRINTED_FEATURES[:5], settings=settings, seed=0)
    solvers = replace(solvers, trusted=solvers.trusted & (solvers.solvers.markers != 3))
    model = MarkerModel(replace(small.state, solvers={"thesis": solvers}))
    clouds, _ = simulate_occlusions(few[0], 2, 1, seed=0)
    labelling, votes = model.label_frames(clouds, method="thesis"), label_by_matrix(clouds, solvers, rules="printed")
    given, shares = labelling.indices >= 0, votes.votes
    np.testing.assert_array_equal(labelling.indices, votes.indices)
    np.testing.assert_array_equal(labelling.confidence[given], shares[given])
    assert len(np.unique(labelling.confidence[given])) > 3, "the votes are divided, so that it is no constant"
    proposed = ~given & (shares > 0)
    np.testing.assert_array_equal(labelling.confidence[proposed], 0.5 * shares[proposed])
    assert np.isnan(labelling.confidence[~given & (shares == 0)]).all()
    assert np.isnan(labelling.confidence[:, 3]).all(), "no solver is trusted with it"
    with pytest.raises(AsterismError, match="partial-solvers"):
        model.label_frames(clouds, method="partial-solvers")


@pytest.mark.parametrize(
    ("rules", "words"),
    [({"marker_targets": {"LTHI": 1.5}}, "LTHI"), ({"solver_rules": ("whole-body",)}, "choose among partial-solvers, thesis")],
)
def test_training_rules_that_make_no_sense_are_refused(rules, words):
    with pytest.raises(AsterismError, match=words):
        TrainingRules(**rules)


# --- the file


def test_a_model_read_back_is_the_same_model(small, saved, few, tmp_path):
    again = MarkerModel.load(saved)
    assert again.marker_set == small.marker_set
    assert again.least_confidence == small.least_confidence
    assert again.about == small.about
    clouds, _ = simulate_occlusions(few[1], 2, 2)
    one, other = small.label_frames(clouds), again.label_frames(clouds)
    np.testing.assert_array_equal(other.indices, one.indices)
    np.testing.assert_array_equal(other.confidence, one.confidence)
    again.save(tmp_path / "again.model")
    assert (tmp_path / "again.model").read_bytes() == saved.read_bytes()


def test_the_marker_set_travels_with_the_model(few, tmp_path):
    marker_set = MarkerSet.load("helen-hayes")
    MarkerModel.fit(few, marker_set=marker_set, **QUICKEST).save(tmp_path / "named.model")
    assert MarkerModel.load(tmp_path / "named.model").marker_set == marker_set


def test_the_file_holds_no_pickle(saved):
    with np.load(saved, allow_pickle=False) as file:
        head = json.loads(file["head"].tobytes())
        assert all(file[name].dtype != object for name in file.files)
    assert (head["format"], head["version"]) == ("asterism-model", 3)


def test_saving_leaves_nothing_else_behind(small, tmp_path):
    (tmp_path / "one.model").write_bytes(b"an older one")
    small.save(tmp_path / "one.model")
    assert [path.name for path in tmp_path.iterdir()] == ["one.model"]
    MarkerModel.load(tmp_path / "one.model")


def test_a_place_that_cannot_be_written_is_a_sentence(small, tmp_path):
    with pytest.raises(AsterismError, match="cannot be written"):
        small.save(tmp_path / "no such folder" / "one.model")


def with_head(saved, path, **changes):
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    head = json.loads(arrays["head"].tobytes()) | changes
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)
    with path.open("wb") as out:
        np.savez_compressed(out, **arrays)
    return path


def test_a_later_version_is_refused_with_the_mend(saved, tmp_path):
    with pytest.raises(AsterismError, match=r"later Asterism \(model format 99\); update Asterism"):
        MarkerModel.load(with_head(saved, tmp_path / "later.model", version=99))


@pytest.mark.parametrize(
    "changes",
    [{"format": "other"}, {"look": {"reward": 1.0, "taste": 2}}, {"marker_set": {}}, {"version": "one"}, {"usual_score": None}],
    ids=lambda changes: next(iter(changes)),
)
def test_a_head_that_makes_no_sense_is_refused(saved, tmp_path, changes):
    with pytest.raises(AsterismError, match=r"odd\.model"):
        MarkerModel.load(with_head(saved, tmp_path / "odd.model", **changes))


def test_arrays_that_do_not_fit_each_other_are_refused(saved, tmp_path):
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    for name in ("body_mean", "anchor_low", "markers", "anchor_triples"):
        with (tmp_path / "odd.model").open("wb") as out:
            np.savez_compressed(out, **{**arrays, name: arrays[name][:, :-1] if arrays[name].ndim > 1 else arrays[name][:-1]})
        with pytest.raises(AsterismError, match="damaged"):
            MarkerModel.load(tmp_path / "odd.model")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY", b"c3d" * 1000], ids=["empty", "zip head", "npy head", "other"])
def test_files_that_are_no_model_are_refused(tmp_path, content):
    (tmp_path / "no.model").write_bytes(content)
    with pytest.raises(AsterismError, match=r"no\.model"):
        MarkerModel.load(tmp_path / "no.model")


@pytest.mark.parametrize(("name", "sentence"), [("absent.model", "does not exist"), (".", "is a folder")])
def test_a_missing_file_is_refused(tmp_path, name, sentence):
    with pytest.raises(AsterismError, match=sentence):
        MarkerModel.load(tmp_path / name)


@given(seed=st.integers(0, 2**31), flips=st.integers(1, 8), kept=st.one_of(st.just(1.0), st.floats(0.0, 1.0)))
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_model_is_refused_or_labels_as_before(small, saved, few, tmp_path, seed, flips, kept):
    rng = np.random.default_rng(seed)
    content = bytearray(saved.read_bytes())
    # half of the flips hit the archive's directory at the end, where its fields are
    for place in rng.integers(0, len(content), flips) if seed % 2 else rng.integers(len(content) - 1200, len(content), flips):
        content[place] ^= 1 << rng.integers(8)
    (tmp_path / "damaged.model").write_bytes(content[: round(kept * len(content))])
    try:
        model = MarkerModel.load(tmp_path / "damaged.model")
    except AsterismError as problem:
        assert "damaged.model" in str(problem)
        return
    clouds = few[0].frames(slice(0, 3)).clouds()
    np.testing.assert_array_equal(model.label_frames(clouds).indices, small.label_frames(clouds).indices)


def test_the_labelling_names_a_recording(model, stranger):
    """From a recording without names to one with the marker set's names, through the nouns of the house."""
    nameless = Recording(stranger.positions[:, ::-1], tuple(f"*{i}" for i in range(15)), 30.0)
    named = nameless.with_labelling(model.label_frames(nameless.clouds()))
    assert named.labels[:15] == stranger.labels
    shown = ~np.isnan(named.positions[:, :15, 0])
    assert shown.mean() > 0.99
    np.testing.assert_array_equal(named.positions[:, :15][shown], stranger.positions[shown])
