"""`asterism garment calibrate`: images of a coded target in; a rig, and whether to trust it, out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, Workers
from asterism.cli.calibrate._calibration import Force, RigToWrite, hand_over

if TYPE_CHECKING:
    from asterism.calibration.boards import BoardCalibration


@dataclass(frozen=True)
class CalibrateOptions:
    """What `asterism garment calibrate` is asked to do."""

    images: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGES", help="A video or a folder of images for each camera, or a folder of those.", show_default=False),
    ]
    target: Annotated[
        Path, typer.Option("--target", metavar="TOML", help="The sheet that `asterism garment print` wrote.", show_default=False)
    ]
    output: RigToWrite = None
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="Cameras whose lenses are known; only poses are calibrated.", show_default=False),
    ] = None
    origin: Annotated[
        int | None, typer.Option(metavar="FRAME", help="The frame in which the sheet lies on the floor, print up: the world's origin.")
    ] = None
    covariance: Annotated[
        Path | None,
        typer.Option(metavar="NPZ", help="Also write the covariance of all camera parameters.", show_default=False),
    ] = None
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Look at each N-th moment only.")] = 1
    force: Force = False
    workers: Workers = 1
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(CalibrateOptions)
def calibrate(options: CalibrateOptions) -> None:
    """Calibrate cameras by a flat sheet of coded circles.

    Move the sheet through the volume, tilted, near and far, up to the corners of each image; a part of it in view is enough. Each camera is
    calibrated by itself, then all cameras that share views, together with the poses of the sheet. A camera that saw nothing or shares no
    view is named.
    """
    outputs = options.output, options.report, options.json, options.covariance
    _console.check_outputs(outputs, (*options.images, options.rig, options.target), options.overwrite)
    made = _calibrated(options)
    # with the rig or not at all: the covariance of another calibration would mislead
    if options.covariance is not None and (made.usable or options.force):
        from asterism.garment.rig_covariance import RigCovariance

        RigCovariance.of(made).save(options.covariance)
    settings = {"images": [str(path) for path in options.images], "target": str(options.target), "known lenses": options.rig}
    facts = {"files": options.images, "target": options.target}
    raise typer.Exit(hand_over(made, "garment calibrate", facts, options, settings, alone=False))


def _calibrated(options: CalibrateOptions) -> BoardCalibration:
    from asterism.calibration.coded_target import calibrate_target
    from asterism.cameras.files import read_rig
    from asterism.garment import Pattern
    from asterism.garment.footage import colour_footage
    from asterism.garment.read import read_image
    from asterism.garment.target_images import find_target

    pattern = Pattern.load(options.target)
    known = None if options.rig is None else read_rig(options.rig)
    # without the rig, which is what is to be found
    footage = colour_footage(options.images)
    with _console.progress("looking for the target") as progress:
        views = find_target(
            footage, pattern, lambda image: read_image(image, pattern), every=options.every, workers=options.workers, progress=progress
        )
    with _console.progress("calibrating") as progress:
        return calibrate_target(views, known=known, origin=options.origin, progress=progress)
