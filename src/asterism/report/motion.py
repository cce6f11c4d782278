"""Limbs, joints and angles in; a page with points coloured by limb, angles with bands, budgets and methods side by side, out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.files.text import some_of
from asterism.recording import Floats, Recording
from asterism.report import figures
from asterism.report.cycle_panels import CurvesOfSide, CyclePanel, drawn_panels
from asterism.report.gait_session import SIDE
from asterism.report.limb_names import joint_name, limb_names
from asterism.report.motion_angles import clinical_section, curves_over, gait_cycles, mean_over, methods_section
from asterism.report.page import Cell, Page, Section, Table, decimal, write_page

if TYPE_CHECKING:
    from asterism.gait import Cycle
    from asterism.motion.analysis import JointAngles, MotionAnalysis
    from asterism.motion.clinical import ClinicalAngles, ClinicalUncertainty
    from asterism.motion.segmentation import Segmentation
    from asterism.motion.uncertainty import AngleUncertainty, UncertaintyResult

_MOST_POINTS = 4000
REJECTED = "rejected"


def segmentation_report(path: str | Path, results: Sequence[tuple[str, Recording, Segmentation]]) -> None:
    """Write an HTML page on the limbs of recordings (name, recording, segmentation). Raises AsterismError where it cannot be written."""
    sections = []
    for name, recording, segmentation in results:
        names = [f"limb {k + 1}" for k in range(segmentation.limbs)]
        rows: list[list[str | Cell]] = []
        for k, limb in enumerate(names):
            points = segmentation.points(k)
            stray = segmentation.stray[points, k]
            known = stray[np.isfinite(stray)]
            typical = 1000 * float(np.median(known)) if len(known) else np.nan
            rows.append([limb, some_of([recording.labels[n] for n in points], 10), str(len(points)), decimal(typical, 1)])
        sections.append(
            Section(
                name,
                f"{segmentation.limbs} limbs in {len(recording)} frames, by {segmentation.method}. Each point has the colour of its limb.",
                figure=points_figure(recording, segmentation.limb_of, names),
                table=Table(["limb", "points", "number", "median stray, mm"], rows, left=2),
            )
        )
    limbs = sum(segmentation.limbs for _, _, segmentation in results)
    lead = "Points that keep their places in the axes of one moving body are one limb."
    write_page(path, Page("Limbs", lead, {"recordings": len(results)}, [(str(limbs), "limbs", "")], sections))


def motion_report(
    path: str | Path,
    results: Sequence[tuple[str, MotionAnalysis, UncertaintyResult | None]],
    *,
    title: str = "Motion: joints and angles",
    clinical: Sequence[tuple[ClinicalAngles | None, ClinicalUncertainty | None]] = (),
) -> None:
    """Write an HTML page on analysed recordings (name, analysis, uncertainty or None), and on their clinical angles, if any, with
    their uncertainty, if known.

    Raises AsterismError where it cannot be written.
    """
    # What a clinician reads first is first, of all recordings; joints that nobody named come behind.
    sections, ranges = [], []
    for number, (name, analysis, _) in enumerate(results):
        of_legs, known = clinical[number] if number < len(clinical) else (None, None)
        if of_legs is not None and of_legs.joints:
            sections.append(clinical_section(name, analysis.recording, of_legs, known))
            ranges += [one.angles[:, 0] for one in of_legs.joints if one.joint == "knee"]
    legs = bool(sections)
    for name, analysis, certain in results:
        sections += _sections(name, analysis, certain)
    joints = sum(len(analysis.angles) for _, analysis, _ in results)
    merits = [(str(joints), "joints found from the motion", "")]
    if ranges:
        most = np.degrees([float(np.ptp(flexion[np.isfinite(flexion)])) for flexion in ranges if np.isfinite(flexion).any()])
        merits = [(f"{most.min():.0f} to {most.max():.0f}°", "range of knee flexion", ""), *merits] if len(most) else merits
    else:
        merits.insert(0, (str(sum(len(analysis.names) for _, analysis, _ in results)), "limbs", ""))
    widths = [float(np.degrees(np.nanmax(one.angle_standard))) for _, _, certain in results if certain for one in certain.joints]
    if widths:
        merits.append((f"{max(widths):.2f}°", "largest standard uncertainty of an angle", ""))
    lead = (
        "Angles of limbs count from the first frame in which both are seen. Flexion is the turn about a joint's main axis, from its mean."
    )
    if legs:
        lead = "First the angles of hips, knees and ankles; below, joints that were found from the motion of the points alone. " + lead
    facts = {"recordings": len(results), "method": results[0][1].motions[0].method if results else None}
    write_page(path, Page(title, lead, facts, merits, sections))


def _sections(name: str, analysis: MotionAnalysis, certain: UncertaintyResult | None) -> list[Section]:
    from asterism.motion.uncertainty.budget import TRIED_ON

    # Hollow by the majority of frames: single frames would flicker.
    rejected = np.zeros(len(analysis.limb_of), dtype=bool)
    for limb, motion in enumerate(analysis.motions):
        rejected[analysis.limb_of == limb] = motion.rejected.mean(axis=0) > 0.5
    limbs = limb_names(analysis)
    sections = [
        Section(
            f"{name}: limbs",
            "Each point has the colour of its limb; hollow points weigh less than half the mean: they move with the skin.",
            figure=points_figure(analysis.recording, analysis.limb_of, limbs, rejected, analysis.centres),
            table=_joint_table(analysis, limbs),
        )
    ]
    cycles = gait_cycles(analysis.recording)
    panels: list[CyclePanel] = []
    over_time = []
    for number, joint in enumerate(analysis.angles):
        one, said = certain.joints[number] if certain else None, joint_name(joint, limbs)
        own = [cycle for cycle in cycles if SIDE[cycle.side] in said]
        # A joint of both sides has no cycle of its own, and neither has one that says no side.
        if own and len({cycle.side for cycle in own}) == 1:
            panels.append(_over_cycles(said, joint, one, analysis.recording.rate, own))
        else:
            over_time.append(_angle_section(f"{name}: {said}", analysis, joint, one))
        if one is not None:
            over_time.append(_budget_section(said, one, analysis.recording.times))
    if panels:
        text = "How far each joint has turned since its first frame, over the cycles of its side."
        text += f" Bands: nominal 95 % intervals. {TRIED_ON}" if certain else ""
        drawing = drawn_panels(panels, interval="nominal 95 % interval")
        sections.append(Section(f"{name}: joints found from the motion, over the gait cycle", text, drawing=drawing))
    sections += over_time
    return [*sections, *methods_section(name, analysis, limbs)]


def _over_cycles(title: str, joint: JointAngles, one: AngleUncertainty | None, rate: float, cycles: Sequence[Cycle]) -> CyclePanel:
    """The angle of a joint of one side."""
    ends = None
    if one is not None:
        low, high = (mean_over(end, rate, cycles) for end in one.angle_intervals[0.95])
        ends = (low, high)
    off = 100 * float(np.mean([cycle.off_share for cycle in cycles]))
    return CyclePanel(title, "°", [CurvesOfSide(SIDE[cycles[0].side], curves_over(joint.angle, rate, cycles), off, ends)])


def points_figure(
    recording: Recording, limb_of: np.ndarray, names: Sequence[str], rejected: np.ndarray | None = None, centres: Floats | None = None
) -> figures.Figure:
    """The frame with the most points, in space, coloured by limb; rejected points hollow, joint centres as diamonds."""
    # The frame with the most points shows the limbs most completely.
    frame = int(np.argmax(recording.visible.sum(axis=1)))
    # Some thousand points show a limb; more only make the page slow.
    step = max(1, -(-len(limb_of) // _MOST_POINTS))
    chosen = np.arange(0, len(limb_of), step)
    hollow = np.zeros(len(limb_of), dtype=bool) if rejected is None else rejected
    data = []
    for limb, name in enumerate(names):
        for open_, suffix in ((False, ""), (True, f", {REJECTED}")):
            points = chosen[(limb_of[chosen] == limb) & (hollow[chosen] == open_)]
            if len(points):
                marker = {"size": 3 if len(limb_of) > 200 else 6, "color": figures.PALETTE[limb % len(figures.PALETTE)]}
                marker["symbol"] = "circle-open" if open_ else "circle"
                named = {"text": [recording.labels[n] for n in points], "hovertemplate": "%{text}<extra></extra>"}
                places = recording.positions[frame, points]
                data.append(figures.in_space(places, 4, name=f"{name}{suffix}", marker=marker, **named))
    if centres is not None and len(centres):
        marker, hover = {"size": 7, "color": "#16213a", "symbol": "diamond"}, "joint centres<extra></extra>"
        data.append(figures.in_space(centres[:, frame], 4, name="joint centres", marker=marker, text=None, hovertemplate=hover))
    scene = {"aspectmode": "data", **{axis: figures.titled(f"{axis[0]} (m)") for axis in ("xaxis", "yaxis", "zaxis")}}
    scene["camera"] = {"eye": {"x": 2.3, "y": -2.3, "z": 0.6}}
    return figures.figure(data, height=560, scene=scene)


def _joint_table(analysis: MotionAnalysis, limbs: Sequence[str]) -> Table:
    rows: list[list[str | Cell]] = []
    for joint in analysis.angles:
        fitted = analysis.skeleton.joints[joint.child]
        if fitted is not None:
            sigma = float(np.sqrt(np.trace(fitted.covariance)))
            turned = np.degrees(np.nanmax(joint.angle))
            rows.append(
                [joint_name(joint, limbs), fitted.kind, f"{turned:.1f}", decimal(1000 * fitted.residual, 1), decimal(1000 * sigma, 1)]
            )
    return Table(["joint", "kind", "largest angle, °", "centre drifts, mm", "centre ±, mm"], rows, left=2)


def _angle_section(heading: str, analysis: MotionAnalysis, joint: JointAngles, one: AngleUncertainty | None) -> Section:
    from asterism.motion.uncertainty.budget import TRIED_ON

    text = "How far the joint has turned since its first frame."
    bands = []
    if one is not None:
        text += f" Bands: nominal 65 and 95 % intervals. {TRIED_ON}"
        bands = [(f"nominal {100 * p:.0f} %", *one.angle_intervals[p]) for p in sorted(one.angle_intervals, reverse=True)]
    return Section(heading, text, figure=band_figure(analysis.recording.times, joint.angle, bands))


def band_figure(times: Floats, angle: Floats, bands: Sequence[tuple[str, Floats, Floats]]) -> figures.Figure:
    """An angle over time (rad, drawn in degrees) over its bands (name, low, high), the widest first; below, the bands about the angle."""
    data: list[dict[str, object]] = []
    # Below, the bands about the angle itself: beside a range of a hundred degrees they would be a line.
    for axis, zero in (("y", np.zeros(len(angle))), ("y2", angle)) if bands else ():
        for place, (label, low, high) in enumerate(bands):
            shade = f"rgba(15, 123, 138, {0.15 + 0.2 * place})"
            low_end, high_end = (np.round(np.degrees(end - zero), 3) for end in (low, high))
            named = {"name": label, "showlegend": axis == "y"}
            data += figures.band(list(times), low_end, high_end, shade, {"yaxis": axis}, named)
    style = {"color": figures.PALETTE[0], "width": 2}
    data.append(figures.line(list(times), np.round(np.degrees(angle), 3), "angle", "%{x:.2f} s: %{y:.2f}°", line=style))
    upper = figures.titled("angle (°)", ticksuffix="°")
    if not bands:
        return figures.figure(data, height=360, xaxis=figures.titled("time (s)"), yaxis=upper)
    lower = figures.titled("interval (°)", ticksuffix="°", domain=[0, 0.3], anchor="x")
    across = figures.titled("time (s)", anchor="y2")
    return figures.figure(data, height=480, xaxis=across, yaxis={**upper, "domain": [0.38, 1]}, yaxis2=lower)


def _budget_section(name: str, one: AngleUncertainty, times: Floats) -> Section:
    data = []
    for place, (source, part) in enumerate(one.budget.items()):
        style = {"width": 3, "color": "#16213a"} if source == "all" else {"width": 2, "color": figures.PALETTE[place]}
        data.append(figures.line(list(times), np.round(np.degrees(part), 4), source, source + " %{x:.2f} s: %{y:.2f}°", line=style))
    names = list(one.budget)
    rows: list[list[str | Cell]] = []
    for label, budget in (("flexion about the joint's axis", one.budget), ("angle since the first frame", one.angle_budget)):
        rows.append([label, *(decimal(float(np.degrees(np.sqrt(np.nanmean(budget[name] ** 2)))), 2) for name in names)])
    axes = {"xaxis": figures.titled("time (s)"), "yaxis": figures.titled("standard uncertainty (°)", rangemode="tozero")}
    return Section(
        f"{name}: what makes it uncertain",
        "The standard uncertainty of the flexion from each source alone, and from all together.",
        figure=figures.figure(data, height=320, **axes),
        table=Table(["root mean square over the frames, °", *names], rows),
        note="The joint's axis is found from the motion: no landmark is palpated for it, and none can be misplaced.",
    )
