"""`asterism name`: an unlabelled file in; its numbered groups out, and with a person's names for them the labelled file."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, Vertical, vertical_axis
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.labelling import MarkerGroups
    from asterism.labelling.naming import GroupPlace
    from asterism.recording import Recording


@dataclass(frozen=True)
class NameOptions:
    """What `asterism name` is asked to do."""

    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: C3D, TRC, CSV, TSV, MAT or NPZ.", show_default=False)]
    names: Annotated[
        Path | None, typer.Option("--names", metavar="CSV", help="Lines of group,marker: the names that you give.", show_default=False)
    ] = None
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="The labelled file.", show_default=False)] = None
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(NameOptions)
def name(options: NameOptions) -> None:
    """Name the markers of a first recording once.

    No model is needed, and labels in the file are not used: the motion shows which pieces of tracks are one marker. These groups are
    listed with a number; the report shows the numbers on the body. Then --names and -o write the labelled file, from which `asterism
    train` learns.
    """
    from asterism import formats
    from asterism.labelling import group_tracklets
    from asterism.labelling.naming import locate_groups

    # first the numbers, then the names: the two calls are told apart by both options
    if (options.names is None) != (options.output is None):
        raise AsterismError("--names (your names) and -o (the labelled file to write) belong together; give both or neither.")
    for new in (options.output, options.report, options.json):
        _console.check_new(new, options.overwrite)
    names = {} if options.names is None else _read_names(options.names)
    recording = formats.read(options.file, vertical=vertical_axis(options.vertical))
    clouds = recording.clouds()
    if not len(clouds.xyz):
        raise AsterismError(f"{options.file} has no point in any frame; give a recording with points.")
    # by their motion alone: names in the file may be what is wrong
    groups = group_tracklets(clouds)
    places = locate_groups(clouds, groups)
    # written before anything is shown: a name that is refused shows no table
    findings = [] if options.output is None else _write(options.file, options.output, recording, groups, names)
    if options.json != "-":
        _print(options.file, groups, places, names, len(clouds))
    if options.report is not None:
        from asterism.report import naming_report

        naming_report(
            options.report,
            clouds,
            groups,
            places,
            names=names,
            first_frame=recording.first_frame,
            title=f"{options.file.name}: which marker is which?",
            facts={"file": str(options.file)},
        )
    _console.write_json(
        options.json,
        {
            "command": "name",
            "file": options.file,
            "output": options.output,
            "findings": [finding.to_dict() for finding in findings],
            "frames": len(clouds),
            "groups": [_as_json(g, place, groups, names) for g, place in enumerate(places)],
        },
    )


def _read_names(path: Path) -> dict[int, str]:
    """{group from 0: marker} of a CSV file with lines of group,marker, groups from 1. Lines without a marker are skipped."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        rows = [[cell.strip() for cell in row] for row in csv.reader(stream)]
    out: dict[int, str] = {}
    for line, row in enumerate(rows, 1):
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


def _write(file: Path, output: Path, recording: Recording, groups: MarkerGroups, names: dict[int, str]) -> list[Finding]:
    """Write the named recording; returns what its format cannot carry, which is also printed."""
    from asterism import formats
    from asterism.cli._recordings import not_carried
    from asterism.labelling import name_groups

    try:
        named = name_groups(recording, groups, names)
    except AsterismError as problem:
        raise AsterismError(f"{file}: {problem}") from None
    findings = not_carried(output, formats.write(output, named))
    for finding in findings:
        _console.report(finding)
    return findings


def _print(file: Path, groups: MarkerGroups, places: list[GroupPlace], names: dict[int, str], frames: int) -> None:
    from asterism.report.naming import neighbours_text, side

    rows = [
        [
            str(g + 1),
            names.get(g, ""),
            side(places[g]),
            neighbours_text(places[g]),
            f"{places[g].height:.2f}",
            _console.count(int(groups.frames[g])),
            _console.percent(groups.frames[g] / frames, 1),
        ]
        # rare groups are ghosts mostly; one that a person has named is not
        for g in sorted({*range(groups.frequent), *names})
    ]
    if rows:
        columns = ["group", "name", "side", "nearest groups", "height m", "frames", "of all"]
        _console.table(f"{file}: groups of points that are one marker, from the head down", columns, rows, left=4)
    samples = max(1, int(groups.frames.sum()))
    named = sum(int(groups.frames[g]) for g in names)
    # what is not in a frequent group need not be named by hand
    share = _console.percent(groups.frames[: groups.frequent].sum() / samples)
    summary = f"{groups.frequent} groups hold {share} of all samples; {len(groups) - groups.frequent} more are rarely seen."
    _console.result(f"{summary} Named: {_console.percent(named / samples)}." if names else summary)


def _as_json(group: int, place: GroupPlace, groups: MarkerGroups, names: dict[int, str]) -> dict[str, Any]:
    return {
        "group": group + 1,
        "marker": names.get(group),
        "frames": int(groups.frames[group]),
        "height_m": place.height,
        "left_m": place.left,
        "ahead_m": place.ahead,
        "nearest": [{"group": other + 1, "distance_m": distance} for other, distance in place.nearest],
    }
