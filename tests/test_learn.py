"""Learning on: what a model learns from more recordings is what it would have learned from all at once, in whatever order they came."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path

import models
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import BRIEF, trained

import asterism
from asterism import AsterismError, MarkerModel, MarkerSet, Recording, formats
from asterism.cli import main
from asterism.geometry import rotate_z_up
from asterism.labelling.body._score_kernels import best_pose
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.features.feature_kernels import G2, G4
from asterism.labelling.partial.solver import unpack_solvers
from asterism.labelling.partial.weak import StrongClassifier
from asterism.labelling.training.learning import TrainingConfig, TrainingRules, TrainingState, _some_stretches
from asterism.labelling.training.model_file import describe_model
from asterism.labelling.training.sample import GRID, Clip, Sample, _water_level
from asterism.session import FileLabeller, LabellingOptions
from asterism.simulation import simulate_occlusions, simulate_walks

pytestmark = pytest.mark.kernels

QUICK = {"miner": None, "training": BRIEF}
PEOPLE = ("Ann", "Ben", "Cem", "Dee", "Eva", "Fay")


@pytest.fixture(scope="module")
def walks():
    return simulate_walks(subjects=6, frames=60, rate=20.0, seed=3)


@pytest.fixture(scope="module")
def first(walks):
    """A model of three people."""
    return trained(walks[:3], subjects=PEOPLE[:3], **QUICK)


@pytest.fixture(scope="module")
def whole(walks):
    """A model of five people, trained at once."""
    return trained(walks[:5], subjects=PEOPLE[:5], **QUICK)


def content(model, folder, name="some.model"):
    model.save(folder / name)
    return (folder / name).read_bytes()


def test_no_training_imports_what_labels_streams():
    """Kept models of tests stay where it changes."""
    package = Path(asterism.__file__).parent
    start = package / "labelling" / "marker_model.py"
    reached = models._reached(package, start)
    assert len(reached) > 100
    assert [source for source in reached - {start} if "labelling.live" in source.read_text(encoding="utf-8")] == []
    for node in ast.parse(start.read_text(encoding="utf-8")).body:
        for inner in node.body if isinstance(node, ast.ClassDef) else [node]:
            if "labelling.live" in ast.unparse(inner):
                assert (isinstance(inner, ast.If) and ast.unparse(inner.test) == "TYPE_CHECKING") or getattr(inner, "name", "") == "stream"


def rates(labelling, truth):
    given_ = labelling.indices >= 0
    right = given_ & (labelling.indices == truth)
    return right.sum() / (truth >= 0).sum(), 1.0 - right.sum() / max(1, given_.sum())


def test_learning_in_any_order_is_training_on_all(first, whole, walks, tmp_path):
    """One after the other, in the other order, and both at once: the same model, bit for bit; the old one is untouched."""
    before = content(first, tmp_path)
    d, e = walks[3], walks[4]
    wanted = content(whole, tmp_path)
    assert content(first.learn([e], subjects=["Eva"]).learn([d], subjects=["Dee"]), tmp_path) == wanted
    assert content(first.learn([e, d], subjects=["Eva", "Dee"]), tmp_path) == wanted
    assert content(first, tmp_path) == before != wanted


def test_a_model_read_back_learns_the_same(first, whole, walks, tmp_path):
    first.save(tmp_path / "first.model")
    again = MarkerModel.load(tmp_path / "first.model")
    learned = again.learn(walks[3:5], subjects=PEOPLE[3:5])
    assert content(learned, tmp_path) == content(whole, tmp_path)
    assert content(MarkerModel.load(tmp_path / "some.model"), tmp_path, "other.model") == content(whole, tmp_path)


def test_a_recording_given_twice_counts_once(first, walks, tmp_path):
    assert content(first.learn([walks[1]], subjects=["Ben"]), tmp_path) == content(first, tmp_path)
    assert content(first.learn([walks[1], walks[1]], subjects=["Zoe", "Zoe"]), tmp_path) == content(first, tmp_path), "the first name stays"


def test_another_person_changes_the_model_and_is_counted(first, walks, tmp_path):
    """The opposite of the above."""
    learned = first.learn([walks[3]], subjects=["Dee"])
    assert content(learned, tmp_path) != content(first, tmp_path)
    assert learned.about["subjects"] == list(PEOPLE[:4])
    assert learned.about["recordings"] == 4
    assert first.about["recordings"] == 3


def test_corrections_teach(walks):
    """From one person's walk, other bodies are often unsure; with their corrected recordings learned, a body like them is labelled."""
    one = trained(walks[:1], **QUICK)
    clouds, truth = simulate_occlusions(walks[5], 3, 0, seed=1)
    learned = one.learn(walks[1:5], subjects=PEOPLE[1:5])
    before, after = rates(one.label_frames(clouds), truth), rates(learned.label_frames(clouds), truth)
    assert after[0] > before[0] + 0.02, f"{before[0]:.1%} right before, {after[0]:.1%} after"
    assert after[0] > 0.9 and after[1] < 0.01


