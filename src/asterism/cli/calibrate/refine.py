"""`asterism calibrate refine`: a rig and any recording of markers in; which camera was bumped, and the mended rig, out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Overwrite, Report

if TYPE_CHECKING:
    from asterism.calibration import Refinement


def refine(
    blobs: Annotated[Path, typer.Argument(metavar="2D.CSV", help="Any recording of markers: frame,camera,x,y.", show_default=False)],
    rig: Annotated[Path, typer.Option("--rig", metavar="FILE", help="The rig as it was calibrated.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The mended rig to write.", show_default=False)
    ] = None,
    frames: Annotated[int, typer.Option("--frames", metavar="N", min=10, help="How many frames to look at.")] = 80,
    overwrite: Overwrite = False,
    report: Report = None,
    json: Json = None,
) -> None:
    """Tell which camera of a rig was bumped, and mend it from any later recording.

    Each camera is compared with what the others see. Those that were moved are named and posed anew, the others stay as they are.
    """
    for path in (output, report, json):
        _console.check_new(path, overwrite)
    from asterism.calibration import refine_rig
    from asterism.cameras.files import read_rig, write_rig
    from asterism.formats import read_blobs

    given = read_rig(rig)
    seen = read_blobs(blobs, given.names)
    with _console.progress("refining") as progress:
        made = refine_rig(seen, given, frames=frames, progress=progress)
    if output is not None:
        write_rig(made.rig, output)
    if report is not None:
        from asterism.report import refinement_report

        refinement_report(report, made, settings={"2D points": blobs, "rig": rig})
    _console.write_json(
        json,
        {
            "command": "calibrate refine",
            "file": blobs,
            "rig": output,
            "frames": len(seen),
            "frames_used": made.frames,
            "noise_px": made.noise,
            "findings": made.findings,
            "cameras": [
                {
                    "name": check.name,
                    "state": check.state,
                    "moved_px": check.before,
                    "reprojection_rms_px": check.after,
                    "turned_deg": math.degrees(check.turned),
                    "shifted_m": check.shifted,
                    "zoomed": check.zoomed,
                    "behind_frames": check.behind,
                    "points": check.points,
                }
                for check in made.cameras
            ],
        },
    )
    if json != "-":
        _print(made)
    for finding in made.findings:
        _console.error(f"{blobs}: {finding}")
    raise typer.Exit(1 if made.findings else 0)


def _print(made: Refinement) -> None:
    _console.table(
        f"{len(made.cameras)} cameras in {made.frames} frames, {made.noise:.2f} px of noise",
        ["camera", "state", "moved px", "error px", "turned deg", "shifted mm", "zoomed %", "points"],
        [
            [
                check.name,
                check.state,
                f"{check.before:.2f}" if math.isfinite(check.before) else "–",
                f"{check.after:.2f}" if math.isfinite(check.after) else "–",
                f"{math.degrees(check.turned):.2f}",
                f"{1000 * check.shifted:.1f}",
                f"{100 * check.zoomed:+.2f}" if check.zoomed else "–",
                _console.count(check.points),
            ]
            for check in made.cameras
        ],
        left=2,
    )
    if not made.findings:
        _console.result("no camera was bumped.")
