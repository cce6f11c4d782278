"""What `asterism calibrate` verbs share: options, and how a calibration that should not be used ends."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.findings import Finding, Severity, exit_status, worst

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
