"""Models of virtual people: made without a labelled file, kept for the next time, and what models of real people start from."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import BRIEF

from asterism import formats
from asterism.errors import AsterismError
from asterism.files import cache
from asterism.labelling import MarkerModel, TrainingRules, virtual_model
from asterism.labelling.training.learning import TrainingConfig, _fewer_trials, _try_frames, beside, fit_whole
from asterism.labelling.training.trials import TrainingTrial
from asterism.labelling.training.virtual import VirtualFrames, placed_by_neighbours, virtual_frames, with_known_places
from asterism.recording import MarkerSet, Recording
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from asterism.skeleton import virtual_people

FEW = 12
"""Virtual people: enough to label others, and learned from in half a second."""

START = replace(BRIEF, virtual_people=FEW)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """One folder for all of this module, which is not the user's."""
    folder = tmp_path_factory.getbasetemp() / "kept"
    monkeypatch.setenv("ASTERISM_CACHE", str(folder))
    return folder


@pytest.fixture(scope="module")
def stranger():
    """A virtual person whom no model here knows, who walks."""
    return next(r for r in virtual_people("helen-hayes", people=2, frames=200, seed=99) if "walk" in r.metadata["file"])


@pytest.fixture(scope="module")
def walks():
    return simulate_walks(3, frames=60, markers="helen-hayes", seed=5)


def content(model: MarkerModel, folder) -> bytes:
    model.save(folder / "one.model")
    return (folder / "one.model").read_bytes()


def rates(model: MarkerModel, recording: Recording) -> tuple[float, float]:
    """Shares of the samples that are labelled right and wrong; the clouds have the points in the order of the markers."""
    indices, truth = model.label(recording).indices, np.arange(len(recording.labels))
    return float((indices == truth).mean()), float(((indices >= 0) & (indices != truth)).mean())


def test_a_model_of_virtual_people_labels_a_person_it_has_not_seen(stranger):
    model = virtual_model("helen-hayes", people=FEW)
    right, wrong = rates(model, stranger)
    assert right > 0.9, "one of 15 may be too uncertain to be given"
    assert wrong == 0.0
    assert (model.about["virtual_people"], model.about["subjects"]) == (FEW, [])


def test_the_model_is_kept_and_the_same_again(own_cache, tmp_path):
    first = virtual_model("helen-hayes", people=FEW)
    files = {path: path.stat().st_mtime_ns for path in (own_cache / "models").iterdir()}
    again = virtual_model("helen-hayes", people=FEW)
    assert content(again, tmp_path) == content(first, tmp_path)
    assert {path: path.stat().st_mtime_ns for path in (own_cache / "models").iterdir()} == files


def test_another_seed_or_number_or_place_is_another_model(own_cache):
    worn = MarkerSet.load("helen-hayes")
    moved = replace(worn, places={**worn.places, "SACR": replace(worn.places["SACR"], spread=0.02)})
    models = [
        virtual_model(worn, people=3),
        virtual_model(worn, people=4),
        virtual_model(worn, people=3, seed=1),
        virtual_model(moved, people=3),
    ]
    bodies = [model.state.body.mean.tobytes() for model in models]
    assert len(set(bodies)) == len(bodies)


def test_a_damaged_file_is_made_anew(own_cache, tmp_path):
    before = content(virtual_model("helen-hayes", people=3), tmp_path)
    for path in (own_cache / "models").iterdir():
        path.write_bytes(path.read_bytes()[:-100])
    assert content(virtual_model("helen-hayes", people=3), tmp_path) == before
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert content(virtual_model("helen-hayes", people=3), tmp_path) == before


def test_spellings_are_those_of_the_set_that_was_asked_for(own_cache):
    worn = MarkerSet.load("helen-hayes")
    spelled = replace(worn, aliases={"SACR": ("my sacrum",)})
    virtual_model(worn, people=3)
    assert virtual_model(spelled, people=3).marker_set == spelled


def test_a_folder_that_cannot_be_written_is_said_once(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("ASTERISM_CACHE", str(tmp_path / "file"))
    with pytest.warns(UserWarning, match="cannot be written.*ASTERISM_CACHE"):
        assert virtual_model("helen-hayes", people=3).about["virtual_people"] == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        virtual_model("helen-hayes", people=3)


@pytest.mark.parametrize(
    ("system", "variables", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/kept"}, "/kept/asterism"),
        ("linux", {"XDG_CACHE_HOME": "beside"}, "/home/ann/.cache/asterism"),
        ("linux", {}, "/home/ann/.cache/asterism"),
        ("darwin", {"XDG_CACHE_HOME": "/kept"}, "/home/ann/Library/Caches/asterism"),
        ("win32", {"LOCALAPPDATA": "/local"}, "/local/asterism/Cache"),
        ("linux", {"ASTERISM_CACHE": "/mine", "XDG_CACHE_HOME": "/kept"}, "/mine"),
    ],
)
def test_the_folder_is_the_systems_unless_a_variable_names_one(monkeypatch, system, variables, expected):
    for name in ("ASTERISM_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": "/home/ann", **variables}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(cache.sys, "platform", system)
    assert cache.cache_folder().as_posix() == expected


def test_a_set_without_places_is_told_how_to_get_them():
    with pytest.raises(AsterismError, match=r"does not say where one, two, three, four sit.*\[places\].*asterism body place"):
        virtual_model(["one", "two", "three", "four"])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"people": 1}, "no population"),
        ({"marker_set": ["SACR"]}, "four are the fewest"),
        ({"marker_set": ["nose", "ear", "chin", "eye"]}, "sit"),
    ],
)
def test_what_makes_no_model_is_refused(given, words):
    with pytest.raises(AsterismError, match=words):
        virtual_model(**{"marker_set": "helen-hayes", **given})


