"""The list of questions as a table that a person fills in, and the answers in it as touches."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.correction.correct import Correction
from asterism.labelling.correction.pieces import described, point_of_piece
from asterism.labelling.correction.touches import PointInFrame, Touch
from asterism.labelling.review import ReviewItem
from asterism.recording import NULL

COLUMNS = (
    "file",
    "recording",
    "piece",
    "point",
    "label",
    "confidence",
    "alternatives",
    "first_frame",
    "last_frame",
    "look_at",
    "samples",
    "gain",
    "answer",
)
_CUT = re.compile(r"\bcut\s*@\s*(\d+)", re.IGNORECASE)
_SWAP = re.compile(r"swap\s*@\s*(\d+)\s+with\s+(.+)", re.IGNORECASE)
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a cell must not begin with: spreadsheets take it for a formula."""
_MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class Answer:
    """One line of a filled table.

    line       its number in the table
    file       the recording's file, as the table names it
    recording  the mark of the recording's points, see `recording_mark`
    piece      the id of the piece
    text       what the person wrote
    """

    line: int
    file: str
    recording: str
    piece: int
    text: str


def recording_mark(correction: Correction) -> str:
    """A short mark of a recording's points; never a number to a spreadsheet."""
    return f"points-{correction.identity[0][:12]}"


def question_row(file: str, correction: Correction, item: ReviewItem) -> list[str]:
    """One line of the table, its answer empty; frames as the file numbers them."""
    first_frame, column = correction.recording.first_frame, int(correction.clouds.columns[item.points[0]])
    cells = [
        file,
        recording_mark(correction),
        str(int(item.points[0])),
        correction.recording.labels[column] if column >= 0 else "",
        item.marker or "",
        f"{item.confidence:.4f}",
        ", ".join(f"{name} {chance:.2f}" for name, chance in item.alternatives),
        str(item.first_frame + first_frame),
        str(item.last_frame + first_frame),
        str(item.frame + first_frame),
        str(item.samples),
        f"{item.gain:.1f}",
        "",
    ]
    # An apostrophe keeps a name such as =A1 from being run as a formula.
    return [f"'{cell}" if cell.startswith(_FORMULA) else cell for cell in cells]


