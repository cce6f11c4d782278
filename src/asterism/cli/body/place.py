"""`asterism body place`: labelled trials in, a marker set that says where its markers sit out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, marker_names

if TYPE_CHECKING:
    from asterism.recording import MarkerSet, Recording


@dataclass(frozen=True)
class BodyPlaceOptions:
    """What `asterism body place` is asked to do."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Labelled trials, standing or moving, of one or more people.", show_default=False),
    ]
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The marker set with its places, TOML.", show_default=False)
    ]
    markers: Annotated[
        str | None,
        typer.Option(metavar="SET", help="The marker set, its TOML file or names with commas; else all named markers.", show_default=False),
    ] = None
    landmark: Annotated[
        list[str],
        typer.Option(metavar="NAME=LANDMARK", help='A marker that sits on a landmark: "MYKNE=left lateral epicondyle of femur".'),
    ] = ()  # type: ignore[assignment]
    vertical: Annotated[str | None, typer.Option(metavar="AXIS", help="Up, if the files do not say: z, -y.", show_default=False)] = None
    overwrite: Overwrite = False
    json: Json = None


@takes(BodyPlaceOptions)
def place(options: BodyPlaceOptions) -> None:
    """Learn where the markers of a set sit.

    Virtual people wear a set whose file says where its markers sit. This writes such a file: a skeleton is laid on the trials by the
    markers whose places are known, by their names or as landmarks, and all others sit where they are seen on it. One standing trial is
    enough.
    """
    from asterism import formats
    from asterism.errors import AsterismError
    from asterism.findings import exit_status
    from asterism.skeleton import learn_places

    output = options.output
    # `--markers` knows a file from a shipped set by its suffix
    if output.suffix.casefold() != ".toml":
        raise AsterismError(f"{output}: a marker set is TOML; name it NAME.toml.")
    _console.check_outputs([output, options.json], options.files, options.overwrite)
    # all points of the files: names are looked for in the set, however it spells them
    recordings = [formats.read(path, markers=None, vertical=options.vertical) for path in options.files]
    learned = learn_places(_wanted(options, recordings), recordings)
    for finding in learned.findings:
        _console.report(finding)
    marker_set = learned.marker_set
    _write(output, marker_set, options.files)
    if options.json != "-":
        people = f"{learned.people} {'person' if learned.people == 1 else 'people'}"
        _console.result(
            f"{output}: places of {len(marker_set.places)} of {len(marker_set)} markers from {people}, {len(learned.known)} of them known "
            f"by landmark or name; the skeleton fits to {1000 * learned.miss:.1f} mm."
        )
    _console.write_json(
        options.json,
        {
            "command": "body place",
            "files": options.files,
            "output": output,
            "known": list(learned.known),
            "people": learned.people,
            "miss_m": learned.miss,
            "places": {name: {"segment": at.segment, "at": list(at.at), "spread": at.spread} for name, at in marker_set.places.items()},
            "findings": [finding.to_dict() for finding in learned.findings],
        },
    )
    raise typer.Exit(exit_status(learned.findings))


def _wanted(options: BodyPlaceOptions, recordings: Sequence[Recording]) -> MarkerSet:
    """The set whose places are wanted, with the landmarks that were given."""
    from asterism.errors import AsterismError
    from asterism.recording import MarkerSet
    from asterism.skeleton import marker_set_of, with_landmarks

    if options.markers is None:
        marker_set = marker_set_of(recordings, title=options.output.stem)
    else:
        names = marker_names(options.markers) or ()
        marker_set = MarkerSet.load(names)
        # names alone have no title
        marker_set = marker_set if isinstance(names, str) else replace(marker_set, title=options.output.stem)
    given: dict[str, str] = {}
    for text in options.landmark:
        name, equals, landmark = text.partition("=")
        if not equals:
            raise AsterismError(f'--landmark {text!r} has no "="; write NAME=LANDMARK, such as "MYKNE=left lateral epicondyle of femur".')
        given[name.strip()] = landmark.strip()
    return with_landmarks(marker_set, given) if given else marker_set


def _write(output: Path, marker_set: MarkerSet, files: Sequence[Path]) -> None:
    from asterism.files.atomic import write_atomically

    shown = ", ".join(path.name for path in files[:3]) + (f" and {len(files) - 3} more" if len(files) > 3 else "")
    # A name of a file may hold a line's end, and a comment ends there.
    comment = "# Places were learned by `asterism body place` from " + "".join(c if c.isprintable() else "?" for c in shown) + "."
    write_atomically(output, f"{comment}\n{marker_set.to_toml()}".encode())
