"""`asterism reconstruct`: blobs of calibrated cameras in, 3D points out."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Overwrite


class Method(StrEnum):
    """How points are chosen among all that the blobs allow."""

    GLOBAL = "global"
    PLAIN = "plain"


def reconstruct(
    blobs: Annotated[Path, typer.Argument(metavar="BLOBS", help="2D CSV: frame, camera, x, y[, size][, time].", show_default=False)],
    rig: Annotated[Path, typer.Option("--rig", metavar="FILE", help="The calibrated rig.", show_default=False)],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Where the points go: .npz, .c3d, .csv, .trc, ...", show_default=False)
    ],
    method: Annotated[Method, typer.Option(help="The likeliest set of points, or the thesis' plain merging.")] = Method.GLOBAL,
    min_cameras: Annotated[int, typer.Option(metavar="N", min=2, help="How many cameras must show a point.")] = 2,
    noise: Annotated[
        float | None, typer.Option(metavar="PX", help="How far off blobs are, per axis. Else told from the blobs.", show_default=False)
    ] = None,
    volume: Annotated[
        str | None,
        typer.Option(
            metavar="BOX",
            help="Where points may be: width x depth x height in m around the origin, or spans such as -3:3,-2:2,0:2.5. Else anywhere.",
            show_default=False,
        ),
    ] = None,
    mask_static: Annotated[
        bool, typer.Option("--mask-static", help="Leave out blobs that never move: lamps, reflections, and markers that rest.")
    ] = False,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Move points to where their paths through time say that they are, as sure as that is.")
    ] = False,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Frames per second. Else as the file says.", show_default=False)] = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Make 3D points from the blobs of calibrated cameras.

    Each blob shows one point at most, and of all sets of points that the blobs of a frame allow the likeliest is chosen, so that few ghosts
    are left. Every point carries its reprojection error, covariance and cameras; NPZ keeps all of them, C3D what it can.
    `asterism label` then gives the points names.
    """
    import numpy as np

    from asterism.cameras.accuracy import Volume
    from asterism.cameras.files import guesses, read_rig
    from asterism.formats import check_suffix, read_blobs
    from asterism.reconstruction import reconstruct as points_of
    from asterism.reconstruction import summary

    check_suffix(output)
    _console.check_new(output, overwrite)
    _console.check_new(json, overwrite)
    calibrated = read_rig(rig)
    box = None if volume is None else Volume.parse(volume, "z" if calibrated.vertical is None else calibrated.vertical)
    seen = read_blobs(blobs, cameras=calibrated.names, rate=rate)
    with _console.progress("reconstructing") as progress:
        result = points_of(
            seen,
            calibrated,
            method=method.value,
            noise=noise,
            min_cameras=min_cameras,
            volume=None if box is None else (box.low, box.high),
            mask_static=mask_static,
            progress=progress,
        )
    told = summary(result, calibrated)
    if smooth:
        from asterism.motion import smooth_paths

        with _console.progress("smoothing") as progress:
            paths = smooth_paths(result.clouds, result.covariance, progress=progress)
        result = result.with_points(paths.clouds, paths.covariance, calibrated)
        told["smoothed"] = {
            "paths": paths.paths,
            "moved_m": float(np.median(paths.moved)) if len(paths.moved) else None,
            "deviation_m": float(np.median(result.deviation)) if len(paths.moved) else None,
        }
    lost = result.write(output)
    guessed = [f"{rig} does not say {phrase}." for phrase in guesses(calibrated)]
    for sentence in (*guessed, *told["remarks"], *(f"{output} leaves out {what}." for what in lost)):
        _console.error(sentence)
    if json != "-":
        _print(output, told)
    _console.write_json(json, {"command": "reconstruct", "blobs": blobs, "rig": rig, "output": output, **told, "not_carried": lost})
    raise typer.Exit(1 if told["remarks"] else 0)


def _print(output: Path, told: dict[str, Any]) -> None:
    def pixels(value: float) -> str:
        return "–" if value != value else f"{value:.3f}"

    rows = [
        [
            camera["name"],
            _console.count(camera["blobs"]),
            _console.percent(camera["used"]),
            pixels(camera["residual_px"]),
            pixels(camera["off_px"]),
        ]
        for camera in told["cameras"]
    ]
    _console.table("cameras", ("camera", "blobs", "used", "residual, px", "off as a whole, px"), rows)
    per_frame = told["points_per_frame"]
    by_cameras = ", ".join(f"{count:,} by {cameras}" for cameras, count in told["points_by_cameras"].items())
    facts = [
        ("points", f"{told['points']:,}; {per_frame['fewest']} to {per_frame['most']} a frame, {per_frame['median']:g} mostly"),
        ("seen by cameras", by_cameras or "–"),
        ("pixel noise", f"{told['noise_px']:.3f} px"),
    ]
    if told["residual_px"]:
        facts.append(("residual", f"{told['residual_px']['median']:.3f} px mostly, {told['residual_px']['p95']:.3f} px for 95 %"))
        facts.append(("one deviation", f"{1000 * told['deviation_m']['median']:.2f} mm mostly"))
    if told["still_points"]:
        by_many = sum(point["cameras"] > 2 for point in told["still_points"])
        facts.append(("points that never move", f"{len(told['still_points'])}, {by_many} of them by three cameras or more"))
    masked = sum(camera["masked_places"] for camera in told["cameras"])
    if masked:
        facts.append(("static lights left out", f"{masked} places in all images"))
    if told.get("smoothed", {}).get("paths"):
        paths = told["smoothed"]
        facts.append(("smoothed", f"{_console.count(paths['paths'])} paths, points moved by {1000 * paths['moved_m']:.2f} mm mostly"))
        facts.append(("one deviation then", f"{1000 * paths['deviation_m']:.2f} mm mostly"))
    _console.facts(f"{output}: {told['frames']:,} frames", facts)
