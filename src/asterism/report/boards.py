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


def board_report(path: str | Path, made: BoardCalibration, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on a calibration from boards; `settings` (files, board, ...) are named at its foot.

    Raises AsterismError where the file cannot be written.
    """
    several = len(made.rig) > 1
    summary = made.summary()
    sections = [
        Section("What to know before using it", table=_findings(made)),
        # One camera has no rig to show.
        *([_rig(made)] if several else []),
        Section("Each camera", table=_cameras(summary), note="± is the standard deviation that the calibration leaves."),
        Section(
            "What each image saw",
            "The board's points in each image, shaded by how far they lie from where the board is. "
            "Where no point is, above all in corners, the lens is a guess: show the board there.",
            figure=_images(made),
        ),
    ]
    if several:
        text = "Frames in which two cameras saw the board together: what holds the rig together."
        sections.append(Section("Shared views", text, table=_shared(made)))
    write_page(path, Page("Calibration from a board", _lead(made), settings or {}, _merits(made), sections))


def _rig(made: BoardCalibration) -> Section:
    shown = made.adjustment.translations + made.adjustment.rotations @ made.views.board.points.mean(axis=0)
    # The adjustment counts from its own origin, the rig from where it stands: the first camera is in both.
    first = made.adjustment.cameras[0]
    in_camera = shown @ first.rotation.T + first.translation
    moved = (in_camera - made.rig.cameras[0].translation) @ made.rig.cameras[0].rotation
    text = "Cameras open where they look; dots are where the board was. Drag to turn."
    return Section("The rig", text, figure=rig_in_space(made.rig, points=moved))


def _lead(made: BoardCalibration) -> str:
    if not made.usable:
        return "Do not use this calibration: see below."
    return "This calibration can be used with care: see below." if made.findings else "This calibration can be used."


def _merits(made: BoardCalibration) -> list[tuple[str, str, str]]:
    # The mean hides one bad camera among good ones.
    worst = max((camera.error for camera in made.rig), default=0.0)
    return [
        (f"{made.rms:.3f} px", "reprojection error, all together", "bad" if not made.usable else "warn" if made.findings else "good"),
        (f"{worst:.3f} px", "of the worst camera", "" if worst < _TINTED_PX else "warn"),
        (f"{len(made.rig)} of {len(made.views.cameras)}", "cameras calibrated", "" if not made.excluded else "warn"),
        (f"{len(made.used):,}", f"of {len(made.views.frames):,} frames used", ""),
    ]


def _findings(made: BoardCalibration) -> Table:
    more: list[list[str | Cell]] = []
    if made.rejected_views:
        some = ", ".join(f"{name} in frame {frame}" for frame, name in made.rejected_views[:12])
        more.append([Cell("left out", 0.3), f"{len(made.rejected_views)} views that do not fit the others: {some}"])
    return findings_table(made.findings, more)


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


def _images(made: BoardCalibration) -> figures.Figure:
    """One small picture per camera: its points, shaded by residual."""
    down = -(-len(made.rig) // _ACROSS)
    size = np.linalg.norm(made.adjustment.residuals, axis=1)
    # A few outliers would leave all other points in one colour.
    high = float(np.nanpercentile(size, 98)) if len(size) else 1.0
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": []}
    for c, camera in enumerate(made.rig):
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
        own = np.nonzero(made.sightings.camera == c)[0]
        # Some thousand points fill an image; more only make the page slow.
        own = own[:: max(1, len(own) // _MOST_POINTS)]
        x, y = np.round(made.sightings.xy[own], 1).T
        data.append(
            {
                "type": "scatter", "mode": "markers", "x": x, "y": y, **axes, "showlegend": False,
                "marker": {
                    "size": 4, "color": np.round(size[own], 3), "cmin": 0.0, "cmax": high, "showscale": c == 0,
                    "colorscale": [[0, "#0b5563"], [0.3, "#5fb6be"], [0.6, "#f6c177"], [1, "#7d1a2d"]],
                    "colorbar": figures.colour_bar("px"),
                },
                "hovertemplate": "%{marker.color:.2f} px<extra>" + camera.name + "</extra>",
            }
        )  # fmt: skip
    return figures.figure(data, height=60 + 260 * down, **layout)


def _shared(made: BoardCalibration) -> Table:
    # Only cameras that were calibrated: the others share no view that counts.
    order = [i for i, name in enumerate(made.linked_cameras) if name in made.rig.names]
    most = int(made.links.shared[np.ix_(order, order)].max(initial=1))
    rows: list[list[str | Cell]] = []
    for i in order:
        shared = [int(made.links.shared[i, j]) for j in order]
        cells = [Cell(str(number), 0.6 if number < 0.1 * most else 0.0) for number in shared]
        rows.append([made.linked_cameras[i], *(NOTHING if i == j else cell for j, cell in zip(order, cells, strict=True))])
    return Table(["", *(made.linked_cameras[i] for i in order)], rows)
