"""The comment lines at the head of our CSV files (units, rate, vertical, events): text in, values out, and back."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from asterism.errors import AsterismError
from asterism.files.text import delimiter_of, number_of
from asterism.recording import Event, Floats, as_vertical


@dataclass(frozen=True)
class Comments:
    """The values in the comment lines of a CSV file; None for those that it does not have."""

    units: str | None = None
    rate: float | None = None
    vertical: Floats | None = None
    subject: str = ""
    first_frame: int | None = None
    frames: int | None = None
    events: tuple[Event, ...] = ()
    unread: tuple[int, ...] = ()
    """The numbers of the lines, counted from 1, that hold an event without a time or a name."""


def comments_of(lines: Sequence[str]) -> Comments:
    """The comments among the first lines of a file. Comments that cannot be read are left out."""
    found: dict[str, str] = {}
    events, unread = [], []
    # A spreadsheet that saved the file again separates the parts of an event as it separates cells.
    start = data_start(lines)
    between = delimiter_of(lines[start]) if start < len(lines) else None
    for number, line in enumerate(lines, 1):
        if not line.strip(" ,;\t"):
            continue
        if not line.startswith("#"):
            # Comments stand at the head: a # further down is part of the data.
            break
        # Spreadsheets add separators behind a comment, to fill the row.
        key, sign, value = line.lstrip("# ").rstrip(" ,;\t").partition("=")
        key, value = key.strip().casefold(), value.strip()
        if key == "event" and sign:
            separator = between if between is not None and between in value else ","
            time, _, rest = value.partition(separator)
            context, _, label = rest.partition(separator)
            seconds = number_of(time)
            if seconds is not None and seconds == seconds and label.strip():
                events.append(Event(label.strip(), seconds, context.strip()))
            else:
                unread.append(number)
        elif sign:
            # The first of two equal keys counts, as in the file that was opened first.
            found.setdefault(key, value)
    numbers = [number_of(cell) for cell in found.get("vertical", "").split()]
    vertical = None
    if len(numbers) == 3 and None not in numbers:
        # Comments are edited by hand: what cannot be read is left out, not refused.
        try:
            vertical = as_vertical([float(n or 0.0) for n in numbers])
        except AsterismError:
            vertical = None
    return Comments(
        units=found.get("units"),
        rate=number_of(found.get("rate", "")),
        vertical=vertical,
        subject=found.get("subject", ""),
        first_frame=_count(found.get("first_frame")),
        frames=_count(found.get("frames")),
        events=tuple(events),
        unread=tuple(unread),
    )


def comment_lines(
    units: str, rate: float, vertical: Floats, frames: int, first_frame: int, subject: str = "", events: Sequence[Event] = ()
) -> list[str]:
    """The comment lines for these values, which `comments_of` reads."""
    lines = [
        f"# units={units}",
        f"# rate={rate!r}",
        "# vertical=" + " ".join(f"{float(v):.17g}" for v in vertical),
        f"# frames={frames}",
        f"# first_frame={first_frame}",
    ]
    lines += [f"# subject={_one_line(subject)}"] if subject else []
    return lines + [f"# event={event.time!r},{_one_line(event.context).replace(',', ' ')},{_one_line(event.label)}" for event in events]


def data_start(lines: Sequence[str]) -> int:
    """The index of the first line that is neither a comment nor blank."""
    return next((i for i, line in enumerate(lines) if line.strip(" ,;\t") and not line.startswith("#")), len(lines))


def _one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text).strip()


def _count(text: str | None) -> int | None:
    return int(text) if text is not None and re.fullmatch(r"-?\d{1,9}", text) else None
