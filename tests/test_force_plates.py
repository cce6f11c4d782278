"""Force plates of C3D files: each type against a known load, whatever its signs and units, and real walks against the feet on them."""

from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np
import pytest

import asterism
from asterism.formats import force_plates
from asterism.recording import ForcePlate
from asterism.recording.plate_feet import BOTH, NOBODY, foot_on

CORNERS = np.array([[1.6, 2.0, 0.0], [1.2, 2.0, 0.0], [1.2, 2.4, 0.0], [1.6, 2.4, 0.0]])
"""m, in the room: the plate's x is the room's, its y the room's backwards, and its z points into the floor."""
FORCE, AT, TWIST = np.array([30.0, -50.0, 700.0]), np.array([1.45, 2.25, 0.0]), 4.0
"""N and m in the room, N m about the vertical: one person's load."""
SENSORS = 0.04
"""m below the surface."""


def plate_axes() -> np.ndarray:
    """Columns: the plate's axes in the room, z down."""
    x, y = (CORNERS[0] - CORNERS[1]) / 0.4, (CORNERS[0] - CORNERS[3]) / 0.4
    return np.stack([x, y, np.cross(x, y)], axis=1)


def channels(kind: int, load: float) -> np.ndarray:
    """What a plate of this type measures of a share of the load: N and N mm, in its axes, about sensors below the surface."""
    axes, centre = plate_axes(), CORNERS.mean(axis=0)
    force = load * FORCE @ axes
    arm = (AT - centre) @ axes
    twist = np.array([0.0, 0.0, load * TWIST]) @ axes
    if kind == 1:
        return np.array([*force, *(1000 * arm[:2]), 1000 * twist[2]])
    # From the sensors' origin, which is below the surface: the plate's z points down.
    moment = np.cross(arm + np.array([0.0, 0.0, -SENSORS]), force) + twist
    if kind in (2, 4):
        return np.array([*force, *(1000 * moment)])
    a, b = 0.12, 0.15
    # Eight sensors: any split that gives these sums.
    z = np.linalg.lstsq(np.array([[1, 1, 1, 1], [b, b, -b, -b], [-a, a, a, -a]]), np.array([force[2], moment[0], moment[1]]), rcond=None)[0]
    sides = np.linalg.lstsq(np.array([[1, 1, 0, 0], [0, 0, 1, 1], [-b, b, a, -a]]), np.array([force[0], force[1], moment[2]]), rcond=None)[
        0
    ]
    return np.array([*sides, *z])


