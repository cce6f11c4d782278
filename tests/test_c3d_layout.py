"""Where the header, the parameters and the length of a C3D file contradict each other: what is read is right, or a finding says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from asterism.cli import main
from asterism.errors import AsterismError, NoMarkers
from asterism.findings import Finding, Severity
from asterism.formats import describe, read, write
from asterism.formats.c3d._edit import floats_record, integers_record, strings_record
from asterism.formats.c3d._file import C3DFile, open_c3d
from asterism.formats.c3d._numbers import PC
from asterism.formats.c3d._parameters import Record, make_group
from asterism.recording import Event, Recording
from asterism.recording.arrays import missing_codes

BLOCK = 512
NAMES = ("RASI", "LASI", "SACR", "RKNE", "LKNE", "RANK", "LANK", "RHEE", "LHEE", "RTOE", "LTOE")
HEIGHTS = np.array([0.95, 0.95, 0.97, 0.5, 0.5, 0.1, 0.1, 0.05, 0.05, 0.04, 0.04])


def walk(frames: int = 60, points: int = len(NAMES), first_frame: int = 1, events: tuple[Event, ...] = ()) -> Recording:
    """Markers of a person who walks along x at 1 m/s; each swings by 10 mm in its own time, so that none is computed from others."""
    place, time = np.arange(points) % len(NAMES), np.arange(frames)[:, None]
    swing = 0.01 * np.sin(time[:, :, None] / (7.0 + np.arange(points)[:, None]) + np.arange(3))
    body = np.stack([0.1 * (place % 3), 0.1 * (-1.0) ** place, HEIGHTS[place]], axis=1)
    positions = swing + body + 0.01 * time[:, :, None] * [1.0, 0.0, 0.0]
    labels = NAMES if points == len(NAMES) else tuple(f"M{number}" for number in range(points))
    return Recording(positions, labels, 100.0, first_frame=first_frame, events=events)


def written(path: Path, recording: Recording) -> C3DFile:
    write(path, recording)
    return open_c3d(path)


def changed(file: C3DFile, words: dict[int, int] | None = None, records: dict[tuple[str, str], Record | None] | None = None) -> bytes:
    """The file's bytes with other words in the header, counted from 1, and other parameters. Another program's file: nothing trusts it."""
    head = bytearray(file.raw[: file.header.parameters_at])
    for word, value in (words or {}).items():
        head[2 * word - 2 : 2 * word] = (value & 0xFFFF).to_bytes(2, "little")
    room = file.layout.start - file.header.parameters_at
    section = file.parameters.replaced(records or {}).to_bytes().replace(b"Asterism", b"Somebody").ljust(room, b"\0")
    assert len(section) == room
    return bytes(head) + section + bytes(file.raw[file.layout.start :])


def integers(file: C3DFile, group: str, name: str, *values: int) -> dict[tuple[str, str], Record]:
    number = file.parameters.group_id(group)
    assert number is not None
    return {(group, name): integers_record(name, number, [value & 0xFFFF for value in values], (len(values),), PC)}


def floats(file: C3DFile, group: str, name: str, value: float) -> dict[tuple[str, str], Record]:
    number = file.parameters.group_id(group)
    assert number is not None
    return {(group, name): floats_record(name, number, [value], (), PC)}


def findings_of(recording: Recording) -> tuple[Finding, ...]:
    return tuple(recording.metadata.get("findings", ()))


def said(recording: Recording, words: str, severity: Severity | None = None) -> bool:
    return any(words in finding.sentence and severity in (None, finding.severity) for finding in findings_of(recording))


LONG = 66_000


@pytest.fixture(scope="module")
def long_by_ezc3d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """66,000 frames of two points, as ezc3d writes them: the header and POINT:FRAMES say 65,535."""
    path = tmp_path_factory.mktemp("ezc3d") / "long.c3d"
    points = np.ones((4, 2, LONG))
    points[:3] = 1000 * walk(LONG, 2).positions.transpose(2, 1, 0)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["A", "B"]
    file["data"]["points"] = points
    file.write(str(path))
    return path


def test_all_frames_of_a_long_recording_of_ezc3d_are_read(long_by_ezc3d: Path, tmp_path: Path) -> None:
    recording = read(long_by_ezc3d)
    np.testing.assert_allclose(recording.positions, walk(LONG, 2).positions, atol=1e-4)
    assert said(recording, "66000 by the length of the file", Severity.NOTE)
    named = replace(recording, labels=("RKNE", "LKNE"))
    write(tmp_path / "out.c3d", named)
    again = ezc3d.c3d(str(tmp_path / "out.c3d"))
    assert again["data"]["points"].shape == (4, 2, LONG)


@pytest.mark.parametrize("count", [LONG % 65536, -1, 65534 + 1, 0], ids=["wrapped", "-1", "limit", "zero"])
def test_frames_beyond_16_bits_are_those_of_the_length(count: int, tmp_path: Path) -> None:
    file = written(tmp_path / "long.c3d", walk(LONG, 3))
    records = {("POINT", "LONG_FRAMES"): None, ("TRIAL", "ACTUAL_START_FIELD"): None, ("TRIAL", "ACTUAL_END_FIELD"): None}
    (tmp_path / "long.c3d").write_bytes(changed(file, {4: 1, 5: count}, {**records, **integers(file, "POINT", "FRAMES", count)}))
    np.testing.assert_allclose(read(tmp_path / "long.c3d").positions, walk(LONG, 3).positions, atol=1e-4)


def test_padding_of_a_narrow_long_recording_is_no_frames(tmp_path: Path) -> None:
    file = written(tmp_path / "long.c3d", walk(LONG, 1))
    records = {("POINT", "LONG_FRAMES"): None, ("TRIAL", "ACTUAL_START_FIELD"): None, ("TRIAL", "ACTUAL_END_FIELD"): None}
    raw = changed(file, {}, records)
    # 16 bytes a frame: a whole block of padding would be 32 frames
    (tmp_path / "long.c3d").write_bytes(raw + bytes(-len(raw) % BLOCK))
    assert len(read(tmp_path / "long.c3d")) == LONG


@pytest.mark.parametrize("frames", [LONG, 300])
def test_rotations_behind_the_data_are_no_frames(frames: int, tmp_path: Path) -> None:
    file = written(tmp_path / "plain.c3d", replace(walk(frames, 3), metadata={"subject": "Ann " * 25}))
    data = bytes(file.raw[file.layout.start : file.layout.stop])
    data += bytes(-len(data) % BLOCK)
    block = (file.layout.start + len(data)) // BLOCK + 1
    records: dict[tuple[str, str], Record | None] = {
        ("POINT", "LONG_FRAMES"): None,
        ("TRIAL", "ACTUAL_START_FIELD"): None,
        ("TRIAL", "ACTUAL_END_FIELD"): None,
        ("", "ROTATION"): make_group("ROTATION", 20, processor=PC),
        ("ROTATION", "USED"): integers_record("USED", 20, [2], (), PC),
        ("ROTATION", "DATA_START"): integers_record("DATA_START", 20, [block], (), PC),
    }
    raw = changed(file, {}, records)
    rotations = np.ones(frames * 2 * 17, dtype="<f4").tobytes()
    (tmp_path / "rotations.c3d").write_bytes(raw[: file.layout.start] + data + rotations)
    recording = read(tmp_path / "rotations.c3d")
    assert len(recording) == frames
    assert not said(recording, "not read")


def test_whole_frames_behind_the_declared_ones_are_told(tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk(200))
    counts = {**integers(file, "POINT", "FRAMES", 150), **integers(file, "TRIAL", "ACTUAL_END_FIELD", 150, 0)}
    (tmp_path / "walk.c3d").write_bytes(changed(file, {5: 150}, counts))
    recording = read(tmp_path / "walk.c3d")
    assert len(recording) == 150
    assert said(recording, "room for 50 more", Severity.WARNING)
    assert main(["info", str(tmp_path / "walk.c3d")]) == 1


@pytest.mark.parametrize("block", [-1, 1, 2, 40, 0], ids="{:+d}".format)
def test_a_start_that_does_not_fit_the_length_gives_way_to_the_other(block: int, tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk())
    start = file.layout.start // BLOCK + 1
    wrong = start + block if block else 0
    for words, records in (({9: wrong}, {}), ({}, integers(file, "POINT", "DATA_START", wrong))):
        (tmp_path / "off.c3d").write_bytes(changed(file, words, records))
        recording = read(tmp_path / "off.c3d")
        np.testing.assert_allclose(recording.positions, walk().positions, atol=1e-6)
        assert recording.labels == NAMES
        assert said(recording, f"block {start} was used", Severity.NOTE) or not wrong


def test_a_cropped_file_has_the_first_frame_that_fits_its_frames(tmp_path: Path) -> None:
    events = (Event("Foot Strike", 1.25, "Left"), Event("Foot Off", 1.5, "Left"))
    file = written(tmp_path / "walk.c3d", walk(100, first_frame=101, events=events))
    # The program that cut the file changed the header only.
    stale = {**integers(file, "TRIAL", "ACTUAL_START_FIELD", 1, 0), **integers(file, "TRIAL", "ACTUAL_END_FIELD", 400, 0)}
    (tmp_path / "cropped.c3d").write_bytes(changed(file, {}, stale))
    recording = read(tmp_path / "cropped.c3d")
    assert (len(recording), recording.first_frame) == (100, 101)
    assert said(recording, "first frame is 1 by TRIAL, 101 by the header, 301 by TRIAL's last frame; 101 was used", Severity.NOTE)
    # Or it changed neither the numbers in TRIAL nor the events, and counts anew in the header.
    (tmp_path / "anew.c3d").write_bytes(changed(file, {4: 1, 5: 100}, {}))
    recording = read(tmp_path / "anew.c3d")
    assert recording.first_frame == 101
    assert said(recording, "101 was used, which fits the frames and events better", Severity.NOTE)
    without = written(tmp_path / "plain.c3d", walk(100, first_frame=101))
    (tmp_path / "plain.c3d").write_bytes(changed(without, {4: 1, 5: 100}, {}))
    assert said(read(tmp_path / "plain.c3d"), "101 by TRIAL, 1 by the header; 101 was used", Severity.WARNING)


def test_a_file_that_may_be_cut_at_either_end_is_told(tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk(100, first_frame=101, events=(Event("Foot Strike", 1.75, "Left"),)))
    # Header and TRIAL begin with one frame, TRIAL ends 50 frames later: these are missing at the beginning or at the end.
    (tmp_path / "cut.c3d").write_bytes(changed(file, {}, integers(file, "TRIAL", "ACTUAL_END_FIELD", 250, 0)))
    recording = read(tmp_path / "cut.c3d")
    assert recording.first_frame == 101
    assert said(recording, "101 by TRIAL, 101 by the header, 151 by TRIAL's last frame; 101 was used", Severity.WARNING)


@pytest.mark.parametrize("suffix", ["c3d", "npz"])
def test_events_outside_the_recording_are_told(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"walk.{suffix}"
    inside = (Event("Foot Strike", 0.99, "Left"), Event("Foot Off", 1.6, "Left"))
    write(path, walk(60, first_frame=101, events=inside))
    assert not findings_of(read(path))
    write(path, walk(60, first_frame=101, events=(*inside, Event("Foot Off", 0.2, "Left"))))
    assert said(read(path), "1 of 3 events lie outside the recording, which is from 1.00 to 1.60 s")
    assert [finding.code for finding in describe(path)["findings"]] == ["format-events-outside"]


def test_of_three_rates_two_decide(tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk())
    (tmp_path / "other.c3d").write_bytes(changed(file, {}, floats(file, "POINT", "RATE", 120.0)))
    recording = read(tmp_path / "other.c3d")
    assert recording.rate == 120.0
    assert said(recording, "120 by POINT:RATE, 100 by the header; 120 was used", Severity.WARNING)
    analog = ezc3d.c3d()
    analog["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    analog["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    analog["parameters"]["POINT"]["LABELS"]["value"] = list(NAMES)
    analog["parameters"]["ANALOG"]["RATE"]["value"] = [1000.0]
    analog["parameters"]["ANALOG"]["LABELS"]["value"] = ["Fx"]
    points = np.ones((4, len(NAMES), 60))
    points[:3] = 1000 * walk().positions.transpose(2, 1, 0)
    analog["data"]["points"], analog["data"]["analogs"] = points, np.zeros((1, 1, 600))
    analog.write(str(tmp_path / "analog.c3d"))
    file = open_c3d(tmp_path / "analog.c3d")
    assert "findings" not in read(tmp_path / "analog.c3d").metadata
    (tmp_path / "analog.c3d").write_bytes(changed(file, {}, floats(file, "POINT", "RATE", 120.0)))
    recording = read(tmp_path / "analog.c3d")
    assert recording.rate == 100.0
    assert said(recording, "100 was used", Severity.NOTE)


@pytest.mark.parametrize("claim", ["header", "parameters"])
def test_a_wrong_number_of_points_gives_way_to_the_one_that_fills_the_file(claim: str, tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk(24))
    # 24 frames of one point more or less have less than a block, so that both numbers fill the file
    for points in (len(NAMES) - 1, len(NAMES) + 1):
        raw = changed(file, {2: points}) if claim == "header" else changed(file, {}, integers(file, "POINT", "USED", points))
        (tmp_path / "other.c3d").write_bytes(raw)
        recording = read(tmp_path / "other.c3d")
        np.testing.assert_allclose(recording.positions, walk(24).positions, atol=1e-6)
        assert said(recording, f"{points} points are declared by")


def test_points_that_leap_are_told_where_a_file_contradicts_itself(tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk(24))
    wrong = len(NAMES) - 1
    raw = changed(file, {2: wrong}, {**integers(file, "POINT", "USED", wrong), ("POINT", "LABELS"): None})
    (tmp_path / "other.c3d").write_bytes(raw)
    assert said(read(tmp_path / "other.c3d", vertical="z"), "leap from frame to frame", Severity.WARNING)


def test_the_points_of_a_cut_file_are_those_that_move_least(tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk(64, 8))
    raw = changed(file, {2: 4})
    # What is left has room for 64 frames of 4 points, and for 32 of 8.
    (tmp_path / "cut.c3d").write_bytes(raw[: file.layout.start + 64 * 4 * 16 + 40])
    recording = read(tmp_path / "cut.c3d")
    np.testing.assert_allclose(recording.positions, walk(32, 8).positions, atol=1e-6)
    assert said(recording, "breaks off", Severity.WARNING)


def as_integers(file: C3DFile, scale: float, stated: float) -> bytes:
    """The file's bytes with its points as 16-bit integers of that scale, and another scale in POINT:SCALE."""
    head = bytearray(changed(file, {}, floats(file, "POINT", "SCALE", stated))[: file.layout.start])
    head[12:16] = np.float32(scale).tobytes()
    points = np.concatenate([np.rint(file.coordinates / scale), np.zeros((*file.coordinates.shape[:2], 1))], axis=2)
    data = points.astype("<i2").tobytes()
    return bytes(head) + data + bytes(-len(data) % BLOCK)


