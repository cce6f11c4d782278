"""`asterism info`: files in, what they hold out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import typer

from asterism.cli import _console
from asterism.cli._options import Files, Json, Overwrite

_UNITS = {"rate": " frames/s", "duration": " s"}
_LONGEST_LIST = {"physical": 200, "events": 40}
_LONG_ENOUGH = 12


def info(files: Files, overwrite: Overwrite = False, json: Json = None) -> None:
    """Show what files hold.

    Points (physical, computed, unnamed), frames, rate, units, the vertical, events, gaps and oddities.
    """
    from asterism import formats

    _console.check_new(json, overwrite)
    batch = _console.Batch("shown")
    found: list[dict[str, Any]] = []
    for path in files:
        with batch.file(path):
            content = {key: value for key, value in formats.describe(path).items() if key != "file"}
            found.append({"file": path, **content})
            if json != "-":
                _console.facts(str(path), list(_rows(content)))
    _console.write_json(json, {"command": "info", "files": found, "failed": batch.failed})
    raise typer.Exit(batch.close())


def _rows(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping) and value and key == "points":
            yield from _rows(value, prefix="points, ")
        elif key == "missing" and isinstance(value, float):
            yield name, _console.percent(value)
        else:
            yield name, _text(value, _LONGEST_LIST.get(key, _LONG_ENOUGH)) + _UNITS.get(key, "")


def _text(value: Any, longest: int = _LONG_ENOUGH) -> str:
    if value is None or value == "":
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        if {"label", "time"} <= set(value):
            return f"{value.get('context', '')} {value['label']} {value['time']:.3f} s".strip()
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        if all(isinstance(item, int | float) for item in value):
            return ", ".join(f"{item:g}" for item in value) or "none"
        listed = ", ".join([_text(item) for item in value[:longest]] + ["..."] * (len(value) > longest))
        return f"{len(value)}: {listed}" if value else "none"
    return str(value)
