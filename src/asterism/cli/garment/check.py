"""`asterism garment check`: photos of a printed garment in; whether lamps, print and exposure will do, out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json
from asterism.errors import AsterismError
from asterism.findings import exit_status

if TYPE_CHECKING:
    from asterism.garment.check import PhotoCheck


@dataclass(frozen=True)
class CheckOptions:
    """What `asterism garment check` is asked to do."""

    photos: Annotated[list[Path], typer.Argument(metavar="PHOTOS", help="Colour images: JPEG, PNG, TIFF.", show_default=False)]
    garment: Annotated[
        Path, typer.Option("--garment", "-g", metavar="TOML", help="The garment that `asterism garment print` wrote.", show_default=False)
    ]
    json: Json = None


@takes(CheckOptions)
def check(options: CheckOptions) -> None:
    """Show from photos alone how surely a garment is read.

    Every circle is read with its eight neighbours, and a block with a misread colour is in the pattern by chance only. So the share of
    blocks that are in it, compared with chance, bounds the rate of misreads, without any truth.
    """
    _console.check_new(options.json, False)
    from asterism.garment import Pattern

    pattern = Pattern.load(options.garment)
    checked: list[tuple[Path, PhotoCheck]] = []
    failed: list[str] = []
    for path in options.photos:
        try:
            checked.append((path, _check(path, pattern)))
        # one photo that cannot be read costs this photo only
        except AsterismError as problem:
            _console.error(str(problem))
            failed.append(str(path))
    if options.json != "-" and checked:
        _console.table(
            "What the photos say about themselves",
            ["photo", "circles", "identified", "px", "blocks", "in the pattern", "by chance", "misread", "at most"],
            [[path.name, *_cells(result)] for path, result in checked],
        )
    findings = [finding for _, result in checked for finding in result.findings]
    for path, result in checked:
        for finding in result.findings:
            _console.report(replace(finding, where=path.name))
    content: dict[str, Any] = {"command": "garment check", "garment": options.garment, "failed": failed}
    _console.write_json(options.json, {**content, "photos": [{"file": path, **result.to_dict()} for path, result in checked]})
    raise typer.Exit(2 if not checked else 1 if failed else exit_status(findings))


def _check(path: Path, pattern: Any) -> PhotoCheck:
    from asterism.errors import guarded_reading
    from asterism.garment.check import check_photo

    with guarded_reading(path, "take the photo again"):
        from asterism.detection.image_files import read_eight_bits, unread_kind

        image = read_eight_bits(path, colour=True)
        if image is None:
            raise AsterismError(f"{path} {unread_kind(path) or 'is not an image that can be read; give JPEG, PNG or TIFF'}.")
        return check_photo(image, pattern)


def _cells(result: PhotoCheck) -> list[str]:
    share = "-" if result.windows == 0 else _console.percent(result.share)
    return [
        str(result.circles),
        str(result.identified),
        "-" if result.identified == 0 else f"{result.diameter:.1f}",
        str(result.windows),
        share,
        _console.percent(result.chance),
        *("unknown" if math.isnan(share) else _console.percent(share) for share in (result.misread, result.misread_most)),
    ]
