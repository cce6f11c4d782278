"""Sessions in; panels of angles, moments and powers over the gait cycle, left over left cycles and right over right, out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from asterism.recording import Floats
from asterism.report.cycle_panels import CurvesOfSide, CycleCurve, CyclePanel, drawn_panels
from asterism.report.gait_session import SIDE, GaitSession, ShownCycle
from asterism.report.page import Cell, Section, Table

if TYPE_CHECKING:
    from asterism.gait import Band, Cycle, GaitAnalysis

ANGLES = (
    ("Pelvis", 0, "pelvic tilt, ahead"),
    ("Pelvis", 1, "pelvic obliquity, up"),
    ("Pelvis", 2, "pelvic rotation, internal"),
    ("Hip", 0, "hip flexion"),
    ("Hip", 1, "hip adduction"),
    ("Hip", 2, "hip rotation, internal"),
    ("Knee", 0, "knee flexion"),
    ("Knee", 1, "knee adduction (varus)"),
    ("Knee", 2, "knee rotation, internal"),
    ("Ankle", 0, "ankle dorsiflexion"),
    ("FootProgress", 2, "foot progression, internal"),
    ("Ankle", 2, "ankle rotation, internal"),
)
"""Twelve panels, three in a row: quantity, which of its angles, and its title, which says what is positive."""
LOADS = (
    ("HipMoment", 0, "hip extension moment", "N m"),
    ("KneeMoment", 0, "knee extension moment", "N m"),
    ("AnkleMoment", 0, "plantar flexion moment", "N m"),
    ("HipPower", 0, "hip power", "W"),
    ("KneePower", 0, "knee power", "W"),
    ("AnklePower", 0, "ankle power", "W"),
    ("GroundReactionForce", 0, "force of the ground, ahead", "N"),
    ("GroundReactionForce", 1, "force of the ground, inwards", "N"),
    ("GroundReactionForce", 2, "force of the ground, upwards", "N"),
)
"""Nine panels, three in a row: curve, which of its columns, title, which says what is positive, and unit."""


@dataclass(frozen=True)
class Curves:
    """Curves of one analysis by name, such as "LKneeAngles" -> (cycles, 101, columns), and the cycles that they are of."""

    values: Mapping[str, Floats]
    cycles: Callable[[str], Sequence[Cycle]]


def angle_section(sessions: Sequence[GaitSession], band: Band | None) -> list[Section]:
    """One section with all angles; none where no recording has them."""
    if not any(analysis.curves for one in sessions for analysis in one.analyses):
        return []
    of = {
        id(analysis): Curves({name: np.degrees(values) for name, values in analysis.curves.items()}, _own_cycles(analysis))
        for one in sessions
        for analysis in one.analyses
    }
    panels = []
    for quantity, which, title in ANGLES:
        control = None
        if band is not None and quantity in band.mean:
            usual, spread = (np.degrees(values[quantity][:, which]) for values in (band.mean, band.deviation))
            control = (usual - spread, usual + spread)
        sides = curves_of_sides(sessions, of, f"{quantity}Angles", which)
        panels.append(CyclePanel(title, "°", _with_intervals(sides, sessions, f"{quantity}Angles", which), control))
    models = dict.fromkeys(
        one.clinical.model.title(one.recording) for session in sessions for one in session.analyses if one.clinical is not None
    )
    text = (
        "From one strike of a foot to its next. Thin lines are single cycles, thick ones their means; upright lines are where the foot "
        f"leaves the floor. Angles of {' and '.join(models)}, by the measures of the file or those given."
    )
    if any(one.interval for panel in panels for one in panel.sides):
        text += (
            " The 95 % interval says where the mean would be in another session with this person: with markers placed anew, and measured "
            "where nobody did. It is no spread of the cycles."
        )
    names = session_names(sessions)
    sections = [Section("Angles over the gait cycle", text, drawing=drawn_panels(panels, names)), *_certainty(sessions[-1])]
    if names is not None and (rows := _differences(panels)):
        said = (
            f"Of the mean curves, {names[1]} less {names[0]}. The interval holds 95 % of the differences that two sessions would show of "
            "the same walk, with markers placed anew. Where a difference exceeds it, the walk has changed."
        )
        head = ["angle", "side", "mean difference, °", "largest, °", "at", "± 95 % there, °", "exceeds it over"]
        sections.append(Section("Angles of two sessions", said, table=Table(head, rows, left=2)))
    return sections


_SAID = {"measures": "measures", "fills": "fills", "events": "strikes", "placement": "placement"}
"""What makes angles uncertain, by the sources of `asterism.gait.angle_bands`."""


def _certainty(session: GaitSession) -> list[Section]:
    """How certain mean curves are with the markers where they are, and from session to session: a row for each angle that has a band."""
    rows: list[list[str | Cell]] = []
    for quantity, which, title in ANGLES:
        here: dict[str, str] = {}
        anew: dict[str, str] = {}
        variance: dict[str, float] = {}
        for letter in SIDE:
            bands = [one.bands[name] for one in session.analyses if (name := f"{letter}{quantity}Angles") in one.bands]
            ends = [[(one.high - one.low)[:, which], np.subtract(*one.same_placement[::-1])[:, which]] for one in bands]
            if not np.isfinite(ends).any():
                continue
            anew[letter], here[letter] = (f"{half:.1f}" for half in np.degrees(np.nanmean(ends, axis=(0, 2)) / 2))
            for one in bands:
                for source, part in one.standard.items():
                    variance[source] = variance.get(source, 0.0) + float(np.nanmean(part[:, which] ** 2))
        if anew:
            most = max(variance, key=variance.__getitem__)
            share = 100 * variance[most] / max(sum(variance.values()), 1e-12)
            sides = [found.get(letter, "–") for found in (here, anew) for letter in SIDE]
            rows.append([title, *sides, f"{_SAID[most]}, {share:.0f} %"])
    if not rows:
        return []
    text = (
        "± 95 % of the mean curves, on average over the cycle. This session: the markers stay where they are; open are what nobody "
        "measured of the person (measures), filled samples (fills) and the times of strikes. Another session: the same with markers "
        "placed anew (placement). The last column says which of them has the most of the variance."
    )
    head = ["angle", *(f"{when}, {side}, ±°" for when in ("this session", "another session") for side in SIDE.values()), "most by"]
    return [Section("How certain the angles are", text, table=Table(head, rows, left=1), folded=True)]


def _differences(panels: Sequence[CyclePanel]) -> list[list[str | Cell]]:
    """How far the later session's means are from the earlier one's, a row for each angle and side whose intervals are known."""
    rows: list[list[str | Cell]] = []
    for panel in panels:
        for side in SIDE.values():
            both = {one.earlier: one for one in panel.sides if one.side == side and one.cycles and one.interval is not None}
            if len(both) < 2:
                continue
            apart = both[False].mean - both[True].mean
            # Both sessions have their own errors of placement.
            half = np.hypot(*(0.5 * (one.interval[1] - one.interval[0]) for one in both.values() if one.interval is not None))
            known = np.isfinite(apart) & np.isfinite(half)
            if not known.any():
                continue
            at = int(np.nanargmax(np.where(known, np.abs(apart), np.nan)))
            share = float((np.abs(apart[known]) > half[known]).mean())
            largest = Cell(f"{apart[at]:+.1f}", 0.6 if share > 0 else 0.0)
            over = f"{100 * share:.0f} % of the cycle" if share > 0 else "no part"
            mean = round(float(apart[known].mean()), 1) + 0.0
            rows.append([panel.title, side, f"{mean:+.1f}", largest, f"{at} %", f"{half[at]:.1f}", over])
    return rows


def _with_intervals(sides: Sequence[CurvesOfSide], sessions: Sequence[GaitSession], curve: str, which: int) -> list[CurvesOfSide]:
    """With the band of each session and foot: the mean of those of its walks, whose markers and measures are the same."""
    from asterism.gait import analyses_without_turns

    letters = {side: letter for letter, side in SIDE.items()}
    found = []
    for number, one in enumerate(sides):
        name = letters[one.side] + curve
        walks = analyses_without_turns(sessions[number // len(SIDE)].analyses)
        bands = [analysis.bands[name] for analysis in walks if name in analysis.bands]
        ends = [np.degrees(np.mean([getattr(band, end)[:, which] for band in bands], axis=0)) for end in ("low", "high") if bands]
        found.append(replace(one, interval=(ends[0], ends[1])) if ends else one)
    return found


def load_sections(sessions: Sequence[GaitSession]) -> list[Section]:
    """Moments, powers and the ground's force; none where no cycle has them. Walks without a mass are in a section of their own."""
    from asterism.gait import analyses_without_turns

    sections = []
    for per_kg in (True, False):
        chosen = [one for session in sessions for one in session.analyses if one.loads and one.kinetics and one.kinetics.per_kg == per_kg]
        if not chosen:
            continue
        of = {id(one): Curves(_inwards(one.loads), lambda name, one=one: one.loaded.get(name, ())) for one in chosen}  # type: ignore[misc]
        per = "/kg" if per_kg else ""
        panels = [
            CyclePanel(title, unit + per, _with_load_intervals(curves_of_sides(sessions, of, name, which), sessions, set(of), name, which))
            for name, which, title, unit in LOADS
        ]
        counted = {side: sum(len(one.loads.get(f"{side}HipMoment", ())) for one in analyses_without_turns(chosen)) for side in SIDE}
        text = (
            f"Over {counted['L']} left and {counted['R']} right cycles in which one foot alone was on a plate. Moments are those that the "
            "muscles and ligaments of the person make; a power above zero is work that they do, below zero work that they take up. "
            "The 95 % interval is what forces, centres of pressure, joint centres, masses, accelerations and turning speeds leave open."
        )
        if not per_kg:
            text += " Nobody gave the mass of the person, so that they are not per kg and leave out the leg's inertia."
        sections.append(Section("Moments and powers over the gait cycle", text, drawing=drawn_panels(panels, session_names(sessions))))
    return sections


