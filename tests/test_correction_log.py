"""The log of corrections: cut off anywhere, moved, changed or begun twice, no answer that was acknowledged is in no file."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from asterism.errors import AsterismError
from asterism.labelling.correction import CorrectionLog

ENTRIES = [{"kind": "ghost", "cuts": [], "labels": [], "number": number} for number in range(3)]


def whole_log(path: Path) -> bytes:
    """A log of three entries, of the recording "a" and the model "b"."""
    log = CorrectionLog(path, "a", "b")
    for entry in ENTRIES:
        log.append(entry)
    log.close()
    return path.read_bytes()


def numbers(log: CorrectionLog) -> list[int]:
    return [entry["number"] for entry in log.entries]


def read_and_continued(path: Path) -> tuple[list[int], list[int]]:
    """Which entries a log gives, and which it gives after two more were added by two programs."""
    first = CorrectionLog(path, "a", "b")
    first.append({**ENTRIES[0], "number": 7})
    first.close()
    second = CorrectionLog(path, "a", "b")
    second.append({**ENTRIES[0], "number": 8})
    second.close()
    last = CorrectionLog(path, "a", "b")
    last.close()
    return numbers(first), numbers(last)


def test_a_log_that_is_cut_off_anywhere_is_read_and_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda file: None)  # the power stays on: a disk takes 5 ms for each
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    whole = whole_log(path)
    ends = [match.end() for match in re.finditer(rb"\n", whole)][1:]
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        # An entry is whole without its end of line.
        expected = [number for number, end in enumerate(ends) if length >= end - 1]
        assert read_and_continued(path) == (expected, [*expected, 7, 8]), length


@pytest.mark.parametrize(
    "change",
    [
        lambda whole: whole.replace(b"\n", b"\n\n"),
        lambda whole: whole.replace(b"\n", b"\r\n"),
        lambda whole: b"\n" + whole,
        lambda whole: whole + b"\n \n\n",
        lambda whole: whole + b"\0" * 600,
        lambda whole: whole.rstrip(b"\n") + b"\0" * 600,
        lambda whole: b"\xef\xbb\xbf" + whole,
        # as earlier versions left them where the last line had lost its end
        lambda whole: whole.replace(
            b'\n{"kind":"ghost","cuts":[],"labels":[],"number":2', b'\0{"kind":"ghost","cuts":[],"labels":[],"number":2'
        ),
    ],
    ids=["blank lines", "CRLF", "blank first", "blanks behind", "zeros behind", "zeros for the end", "byte order mark", "zero between"],
)
def test_what_is_no_entry_in_a_log_is_passed_over(change: Callable[[bytes], bytes], tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    path.write_bytes(change(whole_log(path)))
    assert read_and_continued(path) == ([0, 1, 2], [0, 1, 2, 7, 8])


def test_a_log_is_written_with_the_first_answer_not_on_opening(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    CorrectionLog(path, "a", "b").close()
    assert not path.exists()
    whole = whole_log(path)
    path.write_bytes(whole[:-9])
    CorrectionLog(path, "a", "b").close()
    assert path.read_bytes() == whole[:-9]


@pytest.mark.skipif(os.name != "posix", reason="an open file cannot be moved on Windows")
@pytest.mark.parametrize("lost", ["deleted", "moved", "its folder moved back", "copied back", "time changed"])
def test_a_log_that_is_moved_under_its_program_is_written_again(lost: str, tmp_path: Path) -> None:
    path = tmp_path / "logs" / "walk.c3d.asterism-log.jsonl"
    path.parent.mkdir()
    log = CorrectionLog(path, "a", "b")
    for entry in ENTRIES:
        log.append(entry)
        if lost == "deleted":
            path.unlink()
        elif lost == "moved":
            path.rename(tmp_path / f"moved{entry['number']}.jsonl")
        elif lost == "its folder moved back":
            path.parent.rename(tmp_path / "elsewhere").rename(path.parent)
        elif lost == "copied back":
            path.rename(tmp_path / "copy")
            path.write_bytes((tmp_path / "copy").read_bytes())
        else:
            os.utime(path, ns=(0, 0))
    # Also what was answered before the last move is in the file at the end.
    log.close()
    again = CorrectionLog(path, "a", "b")
    again.close()
    assert numbers(again) == [0, 1, 2]


@pytest.mark.parametrize("other", [b"", b"notes\n", b"other log", b"cut"])
def test_a_log_that_another_program_changed_takes_no_answer_and_keeps_those_before(other: bytes, tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    whole = whole_log(path)
    log = CorrectionLog(path, "a", "b")
    log.append({**ENTRIES[0], "number": 7})
    mine = path.read_bytes()
    content = whole.replace(b'"points":"a"', b'"points":"z"') if other == b"other log" else mine[:-90] if other == b"cut" else other
    path.write_bytes(content)
    for _ in range(2):
        with pytest.raises(AsterismError, match=r"changed or replaced by another program.*was not taken.*log-2.jsonl"):
            log.append(ENTRIES[1])
    log.close()
    kept = tmp_path / "walk.c3d.asterism-log-2.jsonl"
    assert kept.read_bytes() == mine and path.read_bytes() == content and len(list(tmp_path.iterdir())) == 2


def test_a_log_that_another_program_continued_keeps_what_both_wrote(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    whole = whole_log(path)
    log = CorrectionLog(path, "a", "b")
    with path.open("ab") as file:
        file.write(whole[whole.index(b"\n") + 1 :])
    with pytest.raises(AsterismError, match="what both have written is in the file"):
        log.append(ENTRIES[1])
    log.close()
    assert read_and_continued(path)[0] == [0, 1, 2, 0, 1, 2]


def test_of_two_programs_that_begin_a_log_one_is_told(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    first, second = CorrectionLog(path, "a", "b"), CorrectionLog(path, "a", "b")
    first.append(ENTRIES[0])
    with pytest.raises(AsterismError, match="begun by another program"):
        second.append(ENTRIES[1])
    first.append(ENTRIES[2])
    first.close()
    assert read_and_continued(path)[0] == [0, 2]


@pytest.mark.skipif(os.name != "posix", reason="devices and pipes of POSIX")
def test_a_log_that_is_no_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    for target, kind in (("/dev/null", "device"), ("/dev/full", "device"), (tmp_path / "pipe", "pipe"), (tmp_path / "none", "link")):
        if kind == "pipe":
            os.mkfifo(target)
        path.symlink_to(target)
        with pytest.raises(AsterismError, match=kind):
            CorrectionLog(path, "a", "b")
        path.unlink()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"notes", "no log of corrections"),
        (b'{"format":"asterism-corrections","vers\n{"kind":"undo"}\n', "no log of corrections"),
        (b"[]\n", "no log of corrections"),
        (b"\xff\xfe\0\0", "no log of corrections"),
        (b'{"format":"asterism-corrections","version":99}\n', "later Asterism"),
        (b"[" * 100_000, "no log of corrections"),
    ],
)
def test_a_damaged_head_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.asterism-log.jsonl"
    path.write_bytes(content)
    with pytest.raises(AsterismError, match=said):
        CorrectionLog(path, "a", "b")
    assert path.read_bytes() == content


def test_a_log_in_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AsterismError, match="another folder with --log-folder"):
        CorrectionLog(tmp_path / "no such folder" / "walk.jsonl", "a", "b")