def test_a_corrected_recording_may_lack_markers_and_wear_its_own_order(first, walks):
    names = walks[3].labels
    lacking = walks[3].select(names[::-1][:-2])
    holed = replace(lacking, positions=np.where(np.arange(60)[:, None, None] % 7 == 0, np.nan, lacking.positions))
    learned = first.learn([holed], subjects=["Dee"])
    assert learned.marker_set == first.marker_set
    assert learned.about["subjects"] == list(PEOPLE[:4])
    clouds, truth = simulate_occlusions(walks[5], 0, 0)
    right, wrong = rates(learned.label_frames(clouds), truth)
    assert right > 0.9 and wrong < 0.01


def test_a_marker_that_only_the_new_person_wears_is_learned(walks):
    """Nobody else shows it, so the trial without that person must do without it, too."""
    bare = [walk.select(walk.labels[:-1]) for walk in walks[:3]]
    marker_set = MarkerSet(walks[0].labels)
    model = MarkerModel.fit(bare, subjects=PEOPLE[:3], marker_set=marker_set, **QUICK)
    clouds, truth = simulate_occlusions(walks[3], 0, 0)
    assert (model.label_frames(clouds).indices[:, -1] == -1).all()
    learned = model.learn([walks[3]], subjects=["Dee"])
    assert (learned.label_frames(clouds).indices[:, -1] == truth[:, -1]).mean() > 0.9


def test_partial_solvers_stay_unless_searched_again(walks, tmp_path):
    """With four markers, the search is quick."""
    rules = {"miner": "genetic", "training": replace(QUICK["training"], frames_per_person=20)}
    few = [walk.select(walk.labels[:4]) for walk in walks]
    model = MarkerModel.fit(few[:2], subjects=PEOPLE[:2], **rules)
    learned = model.learn([few[2]], subjects=["Cem"])
    assert (learned.about["partial_solvers_from"], learned.about["recordings"]) == (2, 3)
    clouds = few[3].clouds()
    before, after = (one.label_frames(clouds, method="thesis") for one in (model, learned))
    np.testing.assert_array_equal(after.indices, before.indices)
    again = model.learn([few[2]], subjects=["Cem"], search_again=True)
    assert again.about["partial_solvers_from"] == 3
    assert content(again, tmp_path) == content(MarkerModel.fit(few[:3], subjects=PEOPLE[:3], **rules), tmp_path)


def test_each_rules_solvers_and_each_markers_target_reach_the_model(walks, tmp_path):
    """The thesis' solvers have the intervals of eq. 4.4, the others wider ones; targets, trials and what no solver covers are said."""
    few = [walk.select(walk.labels[:4]) for walk in walks[:2]]
    first, others = few[0].labels[0], few[0].labels[1:]
    rules = replace(QUICK["training"], frames_per_person=20, marker_targets={first: 0.75})
    model = MarkerModel.fit(few, subjects=PEOPLE[:2], miner="genetic", training=rules, target_hit_rate=0.9)
    model.save(tmp_path / "four.model")
    again = MarkerModel.load(tmp_path / "four.model")
    assert set(again.state.solvers) == {"partial-solvers", "thesis"}
    frames = np.concatenate([rotate_z_up(walk.positions, walk.vertical) for walk in few])
    for name, solvers in again.state.solvers.items():
        assert solvers.targets.tolist() == [0.75, 0.9, 0.9, 0.9]
        inside = [solver_accepts(solver, frames) for solver in unpack_solvers(solvers.solvers)]
        assert np.mean(inside) > 0.6, f"{name}: of the training itself, whose frames are not all used"
        said = describe_model(tmp_path / "four.model")["partial_solvers"][name]
        assert said["targets"] == {first: 0.75} | dict.fromkeys(others, 0.9)
        assert said["solvers"] == len(solvers)
        assert said["uncovered"] == [marker for marker, covered in zip(few[0].labels, solvers.covered, strict=True) if not covered]
    widths = {name: interval_widths(solvers.solvers) for name, solvers in again.state.solvers.items()}
    shared = widths["thesis"].keys() & widths["partial-solvers"].keys()
    assert shared
    assert all(widths["thesis"][key] < widths["partial-solvers"][key] for key in shared)
    with pytest.raises(AsterismError, match="LNOSE"):
        MarkerModel.fit(few, subjects=PEOPLE[:2], miner="genetic", training=replace(rules, marker_targets={"LNOSE": 0.9}))


