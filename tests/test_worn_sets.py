"""Without a model: which marker set is worn is found by names or points, and every door labels with virtual people."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism import AsterismError
from asterism.cli import main
from asterism.files.cache import cache_folder
from asterism.findings import Finding, Severity
from asterism.labelling import virtual_model
from asterism.live import LabelledFrame, LiveFrame, LiveSession, Replay, SessionWatch, make_labeller
from asterism.recording import Disagreement, MarkerSet, Recording
from asterism.session import FileLabeller, LabellingOptions, LiveLabeller, SetFinder, label_file
from asterism.session.coincident import coincident_findings
from asterism.session.labeller import findings_on_sets
from asterism.session.left_over import LeftOver
from asterism.session.mirror import exchanged_sides
from asterism.session.worn import BY_NAMES, BY_POINTS, GIVEN, FindRules
from asterism.session.worn.find import SetCertainty, SetEvidence, _most_probable, evidence_of
from asterism.session.worn.fit import FrameFit
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from asterism.skeleton import virtual_people


@cache
def person(markers: str) -> Recording:
    """Somebody whom no model has seen, standing and walking."""
    recordings = virtual_people(MarkerSet.load(markers), people=2, frames=200, seed=4711)
    return max(recordings, key=len)


def anonymous(recording: Recording, keep: list[int] | None = None) -> Recording:
    positions = recording.positions if keep is None else recording.positions[:, keep]
    labels = tuple(f"*{m + 1}" for m in range(positions.shape[1]))
    return Recording(positions, labels, recording.rate, recording.vertical)


def found(recording: Recording) -> object:
    (worn,) = SetFinder().of(Path("walk.c3d"), recording)
    return worn


@pytest.mark.parametrize("markers", ["helen-hayes", "plug-in-gait", "optitrack-rizzoli-lower", "vicon-53"])
def test_a_set_is_found_by_its_points(markers: str) -> None:
    worn = found(anonymous(person(markers)))
    assert (worn.name, worn.by) == (markers, BY_POINTS)
    assert worn.shown >= 0.8 * len(MarkerSet.load(markers))
    total = worn.probability + sum(chance for _, chance in worn.others)
    assert 0.5 < worn.probability <= 1.0 and total <= 1.0 + 1e-9


def test_points_left_over_make_a_set_less_sure() -> None:
    """Points that no marker explains may be of a set that is not shipped: what is stated falls, and stays a probability."""
    whole = anonymous(person("optitrack-rizzoli-lower").frames(slice(0, 6)))
    beside = whole.positions[:, :6] + np.array([0.0, 0.0, 0.045])
    more = replace(
        whole, positions=np.concatenate([whole.positions, beside], axis=1), labels=tuple(f"*{m}" for m in range(len(whole.labels) + 6))
    )
    worn = found(more)
    assert worn.shown < worn.points
    assert worn.probability <= worn.shown / worn.points < 0.95
    codes = {finding.code for finding in findings_on_sets(Path("walk.c3d"), [worn], FindRules())}
    assert "label-set-unsure" in codes


def test_ghosts_say_nothing_of_the_set() -> None:
    """Points that come and go beside a body: the set, its probability and the findings are those of the body alone."""
    walk = simulate_walks(1, frames=120, markers="helen-hayes", seed=8)[0]
    rng = np.random.default_rng(1)
    ghosts = np.full((120, 6, 3), np.nan)
    for number, begin in enumerate(range(0, 120, 20)):
        ghosts[begin : begin + 20, number] = walk.positions[begin : begin + 20, number] + rng.uniform(0.05, 0.15, 3)
    beside = replace(
        walk, positions=np.concatenate([walk.positions, ghosts], axis=1), labels=(*walk.labels, *(f"ghost {number}" for number in range(6)))
    )
    alone, among = found(anonymous(walk)), found(anonymous(beside))
    assert among.to_dict() == alone.to_dict()
    assert not findings_on_sets(Path("walk.c3d"), [among], FindRules())


def test_names_that_sets_share_are_sure_where_the_set_is_not() -> None:
    """Plug-in Gait without the markers of its arms is another set, too; both call all points alike, so that nothing need be said."""
    whole = person("plug-in-gait")
    legs = MarkerSet.load("plug-in-gait-lower")
    keep = [place for place, name in enumerate(whole.labels) if name in MarkerSet.load("vicon-35").names]
    assert len(keep) > len(legs) and len(keep) < len(whole.labels)
    worn = found(anonymous(whole, keep))
    likely = [worn.name, *(name for name, chance in worn.others if chance > 0.01)]
    assert set(likely) <= {"plug-in-gait", "vicon-35"}
    assert worn.same_names > worn.probability - 1e-9
    assert all(MarkerSet.load(name).name_of(whole.labels[place]) is not None for name in likely for place in keep)


def frame_fit(*given: list[int], nats: tuple[float, float] = (40.0, 30.0)) -> FrameFit:
    """Two sets of six markers, and the markers that points have by each of them."""
    return FrameFit(np.array(nats), np.array(given), np.array([6, 6]), thing=0.0)


def test_what_is_left_over_makes_a_shipped_set_less_probable() -> None:
    """A marker that is seen in one frame of two is not missing; one that is never seen is, and a point without a marker is left over."""
    every, without, extra = [0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, -1], [0, 1, 2, 3, 4, 5, -1]
    up, rules = np.array([0.0, 0.0, 1.0]), SetCertainty()

    def chances(*fits: FrameFit) -> tuple[float, float]:
        sets, worn = SetEvidence(fits, up).chances(rules)
        return float(np.exp(sets[0])), worn

    whole = chances(frame_fit(every, every))
    assert whole[0] == pytest.approx(1.0 / (1.0 + np.exp(-10.0 / rules.nats)))
    # of four frames the better two count
    seen_once = [frame_fit(without, every), frame_fit([5, *every[:5]], every)] * 2
    assert chances(*seen_once)[0] == pytest.approx(whole[0])
    never_seen, left_over = chances(frame_fit(without, every)), chances(frame_fit(extra, extra))
    assert never_seen[0] == pytest.approx(1.0 / (1.0 + np.exp(-(10.0 + rules.some) / rules.nats)))
    assert never_seen[1] < whole[1] and left_over[1] < whole[1] and left_over[0] == pytest.approx(whole[0])
    # no better than a box of points, and it is rather nothing
    assert chances(frame_fit(every, every, nats=(0.0, -10.0)))[1] < 0.5


def test_the_room_does_not_matter() -> None:
    """A body that is turned, moved, and upright along another axis wears the same."""
    one = anonymous(person("optitrack-rizzoli-lower"))
    turned = one.positions @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T + np.array([7.0, -3.0, 0.0])
    along_y = Recording(turned[:, :, [1, 2, 0]], one.labels, one.rate, "y")
    assert found(along_y).name == found(one).name == "optitrack-rizzoli-lower"


def test_names_decide_where_a_file_has_them() -> None:
    worn = found(person("helen-hayes"))
    assert (worn.name, worn.by, worn.shown) == ("helen-hayes", BY_NAMES, 15)


def test_what_is_given_is_taken() -> None:
    (worn,) = SetFinder(["cmu"]).of(Path("walk.c3d"), anonymous(person("helen-hayes")))
    assert (worn.name, worn.by, worn.probability) == ("cmu", GIVEN, 1.0)


def test_props_are_no_body() -> None:
    """Points of a tray that is carried: the nearest sets are named, and what to do."""
    path = np.linspace(0.0, 2.0, 100)[:, None, None] * np.array([1.0, 0.0, 0.0])
    tray = np.random.default_rng(2).uniform(-0.15, 0.15, (1, 12, 3)) + np.array([0.0, 0.0, 1.0]) + path
    with pytest.raises(AsterismError, match=r"no shipped marker set.*--markers.*body place"):
        found(Recording(tray, tuple(f"*{m}" for m in range(12)), 100.0))


def test_label_needs_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command says which set it took, and how sure it is; the labels are the truth's, and those of Python."""
    truth = person("optitrack-rizzoli-lower").frames(slice(0, 60))
    asterism.write(tmp_path / "walk.c3d", anonymous(truth))
    status = main(["label", str(tmp_path / "walk.c3d"), "-o", str(tmp_path / "out"), "--json", str(tmp_path / "said.json")])
    said = capsys.readouterr()
    assert "optitrack-rizzoli-lower" in said.out and "virtual people" in said.out, said.err
    row = json.loads((tmp_path / "said.json").read_text())["files"][0]
    assert row["virtual_people"] and row["marker_set"][0]["name"] == "optitrack-rizzoli-lower"
    assert status == (1 if "[" in said.err else 0)
    labelled = asterism.read(tmp_path / "out" / "walk.c3d")
    names = [name for name in truth.labels if name in labelled.labels]
    assert len(names) >= 0.9 * len(truth.labels)
    paths = labelled.positions[:, [labelled.labels.index(name) for name in names]]
    wanted = truth.positions[:, [truth.labels.index(name) for name in names]]
    known = ~np.isnan(paths[:, :, 0])
    assert known.mean() > 0.9 and (np.abs(paths - wanted)[known] < 1e-3).all(axis=1).mean() > 0.98
    in_python = label_file(tmp_path / "walk.c3d")
    assert in_python.worn[0].name == "optitrack-rizzoli-lower"
    by_hand = label_file(tmp_path / "walk.c3d", in_python.models)
    np.testing.assert_array_equal(in_python.labelling.indices, by_hand.labelling.indices)


