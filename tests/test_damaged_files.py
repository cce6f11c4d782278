"""Broken and hostile files: whatever a parser raises is one sentence with the file's name; sizes of headers are bounded; nothing hangs."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import asterism
from asterism.calibration.boards import Board
from asterism.cameras.files import read_rig
from asterism.cameras.files._opencv_text import DEEPEST, values_of_xml, values_of_yaml
from asterism.cameras.files.opencv import file_list
from asterism.detection.claimed_sizes import MOST_PIXELS, claimed_size
from asterism.detection.sources import images, open_source
from asterism.errors import AsterismError, guarded_reading
from asterism.files.npz import FREE_BYTES, arrays_of_npz
from asterism.files.text import cells_of, number_of
from asterism.formats import read_blobs, read_table
from asterism.labelling.training.model_file import write_arrays
from asterism.labelling.training.model_schema import check_contents
from asterism.recording import Clouds, MarkerSet
from tests import hanging_trials, models

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
trials, specimens_of, mutations = (import_module(f"tests.damage.{name}") for name in ("trials", "specimens", "mutations"))


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """A whole file of every kind, without a model."""
    return specimens_of.specimens(tmp_path_factory.mktemp("whole") / "files", model=False)


@pytest.mark.parametrize("copies", [range(2), pytest.param(range(2, 16), marks=pytest.mark.slow)], ids=["two", "fourteen"])
def test_damaged_copies_of_every_format_are_read_or_refused_in_a_sentence(known: list[Any], copies: range, tmp_path: Path) -> None:
    numbers = range(copies.start * len(known), copies.stop * len(known))
    faults = [fault for number in numbers for fault in trials.read_copy(number, known, tmp_path / "damaged")]
    assert not faults, "\n".join(f"copy {fault.number} ({fault.kind}): {fault.what}, {fault.where}" for fault in faults[:5])
    assert trials.copy_of(7, known)[1] == trials.copy_of(7, known)[1], "a number stands for one copy"
    assert len({trials.copy_of(number, known)[1] for number in range(2 * len(known))}) > 1.9 * len(known), "copies differ"


@pytest.mark.parametrize(
    ("problem", "what"),
    [(KeyError("a"), "exception"), (MemoryError(), "memory"), (AsterismError("too short."), "exception"), (None, None)],
)
def test_the_trials_notice_what_no_sentence_is(tmp_path: Path, problem: Exception | None, what: str | None) -> None:
    def read(path: Path) -> None:
        with guarded_reading(path) if isinstance(problem, MemoryError) else open(path):
            if problem:
                raise problem

    specimen = specimens_of.Specimen("one", "walk.csv", b"frame,x\n1,2\n", (read,))
    found = trials.read_copy(0, [specimen], tmp_path / "damaged")
    assert [fault.what for fault in found] == ([what] if what else [])


def test_trials_go_on_after_a_hang_and_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "_read_all", hanging_trials.read_all)
    monkeypatch.setattr(trials, "HANG_S", 1.0)
    told = list(trials.run(range(8), jobs=1))
    assert sum(done for done, _ in told) == 8
    assert [(fault.number, fault.what) for _, faults in told for fault in faults] == [
        (hanging_trials.HANGS, "hang"),
        (hanging_trials.CRASHES, "crash"),
    ]


@pytest.mark.parametrize(
    ("problem", "sentence"),
    [
        (ValueError("bad\nthing"), r"walk.csv is damaged \(bad thing\); export it again"),
        (OverflowError(), r"walk.csv is damaged \(a number in it is too large\)"),
        (RecursionError(), "nested too deeply"),
        (MemoryError(), "more than fits into the memory"),
        (PermissionError(13, "Permission denied"), r"walk.csv cannot be read \(Permission denied\)"),
        (struct.error("unpack"), r"\(its bytes are not what its head announces\)"),
        (AsterismError("line 3 is bad."), "walk.csv: line 3 is bad."),
    ],
)
def test_the_guard_names_the_file_and_chains_the_cause(problem: Exception, sentence: str) -> None:
    with pytest.raises(AsterismError, match=sentence) as caught, guarded_reading("lab/walk.csv"):
        raise problem
    assert caught.value.__cause__ is problem
    with pytest.raises(KeyboardInterrupt), guarded_reading("walk.csv"):
        raise KeyboardInterrupt
    exact = AsterismError("lab/walk.csv, line 3: too short.")
    with pytest.raises(AsterismError) as caught, guarded_reading("lab/walk.csv"):
        raise exact
    assert caught.value is exact


@pytest.mark.parametrize(
    "text",
    [
        'markers = "LKNE"',
        "markers = 3",
        "markers = [1, 2]",
        'markers = ["A"]\naliases = ["B"]',
        'markers = ["A"]\naliases = {A = "LK"}',
        'markers = ["A", "B"]\npairs = [["A", "B", "A"]]',
        'markers = ["A", "B"]\npairs = ["AB"]',
        'markers = ["A"]\nsegments = 1',
        'markers = ["A"]\ntitle = 2026-11-22',
        'markers = ["A"]\n[segments]\nleft = [["A"]]',
        "markers = " + "[" * 5000,
    ],
)
def test_marker_sets_with_fields_of_another_type_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "set.toml"
    path.write_text(text)
    with pytest.raises(AsterismError, match=r"set\.toml is not a marker set"):
        MarkerSet.load(path)


@pytest.mark.parametrize(
    "text",
    [
        'kind = "charuco"\ncolumns = inf\nrows = 7\nsquare = 0.03\nmarker = 0.02',
        'kind = ["charuco"]\ncolumns = 5\nrows = 7\nsquare = 0.03',
        'kind = "carpet"\ncolumns = 5\nrows = 7\nsquare = 0.03',
        'columns = 0\nrows = 5\nboard_height = 11.0\nboard_width = 8.5\ndictionary = "DICT_4X4_50"\nunits = "inch"',
        'kind = "chessboard"\ncolumns = 5\nrows = 7\nsquare = 99',
    ],
)
def test_boards_of_impossible_values_are_refused_with_the_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "board.toml"
    path.write_text(text)
    with pytest.raises(AsterismError, match=r"board\.toml"):
        Board.from_toml(path)


def _table(cell: str) -> str:
    return "time,A_x,A_y,A_z,B_x,B_y,B_z\n" + "".join(f"{i / 100},1,2,3,4,5,6\n" for i in range(20)) + f"0.2,{cell},2,3,4,5,6\n"


@pytest.mark.parametrize("cell", ['"' + "1" * 140_000 + '"', "1" * 60_000 + "x", '"' * 999, "\x00"])
def test_long_and_odd_cells_are_refused_by_line(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "walk.csv"
    path.write_text(_table(cell))
    for read in (asterism.read, read_table, asterism.formats.describe):
        with pytest.raises(AsterismError, match=r"walk\.csv"):
            read(path)
    path.write_text("frame,camera,x,y\n" + "".join(f"{i},left,1,2\n" for i in range(9)) + f"9,left,{cell},2\n")
    with pytest.raises(AsterismError, match=r"walk\.csv(, line 11|: a cell that begins|.*not a text file)"):
        read_blobs(path)


def test_numbers_take_time_with_their_length() -> None:
    """By the steps of the pattern's own alternatives: a run of digits is never tried again, so a junk end costs one pass."""
    code = (
        "import sys; sys.setswitchinterval(1); from asterism.files.text import number_of\n"
        "assert number_of('9' * 2_000_000 + 'x') is None and number_of('1.' + '9' * 2_000_000 + 'e') is None"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)  # by squares it would take a day
    assert [number_of(cell) for cell in ("1.5", "-.5e3", "+2.", "1e-3", "inf")] == [1.5, -500.0, 2.0, 0.001, float("inf")]
    assert [number_of(cell) for cell in ("1_0", "0x1", "1e", ".", "--1")] == [None] * 5