def solver_accepts(solver, frames):
    """Share of frames whose right labelling all classifiers of a solver accept."""
    strong = StrongClassifier(solver.weak, np.ones(len(solver.weak)), len(solver.markers))
    return strong.accepts(np.ascontiguousarray(frames), np.tile(solver.markers, (len(frames), 1))).mean()


def interval_widths(arrays):
    """The width of the interval of each distance and height difference, by feature and markers."""
    found = {}
    for solver in unpack_solvers(arrays):
        for kind, slots, low, high in zip(
            solver.weak.kinds, solver.markers[solver.weak.slots], solver.weak.low, solver.weak.high, strict=True
        ):
            if kind in (G2, G4):
                found[int(kind), *slots[:2].tolist()] = high - low
    return found


def test_solvers_that_were_never_searched_cannot_be_searched_again(first, walks):
    with pytest.raises(AsterismError, match="without partial solvers; train it again with --partial-solvers bottom-up"):
        first.learn([walks[3]], search_again=True)


def test_progress_rises_to_one(first, walks):
    told = []
    first.learn([walks[3]], progress=lambda fraction, what: told.append(fraction))
    assert told == sorted(told) and told[0] == 0.0 and told[-1] == 1.0


# --- what is refused


def test_a_model_of_an_earlier_asterism_labels_but_does_not_learn(first, walks, tmp_path):
    first.save(tmp_path / "new.model")
    with np.load(tmp_path / "new.model") as file:
        arrays = {name: file[name] for name in file.files if not name.startswith("sample_")}
    head = arrays["head"].tobytes().replace(b'"version": 3', b'"version": 1')
    with (tmp_path / "old.model").open("wb") as file:
        np.savez_compressed(file, **{**arrays, "head": np.frombuffer(head, dtype=np.uint8)})
    old = MarkerModel.load(tmp_path / "old.model")
    assert first.findings() == []
    assert [finding.code for finding in old.findings(str(tmp_path / "old.model"))] == ["model-earlier-version"]
    labeller = FileLabeller.of_models([tmp_path / "old.model"] * 2, LabellingOptions())
    assert [finding.where for finding in labeller.findings] == [str(tmp_path / "old.model")], "said once"
    clouds = walks[4].clouds()
    np.testing.assert_array_equal(old.label_frames(clouds).indices, first.label_frames(clouds).indices)
    with pytest.raises(AsterismError, match="earlier Asterism and keeps nothing to learn on from; train it again"):
        old.learn([walks[3]])


def test_nothing_to_learn_is_refused(first, walks):
    with pytest.raises(AsterismError, match="no recording to learn from"):
        first.learn([])
    with pytest.raises(AsterismError, match="2 subjects for 1 recordings"):
        first.learn([walks[3]], subjects=["Dee", "Eva"])


def test_a_recording_of_something_else_is_refused(first):
    cube = Recording(np.zeros((10, 4, 3)), ("a", "b", "c", "d"), 100.0, metadata={"file": "cube.c3d"})
    with pytest.raises(AsterismError, match=r"cube\.c3d has none of the model's markers"):
        first.learn([cube])


def test_a_recording_that_shows_nothing_is_refused(first, walks):
    for nothing in (walks[3].frames(slice(0, 0)), walks[3].select(walks[3].labels[:2])):
        with pytest.raises(AsterismError, match=r"bare\.c3d has no frame that shows 3 labelled points"):
            first.learn([replace(nothing, metadata={"file": "bare.c3d"})])


def test_millimetres_taken_for_metres_are_refused(first, walks):
    huge = replace(walks[3], positions=walks[3].positions * 1e6, metadata={"file": "huge.trc"})
    with pytest.raises(AsterismError, match=r"huge\.trc has positions beyond 10 km; check its unit"):
        first.learn([huge])


def test_ten_frames_are_enough_to_begin_with_and_nine_are_not():
    markers = MarkerSet(tuple("abcd"))

    def kept(frames):
        recording = Recording(np.random.default_rng(0).normal(size=(frames, 4, 3)), markers.names, 10.0)
        return TrainingState(Sample(), TrainingConfig()).with_recordings([recording], ["x"], markers)

    assert kept(10).training_frames()[1].shape == (10, 4, 3)
    with pytest.raises(AsterismError, match="9 frames show at least half of them; training needs 4 markers and 10 such frames"):
        kept(9).training_frames()


