"""`asterism label-views`: blobs of few calibrated cameras and a body model in, labelled trajectories out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Vertical, vertical_axis
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.views import ViewsLabelling


@dataclass(frozen=True)
class LabelViewsOptions:
    """What `asterism label-views` is asked to do."""

    blobs: Annotated[
        Path, typer.Argument(metavar="BLOBS", help="2D CSV (frame, camera, x, y[, size]), or QTM's 2D series as JSON.", show_default=False)
    ]
    rig: Annotated[Path, typer.Option("--rig", metavar="FILE", help="The calibrated rig.", show_default=False)]
    body: Annotated[str, typer.Option("--body", metavar="BODY", help="gait15, body26, plug-in-gait, or a TOML file.", show_default=False)]
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The labelled trajectories: .c3d, .trc, .csv, ...", show_default=False)
    ]
    height: Annotated[float | None, typer.Option(metavar="M", help="The person's height, if known.", show_default=False)] = None
    least_confidence: Annotated[float, typer.Option(metavar="P", min=0.0, max=1.0, help="Labels less probable are not given.")] = 0.9
    min_cameras: Annotated[int, typer.Option(metavar="N", min=1, help="Cameras that must show a marker that is written.")] = 1
    most_deviation: Annotated[
        float | None, typer.Option(metavar="MM", help="Leave out places less exact than this.", show_default=False)
    ] = None
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL", help="A trained model that names the 3D points, too; disagreement lowers confidence.", show_default=False
        ),
    ] = None
    quick: Annotated[bool, typer.Option("--quick", help="One direction of time, without this person's own body: faster, less right.")] = (
        False
    )
    labels: Annotated[
        Path | None, typer.Option("--labels", metavar="CSV", help="Write the label of each blob, with its confidence.", show_default=False)
    ] = None
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write an HTML page with a picture of each camera.", show_default=False)
    ] = None
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Frames per second. Else as the file says.", show_default=False)] = None
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(LabelViewsOptions)
def label_views(options: LabelViewsOptions) -> None:
    """Label the blobs in the images of two to four cameras.

    A model of the body says where each marker can be.

    With two to four cameras many markers are seen by one camera only and never become 3D points. The model predicts which marker each
    camera can see. Each blob gets a marker or none; markers that one camera shows get a place from the body, with a standard deviation.
    What was labelled is kept in OUTPUT.unfinished until the end: the same command goes on from there after an interruption.
    """
    from asterism import formats, views
    from asterism.cameras.files import read_rig
    from asterism.cli._recordings import assumptions, not_carried
    from asterism.cli._unfinished import continued
    from asterism.findings import exit_status
    from asterism.formats import check_suffix
    from asterism.formats.blobs_2d import read_2d
    from asterism.labelling import MarkerModel
    from asterism.skeleton import load_body
    from asterism.views.rules import QUICK, RULES

    output = options.output
    check_suffix(output)
    _console.check_outputs([output, options.labels, options.report, options.json], [options.blobs, options.rig], options.overwrite)
    body = load_body(options.body)
    # the body stands on the ground: without a vertical it cannot be placed
    rig = _upright(read_rig(options.rig), options)
    # in the rig's order, so that camera numbers mean the same in both
    blobs = read_2d(options.blobs, cameras=rig.names, rate=options.rate)
    if not len(blobs):
        raise AsterismError(f"{options.blobs} holds no image; write a row for each blob, with frame, camera, x and y.")
    model = None if options.model is None else MarkerModel.load(options.model)
    # what took long is in the output before anything else is made of it
    with continued(output, [options.blobs, options.rig], options.height, options.quick, options.rate, options.vertical, body) as journal:
        with _console.progress("labelling") as progress:
            result = views.label_views(
                blobs, rig, body, height=options.height, rules=QUICK if options.quick else RULES,
                least_confidence=options.least_confidence, journal=journal, progress=progress,
            )  # fmt: skip
        # a second opinion, by the distances between markers alone
        if model is not None:
            from asterism.views.agreement import check_by_model

            with _console.progress("naming the 3D points") as progress:
                result = check_by_model(result, model, least_confidence=options.least_confidence, progress=progress)
        # places that one camera tells are written unless a limit is given; their deviation says how far to trust them
        limit = float("inf") if options.most_deviation is None else 1e-3 * options.most_deviation
        lost = formats.write(output, result.recording(least_views=options.min_cameras, most_deviation=limit))
    if options.labels is not None:
        _write_labels(options.labels, result)
    if options.report is not None:
        from asterism.report.views import views_report

        views_report(options.report, result, title=f"Labels in the images: {options.blobs.name}")
    numbers = _numbers(result)
    # guesses about the rig come first: all that follows rests on them
    findings = (*assumptions(options.rig, rig), *result.findings, *not_carried(output, lost, "Write C3D to keep most."))
    for finding in findings:
        _console.report(finding)
    if options.json != "-":
        _print(output, numbers)
    content = {**numbers, "findings": [finding.to_dict() for finding in findings], "not_carried": lost}
    _console.write_json(
        options.json,
        {"command": "label-views", "blobs": options.blobs, "rig": options.rig, "body": options.body, "output": output, **content},
    )
    raise typer.Exit(exit_status(findings))


def _upright(rig: Rig, options: LabelViewsOptions) -> Rig:
    """The rig with the vertical that is asked for. Raises AsterismError where nobody says what is up."""
    from dataclasses import replace

    from asterism.recording.arrays import as_vertical

    # what a person says counts more than the file
    given = vertical_axis(options.vertical)
    if given is not None:
        return replace(rig, vertical=as_vertical(given))
    if rig.vertical is None:
        raise AsterismError(f"{options.rig} does not say which way is up; give --vertical z, as QTM and Nexus have it, or another axis.")
    return rig


def _numbers(result: ViewsLabelling) -> dict[str, Any]:
    """What was labelled, as plain values."""
    import numpy as np

    given = result.labels >= 0
    # one camera tells no distance by itself: its places come from the body, and are counted apart
    one, more = result.views == 1, result.views >= 2
    deviations = result.deviations

    def median_mm(which: Any) -> float | None:
        return float(1e3 * np.median(deviations[which])) if which.any() else None

    return {
        "frames": len(result.views),
        "frames_with_the_body": int(np.isfinite(result.poses[:, 0]).sum()),
        "restarts": len(result.restarts),
        "blobs": len(result.labels),
        "labelled_blobs": int(given.sum()),
        "mean_confidence": float(result.confidence[given].mean()) if given.any() else None,
        "positions_from_several_cameras": int(more.sum()),
        "positions_from_one_camera": int(one.sum()),
        "median_deviation_several_mm": median_mm(more),
        "median_deviation_one_mm": median_mm(one),
        "markers": {name: int(n) for name, n in zip(result.body.labels, (result.views > 0).sum(axis=0), strict=True)},
    }


def _print(output: Path, numbers: dict[str, Any]) -> None:
    """The table on standard output."""

    def exact(key: str) -> str:
        return "" if numbers[key] is None else f", {numbers[key]:.0f} mm (median standard deviation)"

    _console.result(f"{output}: {numbers['frames']} frames, the body found in {numbers['frames_with_the_body']}")
    _console.result(f"blobs labelled: {numbers['labelled_blobs']} of {numbers['blobs']}")
    _console.result(f"places from two or more cameras: {numbers['positions_from_several_cameras']}{exact('median_deviation_several_mm')}")
    _console.result(f"places from one camera: {numbers['positions_from_one_camera']}{exact('median_deviation_one_mm')}")


def _write_labels(path: Path, result: ViewsLabelling) -> None:
    """A row per blob: frame, camera, x, y, marker, confidence."""
    from asterism.files.atomic import write_atomically

    blobs = result.blobs
    rows = ["frame,camera,x,y,marker,confidence"]
    cells = zip(
        (blobs.frame_of + blobs.first_frame).tolist(),
        blobs.camera_of.tolist(),
        blobs.xy.tolist(),
        result.labels.tolist(),
        result.confidence.tolist(),
        strict=True,
    )
    for frame, camera, (x, y), marker, sure in cells:
        name = result.body.labels[marker] if marker >= 0 else ""
        rows.append(f"{frame},{blobs.cameras[camera]},{x:.6g},{y:.6g},{name},{sure:.4f}")
    write_atomically(path, ("\n".join(rows) + "\n").encode())
