"""`asterism detect`: the images of several cameras in; their marker blobs as 2D CSV out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, Workers
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.detection import Detection, DetectionSettings


@dataclass(frozen=True)
class DetectOptions:
    """What `asterism detect` is asked to do."""

    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="CAMERAS",
            help="One per camera: a video, a folder of images, a TIFF of several pages, or a series such as cam1.%d.",
            show_default=False,
        ),
    ]
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The 2D CSV file to write.", show_default=False)]
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="The calibrated rig: names, image sizes, and the check for cameras out of step."),
    ] = None
    threshold: Annotated[
        str | None,
        typer.Option(
            metavar="GREY",
            help="Markers are so much brighter than the background; one number, or one per camera: 9,9,11. Else estimated from the images.",
            show_default=False,
        ),
    ] = None
    background: Annotated[
        int | None,
        typer.Option(metavar="PX", help="Take off the mean of so many by so many pixels: for uneven light.", show_default=False),
    ] = None
    mask_static: Annotated[bool, typer.Option("--mask-static", help="Leave out what is bright in nearly all images.")] = False
    min_size: Annotated[float, typer.Option(metavar="PX", help="The smallest diameter of a blob.")] = 2.0
    max_size: Annotated[float, typer.Option(metavar="PX", help="The largest diameter of a blob.")] = 64.0
    min_width: Annotated[float, typer.Option(metavar="PX", help="The smallest width and height of a blob.")] = 1.0
    min_roundness: Annotated[float, typer.Option(metavar="RATIO", help="Shorter over longer axis; 0 takes blobs of any shape.")] = 0.0
    split: Annotated[
        float, typer.Option(metavar="SHARE", help="How deep the valley in a blob must be to make two of it; 1 makes none.")
    ] = 0.2
    step: Annotated[
        float | None,
        typer.Option(
            metavar="GREY", help="Instead: part blobs where neighbouring pixels differ by more, as for particles.", show_default=False
        ),
    ] = None
    min_peak: Annotated[
        float | None,
        typer.Option(metavar="GREY", help="The brightest pixel is so much above the background.", show_default=False),
    ] = None
    min_weight: Annotated[float, typer.Option(metavar="GREY", help="What a blob's pixels weigh together at least.")] = 0.0
    connectivity: Annotated[int, typer.Option(metavar="N", help="Pixels belong together that share a corner (8) or a side (4).")] = 8
    weight_reference: Annotated[
        str, typer.Option(metavar="WHAT", help="Pixels weigh what they are brighter than the threshold, or than the background.")
    ] = "threshold"
    times: Annotated[
        Path | None,
        typer.Option("--times", metavar="FILE", help="CSV of when each image was taken: camera, frame, time (s).", show_default=False),
    ] = None
    rate: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Frames per second. Else as times or videos say.", show_default=False),
    ] = None
    workers: Workers = 1
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None

    def settings(self) -> DetectionSettings:
        """The options as `asterism.detection.detect` takes them."""
        from asterism.detection import BlobSettings, DetectionSettings

        threshold = _thresholds(self.threshold)
        blobs = BlobSettings(
            threshold=threshold[0] if len(threshold) == 1 else None,
            background=self.background,
            weight_reference=self.weight_reference,
            connectivity=self.connectivity,
            min_size=self.min_size,
            max_size=self.max_size,
            min_width=self.min_width,
            min_roundness=self.min_roundness,
            min_peak=self.min_peak,
            min_weight=self.min_weight,
            split=self.split,
            step=self.step,
        )
        # one number is for all cameras, several are one for each, in their order
        each = threshold if len(threshold) > 1 else None
        return DetectionSettings(blobs, thresholds=each, mask_static=self.mask_static, times=self.times, rate=self.rate)

    def named(self) -> dict[str, Any]:
        """The options that decide what is a blob, for reports."""
        names = ("mask_static", "background", "min_size", "max_size", "min_width", "min_roundness", "split", "step", "min_peak")
        return {name: getattr(self, name) for name in (*names, "min_weight", "connectivity", "weight_reference")}


@takes(DetectOptions)
def detect(options: DetectOptions) -> None:
    """Find the markers in the images of all cameras.

    Writes one row per blob: frame, camera, x, y, size, and the time where cameras are not triggered together. With --times, blobs are
    interpolated to a common clock. Cameras that run out of step, videos that break off and images that cannot be read are named.
    """
    outputs = options.output, options.report, options.json
    _console.check_outputs(outputs, (*options.sources, options.rig, options.times), options.overwrite)
    _console.silence_opencv()
    from asterism import detection
    from asterism.cameras.files import read_rig
    from asterism.findings import exit_status
    from asterism.formats import write_blobs

    # the rig names the cameras in their order, and says which are missing
    rig = None if options.rig is None else read_rig(options.rig)
    settings = options.settings()
    with _console.progress("detecting") as progress:
        result = detection.detect(options.sources, settings, rig=rig, workers=options.workers, progress=progress)
    write_blobs(result.blobs, options.output)
    if options.json != "-":
        _print(result)
        _console.result(f"{_line(result)} -> {options.output}")
    for finding in result.findings:
        _console.report(finding)
    files = {"output": options.output, "rig": options.rig, "times": options.times}
    if options.report is not None:
        from asterism.report import detection_report

        detection_report(options.report, result, settings={**files, **options.named()})
    _console.write_json(options.json, {"command": "detect", **files, "settings": options.named(), **result.to_dict()})
    raise typer.Exit(exit_status(result.findings))


def _thresholds(given: str | None) -> list[float]:
    """The numbers of --threshold; none where it was not given. Raises AsterismError for a word."""
    try:
        return [] if given is None else [float(number) for number in given.split(",")]
    except ValueError:
        raise AsterismError(f"--threshold {given} is not a number; give one, or one for each camera such as 9,9,11.") from None


def _line(result: Detection) -> str:
    timing = f"at {result.blobs.rate:g} frames/s" + (", which nothing says: give --rate" if result.rate_assumed else "")
    cameras = f"{len(result.cameras)} camera{'s' if len(result.cameras) > 1 else ''}"
    blobs = f"{_console.count(len(result.blobs.xy))} blobs"
    if result.not_followed > 0:
        share = _console.percent(result.not_followed, 1)
        # what is not followed cannot be moved to the common clock, and is lost: it must be said
        blobs += f" at common instants, without the {share} that cannot be followed from frame to frame"
    return f"{cameras}, {len(result.blobs)} frames {timing}; {blobs}"


def _print(result: Detection) -> None:
    rows = [
        [
            # the file is named only where it says more than the camera's name
            camera.name if camera.name in (camera.path.stem, camera.path.name) else f"{camera.name} ({camera.path.name})",
            f"{camera.size[0]} x {camera.size[1]}",
            str(camera.frames),
            f"{camera.threshold:.0f}",
            _console.count(camera.blobs),
            f"{camera.blobs / max(camera.frames, 1):.1f}",
            _console.count(camera.overlapping),
            _console.count(camera.unround),
            _console.count(camera.at_border),
            _console.count(camera.masked_places),
            _console.count(camera.lag_frames),
        ]
        for camera in result.cameras
    ]
    head = [
        "camera",
        "size",
        "images",
        "threshold",
        "blobs",
        "per image",
        "overlapping",
        "unround",
        "cut by edge",
        "lights masked",
        "frames behind",
    ]
    _console.table("Blobs", head, rows, left=1)
