"""Sessions in; tables of the person, of parameters against a band of controls, of two sessions side by side, and of scores, out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.report import figures
from asterism.report.gait_session import SIDE, GaitSession
from asterism.report.page import NOTHING, Cell, Section, Table, decimal

if TYPE_CHECKING:
    from asterism.gait import Band, ParameterSummary, ProfileScore
    from asterism.recording import Recording

_DIGITS = {"m": 3, "s": 3, "m/s": 3, "": 3}
"""Behind the point, by unit; one elsewhere."""
_FAR = 2.0
"""Standard deviations of the controls from which a mean is marked: about one control of twenty is as far."""
_LEADS = '<p class="screen">Click a number: the player below goes to the cycle that is nearest to it.</p>'
_MEASURES = {"leg_length": "leg length", "knee_width": "knee width", "ankle_width": "ankle width"}


def person_section(sessions: Sequence[GaitSession]) -> Section:
    """Who walked, and the measures that the angles rest on, a column for each session."""
    columns = [_person(session) for session in sessions]
    titles = dict.fromkeys(title for column in columns for title in column)
    rows: list[list[str | Cell]] = [[title, *(column.get(title, NOTHING) for column in columns)] for title in titles]
    assumed = any(isinstance(cell, Cell) and "assumed" in cell.text for row in rows for cell in row)
    note = "An assumed measure is an adult's: give the person's own with --measure." if assumed else ""
    return Section("The person", table=Table(["", *(session.name for session in sessions)], rows, left=1 + len(sessions)), note=note)


def _person(session: GaitSession) -> dict[str, str | Cell]:
    people = list(dict.fromkeys(name for one in session.analyses if (name := _name(one.recording))))
    found: dict[str, str | Cell] = {
        "person": Cell(", ".join(people) or NOTHING, 0.6 if len(people) > 1 else 0.0),
        "walks": ", ".join(name for name, _ in session.results),
    }
    clinical = next((one.clinical for one in session.analyses if one.clinical is not None), None)
    mass = None if clinical is None else clinical.subject.mass
    found["body mass"] = NOTHING if mass is None else f"{mass:.1f} kg"
    if clinical is not None:
        walk = next(one.recording for one in session.analyses if one.clinical is clinical)
        found["angles by"] = f"{clinical.model.title(walk)}; hip centres by {clinical.model.hip}"
    # Other models take no widths: their markers stand on both sides of a joint.
    plug_in_gait = clinical is None or clinical.model.name == "plug-in-gait"
    for name, title in _MEASURES.items() if plug_in_gait else ():
        told, doubtful = [], False
        for letter, side in SIDE.items():
            leg = None if clinical is None else clinical.subject.of(letter)
            value = None if leg is None else getattr(leg, name)
            if leg is not None and value is not None:
                known = name in leg.from_file
                doubtful |= not known
                told.append(f"{side} {1000 * value:.0f} mm{'' if known else ', assumed'}")
        found[title] = Cell("; ".join(told) or NOTHING, 0.6 if doubtful else 0.0)
    return found


def _name(recording: Recording) -> str:
    """What the file calls its person, else what its folder does, which is said; nothing of what was not read from a file."""
    subject, file = recording.metadata.get("subject"), Path(str(recording.metadata.get("file") or ""))
    return str(subject) if subject else f"{file.absolute().parent.name} (the folder)" if file.is_file() else ""


def parameter_section(session: GaitSession, band: Band | None) -> Section:
    """Means of both sides, beside those of controls where a band has them."""
    from asterism.gait import PARAMETERS, summarise, symmetries

    of = {(one.name, one.side): one for one in summarise(session.parameters)}
    apart = {one.name: one for one in symmetries(session.parameters)}
    controls = {} if band is None else band.parameters
    rows: list[list[str | Cell]] = []
    for name, unit in PARAMETERS.items():
        own = {side: of.get((name, side)) for side in SIDE}
        if not any(own.values()):
            continue
        digits = _DIGITS.get(unit, 1)
        row: list[str | Cell] = [f"{name}, {unit}" if unit else name]
        row += [_mean(session, one, name, side, controls) for side, one in own.items()]
        if controls:
            usual = controls.get(name)
            row.append(NOTHING if usual is None else f"{usual[0]:.{digits}f} ± {usual[1]:.{digits}f}")
            row.append(Cell("", drawing="" if usual is None else _strip(usual, own)))
        more = apart.get(name)
        row.append("" if more is None else f"{round(more.value, 1) + 0.0:+.1f} ± {more.sigma:.1f}")
        row.append(" | ".join(decimal(one.deviation, digits) if one else NOTHING for one in own.values()))
        rows.append(row)
    text = (
        "Means over the cycles. ± is how exactly strikes and offs tell the mean, one standard uncertainty; SD is the spread of the cycles. "
    )

    head = ["parameter", "left", "right"]
    if controls and band is not None:
        head += [f"{band.people} controls, mean ± SD", "position"]
        text += f" Marked: farther than {_FAR:g} SD from the controls' mean; the grey strip is that wide. A circle is left, a square right."
    elif band is not None:
        text += " The band of controls has no parameters; save it again with --save-band."
    head += ["left more than right, %", "SD left | right"]
    return Section("Parameters", text, table=Table(head, rows), drawing=_LEADS)


def _mean(
    session: GaitSession,
    one: ParameterSummary | None,
    name: str,
    side: str,
    controls: Mapping[str, tuple[float, float]],
    with_sigma: bool = True,
) -> Cell:
    """A mean that leads to the cycle nearest to it; marked where it is far from the controls."""
    if one is None:
        return Cell(NOTHING)
    digits = _DIGITS.get(one.unit, 1)
    typical, usual = session.typical(name, side), controls.get(name)
    far = usual is not None and usual[1] > 0 and abs(one.mean - usual[0]) > _FAR * usual[1]
    place = None if typical is None else typical.place
    certain = f" ± {one.sigma:.{digits}f}" if with_sigma else ""
    return Cell(f"{one.mean:.{digits}f}{certain}", 0.6 if far else 0.0, place=place)


def _strip(usual: tuple[float, float], own: dict[str, ParameterSummary | None]) -> str:
    """Both sides on a strip of the controls' mean ± 2 SD; what is farther off stands at its end."""
    reach = 2 * _FAR
    marks = []
    for letter, one in own.items():
        if one is None or usual[1] <= 0:
            continue
        at = 80 + 75 * float(np.clip((one.mean - usual[0]) / usual[1], -reach, reach)) / reach
        colour = figures.SIDES[SIDE[letter]]["color"]
        shape = f'<circle cx="{at:.1f}" cy="7" r="4"' if letter == "L" else f'<rect x="{at - 3.5:.1f}" y="13" width="7" height="7"'
        marks.append(f'{shape} fill="{colour}"/>')
    half = 75 * _FAR / reach
    grey = f'<rect x="{80 - half:g}" y="2" width="{2 * half:g}" height="20" fill="#64748b" opacity=".25"/>'
    grey += '<path d="M80 1v22" stroke="#64748b"/>'
    return f'<svg class="strip" viewBox="0 0 160 24" aria-hidden="true">{grey}{"".join(marks)}</svg>'


