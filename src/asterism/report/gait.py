"""Analysed walks in; a page with parameters, angles over the gait cycle, events and the recording to look at, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.recording import Floats
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, decimal, write_page

if TYPE_CHECKING:
    from asterism.gait import Band, GaitAnalysis

PANELS = (
    (("Pelvis", 0, "pelvic tilt ahead"), ("Pelvis", 1, "pelvic obliquity, up"), ("Pelvis", 2, "pelvic rotation, internal")),
    (("Hip", 0, "hip flexion"), ("Hip", 1, "hip adduction"), ("Hip", 2, "hip rotation, internal")),
    (("Knee", 0, "knee flexion"), ("Knee", 1, "knee adduction (varus)"), ("Knee", 2, "knee rotation, internal")),
    (("Ankle", 0, "ankle dorsiflexion"), ("FootProgress", 2, "foot progression, internal"), ("Ankle", 2, "ankle rotation, internal")),
)
"""Rows of panels: quantity, which of its angles, and its title, which says what is positive."""
LOADS = (
    (
        ("HipMoment", 0, "hip extension moment", "N m"),
        ("KneeMoment", 0, "knee extension moment", "N m"),
        ("AnkleMoment", 0, "plantar flexion moment", "N m"),
    ),
    (("HipPower", 0, "hip power", "W"), ("KneePower", 0, "knee power", "W"), ("AnklePower", 0, "ankle power", "W")),
    (
        ("GroundReactionForce", 0, "force of the ground, ahead", "N"),
        ("GroundReactionForce", 1, "force of the ground, inwards", "N"),
        ("GroundReactionForce", 2, "force of the ground, upwards", "N"),
    ),
)
"""Rows of panels: curve, which of its columns, title, which says what is positive, and unit."""
_FAINT = "66"
"""Opacity of single cycles, as hexadecimal digits behind a colour."""


def gait_report(path: str | Path, results: Sequence[tuple[str, GaitAnalysis]], *, band: Band | None = None, title: str = "Gait") -> None:
    """Write an HTML page on analysed walks (name, analysis): parameters first, then angles, then what they rest on.

    Cycles of all walks stand side by side in each panel, so give walks of one person in one condition. `band` is drawn grey behind them,
    and scores say how far the person is from it.
    Raises AsterismError where the page cannot be written.
    """
    from asterism.gait import summarise

    analyses = [analysis for _, analysis in results]
    parameters = [parameter for analysis in analyses for parameter in analysis.parameters]
    cycles = [(analysis, cycle) for analysis in analyses for cycle in analysis.cycles]
    sections = [
        Section(
            "Parameters",
            "Means and standard deviations over n cycles. Behind ± stands how exactly strikes and offs tell the mean.",
            table=_parameter_table(summarise(parameters)),
        ),
        *_angles(analyses, band),
        *_loads(analyses),
        *([] if band is None else _scores(analyses, band)),
        _events(results),
        *_filled(results),
    ]
    sides = {side: sum(cycle.side == side for _, cycle in cycles) for side in "LR"}
    speed = [one.value for one in parameters if one.name == "walking speed"]
    merit = [
        (decimal(float(np.mean(speed)), 2, " m/s") if speed else NOTHING, "walking speed", ""),
        (count(sides["L"]), "left cycles", "" if sides["L"] else "warn"),
        (count(sides["R"]), "right cycles", "" if sides["R"] else "warn"),
    ]
    where = "on a treadmill" if all(one.walking.treadmill for one in analyses) else "over the floor"
    findings = [finding for analysis in analyses for finding in analysis.findings]
    if findings:
        rows: list[list[str | Cell]] = [[finding.sentence, finding.mend] for finding in findings]
        sections.append(Section("What to know", table=Table(["found", "what to do"], rows, left=2)))
    lead = f"{len(cycles)} gait cycles in {len(results)} recordings, {where}. Left is red and drawn through, right is blue and dashed."
    write_page(path, Page(title, lead, {"recordings": ", ".join(name for name, _ in results)}, merit, sections))


def _parameter_table(summaries: Sequence[object]) -> Table:
    from asterism.gait import PARAMETERS

    rows: list[list[str | Cell]] = []
    for name, unit in PARAMETERS.items():
        row: list[str | Cell] = [name, unit]
        for side in "LR":
            own = next((one for one in summaries if (one.name, one.side) == (name, side)), None)  # type: ignore[attr-defined]
            digits = {"m": 3, "s": 2, "m/s": 2}.get(unit, 1)
            if own is None:
                row += [NOTHING, NOTHING, NOTHING]
                continue
            row += [
                f"{own.mean:.{digits}f} ± {own.sigma:.{digits}f}",  # type: ignore[attr-defined]
                decimal(own.deviation, digits),  # type: ignore[attr-defined]
                str(own.count),  # type: ignore[attr-defined]
            ]
        rows.append(row)
    return Table(["parameter", "unit", "left", "SD", "n", "right", "SD", "n"], rows, left=2)


def _angles(analyses: Sequence[GaitAnalysis], band: Band | None) -> list[Section]:
    """One section with all panels; none where no recording has angles."""
    if not any(analysis.curves for analysis in analyses):
        return []
    panels = [[_PanelOf(f"{quantity}Angles", which, title, "°") for quantity, which, title in row] for row in PANELS]
    curves = [{name: np.degrees(values) for name, values in analysis.curves.items()} for analysis in analyses]
    text = (
        "From one strike of a foot to its next. Thin lines are single cycles, thick ones their means; upright lines are where the foot "
        "leaves the floor. Angles of Plug-in-Gait, by the measures of the file or those given."
    )
    return [Section("Angles over the gait cycle", text, figure=_grid(panels, curves, analyses, band))]


def _loads(analyses: Sequence[GaitAnalysis]) -> list[Section]:
    """Moments, powers and the ground's force; none where no cycle has them. Walks without a mass are in a section of their own."""
    sections = []
    for per_kg in (True, False):
        chosen = [one for one in analyses if one.loads and one.kinetics is not None and one.kinetics.per_kg == per_kg]
        if not chosen:
            continue
        per = "/kg" if per_kg else ""
        panels = [[_PanelOf(name, which, title, unit + per) for name, which, title, unit in row] for row in LOADS]
        curves = [dict(one.loads) for one in chosen]
        for own in curves:
            # inwards is to the right of the left foot, and to the left of the right one
            own |= {name: own[name] * [1.0, -1.0, 1.0] for name in ("LGroundReactionForce",) if name in own}
        counted = {side: sum(len(own.get(f"{side}HipMoment", ())) for own in curves) for side in "LR"}
        text = (
            f"Over {counted['L']} left and {counted['R']} right cycles in which one foot alone was on a plate. Moments are those that the "
            "muscles and ligaments of the person make; a power above zero is work that they do, below zero work that they take up."
        )
        if not per_kg:
            text += " Nobody gave the mass of the person, so that they are not per kg and leave out the leg's inertia."
        sections.append(Section("Moments and powers over the gait cycle", text, figure=_grid(panels, curves, chosen, None)))
    return sections