def test_the_usual_score_is_what_right_labels_of_others_hardly_ever_stay_below(whole, walks):
    """In nats per label: a model's trials hide some markers, so that an unseen person's whole frames score above it, and not by far."""
    body, settings_, scores = whole.body_labeller.body, whole.body_labeller.settings, []
    for frame in walks[5].positions[::3]:
        workspace = make_body_workspace(15, 15, body.load.shape[3])
        scores.append(best_pose(body, np.ascontiguousarray(frame), np.arange(15), settings_, workspace)[1] / 15)
    assert 0.6 * np.median(scores) < settings_.usual_score < min(scores)


def test_a_person_left_out_is_tried_on_the_longest_of_their_own_stretches():
    lengths = [(0, 20), (1, 5), (1, 9), (0, 30), (1, 7), (2, 6)]
    stretches = [(person, Recording(np.full((length, 3, 3), float(person)), tuple("abc"), 10.0)) for person, length in lengths]
    chosen = _some_stretches(stretches, np.array([1, 2]), np.array([0, 2]), TrainingRules(virtual_people=0, stretches=2, stretch_frames=8))
    assert [(stretch.positions[0, 0, 0], len(stretch), stretch.labels) for stretch in chosen] == [
        (1.0, 8, ("a", "c")),
        (1.0, 7, ("a", "c")),
        (2.0, 6, ("a", "c")),
    ]


@pytest.mark.parametrize("trial", TrainingRules(virtual_people=0).trials, ids=str)
def test_a_trial_says_whether_it_adds_points_that_are_no_markers(trial, walks):
    clouds, truth = trial.in_frames(walks[0], np.random.default_rng(0))
    assert trial.adds_points == (len(clouds.xyz) > (truth >= 0).sum())


# --- the sample that a model carries

SET = MarkerSet(("a", "b", "c"))


def recording_of(number, frames, rate=10.0):
    rng = np.random.default_rng(number)
    positions = rng.normal(size=(frames, 3, 3)).cumsum(axis=0)
    positions[rng.random((frames, 3)) < 0.1] = np.nan
    return Recording(positions, SET.names, rate)


@pytest.mark.parametrize("name", ["w\udcffalk", "one\ntwo"])
def test_a_subject_named_by_a_file_that_is_no_text_survives_saving(name):
    sample = Sample().with_recordings([recording_of(1, 40)], [name], SET, 100, 100)
    again = Sample.from_arrays(sample.to_arrays(), len(SET.names))
    assert {clip.subject for clip in again.clips} == {name.replace("\udcff", "?").replace("\n", " ")}
    assert all((a.counts == b.counts).all() for a, b in zip(sample.clips, again.clips, strict=True))


parts = st.lists(st.tuples(st.integers(0, 8), st.integers(0, 90), st.sampled_from("xyz")), max_size=6)


@given(totals=st.lists(st.integers(0, 30), max_size=5), in_all=st.integers(1, 100))
def test_the_level_up_to_which_people_give_frames_is_the_lowest_that_suffices(totals, in_all):
    level = 1
    while level <= max(totals, default=0) and sum(min(total, level) for total in totals) < in_all:
        level += 1
    assert _water_level(totals, in_all) == level


@given(one=parts, other=parts, per_person=st.integers(1, 120), in_all=st.integers(1, 200))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_a_sample_of_a_sample_and_more_is_the_sample_of_all(one, other, per_person, in_all):
    """Whatever a full sample drops, it would have dropped from the whole, too. (A recording is always given for the same person.)"""

    def added(sample, parts_):
        recordings = [recording_of(number, frames) for number, frames, _ in parts_]
        subjects = ["xyz"[(number + frames) % 3] for number, frames, _ in parts_]
        return sample.with_recordings(recordings, subjects, SET, per_person, in_all)

    def same(a, b):
        key = [(c.subject, c.recording, c.first, c.rank, c.rate, c.counts.tobytes()) for c in a.clips]
        return key == [(c.subject, c.recording, c.first, c.rank, c.rate, c.counts.tobytes()) for c in b.clips]

    at_once = added(Sample(), [*one, *other])
    assert same(added(added(Sample(), one), other), at_once)
    assert same(added(added(Sample(), other), one), at_once)
    frames = sum(len(clip) for clip in at_once.clips)
    longest = max((len(clip) for clip in at_once.clips), default=0)
    assert frames <= in_all + 3 * longest
    if at_once.clips:
        restored = Sample.from_arrays(at_once.to_arrays(), 3)
        assert same(restored, at_once)


