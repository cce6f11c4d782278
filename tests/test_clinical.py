"""Clinical angles: of a leg bent by known angles, against the file's own Plug-in-Gait angles, on the command line and the page."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import asterism
from asterism import AsterismError, Recording, formats
from asterism.cli import main
from asterism.motion.clinical import (
    CLINICAL,
    LegMeasures,
    StaticRules,
    SubjectMeasures,
    clinical_angles,
    complete_legs,
    leg_measures,
    subject_measures,
    with_static_offsets,
)
from asterism.motion.clinical.measures import computed_by_the_file
from asterism.motion.clinical.plug_in_gait import along, axes_along, joint_centre, lower_body, normals, turns
from asterism.simulation import simulate_walks

GIVEN = SubjectMeasures(
    LegMeasures(0.10, 0.07, leg_length=0.85, asis_trochanter=0.07),
    LegMeasures(0.10, 0.07, leg_length=0.85, asis_trochanter=0.07),
    inter_asis=0.24,
)
TO_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]).T
"""From x forward, y up, z to the right into a world with z up."""


def joint_centre_twin(
    upper: np.ndarray, marker: np.ndarray, wand: np.ndarray, offset: float, turn: float = 0.0, tilt: float = 0.0
) -> np.ndarray:
    """`joint_centre` for one frame, by its conditions: a search over the ways round for the turn, at the chord's distance."""

    def turned(angle: float) -> np.ndarray:
        axis = (marker - upper) / np.linalg.norm(marker - upper)
        first = wand - upper - (wand - upper) @ axis * axis
        first /= np.linalg.norm(first)
        long, out = np.linalg.norm(marker - upper), np.cos(angle) * first + np.sin(angle) * np.cross(axis, first)
        # the triangle of upper centre, centre and marker, by the law of cosines with the angle at the centre
        thigh = offset * np.cos(np.pi / 2 + tilt) + np.sqrt(long**2 - (offset * np.sin(np.pi / 2 + tilt)) ** 2)
        near = (long**2 + offset**2 - thigh**2) / (2 * long * offset)
        return np.asarray(marker - offset * (near * axis + np.sqrt(1 - near**2) * out))

    def apart(angle: float) -> float:
        centre = turned(angle)
        line = (centre - upper) / np.linalg.norm(centre - upper)
        one, other = (part - part @ line * line for part in (wand - centre, marker - centre))
        found = np.arctan2(np.cross(one, other) @ line, one @ other)
        return float((turn - found + np.pi) % (2 * np.pi) - np.pi)

    return turned(brentq(apart, turn - 0.4, turn + 0.4, xtol=1e-13) if turn else 0.0)


