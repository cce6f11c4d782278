"""`asterism live cameras set`: settings by name in; what each camera has then, out."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite
from asterism.cli.live_cameras._which import Addresses, Cameras, cameras_of, opened_cameras, opening_findings
from asterism.findings import exit_status


@dataclass(frozen=True)
class SetCamerasOptions:
    """What `asterism live cameras set` is asked to do."""

    settings: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME=VALUE",
            help="As exposure=4ms gain=6 rate=60 trigger=line1 threshold=80 size=640x480 format=MJPG white-balance=4500 focus=0.",
            show_default=False,
        ),
    ]
    cameras: Cameras = None
    addresses: Addresses = field(default_factory=lambda: [])
    only: Annotated[list[str], typer.Option("--only", metavar="NAME", help="On this camera alone. Several times.")] = field(
        default_factory=lambda: []
    )
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write the cameras with these settings, for --cameras.", show_default=False),
    ] = None
    overwrite: Overwrite = False
    json: Json = None


@takes(SetCamerasOptions)
def set(options: SetCamerasOptions) -> None:
    """Set exposure, gain, rate, trigger, threshold and more, on all cameras at once.

    Values have units: exposure=4ms, exposure=auto. A feature of a machine vision camera has its own name, as ReverseX=true. What a camera
    rounds or cannot do is told for each. Many cameras forget what was set when another program opens them: keep it in a file with -o, and
    give this to --cameras. An exposure that is a number switches the automatic one off.
    """
    from asterism.live.cameras import camera_findings, parse_setting, save_cameras, with_settings

    _console.check_outputs([options.output, options.json], [], options.overwrite)
    asked = dict(parse_setting(text) for text in options.settings)
    before = cameras_of(options.cameras, options.addresses)
    specs = with_settings(before, asked, options.only)
    group = opened_cameras([spec for spec in specs if not options.only or spec.name in options.only], options.cameras)
    try:
        outcomes = [outcome for outcome in group.outcomes if outcome.setting in asked or not outcome.as_asked]
        if options.output is not None:
            save_cameras(options.output, specs, group.said())
    finally:
        group.close()
    findings = [*opening_findings(group), *camera_findings([], outcomes)]
    if options.json != "-":
        for outcome in outcomes:
            if not outcome.problem:
                _console.result(str(outcome))
    for finding in findings:
        if options.json == "-" or finding.severity > 0 or finding.code != "live-camera-setting":
            _console.report(finding)
    content = {
        "command": "live cameras set",
        "output": options.output,
        "settings": [dataclasses.asdict(outcome) | {"as_asked": outcome.as_asked} for outcome in outcomes],
        "findings": [finding.to_dict() for finding in findings],
    }
    _console.write_json(options.json, content)
    raise typer.Exit(exit_status(findings))
