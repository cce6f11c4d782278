"""A wand calibration in; out comes a page that says whether to use it, what each camera saw, and where to wave more."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.recording import Floats
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, findings_table, percent, write_page
from asterism.report.space import rig_in_space

if TYPE_CHECKING:
    from asterism.calibration.wand import WandCalibration

_MOST_POINTS = 1500
_ACROSS = 4
"""Images side by side."""
_WORST = 0.7
"""px, a reprojection error that is tinted fully."""


def wand_report(path: str | Path, calibration: WandCalibration, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on a wand calibration; `settings` (files, wand, ...) are named at its foot.

    Raises AsterismError where the file cannot be written.
    """
    from asterism.calibration.wand import coverage

    lengths = calibration.lengths[np.isfinite(calibration.lengths)]
    cells = coverage(calibration)
    sections = [
        Section("What to know before using it", table=findings_table(calibration.findings)),
        Section(
            "The rig",
            "Cameras with their images, and where the wand was waved. Turn it with the mouse."
            + ("" if calibration.rig.vertical is not None else " Up is as the cameras hang until a floor is given."),
            figure=rig_in_space(calibration.rig, points=_some(calibration.positions.reshape(-1, 3))),
        ),
        Section(
            "Each camera",
            table=_cameras(calibration, cells),
            note="± is the standard deviation that the adjustment leaves; that of places is relative to all cameras.",
        ),
        Section(
            "What each image saw",
            "How often each part of each image saw a marker of the wand. White parts saw none: there the lens is a guess. Wave more there.",
            figure=_coverage(calibration, cells),
        ),
        Section(
            "Where the volume was covered",
            "How many cameras saw the wand at each place, from above and from the side. A marker needs two; three make it safe.",
            figure=_volume(calibration),
        ),
        Section(
            "Residuals",
            "Reprojection errors of each camera: half of them lie in the box. Cameras should look alike.",
            figure=_residuals(calibration),
        ),
    ]  # fmt: skip
    # A single marker has no length to measure.
    if len(calibration.wand.lengths) > 1:
        sections.append(
            Section(
                "The wand as measured",
                "Its length in each frame, from both ends triangulated by themselves: the accuracy that a recording can expect.",
                figure=_histogram(1000 * (lengths - calibration.wand.lengths[-1]), "measured less given length in mm"),
            )
        )
    spread = f"{1000 * lengths.std():.2f} mm" if len(lengths) and len(calibration.wand.lengths) > 1 else NOTHING
    merits = [
        (
            f"{calibration.rms:.3f} px",
            "reprojection error",
            "good" if calibration.rms < _WORST else "warn" if calibration.usable else "bad",
        ),
        (spread, "standard deviation of the wand as measured", ""),
        (
            f"{len(calibration.rig)} of {len(calibration.rig) + len(calibration.excluded)}",
            "cameras calibrated",
            "" if not calibration.excluded else "warn",
        ),
        (count(len(calibration.used)), f"of {calibration.frames:,} frames used", ""),
        (
            percent(calibration.mean_rejected_share),
            "of the wand's images left out",
            "warn" if calibration.mean_rejected_share > 0.12 else "",
        ),
    ]
    lead = "This calibration can be used." if calibration.usable else "Do not use this calibration: see below."
    write_page(path, Page("Wand calibration", lead, settings or {}, merits, sections))


def _cameras(calibration: WandCalibration, cells: Floats) -> Table:
    rows: list[list[str | Cell]] = []
    for c, camera in enumerate(calibration.rig):
        sigma = calibration.sigma[c]
        rows.append(
            [
                camera.name,
                count(int((calibration.sightings.camera == c).sum())),
                Cell(f"{camera.error:.3f}", min(max(camera.error - 0.3, 0.0) / _WORST, 1.0)),
                percent(float((cells[c] > 0).mean()), 0),
                f"{camera.focal[0]:.1f} ± {sigma[6]:.1f}",
                f"{camera.centre[0]:.1f}, {camera.centre[1]:.1f} ± {np.nanmax(sigma[8:10]):.1f}",
                ", ".join(f"{k:.3f}" for k in camera.radial[:3]),
                f"{1000 * calibration.position_sigma[c]:.1f}",
            ]
        )
    head = ["camera", "markers", "error in px", "image covered", "focal length in px", "principal point in px", "k1, k2, ..."]
    return Table([*head, "where it stands, ± mm"], rows)