@pytest.mark.parametrize(("turn", "tilt"), [(0.0, 0.0), (0.0, 0.15), (0.3, 0.0), (-0.9, 0.1)])
def test_a_joint_centre_is_where_its_conditions_meet(turn: float, tilt: float) -> None:
    rng = np.random.default_rng(3)
    upper, marker, wand = (rng.normal(place, 0.03, (5, 3)) for place in ([0, 0, 0.4], [0, 0.06, 0], [0.1, 0.1, 0.2]))
    found = joint_centre(upper, marker, wand, 0.06, turn, tilt)
    expected = [joint_centre_twin(*parts, 0.06, turn, tilt) for parts in zip(upper, marker, wand, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-10)
    holed = marker.copy()
    holed[2, 1] = np.nan
    assert np.isnan(joint_centre(upper, holed, wand, 0.06, turn, tilt)).any(axis=1).tolist() == [False, False, True, False, False]


def test_axes_of_limbs_and_their_turns_are_those_of_their_definition() -> None:
    rng = np.random.default_rng(5)
    line, left = rng.normal(size=(2, 6, 3))
    line[1], left[2, 0], left[3] = 0.0, np.nan, 2.0 * line[3]
    axes = along(line, left)
    for frame in (0, 4, 5):
        up = line[frame] / np.linalg.norm(line[frame])
        across = left[frame] - left[frame] @ up * up
        across /= np.linalg.norm(across)
        np.testing.assert_allclose(axes[frame], np.stack([np.cross(across, up), across, up], axis=1), atol=1e-12)
    # what has no length, or is parallel, tells no axes
    assert np.isfinite(axes).all(axis=(1, 2)).tolist() == [True, False, False, False, True, True]
    for first, second in permutations("xyz", 2):
        axes = axes_along(first, line, second, left)
        one, other, both = line[4] / np.linalg.norm(line[4]), axes[4, :, "xyz".index(second)], np.cross(line[4], left[4])
        np.testing.assert_allclose(axes[4, :, "xyz".index(first)], one, atol=1e-12)
        np.testing.assert_allclose(other, both / np.linalg.norm(both), atol=1e-12)
        assert np.linalg.det(axes[4]) == pytest.approx(1.0)
        np.testing.assert_allclose(normals(line, left), axes[:, :, "xyz".index(second)], atol=1e-12)
    # near to each other: of the two triples of a rotation that nearer to the frame before is given
    angles = rng.uniform(-1.0, 1.0, 3) + rng.uniform(-0.1, 0.1, (7, 3))
    parent = Rotation.random(7, random_state=1).as_matrix()
    for first, order in (("y", "YXZ"), ("x", "XYZ")):
        child = parent @ Rotation.from_euler(order, angles).as_matrix()
        child[3, 0, 0] = np.nan
        found = turns(parent, child, first)
        np.testing.assert_allclose(np.delete(found, 3, axis=0), np.delete(angles, 3, axis=0), atol=1e-12)
        assert np.isnan(found[3]).any()
        mirrored = turns(parent, child, first, (-1.0, 1.0, 0.0), np.pi)
        expected = angles * [-1.0, 1.0, 0.0] + [np.pi, 0.0, 0.0]
        np.testing.assert_allclose(np.delete(mirrored, 3, axis=0), np.delete(within_half_a_turn(expected), 3, axis=0), atol=1e-12)
    # what does not move is one row
    np.testing.assert_array_equal(turns(parent[0], child), turns(np.repeat(parent[:1], 7, axis=0), child))


def within_half_a_turn(angles: np.ndarray) -> np.ndarray:
    """From -pi to pi."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def davis_hip(right: float) -> np.ndarray:
    """Behind, below and beside the middle between the spines, x forward, y up, z to the right: the regression of Davis et al., by hand."""
    back, long = 0.07 + 0.007, 0.115 * 0.85 - 0.0153
    ahead = -back * np.cos(0.314) + long * np.cos(0.5) * np.sin(0.314)
    up = -back * np.sin(0.314) - long * np.cos(0.5) * np.cos(0.314)
    return np.array([ahead, up, right * (0.12 - long * np.sin(0.5))])


def standing(
    hip: tuple[float, float, float], knee: tuple[float, float, float], wands: tuple[float, float] = (0.0, 0.0), torsion: float = 0.0
) -> Recording:
    """Three frames of a person whose thighs and shanks are turned by flexion, adduction, internal rotation (degrees), both sides alike.

    wands    degrees by which the wands of thigh and shank stand behind the joints' axes, about the lines between the joint centres
    torsion  degrees by which the ankle's axis is turned outwards from the knee's
    """
    places: dict[str, np.ndarray] = {}
    for side, right in (("L", -1.0), ("R", 1.0)):
        places[f"{side}ASI"] = np.array([0.0, 0.0, right * 0.12])
    places["SACR"] = np.array([-0.15, 0.0, 0.0])
    for side, right in (("L", -1.0), ("R", 1.0)):
        centre = davis_hip(right)
        bend = [Rotation.from_euler("ZXY", np.array([f, right * a, right * i]), degrees=True) for f, a, i in (hip, (-knee[0], *knee[1:]))]
        thigh = bend[0].as_matrix()
        shank = thigh @ bend[1].as_matrix()
        ankle_axes = shank @ Rotation.from_euler("Y", -right * torsion, degrees=True).as_matrix()
        knee_at = centre + thigh @ [0.0, -0.40, 0.0]
        ankle_at = knee_at + shank @ [0.0, -0.38, 0.0]
        outward = np.array([0.0, 0.0, right])
        behind = [Rotation.from_euler("Y", -right * angle, degrees=True).apply(outward) for angle in wands]
        places |= {
            f"{side}KNE": knee_at + thigh @ outward * 0.057,
            f"{side}THI": centre + thigh @ (np.array([0.0, -0.25, 0.0]) + 0.15 * behind[0]),
            f"{side}ANK": ankle_at + ankle_axes @ outward * 0.042,
            f"{side}MMA": ankle_at - ankle_axes @ outward * 0.042,
            f"{side}TIB": knee_at + ankle_axes @ (np.array([0.0, -0.2, 0.0]) + 0.12 * behind[1]),
            f"{side}TOE": ankle_at + shank @ [0.15, -0.05, 0.0],
            f"{side}HEE": ankle_at + shank @ [-0.06, -0.05, 0.0],
        }
    upright = np.array([TO_WORLD @ place for place in places.values()]) + np.array([0.0, 0.0, 0.9])
    return Recording(np.tile(upright, (3, 1, 1)), tuple(places), 100.0)


def with_turns(wands: tuple[float, float], torsion: float) -> SubjectMeasures:
    """The measures that take these off."""
    names = {"ThighRotation": wands[0], "ShankRotation": wands[1], "TibialTorsion": -torsion}
    return GIVEN.with_values({side + name: value for side in "LR" for name, value in names.items()})


@pytest.mark.parametrize(("hip", "knee"), [((0, 0, 0), (0, 0, 0)), ((30, 5, -8), (60, -3, 6)), ((-12, -7, 10), (4, 2, -5))])
@pytest.mark.parametrize(("wands", "torsion"), [((0, 0), 0), ((20, -15), 12), ((-80, 85), 25)])
def test_a_leg_bent_by_known_angles_has_them_on_both_sides(hip, knee, wands, torsion) -> None:
    """Whatever the wands' angles, up to a right one, and the tibia's torsion."""
    clinical = clinical_angles(standing(hip, knee, wands, torsion), measures=with_turns(wands, torsion))
    found = {joint.name: np.degrees(joint.angles[0]) for joint in clinical.joints}
    for side in ("left", "right"):
        np.testing.assert_allclose(found[f"{side} hip"], hip, atol=1e-6)
        np.testing.assert_allclose(found[f"{side} knee"], knee, atol=1e-6)


@pytest.mark.parametrize(("wands", "torsion"), [((0, 0), 0), ((20, -15), 12), ((-40, 60), 25)])
def test_a_standing_trial_tells_the_offsets(wands, torsion) -> None:
    """The thigh's angle is given, for no marker tells it; malleoli tell the shank's and the torsion, heel and toe the foot."""
    upright = standing((0, 0, 0), (0, 0, 0), wands, torsion)
    told = with_static_offsets(upright, GIVEN.with_values({"LThighRotation": wands[0], "RThighRotation": wands[0]}))
    for leg in (told.left, told.right):
        np.testing.assert_allclose(np.degrees([leg.shank_rotation, leg.tibial_torsion]), [wands[1], -torsion], atol=1e-6)
        assert {"shank_rotation", "tibial_torsion", "foot_flexion"} <= set(leg.from_file)
    found = {joint.name: np.degrees(joint.angles[0]) for joint in clinical_angles(upright, measures=told).joints}
    for joint in ("knee", "ankle"):
        np.testing.assert_allclose([found[f"left {joint}"][0], found[f"right {joint}"][0]], 0.0, atol=1e-6)


def test_a_knee_alignment_device_tells_the_knees_axis() -> None:
    """Three markers as far from the knee's, at right angles; the knee's own is not worn."""
    turned = standing((0, 0, 0), (0, 0, 0), (30, 0))
    positions, labels = list(np.moveaxis(turned.positions, 1, 0)), list(turned.labels)
    for side, right in (("L", -1.0), ("R", 1.0)):
        knee = positions[labels.index(f"{side}KNE")]
        for name, arm in (("KAX", [0.0, 0.0, right]), ("KD1", [0.8, 0.6, 0.0]), ("KD2", [-0.6, 0.8, 0.0])):
            positions.append(knee + 0.1 * TO_WORLD @ arm)
            labels.append(side + name)
    kept = [place for place, name in enumerate(labels) if not name.endswith("KNE")]
    static = Recording(np.stack([positions[place] for place in kept], axis=1), [labels[place] for place in kept], 100.0)
    told = with_static_offsets(static, GIVEN)
    np.testing.assert_allclose(np.degrees([told.left.thigh_rotation, told.right.thigh_rotation]), 30.0, atol=1e-6)


def test_measures_by_name_are_checked_and_refused_by_name() -> None:
    given = SubjectMeasures().with_values(
        {"RKneeWidth": 98, "lanklewidth": 61, "MarkerDiameter": 9.5, "RShankRotation": -80.8, "BodyMass": 50}
    )
    assert (given.right.knee_width, given.left.ankle_width, given.marker_radius, given.mass) == (0.098, 0.061, 0.00475, 50.0)
    assert np.degrees(given.right.shank_rotation) == pytest.approx(-80.8)
    for name, value, said in (
        ("LKneeWidth", 0.1, "give it in mm"),
        ("RTibialTorsion", 120, "in degrees"),
        ("Kneewidth", 100, "no measure"),
    ):
        with pytest.raises(AsterismError, match=said):
            SubjectMeasures().with_values({name: value})


def test_a_wand_in_front_of_the_limb_is_believed() -> None:
    """A file's 1.41 rad is a wand that stands almost in front; 97 would be degrees, and is not guessed."""
    for value, read in ((-1.41, -1.41), (-0.99, -0.99), (97.0, 0.0)):
        parameters = SimpleNamespace(number=lambda group, name, value=value: {"RSHANKROTATION": value}.get(name))
        recording = replace(standing((0, 0, 0), (0, 0, 0)), source=SimpleNamespace(parameters=parameters, labels=()))
        assert leg_measures(recording, "R").shank_rotation == read


def test_a_gap_is_a_gap_of_the_angles_that_need_the_marker() -> None:
    given = standing((10, 0, 0), (20, 0, 0))
    positions = given.positions.copy()
    positions[1, given.labels.index("LTIB")] = np.nan
    found = {joint.name: joint.angles for joint in clinical_angles(replace(given, positions=positions), measures=GIVEN).joints}
    assert np.isfinite(found["left hip"]).all() and np.isfinite(found["right knee"]).all()
    assert np.isnan(found["left knee"][1]).all() and np.isfinite(found["left knee"][[0, 2]]).all()


def test_legs_without_their_markers_are_named_and_left_out() -> None:
    given = standing((0, 0, 0), (0, 0, 0))
    left = given.select([name for name in given.labels if name not in ("RTIB", "LTOE")])
    partly = clinical_angles(left)
    assert complete_legs(left) == ("L",) and [joint.name for joint in partly.joints] == ["left hip", "left knee", "right hip"]
    said = [finding.sentence for finding in partly.findings if finding.code == "clinical-left-out"]
    assert len(said) == 1 and "right knee, ankle: RTIB" in said[0]
    assert leg_measures(left, "L") == LegMeasures()
    hidden = given.positions.copy()
    hidden[:, given.labels.index("SACR")] = np.nan
    pelvis = clinical_angles(given.select(["LASI", "RASI", "SACR"]))
    assert not pelvis.joints and set(pelvis.outputs) == {"LPelvisAngles", "RPelvisAngles"} and len(pelvis.findings) == 3
    cases = [(left, "R", "RTIB"), (left, "X", "no side"), (given.select(["LASI", "LTHI"]), None, "RASI, SACR, LKNE, LTIB, LANK")]
    for recording, side, sentence in [*cases, (replace(given, positions=hidden), None, "never shows")]:
        with pytest.raises(AsterismError, match=sentence):
            clinical_angles(recording, side)


LEGS = ("Hip", "Knee", "Ankle", "Pelvis", "FootProgress")
UPPER = ("Thorax", "Spine", "Head", "Neck", "Shoulder", "Elbow", "Wrist")
OUTPUTS = [f"{side}{name}Angles" for side in "LR" for name in (*LEGS, *UPPER)]


@pytest.mark.parametrize(
    ("file", "diameter"),
    [
        ("gait/HC002/straight.c3d", 14.0),
        ("gait/HC031/turn.c3d", 14.0),
        ("gait/HC055/straight.c3d", 10.0),
        ("gait-events/plates/NP1004/walk_1004a05.c3d", 9.5),
        ("movement/clinical-lower/fmc_dynamic15.c3d", 14.0),
    ],
)
def test_angles_are_those_of_the_files_own_plug_in_gait(data: Path, file: str, diameter: float) -> None:
    """Also the marker's diameter with which they were computed, which the first two files give as 10 mm.

    Most come out within 0.001 degrees. The last file was computed from finer positions than it holds.
    """
    recording = asterism.read(data / file)
    clinical = clinical_angles(recording)
    assert 2000 * clinical.subject.marker_radius == pytest.approx(diameter)
    compared = 0
    for name in OUTPUTS:
        theirs = computed_by_the_file(recording, name)
        if theirs is None or name not in clinical.outputs:
            continue
        apart = (np.degrees(clinical.outputs[name]) - theirs + 180.0) % 360.0 - 180.0
        compared += 1
        assert np.sqrt(np.nanmean(apart**2, axis=0)).max() < 0.1, name
    assert compared == (10 if "fmc" in file else 2 * len(LEGS + UPPER))


def test_offsets_of_a_real_standing_trial_are_those_of_its_file(data: Path) -> None:
    for file, diameter, tilted in (("gait/HC030/static.c3d", 10.0, False), ("movement/clinical-lower/sydney_static.c3d", 14.0, True)):
        static = asterism.read(data / file)
        given = replace(subject_measures(static), marker_radius=diameter / 2000)
        told = with_static_offsets(static, given, StaticRules(tilted=tilted))
        for before, after in ((given.left, told.left), (given.right, told.right)):
            for name in ("thigh_rotation", "shank_rotation", "tibial_torsion", "ankle_tilt", "foot_flexion", "foot_rotation"):
                assert getattr(after, name) == pytest.approx(getattr(before, name), abs=0.001), f"{file} {name}"


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clinical") / "walk.c3d"
    [recording] = simulate_walks(subjects=1, frames=60, markers="helen-hayes", seed=3)
    formats.write(path, recording)
    return path


def test_motion_gives_clinical_angles_where_the_markers_are(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, table, found = tmp_path / "page.html", tmp_path / "angles.csv", tmp_path / "found.json"
    words = ["motion", str(walk), "--vertical", "z", "--limbs", "3"]
    assert main([*words, "--report", str(page), "-o", str(table), "--json", str(found)]) == 0
    told = "".join(capsys.readouterr())
    assert "clinical angles" in told and "right ankle" in told and "no knee width, ankle width, leg length of the left leg" in told
    clinical = json.loads(found.read_text())["files"][0]["clinical"]
    knee = next(joint for joint in clinical["joints"] if (joint["side"], joint["joint"]) == ("right", "knee"))
    assert set(knee) == {"joint", "side", *(f"{name}_deg" for name in CLINICAL)} and clinical["measures"]["left"]["from_file"] == []
    with table.open() as lines:
        rows = [row for row in csv.DictReader(lines) if row["joint"] == "right knee"]
    assert len(rows) == 60 and rows[7]["angle_deg"] == ""
    for name in CLINICAL:
        np.testing.assert_allclose([float(row[f"{name}_deg"]) for row in rows], knee[f"{name}_deg"], atol=1e-3)
    written = page.read_text()
    assert "knee flexion (°)" in written and "by each method" in written
    assert main([*words, "--no-anatomy", "--json", "-"]) == 0
    assert "clinical" not in json.loads(capsys.readouterr().out)["files"][0]


def test_clinical_angles_that_cannot_be_are_refused_by_name(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = tmp_path / "few.c3d"
    recording = asterism.read(walk)
    formats.write(few, recording.select([name for name in recording.labels if name != "SACR"]))
    words = ["--vertical", "z", "--limbs", "2"]
    assert main(["motion", str(few), *words, "--anatomy"]) == 2
    told = capsys.readouterr().err
    assert "few.c3d" in told and "no marker SACR" in told and "Helen Hayes" in told
    assert main(["motion", str(few), str(walk), *words, "--anatomy"]) == 1
    assert main(["motion", str(few), *words]) == 0, "not asked for, not missed"


def test_without_the_length_of_a_leg_the_hip_stays_where_the_pelvis_puts_it() -> None:
    """Bell's shares of the distance between the spines: how the leg is bent or its wands stand moves it not."""
    hips = [
        lower_body(standing(hip, (0, 0, 0), wands), SubjectMeasures(), "L").legs["L"].hip
        for hip, wands in (((0, 0, 0), (0, 0)), ((40, 5, 0), (30, 0)))
    ]
    np.testing.assert_allclose(hips[0], hips[1], atol=1e-9)
    np.testing.assert_allclose(hips[0][0], TO_WORLD @ (0.24 * np.array([-0.22, -0.30, -0.36])) + [0, 0, 0.9], atol=1e-9)
