"""Numbers in; Plotly figures out, as plain dicts of `data` and `layout`."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Floats
from asterism.recording.display import significant

Figure = dict[str, Any]

PALETTE = ("#0f7b8a", "#d1495b", "#e09f3e", "#5b5f97", "#3a9d5d", "#8d5a97", "#64748b", "#b5651d")
SIDES: dict[str, dict[str, str]] = {"left": {"color": "#d1344b"}, "right": {"color": "#2563c9", "dash": "dash"}}
"""How lines of each side are drawn: left red, right blue, as gait laboratories do; dashes tell them without colours. The player has the
same colours."""
MOST_NINES = 4.0
COLUMNS = 600
"""The most columns of a picture over time; longer recordings are drawn by blocks of frames."""
_JPEG_QUALITY = 80
"""Of 100, which JPEG counts its quality by."""


def figure(data: Sequence[Mapping[str, Any]], height: int, **layout: Any) -> Figure:
    """A figure in the style of all pages; `layout` adds to it or overrides it."""
    # Fixed ranges: a wheel over a figure scrolls the page; figures that zoom say so themselves.
    axis = {"gridcolor": "#e6ebf2", "zerolinecolor": "#cfd8e4", "linecolor": "#cfd8e4", "automargin": True, "fixedrange": True}
    style: Figure = {
        "height": height,
        "margin": {"l": 12, "r": 12, "t": 12, "b": 12},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "font": {"family": "system-ui, -apple-system, Segoe UI, Roboto, sans-serif", "size": 13, "color": "#16213a"},
        "colorway": list(PALETTE),
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "hoverlabel": {"bgcolor": "#ffffff", "bordercolor": "#cfd8e4"},
    }
    # Each axis gets the style, also the second and later ones that only `layout` names.
    for name in {"xaxis", "yaxis", *(key for key in layout if key.startswith(("xaxis", "yaxis")))}:
        style[name] = {**axis, **layout.pop(name, {})}
    return {"data": [dict(trace) for trace in data], "layout": {**style, **layout}}


def titled(text: str, **more: Any) -> dict[str, Any]:
    """An axis with a title; `more` adds to it."""
    return {"title": {"text": text}, **more}


def line(x: Any, y: Any, name: str = "", hover: str = "", **more: Any) -> dict[str, Any]:
    """A line through points; `name` in the legend, `hover` what the pointer shows. `more` adds to it or overrides it."""
    named = {"name": name} if name else {}
    shown = {"hovertemplate": hover + "<extra></extra>"} if hover else {}
    return {"type": "scatter", "mode": "lines", "x": x, "y": y, **named, **shown, **more}


def band(x: Any, low: Any, high: Any, shade: str, where: Mapping[str, Any], named: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The two edges of a band, the space between them filled; `where`: the axes, `named`: what the legend shows of it."""
    edge = {"line": {"width": 0}, "hoverinfo": "skip", **where}
    return [line(x, low, showlegend=False, **edge), line(x, high, fill="tonexty", fillcolor=shade, **edge, **named)]


def in_space(xyz: Floats, digits: int = 3, **more: Any) -> dict[str, Any]:
    """Points (N, 3) m in 3D, rounded to so many digits."""
    x, y, z = np.round(np.asarray(xyz, dtype=np.float64).reshape(-1, 3).T, digits)
    return {"type": "scatter3d", "mode": "markers", "x": x, "y": y, "z": z, **more}


def colour_bar(text: str = "", **more: Any) -> dict[str, Any]:
    """The scale beside a shaded picture, named by its unit."""
    title = {"title": {"text": text, "side": "right"}} if text else {}
    return {**title, "thickness": 12, "outlinewidth": 0, **more}


def cell_axes(number: int, x: Mapping[str, Any], y: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, Any]]:
    """One of several small pictures in a figure, from 0: the axes that its traces name, and these axes' layout."""
    # Plotly calls the first axis x and the second x2.
    suffix = "" if number == 0 else str(number + 1)
    layout = {f"xaxis{suffix}": {"anchor": f"y{suffix}", **x}, f"yaxis{suffix}": {"anchor": f"x{suffix}", **y}}
    return {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}, layout


def picture(image: NDArray[np.uint8], widest: int) -> str:
    """An image (h, w) grey or (h, w, 3) blue, green, red as a JPEG in a data address, at most `widest` px wide."""
    import cv2

    # A page of many cameras stays small; enlarging would show nothing more.
    scale = min(1.0, widest / max(image.shape[1], 1))
    if scale < 1:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(np.asarray(packed).tobytes()).decode()


