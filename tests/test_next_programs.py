"""Files for the next program: the right axis up, the right unit, and nothing left out without a word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.formats._programs import PROGRAMS, rotation_between
from asterism.recording import Recording, as_vertical
from asterism.simulation import simulate_walks

AXES = ["x", "y", "z", "-x", "-y", "-z"]


def run(*words: object) -> int:
    return main([str(word) for word in words])


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate_walks(1, 20, 50.0, seed=2)[0]


def _height(recording: Recording) -> np.ndarray:
    return recording.positions @ recording.vertical


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("program", PROGRAMS)
def test_heights_and_distances_stay_and_the_programs_axis_is_up(program: str, axis: str, tmp_path: Path) -> None:
    recording = simulate_walks(1, 20, 50.0, seed=2, vertical=axis)[0]
    target = tmp_path / f"walk{PROGRAMS[program].suffix}"
    prepared, _ = formats.for_program(recording, program, target)
    formats.write(target, prepared)
    back = formats.read(target, vertical=PROGRAMS[program].up)
    np.testing.assert_allclose(_height(back), _height(recording), atol=2e-5)
    gaps = [np.linalg.norm(np.diff(each.positions, axis=1), axis=2) for each in (back, recording)]
    np.testing.assert_allclose(*gaps, atol=5e-5)
    triple = [np.linalg.det(each.positions[0, :3] - each.positions[0, 3]) for each in (back, recording)]
    assert triple[0] == pytest.approx(triple[1], rel=1e-2), "a rotation, no mirror image"


def test_opensim_gets_y_up_and_millimetres(walk: Recording, tmp_path: Path) -> None:
    prepared, _ = formats.for_program(walk, "opensim", tmp_path / "walk.trc")
    x, y, z = np.moveaxis(walk.positions, 2, 0)
    np.testing.assert_allclose(prepared.positions, np.stack([x, z, -y], axis=2), atol=1e-12)
    formats.write(tmp_path / "walk.trc", prepared)
    assert "\tmm\t" in (tmp_path / "walk.trc").read_text(encoding="utf-8").splitlines()[2]


def test_points_without_a_name_stay_behind_and_are_told(walk: Recording) -> None:
    recording = Recording(walk.positions, (*walk.labels[:-2], "*1", "*2"), walk.rate)
    prepared, left = formats.for_program(recording, "opensim", "a.trc")
    assert prepared.labels == walk.labels[:-2] and left == ["2 points without a name"]
    assert formats.for_program(recording, "visual3d", "a.c3d") == (recording, [])
    with pytest.raises(AsterismError, match="no point with a name for blender; label it first"):
        formats.for_program(Recording.from_clouds(walk.clouds()), "blender", "a.c3d")


def test_a_c3d_that_suits_the_program_stays_byte_for_byte(data: Path, tmp_path: Path) -> None:
    source, target = data / "gait/HC002/straight.c3d", tmp_path / "walk.c3d"
    assert run("convert", source, target, "--for", "visual3d") == 0
    assert target.read_bytes() == source.read_bytes()


def test_what_a_turned_c3d_leaves_behind_is_told(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("convert", data / "movement/vicon53/nick_freeform_001.c3d", tmp_path / "z.c3d", "--for", "visual3d") == 0
    assert "z.c3d leaves out what" in capsys.readouterr().err
    assert formats.describe(tmp_path / "z.c3d")["vertical"] == [0.0, 0.0, 1.0]


def test_another_suffix_and_a_rig_are_refused(walk: Recording, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formats.write(tmp_path / "walk.c3d", walk)
    assert run("convert", tmp_path / "walk.c3d", tmp_path / "walk.csv", "--for", "opensim") == 2
    assert "files for opensim are written as .trc; name it walk.trc" in capsys.readouterr().err
    assert not (tmp_path / "walk.csv").exists()
    rig = next((data / "cameras/vicon-rig-walk").glob("*.xcp"))
    assert run("convert", rig, tmp_path / "rig.toml", "--for", "opensim") == 2
    assert "leave out --markers, --for, --fill and --filter" in capsys.readouterr().err


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_the_smallest_rotation_brings_one_direction_to_the_other(numbers: list[float]) -> None:
    first, second = np.array(numbers[:3]), np.array(numbers[3:])
    if min(np.linalg.norm(first), np.linalg.norm(second)) < 1e-3:
        return
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    rotation = rotation_between(first, second)
    np.testing.assert_allclose(rotation @ first, second, atol=1e-4)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("axis", AXES)
def test_opposite_directions_turn_by_half_a_circle(axis: str) -> None:
    vertical = as_vertical(axis)
    rotation = rotation_between(vertical, -vertical)
    np.testing.assert_allclose(rotation @ vertical, -vertical, atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "file, form", [("motive-csv/motive_v1.22_rigidbodies.csv", "Motive"), ("vicon-csv/nexus_trajectories.csv", "Nexus")]
)
def test_a_csv_that_does_not_come_back_in_its_own_form_says_so(file: str, form: str, data: Path, tmp_path: Path) -> None:
    recording = formats.read(data / "conformance" / file)
    assert formats.write(tmp_path / "a.csv", recording)[0] == f"the form of a {form} CSV, and is a CSV of Asterism's instead"
    assert not any("form of" in each for each in formats.write(tmp_path / "b.csv", formats.read(tmp_path / "a.csv")))
    assert formats.read(tmp_path / "a.csv").labels == formats.read(tmp_path / "b.csv").labels
