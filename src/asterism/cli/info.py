"""`asterism info`: files in, what they hold out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from asterism.cli import _console
from asterism.cli._options import Files, Json

_LONGEST_LIST = 60


def info(files: Files, json: Json = None) -> None:
    """Show what files hold.

    Points (physical, computed, unnamed), frames, rate, units, the vertical, events, gaps and oddities.
    """
    from asterism import formats

    batch = _console.Batch("shown")
    found: list[dict[str, Any]] = []
    for path in files:
        with batch.file(path):
            content = dict(formats.describe(path))
            found.append({"file": path, **content})
            if json != "-":
                _print(path, content)
    _console.write_json(json, {"command": "info", "files": found, "failed": batch.failed})
    raise typer.Exit(batch.close())


def _print(path: Path, content: Mapping[str, Any]) -> None:
    _console.table(str(path), ["", ""], [[key.replace("_", " "), _text(value)] for key, value in content.items() if key != "file"], left=2)


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:,.6g}"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_text(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        shown = [_text(item) for item in value[:_LONGEST_LIST]]
        return ", ".join(shown + [f"... ({len(value)} in all)"] * (len(value) > _LONGEST_LIST)) or "none"
    return str(value)
