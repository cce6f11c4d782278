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
_REASONS = {
    "vertical": {
        "given": "given",
        "file": "the file says so",
        "data": "its points show it",
        "data against file": "its points show it, against what the file says",
        "convention": "usual in this format",
    },
    "units": {"file": "the file says so", "data": "it fits the size of the body"},
}
"""Why a value was believed, in words, by the value beside it that ends in `_from`."""
_SHOWN_WITH_ANOTHER = {
    "marker_sets",
    "vertical_from",
    "units_from",
    "empty_frames",
    "pieces",
    "heights",
    "people",
    "no_people",
    "people_vertical",
}
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

    Points (physical, computed, unnamed), frames, rate, events and gaps; units and the vertical, and why they were believed; and findings,
    where a file contradicts itself or breaks off. Of points without a name: how many a frame has, how long their pieces last, how high
    they lie, and how many people in which marker sets they are, as `asterism label` finds them. Of rig files and folders of them: cameras,
    their lenses, positions and errors, and what the file lacks. Of models: markers, what they were trained on, and the hit rates that their
    partial solvers have shown.
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

    rigs = [one for one in given if one.is_dir() and is_rig(one)]
    # models and rig files are no recordings, and named themselves
    recordings = recordings_of([one for one in given if one not in rigs], batch) if len(rigs) < len(given) else []
    return [*recordings, *rigs]


def _content(path: Path, batch: _console.Batch, *, show: bool) -> dict[str, Any]:
    """What one file holds, printed where it should be shown; its findings are named in any case."""
    from asterism.cli._recordings import is_model, is_rig

    # by the suffix: no file is opened to learn what it is
    model = is_model(path)
    rig = not model and is_rig(path)
    whole = _described_model(path) if model else _described_rig(path) if rig else _described_recording(path)
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


def _described_recording(path: Path) -> dict[str, Any]:
    """What a recording holds; of points without a name, what can be said of them before they are labelled."""
    from asterism import formats

    content = formats.describe(path)
    found = dict[str, Any]()
    # in the order in which a person asks
    for key, value in content.items():
        found[key] = value
        if key == "units":
            assumed = any(finding.code in ("format-units-assumed", "format-units-unknown") for finding in content.get("findings", ()))
            found["units_from"] = "data" if assumed else "file"
        # clouds say nothing of names
        elif key == "points_per_frame" or (key == "points" and value["unnamed"]):
            # what looks for people takes a second to import
            from asterism.session.raw import described_unnamed

            found |= described_unnamed(path)
    return found


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
        if key in ("missing", "gaps") and not content.get("points", {"physical": True})["physical"]:
            # they are those of named markers
            continue
        if isinstance(value, Mapping) and value and key == "points":
            yield from _rows(value, prefix="points, ")
        elif isinstance(value, Mapping) and key == "partial_solvers":
            for rules, solvers in value.items():
                yield f"partial solvers, {rules}", _solvers_text(solvers)
        elif key == "marker_sets" and content["points"]["physical"]:
            yield from _marker_set_rows(value)
        elif key == "missing" and isinstance(value, float):
            yield name, _console.percent(value)
        elif key in _REASONS and content.get(f"{key}_from") is not None:
            reason = str(content[f"{key}_from"])
            yield name, f"{_text(value)} ({_REASONS[key].get(reason, reason)})"
        elif key == "points_per_frame":
            yield from _unnamed_rows(content)
        elif key not in _SHOWN_WITH_ANOTHER:
            yield name, _text(value, _LONGEST_LIST.get(key, _LONG_ENOUGH)) + _UNITS.get(key, "")


def _unnamed_rows(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What is said of points without a name: see `described_unnamed`."""
    from asterism.recording.display import counted, significant

    of_frame, pieces = content["points_per_frame"], content["pieces"]
    empty = f"; {counted(content['empty_frames'], 'frame')} without a point" if content["empty_frames"] else ""
    yield "points per frame", f"{of_frame['median']:g} in a usual frame, {of_frame['fewest']} to {of_frame['most']}{empty}"
    some = f" of the first {_console.count(pieces['of_frames'])} frames" if pieces["of_frames"] < content["frames"] else ""
    single = f", {_console.count(pieces['single_frames'])} of a single frame" if pieces["single_frames"] else ""
    yield (
        "pieces of paths",
        f"{_console.count(pieces['number'])}{some}{single}; the usual one lasts {significant(pieces['median_seconds'], 3)} s "
        f"({pieces['median_frames']:g} frame{'' if pieces['median_frames'] == 1 else 's'})",
    )
    if "heights" not in content:
        return
    low, high = content["heights"]
    yield "heights", f"{low:.2f} to {high:.2f} m in a usual frame"
    if not content["people"]:
        yield "people", f"none found: {content['no_people']}"
        return
    bodies = content["people"]
    # more names are expected to be wrong than right
    if bodies[0]["same_names"] < 0.5:
        yield "people", f"none that is sure; the nearest set is {bodies[0]['words']}"
        return
    turned = content["people_vertical"]
    where = "" if turned is None else f", with {_text(turned)} up, against the vertical of the file"
    yield "people", f"{len(bodies)}: {'; '.join(body['words'] for body in bodies)}{where}"


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
