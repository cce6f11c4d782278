"""Merge two sessions' figures: a git merge driver for the JSON lists of `benchmarks/`, row by row.

A row that only one side changed, added or removed is taken from that side; where both changed it, ours stays and the merge is a conflict.
Set it up once in a clone:

    git config merge.rows.driver 'python tools/merge_rows.py %O %A %B'

`.gitattributes` names the files.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

Row = dict[str, Any]
KEYS = ("chapter", "command", "row", "folder")


def merge(base: list[Row], ours: list[Row], theirs: list[Row]) -> tuple[list[Row], list[str]]:
    """The merged rows, and the names of those that both sides changed."""
    was, other = ({_key(row): row for row in rows} for rows in (base, theirs))
    mine = {_key(row) for row in ours}
    merged, conflicts = [], []
    for row in ours:
        key = _key(row)
        before, theirs_now = was.get(key), other.get(key)
        if row == before:
            if theirs_now is not None:
                merged.append(theirs_now)
            continue
        if theirs_now not in (before, row):
            conflicts.append(" ".join(filter(None, key)))
        merged.append(row)
    for row in theirs:
        key = _key(row)
        if key not in mine and was.get(key) != row:
            merged.insert(_after_its_kind(merged, row), row)
    return merged, conflicts


def _key(row: Row) -> tuple[str, ...]:
    return tuple(str(row.get(name) or "") for name in KEYS)


def _after_its_kind(rows: list[Row], row: Row) -> int:
    """Where a new row belongs: after the last one of its chapter or command."""
    kind = _key(row)[:2]
    return max((number + 1 for number, other in enumerate(rows) if _key(other)[:2] == kind), default=len(rows))


def main(base: str, ours: str, theirs: str) -> int:
    """Write the merge over `ours`, one row a line. Returns 1 where both sides changed a row, else 0."""
    texts = [Path(path).read_text(encoding="utf-8") for path in (base, ours, theirs)]
    merged, conflicts = merge(*(json.loads(text) if text.strip() else [] for text in texts))
    temporary = Path(ours + ".part")
    temporary.write_text("[\n" + ",\n".join(" " + json.dumps(row, ensure_ascii=False) for row in merged) + "\n]\n", encoding="utf-8")
    os.replace(temporary, ours)
    for name in conflicts:
        print(f"both sides changed: {name}; ours stays", file=sys.stderr)
    return int(bool(conflicts))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