def comparison_section(first: GaitSession, second: GaitSession, band: Band | None) -> Section:
    """Both sessions' parameters, their difference, and whether it is larger than its uncertainty."""
    from asterism.gait import PARAMETERS, compare_sessions

    controls = {} if band is None else band.parameters
    rows: list[list[str | Cell]] = []
    for change in compare_sessions(first.parameters, second.parameters):
        unit = PARAMETERS[change.name]
        digits = _DIGITS.get(unit, 1)
        usual = controls.get(change.name)
        # no minus before a zero
        difference = round(change.difference, digits) + 0.0
        rows.append(
            [
                f"{change.name}, {unit}" if unit else change.name,
                SIDE[change.side],
                _mean(first, change.first, change.name, change.side, controls, with_sigma=False),
                _mean(second, change.second, change.name, change.side, controls, with_sigma=False),
                Cell(f"{difference:+.{digits}f} ± {change.interval:.{digits}f}", 0.6 if change.exceeds else 0.0),
                "yes" if change.exceeds else "no",
                *([] if not controls else [NOTHING if usual is None else f"{usual[0]:.{digits}f} ± {usual[1]:.{digits}f}"]),
            ]
        )
    text = (
        f"Means over the cycles; the difference is {second.name} less {first.name}. The interval behind its ± holds 95 % of the "
        "differences that cycles of one session would show by chance: by their spread and number, or by how exactly strikes and offs are "
        "told where that is more. A difference that exceeds it is one of these walks; shoes, speed and pain of the day are not in it."
    )
    head = ["parameter", "side", first.name, second.name, "difference ± 95 % interval", "exceeds it"]
    return Section(
        "Parameters of two sessions",
        text,
        table=Table([*head, *(["controls, mean ± SD"] if controls else [])], rows, left=2),
        drawing=_LEADS,
    )


