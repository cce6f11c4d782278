"""What `asterism calibrate` verbs share: options, and how a calibration that should not be used ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from asterism.cli import _console
from asterism.findings import Finding, Severity, exit_status, worst

if TYPE_CHECKING:
    from asterism.calibration.boards import BoardCalibration
    from asterism.cameras import Rig

RigToWrite = Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="The rig to write.", show_default=False)]
Force = Annotated[bool, typer.Option("--force", help="Write the rig even where it should not be used.")]


def show_notes(findings: Sequence[Finding]) -> None:
    """Print notes among the results: they speak against nothing."""
    for finding in findings:
        if finding.severity == Severity.NOTE:
            _console.result(f"note: {finding}")


def report_findings(findings: Sequence[Finding], *, written: bool, wanted: bool) -> int:
    """Print warnings and errors on standard error, and return the exit status.

    written: whether the rig was; wanted: whether a file for it was named. The status is 2 where the rig should not be used and was not
    written.
    """
    for finding in findings:
        if finding.severity > Severity.NOTE:
            _console.report(finding)
    if worst(findings) < Severity.ERROR:
        return exit_status(findings)
    _console.error("do not use this calibration" + ("; it was not written (--force writes it)." if wanted and not written else "."))
    return exit_status(findings) if written else 2


def write_cameras(rig: Rig, output: Path) -> list[Finding]:
    """Write a rig, and return what its format leaves out: a lens that it cannot hold is another one when it is read."""
    from asterism.cameras.files import write_rig

    lost, mend = write_rig(rig, output), "Write .toml, which keeps everything."
    return [Finding("board-format-loses", Severity.WARNING, str(output), f"{output} leaves out {what}.", mend) for what in lost]


class _Outputs(Protocol):
    """What is written of a calibration."""

    @property
    def output(self) -> Path | None:
        """The rig."""

    @property
    def report(self) -> Path | None:
        """The page."""

    @property
    def json(self) -> Any:
        """The numbers."""

    @property
    def force(self) -> bool:
        """Whether a rig that should not be used is written, too."""


def hand_over(
    made: BoardCalibration, command: str, facts: Mapping[str, Any], outputs: _Outputs, settings: Mapping[str, Any], *, alone: bool
) -> int:
    """Write and show a calibration from boards, and return the exit status.

    facts: what JSON says of the inputs; settings: what the page says of them; alone: whether each camera was calibrated by itself, too.
    """
    findings, output = list(made.findings), outputs.output
    # a rig that should not be used is not left where the next command finds it
    written = output is not None and (made.usable or outputs.force)
    if output is not None and written:
        findings += write_cameras(made.rig, output)
    if outputs.report is not None:
        from asterism.report import board_report

        board_report(outputs.report, made, settings=settings)
    told = {"rig": output if written else None, **made.summary(), "findings": [finding.to_dict() for finding in findings]}
    _console.write_json(outputs.json, {"command": command, **facts, **told})
    if outputs.json != "-":
        show_cameras(made, alone=alone)
    return report_findings(findings, written=written, wanted=output is not None)


def show_cameras(made: BoardCalibration, *, alone: bool) -> None:
    """Print a calibration's cameras as a table; alone: with the error of each camera calibrated by itself."""
    summary = made.summary()
    rows = [
        [
            camera["name"],
            f"{camera['views']} of {camera['images']}",
            *([f"{camera['rms_alone_px']:.3f}"] if alone else []),
            f"{camera['rms_px']:.3f}",
            f"{camera['focal_px'][0]:.1f}",
            f"{camera['focal_std_px']:.1f}",
            "–" if camera["position_m"] is None else ", ".join(f"{value:.3f}" for value in camera["position_m"]),
        ]
        for camera in summary["cameras"]
    ]
    errors = ("error alone, px", "together, px") if alone else ("error, px",)
    title = f"{summary['board']}: {summary['frames_used']} of {summary['frames']} frames, {summary['reprojection_rms_px']:.3f} px"
    _console.table(title, ("camera", "views", *errors, "focal length, px", "±", "position, m"), rows)
