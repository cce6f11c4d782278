"""Several bodies in one volume: walkers who wear the same markers, and a walker with a box, whose truth is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import trained
from scipy.spatial.transform import Rotation

import asterism
from asterism import formats
from asterism.cli import main
from asterism.labelling import SeveralBodies, join_labellings, label_together
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.labelling.whole.bodies import Bodies, follow_bodies
from asterism.recording import Labelling, MarkerSet, Recording
from asterism.session import label_file
from asterism.simulation import simulate_walks

BOX = np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.0, 0.18, 0.0], [0.05, 0.07, 0.2], [-0.12, 0.04, 0.09]])


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=7, frames=200, seed=11)


@pytest.fixture(scope="module")
def walker(walks: list[Recording]) -> asterism.MarkerModel:
    return trained(walks[:5], miner=None, subjects=list("abcde"))


def tumbling_box(rng: np.random.Generator, frames: int = 200) -> Recording:
    """A rigid box of five markers that somebody carries about and turns every way."""
    time = np.arange(frames) / 100.0

    def wave(size: float) -> np.ndarray:
        frequency, phase = rng.uniform(0.1, 0.6, (3, 3, 1)), rng.uniform(0.0, 2 * np.pi, (3, 3, 1))
        return (size * rng.normal(size=(3, 3, 1)) * np.sin(2 * np.pi * frequency * time + phase)).sum(axis=1).T

    turned, moved = Rotation.from_rotvec(wave(1.0)), wave(0.2) + np.array([0.0, 0.0, 1.0])
    return Recording(np.stack([turned.apply(place) for place in BOX], axis=1) + moved[:, None], tuple(f"box{i}" for i in range(5)), 100.0)


def beside(first: Recording, second: Recording, away: tuple[float, float, float], speed: float = 0.0) -> Recording:
    """Both in one volume, the second's middle `away` (m) from the first's, or passing through that place at `speed` (m/s) along x."""
    moved = second.positions + (first.positions.mean(axis=1) - second.positions.mean(axis=1))[:, None] + np.array(away)
    moved[:, :, 0] += speed * ((np.arange(len(moved)) - len(moved) / 2) / second.rate)[:, None]
    labels = (*first.labels, *(f"2:{label}" for label in second.labels))
    return Recording(np.concatenate([first.positions, moved], axis=1), labels, first.rate)


def judged(labellings: list[Labelling], truth: np.ndarray) -> tuple[float, float]:
    """The share of right entries, and of wrong ones among those given; two who wear the same markers may be exchanged as a whole."""
    one, two = (labelling.indices for labelling in labellings)
    orders = [np.concatenate([one, two], axis=1)]
    if one.shape == two.shape:
        orders.append(np.concatenate([two, one], axis=1))
    given = max(orders, key=lambda indices: float((indices == truth).mean()))
    return float((given == truth).mean()), float((given != truth)[given >= 0].mean())


@pytest.mark.parametrize(("away", "speed"), [((0.8, 0.3, 0.0), 0.0), ((0.0, 1.0, 0.0), 1.5), ((0.3, 0.4, 0.0), 0.0)])
@pytest.mark.parametrize(("hidden", "ghosts", "numbered"), [(0, 0, True), (4, 0, True), (4, 0, False), (2, 3, True)])
def test_two_walkers_with_the_same_markers_are_told_apart(walks, walker, away, speed, hidden: int, ghosts: int, numbered: bool) -> None:
    clouds, truth = simulate_gaps_and_ghosts(beside(walks[5], walks[6], away, speed), hidden, ghosts, 3, number_tracks=numbered)
    right, wrong = judged(label_together([walker, walker], clouds), truth)
    assert right > 0.985, f"{right:.4f} right"
    assert wrong < 0.005, f"{wrong:.4f} wrong among those given"


@pytest.mark.parametrize(("hidden", "ghosts"), [(0, 0), (2, 0), (2, 2)])
def test_a_walker_and_a_box_are_told_apart_in_either_order(walks, walker, hidden: int, ghosts: int) -> None:
    rng = np.random.default_rng(0)
    box = trained([tumbling_box(rng) for _ in range(4)], miner=None, subjects=list("abcd"))
    both = beside(walks[5], tumbling_box(rng), (0.4, 0.3, 0.1))
    clouds, truth = simulate_gaps_and_ghosts(both, hidden, ghosts, 1)
    found = label_together([walker, box], clouds)
    right, wrong = judged(found, truth)
    assert right > 0.97, f"{right:.4f} right"
    assert wrong < 0.005, f"{wrong:.4f} wrong among those given"
    for one, other in zip(found, label_together([box, walker], clouds)[::-1], strict=True):
        np.testing.assert_array_equal(one.indices, other.indices)


def test_no_point_belongs_to_two_bodies_and_workers_change_nothing(walks, walker) -> None:
    clouds, _ = simulate_gaps_and_ghosts(beside(walks[5], walks[6], (0.2, 0.0, 0.0)), 4, 4, 0)
    found = label_together([walker, walker], clouds)
    for frame in np.concatenate([labelling.indices for labelling in found], axis=1):
        given = frame[frame >= 0]
        assert len(set(given.tolist())) == len(given)
    for one, other in zip(found, label_together([walker, walker], clouds, workers=2), strict=True):
        np.testing.assert_array_equal(one.indices, other.indices)
        np.testing.assert_array_equal(one.confidence, other.confidence)


def test_whoever_is_not_there_gets_no_labels(walks, walker) -> None:
    found = label_together([walker, walker], walks[5].clouds())
    shares = sorted((labelling.indices >= 0).mean() for labelling in found)
    assert shares[0] == 0.0
    assert shares[1] > 0.99


def test_a_body_is_followed_by_its_tracklets_whichever_is_found_better() -> None:
    """Ten frames of two bodies with three tracklets each, one tracklet of each renumbered half way; the bodies come in any order."""
    rng = np.random.default_rng(2)
    order = np.array([rng.permutation(2) for _ in range(10)]).T
    track = np.tile(np.arange(6), (10, 1))
    track[5:, [0, 3]] = [6, 7]
    rows = np.array([[e * 6 + 3 * order[b, e] + np.arange(3) for e in range(10)] for b in range(2)])
    bodies = Bodies(np.zeros((2, 10), dtype=np.int64), rows, np.ones(rows.shape))
    who = follow_bodies(bodies, track.ravel())
    assert len(set((who == order).ravel().tolist())) == 1
    assert set(who.ravel().tolist()) == {0, 1}
    lost = replace(bodies, point_of=np.where(rng.random(rows.shape) < 0.3, -1, rows))
    assert len(set((follow_bodies(lost, track.ravel()) == order).ravel().tolist())) == 1


@pytest.mark.parametrize("away", [(0.8, 0.3, 0.0), (0.3, 0.0, 0.0)])
@pytest.mark.parametrize(("hidden", "ghosts"), [(0, 0), (6, 0), (4, 6)])
def test_two_people_for_one_model_are_said_and_never_mixed(walks, walker, away, hidden: int, ghosts: int) -> None:
    clouds, _ = simulate_gaps_and_ghosts(beside(walks[5], walks[6], away), hidden, ghosts, 3)
    with pytest.raises(SeveralBodies, match=r"two bodies with the model's 15 markers .* once for each"):
        walker.label_one_body(clouds)
    labelling = walker.label(clouds)
    assert labelling.bodies == 2
    assert "label-two-bodies" in [finding.code for finding in labelling.findings()]
    assert labelling in label_together([walker, walker], clouds)


@pytest.mark.parametrize(("hidden", "ghosts"), [(0, 0), (0, 15), (2, 30)])
def test_one_person_among_ghosts_is_no_crowd(walks, walker, hidden: int, ghosts: int) -> None:
    walker.label_one_body(simulate_gaps_and_ghosts(walks[5].frames(slice(60)), hidden, ghosts, 3)[0])


def test_a_passer_by_of_a_moment_is_no_second_person(walks, walker) -> None:
    both = beside(walks[5], walks[6], (0.8, 0.3, 0.0))
    positions = both.positions.copy()
    positions[15:, 15:] = np.nan
    labelling = walker.label_one_body(replace(both, positions=positions).clouds())
    assert (labelling.indices[30:] == np.arange(15)).mean() > 0.99


def test_one_person_with_more_markers_than_the_model_knows_is_one(data: Path) -> None:
    people = [formats.read(data / f"gait/{name}/straight.c3d", markers="helen-hayes") for name in ("HC003", "HC030", "HC031", "HC033")]
    model = trained(people, miner=None)
    for name, trial in (("HC039", "static"), ("HC055", "straight")):  # where what is left looks most like somebody
        path = data / f"gait/{name}/{trial}.c3d"
        more = formats.read(path).frames(slice(60))
        assert len(more.labels) > 50
        model.label_one_body(more.clouds())  # not SeveralBodies


def test_joined_labellings_have_a_name_for_every_marker() -> None:
    sets = [
        MarkerSet(("LASI", "RASI"), aliases={"LASI": ("LASIS",)}, pairs=(("LASI", "RASI"),)),
        MarkerSet(("LASIS",)),
        MarkerSet(("box",)),
    ]
    parts = [Labelling(np.full((2, len(s)), i), np.full((2, len(s)), 0.5), s.names) for i, s in enumerate(sets)]
    labelling, everyone = join_labellings(parts, sets, ["ann", "ben", "box"])
    assert labelling.names == everyone.names == ("ann:LASI", "ann:RASI", "ben:LASIS", "box")
    assert everyone.pairs == (("ann:LASI", "ann:RASI"),)
    assert labelling.indices.tolist() == [[0, 0, 1, 2]] * 2
    assert join_labellings(parts[:2], sets[:2])[0].names == ("1:LASI", "1:RASI", "2:LASIS")
    with pytest.raises(asterism.AsterismError, match="do not fit"):
        join_labellings(parts, sets[:2])


@pytest.mark.parametrize("first", ["Ann", "Zoe"])
@pytest.mark.parametrize("twice", [False, True])
def test_two_people_whom_the_file_names_are_both_labelled_under_their_own_names(
    walks, walker, tmp_path: Path, first: str, twice: bool
) -> None:
    both = beside(walks[5].frames(slice(60)), walks[6].frames(slice(60)), (1.5, 0.3, 0.0))
    labels = tuple(f"{who}:{label.rpartition(':')[2]}" for who, label in zip([first] * 15 + ["Mel"] * 15, both.labels, strict=True))
    asterism.write(tmp_path / "walk.c3d", replace(both, labels=labels))
    labelled = label_file(tmp_path / "walk.c3d", [walker] * (1 + twice))
    assert "label-two-bodies" not in [finding.code for finding in labelled.findings]
    assert (labelled.labelling.indices >= 0).mean() > 0.95
    given = labelled.recording
    # all that is named is named as before, whichever of the two shows more
    for label, was in zip(labels, both.positions.swapaxes(0, 1), strict=True):
        now = given.positions[:, given.labels.index(label)]
        known = np.isfinite(now).all(axis=1)
        assert known.any() and np.abs(now - was)[known].max() < 1e-5, label


@pytest.mark.parametrize("named", [0, 1])
def test_of_two_people_of_whom_the_file_names_one_that_one_keeps_the_names(walks, walker, tmp_path: Path, named: int) -> None:
    both = beside(walks[5].frames(slice(60)), walks[6].frames(slice(60)), (1.5, 0.3, 0.0))
    numbers, names = [f"*{at}" for at in range(15)], list(walks[5].labels)
    asterism.write(tmp_path / "walk.c3d", replace(both, labels=tuple(names + numbers if named == 0 else numbers + names)))
    labelled = label_file(tmp_path / "walk.c3d", walker)
    codes = [finding.code for finding in labelled.findings]
    assert "label-two-bodies" in codes and "label-names-differ" not in codes
    given = labelled.labelling.indices
    assert (given >= 0).mean() > 0.95 and set(np.unique(given[given >= 0] // 15)) == {named}


def test_the_command_labels_two_walkers_and_a_box(walks, walker, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    box = trained([tumbling_box(rng) for _ in range(4)], miner=None, subjects=list("abcd"))
    walker.save(tmp_path / "gait.model")
    box.save(tmp_path / "box.model")
    three = beside(beside(walks[5], walks[6], (0.8, 0.3, 0.0)), tumbling_box(rng), (0.0, 1.5, 0.2))
    clouds, truth = simulate_gaps_and_ghosts(three, 3, 0, 1)
    formats.write(tmp_path / "three.c3d", Recording.from_clouds(clouds))
    models = ["-m", str(tmp_path / "gait.model"), "-m", str(tmp_path / "box.model"), "-m", str(tmp_path / "gait.model")]
    told = ["--json", str(tmp_path / "told.json"), "--report", str(tmp_path / "page.html")]
    assert main(["label", str(tmp_path / "three.c3d"), *models, "-o", str(tmp_path / "out"), *told]) == 0
    names = walker.marker_set.names
    found = formats.read(tmp_path / "out" / "three.c3d")
    right = []
    for order in ("13", "31"):
        expected = [f"{who}:{name}" for who in order for name in names] + list(box.marker_set.names)
        got, there = found.select(expected), truth >= 0
        gone = np.linalg.norm(got.positions - three.positions, axis=2)
        right.append((got.visible & there & (gone < 1e-3)).sum() / there.sum())
    assert max(right) > 0.97, f"{max(right):.4f} right"
    assert json.loads((tmp_path / "told.json").read_text())["model"] == models[1::2]
    assert main(["label", str(tmp_path / "three.c3d"), *models, "-o", str(tmp_path / "other"), "--frame-wise"]) == 2
    assert "leave out --frame-wise" in capsys.readouterr().err


def test_the_command_says_that_there_are_two_and_labels_one(walks, walker, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walker.save(tmp_path / "gait.model")
    both = beside(walks[5], walks[6], (0.8, 0.3, 0.0))
    formats.write(tmp_path / "two.c3d", Recording.from_clouds(both.clouds()))
    assert main(["label", str(tmp_path / "two.c3d"), "-m", str(tmp_path / "gait.model"), "-o", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "two.c3d: two bodies wear the model's markers, and only one" in said
    positions = formats.read(tmp_path / "out" / "two.c3d").select(walker.marker_set.names).positions
    shares = [(np.linalg.norm(positions - both.positions[:, part], axis=2) < 1e-3).mean() for part in (slice(15), slice(15, 30))]
    assert max(shares) > 0.99
    assert min(shares) == 0.0
