"""What came in goes out: C3D files survive reading and writing bit by bit, and new ones open elsewhere."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from asterism.errors import AsterismError
from asterism.formats import read, write
from asterism.formats.c3d._edit import integers_record
from asterism.formats.c3d._file import C3DFile, open_c3d
from asterism.formats.c3d._numbers import PC
from asterism.formats.c3d._parameters import make_group
from asterism.recording import Event, Labelling, Recording, is_unnamed

LABEL_PARAMETERS = ("LABELS", "LABELS2", "LABELS3", "DESCRIPTIONS", "DESCRIPTIONS2", "DESCRIPTIONS3", "USED", "DATA_START")


def real_files(data: Path) -> list[Path]:
    odd = sorted(path for path in (data / "conformance" / "c3d").rglob("*") if path.suffix.lower() == ".c3d")
    return [*odd, *sorted((data / "gait").rglob("*.c3d")), *sorted((data / "movement" / "clinical-lower").glob("*.c3d"))]


def parameters(file: C3DFile, but: tuple[str, ...] = ()) -> dict[tuple[str, str], tuple[int, tuple[int, ...], bytes]]:
    found = {}
    for group, names in file.parameters.groups.items():
        for name in names:
            record = file.parameters.find(group, name)
            if record is not None and not (group == "POINT" and name in but):
                found[group, name] = (record.kind, record.dimensions, record.data)
    return found


def everything_but_points_is_equal(before: C3DFile, after: C3DFile) -> None:
    now = parameters(after, LABEL_PARAMETERS)
    now.pop(("ASTERISM", "LOG"), None)
    assert now == parameters(before, LABEL_PARAMETERS)
    assert np.array_equal(after.words[:, 4 * after.layout.points :], before.words[:, 4 * before.layout.points :]), "analog samples"
    assert (after.rate, after.processor, after.layout.real, after.layout.frames) == (
        before.rate,
        before.processor,
        before.layout.real,
        before.layout.frames,
    )
    assert after.header.first_frame == before.header.first_frame
    assert after.header.events == before.header.events
    assert after.raw[24:512] == before.raw[24:512]


def column(file: C3DFile, label: str) -> np.ndarray:
    (place,) = (place for place, name in enumerate(file.labels) if name.rpartition(":")[2] == label)
    return file.point_words[:, place]


def some(frames: int, points: int, seed: int = 0) -> Recording:
    rng = np.random.default_rng(seed)
    positions = rng.normal(loc=(0, 0, 1), scale=0.5, size=(frames, points, 3))
    positions[rng.random((frames, points)) < 0.1] = np.nan
    return Recording(positions, tuple(f"M{i}" for i in range(points)), 120.0)


def test_an_unchanged_file_comes_out_byte_for_byte(data: Path, tmp_path: Path) -> None:
    for path in real_files(data):
        write(tmp_path / "out.c3d", read(path, vertical="z"))
        assert (tmp_path / "out.c3d").read_bytes() == path.read_bytes(), path


def test_a_recording_travels_to_another_process_whole(data: Path, tmp_path: Path) -> None:
    path = data / "gait/HC002/straight.c3d"
    parcel = pickle.dumps(read(path).source)
    assert len(parcel) < 1.01 * path.stat().st_size, "the bytes are enough"
    write(tmp_path / "out.c3d", replace(read(path), source=pickle.loads(parcel)))
    assert (tmp_path / "out.c3d").read_bytes() == path.read_bytes()


def test_swapped_labels_carry_their_samples_bit_by_bit(data: Path, tmp_path: Path) -> None:
    for name in ("gait/HC002/straight.c3d", "conformance/c3d/sample_03/gait-raw.c3d"):
        recording = read(data / name)
        swapped = {"LKNE": "RKNE", "RKNE": "LKNE"}
        write(tmp_path / "out.c3d", replace(recording, labels=tuple(swapped.get(label, label) for label in recording.labels)))
        before, after = open_c3d(data / name), open_c3d(tmp_path / "out.c3d")
        assert after.labels == before.labels
        assert np.array_equal(column(after, "LKNE"), column(before, "RKNE"))
        assert np.array_equal(column(after, "RKNE"), column(before, "LKNE"))
        assert not np.array_equal(column(after, "RKNE"), column(after, "LKNE"))
        assert np.array_equal(column(after, "LTOE"), column(before, "LTOE"))
        everything_but_points_is_equal(before, after)


def test_longer_names_and_more_points_move_the_data_and_nothing_else(data: Path, tmp_path: Path) -> None:
    tried = 0
    for path in real_files(data)[:34:3]:
        recording = read(path, vertical="z")
        # A point that gets a name moves before those without.
        if any(is_unnamed(label) for label in recording.labels):
            continue
        tried += 1
        count = len(recording.labels)
        grown = replace(
            recording,
            positions=np.concatenate([recording.positions, recording.positions[:, :1] + 0.01], axis=1),
            labels=(*(f"a much longer name of a marker, number {i}" for i in range(count)), "one more"),
            origin=None if recording.origin is None else np.pad(recording.origin, ((0, 0), (0, 1)), constant_values=-1),
        )
        write(tmp_path / "out.c3d", grown)
        before, after = open_c3d(path), open_c3d(tmp_path / "out.c3d")
        assert after.layout.points == before.layout.points + 1, path
        assert np.array_equal(after.point_words[:, :-1], before.point_words), path
        again = read(tmp_path / "out.c3d", vertical="z", markers=grown.labels)
        step = 1e-5 if before.layout.real else before.scale * recording.metadata["metres_per_unit"]
        np.testing.assert_allclose(again.positions, grown.positions, atol=step, err_msg=str(path))
        assert parameters(after, LABEL_PARAMETERS) == parameters(before, LABEL_PARAMETERS) or "cut" in str(before.findings), path
        assert np.array_equal(after.words[:, 4 * after.layout.points :], before.words[:, 4 * before.layout.points :]), path


def test_points_that_were_not_read_survive(data: Path, tmp_path: Path) -> None:
    path = data / "gait/HC002/straight.c3d"
    recording = read(path, markers=("LKNE", "RKNE"))
    write(tmp_path / "out.c3d", replace(recording, positions=recording.positions + 0.001))
    before, after = open_c3d(path), open_c3d(tmp_path / "out.c3d")
    assert after.labels == before.labels
    for label in ("LHipAngles", "PELO", "CentreOfMass", "LTOE"):
        assert np.array_equal(column(after, label), column(before, label)), label
    moved = after.coordinates[:, after.labels.index("LKNE")] - before.coordinates[:, before.labels.index("LKNE")]
    np.testing.assert_allclose(moved, 1.0, atol=1e-3)
    everything_but_points_is_equal(before, after)


def test_labelling_loses_no_sample(data: Path, tmp_path: Path) -> None:
    path = data / "conformance/c3d/sample_03/gait-raw.c3d"
    recording = read(path)
    clouds = recording.clouds()
    indices = np.full((len(clouds), 3), -1)
    for marker, label in enumerate(("SACR", "LASI", "RASI")):
        for frame in range(0, len(clouds), 2):
            here = clouds.columns[clouds.offsets[frame] : clouds.offsets[frame + 1]]
            found = np.nonzero(here == recording.labels.index(label))[0]
            indices[frame, marker] = found[0] if len(found) else -1
    labelled = recording.with_labelling(Labelling(indices, np.ones(indices.shape), ("SACR", "LASI", "RASI")))
    write(tmp_path / "out.c3d", labelled)
    before, after = open_c3d(path), open_c3d(tmp_path / "out.c3d")
    everything_but_points_is_equal(before, after)
    assert [step.action for step in read(tmp_path / "out.c3d").log] == ["labelled"]
    for frame in range(before.layout.frames):
        there = {
            words.tobytes() for words, x in zip(before.point_words[frame], before.coordinates[frame], strict=True) if np.isfinite(x[0])
        }
        kept = {words.tobytes() for words, x in zip(after.point_words[frame], after.coordinates[frame], strict=True) if np.isfinite(x[0])}
        assert kept == there, f"frame {frame}"
    assert np.isnan(after.coordinates[1::2, after.labels.index("SACR")]).all(), "odd frames were not labelled"
    again = read(tmp_path / "out.c3d")
    assert again.visible.sum() == recording.visible.sum()


def test_unnamed_points_get_names_that_are_free(data: Path, tmp_path: Path) -> None:
    path = data / "conformance/c3d/sample_32/vicon_zerowire.c3d"
    recording = read(path, markers=("LKNE", "RKNE"))
    kept = open_c3d(path).labels
    clash = next(label for label in kept if label.startswith("*"))
    write(tmp_path / "out.c3d", replace(recording, labels=("LKNE", clash)))
    labels = open_c3d(tmp_path / "out.c3d").labels
    assert len(set(labels)) == len(labels) == len(kept)
    with pytest.raises(AsterismError, match="twice"):
        write(tmp_path / "out.c3d", replace(recording, labels=("LKNE", "LASI")))
    write(tmp_path / "out.c3d", replace(recording, labels=("左膝", "右膝")))
    assert {"左膝", "右膝"} < set(open_c3d(tmp_path / "out.c3d").labels)


def test_a_point_beyond_the_integers_of_a_file_is_refused(data: Path, tmp_path: Path) -> None:
    recording = read(data / "conformance/c3d/sample_02/pc_int.c3d")
    far = recording.positions.copy()
    far[5, 2] = [0.0, 0.0, 50.0]
    with pytest.raises(AsterismError, match="further than the integers"):
        write(tmp_path / "out.c3d", replace(recording, positions=far))
    assert not (tmp_path / "out.c3d").exists()
    far[5, 2] = [0.1, 0.2, 0.3]
    write(tmp_path / "out.c3d", replace(recording, positions=far))
    step = open_c3d(tmp_path / "out.c3d").scale / 1000
    np.testing.assert_allclose(read(tmp_path / "out.c3d").positions[5, 2], [0.1, 0.2, 0.3], atol=step)


def test_lost_and_found_samples_are_written_as_the_file_writes_them(data: Path, tmp_path: Path) -> None:
    for name in ("sample_16/golf.c3d", "sample_02/dec_real.c3d", "sample_02/sgi_int.c3d", "sample_13/Dance1.c3d"):
        recording = read(data / "conformance/c3d" / name, vertical="z")
        changed = recording.positions.copy()
        changed[10, 1] = np.nan
        changed[11, 1] = np.nanmean(changed[:, 1], axis=0)
        write(tmp_path / "out.c3d", replace(recording, positions=changed))
        again = read(tmp_path / "out.c3d", vertical="z")
        assert np.array_equal(again.visible, ~np.isnan(changed[:, :, 0])), name
        step = 1e-6 if again.source.layout.real else again.source.scale * recording.metadata["metres_per_unit"]
        np.testing.assert_allclose(again.positions, changed, atol=step, err_msg=name)


def test_new_events_replace_the_old_ones(data: Path, tmp_path: Path) -> None:
    events = tuple(Event("Foot Strike", 0.25 * i, "Left" if i % 2 else "Right") for i in range(300))
    for name in ("gait/HC002/straight.c3d", "conformance/c3d/sample_02/sgi_real.c3d", "conformance/c3d/sample_20/phasespace_sample.c3d"):
        recording = read(data / name)
        write(tmp_path / "out.c3d", replace(recording, events=events))
        again = read(tmp_path / "out.c3d")
        assert again.events == events, name
        np.testing.assert_array_equal(again.positions, recording.positions)


def test_a_corrected_rate_reaches_the_file(data: Path, tmp_path: Path) -> None:
    recording = read(data / "gait/HC002/straight.c3d")
    write(tmp_path / "out.c3d", replace(recording, rate=200.0))
    file = open_c3d(tmp_path / "out.c3d")
    assert (file.rate, file.header.rate, file.parameters.number("ANALOG", "RATE")) == (200.0, 200.0, 2000.0)
    assert np.array_equal(file.words, open_c3d(data / "gait/HC002/straight.c3d").words)


def test_other_frames_than_the_file_has_are_refused(data: Path, tmp_path: Path) -> None:
    recording = read(data / "gait/HC002/static.c3d")
    short = replace(recording, positions=recording.positions[:-1], origin=None)
    with pytest.raises(AsterismError, match="frames"):
        write(tmp_path / "out.c3d", short)
    write(tmp_path / "out.c3d", recording.frames(slice(0, 10)))
    assert len(read(tmp_path / "out.c3d")) == 10


@pytest.mark.parametrize(("frames", "points"), [(1, 1), (10, 5), (7, 255), (7, 256), (3, 600), (65535, 1), (65536, 1), (70001, 2)])
def test_a_new_file_opens_elsewhere_with_equal_content(tmp_path: Path, frames: int, points: int) -> None:
    # that nothing is seen in a file is a finding of its own
    positions = some(frames, points).positions if frames * points > 1 else np.ones((1, 1, 3))
    recording = replace(some(frames, points), positions=positions, vertical=np.array([0.0, 1.0, 0.0]), metadata={"subject": "Ann"})
    path = tmp_path / "new.c3d"
    write(path, recording)
    other = ezc3d.c3d(str(path))
    np.testing.assert_allclose(other["data"]["points"][:3].transpose(2, 1, 0), recording.positions * 1000, rtol=1e-6, atol=1e-3)
    stated = other["parameters"]["POINT"]
    pages = ["LABELS", *(f"LABELS{page}" for page in range(2, 2 + (points - 1) // 255))]
    assert [label for page in pages for label in stated[page]["value"]] == list(recording.labels)
    assert (stated["RATE"]["value"][0], stated["UNITS"]["value"], stated["Y_SCREEN"]["value"]) == (120.0, ["mm"], ["+Y"])
    if frames <= 10:
        with path.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            third = np.array([block for _, block, _ in c3d.Reader(stream).read_frames(copy=True)])
        third = np.where(third[:, :, 3:4] < 0, np.nan, third[:, :, :3])
        np.testing.assert_allclose(third, recording.positions * 1000, rtol=1e-6, atol=1e-3)
    # points that are everywhere are no body, and may look like one that stands otherwise
    again = read(path, vertical="y")
    np.testing.assert_allclose(again.positions, recording.positions, rtol=1e-6, atol=1e-6)
    assert (again.labels, again.rate, again.metadata["subject"], again.metadata.get("findings")) == (recording.labels, 120.0, "Ann", None)


@pytest.mark.parametrize("vertical", [(0, 0, 1), (0, -1, 0), (1, 0, 0), (0.1, 0.2, 0.9)])
def test_a_new_file_keeps_its_vertical(tmp_path: Path, vertical: tuple[float, float, float]) -> None:
    recording = replace(some(5, 4), vertical=np.array(vertical, dtype=float) / np.linalg.norm(vertical))
    write(tmp_path / "new.c3d", recording)
    np.testing.assert_allclose(read(tmp_path / "new.c3d").vertical, recording.vertical, atol=1e-6)


coordinates = st.floats(-12, 12, width=32) | st.just(np.nan)
labels = st.text(st.characters(codec="utf-8", categories=("L", "N")), min_size=1, max_size=12)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(positions=hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 5), st.just(3)), elements=coordinates), drawn=st.data())
def test_whatever_is_written_new_comes_back(tmp_path: Path, positions: np.ndarray, drawn: st.DataObject) -> None:
    names = drawn.draw(st.lists(labels, min_size=positions.shape[1], max_size=positions.shape[1], unique=True))
    body = np.tile(np.array([[[0.0, 0, 0.1], [0.2, 0.1, 1.0], [0, 0, 1.7]]]), (len(positions), 1, 1))
    events = tuple(Event("E", float(np.float32(t)), "Left") for t in drawn.draw(st.lists(st.integers(0, 59), max_size=3)))
    recording = Recording(np.concatenate([positions, body], axis=1), (*names, "B.1", "B.2", "B.3"), 50.0, events=events)
    write(tmp_path / "new.c3d", recording)
    again = read(tmp_path / "new.c3d", vertical="z")
    assert tuple(again.source.labels) == recording.labels
    written = again.source.coordinates / 1000
    np.testing.assert_allclose(written, recording.positions, rtol=1e-6, atol=1e-9)
    assert (again.events, len(again)) == (events, len(recording))


def test_a_block_behind_the_data_is_still_found_where_its_parameter_says(tmp_path: Path) -> None:
    write(tmp_path / "plain.c3d", replace(some(20, 4), metadata={"subject": "Ann " * 25}))
    file = open_c3d(tmp_path / "plain.c3d")
    block = len(file.raw) // 512 + 1
    records = {
        ("", "ROTATION"): make_group("ROTATION", 20, processor=PC),
        ("ROTATION", "DATA_START"): integers_record("DATA_START", 20, [block], (), PC),
    }
    section = file.parameters.replaced(records).to_bytes().ljust(file.layout.start - 512, b"\0")
    assert len(section) == file.layout.start - 512
    rotations = bytes(range(1, 256)) * 4
    (tmp_path / "rotations.c3d").write_bytes(file.raw[:512] + section + file.raw[file.layout.start :] + rotations)
    recording = read(tmp_path / "rotations.c3d")
    assert recording.positions.shape == (20, 4, 3)
    more = replace(
        recording,
        positions=np.concatenate([recording.positions, recording.positions + 1], axis=1),
        labels=(*recording.labels, *("a very long name of a marker " + "x" * i for i in range(4))),
        origin=None,
    )
    write(tmp_path / "out.c3d", more)
    after = open_c3d(tmp_path / "out.c3d")
    moved = after.parameters.count("ROTATION", "DATA_START")
    assert moved is not None and moved > block
    assert after.raw[(moved - 1) * 512 :] == rotations
    np.testing.assert_allclose(read(tmp_path / "out.c3d").positions, more.positions, atol=1e-6)


@pytest.mark.parametrize("padded", [True, False], ids=["padded", "ends with its last frame"])
def test_a_grown_file_is_padded_to_whole_blocks_if_it_was(tmp_path: Path, padded: bool) -> None:
    write(tmp_path / "plain.c3d", some(20, 4))
    file = open_c3d(tmp_path / "plain.c3d")
    frames_only = bytes(file.raw[: file.layout.stop])
    assert len(frames_only) % 512
    (tmp_path / "in.c3d").write_bytes(frames_only + bytes(-len(frames_only) % 512) if padded else frames_only)
    recording = read(tmp_path / "in.c3d", vertical="z")
    positions = np.concatenate([recording.positions, recording.positions[:, :1] + 1], axis=1)
    write(tmp_path / "out.c3d", replace(recording, positions=positions, labels=(*recording.labels, "MORE"), origin=None))
    after = open_c3d(tmp_path / "out.c3d")
    assert after.layout.stop % 512
    assert len(after.raw) == (-(-after.layout.stop // 512) * 512 if padded else after.layout.stop)


def test_thousands_of_points_with_long_names(tmp_path: Path) -> None:
    recording = replace(some(2, 4000), labels=tuple(f"a name as long as names go in real files {i}" for i in range(4000)))
    write(tmp_path / "many.c3d", recording)
    again = read(tmp_path / "many.c3d")
    assert again.labels == recording.labels
    np.testing.assert_allclose(again.positions, recording.positions, rtol=1e-6, atol=1e-6)


def test_no_points_and_no_frames_are_refused(tmp_path: Path) -> None:
    for empty in (some(3, 0), some(0, 3)):
        with pytest.raises(AsterismError, match=r"new\.c3d.*no (points|frames)"):
            write(tmp_path / "new.c3d", empty)
    with pytest.raises(AsterismError, match="longer than"):
        write(tmp_path / "new.c3d", replace(some(3, 1), labels=("x" * 200,)))


def test_markers_that_got_their_names_come_in_the_order_of_the_set_and_unnamed_points_last(tmp_path: Path) -> None:
    positions = np.random.default_rng(3).normal(loc=(0.0, 0.0, 1.0), scale=0.1, size=(30, 5, 3))
    write(tmp_path / "raw.c3d", Recording(positions, ("*1", "*2", "*3", "*4", "*5"), 120.0))
    raw = read(tmp_path / "raw.c3d", vertical="z")
    clouds = raw.clouds()
    indices = np.full((len(raw), 3), -1)
    # Points of a frame are in the order of their columns: the set's first marker is the last of them.
    indices[:, 0], indices[:, 2] = clouds.counts - 1, clouds.counts - 3
    labelled = raw.with_labelling(Labelling(indices, np.where(indices >= 0, 1.0, 0.0), ("SACR", "LKNE", "RKNE")))
    write(tmp_path / "labelled.c3d", labelled)
    after = read(tmp_path / "labelled.c3d", vertical="z")
    assert after.labels[:3] == ("SACR", "LKNE", "RKNE") and all(label.startswith("*") for label in after.labels[3:])
    np.testing.assert_array_equal(after.positions[:, :3], labelled.positions[:, :3])
