"""`asterism body fit`: labelled trials in, a body model out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, marker_names


@dataclass(frozen=True)
class BodyFitOptions:
    """What `asterism body fit` is asked to do."""

    standing: Annotated[
        list[Path], typer.Argument(metavar="STATIC...", help="Labelled standing trials, one of each person.", show_default=False)
    ]
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The body model, TOML.", show_default=False)]
    moving: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE", help="A labelled trial in which the person moves: joints' usual angles are learned.", show_default=False
        ),
    ] = ()  # type: ignore[assignment]
    markers: Annotated[
        str | None, typer.Option(metavar="SET", help="A marker set or names with commas; else all labelled markers.", show_default=False)
    ] = None
    height: Annotated[
        float | None, typer.Option(metavar="M", help="The person's height. Else estimated from the pelvis'.", show_default=False)
    ] = None
    vertical: Annotated[str | None, typer.Option(metavar="AXIS", help="Up, if the files do not say: z, -y.", show_default=False)] = None
    overwrite: Overwrite = False
    json: Json = None


@takes(BodyFitOptions)
def fit(options: BodyFitOptions) -> None:
    """Make a body model of a standing person.

    The model has the segments of the body with their joints, each marker's place on its segment, and capsules that hide what is behind
    them. Joints are placed by the markers' usual names (Helen Hayes, Plug-in Gait, Oxford foot). `asterism label-views` labels with it.
    """
    from asterism import formats
    from asterism.errors import AsterismError
    from asterism.recording import MarkerSet
    from asterism.skeleton import fit_body, save_body

    output = options.output
    # `label-views` knows a body model from a shipped one by its suffix
    if output.suffix.casefold() != ".toml":
        raise AsterismError(f"{output}: a body model is TOML; name it NAME.toml.")
    _console.check_outputs([output, options.json], [*options.standing, *options.moving], options.overwrite)
    wanted = None
    if options.markers is not None:
        wanted = MarkerSet.load(marker_names(options.markers) or ())
    # all markers of the files: the fit chooses by their usual names
    standing = [formats.read(path, markers=None, vertical=options.vertical) for path in options.standing]
    moving = [formats.read(path, markers=None, vertical=options.vertical) for path in options.moving]
    body = fit_body(standing, moving, markers=wanted, title=output.stem, height=options.height)
    save_body(body, output)
    numbers = {
        "markers": list(body.labels),
        "bones": [bone.name for bone in body.bones],
        "hinges": len(body.hinges),
        "capsules": len(body.capsules),
        "height_m": body.height,
    }
    if options.json != "-":
        _console.result(
            f"{output}: {len(body.markers)} markers on {len(body.bones)} bones, {len(body.capsules)} capsules, {body.height:.2f} m tall"
        )
    _console.write_json(options.json, {"command": "body fit", "standing": options.standing, "output": output, **numbers})
