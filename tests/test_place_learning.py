"""Where the markers of a set sit, learned from labelled recordings: right against a known body, whichever markers are known by name."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.recording import MarkerSet, Place, Recording
from asterism.simulation import simulate_walks
from asterism.simulation.body import SIDED
from asterism.skeleton import learn_places, marker_set_of, place_by_name, with_landmarks
from asterism.skeleton.angles import ANGLES, COLUMN
from asterism.skeleton.build import BuildRules, random_build
from asterism.skeleton.joints import JOINTS, LENGTH_NAMES, TURNS, pose_segments, scales_of
from asterism.skeleton.kinematics import pose
from asterism.skeleton.place_fit import fit_places

WANDS = ("LTHI", "LTIB", "RTHI", "RTIB")


@cache
def walk(seed: int = 1) -> Recording:
    return simulate_walks(subjects=1, frames=120, markers="plug-in-gait-lower", seed=seed)[0]


def renamed(recording: Recording, names: dict[str, str]) -> Recording:
    return replace(recording, labels=tuple(names.get(label, label) for label in recording.labels))


def apart(one: Place, other: tuple[float, ...]) -> float:
    """m between two places on one segment."""
    return float(np.linalg.norm(np.subtract(one.at, other) * (1.0, 1.0, 0.42 if one.limb else 1.0)))


def test_a_wand_of_unknown_name_is_found_on_its_segment():
    """The simulated body has its wands 0.15 of the bone higher on the right, and 8 mm off its table everywhere."""
    unknown = {name: f"stick {i}" for i, name in enumerate(WANDS)}
    mine = MarkerSet(tuple(unknown.get(name, name) for name in walk().labels), pairs=(("stick 0", "stick 2"), ("stick 1", "stick 3")))
    learned = learn_places(mine, [renamed(walk(), unknown)])
    assert len(learned.known) == 12
    assert learned.miss < 0.006
    for name, (segment, *at) in {"LTHI": SIDED["THI"], "LTIB": SIDED["TIB"]}.items():
        place = learned.marker_set.places[unknown[name]]
        assert place.segment == f"left {segment}"
        # Lengths and joints of a person are only told to some centimetres by twelve markers.
        assert apart(place, tuple(at)) < 0.06
    for name, segment in {"RTHI": "thigh", "RTIB": "shank"}.items():
        right = learned.marker_set.places[unknown[name]]
        assert right.segment == f"right {segment}"
        assert right.at[2] > learned.marker_set.places[unknown["L" + name[1:]]].at[2] + 0.08


def test_a_standing_trial_of_a_few_frames_is_enough():
    still = replace(walk(), positions=np.repeat(walk().positions[30:31], 3, axis=0))
    learned = learn_places(MarkerSet(walk().labels), [still])
    assert list(learned.marker_set.places) == list(walk().labels)
    assert learned.marker_set.places["LKNE"].segment == "left thigh"


def test_a_marker_seen_off_its_place_is_told():
    """A marker 0.10 m ahead of the knee is no knee; where all sit as they are called, nothing is told."""
    away = walk().positions.copy()
    column = walk().labels.index("LKNE")
    away[:, column] += 0.12 * np.array([0.0, 1.0, 0.0]) + np.array([0.1, 0.0, 0.0])
    assert learn_places(MarkerSet(walk().labels), [walk()]).findings == ()
    told = learn_places(MarkerSet(walk().labels), [replace(walk(), positions=away)]).findings
    assert ("place-far-from-landmark", "LKNE") in {(finding.code, finding.where) for finding in told}


@pytest.mark.parametrize(
    ("turn", "what"),
    [
        (lambda points: points * [-1.0, 1.0, 1.0], "of 12 markers .* far from where their names say: left and right are exchanged"),
        (lambda points: points * 1000.0, r"8\d\d\.\d\d times as far apart as on a person of 1.70 m; check the unit"),
        (lambda points: points * 0.1, r"0\.09 times as far apart"),
    ],
    ids=["mirrored", "mm", "dm"],
)
def test_what_is_no_person_ends_in_one_sentence(turn, what: str):
    with pytest.raises(AsterismError, match=what):
        learn_places(MarkerSet(walk().labels), [replace(walk(), positions=turn(walk().positions))])


def test_three_people_tell_how_far_hands_place_a_marker():
    people = [replace(person, metadata={"subject": str(i)}) for i, person in enumerate(map(walk, (1, 2, 3)))]
    learned = learn_places(MarkerSet(walk().labels, pairs=MarkerSet.load("plug-in-gait-lower").pairs), people)
    assert learned.people == 3
    spreads = [place.spread for place in learned.marker_set.places.values() if not place.wand]
    # The simulation places markers 8 mm off; the fit sees less of it, since joints follow the markers.
    assert 0.003 < np.median(spreads) < 0.015


def test_landmarks_make_names_known():
    names = {name: f"m{i}" for i, name in enumerate(walk().labels)}
    bare = MarkerSet(tuple(names.values()), pairs=tuple((names[a], names[b]) for a, b in MarkerSet.load("plug-in-gait-lower").pairs))
    with pytest.raises(AsterismError, match=r"only 0 have a known place.*--landmark"):
        learn_places(bare, [renamed(walk(), names)])
    told = {
        names["LASI"]: "anterior superior iliac spine",
        names["LPSI"]: "left posterior superior iliac spine",
        names["LKNE"]: "lateral epicondyle of femur",
        names["LANK"]: "lateral malleolus",
    }
    learned = learn_places(with_landmarks(bare, told), [renamed(walk(), names)])
    assert len(learned.known) == 8
    for name in ("LTIB", "RTIB", "LHEE", "RTOE"):
        side = {"L": "left", "R": "right"}[name[0]]
        assert learned.marker_set.places[names[name]].segment in (f"{side} shank", f"{side} foot")


@pytest.mark.parametrize(
    ("given", "what"),
    [({"LKNE": "elbow of knee"}, "no landmark is called"), ({"MYKNE": "C7"}, "'MYKNE' is not among the markers")],
)
def test_landmarks_that_are_none_are_refused(given: dict[str, str], what: str):
    with pytest.raises(AsterismError, match=what):
        with_landmarks(MarkerSet.load("helen-hayes"), given)


def test_frames_without_enough_known_markers_are_refused():
    # Each frame shows five markers, though all sixteen are seen in one or another.
    hidden = np.full_like(walk().positions, np.nan)
    for t in range(len(hidden)):
        some = (5 * t + np.arange(5)) % 16
        hidden[t, some] = walk().positions[t, some]
    with pytest.raises(AsterismError, match="no frame shows 6 of the known"):
        learn_places(MarkerSet(walk().labels), [replace(walk(), positions=hidden)])
    with pytest.raises(AsterismError, match="give one"):
        learn_places(MarkerSet(walk().labels), [])


def test_all_named_markers_are_a_set_with_its_pairs():
    points = replace(walk(), labels=("Ann:l_knee", "Ann:r_knee", "leftHeel", "rightHeel", "C7", *(f"*{i}" for i in range(11))))
    markers = marker_set_of([points], "mine")
    assert markers.names == ("l_knee", "r_knee", "leftHeel", "rightHeel", "C7")
    assert markers.pairs == (("l_knee", "r_knee"), ("leftHeel", "rightHeel"))
    with pytest.raises(AsterismError, match="no point of the recordings has a name"):
        marker_set_of([replace(points, labels=tuple(f"*{i}" for i in range(16)))], "mine")


def test_the_skeleton_is_its_own_mirror_image():
    rng = np.random.default_rng(1)
    sizes, degrees = np.zeros(8), rng.normal(0.0, 20.0, (1, len(TURNS)))
    mirror = np.diag([1.0, -1.0, 1.0])
    side = {turn.name: i for i, turn in enumerate(TURNS)}
    mirrored = np.empty_like(degrees)
    for name, i in side.items():
        other = name.replace("left ", "right ") if name.startswith("left ") else name.replace("right ", "left ")
        mirrored[0, i] = degrees[0, side[other]] * (1.0 if TURNS[i].axis == 1 else -1.0)
    one = pose_segments(sizes, np.eye(3)[None], np.zeros((1, 3)), degrees)
    other_one = pose_segments(sizes, np.eye(3)[None], np.zeros((1, 3)), mirrored)
    for joint in JOINTS:
        name = joint.segment
        flipped = name.replace("left ", "right ") if name.startswith("left ") else name.replace("right ", "left ")
        assert np.allclose(one.origins[name] @ mirror, other_one.origins[flipped])
        assert np.allclose(mirror @ one.rotations[name] @ mirror, other_one.rotations[flipped])


def test_places_are_read_on_the_skeleton_that_virtual_people_have():
    """Upright with straight arms, of any build without a short limb: each segment has one origin and one set of axes in both."""
    build = random_build(np.random.default_rng(7), 1.55, BuildRules(asymmetry=0.0, short_limb=0.0))
    angles = np.zeros((1, len(ANGLES)))
    angles[0, COLUMN["lean"]] = np.radians(9.0)
    virtual = pose(build, angles)
    sizes = np.log([build.size, *(build.share[name] for name in LENGTH_NAMES)])
    degrees = np.array([[turn.usual if turn.name.endswith("carrying angle") else 0.0 for turn in TURNS]])
    laid = pose_segments(sizes, np.eye(3)[None], np.zeros((1, 3)), degrees)
    for joint in JOINTS:
        assert np.allclose(laid.origins[joint.segment], virtual.origin[joint.segment]), joint.segment
        assert np.allclose(laid.rotations[joint.segment], virtual.axes[joint.segment]), joint.segment


def test_a_posed_skeleton_is_found_again():
    """Markers of a raised arm and a bent knee, of a person of 1.9 m: the misses are below 1 mm, the size within 3 %."""
    places = [MarkerSet.load("plug-in-gait").places[name] for name in MarkerSet.load("plug-in-gait").names]
    degrees = np.zeros((4, len(TURNS)))
    for i, turn in enumerate(TURNS):
        degrees[:, i] = turn.usual + {"left shoulder abduction": 70.0, "right knee flexion": 60.0}.get(turn.name, 0.0)
    sizes = np.zeros(8)
    sizes[0] = np.log(1.9 / 1.7)
    posed = pose_segments(sizes, np.tile(np.eye(3), (4, 1, 1)), np.zeros((4, 3)), degrees)
    points = np.stack(
        [posed.rotations[p.segment] @ (np.array(p.at) * scales_of(sizes, p.segment)) + posed.origins[p.segment] for p in places], axis=1
    )
    found = fit_places(points, places, np.full((len(places), 3), 0.01))
    assert np.nanmedian(found.misses) < 0.001
    assert abs(found.sizes[0] - sizes[0]) < 0.03


def test_the_command_writes_a_set_that_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, out = tmp_path / "static.c3d", tmp_path / "mine.toml"
    formats.write(file, walk())
    assert main(["body", "place", str(file), "-o", str(out)]) == 0
    assert "places of 16 of 16 markers from 1 person" in capsys.readouterr().out
    mine = MarkerSet.load(out)
    assert list(mine.places) == list(mine.names)
    assert mine.places["RKNE"] == mine.places["LKNE"].mirrored()
    # Marker that no file shows: the work is done, and something was found.
    assert main(["body", "place", str(file), "--markers", "helen-hayes", "-o", str(tmp_path / "hh.toml")]) == 1
    assert "SACR is seen in no recording" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["-o", "mine.txt"], "a marker set is TOML"),
        (["-o", "mine.toml", "--markers", "no-such-set"], "is neither shipped"),
        (["-o", "mine.toml", "--landmark", "LKNE"], 'has no "="'),
        (["-o", "mine.toml", "--landmark", "LKNE=knee of elbow"], "no landmark is called"),
        (["-o", "mine.toml", "--markers", "A,B,C"], "6 are needed"),
    ],
)
def test_bad_words_end_in_one_sentence(tmp_path: Path, monkeypatch, capsys, words: list[str], what: str):
    monkeypatch.chdir(tmp_path)
    formats.write(tmp_path / "static.c3d", walk())
    assert main(["body", "place", "static.c3d", *words]) == 2
    error = capsys.readouterr().err.strip()
    assert what in error and len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "file", "loose"),
    [
        ("leuven", "movement/fullbody61/markers_Squat2.trc", ("UA", "LA1", "LA2", "LA3", "THI", "TIB")),
        ("optitrack-baseline-lower", "movement/optitrack-lower/skeleton20/walk_slow_001.c3d", ("Thigh", "Shin", "ToeTip")),
    ],
)
def test_loose_markers_of_real_people_are_found_on_their_segments(data: Path, name: str, file: str, loose: tuple[str, ...]):
    shipped = MarkerSet.load(name)
    recording = formats.read(data / file, markers=name)
    unknown = {n: f"x{i}y" for i, n in enumerate(shipped.names) if n[1:].startswith(loose)}
    mine = MarkerSet(tuple(unknown.get(n, n) for n in shipped.names))
    learned = learn_places(mine, [renamed(recording, unknown)])
    assert len(learned.known) == len(shipped) - len(unknown)
    wrong = {n for n, other in unknown.items() if learned.marker_set.places[other].segment != shipped.places[n].segment}
    assert wrong == set()


def test_exchanged_elbows_of_a_real_person_are_told(data: Path):
    """The inner and outer elbow of this file are exchanged on both sides (`corrections.json`); a knee trial of the same person is not."""
    told = {}
    for trial in ("ech_anat_pose", "ech_right_knee"):
        recording = formats.read(data / f"movement/qtm-fullbody/{trial}.c3d", markers="landmarks-73")
        told[trial] = {f.where for f in learn_places(MarkerSet.load("landmarks-73"), [recording]).findings}
    assert told == {"ech_anat_pose": {"LLHE", "LMHE", "RLHE", "RMHE"}, "ech_right_knee": set()}


def test_usual_names_say_where_markers_sit():
    usual = MarkerSet(("LKNE", "RKNE", "L.ASIS", "hat", "LTIB", "RTIB"), aliases={"hat": ("HeadTop",)})
    placed = place_by_name(usual)
    assert list(placed.places) == ["LKNE", "RKNE", "L.ASIS", "hat", "LTIB", "RTIB"]
    assert placed.places["L.ASIS"] == MarkerSet.load("helen-hayes").places["LASI"]
    # What the set says itself comes first.
    own = Place("pelvis", (0.1, 0.1, 0.1))
    assert place_by_name(replace(usual, places={"LKNE": own})).places["LKNE"] == own


def test_a_cluster_has_no_place_by_its_name_alone():
    """LTH1 of a few sets that differ; but in a set that is worn as it ships, every name is known."""
    names = ("LASI", "RASI", "SACR", "LTHI", "LHEE", "RHEE", "LTOE", "LANK", "LTH1", "LTH2", "nose ring")
    assert set(names) - set(place_by_name(MarkerSet(names)).places) == {"LTH1", "LTH2", "nose ring"}
    shipped = MarkerSet.load("cast")
    assert place_by_name(replace(shipped, places={})).places == shipped.places