def test_options_that_contradict_each_other(tmp_path: Path) -> None:
    asterism.write(tmp_path / "walk.c3d", anonymous(person("helen-hayes")))
    files = ["label", str(tmp_path / "walk.c3d"), "-o", str(tmp_path / "out")]
    assert main([*files, "--model", "any.model", "--markers", "helen-hayes"]) == 2
    assert main([*files, "--rules", "thesis"]) == 2
    assert main([*files, "--markers", "no-such-set"]) == 2
    assert not (tmp_path / "out").exists()


def test_a_file_without_any_label_is_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points that keep no distance get no name, and the exit status says it."""
    drift = np.random.default_rng(5).normal(0.0, 0.02, size=(12, 16, 3)).cumsum(axis=0)
    scattered = np.random.default_rng(6).uniform(0.0, 2.0, size=(16, 3)) + drift
    asterism.write(tmp_path / "dust.c3d", Recording(scattered, tuple(f"*{m}" for m in range(16)), 100.0))
    status = main(["label", str(tmp_path / "dust.c3d"), "--markers", "helen-hayes", "-o", str(tmp_path / "out")])
    assert status == 1
    labelled = asterism.read(tmp_path / "out" / "dust.c3d")
    columns = [column for column, name in enumerate(labelled.labels) if MarkerSet.load("helen-hayes").name_of(name)]
    nothing = not labelled.visible[:, columns].any()
    assert nothing == ("[label-nothing]" in capsys.readouterr().err)


def test_files_of_a_folder_are_judged_together(tmp_path: Path) -> None:
    """A trial that shows less than another of its folder takes the set from it."""
    whole = anonymous(person("helen-hayes").frames(slice(0, 20)))
    files = [tmp_path / "a.c3d", tmp_path / "b.c3d"]
    asterism.write(files[0], whole)
    asterism.write(files[1], replace(whole, positions=whole.positions[:, :11], labels=whole.labels[:11]))
    alone, together = SetFinder(), SetFinder(files=files)
    part = asterism.read(files[1])
    (one,), (other,) = alone.of(files[1], part), together.of(files[1], part)
    assert other.name == "helen-hayes"
    if one.name == other.name:
        assert other.probability >= one.probability - 1e-9


@pytest.mark.parametrize("people", [2, 3])
def test_people_who_wear_one_set_are_all_labelled(people: int, tmp_path: Path) -> None:
    walks = simulate_walks(people, frames=100, markers="helen-hayes", seed=3)
    together = np.concatenate([walk.positions + np.array([0.0, 1.5 * i, 0.0]) for i, walk in enumerate(walks)], axis=1)
    order = np.random.default_rng(0).permutation(together.shape[1])
    labels = tuple(f"*{m}" for m in range(len(order)))
    asterism.write(tmp_path / "people.c3d", Recording(together[:, order], labels, walks[0].rate))
    labelled = label_file(tmp_path / "people.c3d")
    assert [one.name for one in labelled.worn] == ["helen-hayes"] * people
    (note,) = [finding for finding in labelled.findings if finding.code == "label-two-sets"]
    assert f"{'two' if people == 2 else 'three'} bodies" in note.sentence
    # whose labels come first is free, but each person has those of one body
    given, truth = labelled.labelling.indices.reshape(-1, people, 15), np.argsort(order).reshape(people, 15)
    right = np.array([[(given[:, body] == points).mean() for points in truth] for body in range(people)])
    assert sorted(right.argmax(axis=1)) == list(range(people))
    assert (right.max(axis=1) > 0.99).all()


def test_a_body_comes_after_a_prop() -> None:
    """Evidence of a prop between two bodies ends nothing."""
    (walk,) = simulate_walks(1, frames=60, markers="helen-hayes", seed=3)
    own = evidence_of(walk.clouds())
    tray = np.random.default_rng(1).uniform(-0.15, 0.15, (1, 14, 3)) + np.array([0.0, 6.0, 1.0])
    prop = evidence_of(anonymous(replace(walk, positions=np.tile(tray, (60, 1, 1)), labels=walk.labels[:14])).clouds())
    assert own is not None and prop is not None and not prop.is_body(SetCertainty())
    between = replace(own, second=replace(prop, second=own))
    worn = _most_probable(between, *between.chances(SetCertainty()), SetCertainty())
    assert [one.name for one in worn.bodies] == ["helen-hayes", "helen-hayes"]


@pytest.mark.parametrize("up", [["--vertical", "z"], pytest.param([], marks=pytest.mark.slow)], ids=["z up", "any axis up"])
def test_a_single_file_that_should_not_be_used_says_so(up: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A cloud of another kind of body under a set that is named: nothing may look as if all were well."""
    whole = person("plug-in-gait").frames(slice(0, 5))
    upper = [m for m, name in enumerate(whole.labels) if name[1:4] not in ("ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")]
    asterism.write(tmp_path / "upper.c3d", anonymous(whole, upper))
    status = main(["label", str(tmp_path / "upper.c3d"), "--markers", "helen-hayes-medial", "-o", str(tmp_path / "out"), *up])
    out, err = capsys.readouterr()
    assert status == 1
    assert "do not use" in out
    assert "[label-do-not-use]" in err or "[label-nothing]" in err


