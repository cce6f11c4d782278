"""Names, labels and paths of strangers are text only wherever they are shown; files are replaced whole, as they were, or not at all."""

from __future__ import annotations

import errno
import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import asterism
from asterism.cli import _console, main
from asterism.cli._printable import printable
from asterism.errors import AsterismError
from asterism.files import atomic
from asterism.files.atomic import write_atomically
from asterism.files.text import cell_text, name_of_cell
from asterism.formats import read_blobs, read_table, write_blobs, write_table
from asterism.formats.storage import TimeSeriesTable
from asterism.recording import Blobs, Recording
from asterism.report.page import Page, Section, write_page

ESCAPE, LINK, MARKUP, TURNED, FORMULA = "\x1b[31mred", '<a href="http://x">here</a>', "[/x][bold]", "gpj\u202ecod", "=cmd|' /C calc'!A0"
LABELS = ("LKNE", "RKNE", "SACR", "=cmd", "+1+1", "-2+3", "@SUM(A1)", "'quoted")


def _walk(labels: tuple[str, ...] = LABELS) -> Recording:
    rng = np.random.default_rng(0)
    places = rng.normal([0.0, 0.0, 1.0], 0.3, (1, len(labels), 3))
    return Recording(places + rng.normal(0.0, 0.01, (20, len(labels), 3)), labels, 100.0)