@dataclass(frozen=True)
class _PanelOf:
    """What one panel shows: a curve's name without its side, which column of it, title and unit."""

    curve: str
    which: int
    title: str
    unit: str


def _grid(
    grid: Sequence[Sequence[_PanelOf]], curves: Sequence[Mapping[str, Floats]], analyses: Sequence[GaitAnalysis], band: Band | None
) -> dict[str, object]:
    """A figure of rows of panels; curves by name, (cycles, 101, columns), of each analysis."""
    percent = list(range(101))
    data: list[dict[str, object]] = []
    layout: dict[str, object] = {}
    titles: list[dict[str, object]] = []
    columns, rows = len(grid[0]), len(grid)
    # in the legend a side is named once, by the first panel that has it
    named_sides: set[str] = set()
    for row, panels in enumerate(grid):
        for column, panel in enumerate(panels):
            cell = row * columns + column
            left, top = column / columns, 1.0 - row / rows
            x = {"domain": [left + 0.03, left + 1.0 / columns - 0.01], "range": [0, 100], "dtick": 20}
            if row == rows - 1:
                x["title"] = {"text": "gait cycle (%)"}
            y = {"domain": [top - 1.0 / rows + 0.05, top - 0.05]}
            # Above the panel: beside it the words of one panel would lie on the next.
            titles.append(
                {
                    "text": f"{panel.title} ({panel.unit})",
                    "xref": "paper",
                    "yref": "paper",
                    "x": left + 0.03,
                    "y": top - 0.048,
                    "xanchor": "left",
                    "yanchor": "bottom",
                    "showarrow": False,
                    "font": {"size": 12},
                }
            )
            axes, sides = figures.cell_axes(cell, x, y)
            layout |= sides
            quantity = panel.curve.removesuffix("Angles")
            if band is not None and quantity in band.mean:
                usual, spread = (np.degrees(values[quantity][:, panel.which]) for values in (band.mean, band.deviation))
                named = {"name": "controls, ± 1 SD", "showlegend": cell == 0, "legendgroup": "band"}
                data += figures.band(percent, (usual - spread).round(2), (usual + spread).round(2), "#64748b40", axes, named)
            for letter, side in (("L", "left"), ("R", "right")):
                own = [some[name] for some in curves if (name := letter + panel.curve) in some]
                if not own:
                    continue
                drawn = np.asarray(np.concatenate(own)[:, :, panel.which].round(3), dtype=np.float64)
                data += _panel(percent, drawn, side, panel, axes, side not in named_sides)
                named_sides.add(side)
                off = _off_shares(analyses, letter)
                # a curve that no cycle shows has no ends
                if len(off) and np.isfinite(drawn).any():
                    at = round(100 * float(np.mean(off)), 1)
                    span = [float(np.nanmin(drawn)), float(np.nanmax(drawn))]
                    colour = figures.SIDES[side]["color"]
                    style = {"color": colour, "width": 1, "dash": "dot" if side == "right" else "solid"}
                    data.append(
                        figures.line([at, at], span, "", f"{side} foot off at {at} %", line=style, showlegend=False, opacity=0.6, **axes)
                    )
    return figures.figure(data, height=250 * rows, annotations=titles, **layout)


