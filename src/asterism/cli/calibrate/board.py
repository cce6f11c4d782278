"""`asterism calibrate board`: images or videos of a board in; a rig, and whether to trust it, out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Overwrite, Report
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.calibration.boards import Board, BoardCalibration

_SIZE = "columns x rows, such as 9x6"


def board(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATHS",
            help="A video or a folder of images for each camera, or a folder of those; an OpenCV image list.",
            show_default=False,
        ),
    ],
    board: Annotated[
        Path | None, typer.Option("--board", metavar="TOML", help="The board: a file such as caliscope's charuco.toml.", show_default=False)
    ] = None,
    chessboard: Annotated[
        str | None, typer.Option(metavar="CxR", help=f"A chessboard: inner corners, {_SIZE}.", show_default=False)
    ] = None,
    charuco: Annotated[
        str | None, typer.Option(metavar="CxR", help="A ChArUco board: squares, columns x rows.", show_default=False)
    ] = None,
    circles: Annotated[str | None, typer.Option(metavar="CxR", help="A grid of circles, columns x rows.", show_default=False)] = None,
    asymmetric: Annotated[bool, typer.Option("--asymmetric", help="Every second row of circles is shifted by half.")] = False,
    square: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a square, or from circle to circle (asymmetric: half of it in a row), in metres."),
    ] = None,
    marker: Annotated[float | None, typer.Option(metavar="M", help="Side of ChArUco's markers, in metres.")] = None,
    dictionary: Annotated[str, typer.Option(metavar="NAME", help="ChArUco's markers, as OpenCV calls them.")] = "DICT_4X4_50",
    inverted: Annotated[bool, typer.Option("--inverted", help="The board is printed white on black.")] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="The rig to write.", show_default=False)] = None,
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="Cameras whose lenses are known; only poses are calibrated.", show_default=False),
    ] = None,
    origin: Annotated[
        int | None, typer.Option(metavar="FRAME", help="The frame in which the board lies on the floor, print up: the world's origin.")
    ] = None,
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Look at each N-th image only.")] = 1,
    anyway: Annotated[bool, typer.Option("--force", help="Write the rig even where it should not be used.")] = False,
    overwrite: Overwrite = False,
    report: Report = None,
    json: Json = None,
) -> None:
    """Calibrate cameras by a flat board, from images or videos.

    Show the board to each camera tilted, near and far, up to the corners of the image, and to neighbours together. Frames of the same
    number belong together (or those of a timestamps.csv beside the videos). Each camera is calibrated, then all that share views together,
    also where no pair sees all; a camera that saw nothing or shares no view is named. One camera gives its lens.
    """
    for path in (output, report, json):
        _console.check_new(path, overwrite)
    from asterism.calibration.boards import calibrate_board, find_board, footage_of
    from asterism.cameras.files import read_rig, write_rig

    chosen = _board(board, chessboard, charuco, circles, asymmetric, square, marker, dictionary, inverted)
    known = None if rig is None else read_rig(rig)
    with _console.progress("looking for the board") as progress:
        views = find_board(footage_of(paths), chosen, every=every, progress=progress)
    with _console.progress("calibrating") as progress:
        made = calibrate_board(views, known=known, origin=origin, progress=progress)
    written = output is not None and (made.usable or anyway)
    lost = write_rig(made.rig, output) if output is not None and written else []
    if report is not None:
        from asterism.report import board_report

        board_report(report, made, settings={"files": [str(path) for path in paths], "board": str(chosen), "known lenses": rig})
    _console.write_json(json, {"command": "calibrate board", "files": paths, "rig": output if written else None, **made.summary()})
    if json != "-":
        _print(made)
    found = [*views.notes, *made.apart, *made.doubts, *(f"{output} leaves out {what}." for what in lost)]
    for sentence in found:
        _console.error(sentence)
    if not made.usable:
        _console.error("do not use this calibration" + ("." if written or output is None else "; it was not written (--force writes it)."))
    raise typer.Exit(2 if not made.usable and not written else 1 if found else 0)


def _board(
    board: Path | None,
    chessboard: str | None,
    charuco: str | None,
    circles: str | None,
    asymmetric: bool,
    square: float | None,
    marker: float | None,
    dictionary: str,
    inverted: bool,
) -> Board:
    from asterism.calibration.boards import Board, size_of

    given = [option for option in (board, chessboard, charuco, circles) if option is not None]
    if len(given) != 1:
        raise AsterismError("say which board it is: one of --board FILE, --chessboard 9x6, --charuco 5x7, --circles 4x11.")
    if board is not None:
        return Board.from_toml(board)
    if square is None:
        raise AsterismError("give the side of a square in metres, such as --square 0.025: it sets the scale of the rig.")
    columns, rows = size_of(str(given[0]))
    if charuco is not None:
        if marker is None:
            raise AsterismError("give the side of the markers in metres, such as --marker 0.018.")
        return Board("charuco", columns, rows, square, dictionary, marker, inverted)
    if chessboard is not None:
        return Board("chessboard", columns, rows, square, inverted=inverted)
    return Board("asymmetric circles" if asymmetric else "circles", columns, rows, square, inverted=inverted)


def _print(made: BoardCalibration) -> None:
    told = made.summary()
    rows = [
        [
            camera["name"],
            f"{camera['views']} of {camera['images']}",
            f"{camera['rms_alone_px']:.3f}",
            f"{camera['rms_px']:.3f}",
            f"{camera['focal_px'][0]:.1f}",
            f"{camera['focal_std_px']:.1f}",
            "–" if camera["position_m"] is None else ", ".join(f"{value:.3f}" for value in camera["position_m"]),
        ]
        for camera in told["cameras"]
    ]
    head = ("camera", "views", "error alone, px", "together, px", "focal length, px", "±", "position, m")
    _console.table(f"{told['board']}: {told['frames_used']} of {told['frames']} frames, {told['reprojection_rms_px']:.3f} px", head, rows)
