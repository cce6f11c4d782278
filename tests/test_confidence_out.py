"""The confidence of labels in files: what is written is read again, by us and by others, and nothing else in the file changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest

from asterism import formats
from asterism.errors import AsterismError
from asterism.formats.c3d._file import C3DFile, open_c3d
from asterism.recording import Clouds, Labelling, Recording

NAMES = ("LKNE", "RKNE", "SACR")
FRAMES = 7


@pytest.fixture
def labelled() -> tuple[Recording, Labelling, Clouds]:
    """Four tracks, labelled; the knee is hidden in one frame, the sacrum unsure in another, and one label's confidence is not known."""
    positions = np.random.default_rng(0).uniform(0.1, 1.5, size=(FRAMES, 4, 3))
    recording = Recording(positions, ("*1", "*2", "*3", "*4"), rate=50.0)
    clouds = recording.clouds()
    indices = np.tile([0, 1, 2], (FRAMES, 1))
    indices[2, 0] = -1
    indices[3, 2] = -1
    confidence = np.random.default_rng(1).uniform(0.5, 1.0, size=(FRAMES, 3)).round(4)
    confidence[:, 1] = [0.99, 0.9899, 1.0, 0.5, 0.0, 0.25, np.nan]
    labelling = Labelling(indices, confidence, NAMES)
    return recording.with_labelling(labelling, clouds), labelling, clouds


def _expected(labelling: Labelling) -> np.ndarray:
    return np.where(labelling.indices >= 0, np.nan_to_num(labelling.confidence), 0.0)


@pytest.mark.parametrize("name", ["walk.c3d", "walk.csv", "walk.long.csv", "walk.npz"])
def test_confidence_comes_back(name: str, labelled: tuple[Recording, Labelling, Clouds], tmp_path: Path) -> None:
    recording, labelling, clouds = labelled
    assert formats.write(tmp_path / name, recording, labelling=labelling, clouds=clouds) == []
    read = formats.read_confidence(tmp_path / name)
    assert read is not None and read.names == NAMES
    np.testing.assert_allclose(read.values, _expected(labelling), atol=1e-6)
    again = formats.read(tmp_path / name)
    assert set(again.labels) == set(recording.labels), "the columns of confidence are no markers"
    np.testing.assert_allclose(again.select(recording.labels).positions, recording.positions, atol=1e-6)
    formats.write(tmp_path / f"plain-{name}", recording)
    assert formats.read_confidence(tmp_path / f"plain-{name}") is None


@pytest.mark.parametrize("name", ["walk.trc", "walk.tsv", "walk.sto", "walk.mat"])
def test_formats_without_a_place_for_it_say_so(name: str, labelled: tuple[Recording, Labelling, Clouds], tmp_path: Path) -> None:
    recording, labelling, clouds = labelled
    assert "the confidence of the labels" in formats.write(tmp_path / name, recording, labelling=labelling, clouds=clouds)
    assert "the confidence of the labels" not in formats.write(tmp_path / name, recording)
    assert formats.read_confidence(tmp_path / name) is None


def test_other_readers_see_a_channel_for_each_label(labelled: tuple[Recording, Labelling, Clouds], tmp_path: Path) -> None:
    recording, labelling, clouds = labelled
    path = tmp_path / "walk.c3d"
    formats.write(path, recording, labelling=labelling, clouds=clouds)
    seen = ezc3d.c3d(str(path))
    assert seen["parameters"]["ANALOG"]["LABELS"]["value"] == [f"{name} confidence" for name in NAMES]
    np.testing.assert_allclose(seen["data"]["analogs"][0].T, _expected(labelling), atol=1e-6)
    with path.open("rb") as file:
        reader = c3d.Reader(file)
        assert [label.strip() for label in reader.analog_labels] == [f"{name} confidence" for name in NAMES]
        samples = np.concatenate([analog.T for _, _, analog in reader.read_frames()])
    np.testing.assert_allclose(samples, _expected(labelling), atol=1e-6)
    group = seen["parameters"]["ASTERISM"]
    assert group["LABELS"]["value"] == list(NAMES)
    counted = np.array([group[name]["value"] for name in ("LABELLED", "LIKELY", "UNSURE", "HIDDEN")])
    np.testing.assert_array_equal(counted.sum(axis=0), FRAMES)
    np.testing.assert_array_equal(counted[:, 1], [2, 5, 0, 0])
    np.testing.assert_allclose(group["CONFIDENCE"]["value"][1], _expected(labelling)[:, 1].mean(), atol=1e-6)


@pytest.mark.parametrize("value", [-0.01, 1.01, np.nan])
def test_a_confidence_that_is_no_probability_is_refused(
    value: float, labelled: tuple[Recording, Labelling, Clouds], tmp_path: Path
) -> None:
    recording, labelling, clouds = labelled
    path = tmp_path / "walk.npz"
    formats.write(path, recording, labelling=labelling, clouds=clouds)
    with np.load(path) as held:
        arrays = dict(held)
    arrays["confidence"][3, 1] = value
    np.savez(path, **arrays)
    with pytest.raises(AsterismError, match=r"walk\.npz is damaged"):
        formats.read_confidence(path)


