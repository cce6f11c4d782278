"""`asterism name`: an unlabelled file in; its numbered groups out, and with a person's names for them the labelled file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, Vertical, vertical_axis
from asterism.errors import AsterismError
from asterism.findings import Finding, exit_status

if TYPE_CHECKING:
    from asterism.labelling import MarkerGroups
    from asterism.labelling.naming import GroupPlace
    from asterism.recording import Clouds, Recording


@dataclass(frozen=True)
class NameOptions:
    """What `asterism name` is asked to do."""

    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: C3D, TRC, CSV, TSV, MAT, NPZ or XDF.", show_default=False)]
    names: Annotated[
        Path | None, typer.Option("--names", metavar="CSV", help="Lines of group,marker: the names that you give.", show_default=False)
    ] = None
    suggest: Annotated[
        Path | None,
        typer.Option(
            "--suggest",
            metavar="CSV",
            help="Write such lines with the names that virtual people suggest who wear a shipped marker set, to be corrected.",
            show_default=False,
        ),
    ] = None
    markers: Annotated[
        str | None,
        typer.Option(
            "--markers",
            metavar="SET",
            help="The set by which names are suggested: a shipped one, a TOML file, or names with commas. Else it is found.",
            show_default=False,
        ),
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
    train` learns. --suggest writes the names first as `asterism label` would give them without a model.
    """
    from asterism import formats
    from asterism.files.atomic import write_atomically
    from asterism.labelling import group_tracklets
    from asterism.labelling.group_names import group_names_text, read_group_names
    from asterism.labelling.naming import locate_groups

    # first the numbers, then the names: the two calls are told apart by both options
    if (options.names is None) != (options.output is None):
        raise AsterismError("--names (your names) and -o (the labelled file to write) belong together; give both or neither.")
    if options.suggest is not None and options.names is not None:
        raise AsterismError("--suggest writes the names that --names reads; give one of them.")
    for new in (options.output, options.report, options.json, options.suggest):
        _console.check_new(new, options.overwrite)
    names = {} if options.names is None else read_group_names(options.names)
    recording = formats.read(options.file, vertical=vertical_axis(options.vertical))
    clouds = recording.clouds()
    if not len(clouds.xyz):
        raise AsterismError(f"{options.file} has no point in any frame; give a recording with points.")
    # by their motion alone: names in the file may be what is wrong
    groups = group_tracklets(clouds)
    places = locate_groups(clouds, groups)
    # of the file itself; what labels it says the same
    worn, findings = None, list(recording.warnings)
    for finding in findings:
        _console.report(finding)
    if options.suggest is not None or (options.markers is not None and options.names is None):
        names, worn, suggested = _suggested(options, clouds, groups)
        for finding in suggested:
            if finding not in findings:
                _console.report(finding)
                findings.append(finding)
    # written before anything is shown: a name that is refused shows no table
    findings += [] if options.output is None else _write(options.file, options.output, recording, groups, names)
    if options.suggest is not None:
        write_atomically(options.suggest, group_names_text(groups, names).encode())
    if options.json != "-":
        _print(options.file, groups, places, names, len(clouds), worn)
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
            "suggested_by": worn,
            "groups": [_as_json(g, place, groups, names) for g, place in enumerate(places)],
        },
    )
    raise typer.Exit(exit_status(findings))


def _suggested(options: NameOptions, clouds: Clouds, groups: MarkerGroups) -> tuple[dict[int, str], str, list[Finding]]:
    """What a labelling by virtual people calls the groups; the set that they wear, in words; and what was found."""
    from asterism.cli._labelling import worn_sets
    from asterism.labelling.naming import suggested_names
    from asterism.session import IGNORE, FileLabeller, LabellingOptions

    given = worn_sets(None if options.markers is None else [options.markers])
    # labels in the file are not used, as for the groups
    how = LabellingOptions(markers=given, vertical=vertical_axis(options.vertical), file_names=IGNORE, in_memory=True)
    with _console.progress("suggesting names") as progress:
        labelled = FileLabeller((), how, [options.file]).label(options.file, progress)
    words = ", ".join(one.words for one in labelled.worn)
    return suggested_names(clouds, groups, labelled.labelling), words, list(labelled.findings)


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


def _print(
    file: Path, groups: MarkerGroups, places: list[GroupPlace], names: dict[int, str], frames: int, suggested_by: str | None
) -> None:
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
    rare = len(groups) - groups.frequent
    holds = "1 group holds" if groups.frequent == 1 else f"{groups.frequent} groups hold"
    summary = f"{holds} {share} of all samples; {rare} more {'is' if rare == 1 else 'are'} rarely seen."
    of_whom = f" Suggested by virtual people who wear {suggested_by}" if suggested_by else " Named"
    _console.result(f"{summary}{of_whom}: {_console.percent(named / samples)}." if names or suggested_by else summary)


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
