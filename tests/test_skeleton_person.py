"""A person's skeleton, fitted to trials that a body of other bones moves; what its movement tells, and `asterism skeleton`."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import twins_skeleton as twins
from typer.testing import CliRunner

from asterism import formats
from asterism.cli import command_line
from asterism.errors import AsterismError
from asterism.recording import Recording
from asterism.recording.filled import GapFill, logged_fills
from asterism.skeleton import FittedPerson, KinematicsRules, PersonRules, fit_person, load_body, save_body, solve_kinematics, tree_of
from asterism.skeleton.outputs import kinematics_findings, kinematics_table
from asterism.skeleton.person import joint_label
from asterism.skeleton.tree import TreeMarker

FEW = PersonRules(frames=(2, 8))
"""Few frames: a quick fit."""


LOWER = ("LASI", "RASI", "SACR", *(side + name for side in "LR" for name in ("THI", "KNE", "TIB", "ANK", "HEE", "TOE")))
BONES = ("thigh", "shank", "foot")
UPPER = ("C7", "T10", "CLAV", "STRN", *(side + name for side in "LR" for name in ("SHO", "ELB", "WRA", "WRB", "FIN")))


def moved(frames: int, rate: float, labels: tuple[str, ...] | None = None, seed: int = 1) -> Recording:
    """A body of Plug-in-Gait's markers, whose joints were learned from people: it walks ahead, knees and hips bent in turn."""
    tree, rng = tree_of(load_body("plug-in-gait")), np.random.default_rng(seed)
    time, names = np.arange(frames) / rate, [c.name for c in tree.coordinates]
    q = np.tile(tree.start, (frames, 1)) + 0.05 * np.sin(2 * np.pi * (0.7 * time[:, None] + rng.uniform(0, 1, len(names))))
    for side, shift in (("left", 0.0), ("right", np.pi)):
        phase = 2 * np.pi * time + shift
        q[:, names.index(f"{side} thigh flexion")] = 0.15 + 0.4 * np.sin(phase)
        q[:, names.index(f"{side} shank flexion")] = 0.6 + 0.45 * np.cos(phase)
        q[:, names.index(f"{side} upper arm raising")] = -0.3 * np.sin(phase)
    positions = np.array([twins.markers_of(tree, q[t], np.eye(3), np.array([1.1 * time[t], 0.2, 0.8])) for t in range(frames)])
    recording = Recording(positions + rng.normal(0, 0.001, positions.shape), tree.labels, rate, metadata={"file": "walk"})
    return recording if labels is None else recording.select(labels)


def stood() -> Recording:
    tree, rng = tree_of(load_body("plug-in-gait")), np.random.default_rng(9)
    still = twins.markers_of(tree, np.zeros(len(tree.coordinates)), np.eye(3), np.array([0.0, 0.0, 0.83]))
    return Recording(still + rng.normal(0, 0.0005, (6, *still.shape)), tree.labels, 100.0, metadata={"file": "static"})


@pytest.fixture(scope="module")
def person() -> FittedPerson:
    return fit_person([stood()], [moved(90, 60.0)], rules=FEW)


def angle(found, name: str) -> np.ndarray:
    """(T,) degrees."""
    return np.degrees(found.coordinates[:, [c.name for c in found.tree.coordinates].index(name)])


def without(recording: Recording, names: tuple[str, ...], frames: slice) -> Recording:
    positions = recording.positions.copy()
    positions[frames, [[recording.labels.index(name)] for name in names]] = np.nan
    return replace(recording, positions=positions)


def test_bones_are_as_long_as_those_that_moved_and_angles_swing_as_far(person) -> None:
    body = {bone.name: np.array(bone.pivot) for bone in load_body("plug-in-gait").bones}
    for name, lower in (("left thigh", "left shank"), ("right shank", "right foot"), ("left forearm", "left hand")):
        truth = np.linalg.norm(body[lower] - body[name])
        assert abs(person.lengths[name] - truth) < 0.02, f"{name}: {100 * person.lengths[name]:.1f} cm, was {100 * truth:.1f}"
    walk = moved(90, 60.0)
    found = solve_kinematics(person.tree, walk)
    assert np.ptp(angle(found, "left knee flexion")) == pytest.approx(np.degrees(0.9), abs=3.0)
    assert np.ptp(angle(found, "right hip flexion")) == pytest.approx(np.degrees(0.8), abs=3.0)
    assert np.nanmedian(found.misses) < 0.003
    assert kinematics_findings(found, walk) == []


def test_the_skeletons_bones_are_rigid_and_its_motion_places_the_same_joints(person) -> None:
    found = solve_kinematics(person.tree, moved(20, 60.0))
    motion, joints = found.motion(), found.posed[1]
    assert np.allclose(motion.joints, joints, atol=1e-9)
    at = person.tree.bone_names.index
    lengths = np.linalg.norm(joints[:, at("left shank")] - joints[:, at("left thigh")], axis=1)
    assert np.ptp(lengths) < 1e-12, "a bone's length is constant"
    assert motion.lengths[at("left thigh")] == pytest.approx(person.lengths["left thigh"])


