"""Real text files of many vendors: all open, and hold what is known of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats import convert, describe, read, read_table, write

TABLES = ("conformance/motion/inverse_kin.mot", "conformance/motion/inverse_dyn.sto")


def text_files(data):
    folders = [data / name for name in ("conformance", "gait-events", "movement")]
    return sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in (".trc", ".csv", ".mat"))


def test_every_trc_csv_and_mat_opens(data):
    files = text_files(data)
    assert len(files) >= 25
    for path in files:
        recording = read(path)
        assert len(recording) > 0 and len(recording.labels) > 0, path
        assert np.nanmax(np.abs(recording.positions)) < 30.0, f"{path}: a marker is further than 30 m away"
        json.dumps(describe(path), default=Finding.to_dict)


def test_frames_rates_and_points_are_those_of_the_index(data):
    index = json.loads((data / "movement/index.json").read_text())
    checked = 0
    for name, known in index.items():
        path = next(
            (p for p in (data / "movement" / name, data / name, data / "movement" / name.removeprefix("movement/")) if p.is_file()), None
        )
        if path is None or path.suffix not in (".trc", ".csv") or not known.get("physical"):
            continue
        found = describe(path)
        assert (found["frames"], found["rate"]) == (known["frames"], pytest.approx(known["rate"])), name
        assert sorted(found["points"]["physical"]) == sorted(known["markers"]), name
        assert len(found["points"]["computed"]) == known["computed"], name
        checked += 1
    assert checked >= 15


def test_trc_written_again_holds_the_same(data, tmp_path):
    for path in sorted((data / "conformance/trc").glob("*.trc")):
        recording = read(path)
        write(tmp_path / "again.trc", recording)
        again = read(tmp_path / "again.trc")
        columns = [again.labels.index(label) for label in recording.labels]
        np.testing.assert_allclose(again.positions[:, columns], recording.positions, atol=1e-8, equal_nan=True, err_msg=path.name)
        assert (again.rate, again.first_frame) == (recording.rate, recording.first_frame)


def test_five_spellings_of_nan_are_missing(data):
    recording = read(data / "conformance/trc/dataWithNaNsOfDifferentCases.trc")
    assert np.isnan(recording.positions).all(axis=2).sum() == 5


def test_the_same_take_as_trc_and_c3d_is_the_same(data):
    folder = data / "movement/qtm-fullbody"
    text, binary = read(folder / "lem_static.trc"), read(folder / "lem_static.c3d")
    assert text.labels == binary.labels
    np.testing.assert_allclose(text.positions, binary.positions, atol=1e-5)
    assert any("1300 frames" in finding.sentence for finding in text.metadata["findings"])


def test_the_same_take_as_nexus_csv_and_trc_has_the_same_markers(data):
    nexus = read(data / "conformance/vicon-csv/nexus_trajectories.csv")
    bare = [label.rpartition(":")[2] for label in nexus.labels]
    assert nexus.positions.shape == (580, 51, 3)
    assert nexus.rate == 100.0
    assert bare[8:11] == ["ASISr", "ASISl", "PSISr"]
    np.testing.assert_allclose(nexus.positions[0, 0], [0.0441628, -0.276862, 0.675697])


def test_motive_takes_measured_markers_and_no_poses(data):
    rigid = describe(data / "conformance/motive-csv/motive_v1.21_rigidbody_unlabeled.csv")["points"]
    assert len(rigid["physical"]) == 3 and all(":Marker" in label for label in rigid["physical"])
    assert len(rigid["unnamed"]) == 6
    assert set(rigid["computed"]) == {"Rigid Body 1", "Rigid Body 1_1", "Rigid Body 1_2", "Rigid Body 1_3"}
    sticks = read(data / "conformance/motive-csv/motive_v1.22_rigidbodies.csv")
    assert len(sticks.labels) == 11
    assert sticks.first_frame == 4092
    np.testing.assert_allclose(sticks.positions[0, 0], [0.182859, 0.009604, 0.878486])


def test_the_mouse_has_eleven_markers_and_58_pieces(data):
    (path,) = (data / "movement/mouse-qtm").glob("*.mat")
    found = describe(path)
    assert (found["frames"], found["rate"]) == (10500, 300.0)
    assert (len(found["points"]["physical"]), len(found["points"]["unnamed"])) == (11, 58)
    assert found["missing"] == pytest.approx(0.209, abs=0.001)
    assert read(path).visible[:, 11:].sum(axis=1).mean() == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("file", TABLES)
def test_opensim_tables_are_tables_and_convert(data, tmp_path, file):
    table = read_table(data / file)
    assert len(table.names) == 25
    assert table.rate == pytest.approx(100.0)
    assert table.in_degrees is (file.endswith(".mot"))
    with pytest.raises(AsterismError, match="no marker positions"):
        read(data / file)
    for suffix in ("csv", "sto", "mot"):
        assert convert(data / file, tmp_path / f"table.{suffix}") == []
        np.testing.assert_array_equal(read_table(tmp_path / f"table.{suffix}").values, table.values)
    with pytest.raises(AsterismError, match="no marker positions"):
        convert(data / file, tmp_path / "table.c3d")


def test_real_trc_becomes_c3d_and_comes_back(data, tmp_path):
    recording = read(data / "conformance/trc/markers_walk.trc")
    convert(data / "conformance/trc/markers_walk.trc", tmp_path / "walk.c3d")
    back = read(tmp_path / "walk.c3d")
    assert back.labels == recording.labels
    np.testing.assert_allclose(back.positions, recording.positions, atol=1e-6, equal_nan=True)
    np.testing.assert_array_equal(back.vertical, recording.vertical)
