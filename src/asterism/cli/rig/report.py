"""`asterism rig report`: a rig file in; what it measures where, as a table, a page and JSON, out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Overwrite, metres
from asterism.cli._options import image_size as size_of
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.cameras.accuracy import RigMap

RigFile = Annotated[Path, typer.Argument(metavar="RIG", help="A rig file, such as `asterism calibrate` writes.", show_default=False)]
VolumeOption = Annotated[
    str | None,
    typer.Option(
        "--volume",
        metavar="BOX",
        help="Width x depth x height on the floor (6x4x2.5), or spans along x, y, z (-3:3,-2:2,0:2.5), in metres. Else what three see.",
        show_default=False,
    ),
]
Noise = Annotated[
    float | None,
    typer.Option("--noise", metavar="PX", help="Standard deviation of a blob's x and y. Else what the rig's calibration left, or 0.3."),
]
Lengths = Annotated[
    str | None,
    typer.Option("--wand", metavar="METRES", help="Where the wand's markers sit along it: 0 0.2 0.6.", show_default=False),
]
_LITTLE = 0.01


def report(
    rig: RigFile,
    volume: VolumeOption = None,
    noise: Noise = None,
    image_size: Annotated[
        str | None,
        typer.Option("--image-size", metavar="WxH", help="Of cameras whose images' size the rig does not know.", show_default=False),
    ] = None,
    blobs: Annotated[
        Path | None, typer.Option("--blobs", metavar="CSV", help="What the cameras saw of a waved wand, with --wand.", show_default=False)
    ] = None,
    wand: Lengths = None,
    still: Annotated[
        Path | None, typer.Option("--still", metavar="CSV", help="What they saw of markers that stand still.", show_default=False)
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write an HTML report.", show_default=False)] = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Tell what a rig measures, place by place.

    How much of the volume three cameras see, how exactly they measure there, the sensitivity of every pair, and what each camera is
    worth; from recordings, the accuracy against a wand and the repeatability of what stands still. A camera that sees nothing of the
    volume is named.
    """
    if (blobs is None) != (wand is None):
        raise AsterismError("accuracy against a wand needs both what was seen of it, --blobs, and its lengths, --wand.")
    _console.check_new(output, overwrite)
    _console.check_new(json, overwrite)
    import numpy as np

    from asterism.calibration.measured_accuracy import measure_still, measure_wand
    from asterism.cameras.accuracy import Volume, map_rig, repeatability, wand_accuracy
    from asterism.cameras.files import read_rig
    from asterism.formats import read_blobs
    from asterism.report.rig import camera_facts, pair_scalars, rig_report

    given = read_rig(rig)
    box = None if volume is None else Volume.parse(volume, "z" if given.vertical is None else given.vertical)
    if image_size is not None:
        size = size_of(image_size, "--image-size")
        given = replace(given, cameras=tuple(camera if camera.size else replace(camera, size=size) for camera in given))
    with _console.progress("rig report") as progress:
        result = map_rig(given, box, noise=noise, progress=progress)
    waved = resting = None
    if blobs is not None and wand is not None:
        lengths = metres(wand, "--wand")
        waved = wand_accuracy(measure_wand(given, read_blobs(blobs), lengths), lengths)
    if still is not None:
        resting = repeatability(measure_still(given, read_blobs(still)))
    cameras = camera_facts(given, result)
    if json != "-":
        print_map(given, result)
        if waved is not None:
            _console.result(
                f"Wand, {waved.frames:,} frames: lengths {1000 * waved.mean_error:+.3f} mm off on average, "
                f"{_mm(waved.mean_absolute)} without signs, standard deviation {_mm(waved.std)}."
            )
        if resting is not None:
            _console.result("Still markers lie from their mean, on average: " + ", ".join(_mm(float(value)) for value in resting) + ".")
    if output is not None:
        settings = {"rig": rig, "noise px": result.noise, "wand": blobs, "still": still}
        rig_report(output, given, result, title=f"What {rig.name} measures", wand=waved, still=resting, settings=settings)
    idle = [fact["name"] for fact in cameras if fact["sees"] < _LITTLE]
    _console.write_json(
        json,
        {
            "command": "rig report",
            "rig": rig,
            "map": result.to_dict(),
            "cameras": cameras,
            "pairs": pair_scalars(given, result),
            "idle": idle,
            "wand": None if waved is None else vars(waved),
            "repeatability_m": resting,
        },
    )
    if given.vertical is None:
        _console.error(f"{rig} does not say which way is up: z was taken (asterism convert --vertical sets it).")
    blind = not np.isfinite(result.error).any()
    if blind:
        _console.error(f"{rig}: no place of the volume can be measured: two cameras must see it, from two places; move them apart.")
    for name in idle:
        _console.error(f"{rig}: camera {name} sees next to nothing of the volume; turn it, or give the volume that is meant (--volume).")
    raise typer.Exit(1 if idle or blind else 0)


def print_map(rig: Rig, result: RigMap) -> None:
    """The table of a rig's map."""
    told = result.to_dict()
    low, high = result.volume.low, result.volume.high
    spans = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", low, high, strict=True))
    lacking = [("not in the file", ", ".join(rig.lacks))] if rig.lacks else []
    _console.facts(
        f"{len(rig)} cameras, volume {spans} m",
        [
            ("seen by 2 / 3 / 4 cameras", " / ".join(_console.percent(result.coverage(n), 1) for n in (2, 3, 4))),
            ("markers on a body that face two", _console.percent(told["facing_coverage"], 1)),
            (
                "error of a marker, RMS",
                f"median {_mm(told['error_median_m'])}, 95 % of places {_mm(told['error_95_m'])} at {result.noise:.2g} px",
            ),
            (
                "sensitivity of the best pair",
                f"median {_mm(told['sensitivity_median_m'])}, mean of the 12 scalars at ± {result.noise:.2g} px",
            ),
            *lacking,
        ],
    )


def _mm(metres: float | None) -> str:
    return "–" if metres is None else f"{1000 * metres:.2f} mm"
