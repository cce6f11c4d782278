"""A long C3D file is read by ranges, labelled and written as a short one, also where the file or what happens is odd.

Most tests take a model that labels each point by its column, so that a long file has exactly the labels of a short one.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import asterism
from asterism.cli import main
from asterism.files import atomic
from asterism.findings import Finding
from asterism.formats.c3d._edit import integers_record, strings_record
from asterism.formats.c3d._file import C3DFile, open_c3d
from asterism.formats.c3d._long import LongRecording, read_long
from asterism.formats.c3d._numbers import PC
from asterism.formats.c3d._parameters import make_group
from asterism.labelling import recording_labeller, review, stretches
from asterism.recording import NULL, Clouds, Event, Labelling, MarkerSet, Recording
from asterism.recording.verdict import FITS, OTHER_BODY, OTHER_MARKERS, OTHER_PERSON, Verdict
from asterism.session import label_file, sources

FRAMES, POINTS = 300, 4
BLOCK = 512


@pytest.fixture(autouse=True)
def few_frames_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.formats.c3d._file._FRAMES_AT_ONCE", 70)


def recorded(frames: int = FRAMES) -> Recording:
    """Points of which the first one shows only in the first frames, and the last one never."""
    positions = np.random.default_rng(1).normal(loc=(0, 0, 1), size=(frames, POINTS, 3))
    positions[20:, 0] = np.nan
    positions[:, -1] = np.nan
    return Recording(positions, tuple(f"M{number}" for number in range(POINTS)), 100.0, first_frame=37)


def written(path: Path, recording: Recording) -> C3DFile:
    asterism.write(path, recording)
    return open_c3d(path)


def long_of(path: Path) -> LongRecording:
    long = read_long(path, "z", 100)
    assert long is not None
    return long


def is_read_whole(path: Path) -> bool:
    return read_long(path, "z", 100) is None


@pytest.mark.parametrize("some", [slice(0, 50), slice(60, 200), slice(299, None), slice(-10, None)])
def test_a_range_of_frames_is_that_of_the_whole_file(some: slice, tmp_path: Path) -> None:
    written(tmp_path / "long.c3d", recorded())
    found = long_of(tmp_path / "long.c3d").frames(some)
    expected = asterism.read(tmp_path / "long.c3d", vertical="z").frames(some)
    assert found.first_frame == expected.first_frame == 37 + some.indices(FRAMES)[0]
    assert (found.labels, found.rate) == (expected.labels, expected.rate)
    np.testing.assert_array_equal(found.positions, expected.positions)


def test_a_point_that_only_the_first_frames_show_is_shown(tmp_path: Path) -> None:
    written(tmp_path / "long.c3d", recorded())
    counts, shown = long_of(tmp_path / "long.c3d").shown()
    assert shown.tolist() == [True, True, True, False]
    np.testing.assert_array_equal(counts, [3] * 20 + [2] * (FRAMES - 20))


def with_a_gap(file: C3DFile) -> bytes:
    """The file's bytes with three blocks, not zero, between its parameters and its data."""
    head = bytearray(file.raw[:BLOCK])
    head[16:18] = (file.layout.start // BLOCK + 1 + 3).to_bytes(2, "little")
    moved = {("POINT", "DATA_START"): integers_record("DATA_START", group_of(file, "POINT"), [file.layout.start // BLOCK + 4], (), PC)}
    section = file.parameters.replaced(moved).to_bytes().ljust(file.layout.start - BLOCK, b"\0")
    return bytes(head) + section + b"\x07" * (3 * BLOCK) + bytes(file.raw[file.layout.start :])


def group_of(file: C3DFile, name: str) -> int:
    number = file.parameters.group_id(name)
    assert number is not None
    return number


def parameters_behind(file: C3DFile) -> bytes:
    """The file's bytes with its parameters behind its data."""
    data = bytes(file.raw[file.layout.start : file.layout.stop])
    data += bytes(-len(data) % BLOCK)
    head = bytearray(file.raw[:BLOCK])
    head[0] = len(data) // BLOCK + 2
    head[16:18] = (2).to_bytes(2, "little")
    there = {("POINT", "DATA_START"): integers_record("DATA_START", group_of(file, "POINT"), [2], (), PC)}
    section = file.parameters.replaced(there).to_bytes()
    return bytes(head) + data + section + bytes(-len(section) % BLOCK)


def rotations_behind(file: C3DFile) -> bytes:
    """The file's bytes with a block of other data behind its own, where a parameter says that it begins."""
    data = bytes(file.raw[file.layout.start : file.layout.stop])
    data += bytes(-len(data) % BLOCK)
    block = (file.layout.start + len(data)) // BLOCK + 1
    records = {
        ("", "ROTATION"): make_group("ROTATION", 20, processor=PC),
        ("ROTATION", "DATA_START"): integers_record("DATA_START", 20, [block], (), PC),
    }
    section = file.parameters.replaced(records).to_bytes().ljust(file.layout.start - BLOCK, b"\0")
    assert len(section) == file.layout.start - BLOCK
    return bytes(file.raw[:BLOCK]) + section + data + b"\x05" * (2 * BLOCK)


def test_data_that_begin_late_are_read_from_there(tmp_path: Path) -> None:
    path = tmp_path / "gap.c3d"
    path.write_bytes(with_a_gap(written(path, recorded())))
    found, whole = long_of(path), asterism.read(path, vertical="z")
    np.testing.assert_array_equal(found.frames(slice(None)).positions, whole.positions)
    np.testing.assert_allclose(whole.positions, recorded().positions, atol=1e-6)


def a_few_bytes_behind(file: C3DFile) -> bytes:
    """The file's bytes with less than a block behind its data."""
    return bytes(file.raw[: file.layout.stop]) + b"\x05" * 10


def zeros_behind(file: C3DFile) -> bytes:
    """The file's bytes with more zeros behind its data than fill a block."""
    return bytes(file.raw[: file.layout.stop]) + bytes(2 * BLOCK)


@pytest.mark.parametrize("odd", [parameters_behind, rotations_behind, a_few_bytes_behind, zeros_behind])
def test_a_file_with_something_behind_its_data_is_read_whole(odd: Callable[[C3DFile], bytes], tmp_path: Path) -> None:
    path = tmp_path / "odd.c3d"
    file = written(path, replace(recorded(), metadata={"subject": "Ann " * 25}))
    assert not is_read_whole(path)
    path.write_bytes(odd(file))
    np.testing.assert_allclose(asterism.read(path, vertical="z").positions, recorded().positions, atol=1e-6)
    assert is_read_whole(path)


MARKERS = ("A", "B", "C", "D")
LONG = 800
"""Frames of a file that is labelled in three stretches."""


@dataclass
class ByColumn:
    """A model that gives the point of each column the marker of its place, with a confidence that its place tells.

    verdicts  those of the stretches, one after the other, the last one of all that follow
    """

    marker_set: MarkerSet
    verdicts: Sequence[Verdict | None] = (None,)
    about: dict[str, Any] | None = None
    labelled: int = 0

    def label_one_body(self, clouds: Clouds, *_: object, **__: object) -> Labelling:
        shape = (len(clouds), len(self.marker_set))
        indices, confidence = np.full(shape, NULL), np.zeros(shape)
        place = np.arange(len(clouds.xyz)) - clouds.offsets[clouds.frame_of]
        known = clouds.columns < shape[1]
        frame, marker = clouds.frame_of[known], clouds.columns[known]
        indices[frame, marker] = place[known]
        confidence[frame, marker] = 0.9 + 0.1 * np.abs(np.sin(100 * clouds.xyz[known, 0]))
        verdict = self.verdicts[min(self.labelled, len(self.verdicts) - 1)]
        self.labelled += len(clouds) > 1
        return Labelling(indices, confidence, self.marker_set.names, verdict=verdict)

    def findings(self, where: str) -> list[Finding]:
        return []

    def label(self, clouds: Clouds, **_: object) -> Labelling:
        return stretches.label_long(self.label_one_body, self.marker_set.names, clouds)


def moving(frames: int = LONG, points: int = 5) -> Recording:
    """Points that rise slowly, without names, each with a gap."""
    time = np.arange(frames) / 100
    positions = np.stack([np.stack([np.sin(time + p), 0.3 + 0.6 * p + 0 * time, 0.1 * time], axis=1) for p in range(points)], axis=1)
    for point in range(points):
        positions[40 * point + 30 : 40 * point + 50, point] = np.nan
    return Recording(positions, tuple(f"*{p + 1}" for p in range(points)), 100.0, events=(Event("Foot Strike", 2.5, "Left"),))


@pytest.fixture
def in_short_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_labeller, "StretchRules", partial(stretches.StretchRules, whole=100, points=1700, overlap=0.5))


@dataclass
class Run:
    """What `asterism label` did: its status, its output, its row, its findings and what it said."""

    status: int
    output: bytes | None
    row: dict[str, Any]
    findings: list[dict[str, Any]]
    said: str


class Labels:
    """Labels a file twice: as a long one, and as a short one."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self.monkeypatch, self.capsys = folder, monkeypatch, capsys
        self.whole = False

    def run(self, source: Path, model: ByColumn, *options: str) -> Run:
        (self.folder / "any.model").write_bytes(b"any")
        folder = self.folder / ("short" if self.whole else "long")
        report = folder.with_suffix(".json")
        long_ones = list[bool]()

        def read(*given: Any) -> LongRecording | None:
            long = None if self.whole else read_long(*given)
            long_ones.append(long is not None)
            return long

        with self.monkeypatch.context() as patch:
            patch.setattr(asterism.MarkerModel, "load", lambda path: replace(model))
            patch.setattr(sources, "read_long", read)
            given = ["label", str(source), "--model", str(self.folder / "any.model"), "-o", str(folder), "--json", str(report), *options]
            status = main([*given, "--overwrite"])
        self.was_long = any(long_ones)
        content = json.loads(report.read_text())
        outputs = [path for path in folder.glob("*") if path.suffix in (".c3d", ".trc", ".csv")] if folder.exists() else []
        row = content["files"][0] if content["files"] else {}
        findings = json.loads(json.dumps(content["findings"]).replace(str(folder), ""))
        said = self.capsys.readouterr().err.replace(str(folder), "")
        return Run(status, outputs[0].read_bytes() if outputs else None, row, findings, said)

    def both(self, source: Path, model: ByColumn, *options: str) -> tuple[Run, Run]:
        """The run that reads the file by ranges, where it may, and the one that reads it whole."""
        self.whole = False
        by_ranges = self.run(source, model, *options)
        was_long = self.was_long
        self.whole = True
        whole = self.run(source, model, *options)
        self.was_long = was_long
        return by_ranges, whole


@pytest.fixture
def labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], in_short_stretches: None) -> Labels:
    return Labels(tmp_path, monkeypatch, capsys)


def same(by_ranges: Run, whole: Run) -> None:
    """Both runs say and write the same; only the name of the folder and the speed differ."""
    assert by_ranges.output == whole.output
    assert list(by_ranges.row) == list(whole.row)
    for name in by_ranges.row.keys() - {"output", "frames_per_second"}:
        assert by_ranges.row[name] == whole.row[name] or by_ranges.row[name] != by_ranges.row[name], name
    assert by_ranges.findings == whole.findings
    assert (by_ranges.status, by_ranges.said) == (whole.status, whole.said)


def test_a_long_file_has_the_labels_of_a_short_one(labels: Labels, tmp_path: Path) -> None:
    asterism.write(tmp_path / "walk.c3d", moving())
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long and by_ranges.output is not None
    assert "label-in-stretches" in {finding["code"] for finding in by_ranges.findings}
    same(by_ranges, whole)


def verdict(kind: str, *exchangeable: tuple[str, ...]) -> Verdict:
    return Verdict(kind, 0.1, 0.05, 1.0, 0.9, 0.0, exchangeable)


@pytest.mark.parametrize("kind", [OTHER_PERSON, OTHER_MARKERS, OTHER_BODY])
def test_a_long_file_of_another_body_is_called_so(kind: str, labels: Labels, tmp_path: Path) -> None:
    asterism.write(tmp_path / "walk.c3d", moving())
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS), [verdict(kind)]))
    assert labels.was_long and by_ranges.row["verdict"] == kind
    assert "label-foreign-recording" in {finding["code"] for finding in by_ranges.findings}
    assert by_ranges.status == 1
    same(by_ranges, whole)


def test_markers_that_one_stretch_may_exchange_are_named(labels: Labels, tmp_path: Path) -> None:
    asterism.write(tmp_path / "walk.c3d", moving())
    model = ByColumn(MarkerSet(MARKERS), [verdict(FITS), verdict(FITS, ("A", "B")), verdict(FITS, ("C", "D"))])
    # with the axis given, each stretch is labelled once, and takes the next verdict
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", model, "--vertical", "z")
    told = [finding["sentence"] for finding in by_ranges.findings if finding["code"] == "label-exchangeable"]
    assert labels.was_long and ["A and B" in told[0], "C and D" in told[1]] == [True, True]
    same(by_ranges, whole)


@pytest.mark.parametrize("options", [[], ["--known-labels", "check"]], ids=["as the file decides", "names checked"])
def test_names_that_contradict_are_told_with_the_frames_of_the_file(options: list[str], labels: Labels, tmp_path: Path) -> None:
    named = replace(moving(), labels=("B", "A", "*3", "*4", "*5"), first_frame=11)
    asterism.write(tmp_path / "walk.c3d", named)
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)), *options)
    (told,) = [finding["sentence"] for finding in by_ranges.findings if finding["code"] == "label-names-differ"]
    assert labels.was_long and f"to {LONG + 10})" in told
    same(by_ranges, whole)


def with_computed(path: Path) -> None:
    """A file of nameless points and a computed one, which has the name of a marker."""
    recording = moving(points=5)
    file = written(path, replace(recording, labels=(*recording.labels[:4], "B"), metadata={"subject": "Ann " * 25}))
    angles = {("POINT", "ANGLES"): strings_record("ANGLES", group_of(file, "POINT"), [b"B"], 4, PC)}
    section = file.parameters.replaced(angles).to_bytes().ljust(file.layout.start - BLOCK, b"\0")
    assert len(section) == file.layout.start - BLOCK
    path.write_bytes(bytes(file.raw[:BLOCK]) + section + bytes(file.raw[file.layout.start :]))


def test_a_computed_point_that_gets_another_name_is_told(labels: Labels, tmp_path: Path) -> None:
    with_computed(tmp_path / "walk.c3d")
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long and [phrase for phrase in by_ranges.row["not_carried"] if "B_computed" in phrase]
    assert any("B_computed" in finding["sentence"] for finding in by_ranges.findings)
    same(by_ranges, whole)


def test_a_computed_point_that_is_left_out_gets_no_other_name(labels: Labels, tmp_path: Path) -> None:
    with_computed(tmp_path / "walk.c3d")
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)), "--drop-computed")
    assert labels.was_long and by_ranges.row["not_carried"] == []
    same(by_ranges, whole)


@pytest.mark.usefixtures("in_short_stretches")
def test_what_should_be_checked_of_a_long_file_is_in_its_frames(tmp_path: Path) -> None:
    """Each item has the frames of the recording, not those of its stretch; the last one begins and ends in the last stretch."""
    path = tmp_path / "walk.c3d"
    recording = moving()
    positions = recording.positions.copy()
    positions[660:700, 0] = np.nan
    asterism.write(path, replace(recording, positions=positions))
    model: Any = ByColumn(MarkerSet(MARKERS))
    clouds = asterism.read(path, vertical="z").clouds()
    expected = review(model.label_one_body(clouds), clouds)
    found = label_file(path, model)
    pieces = {(item.first_frame, item.last_frame): item for item in found.items}
    assert list(pieces) == [(item.first_frame, item.last_frame) for item in expected]
    assert all(first <= item.frame <= last for (first, last), item in pieces.items())
    (late,) = [item for item in expected if item.first_frame >= 700]
    assert pieces[late.first_frame, late.last_frame].frame == late.frame
    assert [item.gain for item in found.items] == pytest.approx([item.gain for item in expected])


@pytest.mark.parametrize("wanted", ["full disk", "read-only folder"])
def test_a_long_file_that_cannot_be_written_leaves_the_old_one(
    wanted: str, labels: Labels, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "walk.c3d"
    asterism.write(source, moving())
    for name in ("long", "short"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "walk.c3d").write_bytes(b"old")
    number = errno.ENOSPC if wanted == "full disk" else errno.EROFS

    class Full:
        """A stream that takes the first pieces only."""

        def __init__(self, handle: int, _: str) -> None:
            self.handle, self.room = handle, 20_000

        def __enter__(self) -> Full:
            return self

        def __exit__(self, *_: object) -> None:
            os.close(self.handle)

        def write(self, data: bytes) -> None:
            self.room -= os.write(self.handle, data[: self.room])
            if self.room <= 0:
                raise OSError(number, os.strerror(number))

    def refused(path: Path, *_: object) -> int:
        raise OSError(number, os.strerror(number), str(path))

    unlike = {name: getattr(os, name) for name in dir(os) if not name.startswith("__")}
    changed = {"fdopen": Full} if wanted == "full disk" else {"open": refused}
    monkeypatch.setattr(atomic, "os", SimpleNamespace(**{**unlike, **changed}))
    with monkeypatch.context() as patch:
        patch.setattr("asterism.cli.label._console.write_json", only_the_content)
        by_ranges, whole = labels.both(source, ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long and by_ranges.status == 2 and by_ranges.row == {}
    assert f"walk.c3d cannot be written ({os.strerror(number)})" in by_ranges.said.splitlines()[-1]
    assert by_ranges.output == b"old"
    assert not list((tmp_path / "long").glob(".*"))
    same(by_ranges, whole)


def only_the_content(where: str, content: dict[str, Any]) -> None:
    """Write a report past what the test makes fail."""
    from asterism.files.plain import as_json

    Path(where).write_text(json.dumps(as_json(content)))


@pytest.mark.parametrize(
    "gone",
    [[slice(225, 275)], [slice(150, 420)], [slice(0, 300)], [slice(500, None)], [slice(240, 241), slice(530, 531)]],
    ids=["at the seam", "a stretch and more", "the beginning", "the end", "single frames"],
)
def test_frames_without_any_point_stay_empty(gone: list[slice], labels: Labels, tmp_path: Path) -> None:
    recording = moving()
    positions = recording.positions.copy()
    for some in gone:
        positions[some] = np.nan
    asterism.write(tmp_path / "walk.c3d", replace(recording, positions=positions))
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long
    same(by_ranges, whole)
    after = asterism.read(tmp_path / "long" / "walk.c3d", vertical="z")
    np.testing.assert_array_equal(~after.visible.any(axis=1), np.isnan(positions).all(axis=(1, 2)))


@pytest.mark.parametrize("shown", [0, 1, 15], ids=["no frame", "one frame", "some frames"])
def test_a_long_file_with_few_points_in_it_is_labelled_at_once(shown: int, labels: Labels, tmp_path: Path) -> None:
    recording = moving()
    positions = recording.positions.copy()
    positions[shown:] = np.nan
    asterism.write(tmp_path / "walk.c3d", replace(recording, positions=positions))
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long and not any(finding["code"] == "label-in-stretches" for finding in by_ranges.findings)
    same(by_ranges, whole)


def test_a_long_file_may_be_replaced_by_its_labelled_copy(labels: Labels, tmp_path: Path) -> None:
    found = list[Run]()
    for labels.whole in (False, True):
        path = tmp_path / ("short" if labels.whole else "long") / "walk.c3d"
        path.parent.mkdir()
        asterism.write(path, moving())
        found.append(labels.run(path, ByColumn(MarkerSet(MARKERS))))
        assert labels.was_long is not labels.whole
    assert found[0].status == found[1].status == 0
    assert found[0].output == found[1].output
    assert set(MARKERS) <= set(asterism.read(tmp_path / "long" / "walk.c3d").labels)


def test_more_frames_than_a_header_counts_are_all_labelled(labels: Labels, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_labeller, "StretchRules", partial(stretches.StretchRules, whole=100, points=150_000, overlap=0.5))
    monkeypatch.setattr("asterism.formats.c3d._file._FRAMES_AT_ONCE", 20_000)
    recording = replace(moving(66_000, 4), first_frame=10)
    asterism.write(tmp_path / "walk.c3d", recording)
    by_ranges, whole = labels.both(tmp_path / "walk.c3d", ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long and by_ranges.row["frames"] == 66_000
    same(by_ranges, whole)
    after = asterism.read(tmp_path / "long" / "walk.c3d", vertical="z")
    assert (len(after), after.first_frame, set(MARKERS) <= set(after.labels)) == (66_000, 10, True)
    np.testing.assert_allclose(after.positions[-1], recording.positions[-1], atol=1e-5)


@pytest.mark.parametrize("name", ["walk.trc", "walk.csv", "walk.c3d"])
def test_a_file_that_is_no_c3d_or_becomes_none_is_labelled_as_before(name: str, labels: Labels, tmp_path: Path) -> None:
    asterism.write(tmp_path / name, moving())
    options = ["--for", "opensim"] if name == "walk.c3d" else []
    by_ranges, whole = labels.both(tmp_path / name, ByColumn(MarkerSet(MARKERS)), *options)
    assert not labels.was_long and by_ranges.output is not None
    assert "label-in-stretches" in {finding["code"] for finding in by_ranges.findings}
    same(by_ranges, whole)


def test_data_that_begin_late_are_labelled_and_written_there(labels: Labels, tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    path.write_bytes(with_a_gap(written(path, moving())))
    by_ranges, whole = labels.both(path, ByColumn(MarkerSet(MARKERS)))
    assert labels.was_long
    same(by_ranges, whole)


def test_what_stands_behind_the_data_of_a_labelled_file_stays(labels: Labels, tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    path.write_bytes(rotations_behind(written(path, replace(moving(), metadata={"subject": "Ann " * 25}))))
    by_ranges, _ = labels.both(path, ByColumn(MarkerSet(MARKERS)))
    assert by_ranges.output is not None
    after = open_c3d(tmp_path / "long" / "walk.c3d")
    block = after.parameters.count("ROTATION", "DATA_START")
    assert block is not None and after.raw[(block - 1) * BLOCK :] == b"\x05" * (2 * BLOCK)


def test_parameters_behind_the_data_are_said_to_be_in_the_way(labels: Labels, tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d"
    path.write_bytes(parameters_behind(written(path, moving())))
    by_ranges, whole = labels.both(path, ByColumn(MarkerSet(MARKERS)))
    assert by_ranges.status == 2 and "keeps its parameters behind its data" in by_ranges.said
    same(by_ranges, whole)