def behind(source: str, size: tuple[int, int], axes: Mapping[str, str]) -> dict[str, Any]:
    """A picture of size (w, h) px behind the traces of these axes; pixel (0, 0) has its middle at (0, 0)."""
    place = {"xref": axes["xaxis"], "yref": axes["yaxis"], "x": -0.5, "y": -0.5, "sizex": size[0], "sizey": size[1]}
    return {"source": source, **place, "sizing": "stretch", "layer": "below"}


def frames_per_column(frames: int) -> int:
    """How many frames one column of a picture over time stands for."""
    return max(1, -(-frames // COLUMNS))


def matrix(names: Sequence[str], shares: Floats) -> Figure:
    """(M, M) shares as a picture, rows by columns; without the diagonal. The colour shows the root of the share."""
    # The diagonal is right labels, which would outshine the rest.
    off = np.array(shares, dtype=np.float64)
    np.fill_diagonal(off, np.nan)
    # A floor for the scale: a set without confusion must not show noise in full colour.
    highest = max(float(np.nanmax(off, initial=0.0)), 1e-4)
    small = len(names) > 20
    # The colour is the root of the share, so the scale is labelled with the shares themselves.
    parts = [highest * part for part in (0, 0.1, 0.25, 0.5, 1)]
    bar = colour_bar(tickvals=[float(np.sqrt(part)) for part in parts], ticktext=[f"{significant(100 * part, 3)} %" for part in parts])
    trace = {
        "type": "heatmap", "x": list(names), "y": list(names), "z": np.round(np.sqrt(off), 5), "customdata": np.round(100 * off, 3),
        "zmin": 0, "zmax": float(np.sqrt(highest)), "xgap": 1, "ygap": 1, "colorbar": bar,
        "colorscale": [[0, "#ffffff"], [0.02, "#fdf3e4"], [0.35, "#f6c177"], [0.7, "#dd6b4d"], [1, "#7d1a2d"]],
        "hovertemplate": "%{y} could be %{x} in %{customdata} % of the frames<extra></extra>",
    }  # fmt: skip
    side = {"showgrid": False, "dtick": 1, "type": "category", "tickfont": {"size": 9 if small else 11}}
    across, up = titled("could be taken for", **side, tickangle=-90), titled("the point of", **side, autorange="reversed")
    return figure([trace], height=150 + (14 if small else 24) * len(names), xaxis=across, yaxis=up, plot_bgcolor="#eef1f6")


def bars(names: Sequence[str], shares: Floats, what: str) -> Figure:
    """One horizontal bar per name, shares 0..1 as percent."""
    trace = {"type": "bar", "orientation": "h", "y": list(names), "x": 100 * np.asarray(shares), "marker": {"color": PALETTE[0]}}
    trace["hovertemplate"] = "%{y}: %{x:.3f} %<extra></extra>"
    side = {"autorange": "reversed", "dtick": 1, "showgrid": False, "type": "category", "tickfont": {"size": 11}}
    across = titled(what, ticksuffix=" %", rangemode="tozero")
    return figure([trace], height=90 + 20 * len(names), bargap=0.25, xaxis=across, yaxis=side)


def curves(lines: Mapping[str, tuple[Any, Any]], x: str, y: str, faint: Sequence[str] = ()) -> Figure:
    """Named lines of (x, share); shares are drawn in percent, and the lines named in `faint` are thin and grey."""
    data = []
    thick = [name for name in lines if name not in faint]
    for name, (at, shares) in lines.items():
        thin = name in faint
        # Single markers are grey: the eye shall find the mean first.
        style = {"width": 1, "color": "#c3ccd9"} if thin else {"width": 3, "color": PALETTE[thick.index(name) % len(PALETTE)]}
        drawn = line(list(at), 100 * np.asarray(shares, dtype=np.float64), name, name + ": %{y:.3f} % at %{x}", line=style)
        data.append({**drawn, "mode": "lines" if thin else "lines+markers", "marker": {"size": 8}, "showlegend": not thin})
    up = titled(y, ticksuffix=" %", rangemode="normal" if faint else "tozero")
    return figure(data, height=360, xaxis=titled(x, dtick=1), yaxis=up)


def effort(sizes: Sequence[tuple[int, float, float]]) -> Figure:
    """The accuracy of solvers and, on a logarithmic axis, the evaluations that they take, by the number of their weak classifiers."""
    counts, accuracies, evaluations = zip(*sizes, strict=True) if sizes else ((), (), ())
    said = "%{x} classifiers: %{y:"
    data = [
        line(list(counts), 100 * np.asarray(accuracies), "accuracy", said + ".3f} %", mode="lines+markers"),
        line(list(counts), list(evaluations), "evaluations", said + ".0f}", mode="lines+markers", yaxis="y2"),
    ]
    second = titled("feature evaluations", overlaying="y", side="right", showgrid=False, **_logarithmic(evaluations))
    up = titled("wrong labellings rejected", ticksuffix=" %")
    return figure(data, height=360, xaxis=titled("weak classifiers"), yaxis=up, yaxis2=second)


def _logarithmic(values: Sequence[float]) -> dict[str, Any]:
    """A logarithmic axis over positive values, its ticks written out: Plotly shows only their first digits."""
    # A tenth of a decade beyond the points, so that none lies on the frame.
    logs = np.log10([value for value in values if value > 0] or [1.0])
    low, high = float(logs.min()) - 0.1, float(logs.max()) + 0.1
    ticks = [digit * 10.0**power for power in range(int(np.floor(low)), int(np.ceil(high))) for digit in (1, 2, 5)]
    return {"type": "log", "range": [low, high], "tickvals": ticks, "ticktext": [f"{tick:,g}" for tick in ticks]}


def trade_off(lines: Mapping[str, tuple[Any, Any]]) -> Figure:
    """Named lines of (wrong labels of those given, markers in view of those without a label), as shares; both axes in percent."""
    data = []
    for number, (name, (wrong, missed)) in enumerate(lines.items()):
        x, y = (100 * np.asarray(share, dtype=np.float64) for share in (wrong, missed))
        hover = name + ": %{x:.3f} % wrong, %{y:.2f} % of the markers without a label in view"
        data.append(line(x, y, name, hover, mode="lines+markers", line={"color": PALETTE[number % len(PALETTE)]}))
    axes = {
        "xaxis": titled("wrong, of the labels given", ticksuffix=" %"),
        "yaxis": titled("in view, of those without", ticksuffix=" %"),
    }
    return figure(data, height=360, **axes)


def reliability(lines: Mapping[str, Sequence[tuple[float, float, int]]], drawn: Sequence[str]) -> Figure:
    """Confidence against the share of right labels, one line per condition, on a scale of nines; below, the number of labels.

    lines  name -> (mean confidence, share right, count) per bin
    drawn  the lines that are drawn at first; a click on the legend shows the others
    """
    ends, dotted = [0, MOST_NINES], {"color": "#9aa4b5", "dash": "dot", "width": 2}
    # The lines drawn at first take the first colours, which differ most.
    colors = dict(zip([*drawn, *(name for name in lines if name not in drawn)], PALETTE * len(lines), strict=False))
    data: list[Mapping[str, Any]] = [line(ends, ends, "perfectly calibrated", line=dotted, hoverinfo="skip")]
    for name, bins in lines.items():
        data += _reliability_traces(name, bins, colors[name], name in drawn)
    scale = {
        "tickvals": nines((0.0, 0.5, 0.9, 0.99, 0.999, 0.9999)),
        "ticktext": ["0 %", "50 %", "90 %", "99 %", "99.9 %", "≥ 99.99 %"],
        "range": [-0.1, MOST_NINES + 0.1],
    }
    across = titled("confidence of the label", **scale, anchor="y2")
    up = titled("labels that were right", **scale, domain=[0.36, 1])
    below = titled("number of labels", type="log", dtick=1, domain=[0, 0.26])
    return figure(data, height=560, xaxis=across, yaxis=up, yaxis2=below)


def _reliability_traces(name: str, bins: Sequence[tuple[float, float, int]], color: str, drawn: bool) -> list[dict[str, Any]]:
    """One condition's line of shares, and below it the line of counts; bins without labels are left out."""
    # A bin without labels has no share; drawn as 0 it would look like an error.
    kept = [(float(confidence), float(right), int(n)) for confidence, right, n in bins if n > 0]
    text = [
        f"confidence {significant(100 * confidence, 4)} %, right {significant(100 * right, 4)} % of {n:,}" for confidence, right, n in kept
    ]
    shared = {"legendgroup": name, "visible": True if drawn else "legendonly", "text": text, "mode": "lines+markers"}

    def drawn_line(y: Any, width: int, size: int, **more: Any) -> dict[str, Any]:
        style = {"line": {"color": color, "width": width}, "marker": {"size": size}}
        return line(nines([confidence for confidence, _, _ in kept]), y, name, name + ": %{text}", **shared, **style, **more)

    shares = drawn_line(nines([right for _, right, _ in kept]), 2, 7)
    return [shares, drawn_line([n for _, _, n in kept], 1, 5, yaxis="y2", showlegend=False)]


def nines(shares: Any) -> Floats:
    """Shares on a scale on which each step means ten times fewer errors: 0.9 is 1, 0.99 is 2; from 0 to `MOST_NINES`."""
    return np.clip(-np.log10(np.maximum(1.0 - np.asarray(shares, dtype=np.float64), 10.0**-MOST_NINES)), 0.0, MOST_NINES)