def _with_load_intervals(
    sides: Sequence[CurvesOfSide], sessions: Sequence[GaitSession], chosen: Collection[int], curve: str, which: int
) -> list[CurvesOfSide]:
    """With what is uncertain of each session's mean: cycles share their joint centres and plates, so that many are no better than one."""
    from asterism.gait import analyses_without_turns

    letters = {side: letter for letter, side in SIDE.items()}
    found = []
    for number, one in enumerate(sides):
        name = letters[one.side] + curve
        # only those in the same unit: see `load_sections`
        own = analyses_without_turns([analysis for analysis in sessions[number // len(SIDE)].analyses if id(analysis) in chosen])
        known = [analysis.load_sigmas[name] for analysis in own if name in analysis.load_sigmas]
        if known and one.cycles:
            half = 1.96 * np.concatenate(known)[:, :, which].mean(axis=0)
            one = replace(one, interval=(one.mean - half, one.mean + half))
        found.append(one)
    return found


def _inwards(loads: Mapping[str, Floats]) -> dict[str, Floats]:
    """Inwards is to the right of the left foot, and to the left of the right one."""
    turned = {name: loads[name] * [1.0, -1.0, 1.0] for name in ("LGroundReactionForce",) if name in loads}
    return {**loads, **turned}


def session_names(sessions: Sequence[GaitSession]) -> tuple[str, str] | None:
    """Of two sessions; None where there is one."""
    return None if len(sessions) < 2 else (sessions[0].name, sessions[1].name)


def _own_cycles(analysis: GaitAnalysis) -> Callable[[str], Sequence[Cycle]]:
    return lambda name: [cycle for cycle in analysis.cycles if cycle.side == name[0]]


def shown_curve(values: Floats, shown: ShownCycle, session: GaitSession) -> CycleCurve:
    """A curve (101,) of a cycle, by its name on the page."""
    counts = session.counts(shown.cycle)
    name = f"{SIDE[shown.cycle.side]}, {shown.name}"
    return CycleCurve(values, name if counts else f"{name}, a turn", shown.place, counts)


def curves_of_sides(sessions: Sequence[GaitSession], of: Mapping[int, Curves], curve: str, which: int) -> list[CurvesOfSide]:
    """One column of a curve of both feet in all sessions; `of`: by the identity of the analysis."""
    found = []
    for number, session in enumerate(sessions):
        for letter, side in SIDE.items():
            cycles, offs = [], []
            for analysis in session.analyses:
                curves = of.get(id(analysis))
                if curves is None or letter + curve not in curves.values:
                    continue
                values, own = curves.values[letter + curve][:, :, which], curves.cycles(letter + curve)
                # Curves that nobody has cycles of are drawn all the same, and lead nowhere.
                places = [session.shown(cycle) for cycle in own] if len(own) == len(values) else [None] * len(values)
                for line, place in zip(values, places, strict=True):
                    cycles.append(CycleCurve(line) if place is None else shown_curve(line, place, session))
                offs += [100 * cycle.off_share for cycle in analysis.cycles if cycle.side == letter and session.counts(cycle)]
            off = float(np.mean(offs)) if offs and any(np.isfinite(one.values).any() for one in cycles) else None
            found.append(CurvesOfSide(side, cycles, off, earlier=len(sessions) > 1 and number == 0))
    return found
