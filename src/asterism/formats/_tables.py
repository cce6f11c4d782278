"""Shared by readers of tables: lines and columns in; rows of numbers, the rate and frames in their places out."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.text import cells_of, number_of, some_of
from asterism.findings import Finding
from asterism.formats._findings import cut_off, frame_numbers, moved_cells, rate_conflict, short_rows
from asterism.recording import Floats
from asterism.recording.arrays import nan_median
from asterism.recording.display import counted

_QUOTED = re.compile(r'"([^"\n]*)"')
_COMMA, _POINT = re.compile(r"\d,\d"), re.compile(r"\d\.\d")
_COMMA_FIRST = re.compile(r"\d,\d+[.,]\d")
_POINT_FIRST = re.compile(r"\d\.\d+[.,]\d")
_NO_THOUSANDS = {
    sign: re.compile(rf"\d{{4}}{other}|{other}(?!\d{{3}}(?!\d))\d|(?<![\d,.])0\d*{other}") for sign, other in ((",", ","), (".", r"\."))
}
"""What no separator of thousands has: four digits before it, other than three behind it, or a number that begins with zero."""


def lead_of(columns: Sequence[int], width: int) -> int | None:
    """How many columns stand before the coordinates where those fill a table of `width` columns side by side to its end; else None."""
    return columns[0] if list(columns) == list(range(width - len(columns), width)) else None


def rows_of_numbers(
    path: Path,
    lines: Sequence[str],
    first_line: int,
    delimiter: str | None,
    width: int,
    lead: int | None = None,
    least: int | None = None,
    stop: int | None = None,
) -> tuple[Floats, list[Finding]]:
    """The numbers of a table: (rows, width), NaN where a cell is blank or a row is short; and findings.

    lines       the data lines; blank ones are skipped
    first_line  the number in the file of lines[0], counted from 1, for messages
    delimiter   what separates the header's cells; where the data lines are separated otherwise, theirs is taken (`separator_of`)
    lead        how many columns stand before the coordinates, where all others are x, y, z of one point after the other; then a row
                whose cells have moved is found, and its points are taken as missing
    least       how many cells a row has at least; by default, all of them
    stop        where the coordinates end, by default with the row; columns behind them are never blank

    A comma is the decimal sign where it does not separate cells. Raises AsterismError, naming line and column, where a cell is not a
    number, a row is too long, or the decimal sign cannot be told.
    """
    kept = [i for i, line in enumerate(lines) if line.strip(' \t,;"')]
    out = np.full((len(kept), width), np.nan)
    delimiter = separator_of(lines[kept[0]], delimiter) if kept else delimiter
    with_point = decimal_points(path, lines, delimiter)
    counts = np.zeros(len(kept), dtype=np.int64)
    blank = float("nan")
    for row, i in enumerate(kept):
        line = lines[i]
        # Splitting by hand is many times faster; quotes need the careful way.
        if '"' not in line:
            cells = (line if with_point is None else with_point(line)).split(delimiter)
        else:
            cells = cells_of(line, delimiter)
            cells = cells if with_point is None else [with_point(cell) for cell in cells]
        counts[row] = len(cells)
        if len(cells) > width:
            # Blank cells at the end are what spreadsheets leave behind.
            if any(cell.strip() for cell in cells[width:]):
                raise AsterismError(
                    f"{path}, line {first_line + i}: {len(cells)} cells where the header has {width}; correct this line or the header."
                )
            cells = cells[:width]
        try:
            # Python reads 1_000 as a number, which no program writes.
            if "_" in line:
                raise ValueError
            out[row, : len(cells)] = [float(cell) if cell else blank for cell in cells]
        except ValueError:
            # Only a line that failed is read cell by cell, so that the message can name the place.
            for column, cell in enumerate(cells):
                number = number_of(cell)
                if number is None:
                    raise AsterismError(
                        f"{path}, line {first_line + i}, column {column + 1}: {cell.strip()[:30]!r} is not a number; correct or blank it."
                    ) from None
                out[row, column] = number
    line_numbers = [first_line + i for i in kept]
    short = counts < (width if least is None else least)
    # Without its end, the last line belongs to a file that was cut off, and its cells are in their places.
    cut = len(kept) > 0 and kept[-1] == len(lines) - 1
    moved = np.zeros(len(kept), dtype=np.bool_)
    end = width if stop is None else stop
    if lead is not None and (end - lead) % 3 == 0:
        moved = _moved_rows(out[:, lead:end], counts) | (short & (delimiter is None or end < width))
        moved[-1:] &= not (cut and short[-1])
        out[moved, lead:] = np.nan
    findings = []
    # A line that was cut off may end within a number, which then reads as another one.
    if cut and len(kept) > 1 and _cut_short(lines[kept[-1]], lines[kept[-2]], delimiter):
        findings.append(cut_off("the file ends within a line; what the last number of its last line belongs to is taken as missing"))
        last = int(np.nonzero(~np.isnan(out[-1]))[0][-1:].max(initial=0))
        out[-1, last if lead is None or last < lead else lead + (last - lead) // 3 * 3 :] = np.nan
    if moved.any():
        where = _some_lines(line_numbers, moved)
        findings.append(moved_cells(f"{where}: cells are missing or too many, so that the others have moved; their points are missing"))
    if (short & ~moved).any():
        findings.append(
            short_rows(f"{_some_lines(line_numbers, short & ~moved)}: fewer cells than the header has; the rest is taken as missing")
        )
    return out, findings


def _moved_rows(coordinates: Floats, counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(rows,) whether cells of a row stand in other columns than their own, because a separator was lost or doubled.

    Such a row has another number of cells (`counts`) than most rows, and a point with one or two of its three coordinates: with a
    separator too many a blank cell comes between, and with one too few the last point lacks a coordinate.
    """
    if not len(coordinates):
        return np.zeros(0, dtype=np.bool_)
    present = (~np.isnan(coordinates)).reshape(len(coordinates), -1, 3).sum(axis=2)
    parts: NDArray[np.bool_] = ((present == 1) | (present == 2)).any(axis=1)
    return parts & (counts != np.bincount(counts).argmax())


