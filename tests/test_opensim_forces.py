"""Ground reaction forces for OpenSim: under the foot that stands there, on the markers' clock and axes, and nothing left out unsaid."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

from asterism import formats
from asterism.cli import main
from asterism.formats.opensim_forces import write_opensim_forces
from asterism.recording import ForcePlate

RATE, EACH, FRAMES = 100.0, 10, 60
CORNERS = np.array([[0.8, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.6, 0.0], [0.8, 0.6, 0.0]])
AXES = np.diag([1.0, -1.0, -1.0])
"""The plate's x, y and z by these corners: z points down."""
SENSORS = np.array([0.0, 0.0, 0.045])
"""m, the sensors' origin in the plate's axes, from the middle of the surface."""


def step(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces in N and centres of pressure in m, (S, 3) each, of a step; its first third bears nothing."""
    share = np.clip((np.arange(samples) / samples - 1 / 3) * 1.5, 0.0, 1.0)
    push = np.sin(np.pi * share)
    forces = np.column_stack([80 * np.sin(2 * np.pi * share), -30 * push, 700 * push])
    return forces, np.column_stack([0.55 + 0.1 * share, 0.15 + 0.25 * share, np.zeros(samples)])


def written(path: Path, forces: np.ndarray, places: np.ndarray, points: np.ndarray, labels: tuple[str, ...], **given: Any) -> Path:
    """A C3D file with a plate of type 2 that bears the forces at the places."""
    force = forces @ AXES
    moment = np.cross((places - CORNERS.mean(axis=0)) @ AXES - SENSORS, force)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    file["data"]["points"] = np.concatenate([1000 * points.transpose(2, 1, 0), np.ones((1, len(labels), len(points)))])
    units = given.pop("units", ["N"] * 3 + ["Nmm"] * 3)
    group = {"USED": [1], "TYPE": [2], "ZERO": [1, 0], "CORNERS": (1000 * CORNERS).T.reshape(3, 4, 1)}
    group |= {"ORIGIN": (-1000 * SENSORS).reshape(3, 1), "CHANNEL": np.arange(1.0, 7.0).reshape(6, 1)}
    for name, value in {**group, **given}.items():
        file.add_parameter("FORCE_PLATFORM", name, value)
    file["parameters"]["ANALOG"]["RATE"]["value"] = [RATE * EACH]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    file["parameters"]["ANALOG"]["UNITS"]["value"] = units
    file["data"]["analogs"] = np.column_stack([force, 1000 * moment]).T[None]
    file.write(str(path))
    return path


def two_steps(folder: Path, *, sided: bool = True, **given: Any) -> Path:
    """Two contacts on one plate: the left foot, then the right one; the other foot stands behind it."""
    forces, places = (np.concatenate([part, part]) for part in step(FRAMES * EACH // 2))
    foot = np.add(places[::EACH], [0.0, 0.03, 0.08])
    other = np.subtract(foot, [0.4, 0.0, 0.0])
    first = np.arange(FRAMES)[:, None] < FRAMES // 2
    points = np.stack([np.where(first, foot, other), np.where(first, other, foot), np.add(foot, [0.0, 0.0, 0.9])], axis=1)
    return written(folder / "walk.c3d", forces, places, points, ("LHEE", "RHEE", "SACR") if sided else ("A", "B", "C"), **given)


def test_opensim_gets_forces_under_the_feet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = two_steps(tmp_path), tmp_path / "out.trc"
    assert main(["convert", str(source), str(target), "--for", "opensim", "--vertical", "z"]) == 0
    table, markers = formats.read_table(tmp_path / "out_grf.mot"), formats.read(target, vertical="y")
    parts = ("force_v", "force_p", "torque_")
    assert table.names == tuple(f"1_{side}_ground_{part}{axis}" for side in ("left", "right") for part in parts for axis in "xyz")
    assert table.times[0] == markers.times[0] and table.rate == RATE * EACH
    first = np.arange(len(table.times)) < FRAMES * EACH // 2
    loads = ElementTree.parse(tmp_path / "out_grf.xml").getroot().findall(".//ExternalForce")
    assert len(loads) == 2
    for side, own, body in (("left", first, "calcn_l"), ("right", ~first, "calcn_r")):
        force, place = (
            table.values[:, [table.names.index(f"1_{side}_ground_{part}{axis}") for axis in "xyz"]] for part in ("force_v", "force_p")
        )
        assert not force[~own].any() and force[own, 1].max() == pytest.approx(700, abs=0.5)
        # Room's x, y, z become x, -z, y: the heel is 8 cm above the centre of pressure, and 3 cm beside it.
        stands = np.nonzero(force[:, 1] > 300)[0]
        apart = markers.select([f"{side[0].upper()}HEE"]).positions[stands // EACH, 0] - place[stands]
        np.testing.assert_allclose(apart, np.tile([0.0, 0.08, -0.03], (len(apart), 1)), atol=0.012)
        [one] = [each for each in loads if each.findtext("applied_to_body") == body]
        assert one.findtext("force_identifier") == f"1_{side}_ground_force_v" and one.findtext("data_source_name") == "out_grf.mot"
    target.unlink()
    assert main(["convert", str(source), str(target), "--for", "opensim"]) == 2
    assert "out_grf.mot" in capsys.readouterr().err, "an older table is not replaced"


def test_each_contact_is_filtered_by_itself(tmp_path: Path) -> None:
    recording = formats.read(two_steps(tmp_path), vertical="z")
    plates, _ = formats.force_plates(recording)
    assert write_opensim_forces(tmp_path / "a.trc", recording, plates, np.eye(3), cut_off=6.0) == []
    table = formats.read_table(tmp_path / "a_grf.mot")
    left = table.values[:, table.names.index("1_left_ground_force_vz")]
    first = plates[0].load[: len(left) // 2]
    # the second foot's load is none of the first one's, though both are on one plate, 0.1 s apart
    assert left.sum() == pytest.approx(first.sum(), rel=0.03) and not left[len(left) * 3 // 4 :].any()
    assert 500 < left.max() < 700, "without the edges, a short step is lower"


def test_a_load_under_an_unknown_foot_is_in_the_table_and_on_no_body(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(two_steps(tmp_path, sided=False)), str(tmp_path / "out.trc"), "--for", "opensim", "--vertical", "z"]) == 0
    table = formats.read_table(tmp_path / "out_grf.mot")
    assert len(table.names) == 9 and table.values[:, 1].max() > 690
    assert "<ExternalForce" not in (tmp_path / "out_grf.xml").read_text(encoding="utf-8")
    assert "the load on force plate 1 from" in capsys.readouterr().err


def test_a_load_on_both_feet_acts_on_neither(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = two_steps(tmp_path)
    recording = formats.read(source, vertical="z")
    forces, places = (np.concatenate([part, part]) for part in step(FRAMES * EACH // 2))
    points = recording.positions.copy()
    # in the second contact both feet stand side by side
    points[FRAMES // 2 :, 0] = points[FRAMES // 2 :, 1] - [0.0, 0.06, 0.0]
    written(source, forces, places, points, recording.labels)
    assert main(["convert", str(source), str(tmp_path / "out.trc"), "--for", "opensim", "--vertical", "z"]) == 0
    assert "on both feet at once" in capsys.readouterr().err
    table = formats.read_table(tmp_path / "out_grf.mot")
    half = len(table.times) // 2
    up = {who: table.values[:, table.names.index(f"1_{who}_ground_force_vy")] for who in ("left", "other")}
    assert up["left"][:half].max() > 690 and not up["left"][half:].any() and up["other"][half:].max() > 690
    loads = ElementTree.parse(tmp_path / "out_grf.xml").getroot().findall(".//ExternalForce")
    assert [load.findtext("force_identifier") for load in loads] == ["1_left_ground_force_v"]


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"units": ["V"] * 6}, "its channels are in V, not in N"),
        ({"ORIGIN": np.array([[900.0], [0.0], [-40.0]])}, "lie outside its corners"),
        ({"TYPE": [9]}, "type 9"),
    ],
    ids=["volts", "elsewhere", "type"],
)
def test_a_plate_that_tells_no_forces_is_said(given: dict[str, Any], why: str, tmp_path: Path) -> None:
    recording = formats.read(two_steps(tmp_path, **given), vertical="z")
    [left] = [
        phrase for phrase in formats.write_for_program(recording, "opensim", tmp_path / "a.trc") if phrase.startswith("force plate 1")
    ]
    assert why in left and not (tmp_path / "a_grf.mot").exists()


def test_a_person_who_stands_there_from_the_beginning_is_no_baseline(tmp_path: Path) -> None:
    samples = FRAMES * EACH
    forces, places = np.tile([0.0, 0.0, 650.0], (samples, 1)), np.tile([0.6, 0.3, 0.0], (samples, 1))
    path = written(tmp_path / "static.c3d", forces, places, np.tile([0.6, 0.3, 1.0], (FRAMES, 1, 1)), ("SACR",), ZERO=[1, 15])
    [plate], _ = formats.force_plates(formats.read(path, vertical="z"))
    np.testing.assert_allclose(plate.load, 650.0, atol=0.01)
    # Frames, not samples: of the empty plate's first 20 frames all samples are the baseline.
    drift = np.concatenate([np.linspace(0.0, 14.0, 200), np.full(samples - 200, 7.0)])[:, None] * [0.0, 0.0, 1.0]
    heights = drift + np.where(np.arange(samples) >= 200, 650.0, 0.0)[:, None] * [0.0, 0.0, 1.0]
    path = written(tmp_path / "walk.c3d", heights, places, np.tile([0.6, 0.3, 1.0], (FRAMES, 1, 1)), ("SACR",), ZERO=[1, 20])
    [plate], _ = formats.force_plates(formats.read(path, vertical="z"))
    assert plate.load[400] == pytest.approx(650.0, abs=1.0)


def test_contacts_are_steps_not_drift_nor_shaking() -> None:
    def contacts(heights: np.ndarray) -> list[tuple[int, int]]:
        forces = np.column_stack([np.zeros((len(heights), 2)), heights])
        plate = ForcePlate(1, CORNERS, forces, np.zeros_like(forces), 1000.0, np.array([0.0, 0.0, 1.0]))
        return [(run.start, run.stop) for run in plate.contacts]

    heights = np.concatenate([np.zeros(100), np.full(200, 600.0), np.zeros(200), np.full(300, 30.0), np.zeros(100)])
    assert contacts(heights) == [(100, 300)], "thirty newtons are the plate's drift"
    heights[200:210], heights[380:390] = 0.0, 90.0
    assert contacts(heights) == [(100, 300)], "it shakes, and is hit"
    assert contacts(np.zeros(50)) == []


def test_the_table_is_the_vendors_and_the_feet_those_of_the_events(data: Path, tmp_path: Path) -> None:
    folder = data / "gait-events/fullbody"
    formats.write_for_program(formats.read(folder / "small.c3d"), "opensim", tmp_path / "small.trc")
    ours, theirs = formats.read_table(tmp_path / "small_grf.mot"), formats.read_table(folder / "small.mot")
    np.testing.assert_allclose(ours.times, theirs.times, atol=1e-6)
    for plate in (1, 2, 4):
        stands = ours.values[:, ours.names.index(f"{plate}_ground_force_vy")] > 100
        assert stands.sum() > 300
        for part, close in (("v", 10.0), ("p", 0.01)):
            for axis in "xyz":
                own = ours.values[:, ours.names.index(f"{plate}_ground_force_{part}{axis}")]
                other = theirs.values[:, theirs.names.index(f"ground_force{plate}_{part}{axis}")]
                np.testing.assert_allclose(own[stands], other[stands], atol=close)
    loads = ElementTree.parse(tmp_path / "small_grf.xml").getroot().findall(".//ExternalForce")
    feet = {one.get("name"): one.findtext("applied_to_body") for one in loads}
    assert feet == {"1_ground": "calcn_r", "2_ground": "calcn_l", "4_ground": "calcn_r"}


@pytest.mark.parametrize("name", ["NP1003/walk_1003a09", "NP1011/walk_1011a17"])
def test_a_step_bears_the_weight_of_the_body(name: str, data: Path) -> None:
    recording = formats.read(data / f"gait-events/plates/{name}.c3d")
    plates, findings = formats.force_plates(recording)
    # From one strike to the next the plates bear all of the body, which is as fast up and down at both: the mean is its weight.
    strikes = sorted(contact.start for plate in plates for contact in plate.contacts)
    loads = np.sum([plate.load[strikes[1] : strikes[2]] for plate in plates], axis=0)
    assert recording.source is not None and not findings
    [mass] = recording.source.parameters.values("PROCESSING", "BODYMASS")
    assert loads.mean() / 9.81 == pytest.approx(mass, rel=0.04), "kg, as the laboratory weighed it"
