"""Clinical angles, and one joint by all methods; sections of the page on motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, Recording
from asterism.report import figures
from asterism.report.cycle_panels import CurvesOfSide, CycleCurve, CyclePanel, drawn_panels
from asterism.report.gait_session import SIDE
from asterism.report.limb_names import joint_name
from asterism.report.page import NOTHING, Cell, Section, Table

if TYPE_CHECKING:
    from asterism.gait import Cycle
    from asterism.motion.analysis import JointAngles, MotionAnalysis
    from asterism.motion.clinical import ClinicalAngles, ClinicalUncertainty

_GAPS = (0.06, 0.1)
"""Space between the rows and between the columns of small figures, shares of the whole."""


def clinical_section(name: str, recording: Recording, clinical: ClinicalAngles, known: ClinicalUncertainty | None) -> Section:
    """Flexion, adduction and rotation of hip, knee and ankle, left and right in one small figure each; bands if known.

    Over the gait cycle where the recording shows whole ones, over time elsewhere.
    """
    from asterism.motion.clinical.uncertainty import TRIED_ON

    measured = sorted({measure for one in clinical.measures.values() for measure in one.from_file})
    taken = f"Measures that are known: {', '.join(measured).replace('_', ' ')}." if measured else "No measure is known: an adult's."
    model = clinical.model
    text = f"By {model.title(recording)}, hip centres by {model.hip}. Flexion, adduction and internal rotation are positive."
    cycles = gait_cycles(recording)
    if cycles:
        counted = " and ".join(f"{sum(one.side == letter for one in cycles)} {side}" for letter, side in SIDE.items())
        text += f" Over {counted} cycles, from one strike of a foot to its next: thin lines are cycles, thick ones their means."
    return Section(
        f"{name}: hips, knees and ankles" + (" over the gait cycle" if cycles else ""),
        text + (f" Bands: nominal 95 % intervals. {TRIED_ON}" if known is not None else ""),
        figure=None if cycles else _over_time(recording.times, clinical, known),
        drawing=_over_cycles(recording, cycles, clinical, known) if cycles else "",
        table=_clinical_budget(known) if known is not None else None,
        note=f"{taken} The foot is a line from ankle to toe, which tells no adduction." if clinical.model.name == "plug-in-gait" else "",
    )


def gait_cycles(recording: Recording) -> list[Cycle]:
    """Whole gait cycles; none where feet or pelvis have no markers, or nobody walks."""
    from asterism.formats import force_plates
    from asterism.gait import cycles_of, find_events

    try:
        return cycles_of(find_events(recording, force_plates(recording)[0]))
    except AsterismError:
        return []


def _over_cycles(recording: Recording, cycles: Sequence[Cycle], clinical: ClinicalAngles, known: ClinicalUncertainty | None) -> str:
    """A panel for each angle that is known, three in a row."""
    from asterism.motion.clinical import CLINICAL

    panels = []
    for joint in dict.fromkeys(joint.joint for joint in clinical.joints):
        for column, angle in enumerate(CLINICAL):
            sides = []
            for number, one in enumerate(clinical.joints):
                own = [cycle for cycle in cycles if SIDE[cycle.side] == one.side]
                if one.joint != joint or not own or not np.isfinite(one.angles[:, column]).any():
                    continue
                curves = curves_over(one.angles[:, column], recording.rate, own)
                ends = None
                if known is not None:
                    low, high = (mean_over(end[:, column], recording.rate, own) for end in known.joints[number].intervals[0.95])
                    ends = (low, high)
                sides.append(CurvesOfSide(one.side, curves, 100 * float(np.mean([cycle.off_share for cycle in own])), ends))
            if sides:
                panels.append(CyclePanel(f"{joint} {angle}", "°", sides))
    return drawn_panels(panels, interval="nominal 95 % interval")


def curves_over(values: Floats, rate: float, cycles: Sequence[Cycle]) -> list[CycleCurve]:
    """A curve (T,) in rad over each cycle, degrees."""
    from asterism.gait import over_cycle, without_turns

    counted = without_turns(cycles)
    return [
        CycleCurve(over_cycle(np.degrees(values), rate, cycle), f"{SIDE[cycle.side]}, cycle {place + 1}", counts=cycle in counted)
        for place, cycle in enumerate(cycles)
    ]


def mean_over(values: Floats, rate: float, cycles: Sequence[Cycle]) -> Floats:
    """(101,) degrees, the mean of a curve in rad over the cycles that count."""
    from asterism.gait import over_cycle, without_turns

    return np.asarray(np.degrees(np.mean([over_cycle(values, rate, cycle) for cycle in without_turns(cycles)], axis=0)))


def _over_time(times: Floats, clinical: ClinicalAngles, known: ClinicalUncertainty | None) -> figures.Figure:
    """Small figures over time in a grid."""
    from asterism.motion.clinical import CLINICAL

    joints = list(dict.fromkeys(joint.joint for joint in clinical.joints))
    data: list[dict[str, object]] = []
    layout: dict[str, object] = {}
    for row, joint in enumerate(joints):
        for column, angle in enumerate(CLINICAL):
            cell = row * len(CLINICAL) + column
            # What is not known, such as the ankle's adduction, gets no empty figure.
            drawn = [(number, each) for number, each in enumerate(clinical.joints) if each.joint == joint]
            drawn = [(number, each) for number, each in drawn if np.isfinite(each.angles[:, column]).any()]
            # The time is named below the lowest figure of each column.
            last = row == len(joints) - 1 or (row == len(joints) - 2 and joints[-1] == "ankle" and angle == "adduction")
            axes, sides = _axes(cell, (row, len(joints)), (column, len(CLINICAL)), f"{joint} {angle} (°)", last)
            layout |= sides if drawn else {}
            for number, one in drawn:
                side, group = figures.SIDES[one.side], {**axes, "legendgroup": one.side}
                if known is not None:
                    low, high = (np.round(np.degrees(end[:, column]), 2) for end in known.joints[number].intervals[0.95])
                    data += figures.band(list(times), low, high, side["color"] + "2e", group, {"showlegend": False})
                values, hover = np.round(np.degrees(one.angles[:, column]), 3), one.name + " " + angle + " %{x:.2f} s: %{y:.1f}°"
                style = {"line": {**side, "width": 2}, "showlegend": cell == 0}
                data.append(figures.line(list(times), values, one.side, hover, **style, **group))
    return figures.figure(data, height=230 * len(joints) + 40, **layout)


def _clinical_budget(known: ClinicalUncertainty) -> Table:
    """Degrees by which each source makes each angle uncertain, root mean square over the frames."""
    from asterism.motion.clinical import CLINICAL

    names = list(known.joints[0].budget)
    rows: list[list[str | Cell]] = []
    for one in known.joints:
        for k, angle in enumerate(CLINICAL):
            if np.isfinite(one.standard[:, k]).any():
                parts = (np.degrees(np.sqrt(np.nanmean(one.budget[name][:, k] ** 2))) for name in names)
                rows.append([f"{one.joint.name} {angle}", *(f"{part:.1f}" for part in parts)])
    return Table(["standard uncertainty, °", *names], rows)


def _axes(cell: int, row: tuple[int, int], column: tuple[int, int], title: str, last: bool) -> tuple[dict[str, str], dict[str, object]]:
    """The two axes of a small figure in a grid, see `figures.cell_axes`: row and column as (place, number of places)."""
    high, wide = ((1 - gap * (count - 1)) / count for gap, (_, count) in zip(_GAPS, (row, column), strict=True))
    left, top = column[0] * (wide + _GAPS[1]), 1 - row[0] * (high + _GAPS[0])
    across = {"domain": [left, left + wide], **(figures.titled("time (s)") if last else {})}
    return figures.cell_axes(cell, across, figures.titled(title, domain=[max(top - high, 0.0), top]))


def methods_section(name: str, analysis: MotionAnalysis, limbs: Sequence[str]) -> list[Section]:
    """The angle of the joint that turns most, by every method of `estimate_limb_motion`, and how far each is from the one in use."""
    if not analysis.angles:
        return []
    # The joint that turns most shows the differences of the methods best.
    joint = max(analysis.angles, key=lambda one: float(np.nanmax(one.angle)))
    angles, rejected = angles_by_method(analysis, joint)
    used = analysis.motions[joint.parent].method
    times = analysis.recording.times
    data: list[dict[str, object]] = []
    rows: list[list[str | Cell]] = []
    for place, (method, angle) in enumerate(angles.items()):
        style = {"line": {"color": figures.PALETTE[place], "width": 3 if method == used else 1.5}, "legendgroup": method}
        hover = method + " %{x:.2f} s: %{y:.2f}°"
        data.append(figures.line(list(times), np.round(np.degrees(angle), 3), method, hover, **style))
        apart = np.degrees(angle - angles[used])
        if method != used:
            data.append(figures.line(list(times), np.round(apart, 4), method, hover, **style, yaxis="y2", showlegend=False))
        rows.append([method, *_differences(apart, method == used), f"{100 * rejected[method]:.1f}"])
    upper = figures.titled("angle (°)", ticksuffix="°", domain=[0.45, 1])
    lower = figures.titled(f"minus {used} (°)", ticksuffix="°", domain=[0, 0.37], anchor="x")
    across = figures.titled("time (s)", anchor="y2")
    return [
        Section(
            f"{name}: {joint_name(joint, limbs)} by each method",
            f"The joint that turns most, its limbs' points weighed in five ways. Below: how far each is from {used}, which this page uses.",
            figure=figures.figure(data, height=560, xaxis=across, yaxis=upper, yaxis2=lower),
            table=Table(["method", "mean difference, °", "largest, °", "weights below half the mean, %"], rows),
            note="Methods that agree may err together: skin that moves as one with a limb leaves no trace in any of them.",
        )
    ]


def angles_by_method(analysis: MotionAnalysis, joint: JointAngles) -> tuple[dict[str, Floats], dict[str, float]]:
    """By method: the angle of one joint (T,) rad since the frame from which `joint` counts, and how many of its weights, as a share, are
    below half the mean.

    Runs `estimate_limb_motion` on two limbs for each method that `analysis` did not use. A method that cannot tell a limb is absent.
    """
    from asterism.motion.analysis import joint_angles
    from asterism.motion.rigid import METHODS, estimate_limb_motion

    pair, positions = (joint.parent, joint.child), analysis.recording.positions
    angles, rejected = {}, {}
    for method in METHODS:
        # The method in use has been computed already. One that finds the limb's points in a line is left out; the others still compare.
        try:
            one, other = [
                motion if motion.method == method else estimate_limb_motion(positions[:, analysis.limb_of == limb], method)
                for limb, motion in ((limb, analysis.motions[limb]) for limb in pair)
            ]
            angles[method] = joint_angles(one, other, pair, joint.name).angle
        except AsterismError:
            continue
        counted = [each.rejected[np.isfinite(each.residuals)] for each in (one, other)]
        rejected[method] = float(np.concatenate(counted).mean())
    return angles, rejected


def _differences(apart: Floats, in_use: bool) -> list[str | Cell]:
    known = np.abs(apart[np.isfinite(apart)])
    return [NOTHING, NOTHING] if in_use or not len(known) else [f"{known.mean():.2f}", f"{known.max():.2f}"]