def test_a_full_sample_is_spread_over_people_recordings_and_time():
    recordings = [recording_of(n, frames) for n, frames in ((0, 1000), (1, 300), (2, 50))]
    sample = Sample().with_recordings(recordings, ["x", "x", "y"], SET, 200, 10_000)
    mine = [clip for clip in sample.clips if clip.subject == "x"]
    counts = [sum(len(clip) for clip in mine if clip.recording == r) for r in dict.fromkeys(clip.recording for clip in mine)]
    assert 195 <= sum(counts) <= 205 and min(counts) >= 95, "both recordings of a person have their share"
    longer = max(
        ([clip for clip in mine if clip.recording == r] for r in sample.recordings), key=lambda clips: max([0, *(c.first for c in clips)])
    )
    gaps = np.diff([0, *(clip.first for clip in longer), 1000])
    assert gaps.max() < 120, "no tenth of the recording is without a clip"
    assert sum(len(clip) for clip in sample.clips if clip.subject == "y") == 50


def test_positions_are_kept_to_the_grid():
    recording = recording_of(5, 40)
    sample = Sample().with_recordings([recording], ["x"], SET, 100, 100)
    [stretch], [subject] = sample.stretches(SET.names)
    assert subject == "x" and stretch.rate == 10.0
    np.testing.assert_allclose(stretch.positions, recording.positions, atol=0.51 * GRID)


def test_a_clip_tells_its_length():
    assert len(Clip("x", "0", 0, 0, 1.0, np.zeros((7, 3, 3), dtype=np.int32))) == 7


# --- real people


def test_real_people_are_learned_without_the_old_files(data, tmp_path):
    """Three gait subjects, then two more: the fourth's walk, never seen, with three markers hidden; and the model stays small."""
    import asterism

    def trials(subject):
        return [
            asterism.read(data / "gait" / subject / f"{trial}.c3d", markers="helen-hayes").frames(slice(None, None, 3))
            for trial in ("straight", "turn")
        ]

    names = ("HC002", "HC031", "HC033")
    model = MarkerModel.fit([r for n in names for r in trials(n)], subjects=[n for n in names for _ in range(2)], **QUICK)
    learned = model.learn([*trials("HC039"), *trials("HC044")], subjects=["HC039"] * 2 + ["HC044"] * 2)
    clouds, truth = simulate_occlusions(trials("HC050")[1], 3, 0, seed=2)
    before, after = rates(model.label_frames(clouds), truth), rates(learned.label_frames(clouds), truth)
    assert after[0] >= before[0] - 0.01 and after[0] > 0.9, f"{before[0]:.1%} right before, {after[0]:.1%} after"
    assert len(content(learned, tmp_path)) < 1_000_000


# --- the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory, first, walks):
    place = tmp_path_factory.mktemp("learn")
    first.save(place / "first.model")
    for i, walk in enumerate(walks):
        formats.write(place / f"walk-{i}.c3d", walk)
    (place / "broken.c3d").write_bytes(b"no file")
    return place


def test_the_command_learns_and_may_replace_its_own_model(folder, tmp_path, capsys):
    own = tmp_path / "own.model"
    own.write_bytes((folder / "first.model").read_bytes())
    words = ["learn", own, folder / "walk-3.c3d", folder / "walk-4.c3d", "--subject", "Dee", "-o", own]
    assert main([*map(str, words)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert own.read_bytes() == (folder / "first.model").read_bytes()
    assert main([*map(str, words), "--overwrite"]) == 0
    assert "5 recordings of 4 subjects" in capsys.readouterr().out
    assert MarkerModel.load(own).about["subjects"] == ["Ann", "Ben", "Cem", "Dee"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["own.model"]
    assert main([*map(str, [*words, "--overwrite", "--json", "-"])]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["known_already"], told["new_subjects"], told["recordings"]) == (2, [], 5)


@pytest.mark.parametrize(("files", "said"), [(["broken.c3d", "walk-3.c3d"], "1 of 2 files cannot be used"), (["absent.c3d"], "absent.c3d")])
def test_the_command_learns_nothing_from_a_batch_with_a_bad_file(folder, tmp_path, capsys, files, said):
    assert main(["learn", str(folder / "first.model"), *(str(folder / file) for file in files), "-o", str(tmp_path / "new.model")]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
