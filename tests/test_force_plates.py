"""Force plates: a load of known place is found again whatever the plate's type, and OpenSim gets it under the foot that stands there."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

from asterism import formats
from asterism.cli import main
from asterism.formats.c3d._file import open_c3d
from asterism.recording.force_plate import ForcePlate

RATE, EACH, FRAMES = 100.0, 10, 60
CORNERS = np.array([[0.8, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.6, 0.0], [0.8, 0.6, 0.0]])
AXES = np.diag([1.0, -1.0, -1.0])
"""The plate's x, y and z by these corners: z points down."""
BELOW = np.array([0.012, -0.007, 0.045])
"""m, the sensors' origin in the plate's axes, from the middle of the surface."""


@dataclass(frozen=True)
class Load:
    """What is done to the body, (S, 3) each, in the room's axes: N, m, N m. The first third of the samples bears nothing."""

    forces: np.ndarray
    places: np.ndarray
    free: np.ndarray


def load(samples: int = FRAMES * EACH) -> Load:
    share = np.clip((np.arange(samples) / samples - 1 / 3) * 1.5, 0.0, 1.0)
    push = np.sin(np.pi * share)
    forces = np.column_stack([80 * np.sin(2 * np.pi * share), -30 * push, 700 * push])
    places = np.column_stack([0.55 + 0.1 * share, 0.15 + 0.25 * share, np.zeros(samples)])
    return Load(forces, places, np.column_stack([np.zeros((samples, 2)), 4 * push * np.cos(6 * share)]))


def channels(kind: int, done: Load) -> np.ndarray:
    """What the sensors of a plate measure under the load, in N, m and N m."""
    forces = done.forces @ AXES
    arms = (done.places - CORNERS.mean(axis=0)) @ AXES
    free = done.free @ AXES
    if kind == 1:
        return np.column_stack([forces, arms[:, :2], free[:, 2]])
    about = BELOW if kind != 3 and kind != 5 else np.array([0.0, 0.0, BELOW[2]])
    moments = np.cross(arms - about, forces) + free
    if kind in (2, 4):
        return np.column_stack([forces, moments])
    # Four sensors of upward force and of shear at (+-a, +-b) that share the load so that sum and moments are these.
    a, b = 0.12, 0.2
    quarter, tilt_x, tilt_y = forces[:, 2] / 4, moments[:, 0] / (4 * b), moments[:, 1] / (4 * a)
    up = [quarter + tilt_x - tilt_y, quarter + tilt_x + tilt_y, quarter - tilt_x + tilt_y, quarter - tilt_x - tilt_y]
    twist = moments[:, 2] / (4 * b), moments[:, 2] / (4 * a)
    across = [forces[:, 0] / 2 - twist[0], forces[:, 0] / 2 + twist[0], forces[:, 1] / 2 + twist[1], forces[:, 1] / 2 - twist[1]]
    return np.column_stack([*across, *up])


