"""`asterism opensim`: labelled walks and a standing trial in; a folder that OpenSim's tools run from, out."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _clinical, _console
from asterism.cli._command import takes
from asterism.cli._options import Files, Hip, Json, LowerBodyChoice, Measure, Overwrite, Static, Vertical

if TYPE_CHECKING:
    from asterism.recording import Recording


@dataclass(frozen=True)
class OpenSimOptions:
    """What `asterism opensim` is asked to do."""

    files: Files
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="The folder for the files of OpenSim.", show_default=False)
    ]
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            "-m",
            metavar="FILE",
            help="Your copy of a generic model: gait2392, Rajagopal's or one like them (.osim).",
            show_default=False,
        ),
    ] = None
    static: Static = None
    measure: Measure = field(default_factory=list)
    lower_body: LowerBodyChoice = None
    hip: Hip = None
    cut_off: Annotated[
        float, typer.Option("--cut-off", metavar="HZ", help="Of the low-pass filter of coordinates and forces in inverse dynamics.")
    ] = 6.0
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(OpenSimOptions)
def opensim(options: OpenSimOptions) -> None:
    """Write what OpenSim scales and moves a model with.

    FILES are walks of one person. Of each, and of the standing trial, the markers become TRC (mm, y up, walking along x), and forces of
    plates a MOT with the feet on which they act. With --model there are a marker set for that model, the scale factors, and the documents
    of scaling, inverse kinematics and inverse dynamics: the commands that run them are printed.
    What the markers do not tell is named, and what is assumed instead.
    """
    from asterism import formats
    from asterism.cli._folders import check_folder, recordings_of
    from asterism.cli._recordings import one_person, report_warnings
    from asterism.errors import AsterismError
    from asterism.motion.clinical import clinical_angles, exchanged_finding
    from asterism.motion.clinical.gathered import other_person
    from asterism.opensim import OpenSimTrial, generic_model, write_opensim

    check_folder(options.output)
    inputs = [*options.files, options.static, options.model, *_clinical.measure_files(options.measure)]
    _console.check_outputs([options.json], inputs, options.overwrite)
    _clinical.given_measures(options.measure)
    if options.model is not None:
        generic_model(options.model)
    batch = _console.Batch("written")

    def read(path: Path) -> Recording:
        recording = formats.read(path, vertical=options.vertical)
        report_warnings(recording, batch)
        return one_person(recording, batch)

    static = None if options.static is None else read(options.static)
    standing = None if options.static is None else _console.real_path(options.static)
    trials = list[OpenSimTrial]()
    for path in recordings_of(options.files, batch):
        if _console.real_path(path) == standing:
            continue
        with batch.file(path):
            recording = read(path)
            measures, doubtful = _clinical.measures_of(recording, static, options.measure, options.hip)
            found = [*doubtful, *exchanged_finding(recording), *(other_person(recording, trials[0].recording) if trials else ())]
            clinical = None
            try:
                angles = clinical_angles(recording, measures=measures, static=static, model=options.lower_body)
                clinical, found = angles.model, [*found, *angles.findings]
            except AsterismError:
                # that its legs are not known is said when it is written
                if options.lower_body is not None:
                    raise
            for finding in found:
                batch.found(finding)
            trials.append(OpenSimTrial(recording, clinical))
    if trials:
        done = write_opensim(options.output, trials, options.model, static=static, cut_off=options.cut_off, overwrite=options.overwrite)
        for finding in done.findings:
            batch.found(finding)
        if options.json != "-":
            rows = [
                [one.body, f"{one.factor:.3f}", *("–" if value is None else f"{value:.3f}" for value in (one.measured, one.model)), one.by]
                for one in done.scales.values()
            ]
            if rows:
                _console.table("Scale factors", ["body", "factor", "person (m)", "model (m)", "by"], rows)
            _console.result(f"{options.output}: {', '.join(path.name for path in done.files.values())}")
            for command in done.commands:
                _console.result(command)
        _console.write_json(
            options.json,
            {
                "command": "opensim",
                "folder": options.output,
                "files": dict(done.files),
                "commands": list(done.commands),
                "mass_kg": done.mass,
                "scales": {
                    one.body: {"factor": one.factor, "measured_m": one.measured, "model_m": one.model, "by": one.by}
                    for one in done.scales.values()
                },
                "markers": {one.name: {"body": one.body, "location_m": one.location, "joint_centre": one.centre} for one in done.markers},
                "weights": done.weights,
                "known_s": done.known,
                "failed": batch.failed,
                "findings": [finding.to_dict() for finding in batch.findings],
            },
        )
    raise typer.Exit(batch.close())
