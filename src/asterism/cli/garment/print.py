"""`asterism garment print`: sizes, an outline or a garment file in; the file for the print shop and the garment file out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Seed
from asterism.errors import AsterismError
from asterism.findings import exit_status

if TYPE_CHECKING:
    from asterism.garment import Pattern
    from asterism.garment.sheet import SheetRules

_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "": 1.0}


@dataclass(frozen=True)
class PrintOptions:
    """What `asterism garment print` is asked to do."""

    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The print: .svg, .pdf in pages, or .png.", show_default=False)
    ]
    rows: Annotated[
        int | None, typer.Option(metavar="N", min=3, max=9999, help="Rows of circles of one rectangle.", show_default=False)
    ] = None
    cols: Annotated[int | None, typer.Option(metavar="N", min=3, max=9999, help="Circles in a row of it.", show_default=False)] = None
    pieces: Annotated[
        list[str] | None,
        typer.Option(
            "--piece",
            metavar="NAME=SHAPE",
            help="A piece of the garment; may be given several times. SHAPE: 60x40 (rows x circles in a row), 50x30:18 (tapered from 30 "
            "to 18), or an image that is dark where the cloth is, a pixel for a circle.",
            show_default=False,
        ),
    ] = None
    garment: Annotated[
        Path | None, typer.Option("--garment", metavar="TOML", help="Print this pattern again, in another form.", show_default=False)
    ] = None
    target: Annotated[bool, typer.Option("--target", help="A calibration target: pitch 68 mm, diameter 38 mm where not given.")] = False
    pitch: Annotated[str | None, typer.Option(metavar="LENGTH", help="Between circles, such as 18mm. Else 18 mm.", show_default=False)] = (
        None
    )
    diameter: Annotated[str | None, typer.Option(metavar="LENGTH", help="Of circles. Else 5/9 of the pitch.", show_default=False)] = None
    colours: Annotated[int, typer.Option(metavar="N", min=2, max=8, help="How many colours.")] = 4
    least_difference: Annotated[
        int, typer.Option(metavar="CELLS", min=1, max=3, help="In how many cells any two blocks differ: with 2, a lone misread is noticed.")
    ] = 1
    unequal: Annotated[bool, typer.Option("--unequal-neighbours", help="Circles side by side differ in colour.")] = False
    page: Annotated[str, typer.Option(metavar="SIZE", help="Of a PDF's pages: a4, a3, ... a0, letter, 420x594mm, or sheet for one.")] = "a4"
    dpi: Annotated[float, typer.Option(metavar="N", min=20, help="Pixels per inch of a PNG.")] = 150.0
    seed: Seed = 0
    overwrite: Overwrite = False
    json: Json = None


@takes(PrintOptions)
def print(options: PrintOptions) -> None:
    """Make a pattern of coloured circles and write it for the print shop.

    Every circle but those at the edges is known by its own colour and its eight neighbours'. Beside the print stand the garment file
    (.toml), which all other commands take, and its lookup (.npz). Print at 100 %, measure the pitch on the cloth, and correct it in the
    garment file.
    """
    files = [options.output, options.output.with_suffix(".toml"), options.output.with_suffix(".npz")]
    if options.output.suffix.lower() not in (".svg", ".pdf", ".png"):
        raise AsterismError(f"{options.output} is no print; end its name in .svg, .pdf or .png.")
    # the garment file beside the print is the input: only the print is new
    if options.garment is not None and options.garment.with_suffix("") == options.output.with_suffix(""):
        files = files[:1]
    # all or nothing: a print without its garment file cannot be read later
    for path in (*files, options.json):
        _console.check_new(path, options.overwrite)
    from asterism.garment.sheet import ink_findings, print_pattern

    rules = _sheet_rules(options)
    pattern = _pattern(options)
    written = print_pattern(pattern, options.output, rules)
    # colours that ink cannot hold apart are told before the print is paid
    findings = ink_findings(pattern.hsv)
    if options.json != "-":
        rows, cols = pattern.shape
        width, height = (cols * pattern.pitch, rows * pattern.pitch)
        _console.facts(
            f"{options.output.name}: {(pattern.colours >= 0).sum():,} circles, {len(pattern.known):,} identities",
            [
                ("pieces", ", ".join(f"{piece.name} ({piece.rows} x {piece.columns})" for piece in pattern.pieces)),
                ("circles", f"{1000 * pattern.diameter:g} mm, pitch {1000 * pattern.pitch:g} mm, {pattern.q} colours"),
                ("sheet", f"{width:.2f} x {height:.2f} m"),
                ("files", ", ".join(path.name for path in written)),
            ],
        )
    for finding in findings:
        _console.report(finding)
    content = {"command": "garment print", "files": written, "identities": len(pattern.known), "findings": [f.to_dict() for f in findings]}
    _console.write_json(options.json, content)
    raise typer.Exit(exit_status(findings))


def _pattern(options: PrintOptions) -> Pattern:
    """The pattern that is asked for, from a file or made."""
    from asterism.garment import DesignRules, Pattern, design_pattern

    # three ways to say what the cloth is; each alone is complete
    rectangle = options.rows is not None or options.cols is not None
    if (options.garment is not None) + bool(options.pieces) + rectangle != 1 or (rectangle and None in (options.rows, options.cols)):
        raise AsterismError("give either --rows and --cols, or --piece, or --garment.")
    if options.garment is not None:
        return Pattern.load(options.garment)
    # a target hangs far away and is flat, so that its circles are larger
    pitch = length(options.pitch, "--pitch") if options.pitch else 0.068 if options.target else 0.018
    diameter = (
        length(options.diameter, "--diameter") if options.diameter else 0.038 if options.target and not options.pitch else pitch / 1.8
    )
    outline: Any = {"sheet": (options.rows, options.cols)} if rectangle else _pieces(options.pieces or ())
    rules = DesignRules(least_difference=options.least_difference, equal_neighbours=not options.unequal)
    with _console.progress("making the pattern") as progress:
        return design_pattern(outline, options.colours, seed=options.seed, rules=rules, size=(pitch, diameter), progress=progress)


def _pieces(given: Sequence[str]) -> dict[str, object]:
    """The shapes by name. Raises AsterismError where two pieces have one name."""
    shapes = [_piece(piece) for piece in given]
    names = [name for name, _ in shapes]
    # pieces are found by their names later
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise AsterismError(f"two pieces are called {twice[0]}; give each a name of its own.")
    return dict(shapes)


def _piece(given: str) -> tuple[str, object]:
    """NAME=SHAPE as a name and a size or a mask."""
    import numpy as np

    from asterism.garment import tapered

    name, _, shape = given.partition("=")
    plain = re.fullmatch(r"(\d{1,4})x(\d{1,4})(?::(\d{1,4}))?", shape)
    if name and plain:
        rows, top = int(plain[1]), int(plain[2])
        return name, (rows, top) if plain[3] is None else tapered(rows, top, int(plain[3]))
    if not name or not shape:
        raise AsterismError(f"--piece {given} has no shape; give for example --piece sleeve=50x30:18 or --piece front=front.png.")
    import cv2

    if not Path(shape).is_file():
        raise AsterismError(f"--piece {given}: there is no file {shape}; give rows x circles such as 60x40, or an image.")
    # read as bytes first: OpenCV opens no path with letters beyond ASCII on Windows
    image = cv2.imdecode(np.fromfile(shape, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if Path(shape).stat().st_size else None
    if image is None:
        raise AsterismError(f"{shape} is not an image that can be read; give PNG, dark where the cloth is, a pixel for a circle.")
    return name, image < 128


def _sheet_rules(options: PrintOptions) -> SheetRules:
    """The page and the resolution that are asked for."""
    from asterism.garment.sheet import PAGES, SheetRules

    name = options.page.lower()
    if name == "sheet":
        return SheetRules(page=None, dpi=options.dpi)
    if name in PAGES:
        return SheetRules(page=PAGES[name], dpi=options.dpi)
    size = re.fullmatch(r"([\d.]+)x([\d.]+)\s*(mm|cm|m)", name)
    if size is None:
        raise AsterismError(f"--page {options.page} is no page; give one of {', '.join(PAGES)}, sheet, or a size such as 420x594mm.")
    width, height = (length(f"{side}{size[3]}", "--page") for side in size.groups()[:2])
    return SheetRules(page=(width, height), dpi=options.dpi)


def length(given: str, option: str) -> float:
    """Metres of a length such as 18mm, 1.8 cm or 0.018. Raises AsterismError for anything else."""
    found = re.fullmatch(r"\s*(\d*\.?\d+)\s*(mm|cm|m|)\s*", given.lower())
    # a length without a unit is in metres, as everywhere
    if found is None or float(found[1]) <= 0:
        raise AsterismError(f"{option} {given} is not a length; give for example {option} 18mm.")
    return float(found[1]) * _UNITS[found[2]]