def test_of_two_scales_the_one_that_makes_a_person_is_used(tmp_path: Path) -> None:
    file, path = written(tmp_path / "walk.c3d", walk()), tmp_path / "integers.c3d"
    path.write_bytes(as_integers(file, 0.1, 1.0))
    recording = read(path)
    np.testing.assert_allclose(recording.positions, walk().positions, atol=1e-4)
    assert said(recording, "0.1 was used, which makes the points as large as a person", Severity.NOTE)
    raw = bytearray(as_integers(file, 0.1, 0.1))
    raw[12:16] = np.float32(0.01).tobytes()
    path.write_bytes(raw)
    np.testing.assert_allclose(read(path).positions, walk().positions, atol=1e-4)
    path.write_bytes(as_integers(file, 0.1, 0.12))
    assert said(read(path), "0.1 was used", Severity.WARNING)
    path.write_bytes(as_integers(file, 0.1, -0.1))
    assert not findings_of(read(path)), "the sign is the number format, which the length shows"


def test_integers_without_a_scale_are_told(tmp_path: Path) -> None:
    raw = bytearray(as_integers(written(tmp_path / "walk.c3d", walk()), 1.0, 0.0))
    raw[12:16] = bytes(4)
    (tmp_path / "bare.c3d").write_bytes(raw)
    assert said(read(tmp_path / "bare.c3d"), "length of an integer step", Severity.WARNING)