def written(
    path: Path, kind: int, *, sign: float = 1.0, unit: str = "Nmm", origin_sign: float = 1.0, corners: bool = True, bits: int = 0
) -> Path:
    """A C3D file of one plate on which nobody stands, then somebody, then nobody; `bits`: of the whole numbers that it is kept in."""
    ramp = np.linspace(0, 1, 42)[1:-1] if bits else np.zeros(0)
    share = np.concatenate([np.zeros(100), ramp, np.ones(200 - 2 * len(ramp)), ramp[::-1], np.zeros(100)])
    samples = np.array([channels(kind, load) for load in share])
    if bits:
        samples = (np.round(samples) + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    # a place has no sign
    samples[:, [place for place in range(samples.shape[1]) if kind != 1 or place not in (3, 4)]] *= sign
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["LHEE", "RHEE"]
    file["parameters"]["ANALOG"]["RATE"]["value"] = [1000.0]
    count = samples.shape[1]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = [f"channel {i + 1}" for i in range(count)]
    file["parameters"]["ANALOG"]["UNITS"]["value"] = ["N"] * 3 + [unit] * (count - 3)
    file["data"]["points"] = np.ones((4, 2, 40)) * 1000.0
    matrix = np.diag([500.0, 500.0, 1000.0, 8e5, 8e5, 4e5]) + np.eye(6, k=1)
    file["data"]["analogs"] = (samples @ np.linalg.inv(matrix).T if kind == 4 else samples).T[None]
    origin = [120.0, 150.0, -1000 * SENSORS] if kind == 3 else [0.0, 0.0, -1000 * SENSORS]
    group = {
        "USED": [1],
        "TYPE": [kind],
        "CHANNEL": np.arange(1, count + 1, dtype=float)[:, None],
        "ORIGIN": origin_sign * np.array(origin)[:, None],
    }
    group["CORNERS"] = (1000 * CORNERS).T[:, :, None] if corners else np.zeros((3, 4, 1))
    group |= {"ZERO": [1, 50]} | ({"CAL_MATRIX": matrix[:, :, None]} if kind == 4 else {})
    for name, value in group.items():
        file.add_parameter("FORCE_PLATFORM", name, [float(one) for one in value] if isinstance(value, list) else value)
    file.write(str(path))
    return path


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_known_load_is_found_on_every_type_of_plate(tmp_path: Path, kind: int, sign: float) -> None:
    [plate], found = force_plates(asterism.read(written(tmp_path / "plate.c3d", kind, sign=sign)))
    assert not found and plate.rate == pytest.approx(1000.0)
    np.testing.assert_array_equal(plate.loaded, np.concatenate([np.zeros(100), np.ones(200), np.zeros(100)]).astype(bool))
    np.testing.assert_allclose(plate.force[200], FORCE, atol=0.01)
    np.testing.assert_allclose(plate.pressure[200], AT, atol=1e-4)
    assert plate.free_moment[200] == pytest.approx(TWIST, abs=0.01)
    assert np.isnan(plate.pressure[0]).all()


@pytest.mark.parametrize("given", [{"unit": "Nm"}, {"origin_sign": -1.0}])
def test_a_unit_or_origin_that_takes_people_off_the_plate_is_not_believed(tmp_path: Path, given: dict) -> None:
    [plate], _ = force_plates(asterism.read(written(tmp_path / "plate.c3d", 2, **given)))
    np.testing.assert_allclose(plate.pressure[200], AT, atol=1e-4)


def test_moments_that_ran_over_sixteen_bits_are_continued(tmp_path: Path) -> None:
    """35 N m are more than 32,767 N mm: the exporter went on from the other end."""
    recording = asterism.read(written(tmp_path / "plate.c3d", 2, bits=16))
    assert recording.source.analog.min() < -30000
    [plate], [finding] = force_plates(recording)
    assert finding.code == "format-analog-overflow" and "channels 4, 5" in finding.sentence
    np.testing.assert_allclose(plate.pressure[200], AT, atol=1e-4)
    # In 24 bits nothing runs over.
    [plate], found = force_plates(asterism.read(written(tmp_path / "wide.c3d", 2, bits=24)))
    assert not found
    np.testing.assert_allclose(plate.pressure[200], AT, atol=1e-4)


def test_a_plate_without_corners_is_named(tmp_path: Path) -> None:
    plates, [finding] = force_plates(asterism.read(written(tmp_path / "plate.c3d", 2, corners=False)))
    assert plates == () and finding.code == "format-force-plate" and "corners" in finding.sentence


def test_a_plate_that_stands_upright_is_named(tmp_path: Path) -> None:
    """Its corners have z up, and the recording was read with y up."""
    plates, [finding] = force_plates(asterism.read(written(tmp_path / "plate.c3d", 2), vertical="y"))
    assert plates == () and finding.code == "format-force-plate" and "stands upright" in finding.sentence


def test_samples_are_brought_to_the_frames(tmp_path: Path) -> None:
    recording = asterism.read(written(tmp_path / "plate.c3d", 2))
    [plate], _ = force_plates(recording)
    at: ForcePlate = plate.at(recording.rate, len(recording))
    assert at.force.shape == (40, 3) and at.loaded.sum() == pytest.approx(20, abs=1)
    np.testing.assert_allclose(at.pressure[20], AT, atol=1e-4)


def test_a_sample_that_is_no_number_spoils_its_frame_alone(tmp_path: Path) -> None:
    file = ezc3d.c3d(str(written(tmp_path / "plate.c3d", 2)))
    # One sample of a frame whose other nine are there, all of another, and one of those that tell the baseline.
    for samples in (205, slice(245, 255), 3):
        file["data"]["analogs"][0, :, samples] = np.nan
    file.write(str(tmp_path / "holes.c3d"))
    recording = asterism.read(tmp_path / "holes.c3d")
    [plate], found = force_plates(recording)
    at = plate.at(recording.rate, len(recording))
    assert not found
    np.testing.assert_array_equal(np.isnan(at.force).any(axis=1), np.arange(40) == 25)
    np.testing.assert_allclose(at.pressure[[20, 21, 28]], [AT] * 3, atol=1e-4)


def test_feet_stand_on_real_plates(data: Path) -> None:
    """The centre of pressure is between heel and toe, within 25 mm, and the force is that of a person's weight."""
    recording = asterism.read(data / "gait-events/plates/NP1003/walk_1003a09.c3d")
    plates, _ = force_plates(recording)
    weight, seen = 51.3 * 9.81, 0
    for plate in (one.at(recording.rate, len(recording)) for one in plates):
        frames = np.nonzero(plate.load > 0.5 * weight)[0]
        if not len(frames):
            continue
        apart = []
        for side in "LR":
            heel, toe = (recording.positions[frames, recording.labels.index(side + name), :2] for name in ("HEE", "TOE"))
            along = np.clip(((plate.pressure[frames, :2] - heel) * (toe - heel)).sum(axis=1) / ((toe - heel) ** 2).sum(axis=1), 0, 1.3)
            apart.append(np.linalg.norm(plate.pressure[frames, :2] - heel - along[:, None] * (toe - heel), axis=1))
        assert np.median(np.min(apart, axis=0)) < 0.025 and plate.load.max() < 1.6 * weight
        seen += 1
    assert seen == 3


UP = np.array([0.0, 0.0, 1.0])


def loaded_at(places: np.ndarray, high: float = 0.0) -> ForcePlate:
    """A plate that bears 600 N at these places (S, 2), a hundred samples per second."""
    force = np.tile([0.0, 0.0, 600.0], (len(places), 1))
    corners = CORNERS + np.array([0.0, 0.0, high])
    arm = np.column_stack([places, np.full(len(places), high)]) - corners.mean(axis=0)
    return ForcePlate(1, corners, force, np.cross(arm, force), 100.0, UP)


def foot(x: float, *, markers: tuple[float, ...] = (0.0, 0.18), high: float = 0.0) -> np.ndarray:
    """(100, M, 3) markers of a foot that points along y from 2.1 m, and of its knee."""
    points = [[x, 2.1 + along, high + 0.04] for along in markers]
    return np.tile([*points, [x, 2.1, high + 0.5]], (100, 1, 1))


ROLLING = np.column_stack([np.full(100, 1.35), np.linspace(2.1, 2.32, 100)])
"""From a heel to the toes, 1.35 m to the right."""


@pytest.mark.parametrize("markers", [(0.0, 0.18), (0.0,), (0.0, 0.1, 0.18)])
@pytest.mark.parametrize("belt", [0.0, 0.4])
def test_the_foot_that_bears_a_plate_is_told_by_any_markers(markers: tuple[float, ...], belt: float) -> None:
    """By heel and toe, a heel alone, or more; with a belt that lies higher than its plate, and the other foot passing."""
    other = foot(1.12, markers=markers, high=belt)
    other[:, :, 1] += np.linspace(-0.6, 0.6, 100)[:, None]
    feet = {"L": foot(1.36, markers=markers, high=belt), "R": other}
    plate = loaded_at(ROLLING)
    assert foot_on(plate, slice(0, 100), feet, 100.0) == "L"
    assert foot_on(plate, slice(0, 100), {"L": feet["R"], "R": feet["L"]}, 100.0) == "R"


def test_two_feet_and_no_foot_on_a_plate_are_not_one() -> None:
    feet = {"L": foot(1.25), "R": foot(1.55)}
    between = np.column_stack([np.full(100, 1.4), np.full(100, 2.2)])
    assert foot_on(loaded_at(between), slice(0, 100), feet, 100.0) == BOTH
    # one after the other
    after = np.column_stack([np.repeat([1.25, 1.55], 50), np.full(100, 2.2)])
    assert foot_on(loaded_at(after), slice(0, 100), feet, 100.0) == BOTH
    away = {side: points + np.array([0.0, 3.0, 0.0]) for side, points in feet.items()}
    for none in (
        away,
        {side: np.full_like(points, np.nan) for side, points in feet.items()},
        {side: points[:, :0] for side, points in feet.items()},
    ):
        assert foot_on(loaded_at(between), slice(0, 100), none, 100.0) == NOBODY
    assert foot_on(loaded_at(between), slice(0, 100), {side: points[:0] for side, points in feet.items()}, 100.0) == NOBODY
