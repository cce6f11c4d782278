"""`asterism calibrate refine`: a rig and any recording in; which camera was moved, and the refined rig, out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report
from asterism.cli.calibrate._calibration import write_cameras
from asterism.findings import Finding, exit_status

if TYPE_CHECKING:
    from asterism.calibration import Refinement


@dataclass(frozen=True)
class RefineOptions:
    """What `asterism calibrate refine` is asked to do."""

    blobs: Annotated[Path, typer.Argument(metavar="2D.CSV", help="What the cameras saw: any recording of markers.", show_default=False)]
    rig: Annotated[Path, typer.Option("--rig", metavar="FILE", help="The rig as it was calibrated.", show_default=False)]
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="The refined rig to write.", show_default=False)] = (
        None
    )
    frames: Annotated[int, typer.Option("--frames", metavar="N", min=10, help="How many frames to use.")] = 80
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(RefineOptions)
def refine(options: RefineOptions) -> None:
    """Tell which camera of a rig was moved, and correct its pose from any later recording.

    Each camera is compared with what the others see. Those that were moved are named and posed anew, the others stay as they are.
    """
    for path in (options.output, options.report, options.json):
        _console.check_new(path, options.overwrite)
    from asterism.calibration import refine_rig
    from asterism.cameras.files import read_rig
    from asterism.formats import read_blobs

    rig = read_rig(options.rig)
    # in the order of the rig: a camera that saw nothing keeps its place
    seen = read_blobs(options.blobs, rig.names)
    with _console.progress("refining") as progress:
        made = refine_rig(seen, rig, frames=options.frames, progress=progress)
    findings = list(made.findings)
    if options.output is not None:
        findings += write_cameras(made.rig, options.output)
    if options.report is not None:
        from asterism.report import refinement_report

        refinement_report(options.report, made, settings={"2D points": options.blobs, "rig": options.rig})
    _console.write_json(options.json, _as_json(made, findings, options, len(seen)))
    if options.json != "-":
        _print(made)
    # last, so that they stand below the table that they explain
    for finding in findings:
        _console.report(finding)
    raise typer.Exit(exit_status(findings))


def _as_json(made: Refinement, findings: Sequence[Finding], options: RefineOptions, frames: int) -> dict[str, Any]:
    return {
        "command": "calibrate refine",
        "file": options.blobs,
        "rig": options.output,
        "frames": frames,
        "frames_used": made.frames,
        "noise_px": made.noise,
        "findings": [finding.to_dict() for finding in findings],
        "cameras": [
            {
                "name": check.name,
                "state": check.state,
                "moved_px": check.moved_px,
                "reprojection_rms_px": check.rms_px,
                "turned_deg": math.degrees(check.turned),
                "shifted_m": check.shifted,
                "zoomed": check.zoomed,
                "lag_frames": check.lag_frames,
                "points": check.points,
            }
            for check in made.cameras
        ],
    }


def _print(made: Refinement) -> None:
    _console.table(
        f"{len(made.cameras)} cameras in {made.frames} frames, {made.noise:.2f} px of noise",
        ["camera", "state", "moved px", "error px", "turned deg", "shifted mm", "zoomed %", "points"],
        [
            [
                check.name,
                check.state,
                f"{check.moved_px:.2f}" if math.isfinite(check.moved_px) else "–",
                f"{check.rms_px:.2f}" if math.isfinite(check.rms_px) else "–",
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
        _console.result("no camera was moved.")