def table_text(rows: Sequence[Sequence[str]]) -> str:
    """The table as CSV, with its header and the mark by which spreadsheets know UTF-8."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return "\ufeff" + text.getvalue()


def read_answers(path: Path) -> list[Answer]:
    """The answers of a filled table, separated by commas, semicolons or tabs; lines without an answer are left out.

    Raises AsterismError where the file cannot be read, is no such table, or a line is damaged.
    """
    rows = _rows(path)
    header = [cell.strip().lower() for cell in rows[0]] if rows else []
    absent = [name for name in ("file", "recording", "piece", "answer") if name not in header]
    if absent:
        raise AsterismError(f"{path} has no column {absent[0]}; fill in the table that `asterism review --csv` writes.")
    # Columns are found by name: spreadsheets move them.
    at = {name: header.index(name) for name in header}
    answers = []
    for line, cells in enumerate(rows[1:], 2):
        # A row may be short: spreadsheets drop empty cells at its end.
        row = {name: _unescaped(cells[place]) if place < len(cells) else "" for name, place in at.items()}
        if not row["answer"]:
            continue
        # A spreadsheet may have turned the number into 1.2E+05, which names no piece.
        if not re.fullmatch(r"\d{1,18}", row["piece"]):
            raise AsterismError(f"{path}, line {line}: the column piece is {row['piece'][:40]!r}, which is no piece's number; restore it.")
        answers.append(Answer(line, row["file"], row["recording"], int(row["piece"]), row["answer"]))
    return answers


def touches_of(answers: Sequence[Answer], correction: Correction) -> list[Touch]:
    """What answers say about a recording on which nothing was said yet.

    An answer is a marker, `ghost`, `right`, `cut@FRAME` with, if wanted, such answers for the two parts before and behind it, or
    `swap@FRAME with POINT`: from this frame on, the piece and that point, or marker, carry each other's labels.
    Raises AsterismError, naming the line, where an answer belongs to another recording or cannot be understood.
    """
    mark, touches = recording_mark(correction), []
    for answer in answers:
        # The table was written for other points, so that its numbers would name other pieces.
        if answer.recording != mark:
            raise AsterismError(
                f"line {answer.line}: the answer belongs to another recording than {Path(answer.file).name} is now; "
                "list the questions again with `asterism review --csv`."
            )
        try:
            touches += _touches_of_answer(answer, correction)
        except AsterismError as problem:
            raise AsterismError(f"line {answer.line}: {problem}") from problem
    return touches


def _touches_of_answer(answer: Answer, correction: Correction) -> list[Touch]:
    place = correction.pieces.place_of(answer.piece)
    swap = _SWAP.fullmatch(answer.text)
    if swap:
        return [_swap(correction, place, int(swap[1]) - correction.recording.first_frame, swap[2].strip())]
    # `A cut@12 B` splits into the answer before, the frame, and the answer behind.
    texts = _CUT.split(answer.text)
    frames = [int(frame) - correction.recording.first_frame for frame in texts[1::2]]
    first, last = int(correction.pieces.first[place]), int(correction.pieces.last[place])
    # Frames at or before the first one would leave an empty part.
    if any(not first < frame <= last for frame in frames) or sorted(set(frames)) != frames:
        begin = correction.recording.first_frame
        raise AsterismError(f"{answer.text[:60]!r} does not cut frames {first + begin} to {last + begin} in their order.")
    touches = [Touch("cut", (_point(correction, place, frame),)) for frame in frames]
    # A part without an answer stays open: cutting alone is an answer.
    for frame, text in zip([first, *frames], texts[0::2], strict=True):
        if text.strip():
            kind, marker = _said(text.strip(), correction, place)
            touches.append(Touch(kind, (), ((_point(correction, place, frame), marker),)))
    return touches


def _said(text: str, correction: Correction, place: int) -> tuple[str, str | None]:
    """The kind of an answer on one piece or part of one, and its marker."""
    # A marker may be called Ghost: the set's own names come before the words.
    if text in correction.names:
        return "name", text
    if text.lower() == "ghost":
        return "ghost", None
    if text.lower() == "right":
        marker = int(correction.pieces.marker[place])
        return "right", correction.names[marker] if marker != NULL else None
    return "name", _marker_of(text, correction)


def _marker_of(text: str, correction: Correction) -> str:
    found = np.nonzero(correction.marker_set.columns_of((text,)) >= 0)[0]
    if not len(found):
        raise AsterismError(
            f"{text[:60]!r} is no answer; give a marker ({', '.join(correction.names[:4])}, ...), ghost, right, "
            "cut@FRAME or swap@FRAME with POINT."
        )
    return correction.names[int(found[0])]


def _swap(correction: Correction, place: int, frame: int, name: str) -> Touch:
    """From a frame on, a piece and another one, given by its name in the file or by its label, carry each other's labels."""
    pieces, clouds = correction.pieces, correction.clouds
    if not pieces.first[place] <= frame <= pieces.last[place]:
        raise AsterismError(f"the piece is not there in frame {frame + correction.recording.first_frame}; give a frame of its own.")
    begin, end = clouds.offsets[frame : frame + 2]
    columns, labels = clouds.columns[begin:end], correction.recording.labels
    # The name of a point in the file comes first: a person reads it in their own program.
    there = [int(pieces.of_point[begin + n]) for n in range(end - begin) if columns[n] >= 0 and labels[columns[n]] == name]
    if not there:
        marker = correction.names.index(_marker_of(name, correction))
        row = correction.labelling.indices[frame, marker]
        there = [int(pieces.of_point[begin + row])] if row >= 0 else []
    if not there:
        raise AsterismError(f"no point {name[:60]!r} is there in frame {frame + correction.recording.first_frame}.")
    return correction.swap_from((place, there[0]), frame)


def _point(correction: Correction, place: int, frame: int) -> PointInFrame:
    return described(point_of_piece(correction.pieces, correction.clouds, place, frame), correction.clouds)


def _rows(path: Path) -> list[list[str]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise AsterismError(f"{path} is too large for a table of answers; give the one that `asterism review --csv` wrote.")
        data = path.read_bytes()
    except OSError as problem:
        raise AsterismError(f"{path} cannot be read ({problem.strerror}); check its name and folder.") from problem
    # Excel saves UTF-16 as "Unicode text".
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    first = text.lstrip("\r\n").split("\n", 1)[0]
    # The header has a separator for each column, so that the commonest one is it.
    delimiter = max(";\t,", key=first.count)
    try:
        return list(csv.reader(io.StringIO(text.replace("\0", ""), newline=""), delimiter=delimiter))
    except csv.Error as problem:
        raise AsterismError(f"{path} is no table of answers ({problem}); fill in the one that `asterism review --csv` writes.") from problem


def _unescaped(cell: str) -> str:
    cell = cell.strip()
    return cell[1:].strip() if cell.startswith("'") and cell[1:].startswith(_FORMULA) else cell
