"""Shared by readers of tables: lines and columns in; rows of numbers, the rate and frames in their places out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.text import cells_of, number_of
from asterism.findings import Finding
from asterism.formats._findings import frame_numbers, rate_conflict, short_rows
from asterism.recording import Floats


def rows_of_numbers(path: Path, lines: Sequence[str], first_line: int, delimiter: str | None, width: int) -> tuple[Floats, list[Finding]]:
    """The numbers of a table: (rows, width), NaN where a cell is blank or a row is short; and findings.

    lines       the data lines; blank ones are skipped
    first_line  the number in the file of lines[0], counted from 1, for messages

    Raises AsterismError, naming line and column, where a cell is not a number or a row is too long.
    """
    kept = [i for i, line in enumerate(lines) if line.strip(' \t,;"')]
    out = np.full((len(kept), width), np.nan)
    # Where semicolons separate cells, a comma is the decimal mark.
    decimal_comma = delimiter == ";"
    short: list[int] = []
    blank = float("nan")
    for row, i in enumerate(kept):
        line = lines[i].replace(",", ".") if decimal_comma else lines[i]
        # Splitting by hand is many times faster; quotes need the careful way.
        cells = line.split(delimiter) if '"' not in line else cells_of(line, delimiter)
        if len(cells) > width:
            # Blank cells at the end are what spreadsheets leave behind.
            if any(cell.strip() for cell in cells[width:]):
                raise AsterismError(
                    f"{path}, line {first_line + i}: {len(cells)} cells where the header has {width}; correct this line or the header."
                )
            cells = cells[:width]
        elif len(cells) < width:
            short.append(row)
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
    more = f" (and {len(short) - 1} more lines)" if len(short) > 1 else ""
    where = [f"line {first_line + kept[row]} has fewer cells than the header; the rest is taken as missing{more}" for row in short[:1]]
    return out, [short_rows(sentence) for sentence in where]


def rate_of(path: Path, declared: float | None, times: Floats | None, findings: list[Finding]) -> float:
    """Frames per second by the header (`declared`) and the time column; where they differ, one more finding goes into `findings`.

    An evenly spaced time column takes precedence over the header, because it belongs to these samples.
    Raises AsterismError where neither gives a rate.
    """
    timed, agrees = _timed_rate(times, declared)
    good = declared is not None and np.isfinite(declared) and 0 < declared < 1e6
    if good and declared is not None and (agrees or timed is None):
        return float(declared)
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
    mean = span / len(steps)
    # Uneven times are no clock, for instance of frames that were left out.
    if not np.isfinite(span) or mean < 1e-6 or np.abs(steps - mean).max() > 1.01 * digit + 0.02 * mean:
        return None, False
    agrees = declared is not None and declared > 0 and abs(len(steps) / declared - span) <= 1.01 * digit + 1e-4 * span
    return float(f"{1.0 / mean:.6g}"), agrees


def frames_in_place(frames: Floats, rows: Floats) -> tuple[Floats, int, list[Finding]]:
    """Rows (T, ...) with NaN rows inserted where frame numbers are left out, the first frame's number, and findings."""
    if not len(frames):
        return rows, 1, []
    # Frame numbers with fractions are something else, such as times.
    numbers = np.round(np.where(np.isfinite(frames), frames, 0.0))
    if (numbers != frames).any() or (np.abs(numbers) > 2**31).any():
        return rows, 1, []
    first = int(numbers[0])
    steps = np.diff(numbers)
    if len(steps) == 0 or (steps == steps[0]).all():
        return rows, first, []
    span = int(numbers[-1] - numbers[0]) + 1
    # A jump back, or a huge gap, is damage or a joined file: filling it would cost memory for nothing.
    if (steps < 1).any() or span > 4 * len(frames) + 1000:
        return rows, first, [frame_numbers("the frame numbers do not rise one by one; the lines were taken in their order")]
    filled = np.full((span, *rows.shape[1:]), np.nan)
    filled[(numbers - numbers[0]).astype(np.int64)] = rows
    return filled, first, [frame_numbers(f"{span - len(frames)} frames are left out in the file; they were inserted as missing")]