@pytest.mark.parametrize("code", [-9999.0, 9999999.0, 999999.0, -9999.99])
def test_numbers_for_missing_samples_are_missing(code: float, tmp_path: Path) -> None:
    file = written(tmp_path / "walk.c3d", walk())
    raw = bytearray(changed(file))
    words = np.frombuffer(raw, dtype="<f4", offset=file.layout.start, count=60 * 4 * len(NAMES)).reshape(60, -1, 4)
    words[10:20, 3, :3] = code
    (tmp_path / "coded.c3d").write_bytes(raw)
    recording = read(tmp_path / "coded.c3d")
    assert not recording.visible[10:20, 3].any()
    assert recording.visible.sum() == 60 * len(NAMES) - 10
    assert said(recording, "10 samples are", Severity.NOTE)
    write(tmp_path / "again.c3d", recording)
    assert (tmp_path / "again.c3d").read_bytes() == bytes(raw)


def test_no_other_number_is_one_for_missing() -> None:
    odd = [
        [1000.0] * 3,
        [1e6] * 3,
        [-9999.0, 9999.0, -9999.0],
        [9999.0, 9999.0, 12.0],
        [99.0] * 3,
        [np.nan] * 3,
        [np.inf] * 3,
        [9998.0] * 3,
    ]
    assert not missing_codes(np.array(odd)).any()
    assert missing_codes(np.array([[-9999] * 3, [-32768] * 3, [32767] * 3], dtype=np.int16)).all()


