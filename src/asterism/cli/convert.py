"""`asterism convert`: a file in one format in, the same in another format out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Markers, Overwrite, Vertical, marker_names, vertical_axis
from asterism.errors import AsterismError


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="The file to read.", show_default=False)],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write; its suffix says the format.", show_default=False)],
    markers: Markers = None,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Write a file in another format.

    The suffix of OUT says which: C3D, TRC, CSV, TSV, MAT or NPZ; tables of numbers are MOT, STO or CSV.
    Rigs become .toml (Asterism's own), *anipose.toml, camera_array.toml, .yml, .xml, .xcp, .qca.txt or .ori.
    What the other format cannot carry is named on standard error.
    """
    from asterism import formats
    from asterism.cli._recordings import is_rig

    _console.check_new(target, overwrite)
    _console.check_new(json, overwrite)
    axis, wanted = vertical_axis(vertical), marker_names(markers)
    if is_rig(source):
        lost = _rig_converted(source, target, axis, wanted)
    else:
        lost = formats.convert(source, target, axis) if wanted is None else formats.write(target, formats.read(source, wanted, axis))
    for what in lost:
        _console.error(f"{target} leaves out {what}.")
    if json != "-":
        _console.result(f"{source} -> {target}")
    _console.write_json(json, {"command": "convert", "file": source, "output": target, "not_carried": lost})


def _rig_converted(source: Path, target: Path, vertical: Any, markers: Any) -> list[str]:
    from asterism.cameras.files import guesses, read_rig, write_rig
    from asterism.recording import as_vertical

    if markers is not None:
        raise AsterismError(f"{source} is a rig and has no markers; leave out --markers.")
    rig = read_rig(source)
    for phrase in guesses(rig):
        _console.error(f"{source} does not say {phrase}.")
    return write_rig(rig if vertical is None else replace(rig, vertical=as_vertical(vertical)), target)
