"""Kept figures in; the plots of docs/figures.md out, as SVG in docs/figures/. Needs Matplotlib (`pip install -e ".[dev]"`)."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from benchmarks.figures import Entry

FOLDER = Path(__file__).parents[1] / "docs" / "figures"
TEAL, RED, AMBER, GREY, BLUE = "#0f7b8a", "#d1495b", "#e09f3e", "#8a97a8", "#5b5f97"
METHODS = {
    "whole recording": (TEAL, "whole recording"),
    "frame by frame": (BLUE, "frame by frame"),
    "key poses": (AMBER, "peer: key poses"),
    "tracking": (GREY, "peer: tracking from a labelled first frame"),
}
LOOK = {
    "svg.fonttype": "none",
    "svg.hashsalt": "asterism",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 11,
    "figure.constrained_layout.use": True,
}


def write(entries: Sequence[Entry], folder: Path = FOLDER) -> list[str]:
    """Draw every plot whose rows have been measured; returns their names."""
    values = {entry.row: entry for entry in entries}
    folder.mkdir(exist_ok=True)
    drawn = []
    with plt.rc_context(LOOK):
        for name, draw in PLOTS.items():
            canvas = draw(values)
            if canvas is not None:
                canvas.savefig(folder / f"{name}.svg", metadata={"Date": None})
                plt.close(canvas)
                drawn.append(name)
    return drawn


def occlusions(values: dict[str, Entry]) -> Canvas | None:
    """Labels right and labels wrong, by how many of 15 markers are hidden."""
    conditions = ("1 hidden", "3 hidden", "5 hidden", "3 hidden + 3 ghosts")
    if f"gaps, {conditions[0]}, whole recording: right" not in values:
        return None
    canvas, (right, wrong) = plt.subplots(1, 2, figsize=(9, 3.4))
    for method, (color, name) in METHODS.items():
        shares = [[100 * values[f"gaps, {c}, {method}: {what}"].measured for c in conditions] for what in ("right", "FA")]
        for axes, share in zip((right, wrong), shares, strict=True):
            axes.plot(range(3), share[:3], color=color, marker="o", label=name)
            axes.plot([3.3], share[3:], color=color, marker="D")
    for axes in (right, wrong):
        axes.set_xticks([0, 1, 2, 3.3], ["1", "3", "5", "3 + 3 ghosts"])
        axes.set_xlabel("hidden of 15 markers, at every moment")
        axes.grid(axis="y", alpha=0.3)
    right.set(title="markers in view that are labelled right", ylabel="%", ylim=(60, 101))
    wrong.set(title="labels that are wrong (FA)", ylabel="%")
    wrong.set_yscale("symlog", linthresh=0.1)
    wrong.set_yticks([0, 0.1, 1, 10], ["0", "0.1", "1", "10"])
    wrong.set_ylim(-0.01, 40)
    canvas.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return canvas


def movements(values: dict[str, Entry]) -> Canvas | None:
    """Other people, laboratories and movements: right, without a label, wrong."""
    pattern = re.compile(r"movement, (.*), 3 hidden: right")
    names = [match[1] for row in values if (match := pattern.fullmatch(row))]
    if not names:
        return None
    canvas, axes = plt.subplots(figsize=(9, 0.24 * len(names) + 1.2))
    right, missed = ([100 * values[f"movement, {name}, 3 hidden: {what}"].measured for name in names] for what in ("right", "missed"))
    wrong = [max(0.0, 100 - a - b) for a, b in zip(right, missed, strict=True)]
    places = range(len(names))
    axes.barh(places, right, color=TEAL, label="right")
    axes.barh(places, missed, left=right, color="#e3e7ee", label="no label")
    axes.barh(places, wrong, left=[a + b for a, b in zip(right, missed, strict=True)], color=RED, label="another point")
    axes.set_yticks(places, names, fontsize=8)
    axes.invert_yaxis()
    axes.margins(y=0.01)
    axes.set(xlim=(0, 100), xlabel="% of the markers in view; 3 hidden at every moment")
    canvas.legend(loc="outside lower center", ncols=3, frameon=False)
    return canvas


def speed(values: dict[str, Entry]) -> Canvas | None:
    """Frames per second on one core."""
    conditions = ("15 markers, 3 hidden", "15 markers, 3 hidden + 3 ghosts", "59 markers, 3 hidden")
    rows = [
        (condition, method, values[row].measured)
        for condition in conditions
        for method in METHODS
        if (row := f"speed, {condition}, {method}, one core") in values
    ]
    if not rows:
        return None
    canvas, axes = plt.subplots(figsize=(9, 0.3 * len(rows) + 1))
    seen: set[str] = set()
    for place, (condition, method, rate) in enumerate(rows):
        axes.barh(place, rate, color=METHODS[method][0])
        axes.text(rate * 1.05, place, f"{rate:,.0f}", va="center", fontsize=9)
        if condition not in seen:
            axes.text(105, place, condition, va="center", color="white", fontsize=9)
        seen.add(condition)
    axes.set_yticks(range(len(rows)), [METHODS[method][1] for _, method, _ in rows], fontsize=9)
    axes.invert_yaxis()
    axes.margins(y=0.01)
    axes.set(xscale="log", xlim=(100, 60000), xlabel="frames per second, one core")
    return canvas


def wand(values: dict[str, Entry]) -> Canvas | None:
    """Calibration by a waved wand: ours, a peer, the bound."""
    start = "wand, 8 cameras, 2,000 frames, 0.2 px"
    peer = f"{start}, aniposelib from 1 % off"
    panels = (
        ("focal length, RMS error, %", f"{start}, cold start: focal length, RMS", f"{peer}: focal length, RMS"),
        (
            "3D error of unseen points, mm",
            f"{start}, cold start: 3D of unseen points, their blobs with noise, RMS",
            f"{peer}: 3D of unseen points, their blobs with noise, RMS",
        ),
        (
            "final adjustment, s",
            f"{start}, cold start: final adjustment, one core",
            f"{peer}: its adjustment, one core",
        ),
    )
    if any(row not in values for _, *rows in panels for row in rows):
        return None
    canvas, every = plt.subplots(1, 3, figsize=(9, 2.6))
    for axes, (title, *rows) in zip(every, panels, strict=True):
        measured = [values[row].measured for row in rows]
        axes.bar(["Asterism", "aniposelib"], measured, color=[TEAL, AMBER], width=0.55)
        for place, value in enumerate(measured):
            axes.text(place, value, f"{value:.3g}", ha="center", va="bottom")
        axes.set_title(title)
        axes.margins(y=0.2)
    return canvas


def points(values: dict[str, Entry]) -> Canvas | None:
    """Composition of points: how many markers are found how near, and ghosts, against the thesis' plain algorithm."""
    walk = "vicon-rig-walk, {} px, body, strays"
    ghosts = "ghosts, 8 cameras 50 markers 0.3 px, {}, {}"
    if f"{walk.format(0.3)}: found within 2 mm" not in values or ghosts.format("all seen", "global choice") not in values:
        return None
    canvas, (near, extra) = plt.subplots(1, 2, figsize=(9, 3))
    for noise, color in ((0.3, TEAL), (0.15, BLUE)):
        start = walk.format(noise)
        rows = (f"{start}: markers seen by two cameras, found within 1 mm", f"{start}: found within 2 mm", f"{start}: found within 5 mm")
        near.plot([1, 2, 5], [100 * values[row].measured for row in rows], color=color, marker="o", label=f"blob noise {noise} px")
        if smooth := values.get(f"{start}: the same, smoothed along paths"):
            near.plot([1], [100 * smooth.measured], color=color, marker="*", markersize=11, linestyle="", label="the same, smoothed")
    near.set(title="markers found near their true place", xlabel="within so many mm", ylabel="%", ylim=(96, 100.1), xticks=[1, 2, 5])
    near.legend(frameon=False, fontsize=9)
    near.grid(axis="y", alpha=0.3)
    _ghosts(extra, values, ghosts)
    return canvas