@pytest.mark.parametrize(
    "names",
    [("LHJC", "RHJC", "LKJC", "RKJC"), ("LHipAngles", "RHipAngles"), ("LKneeMoment",), ("L_KNEE_ANG", "RHipFlex"), ("HipCenterL", "COM")],
)
def test_a_file_of_computed_points_only_has_no_markers(names: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "computed.c3d"
    write(path, replace(walk(60, len(names)), labels=names))
    with pytest.raises(NoMarkers, match=rf"computed\.c3d holds no markers, only {len(names)} points that a model computed.*{names[0]}"):
        read(path)
    told = describe(path)["points"]
    assert (told["physical"], told["computed"]) == ([], list(names))
    assert read(path, markers=names).labels == names


def named(path: Path, names: list[bytes]) -> bytes:
    """Bytes of a file whose points have these names."""
    file = written(path, walk(60, len(names)))
    group = file.parameters.group_id("POINT")
    assert group is not None
    labels: dict[tuple[str, str], Record | None] = {("POINT", "LABELS"): strings_record("LABELS", group, names, 4, PC)}
    return changed(file, {}, labels)


@pytest.mark.parametrize(
    ("names", "encoding", "finding"),
    [
        (("右膝", "左膝", "ヒザ", "C7"), "cp932", "in Shift-JIS"),
        (("Fußspitze", "épaule", "cœur", "C7"), "cp1252", ""),
        (("Łokieć", "Žebro", "koleno", "C7"), "cp1250", ""),
        (("右膝", "左膝", "ヒザ", "Größe"), "utf-8", ""),
    ],
)
def test_names_are_read_in_the_encoding_that_they_have(names: tuple[str, ...], encoding: str, finding: str, tmp_path: Path) -> None:
    path = tmp_path / "names.c3d"
    path.write_bytes(named(path, [name.encode(encoding) for name in names]))
    recording = read(path)
    assert recording.labels == names
    assert said(recording, finding) if finding else not findings_of(recording)
    write(tmp_path / "again.c3d", recording)
    assert (tmp_path / "again.c3d").read_bytes() == path.read_bytes()
    # New names are UTF-8, beside the old ones.
    write(tmp_path / "new.c3d", replace(recording, labels=("Größe", *names[1:])))
    assert read(tmp_path / "new.c3d").labels == ("Größe", *names[1:])


def test_names_in_an_unknown_encoding_are_told(tmp_path: Path) -> None:
    path = tmp_path / "names.c3d"
    path.write_bytes(named(path, [name.encode("gbk") for name in ("右膝盖", "左膝盖", "左脚踝", "右脚踝")]))
    assert said(read(path), "encoding of the names is not known", Severity.NOTE)


def test_a_name_that_its_field_cuts_within_a_character_is_read(tmp_path: Path) -> None:
    path = tmp_path / "names.c3d"
    for encoding in ("cp932", "utf-8"):
        path.write_bytes(named(path, ["右膝外".encode(encoding)[:-1], b"C7", b"LKNE", b"RKNE"]))
        assert read(path).labels[0].startswith("右膝")


@pytest.mark.parametrize(("unit", "markers"), [("deg", False), ("Nmm/kg", False), ("mm", True), ("furlong", True)])
def test_points_in_a_unit_of_angles_or_forces_are_no_markers(unit: str, markers: bool, tmp_path: Path) -> None:
    file, path = written(tmp_path / "walk.c3d", walk()), tmp_path / "values.c3d"
    group = file.parameters.group_id("POINT")
    assert group is not None
    path.write_bytes(changed(file, {}, {("POINT", "UNITS"): strings_record("UNITS", group, [unit.encode()], 4, PC)}))
    assert bool(describe(path)["points"]["physical"]) == markers
    assert bool(describe(path)["points"]["computed"]) != markers


def altered(raw: bytes, file: C3DFile, rng: np.random.Generator) -> tuple[bytes, str]:
    """The bytes with one number of the header or of the parameters that say what the data hold changed; and which."""
    parameters = [("POINT", name) for name in ("USED", "FRAMES", "DATA_START", "SCALE", "RATE")]
    parameters += [("TRIAL", "ACTUAL_START_FIELD"), ("TRIAL", "ACTUAL_END_FIELD"), ("ANALOG", "USED"), ("ANALOG", "RATE")]
    # Bytes of the header's points, analog samples, frames, scale, start, samples per frame and rate.
    places = [(f"byte {at}", at, size) for at, size in ((2, 2), (4, 2), (6, 2), (8, 2), (12, 4), (16, 2), (18, 2), (20, 4))]
    for group, name in parameters:
        record = file.parameters.find(group, name)
        if record is not None:
            at = raw.index(record.raw) + len(record.raw) - len(record.data) - 1
            places.append((f"{group}:{name}", at, 4 if record.kind == 4 else 2))
    what, at, size = places[rng.integers(len(places))]
    out = bytearray(raw)
    if size == 4:
        value = np.frombuffer(raw, dtype="<f4", count=1, offset=at)[0]
        out[at : at + 4] = np.float32(value * rng.choice([-1, 0, 0.1, 0.5, 2, 10, 1.2])).tobytes()
    else:
        value = int.from_bytes(raw[at : at + 2], "little")
        new = [value + 1, max(value - 1, 0), 2 * value, value // 2, 0, 65535, rng.integers(65536), rng.integers(400)]
        out[at : at + 2] = (int(rng.choice(new)) & 0xFFFF).to_bytes(2, "little")
    return bytes(out), f"{what}: {out[at : at + size].hex()} for {raw[at : at + size].hex()}"


@pytest.mark.parametrize("kind", ["real", "integer", "real at 101", "narrow"])
def test_whatever_one_number_says_the_recording_is_right_or_a_warning_tells(kind: str, tmp_path: Path) -> None:
    rng, first = np.random.default_rng(8), 101 if kind == "real at 101" else 1
    events = tuple(Event("Foot Strike", (first - 1) / 100 + time, "Left") for time in (0.1, 0.3))
    truth = walk(60, 3 if kind == "narrow" else len(NAMES), first, events)
    file = written(tmp_path / "walk.c3d", truth)
    raw = as_integers(file, 0.1, 0.1) if kind == "integer" else changed(file)
    (tmp_path / "walk.c3d").write_bytes(raw)
    file, right = open_c3d(tmp_path / "walk.c3d"), 0
    for _ in range(120):
        other, what = altered(raw, file, rng)
        (tmp_path / "other.c3d").write_bytes(other)
        try:
            recording = read(tmp_path / "other.c3d", vertical="z")
        except AsterismError as problem:
            assert "is damaged" not in str(problem), what
            continue
        same = (recording.labels, recording.first_frame, recording.rate) == (truth.labels, first, 100.0)
        if same and len(recording) == 60 and np.allclose(recording.positions, truth.positions, atol=1e-4):
            right += 1
        else:
            assert any(finding.severity is Severity.WARNING for finding in findings_of(recording)), f"{what}: wrong, and nothing tells"
    assert right > 100