@pytest.mark.parametrize("axes", [((1, 0, 0), (0, 0, 1), (0, -1, 0)), ((1, 0, 0), (0, -1, 0), (0, 0, -1))], ids=["y up", "z down"])
def test_another_vertical_changes_no_angle(person, axes) -> None:
    walk, turn = moved(30, 60.0), np.array(axes, dtype=np.float64)
    found = solve_kinematics(person.tree, walk)
    other = solve_kinematics(person.tree, replace(walk, positions=walk.positions @ turn.T, vertical=turn @ [0, 0, 1]))
    assert np.degrees(np.abs(found.coordinates - other.coordinates)).max() < 0.01
    assert np.allclose(other.posed[1], found.posed[1] @ turn.T, atol=1e-5)
    assert np.allclose(other.motion().joints, other.posed[1], atol=1e-9)
    up = other.motion().offsets[person.tree.bone_names.index("head")] @ other.vertical
    assert up > 0.2, "at rest the head is above the trunk"


def test_a_bone_that_is_not_seen_is_led_by_its_neighbours_and_less_certain(person) -> None:
    walk = moved(120, 60.0)
    hidden = without(walk, ("LTIB", "LANK", "LHEE", "LTOE"), slice(40, 60))
    whole, found = solve_kinematics(person.tree, walk), solve_kinematics(person.tree, hidden)
    off = np.abs(angle(found, "left knee flexion") - angle(whole, "left knee flexion"))
    sd = np.degrees(found.sd[:, person.tree.numbers.index("left knee flexion")])
    assert off.max() < 15.0
    assert sd[50] > 1.5 * sd[10]
    assert off.max() < 3.0 * sd[50]
    assert [f.code for f in kinematics_findings(found, hidden)] == ["skeleton-bone-unseen"] * 2


def test_half_of_the_markers_and_lost_frames_leave_a_movement(person) -> None:
    walk, rng = moved(60, 60.0), np.random.default_rng(2)
    positions = walk.positions.copy()
    positions[rng.random(positions.shape[:2]) < 0.5] = np.nan
    positions[20:24, 2:] = np.nan
    dirty = replace(walk, positions=positions)
    whole, found = solve_kinematics(person.tree, walk), solve_kinematics(person.tree, dirty)
    assert np.sqrt(np.mean((angle(found, "right knee flexion") - angle(whole, "right knee flexion"))[~found.known == 0] ** 2)) < 3.0
    assert list(np.nonzero(~found.known)[0]) == [20, 21, 22, 23]
    assert np.isnan(found.motion().root[21]).all()
    assert "skeleton-frames-left-out" in [f.code for f in kinematics_findings(found, dirty)]


def test_a_marker_ten_centimetres_off_and_two_exchanged_ones_hardly_count(person) -> None:
    walk = moved(40, 60.0)
    positions = walk.positions.copy()
    at = walk.labels.index
    positions[:, at("LKNE")] += [0.0, 0.06, 0.08]
    positions[:, [at("RELB"), at("RWRA")]] = positions[:, [at("RWRA"), at("RELB")]]
    wrong = replace(walk, positions=positions)
    whole, found = solve_kinematics(person.tree, walk), solve_kinematics(person.tree, wrong)
    assert np.abs(angle(found, "left knee flexion") - angle(whole, "left knee flexion")).max() < 6.0
    told = {finding.where.split(", ")[1] for finding in kinematics_findings(found, wrong) if finding.code == "skeleton-marker-astray"}
    assert {"LKNE", "RELB", "RWRA"} <= told


@pytest.mark.parametrize(
    ("labels", "root", "absent"),
    [
        (LOWER, "pelvis", "thorax"),
        (UPPER, "thorax", "pelvis"),
    ],
    ids=["lower body", "upper body"],
)  # fmt: skip
def test_a_part_of_the_body_has_the_bones_that_it_shows(labels, root, absent) -> None:
    walk = moved(12, 25.0, labels)
    person = fit_person([], [walk], rules=FEW)
    assert person.tree.bone_names[0] == root
    assert absent not in person.tree.bone_names
    assert [finding.code for finding in person.findings] == ["skeleton-no-static"]
    assert np.nanmedian(solve_kinematics(person.tree, walk).misses) < 0.005