def _some(points: Floats) -> Floats:
    """Some of the points (n, 3) m that are there: as many as a picture can hold."""
    # Every so many: evenly over the recording, not its beginning.
    points = points[np.isfinite(points).all(axis=1)]
    return points[:: max(1, len(points) // _MOST_POINTS)]


def _coverage(calibration: WandCalibration, cells: Floats) -> figures.Figure:
    """One small picture per camera."""
    down = -(-len(calibration.rig) // _ACROSS)
    # Counts differ by powers of ten between the middle and the edge of an image.
    most = float(np.log10(1.0 + cells.max(initial=0.0)))
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": []}
    for c, camera in enumerate(calibration.rig):
        row, column = divmod(c, _ACROSS)
        width, height = camera.size or (8, 6)
        left, top = column / _ACROSS, 1.0 - row / down
        bare, low = {"showgrid": False, "showticklabels": False}, top - 0.84 / down
        up = {"domain": [low, top], "autorange": "reversed", **bare}
        axes, sides = figures.cell_axes(c, {"domain": [left, left + 0.94 / _ACROSS], **bare}, up)
        layout |= sides
        layout["annotations"].append(
            {
                "text": f"{camera.name}: {100 * float((cells[c] > 0).mean()):.0f} %", "showarrow": False, "font": {"size": 12},
                "xref": "paper", "yref": "paper", "x": left, "y": low, "xanchor": "left", "yanchor": "top",
            }
        )  # fmt: skip
        rows, columns = cells[c].shape
        data.append(
            {
                "type": "heatmap", "z": np.log10(1.0 + cells[c]), "zmin": 0.0, "zmax": max(most, 1.0), "showscale": False,
                "x": (np.arange(columns) + 0.5) * width / columns, "y": (np.arange(rows) + 0.5) * height / rows,
                "customdata": cells[c], "hovertemplate": "%{customdata} markers<extra>" + camera.name + "</extra>",
                "colorscale": [[0, "#ffffff"], [0.01, "#d8eef0"], [1, "#0b5563"]], "xgap": 1, "ygap": 1, **axes,
            }
        )  # fmt: skip
    return figures.figure(data, height=60 + 190 * down, plot_bgcolor="#eef1f6", **layout)


def _volume(calibration: WandCalibration) -> figures.Figure:
    """From above and from the side: the mean number of cameras that saw the wand's markers, in cells of a 24th of the widest extent."""
    # Frames that were left out have no positions.
    rows = np.searchsorted(calibration.used, calibration.sightings.frame)
    markers = len(calibration.wand.lengths)
    seen = np.bincount(rows * markers + calibration.sightings.point, minlength=len(calibration.used) * markers)
    points = calibration.positions.reshape(-1, 3)
    good = np.isfinite(points).all(axis=1)
    points, seen = points[good], seen[good]
    # Cells of a share of the volume: small rooms and halls get pictures of the same fineness.
    size = max(float(np.ptp(points, axis=0).max()) / 24.0, 1e-6) if len(points) else 1.0
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {}
    for n, (across, up, domain, view) in enumerate(((0, 1, [0, 0.47], "from above"), (0, 2, [0.55, 1.0], "from the side"))):
        upwards = figures.titled(f"{'xyz'[up]} in m", scaleanchor=f"x{'' if n == 0 else 2}")
        axes, sides = figures.cell_axes(n, figures.titled(f"x in m, {view}", domain=domain), upwards)
        layout |= sides
        # Counted in cells from the lowest one.
        at = np.floor(points[:, [across, up]] / size).astype(np.int64)
        low = at.min(axis=0, initial=0) if len(at) else np.zeros(2, dtype=np.int64)
        shape = tuple((at.max(axis=0) - low + 1)[::-1]) if len(at) else (1, 1)
        total, number = np.zeros(shape), np.zeros(shape)
        np.add.at(total, (at[:, 1] - low[1], at[:, 0] - low[0]), seen)
        np.add.at(number, (at[:, 1] - low[1], at[:, 0] - low[0]), 1)
        # Places where the wand never was stay white.
        mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
        data.append(
            {
                "type": "heatmap", "z": np.round(mean, 2), "zmin": 2, "zmax": max(len(calibration.rig), 3), "showscale": n == 0,
                "x": (low[0] + np.arange(shape[1]) + 0.5) * size, "y": (low[1] + np.arange(shape[0]) + 0.5) * size,
                "colorscale": [[0, "#f6c177"], [1.0 / max(len(calibration.rig) - 2, 1) * 0.99, "#d8eef0"], [1, "#0b5563"]],
                "colorbar": figures.colour_bar(title={"text": "cameras"}), "hovertemplate": "%{z} cameras<extra></extra>", **axes,
            }
        )  # fmt: skip
    return figures.figure(data, height=380, **layout)


def _residuals(calibration: WandCalibration) -> figures.Figure:
    size = np.linalg.norm(calibration.residuals, axis=1)
    data = []
    for c, camera in enumerate(calibration.rig):
        # 5 and 95 %: the ends of a box must not be single outliers.
        low, first, middle, third, high = np.percentile(size[calibration.sightings.camera == c], [5, 25, 50, 75, 95])
        data.append(
            {
                "type": "box", "name": camera.name, "x": [camera.name], "lowerfence": [low], "q1": [first], "median": [middle],
                "q3": [third], "upperfence": [high], "fillcolor": "#a5d8dc", "line": {"color": "#0f7b8a"}, "showlegend": False,
            }
        )  # fmt: skip
    return figures.figure(data, height=320, yaxis=figures.titled("px, 5 to 95 %", rangemode="tozero"), xaxis={"type": "category"})


def _histogram(values: Floats, what: str) -> figures.Figure:
    # Symmetric about 0: a shift to one side is a wrong scale.
    reach = float(np.percentile(np.abs(values), 99.5)) if len(values) else 1.0
    counts, edges = np.histogram(values, bins=41, range=(-reach, reach))
    trace = {"type": "bar", "x": 0.5 * (edges[1:] + edges[:-1]), "y": counts, "marker": {"color": figures.PALETTE[0]}}
    trace["hovertemplate"] = "%{x:.2f} mm: %{y} frames<extra></extra>"
    return figures.figure([trace], height=280, bargap=0.05, xaxis=figures.titled(what), yaxis=figures.titled("frames"))