def _ghosts(axes: Axes, values: dict[str, Entry], row: str) -> None:
    conditions = {"all seen": "all markers seen", "30 % missed, 0.5 strays an image": "30 % missed, strays"}
    for shift, (method, color, name) in zip(
        (-0.2, 0.2), (("global choice", TEAL, "Asterism"), ("plain algorithm 3.1/3.2", AMBER, "thesis 3.1, 3.2")), strict=True
    ):
        counts = [values[row.format(condition, method)].measured for condition in conditions]
        places = [place + shift for place in range(len(counts))]
        axes.bar(places, counts, 0.4, color=color, label=name)
        for place, count in zip(places, counts, strict=True):
            axes.text(place, count * 1.15, f"{count:,.2g}" if count < 100 else f"{count:,.0f}", ha="center", fontsize=9)
    axes.set_xticks(range(len(conditions)), conditions.values())
    axes.set(yscale="log", ylim=(0.1, 1e6), title="ghosts per 1,000 points")
    axes.legend(frameon=False, fontsize=9, loc="upper left", ncols=2)


PLOTS: dict[str, Callable[[dict[str, Any]], Canvas | None]] = {
    "occlusions": occlusions,
    "movements": movements,
    "speed": speed,
    "wand": wand,
    "points": points,
}
"""Each plot by the name of its file."""
