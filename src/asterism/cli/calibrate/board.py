"""`asterism calibrate board`: images or videos of a board in; a rig, and whether to trust it, out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report
from asterism.cli.calibrate._calibration import Force, RigToWrite, hand_over
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.calibration.boards import Board, BoardCalibration

_SIZE = "columns x rows, such as 9x6"


@dataclass(frozen=True)
class BoardOptions:
    """What `asterism calibrate board` is asked to do."""

    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATHS",
            help="A video or a folder of images for each camera, or a folder of those; an OpenCV image list.",
            show_default=False,
        ),
    ]
    board: Annotated[
        Path | None, typer.Option("--board", metavar="TOML", help="The board: a file such as caliscope's charuco.toml.", show_default=False)
    ] = None
    chessboard: Annotated[str | None, typer.Option(metavar="CxR", help=f"A chessboard: inner corners, {_SIZE}.", show_default=False)] = None
    charuco: Annotated[str | None, typer.Option(metavar="CxR", help="A ChArUco board: squares, columns x rows.", show_default=False)] = None
    circles: Annotated[str | None, typer.Option(metavar="CxR", help="A grid of circles, columns x rows.", show_default=False)] = None
    asymmetric: Annotated[bool, typer.Option("--asymmetric", help="Every second row of circles is shifted by half.")] = False
    square: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a square, or from circle to circle (asymmetric: half of it in a row), in metres."),
    ] = None
    marker: Annotated[float | None, typer.Option(metavar="M", help="Side of ChArUco's markers, in metres.")] = None
    dictionary: Annotated[str, typer.Option(metavar="NAME", help="ChArUco's markers, as OpenCV calls them.")] = "DICT_4X4_50"
    inverted: Annotated[bool, typer.Option("--inverted", help="The board is printed white on black.")] = False
    output: RigToWrite = None
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="Cameras whose lenses are known; only poses are calibrated.", show_default=False),
    ] = None
    origin: Annotated[
        int | None, typer.Option(metavar="FRAME", help="The frame in which the board lies on the floor, print up: the world's origin.")
    ] = None
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Look at each N-th image only.")] = 1
    force: Force = False
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(BoardOptions)
def board(options: BoardOptions) -> None:
    """Calibrate cameras by a flat board, from images or videos.

    Show the board to each camera tilted, near and far, up to the corners of the image, and to neighbours together. Frames of the same
    number belong together (or those of a timestamps.csv beside the videos). Each camera is calibrated, then all that share views together,
    also where no pair sees all; a camera that saw nothing or shares no view is named. One camera gives its lens.
    """
    for path in (options.output, options.report, options.json):
        _console.check_new(path, options.overwrite)
    chosen = _board(options)
    made = _calibrated(options, chosen)
    settings = {"files": [str(path) for path in options.paths], "board": str(chosen), "known lenses": options.rig}
    raise typer.Exit(hand_over(made, "calibrate board", {"files": options.paths}, options, settings, alone=True))


def _calibrated(options: BoardOptions, chosen: Board) -> BoardCalibration:
    from asterism.calibration.boards import calibrate_board, find_board, footage_of
    from asterism.cameras.files import read_rig

    # known lenses stay as they are: the board then tells poses only
    known = None if options.rig is None else read_rig(options.rig)
    with _console.progress("looking for the board") as progress:
        views = find_board(footage_of(options.paths), chosen, every=options.every, progress=progress)
    with _console.progress("calibrating") as progress:
        return calibrate_board(views, known=known, origin=options.origin, progress=progress)


def _board(options: BoardOptions) -> Board:
    """The board that the options describe. Raises AsterismError where they describe none or several."""
    from asterism.calibration.boards import Board, size_of

    # the kinds exclude each other: a wrong one would be found nowhere, after minutes
    given = [option for option in (options.board, options.chessboard, options.charuco, options.circles) if option is not None]
    if len(given) != 1:
        raise AsterismError("say which board it is: one of --board FILE, --chessboard 9x6, --charuco 5x7, --circles 4x11.")
    if options.board is not None:
        return Board.from_toml(options.board)
    # without a length the rig has no scale
    if options.square is None:
        raise AsterismError("give the side of a square in metres, such as --square 0.025: it sets the scale of the rig.")
    columns, rows = size_of(str(given[0]))
    if options.charuco is not None:
        if options.marker is None:
            raise AsterismError("give the side of the markers in metres, such as --marker 0.018.")
        return Board("charuco", columns, rows, options.square, options.dictionary, options.marker, options.inverted)
    if options.chessboard is not None:
        return Board("chessboard", columns, rows, options.square, inverted=options.inverted)
    return Board("asymmetric circles" if options.asymmetric else "circles", columns, rows, options.square, inverted=options.inverted)