def _cut_short(last: str, above: str, delimiter: str | None) -> bool:
    """Whether a last line without its end has fewer cells, or fewer decimals in its last one, than the line above."""
    cells, cells_above = cells_of(last, delimiter), cells_of(above, delimiter)
    if len(cells) < len(cells_above):
        return any(cells_above[len(cells) :])
    decimals = [len(row[-1].replace(",", ".").partition(".")[2]) for row in (cells, cells_above)]
    return len(cells) == len(cells_above) and bool(cells[-1]) and cells[-1].casefold() != "nan" and decimals[0] < decimals[1]


def _some_lines(line_numbers: Sequence[int], which: NDArray[np.bool_]) -> str:
    places = np.nonzero(which)[0]
    more = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return f"line {line_numbers[int(places[0])]}{more}"


def blanked(lines: Sequence[str], columns: Collection[int], delimiter: str | None) -> list[str]:
    """The lines with blanks in columns that hold words, such as a subject or a time of the day."""
    if not columns or delimiter is None:
        return list(lines)
    return [delimiter.join("" if i in columns else cell for i, cell in enumerate(_bare_cells(line, delimiter))) for line in lines]


def _bare_cells(line: str, delimiter: str) -> list[str]:
    return [f'"{cell}"' if delimiter in cell else cell for cell in cells_of(line, delimiter)] if '"' in line else line.split(delimiter)


def separator_of(line: str, delimiter: str | None) -> str | None:
    """What separates the cells of a data line under a header with that delimiter; None is any blank.

    Some programs write the header with tabs and the numbers with blanks, or the other way round.

    >>> separator_of("1 0,00 -12,5", "\\t"), separator_of("1,0.00,-12.5", None)
    (None, ',')
    """
    if delimiter is not None and delimiter in line:
        return delimiter
    cells = line.split()
    for candidate in "\t;":
        if candidate in line:
            return candidate
    # A comma within a number is a decimal sign, one behind a number separates.
    return None if "," not in line or (len(cells) > 1 and all(number_of(cell) is not None for cell in cells)) else ","


def decimal_points(path: Path, lines: Sequence[str], delimiter: str | None) -> Callable[[str], str] | None:
    """What turns the numbers of a table into ones with a decimal point, or None where they have it.

    Only a comma that does not separate cells is looked at: beside tabs, semicolons and blanks, or within quotes. It is the decimal sign,
    or separates thousands (1,234.5). Raises AsterismError, naming the file, where the numbers do not show which.
    """
    if not any('"' in line for line in lines) if delimiter == "," else not any("," in line for line in lines):
        return None
    text = "\n".join(lines)
    if delimiter == ",":
        text = "\n".join(_QUOTED.findall(text))
    if not _COMMA.search(text):
        return None
    # What is rarely there is looked for last: a long table is searched to its end then.
    thousands = _NO_THOUSANDS[","].search(text) is None
    if thousands and _COMMA_FIRST.search(text):
        return lambda part: part.replace(",", "")
    point = _POINT.search(text) if "." in text else None
    if point is not None and _NO_THOUSANDS["."].search(text) is None and _POINT_FIRST.search(text):
        return lambda part: part.replace(".", "").replace(",", ".")
    # A comma before three digits each time may be either, and a wrong choice would be wrong a thousandfold.
    if point is None and not thousands:
        return lambda part: part.replace(",", ".")
    cells = re.split(r"[\s;]+", text)
    shown = [next((cell[:30] for cell in cells if sign.search(cell)), "") for sign in (_COMMA, _POINT)]
    raise AsterismError(
        f"{path}: its numbers ({some_of(list(filter(None, shown)))}) do not show whether a comma is the decimal sign "
        "or separates thousands; export it again with decimal points."
    )


