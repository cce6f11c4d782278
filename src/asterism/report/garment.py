"""A captured garment in; a page that shows the cloth, what each camera read, which circles are missing and what to know, out."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from asterism.findings import Severity, worst
from asterism.geometry import z_up_rotation
from asterism.recording import Floats
from asterism.report import figures
from asterism.report.page import Cell, Page, Section, Table, count, findings_table, percent, write_page

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.garment import Pattern
    from asterism.garment.capture import Capture
    from asterism.garment.dense import UsedCircles

_WIDEST = 1000
"""px of a picture on the page; larger ones are reduced."""


@dataclass(frozen=True)
class Picture:
    """A camera's image on the page, with what was read in it.

    name     of the camera, and what else to say about it
    image    (h, w, 3) uint8, blue, green, red
    circles  that were read; None: none are drawn
    """

    name: str
    image: NDArray[np.uint8]
    circles: UsedCircles | None = None


def garment_report(
    path: str | Path,
    capture: Capture,
    pattern: Pattern,
    rig: Rig,
    *,
    pictures: Sequence[Picture] = (),
    criteria: Table | None = None,
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write an HTML page on a captured garment.

    pictures  images to show, with the circles read in them
    criteria  results against a known truth, shown first
    settings  named at the page's foot

    Raises AsterismError where the file cannot be written.
    """
    sections = []
    if criteria is not None:
        sections.append(Section("Against the truth", "The wearer is simulated, so it is known where each circle was.", table=criteria))
    sections.append(Section("What to know before using it", table=findings_table(capture.findings)))
    # The fullest frame shows the cloth best.
    shown = int(np.argmax(capture.points))
    if capture.points[shown]:
        text = f"Frame {capture.frames[shown]}, the one with most points: triangles between neighbours on the cloth. Drag to turn."
        sections.append(Section("The cloth", text, figure=_cloth(capture, pattern, rig, shown)))
    for picture in pictures:
        text = "Circles with an identity have a ring in the colour that was read." if picture.circles is not None else ""
        sections.append(Section(picture.name, text, figure=_picture(picture, pattern)))
    sections += [
        Section("Points over time", figure=_over_time(capture)),
        Section(
            "Which circles were captured",
            "The printed sheet: in how many of the frames each circle has a position. Circles at the borders have no identity.",
            figure=_sheet(capture, pattern),
        ),
        Section("What each camera read", table=_cameras(capture, rig)),
    ]
    write_page(path, Page("Captured garment", _lead(capture), settings or {}, _merits(capture), sections))


def _lead(capture: Capture) -> str:
    level = worst(capture.findings)
    if level == Severity.ERROR:
        return "Do not use this capture: see below."
    return "This capture can be used with care: see below." if level == Severity.WARNING else "This capture can be used."


def _merits(capture: Capture) -> list[tuple[str, str, str]]:
    summary = capture.summary()
    share = summary["of_those_seen_by_two_cameras"]
    return [
        (count(summary["points_per_frame"]), "points per frame", ""),
        (percent(share), "of the circles that two cameras read", "good" if share > 0.98 else "warn"),
        (f"{1000 * summary['sigma_m']:.2f} mm", "standard deviation of a point, median", ""),
        (count(summary["identities_read_per_image"]), "circles identified per image", ""),
    ]


def _cloth(capture: Capture, pattern: Pattern, rig: Rig, frame: int) -> figures.Figure:
    """The surface of one frame in 3D, up is up."""
    from asterism.garment.surface import surface

    # Triangles between neighbours on the print: they need no guess of the shape.
    cloth = surface(capture.trajectories.points(frame), pattern)
    turn = z_up_rotation(capture.trajectories.vertical)
    x, y, z = np.round((cloth.points @ turn.T).T, 4) if len(cloth.points) else np.empty((3, 0))
    # Dots in the printed colours: whoever knows the suit sees where it is.
    cells = pattern.cells(cloth.ids)
    inks = [_css(pattern.hsv[number]) for number in pattern.colours[cells[:, 0], cells[:, 1]].tolist()]
    corners = {name: cloth.triangles[:, k] for k, name in enumerate("ijk")}
    mesh = {
        "type": "mesh3d", "x": x, "y": y, "z": z, **corners, "color": "#39404d", "flatshading": True, "hoverinfo": "skip",
        "lighting": {"ambient": 0.45, "diffuse": 0.8, "specular": 0.1},
    }  # fmt: skip
    dots = {
        "type": "scatter3d", "mode": "markers", "x": x, "y": y, "z": z, "marker": {"size": 2.2, "color": inks}, "showlegend": False,
        "text": [str(circle) for circle in cloth.ids.tolist()],
        "hovertemplate": "circle %{text}: %{x:.3f}, %{y:.3f}, %{z:.3f} m<extra></extra>",
    }  # fmt: skip
    axis = {"title": {"text": ""}, "showbackground": False, "gridcolor": "#e6ebf2", "zerolinecolor": "#cfd8e4"}
    scene = {"aspectmode": "data", "xaxis": axis, "yaxis": axis, "zaxis": axis, "camera": {"eye": {"x": 1.5, "y": 0.9, "z": 0.35}}}
    return figures.figure([mesh, dots], height=640, scene=scene)


