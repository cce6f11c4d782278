"""`asterism name`: a file without labels in; its markers, numbered, out, and with a person's names for them the labelled file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Overwrite, Report, Vertical, vertical_axis
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.labelling import Groups
    from asterism.labelling.naming import Place
    from asterism.recording import Recording


def name(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: C3D, TRC, CSV, TSV, MAT or NPZ.", show_default=False)],
    names: Annotated[
        Path | None, typer.Option("--names", metavar="CSV", help="Lines of group,marker: the names that you give.", show_default=False)
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="The labelled file.", show_default=False)] = None,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    report: Report = None,
    json: Json = None,
) -> None:
    """Name the markers of a first recording once.

    No model is needed and no label in the file is used: the recording's own motion shows which pieces of tracks are one marker. They are
    listed with a number; the report shows the numbers on the body. Then --names and -o write the labelled file, from which `asterism
    train` learns.
    """
    from asterism import formats
    from asterism.labelling import own_tracks
    from asterism.labelling.naming import places

    if (names is None) != (output is None):
        raise AsterismError("--names (your names) and -o (the labelled file to write) belong together; give both or neither.")
    for new in (output, report, json):
        _console.check_new(new, overwrite)
    given = {} if names is None else _read_names(names)
    recording = formats.read(file, vertical=vertical_axis(vertical))
    clouds = recording.clouds()
    if not len(clouds.xyz):
        raise AsterismError(f"{file} shows no point in any frame; there is nothing to name.")
    groups = own_tracks(clouds)
    where = places(clouds, groups)
    lost: list[str] = []
    if output is not None:
        lost = _write(file, output, recording, groups, given)
    if json != "-":
        _print(file, groups, where, given, len(clouds))
    if report is not None:
        from asterism.report import naming_report

        naming_report(
            report,
            clouds,
            groups,
            where,
            names=given,
            first_frame=recording.first_frame,
            title=f"{file.name}: which marker is which?",
            facts={"file": str(file)},
        )
    _console.write_json(
        json,
        {
            "command": "name",
            "file": file,
            "output": output,
            "not_carried": lost,
            "frames": len(clouds),
            "groups": [_as_json(g, place, groups, given) for g, place in enumerate(where)],
        },
    )


def _read_names(path: Path) -> dict[int, str]:
    """{group from 0: marker} of a CSV file of group,marker with groups from 1; lines without a marker are left out."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        rows = [[cell.strip() for cell in row] for row in csv.reader(stream)]
    out: dict[int, str] = {}
    for line, row in enumerate(rows, 1):
        if not any(row) or (line == 1 and row[0].casefold() == "group"):
            continue
        if len(row) != 2 or not row[0].isascii() or not row[0].isdigit() or int(row[0]) < 1:
            raise AsterismError(f"{path}, line {line}: {','.join(row)!r} is not group,marker; write for example 4,LKNE.")
        if int(row[0]) - 1 in out:
            raise AsterismError(f"{path}, line {line}: group {row[0]} has a name already; keep one of the two.")
        if row[1]:
            out[int(row[0]) - 1] = row[1]
    if not out:
        raise AsterismError(f"{path} gives no name; write a line for each group, for example 4,LKNE.")
    return out


def _write(file: Path, output: Path, recording: Recording, groups: Groups, given: dict[int, str]) -> list[str]:
    from asterism import formats
    from asterism.labelling import name_groups

    try:
        named = name_groups(recording, groups, given)
    except AsterismError as problem:
        raise AsterismError(f"{file}: {problem}") from None
    lost = formats.write(output, named)
    for what in lost:
        _console.error(f"{output} leaves out {what}.")
    return lost


def _print(file: Path, groups: Groups, where: list[Place], given: dict[int, str], frames: int) -> None:
    from asterism.report.naming import beside, side

    rows = [
        [
            str(g + 1),
            given.get(g, ""),
            side(where[g]),
            beside(where[g]),
            f"{where[g].height:.2f}",
            _console.count(int(groups.frames[g])),
            _console.percent(groups.frames[g] / frames, 1),
        ]
        for g in sorted({*range(groups.often), *given})
    ]
    if rows:
        columns = ["group", "name", "side", "nearest groups", "height m", "frames", "of all"]
        _console.table(f"{file}: what moves as one marker, from the head down", columns, rows, left=4)
    samples = max(1, int(groups.frames.sum()))
    named = sum(int(groups.frames[g]) for g in given)
    share = _console.percent(groups.frames[: groups.often].sum() / samples)
    told = f"{groups.often} groups hold {share} of all samples; {len(groups) - groups.often} more are seldom seen."
    _console.result(f"{told} Named: {_console.percent(named / samples)}." if given else told)


def _as_json(group: int, place: Place, groups: Groups, given: dict[int, str]) -> dict[str, Any]:
    return {
        "group": group + 1,
        "marker": given.get(group),
        "frames": int(groups.frames[group]),
        "height_m": place.height,
        "left_m": place.left,
        "ahead_m": place.ahead,
        "nearest": [{"group": other + 1, "distance_m": distance} for other, distance in place.nearest],
    }
