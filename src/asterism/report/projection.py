"""Points of one frame in; a figure that shows them from the side and from the front, with their names, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.recording import Clouds, Floats
from asterism.report import figures

_SECONDS_AROUND = 0.5
_MIN_SPEED = 0.2
_MARGIN = 0.12
_LEAST_HALF = 0.6


@dataclass(frozen=True)
class Dots:
    """Points with one style and legend entry: xyz (N, 3) m in the recording's axes, one text each; `path` joins them by a line."""

    name: str
    xyz: Floats
    texts: Sequence[str]
    color: str
    size: int = 8
    ring: bool = False
    path: bool = False


def travel(clouds: Clouds, frame: int) -> Floats:
    """(3,) the horizontal unit vector in which the cloud travels around a frame; where it does not, the one along which it is thinnest."""
    reach = max(1, round(_SECONDS_AROUND * clouds.rate))
    some = [t for t in range(max(0, frame - reach), min(len(clouds), frame + reach + 1)) if clouds.counts[t]]
    up = clouds.vertical
    if len(some) >= 2:
        path = np.median(clouds[some[-1]], axis=0) - np.median(clouds[some[0]], axis=0)
        path = path - up * (path @ up)
        if np.linalg.norm(path) * clouds.rate >= _MIN_SPEED * (some[-1] - some[0]):
            return path / np.linalg.norm(path)
    level = np.linalg.svd(np.stack([up, np.zeros(3), np.zeros(3)]))[2][1:]
    flat = (clouds[frame] - clouds[frame].mean(axis=0)) @ level.T if clouds.counts[frame] else np.zeros((1, 2))
    return np.linalg.svd(flat)[2][1] @ level


def two_views(groups: Sequence[Dots], vertical: Floats, ahead: Floats, height: int = 420) -> figures.Figure:
    """A figure with two views: left from the subject's right side, so that it walks to the right; right from the front.

    Both views have one scale, in metres. The origin is the middle of all points on the floor plan, at the height of the lowest.
    """
    left = np.cross(vertical, ahead)
    every = np.concatenate([dots.xyz for dots in groups if len(dots.xyz)] or [np.zeros((1, 3))])
    low, high = (every @ vertical).min(), (every @ vertical).max()
    data = []
    for axis, name in ((ahead, ""), (left, "2")):
        middle = ((every @ axis).min() + (every @ axis).max()) / 2
        for dots in groups:
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines" if dots.path else "markers+text" if any(dots.texts) else "markers",
                    "x": np.round(dots.xyz @ axis - middle, 4),
                    "y": np.round(dots.xyz @ vertical - low, 4),
                    "text": list(dots.texts),
                    "textposition": _sides(dots.xyz @ axis - middle, dots.xyz @ vertical, alternate=name == ""),
                    "textfont": {"size": 11, "color": dots.color},
                    "hovertemplate": "%{text}<extra></extra>" if any(dots.texts) else "<extra></extra>",
                    "name": dots.name,
                    "legendgroup": dots.name,
                    "showlegend": name == "" and bool(dots.name) and len(dots.xyz) > 0,
                    "line": {"color": dots.color, "width": 2},
                    "marker": {
                        "color": dots.color,
                        "size": dots.size,
                        "symbol": "circle-open" if dots.ring else "circle",
                        "line": {"width": 3 if dots.ring else 0},
                    },
                    "xaxis": f"x{name}",
                    "yaxis": f"y{name}",
                }
            )
    half = max(_LEAST_HALF, *(np.ptp(every @ axis) / 2 + 2 * _MARGIN for axis in (ahead, left)))
    tall = {"range": [-_MARGIN, high - low + _MARGIN], "ticksuffix": " m", "zeroline": False, "constrain": "domain"}
    wide = {"zeroline": False, "ticksuffix": " m", "range": [-half, half], "dtick": 0.5, "tickangle": 0, "constrain": "domain"}
    return figures.figure(
        data,
        height,
        xaxis={**wide, "domain": [0.0, 0.48], "scaleanchor": "y", "title": {"text": "from the side, walking to the right"}},
        yaxis=tall,
        xaxis2={**wide, "domain": [0.52, 1.0], "scaleanchor": "y2", "anchor": "y2", "title": {"text": "from the front"}},
        yaxis2={**tall, "matches": "y", "anchor": "x2", "showticklabels": False},
    )


def _sides(across: Floats, height: Floats, alternate: bool) -> list[str]:
    """On which side of its point each text is: outwards, or left and right by turns from the top down."""
    to_the_left = np.argsort(np.argsort(-height, kind="stable"), kind="stable") % 2 == 0 if alternate else across < 0
    return ["middle left" if left else "middle right" for left in to_the_left]