def _css(hsv: Floats) -> str:
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(*hsv))
    return f"rgb({red},{green},{blue})"


def _picture(picture: Picture, pattern: Pattern) -> figures.Figure:
    """An image with a ring around each circle that has an identity."""
    height, width = picture.image.shape[:2]
    source = figures.behind(figures.picture(picture.image, _WIDEST), (width, height), {"xaxis": "x", "yaxis": "y"})
    traces: list[dict[str, Any]] = []
    if picture.circles is not None:
        ids = np.asarray(picture.circles.ids)
        # A circle without an identity was found but not read; a ring would promise more.
        known = np.flatnonzero(ids >= 0)
        cells = pattern.cells(ids[known])
        colours = [_css(colour) for colour in pattern.hsv]
        x, y = np.round(np.asarray(picture.circles.centres)[known], 1).T if len(known) else np.empty((2, 0))
        traces.append(
            {
                "type": "scatter", "mode": "markers", "x": x, "y": y, "showlegend": False, "text": [str(i) for i in ids[known].tolist()],
                "marker": {
                    "symbol": "circle-open", "size": 8,
                    "color": [colours[pattern.colours[row, column]] for row, column in cells.tolist()],
                },
                "hovertemplate": "circle %{text} at %{x:.1f}, %{y:.1f}<extra></extra>",
            }
        )  # fmt: skip
    side = {"showgrid": False, "zeroline": False, "showticklabels": False, "constrain": "domain", "fixedrange": False}
    return figures.figure(
        traces or [{"type": "scatter", "x": [], "y": []}], height=int(min(900, 40 + _WIDEST * height / width)), images=[source],
        xaxis={**side, "range": [-0.5, width - 0.5]}, yaxis={**side, "range": [height - 0.5, -0.5], "scaleanchor": "x"},
    )  # fmt: skip


def _over_time(capture: Capture) -> figures.Figure:
    lines = (("points", capture.points, figures.PALETTE[0]), ("circles that two cameras read", capture.seen, figures.PALETTE[2]))
    data = [
        figures.line(
            capture.frames, values, name, "frame %{x}: %{y}", mode="lines+markers", line={"color": colour, "width": 2}, marker={"size": 5}
        )
        for name, values, colour in lines
    ]
    return figures.figure(data, height=300, xaxis=figures.titled("frame"), yaxis=figures.titled("", rangemode="tozero"))


def _sheet(capture: Capture, pattern: Pattern) -> figures.Figure:
    """The share of frames in which each circle has a position, on the printed sheet."""
    # Circles at the borders have no identity to capture: white, not missing.
    share = np.where(pattern.ids >= 0, 0.0, np.nan)
    cells = pattern.cells(capture.trajectories.ids)
    if len(cells):
        share[cells[:, 0], cells[:, 1]] = np.isfinite(capture.trajectories.positions[..., 0]).mean(axis=0)
    trace = {
        "type": "heatmap", "z": np.round(100 * share, 1), "zmin": 0, "zmax": 100,
        "hovertemplate": "row %{y}, column %{x}: %{z} %<extra></extra>",
        "colorscale": [[0, "#7d1a2d"], [0.5, "#f6c177"], [1, "#0f7b8a"]],
        "colorbar": figures.colour_bar(ticksuffix=" %"),
    }  # fmt: skip
    names = [
        {
            "text": piece.name, "x": piece.column + 0.5 * piece.columns, "y": piece.row - 1, "showarrow": False, "yanchor": "bottom",
            "font": {"size": 12},
        }
        for piece in pattern.pieces
    ]  # fmt: skip
    rows, columns = pattern.shape
    side = {"showgrid": False, "zeroline": False, "showticklabels": False, "constrain": "domain"}
    return figures.figure(
        [trace], height=int(np.clip(120 + 900 * rows / columns, 240, 900)), annotations=names, xaxis=side,
        yaxis={**side, "range": [rows, -4], "scaleanchor": "x"},
    )  # fmt: skip


def _cameras(capture: Capture, rig: Rig) -> Table:
    # A quarter of the best camera is little, whatever the suit.
    most = float(capture.read.mean(axis=0).max(initial=1.0))
    rows: list[list[str | Cell]] = []
    for c, name in enumerate(rig.names):
        mean = float(capture.read[:, c].mean())
        rows.append([name, Cell(count(mean), 0.6 if mean < 0.25 * most else 0.0), count(float(capture.read[:, c].min()))])
    return Table(["camera", "circles identified per image", "fewest"], rows)
