"""`asterism info`: files in, what they hold, out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Files, Json, Overwrite

if TYPE_CHECKING:
    from asterism.findings import Finding

_UNITS = {"rate": " frames/s", "duration": " s"}
_LONGEST_LIST = {"physical": 200, "events": 40}
_LONG_ENOUGH = 12
_CALLED = {"miner": "search of partial solvers", "features": "features of partial solvers", "left_out_markers": "markers left out"}
"""What rows are called, where the name in the file is not a laboratory's word."""
_CAMERA_COLUMNS = ("camera", "image, px", "focal length, px", "centre, px", "lens terms", "position, m", "error, px")


@dataclass(frozen=True)
class InfoOptions:
    """What `asterism info` is asked to do."""

    files: Files
    overwrite: Overwrite = False
    json: Json = None


@takes(InfoOptions)
def info(options: InfoOptions) -> None:
    """Show what files hold.

    Points (physical, computed, unnamed), frames, rate, units, the vertical, events and gaps; and findings, where a file
    contradicts itself or breaks off. Of rig files and folders of them: cameras, their lenses, positions and errors, and what the
    file lacks. Of models: markers, what they were trained on, and the hit rates that their partial solvers have shown.
    """
    _console.check_new(options.json, options.overwrite)
    batch = _console.Batch("shown")
    contents: list[dict[str, Any]] = []
    for path in _shown(options.files, batch):
        with batch.file(path):
            contents.append({"file": path, **_content(path, batch, show=options.json != "-")})
    _console.write_json(
        options.json,
        {"command": "info", "files": contents, "failed": batch.failed, "findings": [finding.to_dict() for finding in batch.findings]},
    )
    raise typer.Exit(batch.close())


def _shown(given: Sequence[Path], batch: _console.Batch) -> list[Path]:
    """The files named, those in the folders named, and folders that are rigs."""
    from asterism.cli._folders import recordings_of
    from asterism.cli._recordings import is_rig

    return [path for one in given for path in (recordings_of([one], batch) if one.is_dir() and not is_rig(one) else [one])]


def _content(path: Path, batch: _console.Batch, *, show: bool) -> dict[str, Any]:
    """What one file holds, printed where it should be shown; its findings are named in any case."""
    from asterism import formats
    from asterism.cli._recordings import is_model, is_rig

    # by the suffix: no file is opened to learn what it is
    model = is_model(path)
    rig = not model and is_rig(path)
    whole = _described_model(path) if model else _described_rig(path) if rig else formats.describe(path)
    # they are said on standard error, and not in the table
    findings: Sequence[Finding] = whole.pop("findings", ())
    content = {key: value for key, value in whole.items() if key != "file"}
    if show:
        _console.facts(str(path), list(_rows({key: value for key, value in content.items() if not (rig and key == "cameras")})))
    # cameras have a row each: as facts, they would be a page
    if show and rig:
        _console.table("cameras", _CAMERA_COLUMNS, [_camera_row(camera) for camera in content["cameras"]])
    for finding in findings:
        batch.found(finding)
    return {**content, "findings": [finding.to_dict() for finding in findings]}


def _described_model(path: Path) -> dict[str, Any]:
    """What a model was trained on, and what its partial solvers are known to reach."""
    from asterism.cli._recordings import uncovered_markers
    from asterism.labelling.training.model_file import describe_model

    content = describe_model(path)
    return {**content, "findings": uncovered_markers(path, content["partial_solvers"])}


def _described_rig(path: Path) -> dict[str, Any]:
    from asterism.cameras.files import describe_rig, read_rig

    return describe_rig(read_rig(path))


def _camera_row(camera: Mapping[str, Any]) -> list[str]:
    def pair(values: Sequence[float] | None, pattern: str = "{:.1f}", between: str = ", ") -> str:
        return "–" if values is None else between.join(pattern.format(value) for value in values)

    # how many numbers describe the lens: a rig with none bends no image
    lens = len(camera["radial"]) + sum(map(bool, camera["denominator"])) + sum(map(bool, camera["tangential"]))
    error = "–" if camera["error"] is None else f"{camera['error']:.3f}"
    size = pair(camera["size"], "{:.0f}", " x ")
    return [camera["name"], size, pair(camera["focal"]), pair(camera["centre"]), str(lens), pair(camera["position"], "{:.3f}"), error]


def _rows(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        name = f"{prefix}{_CALLED.get(key, key.replace('_', ' '))}"
        if isinstance(value, Mapping) and value and key == "points":
            yield from _rows(value, prefix="points, ")
        elif isinstance(value, Mapping) and key == "partial_solvers":
            for rules, solvers in value.items():
                yield f"partial solvers, {rules}", _solvers_text(solvers)
        elif key == "marker_sets" and content["points"]["physical"]:
            yield from _marker_set_rows(value)
        elif key == "missing" and isinstance(value, float):
            yield name, _console.percent(value)
        elif key != "marker_sets":
            yield name, _text(value, _LONGEST_LIST.get(key, _LONG_ENOUGH)) + _UNITS.get(key, "")


def _marker_set_rows(sets: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """The best of the shipped marker sets, what the file lacks of it and has beside it; and the other sets that it has."""

    def told(worn: Mapping[str, Any]) -> str:
        return f"{worn['name']}, {len(worn['found'])} of {len(worn['found']) + len(worn['missing'])} markers"

    if not sets:
        yield "marker set", "none that is shipped"
        return
    # the set of which most markers are there comes first
    best = sets[0]
    yield "marker set", told(best)
    if best["missing"]:
        yield "marker set, missing", _text(best["missing"])
    if best["extra"]:
        yield "marker set, extra", _text(best["extra"])
    if len(sets) > 1:
        yield "marker set, also", "; ".join(told(worn) for worn in sets[1:])


def _solvers_text(about: Mapping[str, Any]) -> str:
    shown = about["shown_hit_rates"]
    # a set labels as well as its worst marker
    worst = min(shown, key=shown.get)
    return f"{about['solvers']}; shown hit rates from {_console.percent(shown[worst], 3)} ({worst})"


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
