"""A folder for OpenSim: read by another reader it shows the person, the model's markers and the forces; OpenSim itself runs from it."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from opensim_models import LUMBAR, centres, joints, written_model, written_old_model
from test_opensim_forces import two_steps, written

from asterism import Recording, formats
from asterism.cli import main
from asterism.formats.opensim_model import read_osim
from asterism.opensim import bodies_of
from asterism.simulation import simulate_standing, simulate_walks

ROOM = {"z": np.eye(3), "y": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]), "-x": np.diag([-1.0, -1.0, 1.0])}
"""From the simulation's room, z up: itself, one with y up, and one in which the same person walks the other way along x."""

TORSO = "</socket_parent><translation>{} {} {}".format(*LUMBAR)


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a walk, a standing trial of the same person, and a model."""
    folder = tmp_path_factory.mktemp("opensim")
    [walk], [still] = simulate_walks(1, 150, markers="plug-in-gait", seed=3), simulate_standing(1, 20, markers="plug-in-gait", seed=3)
    gap = walk.positions.copy()
    gap[40:50, -1] = np.nan
    formats.write(folder / "walk.c3d", replace(walk, positions=gap))
    formats.write(folder / "stands.c3d", still)
    written_model(folder / "round.osim")
    return folder


def run(folder: Path, out: Path, *words: object, walk: str = "walk.c3d") -> int:
    given = [
        folder / walk,
        "--static",
        folder / "stands.c3d",
        "--model",
        folder / "round.osim",
        "-o",
        out,
        "--measure",
        "BodyMass=70",
        *words,
    ]
    return main(["opensim", *(str(one) for one in given)])


def trc(path: Path) -> tuple[list[str], np.ndarray, list[str]]:
    """Names, (T, 2 + 3 P) numbers with NaN for blanks, and the header's values: as OpenSim reads it, a cell between two tabs."""
    lines = path.read_text(encoding="utf-8").split("\n")
    names = [name for name in lines[3].split("\t")[2:] if name]
    rows = []
    for line in lines[6:]:
        if line:
            # what stands behind a last tab is no cell
            cells = line.removesuffix("\t").split("\t")
            assert len(cells) == 2 + 3 * len(names)
            rows.append([float(cell) if cell else np.nan for cell in cells])
    return names, np.array(rows), lines[2].split("\t")


def test_a_model_is_read_as_it_stands(tmp_path: Path) -> None:
    truth = centres()
    for path in (written_model(tmp_path / "new.osim"), written_old_model(tmp_path / "old.osim")):
        model = read_osim(path)
        assert set(model.masses) == {body for _, _, body, *_ in joints()} and model.mass == pytest.approx(73.4)
        for body, joint in model.joints.items():
            # the spline of the knee is 0 at 0 degrees, as all its points are on one line
            np.testing.assert_allclose(joint.centre, truth[body], atol=1e-9, err_msg=body)
            np.testing.assert_allclose(model.in_body(body, joint.centre), 0.0, atol=1e-9)
        assert model.joints["femur_l"].coordinates == ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l")


