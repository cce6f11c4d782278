"""`asterism calibrate wand`: blobs of a waved wand in; a rig, and whether to trust it, out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, metres
from asterism.cli.calibrate._calibration import Force, RigToWrite, report_findings, show_notes, write_cameras
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.calibration.wand import WandCalibration
    from asterism.cameras import Rig
    from asterism.findings import Finding

_USUAL_WAND = "0 0.2 0.6"


@dataclass(frozen=True)
class WandOptions:
    """What `asterism calibrate wand` is asked to do."""

    blobs: Annotated[
        Path, typer.Argument(metavar="2D.CSV", help="What the cameras saw: frame,camera,x,y[,size][,time].", show_default=False)
    ]
    lengths: Annotated[
        str | None,
        typer.Option(
            "--wand",
            metavar="M M M",
            help="Places of its markers along the wand, in metres; 0 for one moved marker.",
            show_default=_USUAL_WAND,
        ),
    ] = None
    output: RigToWrite = None
    image_size: Annotated[
        list[str] | None,
        typer.Option("--image-size", metavar="WxH", help="Size of the images, such as 1280x1024; or NAME=WxH for each camera."),
    ] = None
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="FILE", help="Cameras whose lenses and image sizes are known.", show_default=False)
    ] = None
    floor: Annotated[
        Path | None,
        typer.Option("--floor", metavar="2D.CSV", help="The wand lying on the floor in two directions, or the L-frame of --l-frame."),
    ] = None
    l_frame: Annotated[
        str | None,
        typer.Option("--l-frame", metavar="POINTS", help="Where its markers are, in metres, such as '0,0 0.2,0 0.6,0 0,0.4'."),
    ] = None
    points: Annotated[
        Path | None,
        typer.Option("--points", metavar="CSV", help="point,camera,x,y: images of three points called origin, x and y."),
    ] = None
    distance: Annotated[
        str | None, typer.Option("--distance", metavar="A,B=M", help="Metres between two cameras: the scale for one moved marker.")
    ] = None
    force: Force = False
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None

    def check(self) -> None:
        """Raise AsterismError where outputs cannot be written or options contradict each other."""
        for path in (self.output, self.report, self.json):
            _console.check_new(path, self.overwrite)
        if self.l_frame is not None and self.floor is None:
            raise AsterismError("--l-frame says where markers are; give the recording in which they lie still as --floor 2D.CSV, too.")
        if self.floor is not None and self.points is not None:
            raise AsterismError("--floor and --points both say where the world is; give one of them.")


@takes(WandOptions)
def wand(options: WandOptions) -> None:
    """Calibrate cameras by a waved wand, from nothing but image sizes and its lengths.

    Wave a wand of three markers in a line through all of the volume for a minute, turning it. Strays are left out, cameras that
    saw nothing are named, and a calibration that should not be used is said to be one and not written.
    """
    options.check()
    made = _calibrated(options)
    wanted = options.output is not None
    # a rig that should not be used is not left where the next command finds it
    written = wanted and (made.usable or options.force)
    findings = list(made.findings)
    if options.output is not None and written:
        findings += write_cameras(made.rig, options.output)
    if options.report is not None:
        from asterism.report import wand_report

        lengths = " ".join(f"{length:g}" for length in made.wand.lengths)
        settings = {"2D points": options.blobs, "wand in m": lengths, "known lenses": options.rig}
        wand_report(options.report, made, settings=settings)
    _console.write_json(options.json, _as_json(made, findings, options.blobs, options.output if written else None))
    if options.json != "-":
        _print(made)
        # the usual wand is a guess, and the scale of all that follows
        if options.lengths is None:
            _console.result(f"note: the wand's markers were taken to be at {_USUAL_WAND} m; where yours are not, give --wand.")
    raise typer.Exit(report_findings(findings, written=written, wanted=wanted))


def _calibrated(options: WandOptions) -> WandCalibration:
    """The calibration, in the world frame that was asked for."""
    from asterism.calibration.wand import calibrate_wand
    from asterism.cameras.files import read_rig
    from asterism.formats import read_blobs

    # lenses that are known stay; only the cameras' places are found
    known = None if options.rig is None else read_rig(options.rig)
    seen = read_blobs(options.blobs, None if known is None else known.names)
    with _console.progress("calibrating") as progress:
        made = calibrate_wand(
            seen,
            metres(_USUAL_WAND if options.lengths is None else options.lengths, "--wand"),
            sizes=_sizes(options.image_size or [], seen.cameras),
            known=known,
            distance=_distance(options.distance),
            progress=progress,
        )
    return _in_world(made, options)


def _in_world(made: WandCalibration, options: WandOptions) -> WandCalibration:
    from asterism.calibration.wand import in_world, world_from_floor_wand, world_from_l_frame, world_from_points
    from asterism.formats import read_blobs

    if options.floor is not None:
        # in the order of the rig, those left out at the end, so that columns and cameras agree
        lying = read_blobs(options.floor, tuple([*made.rig.names, *made.excluded]))
        if options.l_frame is not None:
            # one moved marker tells no scale, but the L-frame does
            scaled = len(made.wand) > 1 or options.distance is not None
            world = world_from_l_frame(made.rig, lying, _points(options.l_frame), scaled=scaled)
            source = f"the L-frame of {options.floor.name}"
        else:
            world = world_from_floor_wand(made.rig, lying, made.wand.lengths)
            source = f"the wand on the floor of {options.floor.name}"
    elif options.points is not None:
        world = world_from_points(*_named_points(options.points, made.rig))
        source = f"the three points of {options.points.name}"
    else:
        return made
    # the wand's places move with the cameras, so that the report shows one world
    return made.moved(in_world(made.rig, world, source), *world)


def _named_points(path: Path, rig: Rig) -> list[Any]:
    """Three points from a CSV of their images: point,camera,x,y."""
    import csv

    import numpy as np

    from asterism.cameras.bundle import Sightings, locate

    with path.open(encoding="utf-8-sig", newline="") as stream:
        rows = list(csv.DictReader(stream))
    order = ["origin", "x", "y"]
    frame, camera, xy = [], [], []
    # counted as an editor shows them, after the header
    for number, row in enumerate(rows, 2):
        try:
            name, seen_by, place = row["point"].strip(), row["camera"].strip(), (float(row["x"]), float(row["y"]))
        except (KeyError, TypeError, ValueError, AttributeError):
            raise AsterismError(f"{path}, line {number}: expected point,camera,x,y with numbers in px for x and y.") from None
        if name not in order:
            raise AsterismError(f"{path}, line {number}: a point is called {name}; call them origin, x and y.")
        # cameras that were left out have no place from which a point could be seen
        if seen_by in rig.names:
            frame.append(order.index(name))
            camera.append(rig.names.index(seen_by))
            xy.append(place)
    found = locate(rig.cameras, Sightings.of(frame, camera, np.zeros(len(frame), int), np.array(xy).reshape(-1, 2)), 3, 1)[:, 0]
    for name, point in zip(order, found, strict=True):
        if not np.isfinite(point).all():
            raise AsterismError(f"{path}: fewer than two calibrated cameras show the point {name}; give its place in another image.")
    return list(found)


def _points(given: str) -> list[list[float]]:
    try:
        points = [[float(number) for number in point.split(",")] for point in given.replace(";", " ").split()]
    except ValueError:
        points = []
    if not points or any(len(point) not in (2, 3) for point in points):
        raise AsterismError(f"--l-frame {given} is not a list of points; give metres, such as '0,0 0.2,0 0.6,0 0,0.4'.")
    return [[*point, 0.0][:3] for point in points]


def _sizes(given: list[str], cameras: tuple[str, ...]) -> dict[str, tuple[int, int]]:
    """Image sizes by camera: from `WxH` for all and `NAME=WxH` for one."""
    sizes: dict[str, tuple[int, int]] = {}
    # sizes for all come first, so that one for a camera overrules them
    for word in sorted(given, key=lambda word: "=" in word):
        found = re.fullmatch(r"(?:(.+)=)?(\d+)[xX×](\d+)", word.strip())
        if not found:
            raise AsterismError(f"--image-size {word} is not a size; give for example 1280x1024, or left=1280x1024.")
        if found[1] and found[1] not in cameras:
            raise AsterismError(f"--image-size {word}: there is no camera {found[1]}; they are {', '.join(cameras)}.")
        for name in [found[1]] if found[1] else cameras:
            sizes[name] = (int(found[2]), int(found[3]))
    return sizes


def _distance(given: str | None) -> tuple[str, str, float] | None:
    if given is None:
        return None
    found = re.fullmatch(r"(.+),(.+)=([0-9.]+)", given)
    if not found:
        raise AsterismError(f"--distance {given} is not a distance; give two cameras and the metres between them, such as left,right=4.25.")
    return found[1].strip(), found[2].strip(), float(found[3])


def _as_json(made: WandCalibration, findings: Sequence[Finding], blobs: Path, output: Path | None) -> dict[str, Any]:
    import numpy as np

    from asterism.calibration.wand import coverage

    lengths = made.lengths[np.isfinite(made.lengths)]
    # of a single marker there is no length to compare
    measured = len(made.wand.lengths) > 1 and len(lengths) > 0
    cells = coverage(made)
    return {
        "command": "calibrate wand",
        "file": blobs,
        "rig": output,
        "usable": made.usable,
        "findings": [finding.to_dict() for finding in findings],
        "frames": made.frames,
        "frames_used": len(made.used),
        "wand_m": made.wand.lengths,
        "wand_length_mean_m": float(lengths.mean()) if measured else None,
        "wand_length_std_m": float(lengths.std()) if measured else None,
        "reprojection_rms_px": made.rms,
        "noise_px": made.noise,
        "rejected": made.mean_rejected_share,
        "cameras": [
            {
                "name": camera.name,
                "markers": int((made.sightings.camera == c).sum()),
                "reprojection_rms_px": camera.error,
                "focal_px": camera.focal,
                "focal_sigma_px": made.sigma[c, 6],
                "centre_px": camera.centre,
                "radial": camera.radial,
                "tangential": camera.tangential,
                "position_m": camera.position,
                "rejected": made.rejected_share[c],
                "position_sigma_m": made.position_sigma[c],
                "lag_frames": int(made.lag_frames[c]),
                "image_covered": float((cells[c] > 0).mean()),
            }
            for c, camera in enumerate(made.rig)
        ],
        "excluded": {name: " ".join(why) for name, why in made.excluded.items()},
    }  # fmt: skip


def _print(made: WandCalibration) -> None:
    import numpy as np

    _console.table(
        f"{len(made.rig)} cameras from {len(made.used):,} of {made.frames:,} frames",
        ["camera", "markers", "error px", "focal px", "±", "x m", "y m", "z m"],
        [
            [
                camera.name,
                _console.count(int((made.sightings.camera == c).sum())),
                f"{camera.error:.3f}",
                f"{camera.focal[0]:.1f}",
                f"{made.sigma[c, 6]:.1f}",
                *(f"{place:.3f}" for place in camera.position),
            ]
            for c, camera in enumerate(made.rig)
        ],
    )
    lengths = made.lengths[np.isfinite(made.lengths)]
    wand = f", wand {1000 * lengths.mean():.2f} ± {1000 * lengths.std():.2f} mm" if len(made.wand.lengths) > 1 and len(lengths) else ""
    _console.result(
        f"reprojection error {made.rms:.3f} px{wand}, {_console.percent(made.mean_rejected_share)} of the wand's images left out"
    )
    show_notes(made.findings)
