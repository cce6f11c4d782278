"""`asterism live cameras list`: nothing, a file or addresses in; the cameras, what they are and what can be set on each, out."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite
from asterism.cli.live_cameras._which import Addresses, Cameras, Producer, cameras_of, found_cameras, opened_cameras, opening_findings
from asterism.findings import exit_status


@dataclass(frozen=True)
class ListCamerasOptions:
    """What `asterism live cameras list` is asked to do."""

    cameras: Cameras = None
    addresses: Addresses = field(default_factory=lambda: [])
    cti: Producer = ""
    settings: Annotated[bool, typer.Option("--settings", help="Say what each has and what can be set.")] = False
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write them as a file for --cameras.", show_default=False)
    ] = None
    overwrite: Overwrite = False
    json: Json = None


@takes(ListCamerasOptions)
def list(options: ListCamerasOptions) -> None:
    """List cameras: those that are plugged in, or those of a file.

    Webcams are found by this system, machine vision cameras by the GenTL producers that their makers' drivers install. Those of a file or
    at an address are opened, to see whether they are there; with --settings all are. Write a file with -o, give each camera its name in the
    rig there, and use it with --cameras.
    """
    from asterism.live.addresses import without_password
    from asterism.live.cameras import SETTINGS, CameraSpec, save_cameras
    from asterism.live.cameras.settings import setting_text

    _console.check_outputs([options.output, options.json], [options.cameras], options.overwrite)
    named = options.cameras is not None or options.addresses
    abouts = [] if named else found_cameras(options.cti)
    specs = cameras_of(options.cameras, options.addresses) if named else [CameraSpec(about.name, about.address) for about in abouts]
    findings, rows, said = [], [], {}
    if named or (options.settings and specs):
        group = opened_cameras(specs, options.cameras)
        findings = opening_findings(group)
        abouts = [camera.about for camera in group.cameras]
        if options.settings:
            said = {camera.name: {name: camera.get(name) for name in camera.settings} for camera in group.cameras}
        own = group.said() if options.settings else {about.name: about.said() for about in abouts}
        group.close()
    else:
        own = {about.name: about.said() for about in abouts}
    if options.output is not None:
        save_cameras(options.output, specs, own)
    by_name = {about.name: about for about in abouts}
    for spec in specs:
        about = by_name.get(spec.name)
        size = "" if about is None or not any(about.size) else f"{about.size[0]} x {about.size[1]}"
        rate = "" if about is None or math.isnan(about.rate) else f"{about.rate:g} Hz"
        has = ", ".join(f"{name} {setting_text(name, value)}" for name, value in said.get(spec.name, {}).items() if value is not None)
        model, serial = ("", "") if about is None else (about.model, about.serial)
        rows.append([spec.name, without_password(spec.address), model, serial, size, rate, *([has] if options.settings else [])])
    if options.json != "-":
        columns = ["name", "address", "model", "serial", "size", "rate", *(["has"] if options.settings else [])]
        if rows:
            _console.table("Cameras", columns, rows, left=len(columns))
        else:
            _console.result("No camera was found.")
    for finding in findings:
        _console.report(finding)
    content = {
        "command": "live cameras list",
        "cameras": [
            {"name": spec.name, "address": without_password(spec.address), "asked": dict(spec.settings), "has": said.get(spec.name, {})}
            | (dataclasses.asdict(by_name[spec.name]) if spec.name in by_name else {})
            for spec in specs
        ],
        "units": {name: kind.unit for name, kind in SETTINGS.items() if kind.unit},
        "findings": [finding.to_dict() for finding in findings],
    }
    _console.write_json(options.json, content)
    raise typer.Exit(exit_status(findings) if specs else 1)