def test_labelled_again_the_channels_are_replaced(labelled: tuple[Recording, Labelling, Clouds], tmp_path: Path) -> None:
    recording, labelling, clouds = labelled
    first, second = tmp_path / "first.c3d", tmp_path / "second.c3d"
    formats.write(first, recording, labelling=labelling, clouds=clouds)
    read = formats.read(first)
    formats.write(tmp_path / "copy.c3d", read)
    assert (tmp_path / "copy.c3d").read_bytes() == first.read_bytes(), "a file that nobody changed stays as it is"
    fewer = Labelling(np.full((FRAMES, 2), -1), np.zeros((FRAMES, 2)), ("LKNE", "RKNE"))
    fewer.indices[:, 0] = 0
    fewer.confidence[:, 0] = 0.75
    formats.write(second, read.with_labelling(fewer), labelling=fewer)
    assert open_c3d(second).parameters.strings("ANALOG", "LABELS") == ["LKNE confidence", "RKNE confidence"]
    again = formats.read_confidence(second)
    assert again is not None
    np.testing.assert_allclose(again.values, [[0.75, 0.0]] * FRAMES, atol=1e-6)


REAL = [
    "gait/HC030/straight.c3d",
    "conformance/c3d/sample_02/pc_int.c3d",
    "conformance/c3d/sample_02/dec_int.c3d",
    "conformance/c3d/sample_02/dec_real.c3d",
    "conformance/c3d/sample_02/sgi_int.c3d",
    "conformance/c3d/sample_02/sgi_real.c3d",
    "movement/vicon53/nick_freeform_001.c3d",
]


@pytest.mark.parametrize("name", REAL)
def test_points_and_analog_samples_of_real_files_stay(name: str, data: Path, tmp_path: Path) -> None:
    recording = formats.read(data / name)
    before = recording.source
    assert isinstance(before, C3DFile)
    count = 12
    labelling = Labelling(
        np.zeros((len(recording), count), dtype=np.int64),
        np.random.default_rng(0).uniform(0.0, 1.0, size=(len(recording), count)),
        recording.labels[:count],
    )
    clouds = recording.clouds()
    formats.write(tmp_path / "out.c3d", recording, labelling=labelling, clouds=clouds)
    after = open_c3d(tmp_path / "out.c3d")
    np.testing.assert_array_equal(after.point_words, before.point_words)
    np.testing.assert_array_equal(
        after.analog[:, : before.analog_channels], before.analog if before.analog_channels else np.empty((len(after.analog), 0))
    )
    assert after.analog_channels == before.analog_channels + count
    assert after.parameters.values("FORCE_PLATFORM", "CHANNEL").tolist() == before.parameters.values("FORCE_PLATFORM", "CHANNEL").tolist()
    read = formats.read_confidence(tmp_path / "out.c3d")
    assert read is not None
    np.testing.assert_allclose(read.values, labelling.confidence, atol=1.01e-4)
    assert not after.findings or {f.code for f in after.findings} <= {f.code for f in before.findings}


def test_a_marker_may_take_the_label_of_a_computed_point(data: Path, tmp_path: Path) -> None:
    source = data / "movement" / "clinical-lower" / "sydney_static.c3d"
    recording = formats.read(source)
    before = open_c3d(source)
    assert "RKNE" in formats.computed_labels(recording) and "RKNE" not in recording.labels, "a static trial with a knee alignment device"
    column = recording.labels.index(next(label for label in recording.labels if label.startswith("*")))
    named = replace(recording, labels=tuple("RKNE" if m == column else label for m, label in enumerate(recording.labels)))
    [lost] = formats.write(tmp_path / "out.c3d", named)
    assert "RKNE_computed" in lost
    after = open_c3d(tmp_path / "out.c3d")
    computed = after.labels.index("RKNE_computed")
    np.testing.assert_array_equal(after.point_words[:, computed], before.point_words[:, before.labels.index("RKNE")])
    again = formats.read(tmp_path / "out.c3d")
    assert "RKNE" in again.labels and "RKNE_computed" in formats.computed_labels(again)


def test_computed_points_are_left_out_with_their_declaration(data: Path, tmp_path: Path) -> None:
    recording = formats.read(data / "gait" / "HC030" / "straight.c3d")
    assert {"LKneeAngles", "CentreOfMass"} <= set(formats.computed_labels(recording))
    formats.write(tmp_path / "out.c3d", formats.without_computed(recording))
    after = open_c3d(tmp_path / "out.c3d")
    assert set(after.labels) == set(recording.labels)
    lists = [name for name in after.parameters.groups["POINT"] if name.startswith("ANGLES")]
    declared = {label for name in lists for label in after.parameters.strings("POINT", name)}
    assert not declared - set(after.labels) - {""}
    np.testing.assert_array_equal(formats.read(tmp_path / "out.c3d").positions, recording.positions)
    np.testing.assert_array_equal(after.analog, open_c3d(data / "gait" / "HC030" / "straight.c3d").analog)