def test_turned_frames_and_functions_move_a_body(tmp_path: Path) -> None:
    text = written_model(tmp_path / "a.osim").read_text(encoding="utf-8")
    # the left ankle's frames are turned on both sides, and its child lies 0.1 m beside the joint along the turned y
    at = text.index('<CustomJoint name="ankle_l">')
    turned = text[at:].replace("<orientation>0 0 0</orientation>", "<orientation>0 0 1.5707963267948966</orientation>", 2)
    turned = turned.replace("<translation>0 0 0</translation>", "<translation>0 0.1 0</translation>", 1)
    constant = '<Constant name="function"><value>0</value></Constant>'
    polynomial = (
        '<MultiplierFunction name="function"><function><PolynomialFunction><coefficients>3 0.25</coefficients></PolynomialFunction>'
    )
    turned = turned.replace(constant, f"{polynomial}</function><scale>2</scale></MultiplierFunction>", 1)
    (tmp_path / "b.osim").write_text(text[:at] + turned, encoding="utf-8")
    model = read_osim(tmp_path / "b.osim")
    # the first constant is the turn about x, of 2 * 0.25 rad, in the turned frame: about the room's y
    cosine, sine = np.cos(0.5), np.sin(0.5)
    expected = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    np.testing.assert_allclose(model.rotations["talus_l"], expected, atol=1e-9)
    np.testing.assert_allclose(model.origins["talus_l"], centres()["talus_l"] - expected @ [0, 0.1, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("femur_r", "thigh_r"), "no body femur_r"),
        (lambda text: text.replace(f"/bodyset/pelvis{TORSO}", f"/bodyset/hips{TORSO}"), "torso hangs on hips"),
        (lambda text: text.replace("LinearFunction", "Sine"), "function Sine"),
        (lambda text: text[:2000], "no model of OpenSim"),
        (lambda text: text.replace("Model", "Figure"), "no model of OpenSim"),
        (lambda text: text.replace("<mass>9.0", "<mass>heavy"), "is damaged"),
    ],
    ids=["names", "hangs", "function", "cut", "other", "number"],
)
def test_a_model_that_cannot_be_used_is_said(
    change: Any, said: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.osim").write_text(change((session / "round.osim").read_text(encoding="utf-8")), encoding="utf-8")
    assert main(["opensim", str(session / "walk.c3d"), "-m", str(tmp_path / "bad.osim"), "-o", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("room", list(ROOM))
def test_the_scaled_model_stands_where_the_person_does(room: str, session: Path, tmp_path: Path) -> None:
    for name in ("walk.c3d", "stands.c3d"):
        recording = formats.read(session / name)
        up = np.array([0.0, 1.0, 0.0]) if room == "y" else recording.vertical
        turned = replace(recording, positions=recording.positions @ ROOM[room].T, vertical=up, source=None, origin=None, taken=())
        formats.write(tmp_path / name, turned)
    (tmp_path / "round.osim").write_bytes((session / "round.osim").read_bytes())
    assert run(tmp_path, tmp_path / "out", "--json", tmp_path / "a.json") == 0
    result = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    # scaled by hand: each joint is as far from the one above as its body is larger
    table = [line.split(",") for line in (tmp_path / "out" / "scale_factors.csv").read_text(encoding="utf-8").split("\n")[1:] if line]
    factors = {cells[1]: float(cells[2]) for cells in table}
    assert factors == pytest.approx({body: one["factor"] for body, one in result["scales"].items()}, rel=1e-6)
    places = {"ground": np.zeros(3)}
    for _, parent, body, _, place, _, _ in joints():
        places[body] = places[parent] + np.multiply(place, factors.get(parent, 1.0))
    names, rows, header = trc(tmp_path / "out" / "stands.trc")
    assert header[4] == "mm"
    stands = dict(zip(names, np.nanmedian(rows[:, 2:], axis=0).reshape(-1, 3) / 1000, strict=True))
    there, here = [], []
    for marker in ElementTree.parse(tmp_path / "out" / "markers.xml").getroot().iter("Marker"):
        body = (marker.findtext("socket_parent_frame") or "").removeprefix("/bodyset/")
        location = np.array([float(word) for word in (marker.findtext("location") or "").split()])
        there.append(places[body] + factors[body] * location)
        here.append(stands[marker.get("name", "")])
    model, person = np.array(there), np.array(here)
    assert len(model) > 25
    # y up and x ahead in both, so that shifted alone, not turned, the model stands in the person to a few degrees of its joints
    apart = (model - model.mean(axis=0)) - (person - person.mean(axis=0))
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 0.03
    assert person[:, 1].min() > -0.02 and np.ptp(person[:, 1]) > 1.0
    # walking along x as near as quarter turns bring it: this person walks 31 degrees off an axis of the room
    _, walk, _ = trc(tmp_path / "out" / "walk.trc")
    moved = np.nanmean(walk[-1, 2:].reshape(-1, 3) - walk[0, 2:].reshape(-1, 3), axis=0)
    assert moved[0] > 500 and moved[0] > 1.4 * np.abs(moved[1:]).max()


def test_markers_of_one_body_are_as_far_apart_as_the_person_s(session: Path, tmp_path: Path) -> None:
    assert run(session, tmp_path / "out", "--json", tmp_path / "a.json") == 0
    result = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    names, rows, _ = trc(tmp_path / "out" / "stands.trc")
    stands = dict(zip(names, np.nanmedian(rows[:, 2:], axis=0).reshape(-1, 3) / 1000, strict=True))
    root = ElementTree.parse(tmp_path / "out" / "scale.xml").getroot()
    tool = root.find("ScaleTool")
    assert tool is not None and float(tool.findtext("mass") or 0) == 70.0
    assert (tmp_path / "out" / (tool.findtext("GenericModelMaker/model_file") or "")).resolve() == (session / "round.osim").resolve()
    scaled = set()
    for one in tool.iter("Measurement"):
        body = one.get("name", "")
        pair = (one.findtext(".//markers") or "").split()
        own = [result["markers"][name] for name in pair]
        at = [centres()[marker["body"]] + marker["location_m"] for marker in own]
        # as the scale tool does it: the person's distance over the model's
        measured = np.linalg.norm(stands[pair[0]] - stands[pair[1]]) / np.linalg.norm(at[0] - at[1])
        assert measured == pytest.approx(result["scales"][body]["factor"], rel=0.01), body
        scaled.add(body)
    scaled |= {one.findtext("segment") for one in tool.iter("Scale")}
    assert scaled == {body for _, _, body, *_ in joints()}


def test_the_tools_read_each_other_s_files(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(session, out) == 0
    scale, motion = (ElementTree.parse(out / name).getroot()[0] for name in ("scale.xml", "walk_ik.xml"))
    assert motion.findtext("model_file") == scale.findtext("MarkerPlacer/output_model_file")
    placed = {marker.get("name"): marker for marker in ElementTree.parse(out / "markers.xml").getroot().iter("Marker")}
    for tool, file in ((scale, "stands.trc"), (motion, "walk.trc")):
        names, rows, _ = trc(out / file)
        tasks = [task.get("name") for task in tool.iter("IKMarkerTask")]
        assert tasks and set(tasks) <= set(names) & set(placed)
        assert all(float(task.findtext("weight") or 0) > 0 for task in tool.iter("IKMarkerTask"))
        begin, end = (float(word) for word in (tool.findtext(".//time_range") or "").split())
        assert rows[0, 1] == pytest.approx(begin) and rows[-1, 1] == pytest.approx(end)
    # joint centres are computed, and nothing that a walk's inverse kinematics may lean on
    assert "RHJC" in placed and not {"RHJC", "LAJC"} & {task.get("name") for task in motion.iter("IKMarkerTask")}
    weights = {str(task.get("name")): float(task.findtext("weight") or 0) for task in motion.iter("IKMarkerTask")}
    assert weights["LASI"] > 2 * weights["LTHI"], "skin slides on the thigh"
    # two markers on the foot, and none on the toes, whose joint no marker tells
    held = {task.get("name") for task in motion.iter("IKCoordinateTask")}
    assert held == {"mtp_angle_r", "mtp_angle_l"}
    assert not (out / "walk_id.xml").exists(), "no plates, no inverse dynamics"


def test_a_coordinate_that_follows_another_is_left_to_the_model(session: Path, tmp_path: Path) -> None:
    text = (session / "round.osim").read_text(encoding="utf-8")
    line = "<coupled_coordinates_function><LinearFunction><coefficients>1 0</coefficients></LinearFunction></coupled_coordinates_function>"
    names = "<independent_coordinate_names>knee_angle_r</independent_coordinate_names>"
    names += "<dependent_coordinate_name>mtp_angle_r</dependent_coordinate_name>"
    coupled = f'<CoordinateCouplerConstraint name="c"><isEnforced>true</isEnforced>{line}{names}</CoordinateCouplerConstraint>'
    whole = text.replace("</Model>", f"<ConstraintSet><objects>{coupled}</objects></ConstraintSet></Model>")
    (tmp_path / "round.osim").write_text(whole, encoding="utf-8")
    [coupler] = read_osim(tmp_path / "round.osim").couplers
    assert (coupler.dependent, coupler.independent) == ("mtp_angle_r", ("knee_angle_r",)) and coupler.function.y.tolist() == [1.0, 0.0]
    words = [session / "walk.c3d", "--static", session / "stands.c3d", "-m", tmp_path / "round.osim", "-o", tmp_path / "out"]
    assert main(["opensim", *(str(one) for one in words), "--measure", "BodyMass=70"]) == 0
    # held at zero, it would hold the knee
    tasks = ElementTree.parse(tmp_path / "out" / "walk_ik.xml").getroot().iter("IKCoordinateTask")
    assert [task.get("name") for task in tasks] == ["mtp_angle_l"]


def test_gaps_are_missing_samples_to_opensim(session: Path, tmp_path: Path) -> None:
    assert run(session, tmp_path / "out") == 0
    names, rows, _ = trc(tmp_path / "out" / "walk.trc")
    assert names[-1] == "RTOE" and np.isnan(rows[40:50, -3:]).all() and np.isfinite(rows[50:, -3:]).all()


def test_the_pose_is_taken_where_no_sample_is_missing(session: Path, tmp_path: Path) -> None:
    still = formats.read(session / "stands.c3d")
    positions = still.positions.copy()
    for label, gap in (("LASI", slice(0, 2)), ("LTOE", slice(9, 11)), ("T10", slice(5, 20))):
        positions[gap, still.labels.index(label)] = np.nan
    formats.write(tmp_path / "stands.npz", replace(still, positions=positions, source=None, origin=None, taken=()))
    words = [session / "walk.c3d", "--static", tmp_path / "stands.npz", "-m", session / "round.osim", "-o", tmp_path / "out"]
    assert main(["opensim", *(str(one) for one in words), "--measure", "BodyMass=70"]) == 0
    tool = ElementTree.parse(tmp_path / "out" / "scale.xml").getroot()[0]
    names, rows, _ = trc(tmp_path / "out" / "stands.trc")
    for range_ in tool.iter("time_range"):
        begin, end = (float(word) for word in (range_.text or "").split())
        # the frames between the gaps of pelvis and toe, where T10 is seen as well: without LASI there are no hips
        assert (begin, end) == pytest.approx((rows[2, 1], rows[4, 1]), abs=1e-5)
    used = {name for pair in tool.iter("markers") for name in (pair.text or "").split()} & set(names)
    chosen = rows[2:5, 2:].reshape(3, -1, 3)[:, [names.index(name) for name in used]]
    assert np.isfinite(chosen).all() and len(used) > 8


def test_the_model_is_found_from_a_linked_folder(session: Path, tmp_path: Path) -> None:
    (tmp_path / "deep" / "below").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "deep" / "below")
    assert run(session, tmp_path / "link") == 0
    named = ElementTree.parse(tmp_path / "link" / "scale.xml").getroot().findtext(".//model_file") or ""
    # as a program opens it there
    assert (tmp_path / "link" / named).samefile(session / "round.osim")


def test_without_a_standing_trial_the_walk_scales(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [session / "walk.c3d", "-m", session / "round.osim", "-o", tmp_path / "out", "--measure", "BodyMass=70"]
    assert main(["opensim", *(str(one) for one in words)]) == 0
    assert "[opensim-no-static]" in capsys.readouterr().err
    tool = ElementTree.parse(tmp_path / "out" / "scale.xml").getroot()[0]
    assert tool.findtext("ModelScaler/marker_file") == "walk.trc" and tool.find("MarkerPlacer") is None
    motion = ElementTree.parse(tmp_path / "out" / "walk_ik.xml").getroot()[0]
    assert motion.findtext("model_file") == tool.findtext("ModelScaler/output_model_file")


def test_without_a_model_there_are_markers_and_forces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = two_steps(tmp_path)
    # three markers tell no legs, which is no fault where no model asks for them
    assert main(["opensim", str(source), "-o", str(tmp_path / "out"), "--vertical", "z"]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"walk.trc", "walk_grf.mot", "walk_grf.xml"}
    assert "[opensim-no-model]" in capsys.readouterr().err
    written_model(tmp_path / "a.osim")
    assert main(["opensim", str(source), "-m", str(tmp_path / "a.osim"), "-o", str(tmp_path / "two"), "--vertical", "z"]) == 1
    assert "[opensim-no-legs]" in capsys.readouterr().err and (tmp_path / "two" / "walk_grf.mot").exists()


def test_nothing_is_replaced_unless_asked(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(session, out) == 0
    before = (out / "walk.trc").read_bytes()
    (out / "walk.trc").write_bytes(b"mine")
    (out / "scale.xml").unlink()
    assert run(session, out) == 2 and "exists" in capsys.readouterr().err
    assert (out / "walk.trc").read_bytes() == b"mine" and not (out / "scale.xml").exists()
    assert run(session, out, "--overwrite") == 0 and (out / "walk.trc").read_bytes() == before
    assert run(session, tmp_path / "two", "--cut-off", "0") == 2 and "0 Hz filters nothing" in capsys.readouterr().err
    assert run(session, session / "walk.c3d") == 2 and "is a file" in capsys.readouterr().err


def renamed(recording: Recording, change: Any) -> Recording:
    return replace(recording, labels=tuple(change(label) for label in recording.labels), source=None, origin=None, taken=())


def test_names_that_opensim_does_not_take(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    long = {"LKNE": "L Knee", "RKNE": "R Knee", "LHEE": "Ann:LHEE", "T10": "my*10"}
    for name in ("walk", "stands"):
        formats.write(tmp_path / f"{name}.npz", renamed(formats.read(session / f"{name}.c3d"), lambda label: long.get(label, label)))
    words = [tmp_path / "walk.npz", "--static", tmp_path / "stands.npz", "-m", session / "round.osim", "-o", tmp_path / "out"]
    assert main(["opensim", *(str(one) for one in words), "--measure", "BodyMass=70"]) == 0
    error = capsys.readouterr().err
    assert "L Knee is L_Knee" in error and "my*10 is my_10" in error
    names, _, _ = trc(tmp_path / "out" / "walk.trc")
    assert {"L_Knee", "R_Knee", "LHEE", "my_10"} <= set(names)
    placed = {marker.get("name"): marker for marker in ElementTree.parse(tmp_path / "out" / "markers.xml").getroot().iter("Marker")}
    assert placed["L_Knee"].findtext("socket_parent_frame") == "/bodyset/femur_l"


def test_a_marker_that_no_set_knows_sits_where_it_moves_least(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("walk", "stands"):
        recording = formats.read(session / f"{name}.c3d")
        # between two markers of the shank, and one that flies about
        shank, flies = (
            recording.select(["LTIB", "LKNE"]).positions.mean(axis=1),
            np.random.default_rng(1).normal(1, 0.3, (len(recording), 3)),
        )
        more = np.stack([shank, flies], axis=1)
        positions = np.concatenate([recording.positions, more], axis=1)
        both = replace(recording, positions=positions, labels=(*recording.labels, "bump", "fly"), source=None, origin=None, taken=())
        formats.write(tmp_path / f"{name}.npz", both)
    words = [tmp_path / "walk.npz", "--static", tmp_path / "stands.npz", "-m", session / "round.osim", "-o", tmp_path / "out"]
    assert main(["opensim", *(str(one) for one in words), "--measure", "BodyMass=70", "--vertical", "z"]) == 0
    error = capsys.readouterr().err
    assert "bump on tibia_l" in error and "fly is in the TRC file and not on the model" in error
    placed = {marker.get("name") for marker in ElementTree.parse(tmp_path / "out" / "markers.xml").getroot().iter("Marker")}
    assert "bump" in placed and "fly" not in placed


def test_two_files_of_one_name_are_refused(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "walk.c3d").write_bytes((session / "walk.c3d").read_bytes())
    assert run(session, tmp_path / "out", tmp_path / "walk.c3d") == 2
    assert "would both become walk.trc" in capsys.readouterr().err


def test_bodies_by_names() -> None:
    found = bodies_of(["Ann:LASI", "R.Thigh", "LSHO", "LFHD", "RELB", "LMED", "what"])
    assert found == {
        "Ann:LASI": "pelvis", "R.Thigh": "femur_r", "LSHO": "torso", "LFHD": "head", "RELB": "humerus_r", "LMED": "tibia_l",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("beside", "said"), [(0.0, "the plates bear 61.2 kg"), (0.12, "61.2 kg, not under both feet")], ids=["both", "one"]
)
def test_the_mass_is_what_the_plates_bear(
    beside: float, said: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = formats.read(session / "stands.c3d")
    ankles = still.select(["LANK", "RANK"]).positions[0]
    where = np.array([0.6, 0.3]) - ankles.mean(axis=0)[:2]
    positions = np.add(still.positions, [*where, 0.0])
    samples = len(still) * 10
    across = (ankles[0] - ankles[1]) / np.linalg.norm(ankles[0] - ankles[1])
    places = np.tile(np.array([0.6, 0.3, 0.0]) + beside * across * [1, 1, 0], (samples, 1))
    written(tmp_path / "stands.c3d", np.tile([0.0, 0.0, 600.0], (samples, 1)), places, positions, still.labels)
    words = [session / "walk.c3d", "--static", tmp_path / "stands.c3d", "-m", session / "round.osim", "-o", tmp_path / "out"]
    assert main(["opensim", *(str(one) for one in words)]) == (0 if beside == 0 else 1)
    assert said in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*grf*")), "no inverse dynamics of who stands"
    mass = float(ElementTree.parse(tmp_path / "out" / "scale.xml").findtext(".//mass") or 0)
    assert mass == pytest.approx(600 / 9.81 if beside == 0 else -1, abs=0.01)


def test_a_pelvis_alone_moves_no_model(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = formats.read(session / "walk.c3d").select(["LASI", "RASI", "LPSI", "RPSI", "LTHI", "LANK", "LHEE", "LTOE"])
    formats.write(tmp_path / "walk.npz", replace(walk, source=None, origin=None, taken=()))
    words = [tmp_path / "walk.npz", "-m", session / "round.osim", "-o", tmp_path / "out", "--vertical", "z"]
    assert main(["opensim", *(str(one) for one in words)]) == 1
    assert "[opensim-no-legs]" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"walk.trc"}


def test_one_leg_scales_both(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("walk", "stands"):
        recording = formats.read(session / f"{name}.c3d")
        kept = [label for label in recording.labels if label[0] != "L" or label[1:] in ("ASI", "PSI", "SHO")]
        formats.write(tmp_path / f"{name}.npz", replace(recording.select(kept), source=None, origin=None, taken=()))
    words = [tmp_path / "walk.npz", "--static", tmp_path / "stands.npz", "-m", session / "round.osim", "-o", tmp_path / "out"]
    words += ["--json", tmp_path / "a.json", "--measure", "BodyMass=70"]
    assert main(["opensim", *(str(one) for one in words)]) == 1
    told = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    scales = told["scales"]
    assert scales["femur_l"]["factor"] == scales["femur_r"]["factor"] and scales["femur_l"]["by"] == "as femur_r"
    # both hips are known by the pelvis, on which its markers sit as far to either side
    assert scales["pelvis"]["by"] == "RHJC to LHJC"
    left, right = (told["markers"][f"{side}ASI"]["location_m"] for side in "LR")
    assert left[2] == pytest.approx(-right[2], abs=0.03) and left[2] < 0
    [held] = [one for one in told["findings"] if one["code"] == "opensim-held"]
    assert held["severity"] == "warning" and "hip_flexion_l" in held["sentence"] and "hip_flexion_r" not in held["sentence"]


def test_of_two_people_the_first_is_written(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = formats.read(session / "walk.c3d")
    positions = np.concatenate([walk.positions, np.add(walk.positions, [0, 1.5, 0])], axis=1)
    labels = tuple(f"{name}:{label}" for name in ("Ann", "Bob") for label in walk.labels)
    formats.write(tmp_path / "two.npz", replace(walk, positions=positions, labels=labels, source=None, origin=None, taken=()))
    words = [tmp_path / "two.npz", "-m", session / "round.osim", "-o", tmp_path / "out", "--measure", "BodyMass=70"]
    assert main(["opensim", *(str(one) for one in words)]) == 1
    assert "[recording-several-people]" in capsys.readouterr().err
    names, rows, _ = trc(tmp_path / "out" / "two.trc")
    assert sorted(names[: len(walk.labels)]) == sorted(walk.labels) and len(names) == len(walk.labels) + 12
    assert np.isfinite(rows).any()


def test_arms_sit_on_a_model_with_arms(session: Path, tmp_path: Path) -> None:
    text = written_model(tmp_path / "arms.osim", arms=True)
    words = [session / "walk.c3d", "--static", session / "stands.c3d", "-m", text, "-o", tmp_path / "out", "--json", tmp_path / "a.json"]
    assert main(["opensim", *(str(one) for one in words), "--measure", "BodyMass=70"]) == 0
    result = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    on = {name: marker["body"] for name, marker in result["markers"].items()}
    assert {"LELB": "humerus_l", "RWRA": "radius_r", "LFIN": "hand_l", "RSJC": "humerus_r", "LEJC": "ulna_l"}.items() <= on.items()
    factors = {body: scale["factor"] for body, scale in result["scales"].items()}
    assert factors["ulna_r"] == factors["radius_r"] == factors["hand_r"] != factors["humerus_r"]
    # thumbs ahead and palms to the thighs: the thumb's side of the wrist is ahead, on both sides
    for side in "lr":
        thumb, little = (np.array(result["markers"][f"{side.upper()}WR{one}"]["location_m"]) for one in "AB")
        assert thumb[0] - little[0] > 0.03 and abs(thumb[2] - little[2]) < 0.02
        out = np.array(result["markers"][f"{side.upper()}ELB"]["location_m"])
        assert (out[2] > 0) == (side == "r") and out[1] == pytest.approx(-0.28, abs=0.04)


def opensim_python() -> str:
    """The interpreter that has OpenSim: this one, or that which ASTERISM_OPENSIM names."""
    given = os.environ.get("ASTERISM_OPENSIM") or (sys.executable if importlib.util.find_spec("opensim") else "")
    if not given:
        pytest.skip("no OpenSim here: install the package opensim, or let ASTERISM_OPENSIM name an interpreter that has it")
    return given


def stepping(session: Path, path: Path) -> Path:
    """The walk with a force plate that bears the left foot, whose ankle stands still longest."""
    walk = formats.read(session / "walk.c3d")
    samples = len(walk) * 10
    ankle = walk.select(["LANK"]).positions[:, 0]
    speed = np.convolve(np.linalg.norm(np.diff(ankle, axis=0), axis=1), np.ones(30), "same")
    middle = int(np.argmin(speed[20:-20])) + 20
    share = np.clip((np.arange(samples) / 10 - middle + 30) / 60, 0, 1)
    where = np.array([0.6, 0.3]) - ankle[middle, :2]
    forces = np.outer(500.0 * np.sin(np.pi * share), [0.0, 0.0, 1.0])
    return written(path, forces, np.tile([0.62, 0.3, 0.0], (samples, 1)), np.add(walk.positions, [*where, 0.0]), walk.labels)


def test_forces_come_with_inverse_dynamics(session: Path, tmp_path: Path) -> None:
    stepping(session, tmp_path / "walk.c3d")
    words = [tmp_path / "walk.c3d", "--static", session / "stands.c3d", "-m", session / "round.osim", "-o", tmp_path / "out"]
    words += ["--measure", "BodyMass=70", "--json", tmp_path / "a.json"]
    assert main(["opensim", *(str(one) for one in words)]) == 0
    tool = ElementTree.parse(tmp_path / "out" / "walk_id.xml").getroot()[0]
    assert tool.findtext("coordinates_file") == "walk_ik.mot" and tool.findtext("forces_to_exclude") == "Muscles"
    loads = ElementTree.parse(tmp_path / "out" / (tool.findtext("external_loads_file") or "")).getroot()
    assert {one.findtext("applied_to_body") for one in loads.iter("ExternalForce")} == {"calcn_l"}
    filtered = formats.read_table(tmp_path / "out" / (loads.findtext(".//datafile") or ""))
    table = formats.read_table(tmp_path / "out" / "walk_grf.mot")
    up, smooth = (one.values[:, one.names.index("1_ground_force_vy")] for one in (table, filtered))
    # the same impulse, spread beyond the contact's ends
    assert smooth.sum() == pytest.approx(up.sum(), rel=0.02) and (smooth > 0).sum() > (up > 0).sum() + 10
    both = np.minimum(up, smooth) > 100
    middle = [table.names.index(f"1_ground_force_p{axis}") for axis in "xyz"]
    np.testing.assert_allclose(filtered.values[both][:, middle], table.values[both][:, middle], atol=1e-6)
    stands = table.times[table.values[:, table.names.index("1_ground_force_vy")] > 250]
    # under the ankle on the markers' clock, in the axes of the TRC
    names, rows, _ = trc(tmp_path / "out" / "walk.trc")
    frame = int(np.argmin(np.abs(rows[:, 1] - stands.mean())))
    ankle = rows[frame, 2 + 3 * names.index("LANK") :][:3] / 1000
    sample = int(np.argmin(np.abs(table.times - stands.mean())))
    place = table.values[sample, [table.names.index(f"1_ground_force_p{axis}") for axis in "xyz"]]
    assert np.linalg.norm((ankle - place)[[0, 2]]) < 0.06 and place[1] == pytest.approx(0.0, abs=1e-6)
    told = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert any(begin < stands.mean() < end for begin, end in told["known_s"]["walk"]["left"])


TOOLS = """
import sys, opensim
opensim.Logger.setLevelString("Error")
for name, tool in (("scale", opensim.ScaleTool), ("walk_ik", opensim.InverseKinematicsTool), ("walk_id", opensim.InverseDynamicsTool)):
    assert tool(name + ".xml").run(), name
model = opensim.Model(sys.argv[1])
print(model.getTotalMass(model.initSystem()))
"""


@pytest.mark.parametrize("static", [True, False], ids=["standing", "walk-alone"])
def test_opensim_runs_from_it(static: bool, session: Path, tmp_path: Path) -> None:
    python = opensim_python()
    walk = formats.read(stepping(session, tmp_path / "walk.c3d"))
    words = [tmp_path / "walk.c3d", "-m", session / "round.osim", "-o", tmp_path / "out", "--measure", "BodyMass=70"]
    words += ["--static", session / "stands.c3d"] if static else []
    assert main(["opensim", *(str(one) for one in words)]) == 0
    [scaled] = {one.findtext("model_file") for one in ElementTree.parse(tmp_path / "out" / "walk_ik.xml").getroot()}
    done = subprocess.run([python, "-c", TOOLS, str(scaled)], cwd=tmp_path / "out", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    assert float(done.stdout.strip().split("\n")[-1]) == pytest.approx(70.0)
    # what the tool measured is what the table says, though a marker has a gap
    table = [line.split(",") for line in (tmp_path / "out" / "scale_factors.csv").read_text(encoding="utf-8").split("\n")[1:] if line]
    factors, after = {cells[1]: float(cells[2]) for cells in table}, read_osim(tmp_path / "out" / str(scaled))
    for _, parent, body, _, place, _, _ in joints():
        if parent != "ground":
            bone = after.joints[body].centre - after.joints[parent].centre
            assert np.linalg.norm(bone) / np.linalg.norm(place) == pytest.approx(factors[parent], rel=0.02), body
    [errors] = (tmp_path / "out").glob("*marker_errors.sto")
    table = formats.read_table(errors)
    rms = table.values[:, table.names.index("marker_error_RMS")]
    assert len(rms) == len(walk) and rms.mean() < 0.02
    moments = formats.read_table(tmp_path / "out" / "walk_id.sto")
    assert np.isfinite(moments.values).all() and "knee_angle_l_moment" in moments.names
