"""`asterism garment capture`: images of a worn garment in; the trajectories of its circles out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, Workers
from asterism.findings import Finding, exit_status

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.garment import Pattern
    from asterism.garment.capture import Capture


@dataclass(frozen=True)
class CaptureOptions:
    """What `asterism garment capture` is asked to do."""

    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGES",
            help="A video or a folder of images for each camera, named as in the rig, or a folder of those.",
            show_default=False,
        ),
    ]
    rig: Annotated[Path, typer.Option("--rig", metavar="FILE", help="The calibrated cameras.", show_default=False)]
    garment: Annotated[
        Path, typer.Option("--garment", metavar="TOML", help="The garment that `asterism garment print` wrote.", show_default=False)
    ]
    output: Annotated[Path, typer.Option("--output", "-o", metavar="NPZ", help="The trajectories to write.", show_default=False)]
    rate: Annotated[float, typer.Option(metavar="HZ", min=0.001, help="Moments per second.")] = 10.0
    surfaces: Annotated[
        Path | None,
        typer.Option("--surfaces", metavar="FOLDER", help="Also write the cloth's surface of each frame, as PLY.", show_default=False),
    ] = None
    workers: Workers = 1
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(CaptureOptions)
def capture(options: CaptureOptions) -> None:
    """Turn images of a worn garment into dense trajectories.

    Writes positions (frames, circles, 3) in metres with NaN where a circle was not seen by two cameras, the covariance of each, and the
    circles' identities; `asterism info` and `asterism convert` take the file as a recording. A garment file that does not match the cloth
    is said after the first images. An image that cannot be read, or is of another size, is named and left out. What was read is kept in
    OUTPUT.unfinished until the end: the same command goes on from there after an interruption.
    """
    outputs = options.output, options.report, options.json
    _console.check_outputs(outputs, (*options.images, options.rig, options.garment), options.overwrite)
    from asterism.cameras.files import read_rig
    from asterism.garment import Pattern

    rig, pattern = read_rig(options.rig), Pattern.load(options.garment)
    made, problems = _captured(options, rig, pattern)
    # what is wrong with the files explains what is wrong with the capture
    findings = (*problems, *made.findings)
    # only on demand: a surface for each frame is many times the size of the trajectories
    surfaces = _surfaces(options, made, pattern)
    summary = made.summary()
    if options.json != "-":
        _print(made, rig)
        _console.result(
            f"{len(made.frames)} frames, {summary['points_per_frame']:,.0f} points per frame, "
            f"{_console.percent(summary['of_those_seen_by_two_cameras'], 1)} of the circles that two cameras saw -> {options.output}"
        )
    for finding in findings:
        _console.report(finding)
    files = {"output": options.output, "rig": options.rig, "garment": options.garment, "surfaces": surfaces}
    if options.report is not None:
        from asterism.report.garment import garment_report

        garment_report(options.report, made, pattern, rig, settings={key: str(value) for key, value in files.items() if value})
    _console.write_json(
        options.json,
        {
            "command": "garment capture",
            "images": options.images,
            **files,
            **summary,
            "cameras": [{"name": name, "identities_per_image": float(made.read[:, c].mean())} for c, name in enumerate(rig.names)],
            "findings": [finding.to_dict() for finding in findings],
        },
    )
    raise typer.Exit(exit_status(findings))


def _captured(options: CaptureOptions, rig: Rig, pattern: Pattern) -> tuple[Capture, tuple[Finding, ...]]:
    """The capture, which is on the disk, and what is wrong with the files."""
    from asterism.cli._unfinished import continued
    from asterism.garment.capture import capture as capture_garment
    from asterism.garment.first_images import check_first_images
    from asterism.garment.footage import colour_footage
    from asterism.garment.read import read_image

    footage = colour_footage(options.images, rig)
    # a wrong garment file is told after seconds, not after hours
    check_first_images(footage, pattern, rig)
    images = [path for camera in footage.cameras for path in (*camera.images, *([camera.video] if camera.video else []))]
    with continued(options.output, [*images, options.rig, options.garment], "garment capture") as journal:
        with _console.progress("reading") as progress:
            made = capture_garment(
                rig, pattern, footage, lambda image: read_image(image, pattern),
                rate=options.rate, workers=options.workers, journal=journal, progress=progress,
            )  # fmt: skip
        # before the page: what took hours is on the disk first
        made.trajectories.save(options.output)
    return made, footage.findings


def _surfaces(options: CaptureOptions, made: Capture, pattern: Pattern) -> Path | None:
    """Write the surface of each frame that has points."""
    if options.surfaces is None:
        return None
    from asterism.garment.surface import surface, write_surface

    options.surfaces.mkdir(parents=True, exist_ok=True)
    targets = [options.surfaces / f"{number:06d}.ply" for number in made.frames.tolist()]
    # all are asked before the first is written
    for target in targets:
        _console.check_new(target, options.overwrite)
    for t, target in enumerate(targets):
        # a frame without a point has no surface, and no file
        if made.points[t]:
            write_surface(target, surface(made.trajectories.points(t), pattern), pattern)
    return options.surfaces


def _print(made: Capture, rig: Rig) -> None:
    rows: list[list[Any]] = [
        [name, _console.count(float(made.read[:, c].mean())), _console.count(float(made.read[:, c].min()))]
        for c, name in enumerate(rig.names)
    ]
    _console.table("Circles with an identity", ("camera", "per image", "fewest"), rows)