def test_columns_of_joints_tell_where_the_joints_are() -> None:
    truth = load_body("plug-in-gait")
    walk, tree = moved(40, 60.0, LOWER), tree_of(truth)
    at = [TreeMarker(joint_label(f"{side} {bone}"), f"{side} {bone}", (0.0, 0.0, 0.0)) for side in ("left", "right") for bone in BONES]
    q = solve_kinematics(tree, moved(40, 60.0))
    joints = np.stack([q.posed[1][:, tree.bone_names.index(marker.bone)] for marker in at], axis=1)
    told = replace(
        walk,
        positions=np.concatenate([walk.positions, joints], axis=1),
        labels=(*walk.labels, *(marker.name for marker in at)),
        source=None,
    )
    found, alone = (fit_person([], [trial], rules=FEW) for trial in (told, walk))
    pivots = {bone.name: np.array(bone.pivot) for bone in truth.bones}
    for upper, lower in (("left thigh", "left shank"), ("right shank", "right foot")):
        length = np.linalg.norm(pivots[lower] - pivots[upper])
        assert abs(found.lengths[upper] - length) < 0.006
        assert abs(found.lengths[upper] - length) < abs(alone.lengths[upper] - length)
    assert found.tree.labels == walk.labels, "a joint is no marker"


def test_what_was_filled_hardly_counts(person) -> None:
    walk, knee = moved(20, 60.0), "left knee flexion"
    positions = walk.positions.copy()
    at = walk.labels.index("LANK")
    positions[5:15, at] += [0.05, 0.0, 0.0]
    wrong = replace(walk, positions=positions)
    filled = logged_fills(wrong, [GapFill("LANK", 5 / 60, 14 / 60, 0.05)], "test", 0.1)
    # By squares: Student's t would let a marker go that is so far off.
    rules = KinematicsRules(tails=0.0)
    whole, off, on = (angle(solve_kinematics(person.tree, each, rules=rules), knee) for each in (walk, wrong, filled))
    assert np.abs(on - whole).max() < 0.3 * np.abs(off - whole).max()


def test_trials_of_several_people_are_told() -> None:
    trials = [replace(moved(8, 25.0, LOWER), metadata={"subject": name}) for name in ("Ann", "Bob")]
    assert [finding.code for finding in fit_person(trials[:1], trials[1:], rules=FEW).findings] == ["skeleton-several-people"]


def exchanged(recording: Recording, names: tuple[str, ...]) -> Recording:
    """The recording with these markers of both sides under each other's names."""
    swap = {side + name: other + name for name in names for side, other in ("LR", "RL")}
    return replace(recording, labels=tuple(swap.get(label, label) for label in recording.labels))


def test_names_of_the_wrong_side_are_told_or_refused() -> None:
    walk = moved(12, 25.0)
    told = [f.where for f in fit_person([], [exchanged(walk, ("ASI",))], rules=FEW).findings if f.code == "skeleton-marker-displaced"]
    assert sorted(told) == ["walk, LASI", "walk, RASI"]
    everything = tuple(label[1:] for label in walk.labels if label[0] == "L" and "R" + label[1:] in walk.labels)
    with pytest.raises(AsterismError, match="left and right are exchanged, the recording is mirrored"):
        fit_person([], [exchanged(walk, everything)], rules=FEW)


def test_one_frame_is_enough_for_a_pose_and_nothing_for_none(person) -> None:
    found = solve_kinematics(person.tree, moved(1, 60.0))
    assert found.coordinates.shape == (1, len(person.tree.coordinates))
    assert np.isfinite(found.sd).all()
    with pytest.raises(AsterismError, match="give a standing one, a moving one, or both"):
        fit_person([])


def test_the_table_holds_lengths_and_each_frames_coordinates(person) -> None:
    walk = replace(moved(5, 60.0), first_frame=11)
    found = solve_kinematics(person.tree, walk)
    table = kinematics_table([("walk", found, walk)])
    rows = [row for row in table.rows if row[2] == "left knee flexion"]
    assert [row[3] for row in rows] == [11, 12, 13, 14, 15]
    assert [row[5] for row in rows] == pytest.approx(angle(found, "left knee flexion").tolist())
    assert {row[1] for row in table.rows} == {"length", "spread", "miss", "coordinate"}


def test_the_command_writes_c3d_table_and_json(tmp_path) -> None:
    formats.write(tmp_path / "walk.c3d", moved(12, 60.0))
    save_body(load_body("plug-in-gait"), tmp_path / "ann.toml")
    words = ["skeleton", tmp_path / "walk.c3d", "--model", tmp_path / "ann.toml", "-o", tmp_path / "out", "--table", tmp_path / "out.csv"]
    ran = CliRunner().invoke(command_line(["skeleton"]), [str(word) for word in (*words, "--json", tmp_path / "out.json")])
    assert ran.exit_code == 0, ran.output
    written = json.loads((tmp_path / "out.json").read_text())
    knee = written["files"][0]["coordinates"]["left shank flexion"]
    assert np.ptp(knee["values"]) == pytest.approx(np.degrees(0.45 * (1 - np.cos(2 * np.pi * 11 / 60))), abs=3.0)
    copy = formats.read(tmp_path / "out" / "walk.c3d", markers=["left shank joint", "left shank angles"])
    assert np.isfinite(copy.positions[:, 0]).all()
    assert written["lengths_m"]["left thigh"] == pytest.approx(0.331, abs=0.01)
    assert (tmp_path / "out.csv").read_text().startswith("file,kind,name,frame")
