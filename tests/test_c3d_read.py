"""C3D files of all vendors come in right: against two other readers, against each other, and against known truth."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.formats import describe, read, write
from asterism.formats.c3d._edit import integers_record
from asterism.formats.c3d._file import C3DFile, open_c3d
from asterism.formats.c3d._parameters import Record, make_group
from asterism.recording import Event, Recording

EZC3D_IS_WRONG = {
    "giant.c3d": "every residual is -1, though the coordinates are there",
    "golf.c3d": "every residual is -1, though the coordinates are there",
    "kyowadengyo.c3d": "POINT:USED says 12, but only 11 points of 152 frames fill the file to its last block",
}
EZC3D_TAKES_A_MINUTE_TO_REFUSE = {"bad_parameter_section.c3d", "BKINtechnologies.c3d"}
C3D_IS_WRONG = {
    "giant.c3d": "every residual is -1, though the coordinates are there",
    "golf.c3d": "every residual is -1, though the coordinates are there",
    "admarche2.c3d": "calls every point missing, ezc3d calls none of these missing",
    "Dance.c3d": "takes the general scale -1 of the analog channels without its sign, ezc3d with it",
    "Dance1.c3d": "takes the general scale -1 of the analog channels without its sign, ezc3d with it",
}


def conformance(data: Path) -> list[Path]:
    return sorted(path for path in (data / "conformance" / "c3d").rglob("*") if path.suffix.lower() == ".c3d")


def some_files(data: Path) -> list[Path]:
    """All odd ones, and from every set of bodies one file."""
    bodies = [next(iter(sorted(folder.rglob("*.c3d"))), None) for folder in sorted((data / "movement").iterdir()) if folder.is_dir()]
    return [*conformance(data), *(path for path in bodies if path), data / "gait" / "HC002" / "static.c3d"]


def walk(frames: int = 20, rate: float = 100.0) -> Recording:
    """Five markers of a person as tall as 1.7 m who walks along x at 1 m/s, straight up and down along z."""
    names = ("LHEE", "LKNE", "LASI", "C7", "RFHD")
    positions = np.zeros((frames, 5, 3))
    positions[:, :, 2] = [0.05, 0.5, 0.95, 1.45, 1.7]
    positions[:, :, 0] = np.arange(frames)[:, None] / rate + [0.1, 0.2, 0.3, 0.25, 0.3]
    positions[:, :, 1] = [0.1, 0.12, 0.15, 0.02, -0.06]
    return Recording(positions, names, rate)


def opened_by_ezc3d(path: Path) -> ezc3d.c3d | None:
    try:
        opened = ezc3d.c3d(str(path))
    except Exception:
        return None
    return opened if opened["data"]["points"].shape[2] else None


def opened_by_c3d(path: Path) -> tuple[c3d.Reader, list[tuple[np.ndarray, np.ndarray]]] | None:
    try:
        with path.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader = c3d.Reader(stream)
            frames = [(points, analog) for _, points, analog in reader.read_frames(copy=True)]
    except Exception:
        return None
    return (reader, frames) if frames else None


def differences(file: C3DFile, positions: np.ndarray, analog: np.ndarray, rate: float) -> list[str]:
    found = []
    if positions.shape != file.coordinates.shape:
        return [f"{positions.shape} points, ours {file.coordinates.shape}"]
    missing, ours = np.isnan(positions).any(axis=2), np.isnan(file.coordinates).any(axis=2)
    if (missing != ours).any():
        found.append(f"{(missing != ours).sum()} samples missing in one only")
    both = ~missing & ~ours
    if both.any() and not np.allclose(positions[both], file.coordinates[both], rtol=1e-6, atol=1e-6):
        found.append("other coordinates")
    if analog.size and (analog.shape != file.analog.shape or not np.allclose(analog, file.analog, rtol=1e-5, atol=1e-8, equal_nan=True)):
        found.append("other analog samples")
    if rate != file.rate:
        found.append(f"rate {rate}, ours {file.rate}")
    return found


def test_every_odd_file_opens(data: Path) -> None:
    files = conformance(data)
    assert len(files) == 26
    refused = {}
    for path in files:
        try:
            recording = read(path)
            assert recording.visible.any(), f"{path} has no visible point"
        except AsterismError as problem:
            refused[path.name] = str(problem)
    assert refused == {}


def test_whatever_ezc3d_reads_comes_out_equal(data: Path) -> None:
    compared, wrong = 0, {}
    for path in some_files(data):
        other = None if path.name in EZC3D_TAKES_A_MINUTE_TO_REFUSE else opened_by_ezc3d(path)
        if other is None:
            continue
        compared += 1
        file = open_c3d(path)
        analog = other["data"]["analogs"][0].T
        found = differences(file, other["data"]["points"][:3].transpose(2, 1, 0), analog, other["parameters"]["POINT"]["RATE"]["value"][0])
        points = other["parameters"]["POINT"]
        labels = [label.strip() for key in ("LABELS", "LABELS2") if key in points for label in points[key]["value"]][: file.layout.points]
        if not found and any(
            ours not in (label, f"*{place + 1}") for place, (label, ours) in enumerate(zip(labels, file.labels, strict=False))
        ):
            found.append("other labels")
        if found:
            wrong[path.name] = found
    assert compared >= 25
    assert set(wrong) == set(EZC3D_IS_WRONG), wrong


def test_whatever_the_package_c3d_reads_comes_out_equal(data: Path) -> None:
    compared, wrong = 0, {}
    for path in conformance(data):
        other = opened_by_c3d(path)
        if other is None:
            continue
        compared += 1
        reader, frames = other
        points = np.array([points for points, _ in frames])
        positions = np.where((points[:, :, 3:4] < 0) | ~np.isfinite(points[:, :, :3]), np.nan, points[:, :, :3])
        found = differences(open_c3d(path), positions, np.concatenate([analog.T for _, analog in frames]), reader.point_rate)
        if found:
            wrong[path.name] = found
    assert compared >= 22
    assert set(wrong) == set(C3D_IS_WRONG), wrong


def test_the_file_of_kyowa_is_filled_by_eleven_points(data: Path) -> None:
    file = open_c3d(data / "conformance/c3d/sample_27/kyowadengyo.c3d")
    assert (file.layout.points, file.layout.frames, file.analog_channels) == (11, 152, 24)
    assert len(file.raw) - file.layout.stop < 512
    steps = np.linalg.norm(np.diff(file.coordinates, axis=0), axis=2)
    assert np.nanmax(steps) < 120, f"a marker jumps {np.nanmax(steps):.0f} mm from one frame to the next"


def test_six_encodings_of_one_trial_are_equal_to_rounding(data: Path) -> None:
    files = {path.stem: open_c3d(path) for path in sorted((data / "conformance/c3d/sample_02").glob("*.c3d"))}
    assert {(f.processor.name, f.layout.real) for f in files.values()} == {(p, r) for p in ("PC", "DEC", "SGI") for r in (True, False)}
    truth = files["pc_real"]
    for name, file in files.items():
        assert np.array_equal(np.isnan(file.coordinates), np.isnan(truth.coordinates)), name
        worst = np.nanmax(np.abs(file.coordinates - truth.coordinates))
        assert worst <= 1.0001 * truth.scale, f"{name}: {worst:.3f} mm, one step is {truth.scale:.3f} mm"
        if file.layout.real:
            assert worst == 0.0, name
        assert np.array_equal(file.analog, truth.analog), name
        assert (file.labels, file.rate) == (truth.labels, truth.rate), name


def test_files_whose_residuals_are_all_negative_are_read_all_the_same(data: Path) -> None:
    recording = read(data / "conformance/c3d/sample_16/golf.c3d")
    assert recording.visible.all()
    assert "m" in recording.metadata["units"]
    assert 1.2 < np.ptp(recording.positions[:, :, 2]) < 2.5
    giant = read(data / "conformance/c3d/sample_16/giant.c3d")
    assert not giant.visible[:, 24].any(), "-1e9 is no place"


def test_vertical_is_z_where_qualisys_writes_minus_z(data: Path) -> None:
    path = data / "movement/qtm-fullbody/lem_static.c3d"
    assert open_c3d(path).parameters.text("POINT", "Y_SCREEN") == "-Z"
    recording = read(path)
    assert recording.vertical.tolist() == [0, 0, 1]
    heads = [place for place, label in enumerate(recording.labels) if label in ("HV", "OCC")]
    assert np.nanmean(recording.positions[:, heads, 2]) > 1.2


def test_a_vertical_that_is_given_wins(data: Path) -> None:
    path = data / "gait/HC002/static.c3d"
    assert read(path).vertical.tolist() == [0, 0, 1]
    assert read(path, vertical="-y").vertical.tolist() == [0, -1, 0]


def test_a_subjects_prefix_is_taken_off_and_remembered(data: Path) -> None:
    recording = read(data / "movement/cmu41/02_01_walk.c3d")
    assert "LKNE" in recording.labels
    assert recording.metadata["subject"] == "TakeoMonday"


def test_a_marker_set_gives_exactly_its_columns(data: Path) -> None:
    path = data / "gait/HC002/straight.c3d"
    wanted = ("RASI", "LKNE", "NOWHERE")
    recording = read(path, markers=wanted)
    assert recording.labels == wanted
    assert not recording.visible[:, 2].any()
    everything = read(path)
    np.testing.assert_array_equal(recording.positions[:, 1], everything.positions[:, everything.labels.index("LKNE")])
    with pytest.raises(AsterismError, match=r"straight\.c3d.*NOWHERE"):
        read(path, markers=("NOWHERE",))


def test_events_carry_side_and_time(data: Path) -> None:
    recording = read(data / "gait/HC002/straight.c3d")
    assert {(event.label, event.context) for event in recording.events} <= {
        (a, b) for a in ("Foot Strike", "Foot Off") for b in ("Left", "Right")
    }
    first, rate = recording.first_frame, recording.rate
    assert all((first - 1) / rate - 0.5 <= event.time <= (first - 1 + len(recording)) / rate + 0.5 for event in recording.events)
    header = read(data / "conformance/c3d/sample_02/pc_real.c3d")
    assert [event.label for event in header.events][:2] == ["RHS", "STRT"]


def test_metres_millimetres_and_no_units_give_the_same_body(data: Path) -> None:
    for name in (
        "movement/optitrack-lower/skeleton20/jog_001.c3d",
        "gait/HC002/static.c3d",
        "conformance/c3d/sample_20/phasespace_sample.c3d",
    ):
        recording = read(data / name)
        middle = len(recording) // 2
        height = np.nanmax(recording.positions[middle, :, 2]) - np.nanmin(recording.positions[middle, :, 2])
        assert 0.6 < height < 2.2, f"{name}: {height} m"
    assert any("units" in finding.sentence for finding in recording.metadata["findings"])


def test_units_that_make_a_body_of_a_millimetre_are_refused(tmp_path: Path) -> None:
    recording = walk()
    write(tmp_path / "tiny.c3d", replace(recording, positions=recording.positions / 1000))
    with pytest.raises(AsterismError, match=r"tiny\.c3d.*units"):
        read(tmp_path / "tiny.c3d")


def test_zeros_mean_missing_only_where_a_file_cannot_say_it_otherwise(tmp_path: Path) -> None:
    recording = walk()
    positions = recording.positions.copy()
    positions[3, 1] = 0.0
    write(tmp_path / "ours.c3d", replace(recording, positions=positions))
    assert read(tmp_path / "ours.c3d").visible.all(), "we write missing with a residual, so our zeros are zeros"
    raw = (tmp_path / "ours.c3d").read_bytes().replace(b"Asterism", b"Somebody")
    (tmp_path / "theirs.c3d").write_bytes(raw)
    visible = read(tmp_path / "theirs.c3d").visible
    assert not visible[3, 1]
    assert visible.sum() == visible.size - 1


def test_a_float_that_is_no_number_is_missing(tmp_path: Path) -> None:
    write(tmp_path / "walk.c3d", walk())
    file = open_c3d(tmp_path / "walk.c3d")
    raw = bytearray(file.raw)
    at = file.layout.start + 4 * (4 * file.layout.points * 2 + 4)
    raw[at : at + 4] = np.float32(np.inf).tobytes()
    (tmp_path / "walk.c3d").write_bytes(raw)
    visible = read(tmp_path / "walk.c3d").visible
    assert not visible[2, 1]
    assert visible.sum() == visible.size - 1
    again = open_c3d(tmp_path / "walk.c3d")
    assert np.array_equal(again.coordinates_of(slice(1, 4), [2, 1]), again.coordinates[1:4, [2, 1]], equal_nan=True)


@pytest.mark.parametrize("name", ["pc_int", "dec_int", "sgi_int", "pc_real", "dec_real", "sgi_real"])
def test_without_any_scale_the_length_of_the_file_tells_integers_from_floats(data: Path, tmp_path: Path, name: str) -> None:
    file = open_c3d(data / f"conformance/c3d/sample_02/{name}.c3d")
    raw, record = bytearray(file.raw), file.parameters.find("POINT", "SCALE")
    assert record is not None
    at = raw.find(record.raw) + record.raw.find(record.data)
    raw[12:16] = raw[at : at + 4] = bytes(4)
    (tmp_path / "unscaled.c3d").write_bytes(raw)
    bare = open_c3d(tmp_path / "unscaled.c3d")
    assert bare.layout == file.layout
    assert np.array_equal(bare.words, file.words)


def with_last(file: C3DFile, records: dict[tuple[str, str], Record | None], behind: bytes = b"") -> bytes:
    """The bytes of a file with more parameters and, up to its data, something behind the last of them."""
    section = file.parameters.replaced(records).to_bytes()[:-2] + behind
    room = file.layout.start - file.header.parameters_at
    assert len(section) <= room
    return bytes(file.raw[: file.header.parameters_at]) + section.ljust(room, b"\0") + bytes(file.raw[file.layout.start :])


@pytest.mark.parametrize("values", [[7], [7, 0], []], ids=["one word", "two words", "none"])
def test_a_first_frame_is_taken_from_the_trial_only_where_both_its_words_are_there(tmp_path: Path, values: list[int]) -> None:
    write(tmp_path / "walk.c3d", walk())
    file = open_c3d(tmp_path / "walk.c3d")
    group = file.parameters.group_id("TRIAL")
    assert group is not None
    words = integers_record("ACTUAL_START_FIELD", group, values, (len(values),), file.processor)
    end = integers_record("ACTUAL_END_FIELD", group, [26, 0], (2,), file.processor)
    records = {("TRIAL", "ACTUAL_START_FIELD"): words, ("TRIAL", "ACTUAL_END_FIELD"): end}
    (tmp_path / "walk.c3d").write_bytes(with_last(file, records))
    recording = read(tmp_path / "walk.c3d")
    assert len(recording) == 20
    assert recording.first_frame == (7 if len(values) == 2 else file.header.first_frame)


def ended_by(record: Record) -> bytes:
    """The bytes of a group or parameter that says it is the last of its file."""
    at = 2 + len(record.name)
    return record.raw[:at] + bytes(2) + record.raw[at + 2 :]


@pytest.mark.parametrize("last", ["group", "parameter"])
def test_nothing_is_read_behind_the_record_that_says_it_is_the_last(tmp_path: Path, last: str) -> None:
    write(tmp_path / "walk.c3d", walk())
    file = open_c3d(tmp_path / "walk.c3d")
    notes = make_group("NOTES", 60, processor=file.processor)
    count, leftover = (integers_record(name, 60, [3], (), file.processor) for name in ("COUNT", "LEFTOVER"))
    behind = (ended_by(notes) if last == "group" else notes.raw + ended_by(count)) + leftover.raw
    (tmp_path / "walk.c3d").write_bytes(with_last(file, {("MANUFACTURER", "VERSION_LABEL"): None}, behind))
    assert open_c3d(tmp_path / "walk.c3d").parameters.groups["NOTES"] == (["COUNT"] if last == "parameter" else [])
    assert "findings" not in read(tmp_path / "walk.c3d").metadata


def test_parameters_follow_a_group_that_was_the_last_record_of_its_file(tmp_path: Path) -> None:
    write(tmp_path / "walk.c3d", walk())
    file = open_c3d(tmp_path / "walk.c3d")
    last = ended_by(make_group("EVENT", 60, "marked by hand", processor=file.processor))
    (tmp_path / "walk.c3d").write_bytes(with_last(file, {("MANUFACTURER", "VERSION_LABEL"): None}, last))
    events = (Event("Foot Strike", 0.0625, "Left"), Event("Foot Off", 0.125, "Right"))
    write(tmp_path / "out.c3d", replace(read(tmp_path / "walk.c3d"), events=events))
    again = read(tmp_path / "out.c3d")
    assert again.events == events
    assert "findings" not in again.metadata
    (group,) = (record for record in open_c3d(tmp_path / "out.c3d").parameters.records if record.name == "EVENT")
    assert group.raw.endswith(b"marked by hand")


def test_description_names_what_is_there(data: Path) -> None:
    told = describe(data / "gait/HC002/straight.c3d")
    assert (told["frames"], told["rate"], told["encoding"], told["units"]) == (222, 100.0, "PC real", "mm")
    assert (told["analog"]["channels"], told["analog"]["rate"]) == (24, 1000.0)
    assert len(told["points"]["physical"]) == 59
    assert {"LHipAngles", "PELO", "LHJC", "CentreOfMass"} <= set(told["points"]["computed"])
    assert told["parameters"]["POINT"] > 20
    broken = describe(data / "conformance/c3d/sample_18/bad_parameter_section.c3d")
    assert any("cut" in finding.sentence for finding in broken["findings"])


def test_an_event_keeps_its_minutes(tmp_path: Path) -> None:
    events = (Event("Foot Strike", 0.5, "Left"), Event("Foot Off", 61.25, "Right"), Event("General", 3600.0, ""))
    write(tmp_path / "walk.c3d", replace(walk(), events=events))
    assert read(tmp_path / "walk.c3d").events == events
