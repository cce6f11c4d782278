"""Damaged and lying files: one clear sentence or a right answer, never another exception."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.formats import convert, describe, read, read_clouds, read_table, write, write_table
from asterism.formats._mat5 import variables_of
from asterism.formats.csv_long import write_long
from asterism.recording import Clouds, Event, Recording

fuzzed = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])

MOTIVE = (
    "Format Version,1.22,Take Name,x,Export Frame Rate,120.000000,Total Exported Frames,2,Length Units,Meters\n\n"
    ",,Marker,Marker,Marker\n,,LKNE,LKNE,LKNE\n,,1,1,1\n,,Position,Position,Position\nFrame,Time,X,Y,Z\n0,0.0,0.1,0.2,0.3\n1,0.008333,0.1,0.2,0.3\n"
)
NEXUS = (
    "Trajectories\n100\n,,Ann:LKNE,,,Ann:RKNE,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n1,0,1,2,300,4,5,600\n2,0,1,2,300,,,\n"
)
QTM = (
    "NO_OF_FRAMES\t2\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nDATA_INCLUDED\t3D\nMARKER_NAMES\tA\tB\n1\t2\t300\t4\t5\t600\n1\t2\t300\t4\t5\t600\n"
)


def small() -> Recording:
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 1.5, (6, 4, 3))
    positions[2, 1] = np.nan
    return Recording(positions, ("LKNE", "RKNE", "LASI", "*1"), 100.0, events=(Event("kick", 0.02, "Left"),))


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """One good file of each format, by name."""
    folder = tmp_path_factory.mktemp("seeds")
    for suffix in ("trc", "csv", "tsv", "mat", "npz", "sto"):
        write(folder / f"a.{suffix}", small())
    write_long(folder / "long.csv", small())
    write(folder / "clouds.csv", small().clouds())
    write(folder / "clouds.npz", small().clouds())
    (folder / "motive.csv").write_text(MOTIVE)
    (folder / "nexus.csv").write_text(NEXUS)
    (folder / "qtm.tsv").write_text(QTM)
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def taken_or_refused(path) -> None:
    """Reading gives a recording that is sound, or an AsterismError in one line that names the file."""
    for action in (lambda p: read(p, vertical="z"), describe, read_clouds, read_table):
        try:
            result = action(path)
        except AsterismError as problem:
            assert path.name in str(problem)
            assert "\n" not in str(problem)
            assert len(str(problem)) < 600
        else:
            if isinstance(result, Recording):
                assert not np.isinf(result.positions).any()
                assert len(set(map(len, (result.labels, result.positions[0] if len(result) else result.labels)))) == 1
            if isinstance(result, Clouds):
                assert np.isfinite(result.xyz).all()


@fuzzed
@given(
    data=st.data(),
    name=st.sampled_from(
        ["a.trc", "a.csv", "a.tsv", "a.mat", "a.npz", "a.sto", "long.csv", "clouds.csv", "clouds.npz", "motive.csv", "nexus.csv", "qtm.tsv"]
    ),
)
def test_flipped_and_cut_bytes(tmp_path, seeds, data, name):
    content = bytearray(seeds[name])
    for place, value in data.draw(st.lists(st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255)), max_size=6)):
        content[place] = value
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content)))]
    path = tmp_path / name
    path.write_bytes(bytes(content))
    taken_or_refused(path)


CELLS = [
    "",
    "NaN",
    "x",
    "1e308",
    "-1e308",
    "1e999",
    "inf",
    "-",
    "0",
    "999999999999",
    "1,5",
    '"',
    '"a',
    "1_0",
    "\x00",
    "é",
    "-1",
    "1.5.2",
    "1e",
    "é" * 40,
]


@fuzzed
@given(
    data=st.data(),
    name=st.sampled_from(["a.trc", "a.csv", "a.tsv", "a.sto", "long.csv", "clouds.csv", "motive.csv", "nexus.csv", "qtm.tsv"]),
)
def test_cells_lines_and_headers_that_lie(tmp_path, seeds, data, name):
    lines = seeds[name].decode().split("\n")
    for _ in range(data.draw(st.integers(1, 4))):
        row = data.draw(st.integers(0, len(lines) - 1))
        action = data.draw(st.sampled_from(["cell", "drop", "twice", "swap", "longer", "blank"]))
        separator = "\t" if "\t" in lines[row] else ","
        cells = lines[row].split(separator)
        if action == "cell":
            cells[data.draw(st.integers(0, len(cells) - 1))] = data.draw(st.sampled_from(CELLS))
            lines[row] = separator.join(cells)
        elif action == "drop" and len(lines) > 1:
            del lines[row]
        elif action == "twice":
            lines.insert(row, lines[row])
        elif action == "swap":
            other = data.draw(st.integers(0, len(lines) - 1))
            lines[row], lines[other] = lines[other], lines[row]
        elif action == "longer":
            lines[row] += separator + "7"
        elif action == "blank":
            lines[row] = ""
    path = tmp_path / name
    path.write_text("\n".join(lines), encoding="utf-8")
    taken_or_refused(path)


@pytest.mark.parametrize("suffix", ["trc", "csv", "tsv", "mat", "npz", "sto", "mot", "txt", "c3d"])
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n\n",
        b"\x00" * 600,
        bytes(range(256)) * 8,
        b"\xff\xfe",
        b"\xff\xfea",
        b"PK\x03\x04",
        b"MATLAB 5.0 MAT-file",
        b"hello\n",
        b",,,,\n,,,\n",
        b"frame,time,x,y,z\n",
        b"time\n1\n2\n",
        b"endheader\n",
        b"Trajectories\n",
        b"Format Version,1.2",
        b"PathFileType\t4",
        b"MARKER_NAMES\n",
        b"\x89HDF\r\n\x1a\n" + b"\x00" * 100,
        b"DataRate\nNumMarkers\nFrame#\n",
        b'"' * 99,
        b"a\n" * 999,
    ],
    ids=lambda content: repr(content[:12]),
)
def test_garbage_is_refused_in_one_sentence(tmp_path, suffix, content):
    path = tmp_path / f"garbage.{suffix}"
    path.write_bytes(content)
    with pytest.raises(AsterismError, match=r"garbage\.") as caught:
        read(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(AsterismError):
        convert(path, tmp_path / "out.npz")


def test_absent_files_and_folders_are_refused(tmp_path):
    with pytest.raises(AsterismError, match="does not exist"):
        read(tmp_path / "absent.trc")
    (tmp_path / "folder.trc").mkdir()
    with pytest.raises(AsterismError, match="is a folder"):
        read(tmp_path / "folder.trc")


def test_a_word_among_the_numbers_is_named_by_line_and_column(tmp_path, seeds):
    (tmp_path / "walk.trc").write_bytes(seeds["a.trc"].replace(b"\n3\t0.02", b"\n3\tabc", 1))
    with pytest.raises(AsterismError, match=r"walk\.trc, line 9, column 2: 'abc.*' is not a number"):
        read(tmp_path / "walk.trc")


def test_a_row_too_long_is_named(tmp_path, seeds):
    text = seeds["a.csv"].decode().splitlines()
    text[-2] += ",5"
    (tmp_path / "walk.csv").write_text("\n".join(text) + "\n")
    with pytest.raises(AsterismError, match=rf"walk\.csv, line {len(text) - 1}: 15 cells where the header has 14"):
        read(tmp_path / "walk.csv")


@pytest.mark.parametrize("value", ["1e300", "inf", "-inf", "1e308"])
def test_what_cannot_be_a_place_is_missing(tmp_path, seeds, value):
    text = seeds["a.trc"].decode().splitlines()
    cells = text[6].split("\t")
    cells[2] = value
    text[6] = "\t".join(cells)
    (tmp_path / "walk.trc").write_text("\n".join(text) + "\n")
    recording = read(tmp_path / "walk.trc", vertical="z")
    assert np.isnan(recording.positions[0, 0]).all()
    assert np.isfinite(recording.positions[1, 0]).all()


def test_an_npz_that_claims_gigabytes_is_refused_without_them(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 100, 3)})
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        archive.writestr("asterism.npy", header.getvalue() + b"\x00" * 64)
    with pytest.raises(AsterismError, match=r"huge\.npz is damaged"):
        read(tmp_path / "huge.npz")


def test_an_npz_with_pickled_objects_is_refused(tmp_path):
    np.savez(tmp_path / "evil.npz", asterism=1, kind="recording", positions=np.array([{"a": 1}], dtype=object))
    with pytest.raises(AsterismError, match=r"evil\.npz is damaged"):
        read(tmp_path / "evil.npz")


def test_an_npz_of_a_later_version_or_of_others_is_refused(tmp_path):
    np.savez(tmp_path / "later.npz", asterism=99, kind="recording")
    with pytest.raises(AsterismError, match="version 99"):
        read(tmp_path / "later.npz")
    np.savez(tmp_path / "other.npz", positions=np.zeros((3, 3, 3)))
    with pytest.raises(AsterismError, match="none that Asterism wrote"):
        read(tmp_path / "other.npz")


def test_frame_numbers_that_would_need_gigabytes_are_refused(tmp_path):
    (tmp_path / "walk.csv").write_text("# rate=100\nframe,marker,x,y,z\n1,A,0,0,1\n2000000000,A,0,0,1\n")
    with pytest.raises(AsterismError, match="correct the frame column"):
        read(tmp_path / "walk.csv")


def test_a_table_without_time_is_refused(tmp_path):
    (tmp_path / "walk.sto").write_text("x\nendheader\na\tb\n1\t2\n")
    with pytest.raises(AsterismError, match="no column called time"):
        read(tmp_path / "walk.sto")


def test_tables_are_written_under_known_suffixes_only(tmp_path, seeds):
    (tmp_path / "a.sto").write_bytes(seeds["a.sto"])
    with pytest.raises(AsterismError, match=r"as \.mot, \.sto or \.csv"):
        write_table(tmp_path / "table.xyz", read_table(tmp_path / "a.sto"))


@pytest.mark.parametrize("cut", [0.0, 0.3, 0.7, 0.99])
def test_cut_real_files(data, tmp_path, cut):
    (mouse,) = (data / "movement/mouse-qtm").glob("*.mat")
    for source in [*sorted((data / "conformance/trc").glob("*.trc")), *sorted((data / "conformance").glob("*csv/*.csv")), mouse]:
        content = source.read_bytes()
        path = tmp_path / source.name
        path.write_bytes(content[: int(cut * len(content))])
        try:
            found = read(path, vertical="z")
        except AsterismError as problem:
            assert source.name in str(problem)
        else:
            whole = read(source, vertical="z")
            same = min(len(found), len(whole))
            shared = [label for label in found.labels if label in whole.labels]
            mine = found.positions[:same, [found.labels.index(label) for label in shared]]
            theirs = whole.positions[:same, [whole.labels.index(label) for label in shared]]
            wrong = ~np.isnan(mine) & ~np.isclose(mine, theirs, atol=1e-12, equal_nan=True)
            assert not wrong.any(), f"{source.name} cut at {cut}: a wrong number"


def test_mat_files_that_are_no_take_of_qtm_are_refused(tmp_path):
    scipy.io.savemat(tmp_path / "other.mat", {"a": np.eye(3), "b": "text", "c": {"d": 1.0}})
    with pytest.raises(AsterismError, match=r"other\.mat is a MAT file, but not one that QTM exports"):
        read(tmp_path / "other.mat")
    scipy.io.savemat(
        tmp_path / "half.mat", {"a": {"Frames": 3.0, "FrameRate": 100.0, "Trajectories": {"Labeled": {"Data": np.zeros((2, 7, 3))}}}}
    )
    with pytest.raises(AsterismError, match=r"half\.mat: its trajectories are not laid out as QTM does"):
        read(tmp_path / "half.mat")
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file" + b" " * 200)
    with pytest.raises(AsterismError, match=r"new\.mat.*version 7\.3"):
        read(tmp_path / "new.mat")


@pytest.mark.parametrize("compressed", [False, True])
def test_our_mat_reader_agrees_with_scipy(tmp_path, compressed):
    rng = np.random.default_rng(0)
    names = np.array(["a", "bc", "ä"], dtype=object).reshape(1, 3)
    held = {
        "x": rng.normal(size=(2, 3, 4)),
        "n": np.arange(5, dtype=np.uint8),
        "t": "words",
        "c": names,
        "s": {"y": {"z": 2.0}, "e": np.zeros((0, 3))},
    }
    scipy.io.savemat(tmp_path / "a.mat", held, do_compression=compressed)
    found = variables_of((tmp_path / "a.mat").read_bytes())
    np.testing.assert_array_equal(found["x"], held["x"])
    np.testing.assert_array_equal(found["n"], scipy.io.loadmat(tmp_path / "a.mat")["n"])
    assert (found["t"], found["c"]) == ("words", ["a", "bc", "ä"])
    assert found["s"]["y"]["z"] == 2.0
    assert found["s"]["e"].shape == (0, 3)
