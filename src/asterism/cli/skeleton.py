"""`asterism skeleton`: labelled trials of one person in; the person's skeleton and the movement of its joints out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Files, Json, Markers, Overwrite, Vertical, marker_names

if TYPE_CHECKING:
    from asterism.recording import Recording
    from asterism.skeleton import Kinematics, KinematicTree


@dataclass(frozen=True)
class SkeletonOptions:
    """What `asterism skeleton` is asked to do."""

    files: Files
    static: Annotated[
        Path | None,
        typer.Option("--static", metavar="FILE", help="A standing trial of the person, from which angles count.", show_default=False),
    ] = None
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="FILE",
            help="Move this model as it is: an OpenSim model (.osim), or a body model (TOML, or gait15).",
            show_default=False,
        ),
    ] = None
    markers: Markers = None
    clinical: Annotated[
        bool, typer.Option("--clinical", help="Take hip, knee and ankle centres from the clinical model, with the files' measures.")
    ] = False
    smooth: Annotated[bool, typer.Option("--smooth/--no-smooth", help="Whether frames tell each other their poses.")] = True
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FOLDER", help="Write copies as C3D with joints, angles and bone lengths.", show_default=False
        ),
    ] = None
    table: Annotated[
        Path | None,
        typer.Option("--table", metavar="FILE", help="Write all numbers with their uncertainty; CSV or .parquet.", show_default=False),
    ] = None
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(SkeletonOptions)
def skeleton(options: SkeletonOptions) -> None:
    """Fit a skeleton to a person and find how its joints move.

    The files are trials of one person. Bone lengths, joints, and where each marker sits are found together from the standing trial and
    from the movements, and are then constant. Joint angles over time come from all markers at once, each with its standard deviation;
    markers may be missing. Any shipped marker set is known by its names, whole or in part; other markers sit where they are seen.
    """
    from asterism.cli._folders import check_output, copies_of, trials
    from asterism.cli._recordings import report_warnings
    from asterism.files.tables import check_table
    from asterism.formats import read
    from asterism.skeleton import KinematicsRules, solve_kinematics
    from asterism.skeleton.outputs import kinematics_findings, kinematics_table, write_kinematics_c3d

    others = [options.static, options.model]
    _console.check_outputs([options.table, options.json], [*options.files, *others], options.overwrite)
    if options.table is not None:
        check_table(options.table)
    batch = _console.Batch("moved")
    found = trials(options.files, batch, without=options.output)
    copies = {} if options.output is None else copies_of(found, options.output, others)
    recordings: dict[Path, Recording] = {}
    for path in (trial.path for trial in found):
        with batch.file(path):
            if path in copies:
                check_output(path, copies[path], options.overwrite)
            recordings[path] = read(path, markers=marker_names(options.markers), vertical=options.vertical)
            report_warnings(recordings[path], batch)
    if not recordings:
        raise typer.Exit(batch.close())
    tree = _tree(options, list(recordings.values()), batch)
    results: dict[Path, Kinematics] = {}
    for path, recording in recordings.items():
        with batch.file(path):
            movement = solve_kinematics(tree, recording, rules=KinematicsRules(smooth=options.smooth))
            for finding in kinematics_findings(movement, recording):
                batch.found(finding)
            if path in copies:
                copies[path].parent.mkdir(parents=True, exist_ok=True)
                for changed in write_kinematics_c3d(copies[path], movement, recording):
                    _console.notice(f"{copies[path]}: {changed}")
            results[path] = movement
            if options.json != "-":
                _show(path, movement)
    if results and options.table is not None:
        kinematics_table([(str(path), movement, recordings[path]) for path, movement in results.items()]).write(options.table)
    if results:
        content = {
            "command": "skeleton",
            "title": tree.title,
            "lengths_m": _lengths(tree),
            "markers": {marker.name: {"bone": marker.bone, "place_m": marker.place, "spread_m": marker.spread} for marker in tree.markers},
            "files": [{"file": path, "copy": copies.get(path), **_summary(movement)} for path, movement in results.items()],
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
        }
        _console.write_json(options.json, content)
    raise typer.Exit(batch.close())


def _tree(options: SkeletonOptions, moving: list[Recording], batch: _console.Batch) -> KinematicTree:
    """The model that is given, or the skeleton of the person."""
    from asterism.formats import read
    from asterism.motion.clinical.gathered import static_of_another
    from asterism.motion.clinical.joint_centres import with_joint_centres
    from asterism.recording import MarkerSet
    from asterism.skeleton import fit_person, load_body, load_osim, tree_of

    if options.model is not None:
        return load_osim(options.model) if options.model.suffix.casefold() == ".osim" else tree_of(load_body(str(options.model)))
    names = marker_names(options.markers)
    standing = [] if options.static is None else [read(options.static, markers=names, vertical=options.vertical)]
    for one in moving:
        for static in standing:
            for finding in static_of_another(one, static):
                batch.found(finding)
    if options.clinical:
        worn = standing[0] if standing else None
        standing = [with_joint_centres(one) for one in standing]
        moving = [with_joint_centres(one, static=worn) for one in moving]
    person = fit_person(standing, moving, markers=None if names is None else MarkerSet.load(names))
    for finding in person.findings:
        batch.found(finding)
    return person.tree


def _lengths(tree: KinematicTree) -> dict[str, float]:
    from asterism.skeleton.person import lengths_of_bones

    return lengths_of_bones(tree)


def _summary(found: Kinematics) -> dict[str, object]:
    """What the JSON holds of a movement."""
    import numpy as np

    coordinates = {}
    for i, coordinate in enumerate(found.tree.coordinates):
        factor = 1.0 if coordinate.slides else np.degrees(1.0)
        coordinates[coordinate.name] = {
            "unit": "m" if coordinate.slides else "deg",
            "values": [float(factor * v) if known else None for v, known in zip(found.coordinates[:, i], found.known, strict=True)],
            "sd": [float(factor * v) if known else None for v, known in zip(found.sd[:, 6 + i], found.known, strict=True)],
        }
    return {
        "frames": len(found),
        "rate": found.rate,
        "miss_m": float(np.nanmedian(found.misses)),
        "root_m": found.posed[1][:, 0].tolist(),
        "coordinates": coordinates,
    }


def _show(path: Path, found: Kinematics) -> None:
    """Print the lengths of the bones, and how far each coordinate goes."""
    import numpy as np

    lengths = ", ".join(f"{name} {100 * length:.1f}" for name, length in _lengths(found.tree).items())
    _console.result(
        f"{path}: {found.tree.title}, markers {1000 * float(np.nanmedian(found.misses)):.1f} mm off (median). Bones, cm: {lengths}."
    )
    rows = []
    for i, coordinate in enumerate(found.tree.coordinates):
        factor, unit = (1000.0, "mm") if coordinate.slides else (float(np.degrees(1.0)), "deg")
        values, sd = factor * found.coordinates[found.known, i], factor * np.median(found.sd[found.known, 6 + i])
        rows.append([coordinate.name, f"{values.min():.1f}", f"{values.max():.1f}", f"{sd:.1f}", unit])
    _console.table(f"{path}: joints", ["coordinate", "least", "most", "± (median)", "unit"], rows)
