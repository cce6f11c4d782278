"""Sessions in; tables of the person, of parameters against a band of controls, of two sessions side by side, and of scores, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from asterism.report import figures
from asterism.report.gait_session import SIDE, GaitSession
from asterism.report.page import NOTHING, Cell, Section, Table, decimal

if TYPE_CHECKING:
    from asterism.gait import Band, ParameterSummary

_DIGITS = {"m": 3, "s": 2, "m/s": 2, "": 2}
"""Behind the point, by unit; one elsewhere."""
_FAR = 2.0
"""Standard deviations of the controls from which a mean is marked: about one control of twenty is as far."""
_MEASURES = {"leg_length": "leg length", "knee_width": "knee width", "ankle_width": "ankle width"}


def person_section(sessions: Sequence[GaitSession]) -> Section:
    """Who walked, and the measures that the angles rest on."""
    from asterism.recording import subject_of

    rows: list[list[str | Cell]] = []
    assumed = False
    for session in sessions:
        of = f", {session.name}" if session.name else ""
        recordings = [analysis.recording for analysis in session.analyses]
        people = dict.fromkeys(
            str(one.metadata.get("subject") or "") or subject_of(one).replace("\\", "/").rsplit("/", 1)[-1] for one in recordings
        )
        rows.append([f"person{of}", Cell(", ".join(people) or NOTHING, 0.6 if len(people) > 1 else 0.0), ""])
        rows.append([f"walks{of}", ", ".join(name for name, _ in session.results), ""])
        clinical = next((one.clinical for one in session.analyses if one.clinical is not None), None)
        if clinical is None:
            continue
        subject = clinical.subject
        rows.append([f"body mass{of}", NOTHING if subject.mass is None else f"{subject.mass:.1f} kg", ""])
        for name, title in _MEASURES.items():
            cells: list[str | Cell] = []
            for letter in SIDE:
                leg = subject.of(letter)
                value = getattr(leg, name)
                known = name in leg.from_file
                assumed |= value is not None and not known
                text = NOTHING if value is None else f"{SIDE[letter]} {1000 * value:.0f} mm{'' if known else ', assumed'}"
                cells.append(Cell(text, 0.0 if known or value is None else 0.6))
            rows.append([title + of, *cells])
    note = "An assumed measure is an adult's: give the person's own with --measure." if assumed else ""
    return Section("The person", table=Table(["", "", ""], rows, left=3), note=note)


def parameter_section(session: GaitSession, band: Band | None) -> Section:
    """Means of both sides, beside those of controls where a band has them."""
    from asterism.gait import PARAMETERS, summarise

    of = {(one.name, one.side): one for one in summarise(session.parameters)}
    controls = {} if band is None else band.parameters
    rows: list[list[str | Cell]] = []
    for name, unit in PARAMETERS.items():
        own = {side: of.get((name, side)) for side in SIDE}
        if not any(own.values()):
            continue
        digits = _DIGITS.get(unit, 1)
        row: list[str | Cell] = [f"{name}, {unit}" if unit else name]
        for side, one in own.items():
            row += [_mean(session, one, name, side, controls), decimal(one.deviation, digits) if one else NOTHING]
        if controls:
            usual = controls.get(name)
            row.append(NOTHING if usual is None else f"{usual[0]:.{digits}f} ± {usual[1]:.{digits}f}")
            row.append(Cell("", drawing="" if usual is None else _strip(usual, own)))
        rows.append(row)
    text = (
        "Means over the cycles. ± is how exactly strikes and offs tell the mean, one standard uncertainty; SD is the spread of the cycles. "
    )
    text += "A number leads to the cycle that is nearest to it."
    head = ["parameter", "left", "SD", "right", "SD"]
    if controls and band is not None:
        head += [f"{band.people} controls, mean ± SD", "against the controls"]
        text += f" Marked: farther than {_FAR:g} SD from the controls' mean; the grey strip is that wide."
    elif band is not None:
        text += " The band of controls has no parameters; save it again with --save-band."
    return Section("Parameters", text, table=Table(head, rows))


def _mean(
    session: GaitSession, one: ParameterSummary | None, name: str, side: str, controls: Mapping[str, tuple[float, float]] | None = None
) -> Cell:
    if one is None:
        return Cell(NOTHING)
    digits = _DIGITS.get(one.unit, 1)
    typical, usual = session.typical(name, side), (controls or {}).get(name)
    far = usual is not None and usual[1] > 0 and abs(one.mean - usual[0]) > _FAR * usual[1]
    place = None if typical is None else typical.place
    return Cell(f"{one.mean:.{digits}f} ± {one.sigma:.{digits}f}", 0.6 if far else 0.0, place=place)


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
        rows.append(
            [
                f"{change.name}, {unit}" if unit else change.name,
                SIDE[change.side],
                _mean(first, change.first, change.name, change.side, controls),
                str(change.first.count),
                _mean(second, change.second, change.name, change.side, controls),
                str(change.second.count),
                Cell(f"{change.difference:+.{digits}f}", 0.6 if change.exceeds else 0.0),
                f"{change.interval:.{digits}f}",
                "yes" if change.exceeds else "no",
                *([] if not controls else [NOTHING if usual is None else f"{usual[0]:.{digits}f} ± {usual[1]:.{digits}f}"]),
            ]
        )
    text = (
        f"Means over n cycles, and {second.name} less {first.name}. The interval holds 95 % of the differences that cycles of one session "
        "would show by chance: by their spread and number, or by how exactly strikes and offs are told where that is more. A difference "
        "that exceeds it is one of these walks; shoes, speed and pain of the day are not in it. A number leads to the cycle nearest to it."
    )
    head = ["parameter", "side", first.name, "n", second.name, "n", "difference", "± 95 %", "exceeds it"]
    return Section("Parameters of two sessions", text, table=Table([*head, *(["controls, mean ± SD"] if controls else [])], rows, left=2))


def score_sections(sessions: Sequence[GaitSession], band: Band | None) -> list[Section]:
    """Gait Profile Score and its parts, a column for each side of each session; none without a band, or without all nine angles."""
    from asterism.gait import profile_scores
    from asterism.gait.bands import SCORED

    if band is None:
        return []
    of = {(number, score.side): score for number, session in enumerate(sessions) for score in profile_scores(session.analyses, band)}
    if not of:
        return []
    columns = [(number, side) for number in range(len(sessions)) for side in SIDE]
    rows: list[list[str | Cell]] = [
        [title, *(decimal(float(np.degrees(of[one].variables[title])), 1) if one in of else NOTHING for one in columns)]
        for _, _, title in SCORED
    ]
    rows.append(["Gait Profile Score", *(decimal(float(np.degrees(of[one].gps)), 1) if one in of else NOTHING for one in columns)])
    head = ["angle", *(", ".join(filter(None, (SIDE[side], sessions[number].name))) for number, side in columns)]
    text = f"Degrees from the mean of {band.people} people, root mean square over the cycle (Baker et al. 2009)."
    return [Section("Scores", text, table=Table(head, rows))]


def cycle_section(sessions: Sequence[GaitSession]) -> Section:
    """A row for each cycle with all its parameters; its name leads to its frames."""
    from asterism.gait import PARAMETERS

    names = [name for name in PARAMETERS if any(one.name == name for session in sessions for one in session.parameters)]
    rows: list[list[str | Cell]] = []
    for session in sessions:
        for number, (_, analysis) in enumerate(session.results):
            values = {(one.side, one.begins, one.name): one.value for one in analysis.parameters}
            for shown in (one for one in session.cycles if one.place[0] == session.offset + number):
                cycle = shown.cycle
                row: list[str | Cell] = [Cell(f"{SIDE[cycle.side]}, {shown.name}", place=shown.place)]
                for name in names:
                    value = values.get((cycle.side, cycle.strike.time, name), float("nan"))
                    row.append(decimal(value, _DIGITS.get(PARAMETERS[name], 1)))
                rows.append(row)
    head = ["cycle", *(f"{name}, {PARAMETERS[name]}" if PARAMETERS[name] else name for name in names)]
    return Section("Each cycle", "A cycle's name leads to its frames.", table=Table(head, rows), folded=True)