def test_names_too_long_for_patterns_are_refused(tmp_path: Path) -> None:
    with pytest.raises(AsterismError, match=r"a cell that begins 'b+' has 5,000 characters"):
        cells_of("a," + "b" * 5000, ",")
    path = tmp_path / "walk.npz"
    asterism.write(path, asterism.Recording(np.zeros((3, 1, 3)), ("ghost" + "1" * 60_000 + "x",), 100.0))
    with pytest.raises(AsterismError, match=r"walk\.npz.*point 1 has a name of 60,006 characters"):
        asterism.read(path)


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("two.yml", "%YAML:1.0\n---\nK: 1\n---\nD: 2\n", "line 4: a second document begins"),
        ("two.yml", "---\nK: !!opencv-matrix\n---\n rows: 3\n", "a second document begins"),
        ("deep.yml", "%YAML:1.0\n---\na: " + "[" * 50_000, "nested|brackets"),
        ("deep.yml", "%YAML:1.0\n---\n" + "- " * 50_000, "nested"),
        ("deep.yml", "%YAML:1.0\n---\n" + "".join(" " * i + "a:\n" for i in range(500)), "nested"),
        ("deep.xml", "<opencv_storage>" + "<a>" * 50_000 + "</a>" * 50_000 + "</opencv_storage>", "nested"),
        ("open.yml", 'a: "text\n', "no closing quote"),
        ("open.yml", "K" + " " * 100_000 + "x\n", "no `key: value`|no camera"),
    ],
)
def test_yaml_and_xml_that_opencv_hangs_or_crashes_on_are_refused(tmp_path: Path, name: str, text: str, why: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(AsterismError, match=why) as caught:
        read_rig(path)
    assert name in str(caught.value)


def _written_by_opencv(suffix: str) -> str:
    import cv2

    file = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    file.write("K", np.array([[1234.567890123456, 0, 1e-300], [np.nan, np.inf, -np.inf], [-0.0, 5, 1e300]]))
    file.write("whole", np.arange(60, dtype=np.int32).reshape(6, 10))
    for key, value in (
        ("n", 3),
        ("x", 2.5),
        ("s", "hello world"),
        ("q", 'a "quoted" \\ [x]: {y} # no'),
        ("digits", "123"),
        ("yes", "true"),
    ):
        file.write(key, value)
    file.startWriteStruct("names", cv2.FileNode_SEQ)
    for text in ("cam 1", "left", "3", "a,b", "it's"):
        file.write("", text)
    file.endWriteStruct()
    file.startWriteStruct("numbers", cv2.FileNode_SEQ | cv2.FileNode_FLOW)
    for number in (1, 2.5, -3e-7):
        file.write("", number)
    file.endWriteStruct()
    file.startWriteStruct("map", cv2.FileNode_MAP)
    file.write("a", 1)
    file.endWriteStruct()
    return str(file.releaseAndGetString())


def _plain_by_opencv(text: str) -> dict[str, Any]:
    import cv2

    def plain(node: Any) -> Any:
        if node.isMap():
            return {key: plain(node.getNode(key)) for key in node.keys()}  # noqa: SIM118
        if node.isSeq():
            return [plain(node.at(i)) for i in range(node.size())]
        return node.string() if node.isString() else float(node.real())

    file = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    root = file.root()
    return {key: plain(root.getNode(key)) for key in root.keys()}  # noqa: SIM118


_BY_HAND = (
    "%YAML:1.0\n---\ncamera_matrix:\n  rows: 1\n  cols: 3\n  data: [1, 0, 2]\nimage_width: 640\ncamera_name: left\n",
    "%YAML:1.0\n---\n# note\nK: !!opencv-matrix\n   rows: 1\n   cols: 4\n   dt: d\n   data: [ 1., 0.,\n       2., .Nan ]\n"
    "size: [640, 480] # px\n",
    '%YAML:1.0\n---\nimages:\n  - "a.jpg"\n  - "b.jpg"\nflow: {x: 1, y: 2}\nnone: ""\nflag: true\n',
)


@pytest.mark.parametrize("text", [_written_by_opencv(".yml"), _written_by_opencv(".xml"), *_BY_HAND])
def test_our_yaml_and_xml_are_opencvs(text: str) -> None:
    ours = values_of_xml(text) if text.startswith("<") else values_of_yaml(text)
    theirs = _plain_by_opencv(text)
    assert list(ours) == list(theirs)
    for key, value in theirs.items():
        np.testing.assert_equal(ours[key], value, err_msg=key)


def test_real_opencv_files_are_read_as_opencv_reads_them(data: Path) -> None:
    files = [path for suffix in ("yml", "yaml") for path in sorted((data / "cameras").rglob(f"*.{suffix}"))]
    assert files
    for path in files:
        text = path.read_text()
        text = text if text.startswith("%YAML") else f"%YAML:1.0\n---\n{text}"
        np.testing.assert_equal(values_of_yaml(text), _plain_by_opencv(text), err_msg=str(path))


def test_an_image_list_is_read(tmp_path: Path) -> None:
    path = tmp_path / "list.xml"
    path.write_text('<?xml version="1.0"?>\n<opencv_storage>\n<images>\n"left 01.jpg"\nright01.jpg\n</images>\n</opencv_storage>\n')
    assert file_list(path) == ["left 01.jpg", "right01.jpg"]
    with pytest.raises(ValueError, match="nested"):
        values_of_yaml("a: " + "[" * (DEEPEST + 2) + "]" * (DEEPEST + 2))


def _npz(method: int = zipfile.ZIP_DEFLATED, **members: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return out.getvalue()


def _npy(shape: tuple[int, ...], content: bytes = b"", kind: str = "<f8") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": kind, "fortran_order": False, "shape": shape})
    return out.getvalue() + content


@pytest.mark.parametrize(
    ("packed", "why"),
    [
        (lambda: _npz(a=_npy((1 << 26,), bytes(FREE_BYTES + (1 << 24)))), "more than it can"),
        (lambda: _npz(a=_npy((1 << 40,))), "longer than its data"),
        (lambda: _npz(a=_npy((-3,), bytes(24))), "longer than its data"),
        (lambda: _npz(a=_npy((1,), bytes(8), "|O")), "holds objects"),
        (lambda: _npz(zipfile.ZIP_LZMA, a=_npy((1,), bytes(8))), "packed otherwise"),
        (lambda: _npz(a=_npy((1,), bytes(8), "<M8[s]")), "datetime64"),
    ],
)
def test_archives_that_claim_more_than_they_hold_are_refused_before_they_are_unpacked(packed: Callable[[], bytes], why: str) -> None:
    archive = packed()  # the first takes half a second to pack: not for every worker that imports this file
    with pytest.raises(ValueError, match=why):
        arrays_of_npz(archive)


def test_what_packs_extremely_well_is_written_so_that_it_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    npz = import_module("asterism.formats.npz")
    path = tmp_path / "walk.npz"
    empty = asterism.Recording(np.full((2000, 20, 3), np.nan), tuple(f"M{i}" for i in range(20)), 100.0)
    asterism.write(path, empty)
    packed = path.stat().st_size
    monkeypatch.setattr(npz, "most_unpacked", lambda size: 60 * size)
    asterism.write(path, empty)
    assert path.stat().st_size > 20 * packed and len(asterism.read(path)) == 2000


def test_a_long_recording_is_in_memory_a_few_times_only(tmp_path: Path) -> None:
    import tracemalloc

    path = tmp_path / "hour.c3d"
    places = np.random.default_rng(0).normal([0.0, 0.0, 1.0], 0.3, (1, 39, 3))
    drift = np.linspace(0.0, 0.1, 20_000)[:, None, None]
    asterism.write(path, asterism.Recording(places + drift, tuple(f"M{i}" for i in range(39)), 100.0))
    tracemalloc.start()
    recording = asterism.read(path)
    read = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    asterism.write(tmp_path / "again.c3d", recording)
    written = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = path.stat().st_size
    assert read[1] < 6.0 * size, f"reading takes {read[1] / size:.1f} times the file"  # it was 13
    assert written < read[0] + 4.5 * size, f"writing takes {(written - read[0]) / size:.1f} times the file"  # it was 6
    assert (tmp_path / "again.c3d").read_bytes() == path.read_bytes()


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


def test_an_image_of_more_pixels_than_any_cameras_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    path.write_bytes(_png(32_000, 32_000))
    with pytest.raises(AsterismError, match=r"large\.png claims to be 32,000 x 32,000 pixels"):
        list(images(open_source(path)))
    path.write_bytes(_png(20, 30))
    assert len(list(images(open_source(path)))) == 1


def test_a_png_with_a_chunk_of_4_gb_is_refused_before_opencv_sees_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes half a minute to find that these bytes are not there."""
    import cv2

    for name in ("imcount", "imdecode"):
        monkeypatch.setattr(cv2, name, lambda *_: pytest.fail("OpenCV was asked"))
    path = tmp_path / "chunk.png"
    content = bytearray(_png(60, 40))
    content[33:37] = b"\xff\x00\x00\x69"
    path.write_bytes(content)
    with pytest.raises(AsterismError, match=r"chunk\.png is damaged: a part of it claims 4,278,190,185 bytes"):
        list(images(open_source(path)))


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "pgm", "tif", "jp2"])
def test_claimed_sizes_are_those_of_the_image(suffix: str) -> None:
    import cv2

    _, content = cv2.imencode(f".{suffix}", np.random.default_rng(0).integers(0, 255, (37, 53), dtype=np.uint8))
    assert claimed_size(content.ravel()) == (53.0, 37.0)
    for cut in range(0, len(content), 7):
        width, height = claimed_size(content.ravel()[:cut])
        assert 0 <= width * height < MOST_PIXELS


@pytest.mark.parametrize(("suffix", "code"), [("avi", "MJPG")])
def test_a_film_whose_header_claims_two_thousand_million_frames_has_those_it_holds(tmp_path: Path, suffix: str, code: str) -> None:
    import cv2

    path = tmp_path / f"film.{suffix}"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 25.0, (64, 48))
    for _ in range(5):
        film.write(np.zeros((48, 64, 3), np.uint8))
    film.release()
    content = bytearray(path.read_bytes())
    at = content.find(b"avih")
    struct.pack_into("<I", content, at + 8 + 16, 2_000_000_000)
    header = content.find(b"strh")
    struct.pack_into("<I", content, header + 8 + 32, 2_000_000_000)
    path.write_bytes(content)
    assert len(open_source(path)) < 100


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file, and in `_opened` its head and arrays."""
    path = tmp_path_factory.mktemp("model") / "walks.model"
    models.trained(asterism.simulation.simulate_walks(subjects=3, frames=60, rate=50.0), training=models.BRIEF).save(path)
    return path


def _opened(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    import json

    arrays = arrays_of_npz(path.read_bytes())
    return json.loads(arrays.pop("head").tobytes()), arrays


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("markers", np.array([0.5]), "markers has float64"),
        ("body_mean", None, "lacks body_mean"),
        ("body_mean", np.full((1, 15, 3), np.nan), "body_mean has a number"),
        ("body_mean", np.full((1, 15, 3), 1e300), "body_mean has a number"),
        ("body_noise", np.zeros((1, 15, 3, 3)), "no covariance"),
        ("body_noise", np.zeros((1, 14, 3, 3)), "do not fit|shapes"),
        ("body_within", -np.eye(45)[None], "no covariance"),
        ("anchor_triples", np.zeros((40, 3), dtype=np.int64), "marker twice"),
        ("anchor_triples", np.full((40, 3), 99), "shapes"),
        ("markers", np.zeros(15, dtype=np.int64), "learned twice"),
        ("calibration_0", np.array([[1.0, 0.0], [0.5, 0.5]]), "curve of confidence"),
        ("calibration_0", np.array([[0.0, 1.0], [0.5, 7.0]]), "curve of confidence"),
        ("sample_numbers", np.full((3, 6), 1 << 40), "too large|another length"),
        ("sample_rates", np.zeros(6), "frame rate|does not fit"),
        ("sample_planes", np.zeros((4, 3), dtype=np.uint8), "another length"),
    ],
)
def test_a_model_is_checked_before_anything_uses_it(model: Path, tmp_path: Path, name: str, value: Any, why: str) -> None:
    head, arrays = _opened(model)
    arrays[name] = value
    path = tmp_path / "damaged.model"
    write_arrays(path, head, {key: array for key, array in arrays.items() if array is not None})
    with pytest.raises(AsterismError, match=rf"damaged\.model is damaged.*({why})"):
        asterism.MarkerModel.load(path)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"usual_score": "6"}, "usual_score is of another kind"),
        ({"least_confidence": 7.5}, "least_confidence is 7.5"),
        ({"marker_set": {"names": "ABC"}}, "markers are no list"),
        ({"look": {"max_evaluations": 10**13}}, "max_evaluations|holds"),
        ({"look": {"reward": "much"}}, "look.reward is 'much'"),
        ({"look": {"votes_needed": 2.5}}, "look.votes_needed"),
        ({"about": [1]}, "about is of another kind"),
        ({"version": None}, "wrong kind"),
        ({"format": 3}, "no Asterism model"),
    ],
)
def test_the_head_of_a_model_is_checked(model: Path, tmp_path: Path, change: dict[str, Any], why: str) -> None:
    head, arrays = _opened(model)
    (key, value), *_ = change.items()
    head[key] = {**head[key], **value} if isinstance(value, dict) else value
    path = tmp_path / "damaged.model"
    write_arrays(path, head, arrays)
    with pytest.raises(AsterismError, match=rf"damaged\.model.*({why})"):
        asterism.MarkerModel.load(path)
    with pytest.raises(AsterismError):
        asterism.labelling.training.model_file.describe_model(path) if key != "look" and key != "least_confidence" else _refuse(path)


def _refuse(path: Path) -> None:
    raise AsterismError(f"{path}: described without what it learned.")


def test_a_model_has_at_most_2000_markers(model: Path) -> None:
    head, arrays = _opened(model)
    for count, why in ((2000, "has another length"), (2001, "no list of names")):
        head["marker_set"]["names"] = [f"M{number}" for number in range(count)]
        with pytest.raises(ValueError, match=why):
            check_contents(head, arrays)


def test_damaged_models_are_refused_or_label(model: Path, tmp_path: Path) -> None:
    clouds: Clouds = asterism.simulation.simulate_walks(subjects=1, frames=3, rate=50.0)[0].clouds()
    specimen = specimens_of.Specimen(
        "model", "walks.model", model.read_bytes(), (lambda path: asterism.MarkerModel.load(path).label_frames(clouds),), packed=True
    )
    faults = [fault for number in range(60) for fault in trials.read_copy(number, [specimen], tmp_path / "damaged")]
    assert not faults, faults[:3]
    head, arrays = _opened(model)
    check_contents(head, arrays)
