"""Labels in the images in; a page with a picture for each camera out: blobs, the body's capsules, assignments, hidden markers hollow."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras import Camera
from asterism.recording import Floats
from asterism.report.figures import line
from asterism.report.page import Page, Section, Table, percent, write_page
from asterism.views import ViewsLabelling
from asterism.views.posing import posed_points

_BODY, _LABEL, _ONE, _LEFT = "rgba(95, 182, 190, 0.25)", "#0b5563", "#c77d1a", "#7d1a2d"


def views_report(path: str | Path, result: ViewsLabelling, *, frame: int | None = None, title: str = "Labels in the images") -> None:
    """Write an HTML page on labels in the images.

    frame  the one that is shown; by default, of those with the body, that in which the most markers are seen by one camera alone
    Raises AsterismError where the file cannot be written.
    """
    there = np.isfinite(result.poses[:, 0])
    given = result.labels >= 0
    one, more = result.views == 1, result.views >= 2
    if frame is None:
        # Where most markers are seen by one camera alone the body does most of the work.
        frame = int(np.argmax(np.where(there, one.sum(axis=1), -1))) if there.any() else 0
    merits = [
        (percent(float(there.mean())) if len(there) else "0 %", "of the frames show the body", ""),
        (percent(float(given.mean())) if len(given) else "0 %", "of the blobs have a label", ""),
        (str(int(more.sum())), "places by two or more cameras", ""),
        (str(int(one.sum())), "places by one camera and the body", ""),
    ]
    number = frame + result.blobs.first_frame
    pictures = [
        Section(
            f"Camera {camera.name}, frame {number}",
            "Dots are blobs with the marker that each shows, crosses blobs without a label, rings markers that the body hides here.",
            figure=_picture(result, c, frame),
        )
        for c, camera in enumerate(result.rig)
    ]
    sections = [*pictures, Section("Markers", "Median standard deviation of the places, mm.", table=_markers(result))]
    facts: Mapping[str, Any] = {
        "body": result.body.title,
        "height of the person": f"{result.person.height:.2f} m",
        "cameras": ", ".join(result.rig.names),
        "body sought anew in frames": ", ".join(str(t + result.blobs.first_frame) for t in result.restarts[:12]) or "none",
    }
    lead = f"{len(result.views)} frames of {len(result.rig)} cameras, labelled with a model of the body."
    write_page(path, Page(title, lead, facts, merits, tuple(sections)))


def _markers(result: ViewsLabelling) -> Table:
    deviations = 1000 * result.deviations

    def median(which: Any) -> str:
        return f"{np.median(deviations[which]):.1f}" if which.any() else ""

    rows = []
    for m, name in enumerate(result.body.labels):
        chosen = np.zeros_like(result.views, dtype=np.bool_)
        chosen[:, m] = True
        several, single = chosen & (result.views >= 2), chosen & (result.views == 1)
        rows.append([name, str(int(several.sum())), median(several), str(int(single.sum())), median(single)])
    return Table(["marker", "frames, several cameras", "mm", "frames, one camera", "mm"], rows)


def _picture(result: ViewsLabelling, c: int, frame: int) -> dict[str, Any]:
    """The image of one camera as a Plotly figure."""
    camera, blobs = result.rig.cameras[c], result.blobs
    cell = frame * len(result.rig) + c
    rows = slice(blobs.offsets[cell], blobs.offsets[cell + 1])
    xy, labels = blobs.xy[rows], result.labels[rows]
    traces: list[dict[str, Any]] = []
    names = np.array(result.body.labels)
    if np.isfinite(result.poses[frame, 0]):
        points, starts, ends = posed_points(result.person, result.poses[frame], result.rotations[frame])
        radii = float(result.poses[frame, :3].mean()) * result.person.arrays.radii
        traces += [_capsule(camera, *part) for part in zip(starts, ends, radii, strict=True)]
        seen = camera.project(points)
        links = [(seen[m], blob) for blob, m in zip(xy, labels, strict=True) if m >= 0]
        traces.append(_lines(links))
        # Expected to be hidden, and without a blob.
        hidden = (result.expected[frame, c] < 0.5) & ~np.isin(np.arange(len(points)), labels[labels >= 0])
        traces.append(_dots(seen[hidden], names[hidden], _LABEL, "circle-open", "hidden by the body"))
    labelled, alone = labels >= 0, np.zeros(len(labels), dtype=np.bool_)
    # Labels of one camera rest on the body; they get a colour of their own.
    alone[labelled] = result.views[frame, labels[labelled]] == 1
    several = labelled & ~alone
    traces.append(_dots(xy[several], names[labels[several]], _LABEL, "circle", "labelled"))
    traces.append(_dots(xy[alone], names[labels[alone]], _ONE, "circle", "labelled, this camera alone"))
    traces.append(_dots(xy[~labelled], np.full(int((~labelled).sum()), ""), _LEFT, "x", "no label"))
    # Strays may be anywhere: they must not shrink the person.
    left, right, top, bottom = _extent(camera, [*traces[:-1]] or traces)
    axis = {"showgrid": False, "zeroline": False}
    layout = {
        "xaxis": {**axis, "range": [left, right], "constrain": "domain", "title": {"text": "x (px)"}},
        "yaxis": {**axis, "range": [bottom, top], "scaleanchor": "x", "constrain": "domain", "title": {"text": "y (px)"}},
        "height": 620,
        "margin": {"l": 60, "r": 20, "t": 20, "b": 50},
        "legend": {"orientation": "h", "y": 1.08},
    }
    return {"data": [trace for trace in traces if trace["x"]], "layout": layout}


def _extent(camera: Camera, traces: list[dict[str, Any]]) -> tuple[float, float, float, float]:
    """px, left, right, top and bottom of the part of the image around the person: what is drawn but strays, and a margin of 30 px."""
    x = [value for trace in traces for value in trace["x"] if value is not None]
    y = [value for trace in traces for value in trace["y"] if value is not None]
    if not x:
        width, height = camera.size or (2 * camera.centre[0], 2 * camera.centre[1])
        return 0.0, float(width), 0.0, float(height)
    return min(x) - 30.0, max(x) + 30.0, min(y) - 30.0, max(y) + 30.0


def _capsule(camera: Camera, start: Floats, end: Floats, radii: Floats) -> dict[str, Any]:
    """The outline of a capsule in an image: the hull of the circles at its ends."""
    from scipy.spatial import ConvexHull

    turn = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    across = camera.rotation[:2]
    rings = [
        place + radius * (np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1])
        for place, radius in zip((start, end), radii, strict=True)
    ]
    seen = camera.project(np.concatenate(rings))
    seen = seen[np.isfinite(seen[:, 0])]
    # Fewer than three points before the camera have no outline.
    outline = seen[ConvexHull(seen).vertices] if len(seen) >= 3 else np.empty((0, 2))
    closed = np.concatenate([outline, outline[:1]])
    shape: dict[str, Any] = {"fill": "toself", "fillcolor": _BODY, "hoverinfo": "skip", "showlegend": False}
    return line(closed[:, 0].tolist(), closed[:, 1].tolist(), line={"color": "rgba(11, 85, 99, 0.4)", "width": 1}, **shape)


def _lines(links: list[tuple[Floats, Floats]]) -> dict[str, Any]:
    """From where the body has its markers to their blobs."""
    x = [value for one, other in links for value in (float(one[0]), float(other[0]), None)]
    y = [value for one, other in links for value in (float(one[1]), float(other[1]), None)]
    return line(x, y, "from the body to the blob", line={"color": "#d9480f", "width": 1.5})


def _dots(xy: Floats, names: np.ndarray, colour: str, symbol: str, what: str) -> dict[str, Any]:
    there = np.isfinite(xy[:, 0])
    text: dict[str, Any] = {
        "text": [str(name) for name in names[there]],
        "textposition": "top center",
        "textfont": {"size": 10, "color": colour},
    }
    marker = {"color": colour, "symbol": symbol, "size": 7, "line": {"width": 1.5, "color": colour}}
    return line(xy[there, 0].tolist(), xy[there, 1].tolist(), what, mode="markers+text", marker=marker, **text)
