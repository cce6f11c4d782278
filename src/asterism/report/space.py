"""Cameras in; the pictures of a rig out: where it stands, and what it measures slice by slice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from asterism.cameras import Camera, Rig
from asterism.cameras.accuracy import RigMap, Volume
from asterism.geometry import z_up_rotation
from asterism.recording import Floats, as_vertical
from asterism.report.figures import PALETTE, Figure, cell_axes, colour_bar, figure, in_space, titled

LAYERS = 4
"""So many slices through a volume."""


def rig_in_space(
    rig: Rig, volume: Volume | None = None, points: Floats | None = None, values: Sequence[float] | None = None, what: str = ""
) -> Figure:
    """The rig in 3D, up is up: each camera as a pyramid that opens where it looks, the volume as a box, points (N, 3) m if there are any.

    values  one per point, drawn as its shade; what: their name and unit
    """
    # Up is up on the page, whatever axis the laboratory calls up.
    turn = z_up_rotation(as_vertical("z") if rig.vertical is None else rig.vertical)
    eyes = np.stack([camera.position for camera in rig])
    # Pyramids grow with the rig, so that they are seen in a hall.
    reach = float(np.linalg.norm(eyes.max(axis=0) - eyes.min(axis=0))) or 1.0
    data: list[Mapping[str, Any]] = []
    edges = [path for camera in rig for path in _pyramid(camera, 0.06 * reach)]
    data.append(_lines(edges, turn, PALETTE[0], 3))
    if volume is not None:
        data.append(_lines(_box(volume), turn, "#9aa4b5", 2))
    named: dict[str, Any] = {
        "text": list(rig.names),
        "textposition": "top center",
        "textfont": {"size": 11},
        "mode": "markers+text",
        "showlegend": False,
    }
    place = "%{x:.2f}, %{y:.2f}, %{z:.2f} m"
    hover = "%{text}: " + place + "<extra></extra>"
    data.append(in_space(eyes @ turn.T, marker={"size": 3, "color": PALETTE[0]}, hovertemplate=hover, **named))
    if points is not None and len(points):
        marker: dict[str, Any] = {"size": 3, "color": PALETTE[2]}
        if values is not None:
            marker |= {"color": np.round(np.asarray(values, dtype=np.float64), 4), "colorscale": "Viridis", "colorbar": colour_bar(what)}
        hover = place + ("" if values is None else ": %{marker.color:.3r}") + "<extra></extra>"
        data.append(in_space(np.asarray(points) @ turn.T, marker=marker, hovertemplate=hover, showlegend=False))
    axis = titled("", backgroundcolor="#f7f9fc", gridcolor="#dfe5ee", showspikes=False, ticksuffix=" m", nticks=6)
    view = {"eye": {"x": 1.27, "y": -1.55, "z": 1.09}, "center": {"x": 0, "y": 0, "z": -0.12}}
    scene = {"aspectmode": "data", "xaxis": axis, "yaxis": axis, "zaxis": axis, "camera": view}
    return figure(data, height=520, scene=scene)


def slices(result: RigMap, values: Floats, vertical: Floats, what: str, shades: Sequence[Sequence[Any]], low: float, high: float) -> Figure:
    """Level slices through a map, from the lowest up: values (N,) of its places as shades from `low` to `high`."""
    # Level slices: people move along the floor.
    axis = int(np.argmax(np.abs(vertical)))
    across, along = [i for i in range(3) if i != axis]
    grid = np.moveaxis(result.grid(values), axis, 0)  # height, across, along
    count = len(result.axes[axis])
    # From the lowest up, also where the vertical points down the axis.
    layers = np.unique(np.linspace(0, count - 1, min(LAYERS, count)).round().astype(np.int64))
    layers = layers if vertical[axis] > 0 else layers[::-1]
    wide, deep = result.volume.size[across], result.volume.size[along]
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {}
    for n, layer in enumerate(layers):
        left, right = (n + 0.05) / len(layers), (n + 0.91) / len(layers)
        side = {"showgrid": False, "zeroline": False, "ticksuffix": " m", "nticks": 4, "tickfont": {"size": 10}, "constrain": "domain"}
        # narrow maps stand close beside each other: few numbers below them, or these touch
        level = {**side, "nticks": 3, "showticksuffix": "last"}
        height = float(result.axes[axis][layer] * np.sign(vertical[axis]))
        title = {"text": f"{height:.1f} m high", "font": {"size": 12}}
        up = {**side, "scaleanchor": "x" + ("" if n == 0 else str(n + 1)), "showticklabels": n == 0}
        axes, sides = cell_axes(n, {**level, "title": title, "domain": [left, right]}, up)
        layout |= sides
        data.append(
            {
                "type": "heatmap", "x": np.round(result.axes[across], 3), "y": np.round(result.axes[along], 3),
                "z": np.round(grid[layer].T, 4), "zmin": low, "zmax": high, "colorscale": list(shades), "colorbar": colour_bar(what),
                "showscale": n == len(layers) - 1, "hovertemplate": "%{x:.2f}, %{y:.2f} m: %{z:.3r} " + what + "<extra></extra>", **axes,
            }
        )  # fmt: skip
    drawn = int(np.clip(90 + 900 / len(layers) * deep / wide, 220, 460))
    return figure(data, height=drawn, plot_bgcolor="#eef1f6", **layout)


def _pyramid(camera: Camera, length: float) -> list[Floats]:
    """The lines of a camera's field of view, `length` m deep; 40 degrees, half as deep, where the image size is not known."""
    width, height = camera.size or (0.7 * camera.focal[0], 0.7 * camera.focal[1])
    # Without an image size the field of view is a guess, drawn short.
    depth = length if camera.size else 0.5 * length
    x, y = 0.5 * width / camera.focal[0], 0.5 * height / camera.focal[1]
    corners = depth * np.array([(-x, -y, 1.0), (x, -y, 1.0), (x, y, 1.0), (-x, y, 1.0)]) @ camera.rotation + camera.position
    return [*(np.stack([camera.position, corner]) for corner in corners), np.vstack([corners, corners[:1]])]


def _box(volume: Volume) -> list[Floats]:
    low, high = volume.low, volume.high
    # The twelve edges join corners that differ in one coordinate.
    corners = np.array([[(low, high)[bit][i] for i, bit in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])
    return [np.stack([corners[a], corners[b]]) for a in range(8) for b in range(a) if np.isclose(corners[a], corners[b]).sum() == 2]


def _lines(paths: Sequence[Floats], turn: Floats, color: str, width: int) -> dict[str, Any]:
    xyz: list[list[float | None]] = []
    for path in paths:
        xyz += [[round(float(v), 3) for v in point] for point in path @ turn.T]
        # A gap between the paths: one trace draws them all.
        xyz.append([None, None, None])
    x, y, z = zip(*xyz, strict=True)
    line = {"color": color, "width": width}
    return {"type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "line": line, "hoverinfo": "skip", "showlegend": False}
