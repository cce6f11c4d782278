"""A calibration from boards in; out comes a page that says whether to use it, what each camera saw, and how well the board fits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, findings_table, percent, write_page
from asterism.report.space import rig_in_space

if TYPE_CHECKING:
    from asterism.calibration.boards import BoardCalibration

_ACROSS = 3
"""Images side by side."""
_MOST_POINTS = 3000
_TINTED_PX = 1.0


def board_report(path: str | Path, calibration: BoardCalibration, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on a calibration from boards; `settings` (files, board, ...) are named at its foot.

    Raises AsterismError where the file cannot be written.
    """
    several = len(calibration.rig) > 1
    summary = calibration.summary()
    sections = [
        Section("What to know before using it", table=_findings(calibration)),
        # One camera has no rig to show.
        *([_rig(calibration)] if several else []),
        Section("Each camera", table=_cameras(summary), note="± is the standard deviation that the calibration leaves."),
        Section(
            "What each image saw",
            "The board's points in each image, shaded by how far they lie from where the board is. "
            "Where no point is, above all in corners, the lens is a guess: show the board there.",
            figure=_images(calibration),
        ),
    ]
    if several:
        text = "Frames in which two cameras saw the board together: what holds the rig together."
        sections.append(Section("Shared views", text, table=_shared(calibration)))
    write_page(path, Page("Calibration from a board", _lead(calibration), settings or {}, _merits(calibration), sections))


def _rig(calibration: BoardCalibration) -> Section:
    shown = calibration.adjustment.translations + calibration.adjustment.rotations @ calibration.views.board.points.mean(axis=0)
    # The adjustment counts from its own origin, the rig from where it stands: the first camera is in both.
    first = calibration.adjustment.cameras[0]
    in_camera = shown @ first.rotation.T + first.translation
    moved = (in_camera - calibration.rig.cameras[0].translation) @ calibration.rig.cameras[0].rotation
    text = "Cameras open where they look; dots are where the board was. Drag to turn."
    return Section("The rig", text, figure=rig_in_space(calibration.rig, points=moved))


def _lead(calibration: BoardCalibration) -> str:
    if not calibration.usable:
        return "Do not use this calibration: see below."
    return "This calibration can be used with care: see below." if calibration.findings else "This calibration can be used."


def _merits(calibration: BoardCalibration) -> list[tuple[str, str, str]]:
    # The mean hides one bad camera among good ones.
    grade = "bad" if not calibration.usable else "warn" if calibration.findings else "good"
    worst = max((camera.error for camera in calibration.rig), default=0.0)
    return [
        (f"{calibration.rms:.3f} px", "reprojection error, all together", grade),
        (f"{worst:.3f} px", "of the worst camera", "" if worst < _TINTED_PX else "warn"),
        (f"{len(calibration.rig)} of {len(calibration.views.cameras)}", "cameras calibrated", "" if not calibration.excluded else "warn"),
        (f"{len(calibration.used):,}", f"of {len(calibration.views.frames):,} frames used", ""),
    ]


def _findings(calibration: BoardCalibration) -> Table:
    more: list[list[str | Cell]] = []
    if calibration.rejected_views:
        some = ", ".join(f"{name} in frame {frame}" for frame, name in calibration.rejected_views[:12])
        more.append([Cell("left out", 0.3), f"{len(calibration.rejected_views)} views that do not fit the others: {some}"])
    return findings_table(calibration.findings, more)


def _cameras(summary: Mapping[str, Any]) -> Table:
    rows: list[list[str | Cell]] = [
        [
            camera["name"],
            f"{camera['views']} of {camera['images']}",
            percent(camera["image_covered"], 0),
            f"{camera['rms_alone_px']:.3f}",
            Cell(f"{camera['rms_px']:.3f}", min(max(camera["rms_px"] - 0.3, 0.0) / _TINTED_PX, 1.0)),
            f"{camera['focal_px'][0]:.1f} ± {camera['focal_std_px']:.1f}",
            ", ".join(f"{value:.1f}" for value in camera["centre_px"]),
            ", ".join(f"{value:.3f}" for value in camera["distortion"][:5]),
            NOTHING if camera["position_m"] is None else ", ".join(f"{value:.3f}" for value in camera["position_m"]),
        ]
        for camera in summary["cameras"]
    ]
    head = ["camera", "views", "image covered", "error alone, px", "together, px", "focal length, px", "centre, px"]
    return Table([*head, "k1, k2, p1, p2, k3", "stands at, m"], rows)


def _images(calibration: BoardCalibration) -> figures.Figure:
    """One small picture per camera: its points, shaded by residual."""
    down = -(-len(calibration.rig) // _ACROSS)
    size = np.linalg.norm(calibration.adjustment.residuals, axis=1)
    # A few outliers would leave all other points in one colour.
    high = float(np.nanpercentile(size, 98)) if len(size) else 1.0
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": []}
    for c, camera in enumerate(calibration.rig):
        row, column = divmod(c, _ACROSS)
        width, height = camera.size or (1, 1)
        left, top = column / _ACROSS, 1.0 - row / down
        frame = {"showgrid": False, "showticklabels": False, "constrain": "domain", "mirror": True, "showline": True, "zeroline": False}
        across = {"domain": [left, left + 0.92 / _ACROSS], "range": [0, width], **frame}
        up = {"domain": [top - 0.84 / down, top], "range": [height, 0], "scaleanchor": "x" + ("" if c == 0 else str(c + 1)), **frame}
        axes, sides = figures.cell_axes(c, across, up)
        layout |= sides
        at = {"xref": axes["xaxis"], "yref": axes["yaxis"], "x": 0, "y": height, "xanchor": "left", "yanchor": "top"}
        layout["annotations"].append({"text": camera.name, "showarrow": False, "font": {"size": 12}, **at})
        shown = np.nonzero(calibration.sightings.camera == c)[0]
        # Some thousand points fill an image; more only make the page slow.
        shown = shown[:: max(1, len(shown) // _MOST_POINTS)]
        x, y = np.round(calibration.sightings.xy[shown], 1).T
        data.append(
            {
                "type": "scatter", "mode": "markers", "x": x, "y": y, **axes, "showlegend": False,
                "marker": {
                    "size": 4, "color": np.round(size[shown], 3), "cmin": 0.0, "cmax": high, "showscale": c == 0,
                    "colorscale": [[0, "#0b5563"], [0.3, "#5fb6be"], [0.6, "#f6c177"], [1, "#7d1a2d"]],
                    "colorbar": figures.colour_bar("px"),
                },
                "hovertemplate": "%{marker.color:.2f} px<extra>" + camera.name + "</extra>",
            }
        )  # fmt: skip
    return figures.figure(data, height=60 + 260 * down, **layout)


def _shared(calibration: BoardCalibration) -> Table:
    # Only cameras that were calibrated: the others share no view that counts.
    order = [i for i, name in enumerate(calibration.linked_cameras) if name in calibration.rig.names]
    most = int(calibration.links.shared[np.ix_(order, order)].max(initial=1))
    rows: list[list[str | Cell]] = []
    for i in order:
        shared = [int(calibration.links.shared[i, j]) for j in order]
        cells = [Cell(str(number), 0.6 if number < 0.1 * most else 0.0) for number in shared]
        rows.append([calibration.linked_cameras[i], *(NOTHING if i == j else cell for j, cell in zip(order, cells, strict=True))])
    return Table(["", *(calibration.linked_cameras[i] for i in order)], rows)
