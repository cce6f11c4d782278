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
from asterism.skeleton.posing import posed_points
from asterism.views import ViewsLabelling

_BODY, _LABEL, _ONE, _LEFT = "rgba(95, 182, 190, 0.25)", "#0b5563", "#c77d1a", "#7d1a2d"
_HIDDEN = "#6b7c8c"
_COLUMNS = 2
"""Pictures beside each other: on a page of 800 px each is as wide as a person with the names on both sides."""
_HEIGHT = 560
"""px of a picture: with its title and the slider it fits a screen."""
_NAME_WIDTH = 62
"""px beside the person for the names: ten letters."""
_LINE = 16
"""px from a name to the next one, whose letters are 10 px high; on a narrow page a picture is drawn a fifth smaller."""
_STEPS = 24
"""Frames on the slider: a second's step in a walk of some strides; each adds some 20 kB to the page for a camera."""
_Extent = tuple[float, float, float, float]


def views_report(path: str | Path, result: ViewsLabelling, *, frame: int | None = None, title: str = "Labels in the images") -> None:
    """Write an HTML page on labels in the images.

    frame  the one that is shown first; by default, of those with the body, that in which the most markers are seen by one camera alone
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
    sections = [
        Section(
            "What the cameras show",
            "Dots are blobs with the marker that each shows, crosses blobs without a label, rings markers that the body hides here. Each "
            "picture shows the part of the image in which the person is. The slider goes through the recording.",
            figure=_pictures(result, frame),
        ),
        Section("Markers", "Median standard deviation of the places, mm.", table=_markers(result)),
    ]
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


def _pictures(result: ViewsLabelling, first: int) -> dict[str, Any]:
    """All cameras' images as one Plotly figure, with a slider over frames."""
    count, frames = len(result.rig), len(result.views)
    across = min(count, _COLUMNS)
    down = -(-count // across)
    shown = sorted({first, *np.linspace(0, frames - 1, min(_STEPS, frames)).round().astype(int).tolist()})
    traces: list[dict[str, Any]] = []
    ends: list[int] = []
    layouts: list[dict[str, Any]] = []
    for frame in shown:
        annotations: list[dict[str, Any]] = []
        layout: dict[str, Any] = {"annotations": annotations}
        for c in range(count):
            own, (left, right, top, bottom), names = _picture(result, c, frame)
            axes = {"xaxis": f"x{_number(c)}", "yaxis": f"y{_number(c)}"}
            # What a legend says once holds for all cameras.
            traces += [{**trace, **axes, "legendgroup": trace.get("name"), "showlegend": trace.get("showlegend", c == 0)} for trace in own]
            layout |= {f"xaxis{_number(c)}.range": [left, right], f"yaxis{_number(c)}.range": [bottom, top]}
            title = {
                "text": f"Camera {result.blobs.cameras[c]}", "xref": f"x{_number(c)} domain", "yref": f"y{_number(c)} domain",
                "x": 0.5, "y": 1.0,
                "yanchor": "bottom", "showarrow": False, "font": {"size": 14},
            }  # fmt: skip
            annotations += [title, *({**name, **_of_axes(c)} for name in names)]
        ends.append(len(traces))
        layouts.append(layout)
    steps: list[dict[str, Any]] = []
    for k, (frame, layout) in enumerate(zip(shown, layouts, strict=True)):
        begin, end = ends[k - 1] if k else 0, ends[k]
        visible = [begin <= i < end for i in range(len(traces))]
        steps.append({"label": str(frame + result.blobs.first_frame), "method": "update", "args": [{"visible": visible}, layout]})
    active = shown.index(first)
    for i, trace in enumerate(traces):
        trace["visible"] = (ends[active - 1] if active else 0) <= i < ends[active]
    slider = {
        "active": active, "steps": steps, "y": 1.0, "yanchor": "bottom", "pad": {"b": 40, "t": 0},
        "currentvalue": {"prefix": "frame "}, "font": {"size": 10},
    }  # fmt: skip
    layout = {
        "height": _HEIGHT * down + 170,
        "margin": {"l": 20, "r": 20, "t": 150, "b": 40},
        "legend": {"orientation": "h", "y": 0.0, "yanchor": "top"},
        "sliders": [slider],
        "annotations": layouts[active]["annotations"],
    }
    for c in range(count):
        row, column = divmod(c, across)
        axis = {"showgrid": False, "zeroline": False, "showticklabels": False, "constrain": "domain"}
        start = layouts[active]
        ranges = [start[f"{name}axis{_number(c)}.range"] for name in "xy"]
        layout[f"xaxis{_number(c)}"] = {
            **axis,
            "range": ranges[0],
            "domain": [column / across, (column + 0.96) / across],
            "anchor": f"y{_number(c)}",
        }
        layout[f"yaxis{_number(c)}"] = {
            **axis, "range": ranges[1], "domain": [1 - (row + 0.94) / down, 1 - row / down],
            "anchor": f"x{_number(c)}", "scaleanchor": f"x{_number(c)}",
        }  # fmt: skip
    return {"data": traces, "layout": layout}


def _number(c: int) -> str:
    """Of a camera's axes, as Plotly counts them: none, 2, 3."""
    return str(c + 1) if c else ""


def _of_axes(c: int) -> dict[str, str]:
    return {"xref": f"x{_number(c)}", "yref": f"y{_number(c)}", "axref": f"x{_number(c)}", "ayref": f"y{_number(c)}"}


def _picture(result: ViewsLabelling, c: int, frame: int) -> tuple[list[dict[str, Any]], _Extent, list[dict[str, Any]]]:
    """The traces of one camera's image in a frame, the part of it that is shown, and the names beside the person."""
    camera, blobs = result.rig.cameras[c], result.blobs
    # A late camera has this frame's blobs under a later number.
    taken = frame + int(result.late[c])
    cell = taken * len(result.rig) + c
    rows = slice(*blobs.offsets[cell : cell + 2]) if 0 <= taken < len(blobs) else slice(0)
    xy, labels = blobs.xy[rows], result.labels[rows]
    traces: list[dict[str, Any]] = []
    names = np.array(result.body.labels)
    named: list[tuple[Floats, str, str]] = []
    if np.isfinite(result.poses[frame, 0]):
        points, starts, ends = posed_points(result.person, result.poses[frame], result.rotations[frame])
        radii = float(result.poses[frame, :3].mean()) * result.person.arrays.radii
        traces.append(_body([_capsule(camera, *part) for part in zip(starts, ends, radii, strict=True)]))
        seen = camera.project(points)
        links = [(seen[m], blob) for blob, m in zip(xy, labels, strict=True) if m >= 0]
        traces.append(_lines(links))
        # Expected to be hidden, and without a blob.
        hidden = (result.in_view[frame, c] < 0.5) & ~np.isin(np.arange(len(points)), labels[labels >= 0])
        traces.append(_dots(seen[hidden], names[hidden], _LABEL, "circle-open", "hidden by the body"))
        named += [(place, str(name), _HIDDEN) for place, name in zip(seen[hidden], names[hidden], strict=True) if np.isfinite(place[0])]
    labelled, alone = labels >= 0, np.zeros(len(labels), dtype=np.bool_)
    # Labels of one camera rest on the body; they get a colour of their own.
    alone[labelled] = result.views[frame, labels[labelled]] == 1
    several = labelled & ~alone
    traces.append(_dots(xy[several], names[labels[several]], _LABEL, "circle", "labelled"))
    traces.append(_dots(xy[alone], names[labels[alone]], _ONE, "circle", "labelled, this camera alone"))
    named += [(xy[i], str(names[labels[i]]), _ONE if alone[i] else _LABEL) for i in np.nonzero(labelled)[0]]
    # Strays may be anywhere: they must not shrink the person.
    extent = _extent(camera, traces or [_dots(xy, names[:0], _LEFT, "x", "")])
    traces.append(_dots(xy[~labelled], np.full(int((~labelled).sum()), ""), _LEFT, "x", "no label"))
    return traces, extent, _names(named, extent)


def _extent(camera: Camera, traces: list[dict[str, Any]]) -> _Extent:
    """px, left, right, top and bottom of the part of the image around the person: what is drawn but strays, and room for the names."""
    x = [value for trace in traces for value in trace["x"] if value is not None]
    y = [value for trace in traces for value in trace["y"] if value is not None]
    if not x:
        width, height = camera.size or (2 * camera.centre[0], 2 * camera.centre[1])
        return 0.0, float(width), 0.0, float(height)
    margin = 0.05 * max(max(y) - min(y), max(x) - min(x), 1.0)
    top, bottom = min(y) - margin, max(y) + margin
    beside = _NAME_WIDTH * (bottom - top) / _HEIGHT
    return min(x) - margin - beside, max(x) + margin + beside, top, bottom


def _names(named: list[tuple[Floats, str, str]], extent: _Extent) -> list[dict[str, Any]]:
    """The markers' names in two columns beside the person, each with a line to its blob: none covers another."""
    left, right, top, bottom = extent
    unit = (bottom - top) / _HEIGHT
    # Inside the picture; blobs of strange labels far off are not named.
    named = sorted((one for one in named if top <= one[0][1] <= bottom and left <= one[0][0] <= right), key=lambda one: one[0][0])
    found = []
    for column, side, anchor in (
        (named[: len(named) // 2], left + _NAME_WIDTH * unit, "right"),
        (named[len(named) // 2 :], right - _NAME_WIDTH * unit, "left"),
    ):
        column = sorted(column, key=lambda one: one[0][1])
        for (place, name, colour), height in zip(
            column, _spread([float(p[1]) for p, _, _ in column], _LINE * unit, top, bottom), strict=True
        ):
            found.append(
                {
                    "text": name, "x": float(place[0]), "y": float(place[1]), "ax": side, "ay": height, "xanchor": anchor, "arrowhead": 0,
                    "arrowwidth": 0.7, "arrowcolor": colour, "font": {"size": 10, "color": colour}, "standoff": 4,
                }
            )  # fmt: skip
    return found


def _spread(heights: list[float], least: float, top: float, bottom: float) -> list[float]:
    """Ascending heights, moved to be `least` apart and between top and bottom; evenly spread where there is too little room for that."""
    count = len(heights)
    if count * least > bottom - top:
        return np.linspace(top, bottom, count).tolist() if count > 1 else heights
    out: list[float] = []
    for height in heights:
        out.append(max(height, out[-1] + least if out else top + least / 2))
    limit = bottom - least / 2
    for i in range(count - 1, -1, -1):
        out[i] = min(out[i], limit)
        limit = out[i] - least
    return out


def _capsule(camera: Camera, start: Floats, end: Floats, radii: Floats) -> Floats:
    """(n, 2) px, the closed outline of a capsule in an image: the hull of the circles at its ends."""
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
    return np.round(np.concatenate([outline, outline[:1]]), 1)


def _body(outlines: list[Floats]) -> dict[str, Any]:
    """The body's capsules as one trace."""
    x = [value for outline in outlines for value in [*outline[:, 0].tolist(), None]]
    y = [value for outline in outlines for value in [*outline[:, 1].tolist(), None]]
    shape: dict[str, Any] = {"fill": "toself", "fillcolor": _BODY, "hoverinfo": "skip", "showlegend": False}
    return line(x, y, line={"color": "rgba(11, 85, 99, 0.4)", "width": 1}, **shape)


def _lines(links: list[tuple[Floats, Floats]]) -> dict[str, Any]:
    """From where the body has its markers to their blobs."""
    x = [value for one, other in links for value in (float(one[0]), float(other[0]), None)]
    y = [value for one, other in links for value in (float(one[1]), float(other[1]), None)]
    return line(x, y, "from the body to the blob", line={"color": "#d9480f", "width": 1.5})


def _dots(xy: Floats, names: np.ndarray, colour: str, symbol: str, what: str) -> dict[str, Any]:
    there = np.isfinite(xy[:, 0])
    text: dict[str, Any] = {"text": [str(name) for name in names[there]] if len(names) == len(xy) else [], "hoverinfo": "text"}
    marker = {"color": colour, "symbol": symbol, "size": 7, "line": {"width": 1.5, "color": colour}}
    return line(xy[there, 0].tolist(), xy[there, 1].tolist(), what, mode="markers", marker=marker, **text)
