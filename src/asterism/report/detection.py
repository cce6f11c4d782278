"""Detected blobs in; a page with a contact sheet of all cameras and their counts over time out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.findings import Severity, worst
from asterism.recording import Floats
from asterism.report import figures
from asterism.report.page import Cell, Page, Section, Table, count, percent, write_page

if TYPE_CHECKING:
    from asterism.detection import CameraImages, Detection

_WIDEST = 1000
_COLUMNS = 2
_WIDTH = 960


def detection_report(path: str | Path, detection: Detection, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on what was found in each camera's images; `settings` are named at its foot.

    Raises AsterismError where the file cannot be written.
    """
    cameras, blobs, findings = detection.cameras, detection.blobs, detection.findings
    seconds = np.arange(len(blobs)) / blobs.rate
    step = figures.frames_per_column(len(blobs))
    starts = np.arange(0, len(blobs), step)
    # Means over blocks of frames: an hour has more frames than a picture has columns.
    counts = (
        np.add.reduceat(blobs.counts, starts, axis=0) / np.diff([*starts, len(blobs)])[:, None]
        if len(blobs)
        else np.zeros(blobs.counts.shape)
    )
    sections = [
        Section(
            "What each camera sees",
            "One image of each camera; circles are blobs, as wide as they were measured. Amber: flagged, because it overlaps another, is "
            "cut by the image's edge or is not round.",
            figure=_contact_sheet(cameras),
        ),
        Section(
            "Blobs over time",
            "How many blobs each camera has. A camera that falls to none is blocked or stopped; one far above the others sees lights.",
            figure=_over_time(blobs.cameras, seconds[starts], counts),
        ),
        Section("Cameras", table=_table(cameras)),
    ]
    # More images than expected are no loss.
    missing = sum(max(camera.expected - camera.frames, 0) for camera in cameras)
    merits = [
        (str(len(cameras)), "cameras", ""),
        (count(len(blobs)), "frames", ""),
        (count(len(blobs.xy)), "blobs", ""),
        (count(missing), "images missing", "bad" if missing else "good"),
        (str(len(findings)), "findings", "bad" if worst(findings) > Severity.NOTE else "good"),
    ]
    lead = " ".join(map(str, findings)) or "Nothing is wrong with the images."
    write_page(path, Page("Markers in the images", lead, settings or {}, merits, sections))


def _over_time(names: tuple[str, ...], seconds: Floats, counts: Floats) -> figures.Figure:
    """Mean counts (T, C) of each camera's images over time, one line each."""
    styles = [{"width": 1.5, "color": figures.PALETTE[c % len(figures.PALETTE)]} for c in range(len(names))]
    x = np.round(seconds, 4)
    data = [figures.line(x, np.round(counts[:, c], 2), name, line=styles[c]) for c, name in enumerate(names)]
    return figures.figure(data, 320, xaxis=figures.titled("time in s"), yaxis=figures.titled("blobs", rangemode="tozero"))


def _contact_sheet(cameras: tuple[CameraImages, ...]) -> figures.Figure:
    """All cameras' sample images in a grid, each with its blobs drawn over it."""
    rows = -(-len(cameras) // _COLUMNS)
    columns = min(_COLUMNS, len(cameras))
    data: list[Mapping[str, Any]] = []
    layout: dict[str, Any] = {"images": [], "annotations": [], "showlegend": False}
    for i, camera in enumerate(cameras):
        row, column = divmod(i, columns)
        wide, tall = camera.size
        left, top = column / columns, 1 - row / rows
        place = {"showgrid": False, "zeroline": False, "showticklabels": False, "fixedrange": False, "constrain": "domain"}
        across = {**place, "domain": [left + 0.01, left + 1 / columns - 0.01], "range": [-0.5, wide - 0.5]}
        up = {**place, "domain": [top - 1 / rows + 0.02, top - 0.06], "range": [tall - 0.5, -0.5], "scaleanchor": f"x{i + 1 if i else ''}"}
        axes, sides = figures.cell_axes(i, across, up)
        layout |= sides
        layout["images"].append(figures.behind(_picture(camera), camera.size, axes))
        text = f"{camera.name}, image {camera.sample_frame}: {len(camera.sample_blobs)} blobs"
        at = {"xref": f"{axes['xaxis']} domain", "yref": f"{axes['yaxis']} domain", "x": 0, "y": 1, "yanchor": "bottom", "xanchor": "left"}
        layout["annotations"].append({"text": text, "showarrow": False, **at})
        data += _circles(camera, axes)
    tallest = max(camera.size[1] / camera.size[0] for camera in cameras)
    return figures.figure(data, int(rows * (50 + _WIDTH / columns * tallest)), **layout)


def _circles(camera: CameraImages, axes: Mapping[str, str]) -> list[Mapping[str, Any]]:
    """The blobs of the sample image as circles in its own pixels: those without a flag and those with one."""
    # NaN lifts the pen between two circles.
    turn = np.append(np.linspace(0, 2 * np.pi, 17), np.nan)
    traces: list[Mapping[str, Any]] = []
    blobs = camera.sample_blobs
    for flagged, colour in ((False, "#2ad4c4"), (True, "#ffb000")):
        these = (blobs.flags > 0) == flagged
        # Around the blob, not on it, and never too small to be seen.
        radius = np.maximum(0.5 * blobs.size[these] + 2.0, 0.007 * camera.size[0])
        x = np.round(blobs.xy[these, 0, None] + radius[:, None] * np.cos(turn), 1).ravel()
        y = np.round(blobs.xy[these, 1, None] + radius[:, None] * np.sin(turn), 1).ravel()
        traces.append(figures.line(x, y, line={"color": colour, "width": 2}, hoverinfo="skip", **axes))
    return traces


def _picture(camera: CameraImages) -> str:
    """The sample image as a data address: made smaller, and brighter where it is dark, so that its blobs can be seen."""
    image = camera.sample.astype(np.float64)
    # Marker images are nearly black: scaled so that a usual blob is white.
    above = max(2.0 * camera.threshold, float(np.median(camera.sample_blobs.peak)) if len(camera.sample_blobs) else 0.0, 1.0)
    bright = float(np.median(image)) + above
    grey = np.clip(255.0 * image / bright, 0, 255).astype(np.uint8)
    return figures.picture(grey, _WIDEST)


def _table(cameras: tuple[CameraImages, ...]) -> Table:
    def share(part: int, camera: CameraImages) -> Cell:
        of = part / camera.blobs if camera.blobs else 0.0
        return Cell(percent(of), min(1.0, 2 * of))

    head = ["camera", "size", "images", "threshold", "per image", "overlapping", "unround", "saturated", "cut by edge", "masked"]
    head += ["frames behind"]
    rows: list[list[str | Cell]] = [
        [
            camera.name,
            f"{camera.size[0]} x {camera.size[1]}",
            Cell(f"{camera.frames} of {camera.expected}", float(camera.frames < camera.expected), "bad"),
            f"{camera.threshold:.0f}",
            f"{camera.blobs / max(camera.frames, 1):.1f}",
            share(camera.overlapping, camera),
            share(camera.unround, camera),
            percent(camera.saturated / max(camera.blobs, 1)),
            count(camera.at_border),
            f"{percent(camera.masked)} in {camera.masked_places}",
            Cell(count(camera.lag_frames), float(abs(camera.lag_frames) >= 1), "bad"),
        ]
        for camera in cameras
    ]
    return Table(head, rows)