@pytest.mark.parametrize("text", [ESCAPE, TURNED, "a\rb", "\x9b31m", "\u2066x\u2069", "\ud8ff", "a\x00b"])
def test_what_a_terminal_would_obey_is_written_out(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable() and "\\" in shown and printable(shown) == shown
    assert printable("Müller 步行 [bold] = a\tb\n") == "Müller 步行 [bold] = a\tb\n"


def test_every_way_to_print_shows_text_only(capsys: pytest.CaptureFixture[str]) -> None:
    name = f"{ESCAPE} {MARKUP} {TURNED}"
    _console.result(name)
    _console.error(name)
    _console.notice(name)
    _console.facts(name, [(name, name)])
    _console.table(name, [name, "n"], [[name, "1"]])
    shown = capsys.readouterr()
    for text in (shown.out, shown.err):
        assert "\x1b" not in text and "\u202e" not in text
        assert text.count("[/x][bold]") == text.count("\\x1b[31mred") > 0


def test_markup_in_a_name_does_not_stop_a_progress_bar(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with _console.progress(MARKUP) as progress:
        assert progress is not None
        progress(0.5, f"{MARKUP} {TURNED}")
        _console.notice(MARKUP, in_progress_line=True)
    assert "\u202e" not in capsys.readouterr().err


def test_labels_in_commands_reach_the_terminal_as_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"walk {MARKUP.replace('/', '')} \u202e.npz"
    asterism.write(path, _walk(("LKNE", ESCAPE, MARKUP, TURNED)))
    assert main(["info", str(path)]) in (0, 1)
    assert main(["convert", str(path), str(tmp_path / f"{TURNED}.trc")]) in (0, 1)
    assert main(["info", str(tmp_path / f"missing \x1b[2J{TURNED}.c3d")]) == 2
    shown = capsys.readouterr()
    assert not {"\x1b", "\u202e"} & set(shown.out + shown.err)
    assert "\\x1b[2J" in shown.err and "\\u202e" in shown.out


def test_names_are_no_markup_in_the_plots_of_a_report(tmp_path: Path) -> None:
    figure = {"data": [{"text": [LINK, np.str_(TURNED)], "name": "a & b", "hovertemplate": "%{y}<br>" + LINK + "<extra></extra>"}]}
    write_page(tmp_path / "page.html", Page(LINK, LINK, {LINK: LINK}, [(LINK, LINK, "")], [Section(LINK, LINK, figure=figure)]))
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert '<a href="http://x"' not in page and 'a href=\\"http://x' not in page.replace("\\u0026lt;", "&lt;").replace("&lt;a", "")
    assert "\\u003cextra>" in page and "\\u003cbr>" in page and "a &amp; b" in page.replace("\\u0026", "&")
    assert "\u202e" not in page


@pytest.mark.parametrize("name", ["walk.csv", "walk.long.csv"])
def test_labels_that_are_formulas_are_no_formulas_in_a_spreadsheet_and_come_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    asterism.write(path, _walk())
    cells = [cell for line in path.read_text().splitlines() if not line.startswith("#") for cell in line.split(",")]
    assert not [
        cell for cell in cells if cell[:1] in ("=", "+", "@") or (cell[:1] == "-" and not cell[1:2].isdigit()) or cell.startswith("-2+")
    ]
    assert sorted(asterism.read(path).labels) == sorted(LABELS)


def test_formulas_stay_what_they_are_in_other_formats_and_in_tables(tmp_path: Path) -> None:
    asterism.write(tmp_path / "walk.c3d", _walk())
    assert asterism.read(tmp_path / "walk.c3d").labels == LABELS
    table = TimeSeriesTable(("=hip", "knee"), np.ones((3, 2)), np.arange(3) / 10)
    for suffix, spelled in (("csv", "'=hip"), ("sto", "\t=hip")):
        write_table(tmp_path / f"angles.{suffix}", table)
        assert spelled in (tmp_path / f"angles.{suffix}").read_text()
        assert read_table(tmp_path / f"angles.{suffix}").names == ("=hip", "knee")
    blobs = Blobs.from_rows([0, 1], [0, 1], [[1.0, 2.0], [3.0, 4.0]], ("=left", "right"))
    write_blobs(blobs, tmp_path / "2d.csv")
    assert "0,'=left,1,2" in (tmp_path / "2d.csv").read_text() and read_blobs(tmp_path / "2d.csv").cameras == ("=left", "right")
    for name in (*LABELS, "'", "''=", "a=b"):
        assert name_of_cell(cell_text(name)) == name


@pytest.fixture
def odd_name(tmp_path: Path) -> Path:
    """A recording whose file's name is not UTF-8, where the file system takes such names."""
    path = tmp_path / os.fsdecode(b"w\xffalk.c3d")
    try:
        path.touch()
    except OSError:
        pytest.skip("this file system takes no names that are not UTF-8")
    asterism.write(path, _walk(("LKNE", "RKNE", "SACR")))
    return path


def test_a_file_name_that_is_not_utf8_survives_every_output(odd_name: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for suffix in ("trc", "csv", "long.csv", "tsv", "mat", "npz", "c3d"):
        assert main(["convert", str(odd_name), str(tmp_path / f"out.{suffix}"), "--json", str(tmp_path / f"{suffix}.json")]) in (0, 1), (
            suffix
        )
        json.loads((tmp_path / f"{suffix}.json").read_text(encoding="utf-8"))
        assert len(asterism.read(tmp_path / f"out.{suffix}")) == 20
    asterism.write(tmp_path / os.fsdecode(b"o\xffut.trc"), asterism.read(odd_name))
    assert main(["info", str(odd_name), "--json", "-"]) in (0, 1)
    write_page(tmp_path / "page.html", Page(str(odd_name), "", {"file": str(odd_name)}, []))
    assert "w?alk" in (tmp_path / "page.html").read_text(encoding="utf-8") or "w\ufffdalk" in (tmp_path / "page.html").read_text(
        encoding="utf-8"
    )
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="permissions and links of POSIX")
def test_a_replaced_file_keeps_its_permissions_and_a_link_its_target(tmp_path: Path) -> None:
    path, link = tmp_path / "private.npz", tmp_path / "link.npz"
    path.write_bytes(b"old")
    path.chmod(0o600)
    link.symlink_to(path)
    assert main(["convert", str(_written(tmp_path / "walk.c3d")), str(link), "--overwrite"]) in (0, 1)
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o600 and len(asterism.read(path)) == 20
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "new.csv", b"1")
    finally:
        os.umask(before)
    assert (tmp_path / "new.csv").stat().st_mode & 0o777 == 0o640
    dangling = tmp_path / "dangling.csv"
    dangling.symlink_to(tmp_path / "target.csv")
    write_atomically(dangling, b"2")
    assert dangling.is_symlink() and (tmp_path / "target.csv").read_bytes() == b"2"


def _written(path: Path) -> Path:
    asterism.write(path, _walk())
    return path


@pytest.mark.skipif(sys.platform == "win32", reason="whether a program holds a file is not asked there")
def test_what_a_killed_run_left_is_removed_by_the_next_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import fcntl

    source, target = _written(tmp_path / "walk.c3d"), tmp_path / "out[1].trc"
    # Earlier versions named them by their process, which says nothing in a folder that two containers share.
    left = [tmp_path / f".{target.name}.{chance}.part" for chance in ("1", "00c0ffee")]
    held = tmp_path / f".{target.name}.0badcafe.part"
    others = [tmp_path / ".other.trc.00c0ffee.part", tmp_path / f".{target.name}.notes.part", tmp_path / ".out1.trc.1.part"]
    for path in (*left, held, *others):
        path.write_bytes(b"half")
    with held.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(["convert", str(source), str(target)]) in (0, 1)
    assert not any(path.exists() for path in left) and held.exists() and all(path.exists() for path in others)
    error = capsys.readouterr().err
    assert all(f"{path} was left by a run that was killed; it is removed." in error for path in left)
    assert len(asterism.read(target)) == 20


@pytest.mark.skipif(sys.platform == "win32", reason="containers of Linux")
def test_two_writers_of_one_process_number_leave_each_other_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in two containers that share a folder: both are process 1, and neither sees the other's processes."""
    monkeypatch.setattr(os, "getpid", lambda: 1)
    path = tmp_path / "out.csv"

    def pieces() -> Iterator[bytes]:
        yield b"first "
        write_atomically(path, b"other")
        yield b"whole"

    write_atomically(path, pieces())
    assert path.read_bytes() == b"first whole" and list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = []
    replace, fsync = os.replace, os.fsync

    def synced(handle: int) -> None:
        order.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else f"file of {os.fstat(handle).st_size}")
        fsync(handle)

    def renamed(source: Path, target: Path) -> None:
        order.append("name")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    write_atomically(tmp_path / "out.csv", [b"12", b"345"])
    assert order == ["file of 5", "name", *(["folder"] if os.name == "posix" else [])]