def run(*words: str | Path) -> int:
    return main([str(word) for word in words])


@pytest.fixture
def legs(tmp_path: Path) -> Path:
    """A walk with points without names."""
    asterism.write(tmp_path / "walk, anonymous.c3d", anonymous(simulate_walks(1, frames=15, seed=5)[0]))
    return tmp_path / "walk, anonymous.c3d"


@pytest.mark.parametrize(("markers", "told"), [("cmu", True), ("helen-hayes", False)])
def test_a_set_of_which_few_markers_are_there_is_told(markers: str, told: bool, legs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("label", legs, "-o", legs.parent / "out", "--markers", markers) == int(told)
    assert ("[label-few-markers]" in capsys.readouterr().err) == told


@pytest.mark.parametrize(("apart", "told"), [(0.0, True), (0.0004, True), (0.003, False)])
def test_points_that_coincide_are_told(apart: float, told: bool) -> None:
    (walk,) = simulate_walks(1, frames=60, seed=5)
    twice = np.concatenate([walk.positions, walk.positions[:, :4] + np.array([apart, 0.0, 0.0])], axis=1)
    found = coincident_findings("walk.c3d", anonymous(replace(walk, positions=twice, labels=("",) * twice.shape[1])).clouds())
    assert [finding.code for finding in found] == ["label-coincident"] * told
    assert not told or "8 of the 19 points" in found[0].sentence


def test_a_file_with_each_point_twice_says_why_it_has_no_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (walk,) = simulate_walks(1, frames=3, seed=5)
    twice = np.concatenate([walk.positions, walk.positions], axis=1)
    asterism.write(tmp_path / "twice.c3d", anonymous(replace(walk, positions=twice, labels=("",) * 30)))
    # what is up is given, so that not each axis is tried
    assert run("label", tmp_path / "twice.c3d", "-o", tmp_path / "out", "--markers", "helen-hayes", "--vertical", "z") == 1
    assert "[label-coincident]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "near"),
    [
        ("helenhays", "helen-hayes"),
        ("PiG", "plug-in-gait"),
        ("vicon39", "vicon-35, vicon-53"),
        ("rizoli", "rizzoli-foot"),
        ("qq", "cast, "),
    ],
)
def test_a_wrong_name_of_a_set_tells_the_nearest(wrong: str, near: str, legs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("label", legs, "-o", legs.parent / "out", "--markers", wrong) == 2
    said = capsys.readouterr().err
    assert repr(wrong) in said and near in said
    # all names only where none is like it
    assert ("sprint-51" in said) == (wrong == "qq")


def test_markers_can_be_listed(legs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names with commas are a set without aliases: the labels are those of the shipped set of these names."""
    names = MarkerSet.load("helen-hayes").names
    files = [legs.parent / of / legs.name for of in ("listed", "shipped")]
    for file, markers in zip(files, (", ".join(names), "helen-hayes"), strict=True):
        assert run("label", legs, "-o", file.parent, "--markers", markers) == 0
    said = capsys.readouterr()
    assert "list of 15 names" in said.out, said.err
    listed, shipped = (asterism.read(file, markers=names) for file in files)
    np.testing.assert_array_equal(listed.positions, shipped.positions)
    assert run("evaluate", files[0], "--markers", ",".join(names), "--occlusions", "0") == 0
    assert run("label", legs, "-o", legs.parent / "out", "--markers", "LASI,RASI,SACR,HAT") == 2
    assert "does not say where HAT sits" in capsys.readouterr().err
    assert run("label", legs, "-o", legs.parent / "out", "--markers", "mine, with places.toml") == 2
    assert "nor a TOML file that exists" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["file/out", "file/deep/out", "/proc/out", "/proc"])
def test_a_folder_that_cannot_be_written_is_told_first(place: str, legs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Before the labelling, with its name; and nothing is made."""
    if place.startswith("/proc") and not Path("/proc").is_dir():
        pytest.skip("this system has no folder that even its owner cannot write")
    (legs.parent / "file").write_text("")
    output = legs.parent / place
    assert run("label", legs, "-o", output) == 2
    said = capsys.readouterr().err
    assert str(output) in said and "name another with -o" in said and "%" not in said
    assert sorted(path.name for path in legs.parent.iterdir()) == ["file", legs.name]


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_a_few_frames_are_labelled_by_posture(frames: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The labels are right and none is called sure; where nothing moves, a note says why."""
    truth = simulate_walks(1, frames=60, seed=5)[0].frames(slice(20, 20 + frames))
    asterism.write(tmp_path / "short.c3d", anonymous(truth))
    run("label", tmp_path / "short.c3d", "-o", tmp_path / "out")
    said = capsys.readouterr()
    assert f"{frames} frame{'s' if frames > 1 else ''}, z up, 0.00 % labelled" in said.out
    assert ("[label-few-frames]" in said.err) == (frames < 5)
    labelled = asterism.read(tmp_path / "out" / "short.c3d", markers=truth.labels)
    assert np.abs(labelled.positions - truth.positions).max() < 1e-3


def in_a_corner(recording: Recording, axes: list[int]) -> Recording:
    """A recording that says that z is up, in a room that begins nowhere at zero, so that only the body tells."""
    moved = recording.positions - np.nanmin(recording.positions, axis=(0, 1)) + 0.5
    return Recording(moved[:, :, axes], recording.labels, recording.rate, "z")


@pytest.mark.parametrize("door", ["points", "given", "names", "trained"])
def test_a_wrong_vertical_is_noticed(door: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Labels are those of the file that says what is up; a finding tells what was taken. Who says what is up is believed."""
    # of legs alone the reader sees too little, so that labelling has to; each vertical is labelled, so few markers are tried sooner
    by_door = {"points": ("helen-hayes", 10), "names": ("plug-in-gait", 5)}
    markers, frames = by_door.get(door, ("helen-hayes", 20))
    truth = person(markers).frames(slice(0, frames))
    file, straight = (tmp_path / name for name in ("wrong.c3d", "right.c3d"))
    shown = truth if door == "names" else anonymous(truth)
    asterism.write(file, in_a_corner(shown, [1, 2, 0]))
    asterism.write(straight, in_a_corner(shown, [0, 1, 2]))
    assert door != "points" or asterism.read(file).vertical[2] == 1.0, "the reader itself sees it, so that this tests nothing"
    words = ["--markers", markers] if door == "given" else []
    if door == "trained":
        virtual_model(markers).save(tmp_path / "mine.model")
        words = ["--model", str(tmp_path / "mine.model")]
    for path in (file, straight):
        run("label", path, "-o", tmp_path / "out", "--overwrite", *words)
        said = capsys.readouterr().err
        assert ("[label-vertical]" in said or "[format-vertical-conflict]" in said) == (path is file), said
        assert ("with y up" in said) == (path is file), said
    wrong, right = (asterism.read(tmp_path / "out" / path.name, markers=markers).visible for path in (file, straight))
    np.testing.assert_array_equal(wrong, right)
    if door == "given":
        run("label", file, "-o", tmp_path / "out", "--overwrite", "--vertical", "z", *words)
        assert "-vertical]" not in capsys.readouterr().err


def test_learn_needs_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It starts from the virtual people by whom `label` labels, who wear the set of the files' names, or the one given."""
    walk = simulate_walks(1, frames=40, seed=5)[0]
    asterism.write(tmp_path / "walk.c3d", walk)
    asterism.write(tmp_path / "bare.c3d", anonymous(walk))
    found = tmp_path / "found.model"
    assert run("learn", tmp_path / "walk.c3d", "-o", found) == 0
    assert "virtual people who wear helen-hayes; learned 1 recording" in capsys.readouterr().out
    learned = asterism.MarkerModel.load(found)
    assert learned.about["virtual_people"] == 80 and learned.about["recordings"] == 1
    capsys.readouterr()
    # a model has a set; names must be there to be learned; and a model alone teaches nothing
    for words, why in (
        ([found, tmp_path / "walk.c3d", "--markers", "cmu"], "has its own marker set"),
        ([tmp_path / "bare.c3d", "--markers", "helen-hayes"], "no marker of"),
        ([found], "nothing to learn from"),
        ([tmp_path / "walk.c3d", "--markers", "helen-haze"], "helen-hayes"),
    ):
        assert run("learn", *words, "-o", tmp_path / "other.model") == 2
        assert why in capsys.readouterr().err
    assert not (tmp_path / "other.model").exists()


def test_a_live_stream_needs_no_model() -> None:
    """The set is found in the first second in which somebody is there; then the labels are those of a stream of its model."""
    walk = simulate_walks(1, frames=90, rate=50.0, seed=5)[0]
    mixed = np.random.default_rng(1).permutation(15)
    live, delay, nobody = LiveLabeller(50.0, 5, studies="none"), 5, 50
    stream = virtual_model("helen-hayes").stream(50.0, delay)
    assert {live.push(np.zeros((0, 3))) for _ in range(nobody)} == {None}
    assert live.worn is None and "no frame with 8 points" in live.refusal
    found = [live.push(points[mixed]) for points in walk.positions]
    wanted = [stream.push(points[mixed]) for points in walk.positions]
    assert live.marker_set is not None and live.marker_set.names == MarkerSet.load("helen-hayes").names
    labels = [each for each in (*found, *live.flush()) if each is not None]
    # the last push of that second gives the first labels
    assert [each.frame for each in labels] == list(range(nobody + 49 - delay, nobody + 90))
    same = [each for each in (*wanted, *stream.flush()) if each is not None and each.frame >= 49 - delay]
    for one, other in zip(labels, same, strict=True):
        np.testing.assert_array_equal(one.indices, other.indices)
        assert one.frame == nobody + other.frame
    for each in labels:
        names = [walk.labels[mixed[point]] for point in each.indices if point >= 0]
        assert names == [name for name, point in zip(live.marker_set.names, each.indices, strict=True) if point >= 0]
        assert len(names) >= 12


def test_a_live_stream_of_a_given_set_begins_at_once() -> None:
    walk = simulate_walks(1, frames=3, rate=50.0, seed=5)[0]
    labels = LiveLabeller(50.0, markers="helen-hayes", studies="none").push(walk.positions[0])
    assert labels is not None and labels.frame == 0
    with pytest.raises(AsterismError, match="positive"):
        LiveLabeller(0.0)
    with pytest.raises(AsterismError, match="delay"):
        LiveLabeller(50.0, -1)
    with pytest.raises(AsterismError, match="helen-hayes"):
        LiveLabeller(50.0, markers="hh")


def test_name_suggests_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The lines that it writes are those that it reads; a marker in two pieces has one name."""
    walk = simulate_walks(1, frames=80, seed=5)[0]
    pieces = np.concatenate([walk.positions, walk.positions], axis=1)
    pieces[40:, :15], pieces[:40, 15:] = np.nan, np.nan
    asterism.write(tmp_path / "cut.c3d", anonymous(replace(walk, positions=pieces, labels=(*walk.labels,) * 2)))
    names, named = tmp_path / "names.csv", tmp_path / "named.c3d"
    assert run("name", tmp_path / "cut.c3d", "--suggest", names) == 0
    assert "Suggested by virtual people who wear helen-hayes" in capsys.readouterr().out
    assert run("name", tmp_path / "cut.c3d", "--names", names, "-o", named) == 0
    written = asterism.read(named, markers=walk.labels)
    assert written.visible.mean() > 0.95
    assert np.nanmax(np.abs(written.positions - walk.positions)) < 1e-3
    assert run("name", tmp_path / "cut.c3d", "--names", names, "--suggest", tmp_path / "more.csv", "-o", tmp_path / "n.c3d") == 2
    assert "give one of them" in capsys.readouterr().err


def test_warm_up_makes_what_the_first_label_needs(
    legs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After it, labelling makes no model and no shapes; a set that cannot be used is told."""
    # what sets are found by is as long in the making as all else together, and is made as it is anywhere
    SetFinder().of(legs, asterism.read(legs))
    shutil.copytree(cache_folder() / "models", tmp_path / "cache" / "models", ignore=shutil.ignore_patterns("*.model"))
    monkeypatch.setenv("ASTERISM_CACHE", str(tmp_path / "cache"))
    assert run("warm-up", "--markers", "hh") == 2
    assert "helen-hayes" in capsys.readouterr().err
    assert run("warm-up", "--markers", "LASI,RASI,SACR,LKNE,RKNE") == 0
    assert "for LASI,RASI,SACR,LKNE,RKNE; helen-hayes." in capsys.readouterr().out
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").rglob("*") if path.is_file()}
    assert sum(path.suffix == ".model" for path in kept) == 2
    run("label", legs, "-o", tmp_path / "out", "--markers", "helen-hayes")
    # with more points than these markers, larger sets are asked, too
    names = ("LASI", "RASI", "SACR", "LKNE", "RKNE")
    asterism.write(tmp_path / "few.c3d", anonymous(simulate_walks(1, frames=60, seed=5)[0].select(names)))
    run("label", tmp_path / "few.c3d", "-o", tmp_path / "listed", "--markers", ",".join(names))
    assert kept == {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").rglob("*") if path.is_file()}


@pytest.mark.parametrize("mirrored", [False, True])
def test_names_of_a_mirror_image_are_told(mirrored: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Legs alone are as well a mirror image; the names of all pairs are then exchanged, which is no note any more."""
    walk = simulate_walks(1, frames=60, seed=5)[0]
    seen = replace(walk, positions=walk.positions * np.array([1.0, -1.0 if mirrored else 1.0, 1.0]))
    asterism.write(tmp_path / "walk.c3d", seen)
    assert run("label", tmp_path / "walk.c3d", "-o", tmp_path / "out") == int(mirrored)
    assert ("[label-mirrored]" in capsys.readouterr().err) == mirrored


def test_a_few_exchanged_names_are_no_mirror_image() -> None:
    marker_set = MarkerSet.load("helen-hayes")
    other = {name: twin for pair in marker_set.pairs for name, twin in (pair, pair[::-1])}
    all_sides = [Disagreement(name, twin, 0, 9, 10) for name, twin in other.items()]
    assert [finding.code for finding in exchanged_sides("walk.c3d", marker_set, all_sides)] == ["label-mirrored"]
    assert exchanged_sides("walk.c3d", marker_set, all_sides[:4]) == []
    assert exchanged_sides("walk.c3d", marker_set, [replace(each, given=None) for each in all_sides]) == []


@pytest.mark.skipif("ASTERISM_DATA" not in os.environ, reason="needs the recordings that ASTERISM_DATA names")
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_marker_of_one_side_tells_a_mirror_image(mirrored: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The marker on the right shoulder blade of a real walk lies where none is worn."""
    walk = asterism.read(Path(os.environ["ASTERISM_DATA"]) / "movement/cmu41/02_01_walk.c3d", markers="cmu").frames(slice(100, 160))
    seen = replace(walk, positions=walk.positions * np.array([1.0, -1.0 if mirrored else 1.0, 1.0]))
    asterism.write(tmp_path / "walk.c3d", anonymous(seen))
    run("label", tmp_path / "walk.c3d", "-o", tmp_path / "out", "--markers", "cmu")
    said = capsys.readouterr().err
    assert ("RBAC fits on the other side only" in said) == mirrored, said


def told_by_both_doors(recording: Recording, markers: str, folder: Path) -> tuple[list[Finding], list[Finding]]:
    """What `asterism label` and a live session say of a set that was named, of findings on sets."""
    asterism.write(folder / "walk.c3d", recording)
    label = FileLabeller([], LabellingOptions(markers=[markers])).label(folder / "walk.c3d").findings
    watch = SessionWatch("lab", recording.vertical, timed=False)
    make = make_labeller(None, markers, 0, "none")
    LiveSession(Replay(folder / "walk.c3d", speed=float("inf")), make, watch=watch, waits=True).run()
    codes = ("label-other-set", "label-left-over", "label-few-markers", "live-other-markers")
    return tuple([one for one in found if one.code in codes] for found in (label, watch.findings()))  # type: ignore[return-value]


def test_a_set_that_is_half_there_beside_points_without_a_label_is_told_by_every_door(tmp_path: Path) -> None:
    (label,), (live,) = told_by_both_doors(anonymous(person("plug-in-gait").frames(slice(0, 60))), "vicon-53", tmp_path)
    assert (label.code, live.code) == ("label-other-set", "live-other-markers")
    for one in (label, live):
        assert "of 53 markers" in one.sentence and "plug-in-gait (39 of 39 markers)" in one.mend


@pytest.mark.parametrize(
    ("worn", "chosen", "told"),
    [("cmu", "optitrack-baseline", "those of cmu, which"), ("plug-in-gait", "helen-hayes", ""), ("cmu", "cmu", "")],
)
def test_a_set_that_is_like_the_one_that_is_worn_is_told_where_its_names_are_others(worn: str, chosen: str, told: str) -> None:
    """Markers of both sit alike, so that no point is left over."""
    walk, markers = person(worn), MarkerSet.load(chosen).names
    watch, none = SessionWatch("lab", walk.vertical, timed=False, chosen=True), np.full(len(markers), -1)
    for n in range(0, 60, 3):
        points = walk.positions[n][np.isfinite(walk.positions[n]).all(axis=1)]
        labels = np.where(np.arange(len(markers)) < len(points), np.arange(len(markers)), none)
        watch.add(LabelledFrame(LiveFrame(n, n / 10, n / 10, points), markers, labels, np.ones(len(markers)), n / 10), 10.0)
    said = " ".join(finding.sentence for finding in watch.findings())
    assert ("those of" in said) == bool(told) and told in said


def test_the_right_set_that_leaves_as_much_over_is_no_other_set(tmp_path: Path) -> None:
    """Six markers are hidden all the time, beside six points that ride along where no marker is."""
    walk = person("plug-in-gait").frames(slice(0, 60))
    hidden = np.isin(np.arange(len(walk.labels)), np.arange(6) * 6)
    ghosts = walk.positions[:, ~hidden][:, :6] + np.array([0.0, 0.0, 0.07])
    shown = Recording(
        np.concatenate([walk.positions[:, ~hidden], ghosts], axis=1),
        (*np.array(walk.labels)[~hidden], *(f"*{g}" for g in range(6))),
        walk.rate,
        walk.vertical,
    )
    for (one,) in told_by_both_doors(anonymous(shown), "plug-in-gait", tmp_path):
        assert (one.code, one.severity) == ("label-left-over", Severity.NOTE) and "the set is the right one" in one.sentence


@pytest.mark.parametrize("worn", ["hidden", "legs"])
def test_hidden_markers_ghosts_and_a_part_of_a_set_are_no_other_set(worn: str, tmp_path: Path) -> None:
    walk = person("plug-in-gait")
    if worn == "legs":
        shown = [m for m, name in enumerate(walk.labels) if name[1:4] in ("ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")]
        walk = walk.select([walk.labels[m] for m in shown])
    clouds, _ = simulate_gaps_and_ghosts(walk, *((3, 3) if worn == "hidden" else (0, 0)), seed=2)
    label, live = told_by_both_doors(Recording.from_clouds(clouds), "plug-in-gait", tmp_path)
    assert [one.code for one in label] == (["label-few-markers"] if worn == "legs" else []) and not live


@pytest.mark.parametrize(
    ("unseen", "points", "told"),
    [(13, 14, True), (13, 0, False), (13, 3, False), (3, 14, False), (4, 14, False), (5, 5, True), (0, 39, False)],
    ids=["wrong set", "part of it", "part and ghosts", "hidden", "few hidden", "an eighth", "second person"],
)
def test_another_set_leaves_both_markers_and_points_over(unseen: int, points: int, told: bool) -> None:
    shown = np.where(np.arange(39) < unseen, 0.01, 0.9)
    left = LeftOver.of(shown, np.full(100, points))
    assert left.tells is told and (left.markers, left.unseen, left.points) == (39, unseen, points)
    # what comes and goes for half of the time is a ghost
    assert not LeftOver.of(shown, np.where(np.arange(100) % 2, points, 0)).tells
