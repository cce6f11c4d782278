"""Numbers in; Plotly figures out, as plain dicts of `data` and `layout`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from asterism.recording import Floats

Figure = dict[str, Any]

PALETTE = ("#0f7b8a", "#d1495b", "#e09f3e", "#5b5f97", "#3a9d5d", "#8d5a97", "#64748b", "#b5651d")
MOST_NINES = 4.0
COLUMNS = 600
"""The most columns of a picture over time; longer recordings are drawn by blocks of frames."""


def figure(data: Sequence[Mapping[str, Any]], height: int, **layout: Any) -> Figure:
    """A figure in the style of all pages; `layout` adds to it or overrides it."""
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
    for name in {"xaxis", "yaxis", *(key for key in layout if key.startswith(("xaxis", "yaxis")))}:
        style[name] = {**axis, **layout.pop(name, {})}
    return {"data": [dict(trace) for trace in data], "layout": {**style, **layout}}


def frames_per_column(frames: int) -> int:
    """How many frames one column of a picture over time stands for."""
    return max(1, -(-frames // COLUMNS))


def matrix(names: Sequence[str], shares: Floats) -> Figure:
    """(M, M) shares as a picture, rows by columns; without the diagonal. The colour shows the root of the share."""
    off = np.array(shares, dtype=np.float64)
    np.fill_diagonal(off, np.nan)
    highest = max(float(np.nanmax(off, initial=0.0)), 1e-4)
    small = len(names) > 20
    trace = {
        "type": "heatmap",
        "x": list(names),
        "y": list(names),
        "z": np.round(np.sqrt(off), 5),
        "customdata": np.round(100 * off, 3),
        "zmin": 0,
        "zmax": float(np.sqrt(highest)),
        "colorscale": [[0, "#ffffff"], [0.02, "#fdf3e4"], [0.35, "#f6c177"], [0.7, "#dd6b4d"], [1, "#7d1a2d"]],
        "hovertemplate": "%{y} could be %{x} in %{customdata} % of the frames<extra></extra>",
        "xgap": 1,
        "ygap": 1,
        "colorbar": {
            "tickvals": [float(np.sqrt(highest * part)) for part in (0, 0.1, 0.25, 0.5, 1)],
            "ticktext": [f"{100 * highest * part:.3g} %" for part in (0, 0.1, 0.25, 0.5, 1)],
            "thickness": 12,
            "outlinewidth": 0,
        },
    }
    side = {"showgrid": False, "dtick": 1, "type": "category", "tickfont": {"size": 9 if small else 11}}
    return figure(
        [trace],
        height=150 + (14 if small else 24) * len(names),
        xaxis={**side, "title": {"text": "could be taken for"}, "tickangle": -90},
        yaxis={**side, "title": {"text": "the point of"}, "autorange": "reversed"},
        plot_bgcolor="#eef1f6",
    )


def bars(names: Sequence[str], shares: Floats, what: str) -> Figure:
    """One horizontal bar per name, shares 0..1 as percent."""
    trace = {
        "type": "bar",
        "orientation": "h",
        "y": list(names),
        "x": 100 * np.asarray(shares),
        "marker": {"color": "#0f7b8a"},
        "hovertemplate": "%{y}: %{x:.3f} %<extra></extra>",
    }
    return figure(
        [trace],
        height=90 + 20 * len(names),
        bargap=0.25,
        xaxis={"title": {"text": what}, "ticksuffix": " %", "rangemode": "tozero"},
        yaxis={"autorange": "reversed", "dtick": 1, "showgrid": False, "type": "category", "tickfont": {"size": 11}},
    )


def curves(lines: Mapping[str, tuple[Any, Any]], x: str, y: str, faint: Sequence[str] = ()) -> Figure:
    """Named lines of (x, share); shares are drawn in percent, and the lines named in `faint` are thin and grey."""
    data = []
    thick = [name for name in lines if name not in faint]
    for name, (at, shares) in lines.items():
        thin = name in faint
        data.append(
            {
                "type": "scatter",
                "mode": "lines" if thin else "lines+markers",
                "name": name,
                "x": list(at),
                "y": 100 * np.asarray(shares, dtype=np.float64),
                "line": {"width": 1, "color": "#c3ccd9"} if thin else {"width": 3, "color": PALETTE[thick.index(name) % len(PALETTE)]},
                "marker": {"size": 8},
                "showlegend": not thin,
                "hovertemplate": name + ": %{y:.3f} % at %{x}<extra></extra>",
            }
        )
    return figure(
        data,
        height=360,
        xaxis={"title": {"text": x}, "dtick": 1},
        yaxis={"title": {"text": y}, "ticksuffix": " %", "rangemode": "normal" if faint else "tozero"},
    )


def effort(sizes: Sequence[tuple[int, float, float]]) -> Figure:
    """The accuracy of solvers and, on a logarithmic axis, the evaluations that they take, by the number of their weak classifiers."""
    counts, accuracies, evaluations = zip(*sizes, strict=True) if sizes else ((), (), ())
    accuracy = {"name": "accuracy", "y": 100 * np.asarray(accuracies), "hovertemplate": "%{x} classifiers: %{y:.3f} %<extra></extra>"}
    cost = {"name": "evaluations", "y": list(evaluations), "yaxis": "y2", "hovertemplate": "%{x} classifiers: %{y:.0f}<extra></extra>"}
    return figure(
        [{"type": "scatter", "mode": "lines+markers", "x": list(counts), **line} for line in (accuracy, cost)],
        height=360,
        xaxis={"title": {"text": "weak classifiers"}},
        yaxis={"title": {"text": "wrong labellings rejected"}, "ticksuffix": " %"},
        yaxis2={
            "title": {"text": "feature evaluations"},
            "overlaying": "y",
            "side": "right",
            "showgrid": False,
            **_logarithmic(evaluations),
        },
    )


def _logarithmic(values: Sequence[float]) -> dict[str, Any]:
    """A logarithmic axis over positive values, its ticks written out: Plotly shows only their first digits."""
    logs = np.log10([value for value in values if value > 0] or [1.0])
    low, high = float(logs.min()) - 0.1, float(logs.max()) + 0.1
    ticks = [digit * 10.0**power for power in range(int(np.floor(low)), int(np.ceil(high))) for digit in (1, 2, 5)]
    return {"type": "log", "range": [low, high], "tickvals": ticks, "ticktext": [f"{tick:,g}" for tick in ticks]}


def trade_off(lines: Mapping[str, tuple[Any, Any]]) -> Figure:
    """Named lines of (false assignments, false occlusions), as shares; both axes in percent."""
    data = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": name,
            "x": 100 * np.asarray(wrong, dtype=np.float64),
            "y": 100 * np.asarray(missed, dtype=np.float64),
            "line": {"color": PALETTE[number % len(PALETTE)]},
            "hovertemplate": name + ": %{x:.3f} % wrong, %{y:.2f} % of the nulls missed<extra></extra>",
        }
        for number, (name, (wrong, missed)) in enumerate(lines.items())
    ]
    axes = {"xaxis": "false assignments", "yaxis": "false occlusions"}
    return figure(data, height=360, **{axis: {"title": {"text": what}, "ticksuffix": " %"} for axis, what in axes.items()})


def reliability(lines: Mapping[str, Sequence[tuple[float, float, int]]], drawn: Sequence[str]) -> Figure:
    """Confidence against the share of right labels, one line per condition, on a scale of nines; below, the number of labels.

    lines  name -> (mean confidence, share right, count) per bin
    drawn  the lines that are drawn at first; a click on the legend shows the others
    """
    ticks = (0.0, 0.5, 0.9, 0.99, 0.999, 0.9999)
    diagonal = {
        "type": "scatter",
        "mode": "lines",
        "x": [0, MOST_NINES],
        "y": [0, MOST_NINES],
        "line": {"color": "#9aa4b5", "dash": "dot", "width": 2},
        "name": "perfectly calibrated",
        "hoverinfo": "skip",
    }
    colors = dict(zip([*drawn, *(name for name in lines if name not in drawn)], PALETTE * len(lines), strict=False))
    data: list[Mapping[str, Any]] = [diagonal]
    for name, bins in lines.items():
        data += _reliability_traces(name, bins, colors[name], name in drawn)
    scale = {
        "tickvals": [_nines(tick) for tick in ticks],
        "ticktext": ["0 %", "50 %", "90 %", "99 %", "99.9 %", "≥ 99.99 %"],
        "range": [-0.1, MOST_NINES + 0.1],
    }
    return figure(
        data,
        height=560,
        xaxis={**scale, "title": {"text": "confidence of the label"}, "anchor": "y2"},
        yaxis={**scale, "title": {"text": "labels that were right"}, "domain": [0.36, 1]},
        yaxis2={"title": {"text": "number of labels"}, "type": "log", "dtick": 1, "domain": [0, 0.26]},
    )


def _reliability_traces(name: str, bins: Sequence[tuple[float, float, int]], color: str, drawn: bool) -> list[dict[str, Any]]:
    """One condition's line of shares, and below it the line of counts; bins without labels are left out."""
    kept = [(float(confidence), float(right), int(n)) for confidence, right, n in bins if n > 0]
    shared: dict[str, Any] = {
        "name": name,
        "x": [_nines(confidence) for confidence, _, _ in kept],
        "legendgroup": name,
        "visible": True if drawn else "legendonly",
        "text": [f"confidence {100 * confidence:.4g} %, right {100 * right:.4g} % of {n:,}" for confidence, right, n in kept],
        "hovertemplate": name + ": %{text}<extra></extra>",
        "type": "scatter",
        "mode": "lines+markers",
    }
    shares = {"y": [_nines(right) for _, right, _ in kept], "line": {"color": color, "width": 2}, "marker": {"size": 7}}
    counts = {"y": [n for _, _, n in kept], "line": {"color": color, "width": 1}, "marker": {"size": 5}, "yaxis": "y2", "showlegend": False}
    return [{**shared, **shares}, {**shared, **counts}]


def _nines(share: float) -> float:
    return float(np.clip(-np.log10(max(1.0 - share, 10.0**-MOST_NINES)), 0.0, MOST_NINES))