def lines_in_order(values: Floats, numbers: Floats) -> tuple[Floats, list[Finding]]:
    """The lines (T, C) of a table in the order of their frame numbers (T,), those that stand there again once; and a finding.

    Lines of one number that differ are of two recordings: then all stay as they are, and so where a number is missing.
    """
    if len(numbers) < 2 or not np.isfinite(numbers).all() or (np.diff(numbers) > 0).all():
        return values, []
    order = np.argsort(numbers, kind="stable")
    again = np.concatenate([[False], np.diff(numbers[order]) == 0])
    first, second = values[order[:-1]][again[1:]], values[order[1:]][again[1:]]
    if not np.array_equal(first, second, equal_nan=True):
        return values, []
    twice, said = int(again.sum()), list[str]()
    if twice:
        said.append(f"{counted(twice, 'line')} of frames that are there already {'was' if twice == 1 else 'were'} left out")
    if (np.diff(order[~again]) < 0).any():
        said.append("the lines are not in the order of their frames, and were put into it")
    return values[order[~again]], [frame_numbers("; ".join(said))]


def rate_of(path: Path, declared: float | None, times: Floats | None, findings: list[Finding]) -> float:
    """Frames per second by the header (`declared`) and the time column; where they differ, one more finding goes into `findings`.

    An evenly spaced time column takes precedence over the header, because it belongs to these samples.
    Raises AsterismError where neither gives a rate.
    """
    timed, agrees = _timed_rate(times, declared)
    good = declared is not None and np.isfinite(declared) and 0 < declared < 1e6
    if good and declared is not None and (agrees or timed is None):
        return float(declared)
    if timed is None and times is not None and not len(times):
        raise AsterismError(f"{path} has no frame below its header; export it again.")
    if timed is None and times is not None:
        raise AsterismError(f"{path}: its times are not even steps and give no rate; correct them, or add the rate to its header.")
    if timed is None:
        raise AsterismError(f"{path} does not say how many frames per second it has; add the rate to its header or a time column.")
    # Both are given and differ: the samples' own times are right, and a person should know.
    if good:
        findings.append(
            rate_conflict(f"the header says {declared:g} frames per second, the time column {timed:.6g}; the rate is the latter")
        )
    return timed


def _timed_rate(times: Floats | None, declared: float | None) -> tuple[float | None, bool]:
    """The rate of evenly spaced times, else None; and whether `declared` agrees with them within their printed digits."""
    if times is None or len(times) < 2 or not (np.abs(times) < 1e9).all():
        return None, False
    span, steps = float(times[-1] - times[0]), np.diff(times)
    # Printed times are rounded: their last digit is how far they may be off.
    digit = next((10.0**-d for d in range(7) if np.allclose(np.round(times, d), times, rtol=0, atol=1e-9)), 1e-6)
    usual = float(nan_median(steps, axis=0))
    # A step of several frames is one from which lines were left out.
    counts = np.maximum(np.round(steps / usual), 1.0) if np.isfinite(usual) and usual > 1e-6 else np.ones(len(steps))
    mean = span / float(counts.sum())
    # Uneven times are no clock.
    if not np.isfinite(span) or mean < 1e-6 or np.abs(steps - counts * mean).max() > 1.01 * digit + 0.02 * mean:
        return None, False
    agrees = declared is not None and declared > 0 and abs(float(counts.sum()) / declared - span) <= 1.01 * digit + 1e-4 * span
    return float(f"{1.0 / mean:.6g}"), agrees


def frames_of(times: Floats, rate: float) -> Floats:
    """(T,) the frame numbers, from 0, that evenly spaced times (s) stand for; else one after the other."""
    if not np.isfinite(times).all() or not np.isfinite(rate):
        return np.arange(float(len(times)))
    numbers = np.round((times - times[:1]) * rate)
    # Times that rise by less than a frame are no clock of the frames; times that fall are lines out of order.
    return np.arange(float(len(times))) if (np.diff(numbers) < 1).any() and (np.diff(times) > 0).all() else numbers


def frames_in_place(frames: Floats, rows: Floats) -> tuple[Floats, int, list[Finding]]:
    """Rows (T, ...) with NaN rows inserted where frame numbers are left out, the first frame's number, and findings."""
    known = np.isfinite(frames)
    if not known.any():
        return rows, 1, []
    # A row without a number stands between its neighbours where the numbers count the rows.
    counted = np.arange(float(len(frames))) + (frames[known][0] - np.nonzero(known)[0][0])
    if not known.all() and (frames[known] == counted[known]).all():
        frames = counted
    # Frame numbers with fractions are something else, such as times.
    numbers = np.round(np.where(np.isfinite(frames), frames, 0.0))
    if (numbers != frames).any() or (np.abs(numbers) > 2**31).any():
        return rows, 1, []
    first = int(numbers[0])
    steps = np.diff(numbers)
    if len(steps) == 0 or (steps[0] > 0 and (steps == steps[0]).all()):
        return rows, first, []
    span = int(numbers[-1] - numbers[0]) + 1
    # A jump back, or a huge gap, is damage or a joined file: filling it would cost memory for nothing.
    if (steps < 1).any() or span > 4 * len(frames) + 1000:
        return rows, first, [frame_numbers("the frame numbers do not rise one by one; the lines were taken in their order")]
    filled = np.full((span, *rows.shape[1:]), np.nan)
    filled[(numbers - numbers[0]).astype(np.int64)] = rows
    return filled, first, [frame_numbers(f"{span - len(frames)} frames are left out in the file; they were inserted as missing")]