def _scores(analyses: Sequence[GaitAnalysis], band: Band) -> list[Section]:
    from asterism.gait import profile_scores
    from asterism.gait.bands import SCORED

    scores = {score.side: score for score in profile_scores(analyses, band)}
    if not scores:
        return []
    rows: list[list[str | Cell]] = [
        [title, *(decimal(float(np.degrees(scores[side].variables[title])), 1) if side in scores else NOTHING for side in "LR")]
        for _, _, title in SCORED
    ]
    rows.append(["Gait Profile Score", *(decimal(float(np.degrees(scores[side].gps)), 1) if side in scores else NOTHING for side in "LR")])
    text = f"Degrees from the mean of {band.people} people, root mean square over the cycle (Baker et al. 2009)."
    return [Section("Scores", text, table=Table(["angle", "left", "right"], rows))]


def _panel(percent: list[int], curves: Floats, side: str, panel: _PanelOf, axes: dict[str, str], first: bool) -> list[dict[str, object]]:
    unit = panel.unit if panel.unit == "°" else f" {panel.unit}"
    style, hover = figures.SIDES[side], f"{side} {panel.title} %{{x}} %: %{{y:.{1 if panel.unit == '°' else 2}f}}{unit}"
    group = {"legendgroup": side, **axes}
    thin = {**style, "color": style["color"] + _FAINT, "width": 1}
    lines = [figures.line(percent, curve, "", "", line=thin, showlegend=False, hoverinfo="skip", **group) for curve in curves]
    known = np.isfinite(curves)
    # where no cycle is known the mean is not either
    mean = np.where(known.any(axis=0), np.nansum(curves, axis=0) / np.maximum(known.sum(axis=0), 1), np.nan).round(3)
    return [*lines, figures.line(percent, mean, side, hover, line={**style, "width": 2.5}, showlegend=first, **group)]


def _off_shares(analyses: Sequence[GaitAnalysis], side: str) -> list[float]:
    return [cycle.off_share for analysis in analyses for cycle in analysis.cycles if cycle.side == side]


def _filled(results: Sequence[tuple[str, GaitAnalysis]]) -> list[Section]:
    """Markers whose gaps were filled, and how far that makes angles uncertain; none where nothing was filled."""
    from asterism.recording import filled_samples

    rows: list[list[str | Cell]] = []
    largest = 0.0
    for name, analysis in results:
        deviation = filled_samples(analysis.recording)
        many = np.isfinite(deviation).sum(axis=0)
        for column in np.flatnonzero(many):
            most = 1000.0 * float(np.nanmax(deviation[:, column]))
            rows.append([name, analysis.recording.labels[column], f"{many[column]} of {len(deviation)}", f"{most:.1f}"])
        largest = max([largest, *(float(np.degrees(np.nanmax(one, initial=0.0))) for one in analysis.fill_sigmas.values())])
    if not rows:
        return []
    text = (
        "These markers were not seen in some frames; their places there follow from other markers. "
        f"That makes the angles of the cycles above uncertain by up to {largest:.1f}° (standard deviation), and is part of the ± of events."
    )
    return [Section("Filled markers", text, table=Table(["recording", "marker", "frames", "± mm"], rows, left=2), folded=True)]


def _events(results: Sequence[tuple[str, GaitAnalysis]]) -> Section:
    rows: list[list[str | Cell]] = []
    for name, analysis in results:
        for event in analysis.walking.events:
            side = "left" if event.side == "L" else "right"
            source = f"{event.source}, filled" if event.filled else event.source
            rows.append([name, side, event.label, source, f"{event.time:.3f}", f"{1000 * event.sigma:.0f}"])
    text = "Seconds from the first frame of each recording. An event on a force plate is told by its load, another by heel, toe and pelvis."
    return Section("Events", text, table=Table(["recording", "side", "event", "by", "s", "± ms"], rows, left=4), folded=True)