def score_sections(sessions: Sequence[GaitSession], band: Band | None) -> list[Section]:
    """Gait Profile Score and its parts, a column for each side of each session; none without a band, or without all nine angles."""
    from asterism.gait import profile_scores
    from asterism.gait.bands import SCORED, other_models

    if band is None:
        return []
    of = {
        (number, score.side): score
        for number, session in enumerate(sessions)
        for score in profile_scores(session.analyses, band, sigmas=True)
    }
    if not of:
        return []
    columns = [(number, side) for number in range(len(sessions)) for side in SIDE]

    def cell(value: float | None, sigma: float | None, digits: int = 1) -> str:
        off = "" if sigma is None else f" ± {decimal(sigma, digits)}"
        return NOTHING if value is None else f"{decimal(value, digits)}{off}"

    def angle(value: float, sigma: float | None) -> str:
        return cell(float(np.degrees(value)), None if sigma is None else float(np.degrees(sigma)))

    def row(title: str, shown: Callable[[ProfileScore], str]) -> list[str | Cell]:
        return [title, *(shown(of[one]) if one in of else NOTHING for one in columns)]

    rows = [row(title, lambda one, title=title: angle(one.variables[title], one.sigmas.get(title))) for _, _, title in SCORED]  # type: ignore[misc]
    rows.append(row("Gait Profile Score", lambda one: angle(one.gps, one.gps_sigma)))
    head = ["angle", *(", ".join(filter(None, (SIDE[side], sessions[number].name))) for number, side in columns)]
    usual = usual_score(band)
    text = (
        f"Degrees from the mean of {band.people} people, root mean square over the cycle (Baker et al. 2009). "
        "± is one standard uncertainty from session to session, by the angles' own."
    )
    if any(score.gdi is not None for score in of.values()):
        rows.append(row("Gait Deviation Index", lambda one: cell(one.gdi, one.gdi_sigma, 0)))
        text += " The index is 100 for the mean of these people, and 10 less for each standard deviation of theirs (GDI*)."
    if usual is not None:
        # What a number is to be held against stands beside it.
        told = {"Gait Profile Score": f"{usual[1]:.1f} ({usual[0]:.1f} to {usual[2]:.1f})", "Gait Deviation Index": "100 (90 to 110)"}
        rows = [[*row, told.get(str(row[0]), "")] for row in rows]
        head.append("controls, mean (± 1 SD)")
        text += " Each of them was held against the others."
    note = other_models([analysis for session in sessions for analysis in session.analyses], band)
    return [Section("Scores", text, table=Table(head, rows), note=note)]


def usual_score(band: Band) -> tuple[float, float, float] | None:
    """degrees: the Gait Profile Score of a band's own people, a standard deviation below the mean, the mean, one above; None if unknown."""
    if band.log_score is None:
        return None
    mean, deviation = band.log_score
    low, middle, high = np.degrees(np.exp([mean - deviation, mean, mean + deviation])).tolist()
    return low, middle, high


def cycle_section(sessions: Sequence[GaitSession]) -> Section:
    """A row for each cycle with all its parameters; its name leads to its frames."""
    from asterism.gait import PARAMETERS

    names = [name for name in PARAMETERS if any(one.name == name for session in sessions for one in session.parameters)]
    turns = any(shown.cycle.turns for session in sessions for shown in session.cycles)
    rows: list[list[str | Cell]] = []
    for session in sessions:
        for number, (_, analysis) in enumerate(session.results):
            values = {(one.side, one.begins, one.name): one.value for one in analysis.parameters}
            for shown in (one for one in session.cycles if one.place[0] == session.offset + number):
                cycle = shown.cycle
                row: list[str | Cell] = [Cell(f"{SIDE[cycle.side]}, {shown.name}", place=shown.place)]
                row += ["turns, in no mean" if not session.counts(cycle) else "turns" if cycle.turns else "straight"] if turns else []
                for name in names:
                    value = values.get((cycle.side, cycle.strike.time, name), float("nan"))
                    row.append(decimal(value, _DIGITS.get(PARAMETERS[name], 1)))
                rows.append(row)
    head = ["cycle", *(["way"] if turns else []), *(f"{name}, {PARAMETERS[name]}" if PARAMETERS[name] else name for name in names)]
    return Section("Each cycle", "A cycle's name leads to its frames.", table=Table(head, rows), folded=True)
