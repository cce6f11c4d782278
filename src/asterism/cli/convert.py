"""`asterism convert`: a file in one format in, the same in another format out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Markers, Overwrite, Vertical, marker_names, vertical_axis


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
    What the other format cannot carry is named on standard error.
    """
    from asterism import formats

    _console.check_new(target, overwrite)
    _console.check_new(json, overwrite)
    axis, wanted = vertical_axis(vertical), marker_names(markers)
    lost = formats.convert(source, target, axis) if wanted is None else formats.write(target, formats.read(source, wanted, axis))
    for what in lost:
        _console.complain(f"{target} leaves out {what}.")
    if json != "-":
        _console.say(f"{source} -> {target}")
    _console.write_json(json, {"command": "convert", "file": source, "output": target, "not_carried": lost})