# --- starting from them


def test_one_persons_model_starts_from_virtual_people_and_knows_other_movements(walks):
    """A person who walked taught the model; another one, who stands with raised arms and squats, is labelled."""
    takes = [r for r in virtual_people("helen-hayes", people=3, frames=60, seed=7) if "walk" not in r.metadata["file"]]
    alone = MarkerModel.fit(walks[:1], training=BRIEF)
    started = MarkerModel.fit(walks[:1], training=START)
    assert (alone.about["virtual_people"], started.about["virtual_people"]) == (0, FEW)
    before, after = (np.mean([rates(model, take) for take in takes], axis=0) for model in (alone, started))
    assert after[0] > before[0] + 0.02, f"{before} before, {after} after"
    assert after[0] > 0.95
    assert after[1] < 0.01


def test_fewer_frames_with_ghosts_count_as_much_as_all_of_them(walks):
    labeller, frames = virtual_model("helen-hayes", people=FEW).body_labeller, walks[0].positions
    rules = TrainingRules(trial_frames=20, trials=(TrainingTrial(0.2), TrainingTrial(0.2, 3)))
    people = np.zeros(len(frames), dtype=np.int64)
    all_of_them, few = (_try_frames(labeller, frames, people, rules, 0, few) for few in (False, True))
    # 20 frames, and 20 with ghosts that count a fifth: of these 4 do
    assert 1.5 * len(few.right) < len(all_of_them.right)
    assert few.weight.sum() == pytest.approx(all_of_them.weight.sum(), rel=0.05)
    half = _fewer_trials(rules)
    assert (half.trial_frames, half.stretch_frames, half.stretches) == (10, rules.stretch_frames // 2, rules.stretches)


def test_learning_starts_from_the_same_people_in_any_order(walks, tmp_path):
    """fit(a, b) = fit(b).learn(a), through a file, where both have the same rules, bit for bit."""
    places = {"marker_set": MarkerSet.load("helen-hayes"), "training": START}
    both = content(MarkerModel.fit(walks[:2], **places), tmp_path)
    MarkerModel.fit(walks[1:2], **places).save(tmp_path / "kept.model")
    assert content(MarkerModel.load(tmp_path / "kept.model").learn(walks[:1]), tmp_path) == both


def test_a_model_of_virtual_people_learns_real_ones(walks, tmp_path):
    model = virtual_model("helen-hayes", people=FEW)
    model = MarkerModel(replace(model.state, training=replace(model.state.training, config=TrainingConfig(rules=START))))
    learned = model.learn(walks[:1])
    expected = MarkerModel.fit(walks[:1], marker_set=MarkerSet.load("helen-hayes"), training=START)
    assert content(learned, tmp_path) == content(expected, tmp_path)


def test_a_marker_that_no_recording_shows_is_known_from_virtual_people(walks):
    worn, bare = MarkerSet.load("helen-hayes"), walks[0].select([name for name in walks[0].labels if name != "SACR"])
    model = MarkerModel.fit([bare], marker_set=worn, training=START)
    assert list(model.state.markers) == list(range(15))
    column = worn.names.index("SACR")
    assert (model.label(walks[1]).indices[:, column] == walks[1].labels.index("SACR")).mean() > 0.9


def test_places_are_found_by_names_that_a_shipped_set_knows():
    worn = MarkerSet.load("helen-hayes")
    assert with_known_places(MarkerSet(worn.names)).places == worn.places
    assert with_known_places(MarkerSet((*worn.names, "box 1", "box 2"))).places == worn.places
    unknown = MarkerSet(("a", "b", "c", "d"))
    assert with_known_places(unknown) is unknown


def test_a_set_that_no_shipped_one_knows_is_learned_from_the_recordings_alone(walks):
    renamed = [replace(walk, labels=tuple(f"point {i}" for i in range(15))) for walk in walks]
    model = MarkerModel.fit(renamed, training=START)
    assert model.about["virtual_people"] == 0
    assert model.state.body.mean.tobytes() == MarkerModel.fit(renamed, training=BRIEF).state.body.mean.tobytes()


def test_a_marker_without_a_place_is_put_where_the_recordings_show_it():
    """The knee of virtual people, its place forgotten, is found again from others who show it."""
    worn = MarkerSet.load("helen-hayes")
    knee = worn.names.index("LKNE")
    shown, others = virtual_frames(worn, 6, 1), virtual_frames(worn, 6, 2)
    hidden = shown.frames.copy()
    hidden[:, knee] = np.nan
    placed = placed_by_neighbours(VirtualFrames(hidden, shown.people), others.frames, 0).frames
    away = np.linalg.norm(placed[:, knee] - shown.frames[:, knee], axis=1)
    assert np.median(away) < 0.12, "the wands beside it sit elsewhere on everybody, by as much"
    rest = [marker for marker in range(15) if marker != knee]
    np.testing.assert_array_equal(placed[:, rest], shown.frames[:, rest])


def test_without_frames_that_show_it_a_marker_has_no_place():
    worn = MarkerSet.load("helen-hayes")
    shown = virtual_frames(worn, 3, 1)
    hidden = shown.frames.copy()
    hidden[:, 0] = np.nan
    placed = placed_by_neighbours(VirtualFrames(hidden, shown.people), np.empty((0, 15, 3)), 0)
    assert np.isnan(placed.frames[:, 0]).all()


def test_all_virtual_people_together_count_for_so_many_real_ones(walks):
    """The mean body lies between that of the real people and that of the virtual ones, nearer to those that weigh more."""
    worn = MarkerSet.load("helen-hayes")
    virtual = virtual_frames(worn, 6, 1)
    real, people = np.concatenate([walk.positions for walk in walks]), np.repeat(np.arange(3), 60)
    for weight in (0.5, 50.0):
        frames, whose, weights = beside(virtual, real, people, replace(START, virtual_weight=weight), 0)
        assert (len(frames), int(whose.max())) == (len(real) + len(virtual.frames), 8)
        assert ((weights[:3] > 0.0) & (weights[:3] <= 1.0)).all()
        assert weights[3:].tolist() == [weight / 6] * 6
    heights, rules = [], replace(START, body=replace(START.body, poses=1))
    for weight in (0.001, 1000.0):
        config = TrainingConfig(rules=replace(rules, virtual_weight=weight))
        heights.append(np.ptp(fit_whole(real, people, config, virtual)[0].mean[0, :, 2]))
    groups = (VirtualFrames(real, people), virtual)
    alone = [np.ptp(fit_whole(some.frames, some.people, TrainingConfig(rules=rules))[0].mean[0, :, 2]) for some in groups]
    np.testing.assert_allclose(heights, alone, atol=0.02)


def test_a_person_who_shows_one_posture_tells_less_than_one_who_moves(walks):
    virtual = virtual_frames(MarkerSet.load("helen-hayes"), 6, 1)
    shown = [np.repeat(walks[0].positions[:1], 60, axis=0), walks[0].positions, virtual.frames[virtual.people == 2]]
    people = np.repeat(np.arange(3), [len(some) for some in shown])
    _, _, weights = beside(virtual, np.concatenate(shown), people, START, 0)
    assert 0.0 < weights[0] < 0.9 * weights[1]
    assert weights[1] < weights[2] <= 1.0


@pytest.mark.parametrize("given", [{"virtual_people": -1}, {"virtual_weight": 0.0}])
def test_rules_that_cannot_teach_are_refused(given):
    with pytest.raises(AsterismError, match="cannot teach"):
        TrainingRules(**given)


def test_ghosts_beside_a_walk_do_not_silence_a_model_of_virtual_people() -> None:
    """Bodies of any size leave many ways to lay an anchor on 15 points: with room for too few of them, no frame had a label."""
    walk = simulate_walks(1, frames=80, markers="helen-hayes", seed=6)[0]
    clouds, truth = simulate_gaps_and_ghosts(walk, hidden=3, ghosts=3, seed=2)
    model = virtual_model("helen-hayes")
    shown = truth >= 0
    assert (model.body_labeller.label(clouds).point_of == truth)[shown].mean() > 0.9
    given = model.label(clouds).indices
    assert (given == truth)[shown].mean() > 0.9
    assert ((given >= 0) & (given != truth)).mean() < 0.01


def test_a_stream_of_many_markers_finds_a_stranger(data: Path) -> None:
    """An anchor that knows bodies of any size looks at tens of thousands of triples of 61 points, or no frame has labels."""
    recording = formats.read(data / "movement/fullbody61/markers.trc", markers="leuven").frames(slice(100, 130))
    stream, right, shown = virtual_model("leuven", people=FEW).stream(recording.rate, 0, recording.vertical), 0, 0
    for points, visible in zip(recording.positions, recording.visible, strict=True):
        indices = stream.push(points[visible]).indices
        right += (indices[visible] == np.arange(visible.sum())).sum()
        shown += visible.sum()
    assert right > 0.5 * shown