@pytest.mark.skipif(os.name != "posix", reason="devices and pipes of POSIX")
@pytest.mark.parametrize("kind", ["device", "pipe"])
def test_a_device_or_pipe_is_neither_read_nor_replaced(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out.csv"
    if kind == "device":
        path.symlink_to("/dev/full")
    else:
        os.mkfifo(path)
    assert main(["convert", str(_written(tmp_path / "walk.c3d")), str(path), "--overwrite"]) == 2
    assert main(["info", str(path)]) == 2
    assert capsys.readouterr().err.count(f"out.csv is a {kind} and no file") == 2
    assert path.is_symlink() if kind == "device" else path.is_fifo()


def test_a_name_as_long_as_can_be_is_written(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 120 + ".csv")
    write_atomically(path, b"1")
    assert path.read_bytes() == b"1" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("number", "sentence"),
    [(errno.ENOSPC, "No space left on device"), (errno.EACCES, "Permission denied"), (errno.EROFS, "Read-only file system")],
)
def test_a_full_disk_and_a_read_only_folder_are_one_sentence_and_leave_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: int, sentence: str
) -> None:
    source, target = _written(tmp_path / "walk.c3d"), tmp_path / "out.trc"
    target.write_bytes(b"old")

    class Full:
        def __init__(self, handle: int, mode: str) -> None:
            self.handle = handle

        def __enter__(self) -> Full:
            return self

        def __exit__(self, *given: object) -> None:
            os.close(self.handle)

        def write(self, data: bytes) -> None:
            os.write(self.handle, data[:10])
            raise OSError(number, os.strerror(number))

        def flush(self) -> None: ...

    monkeypatch.setattr(atomic.os, "fdopen", Full)
    assert main(["convert", str(source), str(target), "--overwrite"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"{target} cannot be written ({sentence})" in error
    assert target.read_bytes() == b"old" and sorted(path.name for path in tmp_path.iterdir()) == ["out.trc", "walk.c3d"]


@pytest.mark.slow
def test_two_writers_of_one_file_leave_one_whole(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from asterism.files.atomic import write_atomically\n"
        "for _ in range(60): write_atomically(Path(sys.argv[1]), sys.argv[2].encode() * 300_000)"
    )
    path = tmp_path / "out.csv"
    writers = [subprocess.Popen([sys.executable, "-c", code, str(path), mark]) for mark in "ab"]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        if path.exists():
            seen.add(path.read_bytes()[:1] + bytes([len(set(path.read_bytes()))]))
    assert [writer.returncode for writer in writers] == [0, 0]
    assert {mark[1] for mark in seen} == {1}, "never a mixture"
    assert len(path.read_bytes()) == 300_000 and list(tmp_path.iterdir()) == [path]


def test_a_batch_survives_whatever_a_file_raises(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    batch = _console.Batch("read")
    problems = (ZeroDivisionError("x"), MemoryError(), RecursionError(), AsterismError("walk.c3d is bad."), None)
    for number, problem in enumerate(problems):
        with batch.file(Path(f"{number}.c3d")):
            if problem:
                raise problem
    assert batch.done == [Path("4.c3d")] and len(batch.failed) == 4 and batch.close() == 1
    error = capsys.readouterr().err
    assert "0.c3d: ZeroDivisionError: x; this is a fault of Asterism, please report it with the file." in error
    assert "walk.c3d is bad.\n" in error and "fault of Asterism" not in error.split("walk.c3d is bad.")[1].split("\n")[0]
    with pytest.raises(KeyboardInterrupt), batch.file(Path("5.c3d")):
        raise KeyboardInterrupt


def test_a_long_quoted_cell_costs_its_own_file_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad, good = tmp_path / "bad.csv", _written(tmp_path / "good.c3d")
    bad.write_text('time,A_x,A_y,A_z\n0,"' + "1" * 200_000 + '",2,3\n')
    assert main(["audit", str(bad), str(good)]) in (1, 2)
    assert main(["info", str(bad), str(good)]) == 1
    shown = capsys.readouterr()
    assert "bad.csv" in shown.err and "good.c3d" in shown.out


def test_a_crash_outside_a_batch_is_said_with_its_place_and_ends_with_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*given: Any) -> None:
        raise ZeroDivisionError("of our own")

    source = _written(tmp_path / "walk.c3d")
    monkeypatch.setattr(asterism.formats, "convert_and_tell", broken)
    assert main(["convert", str(source), str(tmp_path / "out.trc")]) == 2
    error = capsys.readouterr().err
    assert "Traceback" in error and "ZeroDivisionError: of our own; this is a fault of Asterism" in error.splitlines()[-1]
