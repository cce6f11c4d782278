"""A file of cameras, addresses, or nothing in; which cameras a command is about, out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity

if TYPE_CHECKING:
    from asterism.live.cameras import CameraAbout, CameraGroup, CameraSpec

Cameras = Annotated[
    Path | None,
    typer.Option("--cameras", metavar="FILE", help="The cameras of a rig in TOML; else all that are found.", show_default=False),
]
Addresses = Annotated[
    list[str],
    typer.Option("--address", metavar="ADDRESS", help="A camera instead: camera://0, genicam://SERIAL, a video. Several times."),
]
Producer = Annotated[
    str,
    typer.Option("--cti", metavar="FILE", help="The GenTL producer of machine vision cameras; else those installed.", show_default=False),
]


def found_cameras(producer: str = "") -> list[CameraAbout]:
    """The webcams and machine vision cameras of this machine; why the latter are not looked for is said on standard error."""
    from asterism.live.cameras.found_webcams import found_webcams
    from asterism.live.cameras.machine_vision import found_genicam

    found = found_webcams()
    try:
        found += found_genicam(producer)
    except AsterismError as problem:
        if producer:
            raise
        _console.notice(f"Machine vision cameras are not looked for: {problem}")
    return found


def cameras_of(file: Path | None, addresses: Iterable[str]) -> list[CameraSpec]:
    """The cameras of a file, those at addresses, or all that are found. Raises AsterismError where there are none."""
    from asterism.live.cameras import CameraSpec, load_cameras

    given = [*addresses]
    if file is not None and given:
        raise AsterismError("give the cameras once: --cameras FILE or --address ADDRESS.")
    if file is not None:
        return load_cameras(file)
    if given:
        return [CameraSpec(f"camera{number}", address) for number, address in enumerate(given, start=1)]
    found = found_cameras()
    if not found:
        raise AsterismError("no camera was found; plug one in, or name some with --address or --cameras.")
    return [CameraSpec(about.name, about.address) for about in found]


def opened_cameras(specs: Sequence[CameraSpec], file: Path | None) -> CameraGroup:
    """The cameras, open. Raises AsterismError, with the file that names them, where none could be opened."""
    from asterism.live.cameras import CameraGroup

    try:
        return CameraGroup(specs)
    except AsterismError as problem:
        raise AsterismError(f"{problem}" if file is None else f"{file}: {problem}") from problem


def opening_findings(group: CameraGroup) -> list[Finding]:
    """Cameras that could not be opened or started."""
    mend = "Look at its cable and its address; the others go on without it."
    return [
        Finding("live-camera-not-opened", Severity.ERROR, name, f"camera {name}: {problem}", mend) for name, problem in group.failed.items()
    ]
