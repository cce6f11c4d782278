"""A table of a person's names for the groups of a recording: a file in, names out, and back."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.errors import AsterismError
from asterism.files.text import cell_text, cells_of, decoded, delimiter_of, lines_of

if TYPE_CHECKING:
    from asterism.labelling.naming import MarkerGroups


def read_group_names(path: Path) -> dict[int, str]:
    """{group from 0: marker} of a file with lines of group,marker, groups from 1, as any spreadsheet saves them.

    Lines without a marker are skipped. Raises AsterismError where the file cannot be read, a line is none of these, or names a group again.
    """
    text = decoded(path, path.read_bytes())
    out: dict[int, str] = {}
    for line, content in enumerate(lines_of(text), 1):
        row = cells_of(content, delimiter_of(content) or ",")
        # spreadsheets leave empty lines and a header
        if not any(row) or (line == 1 and row[0].casefold() == "group"):
            continue
        if len(row) != 2 or not row[0].isascii() or not row[0].isdigit() or int(row[0]) < 1:
            raise AsterismError(f"{path}, line {line}: {','.join(row)!r} is not group,marker; write for example 4,LKNE.")
        # which of the two is meant, only the person knows
        if int(row[0]) - 1 in out:
            raise AsterismError(f"{path}, line {line}: group {row[0]} already has a name; keep one of the two lines.")
        if row[1]:
            out[int(row[0]) - 1] = row[1]
    if not out:
        raise AsterismError(f"{path} gives no name; write a line for each group, for example 4,LKNE.")
    return out


def group_names_text(groups: MarkerGroups, names: Mapping[int, str]) -> str:
    """The lines that `read_group_names` reads: of each group that a person names, and of each that has a name."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["group", "marker"])
    writer.writerows([group + 1, cell_text(names.get(group, ""))] for group in sorted({*range(groups.frequent), *names}))
    return text.getvalue()