def written(
    path: Path,
    kind: int,
    samples: np.ndarray,
    *,
    origin: np.ndarray | None = None,
    moment_unit: str = "Nmm",
    unit: str = "mm",
    points: np.ndarray | None = None,
    labels: tuple[str, ...] = ("SACR",),
    **parameters: Any,
) -> Path:
    """A C3D file with one plate that measures the samples; lengths are given in m and stored in the file's unit."""
    scale = {"mm": 1000.0, "m": 1.0}[unit]
    file = ezc3d.c3d()
    points = np.tile([0.6, 0.3, 1.0], (FRAMES, len(labels), 1)) if points is None else points
    file["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    file["data"]["points"] = np.concatenate([scale * points.transpose(2, 1, 0), np.ones((1, len(labels), len(points)))])
    stored = samples.copy()
    if kind == 1:
        stored[:, 3:5] *= scale
    if kind != 3:
        stored[:, 5 if kind == 1 else slice(3, 6)] *= {"Nmm": 1000.0, "Nm": 1.0, "V": 1000.0}[moment_unit]
    width = stored.shape[1]
    group: dict[str, Any] = {
        "USED": [1], "TYPE": [kind], "ZERO": [1, 0], "CORNERS": (scale * CORNERS).T.reshape(3, 4, 1),
        "ORIGIN": (scale * (-BELOW if origin is None else origin)).reshape(3, 1), "CHANNEL": np.arange(1.0, width + 1).reshape(width, 1),
    }  # fmt: skip
    if kind == 4:
        # Outputs of the matrix are the channels; what it is given is not.
        matrix = np.diag([2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + 0.01 * np.arange(36).reshape(6, 6)
        stored, group["CAL_MATRIX"] = np.linalg.solve(matrix, stored.T).T, matrix.reshape(6, 6, 1)
    for name, value in {**group, **parameters}.items():
        file.add_parameter("FORCE_PLATFORM", name, value)
    file["parameters"]["ANALOG"]["RATE"]["value"] = [RATE * EACH]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = [f"ch{k}" for k in range(width)]
    file["parameters"]["ANALOG"]["UNITS"]["value"] = (
        ["V"] * width if moment_unit == "V" else ["N"] * 3 + ([moment_unit] * 3 if width == 6 else ["N"] * 5)
    )
    file["data"]["analogs"] = stored.T[None]
    file.write(str(path))
    return path


def read(path: Path) -> ForcePlate:
    [plate], findings = formats.read_force_plates(path)
    assert not findings
    return plate


def check(plate: ForcePlate, done: Load) -> None:
    np.testing.assert_allclose(plate.forces, done.forces, atol=0.01)
    stands = done.forces[:, 2] > 20.1
    assert (plate.loaded == (done.forces[:, 2] > 20)).mean() > 0.99 and 0.5 < stands.mean() < 0.7
    np.testing.assert_allclose(plate.pressures[stands], done.places[stands], atol=2e-4)
    np.testing.assert_allclose(plate.moments[stands], done.free[stands], atol=0.02)
    assert np.isnan(plate.pressures[~plate.loaded]).all() and plate.rate == RATE * EACH


@pytest.mark.parametrize("sign", [1, -1], ids=["reaction", "action"])
@pytest.mark.parametrize(
    ("kind", "moment_unit", "unit"),
    [(1, "Nmm", "mm"), (2, "Nmm", "mm"), (2, "Nm", "m"), (2, "Nm", "mm"), (3, "Nmm", "mm"), (4, "V", "mm"), (4, "Nm", "m")],
)
def test_a_known_load_is_found_again(kind: int, moment_unit: str, unit: str, sign: int, tmp_path: Path) -> None:
    samples = channels(kind, load())
    samples = samples * (np.array([sign] * 3 + [1, 1, sign]) if kind == 1 else sign)
    origin = -np.array([0.12, 0.2, BELOW[2]]) * [-1, -1, 1] if kind == 3 else None
    check(read(written(tmp_path / "a.c3d", kind, samples, origin=origin, moment_unit=moment_unit, unit=unit)), load())


def test_an_origin_written_the_other_way_round_is_the_same(tmp_path: Path) -> None:
    check(read(written(tmp_path / "a.c3d", 2, channels(2, load()), origin=BELOW)), load())


def test_a_baseline_is_subtracted_and_a_person_is_none(tmp_path: Path) -> None:
    drift = np.array([3.0, -5.0, 12.0, 0.4, -0.6, 0.2])
    check(read(written(tmp_path / "a.c3d", 2, channels(2, load()) + drift, ZERO=[1, 15])), load())
    standing = channels(2, load()) + np.array([0.0, 0.0, -650.0, 0.0, 0.0, 0.0])
    [plate], [finding] = formats.read_force_plates(written(tmp_path / "b.c3d", 2, standing, ZERO=[1, 15]))
    assert finding.code == "format-force-plate" and "the baseline of force plate 1 is left out: it bore 650 N" in finding.sentence
    assert plate.forces[0, 2] == pytest.approx(650, abs=0.01)


def test_a_plate_that_cannot_be_read_is_left_out_and_said(tmp_path: Path) -> None:
    samples = channels(2, load())
    damage: dict[str, dict[str, Any]] = {
        "its type 9 is none of": {"TYPE": [9]},
        "its channels are not among": {"CHANNEL": np.arange(3.0, 9).reshape(6, 1)},
        "its corners span no surface": {"CORNERS": np.ones((3, 4, 1))},
        "CORNERS does not hold its 12 values": {"CORNERS": np.ones((3, 3, 1))},
        "lie outside its corners": {"ORIGIN": np.array([9000.0, 0.0, -40.0]).reshape(3, 1)},
    }
    for why, given in damage.items():
        plates, [finding] = formats.read_force_plates(written(tmp_path / "a.c3d", 2, samples, **given))
        assert not plates and why in finding.sentence, finding.sentence
    plates, [finding] = formats.read_force_plates(written(tmp_path / "a.c3d", 2, samples, moment_unit="V"))
    assert not plates and "in V, not in N" in finding.sentence


def test_contacts_are_steps_not_drift_nor_shaking() -> None:
    def contacts(heights: np.ndarray) -> list[tuple[int, int]]:
        forces = np.column_stack([np.zeros((len(heights), 2)), heights])
        places = np.where(heights[:, None] >= 20, 0.0, np.nan) + np.zeros(3)
        plate = ForcePlate(CORNERS, np.array([0.0, 0.0, 1.0]), 1000.0, 0.0, forces, places, places)
        return [(run.start, run.stop) for run in plate.contacts()]

    step = np.concatenate([np.zeros(100), np.full(200, 600.0), np.zeros(200), np.full(300, 30.0), np.zeros(100)])
    assert contacts(step) == [(100, 300)], "thirty newtons are the plate's drift"
    step[200:210], step[380:390] = 0.0, 90.0
    assert contacts(step) == [(100, 300)], "it shakes, and is hit"
    assert contacts(np.zeros(50)) == []


def two_steps(folder: Path, *, sided: bool = True) -> Path:
    """Two contacts on one plate: the left foot, then the right one; the other foot stands behind it."""
    samples = FRAMES * EACH
    done = load(samples // 2)
    done = Load(*(np.concatenate([part, part]) for part in (done.forces, done.places, done.free)))
    foot = np.add(done.places[::EACH], [0.0, 0.03, 0.08])
    other = np.subtract(foot, [0.4, 0.0, 0.0])
    first = np.arange(FRAMES)[:, None] < FRAMES // 2
    points = np.stack([np.where(first, foot, other), np.where(first, other, foot), np.add(foot, [0.0, 0.0, 0.9])], axis=1)
    labels = ("LHEE", "RHEE", "SACR") if sided else ("A", "B", "C")
    return written(folder / "walk.c3d", 2, channels(2, done), points=points, labels=labels)


def test_opensim_gets_forces_under_the_feet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = two_steps(tmp_path), tmp_path / "out.trc"
    assert main(["convert", str(source), str(target), "--for", "opensim", "--vertical", "z"]) == 0
    table = formats.read_table(tmp_path / "out_grf.mot")
    assert table.names[:9] == tuple(f"1_left_ground_{part}{axis}" for part in ("force_v", "force_p", "torque_") for axis in "xyz")
    markers = formats.read(target, vertical="y")
    assert table.times[0] == markers.times[0] and table.rate == RATE * EACH
    first = np.arange(len(table.times)) < FRAMES * EACH // 2
    for side, own, body in (("left", first, "calcn_l"), ("right", ~first, "calcn_r")):
        columns = {
            part: table.values[:, [table.names.index(f"1_{side}_ground_{part}{axis}") for axis in "xyz"]] for part in ("force_v", "force_p")
        }
        assert not columns["force_v"][~own].any() and columns["force_v"][own, 1].max() == pytest.approx(700, abs=0.5)
        stands = np.nonzero(columns["force_v"][:, 1] > 300)[0]
        heel = markers.select([f"{side[0].upper()}HEE"]).positions[stands // EACH, 0]
        apart = heel - columns["force_p"][stands]
        np.testing.assert_allclose(apart, np.tile([0.0, 0.08, -0.03], (len(apart), 1)), atol=0.012)
        loads = ElementTree.parse(tmp_path / "out_grf.xml").getroot().findall(".//ExternalForce")
        [one] = [each for each in loads if each.findtext("applied_to_body") == body]
        assert one.findtext("force_identifier") == f"1_{side}_ground_force_v" and one.findtext("data_source_name") == "out_grf.mot"
    assert main(["convert", str(source), str(tmp_path / "new.trc"), "--for", "opensim"]) == 0
    (tmp_path / "new.trc").unlink()
    assert main(["convert", str(source), str(tmp_path / "new.trc"), "--for", "opensim"]) == 2
    assert "new_grf.mot" in capsys.readouterr().err, "an older table is not replaced"


def test_a_load_under_an_unknown_foot_is_in_the_table_and_under_no_body(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = two_steps(tmp_path, sided=False)
    assert main(["convert", str(source), str(tmp_path / "out.trc"), "--for", "opensim"]) == 0
    table = formats.read_table(tmp_path / "out_grf.mot")
    assert len(table.names) == 9 and table.values[:, 1].max() > 690
    assert "<ExternalForce" not in (tmp_path / "out_grf.xml").read_text()
    assert "the load on force plate 1 from" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["NP1003/walk_1003a09", "NP1011/walk_1011a17"])
def test_walking_bears_the_weight_of_the_body_within_the_plates(name: str, data: Path) -> None:
    path = data / f"gait-events/plates/{name}.c3d"
    plates, findings = formats.read_force_plates(path)
    assert not findings
    peer = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]["platform"]
    steps = [(plate, contact) for plate in plates for contact in plate.contacts()]
    assert len(steps) >= 3
    # From one strike to the next the plates bear all of the body, which is as fast up and down at both: the mean is its weight.
    strikes = sorted(contact.start for _, contact in steps)
    force = sum(plate.forces[strikes[1] : strikes[2], 2] for plate in plates)
    [mass] = open_c3d(path).parameters.values("PROCESSING", "BODYMASS")
    assert np.mean(force) / 9.81 == pytest.approx(mass, rel=0.04), "kg, as the laboratory weighed it"
    for plate, theirs in zip(plates, peer, strict=True):
        stands = plate.forces[:, 2] > 100
        assert plate.on_surface(plate.pressures[stands]).all()
        np.testing.assert_allclose(plate.forces, theirs["force"].T, atol=0.01)
        np.testing.assert_allclose(1000 * plate.pressures[stands], theirs["center_of_pressure"].T[stands], atol=0.1)


def test_the_table_is_the_vendors(data: Path, tmp_path: Path) -> None:
    folder = data / "gait-events/fullbody"
    formats.write_for_program(formats.read(folder / "small.c3d"), "opensim", tmp_path / "small.trc")
    ours, theirs = formats.read_table(tmp_path / "small_grf.mot"), formats.read_table(folder / "small.mot")
    np.testing.assert_allclose(ours.times, theirs.times, atol=1e-6)
    for plate in (1, 2, 4):
        for part in ("v", "p"):
            for axis in "xyz":
                own = ours.values[:, ours.names.index(f"{plate}_ground_force_{part}{axis}")]
                other = theirs.values[:, theirs.names.index(f"ground_force{plate}_{part}{axis}")]
                stands = ours.values[:, ours.names.index(f"{plate}_ground_force_vy")] > 100
                assert stands.sum() > 300
                np.testing.assert_allclose(own[stands], other[stands], atol=1e-3)
