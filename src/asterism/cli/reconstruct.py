"""`asterism reconstruct`: blobs of calibrated cameras in, 3D points out."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.reconstruction import Reconstruction, ReconstructionSettings


class Method(StrEnum):
    """How points are chosen among all that the blobs allow."""

    GLOBAL = "global"
    PLAIN = "plain"
    PLAIN_COVARIANCE = "plain-covariance"


@dataclass(frozen=True)
class ReconstructOptions:
    """What `asterism reconstruct` is asked to do."""

    blobs: Annotated[Path, typer.Argument(metavar="BLOBS", help="2D CSV: frame, camera, x, y[, size][, time].", show_default=False)]
    rig: Annotated[Path, typer.Option("--rig", metavar="FILE", help="The calibrated rig.", show_default=False)]
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Where the points go: .npz, .c3d, .csv, .trc, ...", show_default=False)
    ]
    method: Annotated[
        Method, typer.Option(help="The likeliest set of points, or the thesis' plain merging (by sensitivity, or by covariance).")
    ] = Method.GLOBAL
    min_cameras: Annotated[int, typer.Option(metavar="N", min=2, help="How many cameras must show a point.")] = 2
    noise: Annotated[
        float | None, typer.Option(metavar="PX", help="How far off blobs are, per axis. Else estimated from the blobs.", show_default=False)
    ] = None
    volume: Annotated[
        str | None,
        typer.Option(
            metavar="BOX",
            help="Where points may be: width x depth x height in m around the origin, or spans such as -3:3,-2:2,0:2.5. Else anywhere.",
            show_default=False,
        ),
    ] = None
    mask_static: Annotated[
        bool, typer.Option("--mask-static", help="Leave out blobs that never move: lamps, reflections, and markers that rest.")
    ] = False
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Move points to where their paths through time say that they are, with the exactness of that.")
    ] = False
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Frames per second. Else as the file says.", show_default=False)] = None
    overwrite: Overwrite = False
    json: Json = None

    def settings(self, rig: Rig) -> ReconstructionSettings:
        """The options as `asterism.reconstruction.reconstruct` takes them."""
        from asterism.cameras.accuracy import Volume
        from asterism.reconstruction import ReconstructionSettings

        box = None if self.volume is None else Volume.parse(self.volume, "z" if rig.vertical is None else rig.vertical)
        return ReconstructionSettings(
            method=self.method.value,
            noise=self.noise,
            min_cameras=self.min_cameras,
            volume=None if box is None else (box.low, box.high),
            mask_static=self.mask_static,
        )


@takes(ReconstructOptions)
def reconstruct(options: ReconstructOptions) -> None:
    """Make 3D points from the blobs of calibrated cameras.

    Each blob shows one point at most, and of all sets of points that the blobs of a frame allow the likeliest is chosen, so that few ghosts
    are left. Every point carries its reprojection error, covariance and cameras; NPZ keeps all of them, C3D what it can.
    `asterism label` then gives the points names.
    """
    from asterism import reconstruction
    from asterism.cameras.files import read_rig
    from asterism.cli._recordings import assumptions, not_carried
    from asterism.findings import exit_status
    from asterism.formats import check_suffix, read_blobs

    output = options.output
    check_suffix(output)
    _console.check_new(output, options.overwrite)
    _console.check_new(options.json, options.overwrite)
    # the rig first: it says which cameras the blobs must be of
    rig = read_rig(options.rig)
    settings = options.settings(rig)
    # in the rig's order; cameras that saw nothing keep their place
    blobs = read_blobs(options.blobs, cameras=rig.names, rate=options.rate)
    with _console.progress("reconstructing") as progress:
        result = reconstruction.reconstruct(blobs, rig, settings, progress=progress)
    # before smoothing, which hides what cameras disagree on
    numbers, findings = reconstruction.summary(result, rig)
    if options.smooth:
        result, numbers["smoothed"] = _smoothed(result, rig)
    lost = result.write(output)
    findings = (*assumptions(options.rig, rig), *findings, *not_carried(output, lost, "Write NPZ to keep everything."))
    for finding in findings:
        _console.report(finding)
    if options.json != "-":
        _print(output, numbers)
    content = {**numbers, "findings": [finding.to_dict() for finding in findings], "not_carried": lost}
    _console.write_json(options.json, {"command": "reconstruct", "blobs": options.blobs, "rig": options.rig, "output": output, **content})
    raise typer.Exit(exit_status(findings))


def _smoothed(result: Reconstruction, rig: Rig) -> tuple[Reconstruction, dict[str, Any]]:
    """The points moved to where their paths say that they are, and numbers about that."""
    import numpy as np

    from asterism.motion import smooth_paths

    with _console.progress("smoothing") as progress:
        paths = smooth_paths(result.clouds, result.covariance, progress=progress)
    # residuals belong to points: they are taken anew of the moved ones
    result = result.with_points(paths.clouds, paths.covariance, rig)
    return result, {
        "paths": paths.paths,
        "moved_m": float(np.median(paths.moved)) if len(paths.moved) else None,
        "deviation_m": float(np.median(result.deviation)) if len(paths.moved) else None,
    }


def _print(output: Path, numbers: dict[str, Any]) -> None:
    def pixels(value: float) -> str:
        return "–" if value != value else f"{value:.3f}"

    rows = [
        [
            camera["name"],
            _console.count(camera["blobs"]),
            _console.percent(camera["used"]),
            pixels(camera["residual_px"]),
            pixels(camera["systematic_px"]),
        ]
        for camera in numbers["cameras"]
    ]
    _console.table("cameras", ("camera", "blobs", "used", "residual, px", "systematic, px"), rows)
    per_frame = numbers["points_per_frame"]
    by_cameras = ", ".join(f"{count:,} by {cameras}" for cameras, count in numbers["points_by_cameras"].items())
    facts = [
        ("points", f"{numbers['points']:,}; {per_frame['fewest']} to {per_frame['most']} a frame, {per_frame['median']:g} mostly"),
        ("seen by cameras", by_cameras or "–"),
        ("pixel noise", f"{numbers['noise_px']:.3f} px"),
    ]
    # without a point there is nothing that could be off
    if numbers["residual_px"]:
        facts.append(("residual", f"{numbers['residual_px']['median']:.3f} px mostly, {numbers['residual_px']['p95']:.3f} px for 95 %"))
        facts.append(("one deviation", f"{1000 * numbers['deviation_m']['median']:.2f} mm mostly"))
    if numbers["static_points"]:
        # a light that two cameras see may be two lights
        by_many = sum(point["cameras"] > 2 for point in numbers["static_points"])
        facts.append(("points that never move", f"{len(numbers['static_points'])}, {by_many} of them by three cameras or more"))
    masked = sum(camera["masked_places"] for camera in numbers["cameras"])
    if masked:
        facts.append(("static lights left out", f"{masked} places in all images"))
    if numbers.get("smoothed", {}).get("paths"):
        paths = numbers["smoothed"]
        facts.append(("smoothed", f"{_console.count(paths['paths'])} paths, points moved by {1000 * paths['moved_m']:.2f} mm mostly"))
        facts.append(("one deviation then", f"{1000 * paths['deviation_m']:.2f} mm mostly"))
    _console.facts(f"{output}: {numbers['frames']:,} frames", facts)
