"""`asterism rig report`: a rig file in; what it measures where, as a table, a page and JSON, out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, metres
from asterism.cli._options import image_size as size_of
from asterism.errors import AsterismError
from asterism.findings import Finding, exit_status

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.cameras.accuracy import RigMap, WandAccuracy
    from asterism.recording import Floats


@dataclass(frozen=True)
class RigReportOptions:
    """What `asterism rig report` is asked to do."""

    rig: Annotated[Path, typer.Argument(metavar="RIG", help="A rig file, such as `asterism calibrate` writes.", show_default=False)]
    volume: Annotated[
        str | None,
        typer.Option(
            "--volume",
            metavar="BOX",
            help="Width x depth x height on the floor (6x4x2.5), or spans along x, y, z (-3:3,-2:2,0:2.5), in metres. Else what three see.",
            show_default=False,
        ),
    ] = None
    noise: Annotated[
        float | None,
        typer.Option("--noise", metavar="PX", help="Standard deviation of a blob's x and y. Else what the rig's calibration left, or 0.3."),
    ] = None
    image_size: Annotated[
        str | None,
        typer.Option("--image-size", metavar="WxH", help="Of cameras whose images' size the rig does not know.", show_default=False),
    ] = None
    blobs: Annotated[
        Path | None, typer.Option("--blobs", metavar="CSV", help="What the cameras saw of a waved wand, with --wand.", show_default=False)
    ] = None
    wand: Annotated[
        str | None,
        typer.Option("--wand", metavar="METRES", help="Where the wand's markers sit along it: 0 0.2 0.6.", show_default=False),
    ] = None
    still: Annotated[
        Path | None, typer.Option("--still", metavar="CSV", help="What they saw of markers that stand still.", show_default=False)
    ] = None
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write an HTML report.", show_default=False)] = None
    overwrite: Overwrite = False
    json: Json = None


@takes(RigReportOptions)
def report(options: RigReportOptions) -> None:
    """Tell what a rig measures, place by place.

    How much of the volume three cameras see, how exactly they measure there, the sensitivity of every pair, and what each camera is
    worth; from recordings, the accuracy against a wand and the repeatability of what stands still. A camera that sees nothing of the
    volume is named.
    """
    # images without lengths measure nothing, and lengths without images neither
    if (options.blobs is None) != (options.wand is None):
        raise AsterismError("accuracy against a wand needs both what was seen of it, --blobs, and its lengths, --wand.")
    _console.check_new(options.output, options.overwrite)
    _console.check_new(options.json, options.overwrite)
    from asterism.cameras.accuracy import Volume, check_map, map_rig
    from asterism.report.rig import rig_report

    rig = _rig(options)
    # the volume stands on the ground, so that it needs the vertical
    box = None if options.volume is None else Volume.parse(options.volume, "z" if rig.vertical is None else rig.vertical)
    with _console.progress("rig report") as progress:
        result = map_rig(rig, box, noise=options.noise, progress=progress)
    findings = check_map(rig, result)
    wand, still = _measured(options, rig)
    if options.json != "-":
        print_map(rig, result)
        _print_measured(wand, still)
    if options.output is not None:
        settings = {"rig": options.rig, "noise px": result.noise, "wand": options.blobs, "still": options.still}
        title = f"What {options.rig.name} measures"
        rig_report(options.output, rig, result, title=title, wand=wand, still=still, settings=settings)
    _console.write_json(options.json, {**_as_json(rig, result, findings), "rig": options.rig, **_measured_json(wand, still)})
    for finding in findings:
        # a finding on the whole rig has no camera to name: it names the file
        _console.report(finding if finding.where else replace(finding, where=str(options.rig)))
    raise typer.Exit(exit_status(findings))


def _rig(options: RigReportOptions) -> Rig:
    """The rig, with the image size given where it has none."""
    from asterism.cameras.files import read_rig

    rig = read_rig(options.rig)
    if options.image_size is None:
        return rig
    size = size_of(options.image_size, "--image-size")
    # what the file says of a camera stays
    return replace(rig, cameras=tuple(camera if camera.size else replace(camera, size=size) for camera in rig))


def _measured(options: RigReportOptions, rig: Rig) -> tuple[WandAccuracy | None, Floats | None]:
    """The accuracy against a wand, and the repeatability of still markers (M,) m, where recordings of them were given."""
    from asterism.calibration.measured_accuracy import measure_still, measure_wand
    from asterism.cameras.accuracy import repeatability, wand_accuracy
    from asterism.formats import read_blobs

    wand = still = None
    if options.blobs is not None and options.wand is not None:
        lengths = metres(options.wand, "--wand")
        # measured by the rig as it is: nothing is calibrated on what judges it
        wand = wand_accuracy(measure_wand(rig, read_blobs(options.blobs), lengths), lengths)
    if options.still is not None:
        still = repeatability(measure_still(rig, read_blobs(options.still)))
    return wand, still


def _print_measured(wand: WandAccuracy | None, still: Floats | None) -> None:
    if wand is not None:
        _console.result(
            f"Wand, {wand.frames:,} frames: lengths {1000 * wand.mean_error:+.3f} mm off on average, "
            f"{_mm(wand.mean_absolute)} without signs, standard deviation {_mm(wand.std)}."
        )
    if still is not None:
        _console.result("Still markers lie from their mean, on average: " + ", ".join(_mm(float(value)) for value in still) + ".")


def _measured_json(wand: WandAccuracy | None, still: Floats | None) -> dict[str, Any]:
    return {"wand": None if wand is None else vars(wand), "repeatability_m": still}


def _as_json(rig: Rig, result: RigMap, findings: tuple[Finding, ...]) -> dict[str, Any]:
    from asterism.report.rig import camera_facts, pair_scalars

    return {
        "command": "rig report",
        "map": result.to_dict(),
        "cameras": camera_facts(rig, result),
        "pairs": pair_scalars(rig, result),
        "idle": [finding.where for finding in findings if finding.code == "rig-camera-idle"],
        "findings": [finding.to_dict() for finding in findings],
    }


def print_map(rig: Rig, result: RigMap) -> None:
    """The table of a rig's map."""
    from asterism.recording.display import significant

    summary = result.to_dict()
    low, high = result.volume.low, result.volume.high
    spans = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", low, high, strict=True))
    lacking = [("not in the file", ", ".join(rig.lacks))] if rig.lacks else []
    noise = significant(result.noise, 2)
    _console.facts(
        f"{len(rig)} cameras, volume {spans} m",
        [
            ("seen by 2 / 3 / 4 cameras", " / ".join(_console.percent(result.coverage(n), 1) for n in (2, 3, 4))),
            ("markers on a body that face two", _console.percent(summary["facing_coverage"], 1)),
            (
                "error of a marker, RMS",
                f"median {_mm(summary['error_median_m'])}, 95 % of places {_mm(summary['error_95_m'])} at {noise} px",
            ),
            (
                "sensitivity of the best pair",
                f"median {_mm(summary['sensitivity_median_m'])}, mean of the 12 scalars at ± {noise} px",
            ),
            *lacking,
        ],
    )


def _mm(metres: float | None) -> str:
    return "–" if metres is None else f"{1000 * metres:.2f} mm"
