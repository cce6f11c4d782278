"""Analysed walks in; a page that a clinician reads from the top, out: the person, parameters, curves, quality, and the recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Severity
from asterism.recording.display import counted
from asterism.recording.shares import SURE
from asterism.report.gait_curves import angle_section, load_sections
from asterism.report.gait_muscles import muscle_section
from asterism.report.gait_session import SIDE, GaitSession
from asterism.report.gait_steps import drawn_steps
from asterism.report.gait_tables import comparison_section, cycle_section, parameter_section, person_section, score_sections, usual_score
from asterism.report.page import Cell, Page, Section, Table, decimal, percent, write_page
from asterism.report.player import ShownRecording, pack_recordings
from asterism.report.recording import label_confidence, labelling_by_names, named_columns

if TYPE_CHECKING:
    from asterism.gait import Band, GaitAnalysis
    from asterism.recording import ForcePlate, Recording

_LEFT_OUT = "kinetics-step"
"""The code of a step on a force plate that moments and powers cannot use."""


def gait_report(
    path: str | Path,
    results: Sequence[tuple[str, GaitAnalysis]],
    *,
    band: Band | None = None,
    title: str = "Gait report",
    compare: Sequence[tuple[str, GaitAnalysis]] = (),
    sessions: tuple[str, str] = ("before", "after"),
) -> None:
    """Write an HTML page on analysed walks (name, analysis).

    Cycles of all walks of a session stand side by side in each panel, so give walks of one person in one condition.

    band      of controls, drawn grey behind the curves; scores say how far the person is from it
    compare   walks of a second session, whose parameters and curves stand beside the first one's; the sessions have these names

    Raises AsterismError where the page cannot be written.
    """
    first = GaitSession(sessions[0] if compare else "", results)
    second = GaitSession(sessions[1], compare, len(results)) if compare else None
    both = [first] if second is None else [first, second]
    sections = [
        person_section(both),
        parameter_section(first, band) if second is None else comparison_section(first, second, band),
        *angle_section(both, band),
        *load_sections(both),
        *muscle_section(both),
        *score_sections(both, band),
        _quality(both),
        *_findings(both),
        *_filled(both),
        *([] if not any(one.cycles for one in both) else [cycle_section(both)]),
        *_events(both),
        _player(both),
    ]
    recordings = sum(len(one.results) for one in both)
    where = "on a treadmill" if all(analysis.walking.treadmill for one in both for analysis in one.analyses) else "over the floor"
    lead = f"{sum(len(one.cycles) for one in both)} gait cycles in {counted(recordings, 'recording')}, {where}."
    if turns := sum(shown.cycle.turns for one in both for shown in one.cycles):
        lead += f" In {turns} of them the person turns: "
        lead += "means are of turns." if any(one.all_turn for one in both) else "these are drawn pale and are in no mean."
    lead += f" Two sessions: {first.name} and {second.name}." if second is not None else ""
    lead += " Left is red and drawn through, right is blue and dashed."
    names = ", ".join(name for one in both for name, _ in one.results)
    write_page(path, Page(title, lead, {"recordings": names}, _merits(both, band), sections))


def _merits(sessions: Sequence[GaitSession], band: Band | None) -> list[tuple[str, str, str]]:
    """Speed, cadence, cycles of each side, and how far the person is from a band, in one line at the top."""
    from asterism.gait import profile_scores

    def told(of: Callable[[GaitSession], str], name: str, kind: str = "") -> tuple[str, str, str]:
        return " → ".join(map(of, sessions)), name, kind

    def mean(name: str, digits: int) -> Callable[[GaitSession], str]:
        return lambda session: decimal(float(np.mean([*session.values(name)] or [np.nan])), digits)

    def cycles(session: GaitSession) -> str:
        return " | ".join(str(sum(one.cycle.side == side and session.counts(one.cycle) for one in session.cycles)) for side in "LR")

    def gps(side: str) -> Callable[[GaitSession], str]:
        def score(session: GaitSession) -> str:
            scores = {} if band is None else {score.side: score.gps for score in profile_scores(session.analyses, band)}
            return decimal(float(np.degrees(scores.get(side, np.nan))), 1, "°")

        return score

    usual = None if band is None else usual_score(band)
    controls = "" if usual is None else f"; controls {usual[1]:.1f}°"
    few = any(count == "0" for session in sessions for count in cycles(session).split(" | "))
    return [
        told(mean("walking speed", 2), "walking speed, m/s"),
        told(mean("cadence", 0), "cadence, steps/min"),
        told(cycles, "cycles left | right", "warn" if few else ""),
        *([] if band is None else [told(gps(letter), f"Gait Profile Score, {side}{controls}") for letter, side in SIDE.items()]),
    ]


def _quality(sessions: Sequence[GaitSession]) -> Section:
    """What the numbers rest on, a row for each recording, and when which foot was on the floor."""
    from asterism.motion.filters import last_filter
    from asterism.recording import filled_samples

    rows: list[list[str | Cell]] = []
    for session in sessions:
        for number, (name, analysis) in enumerate(session.results):
            recording, events = analysis.recording, analysis.walking.events
            shown = recording.visible[:, named_columns(recording)]
            filled = filled_samples(recording)[:, named_columns(recording)]
            share = float(np.isfinite(filled).mean()) if filled.size else float("nan")
            missing = 1.0 - float(shown.mean()) if shown.size else float("nan")
            by_plates = sum(event.source.startswith("plate") for event in events)
            left_out = sum(finding.code == _LEFT_OUT for finding in analysis.findings)
            largest = f", up to ± {1000 * float(np.nanmax(filled)):.1f} mm" if np.isfinite(filled).any() else ""
            rows.append(
                [
                    Cell(name, place=(session.offset + number, 0, max(len(recording) - 1, 0))),
                    _labels(recording),
                    Cell(percent(missing), min(np.sqrt(missing) if np.isfinite(missing) else 0.0, 1.0)),
                    percent(share, 1) + largest,
                    f"{last_filter(recording).choice.method} {last_filter(recording).span}",
                    f"{len(events) - by_plates} | {by_plates}",
                    Cell(str(left_out), 0.6 if left_out else 0.0),
                    " | ".join(str(sum(cycle.side == side for cycle in analysis.cycles)) for side in "LR"),
                ]
            )
    head = [
        "recording",
        "labels",
        "samples missing",
        "samples filled",
        "filter",
        "events by markers | plates",
        "steps on plates left out",
        "cycles left | right",
    ]
    text = (
        "Labels without a confidence are taken as the files have them. A step on a plate is left out where it is not one foot alone, or "
        "not the whole foot."
    )
    return Section("Quality", text, table=Table(head, rows, left=2), drawing=drawn_steps(sessions))


def _labels(recording: Recording) -> str | Cell:
    """How many labels are certain, where the file says it of each."""
    confidence = label_confidence(recording)
    named = named_columns(recording)
    if confidence is None:
        return "as in the file"
    certain = confidence[:, named][recording.visible[:, named]]
    share = float((certain >= SURE).mean()) if certain.size else float("nan")
    return Cell(f"{percent(share)} certain ({percent(SURE, 0)} or more)", min(1.0, 10 * (1 - share)) if share < 1 else 0.0)


def _filled(sessions: Sequence[GaitSession]) -> list[Section]:
    """Markers whose gaps were filled, and how far that makes angles uncertain; none where nothing was filled."""
    from asterism.recording import filled_samples

    rows: list[list[str | Cell]] = []
    largest = 0.0
    for session in sessions:
        for number, (name, analysis) in enumerate(session.results):
            deviation = filled_samples(analysis.recording)
            filled = np.isfinite(deviation)
            for column in np.flatnonzero(filled.any(axis=0)):
                most = 1000.0 * float(np.nanmax(deviation[:, column]))
                frames = np.flatnonzero(filled[:, column])
                place = (session.offset + number, int(frames[0]), int(frames[-1]))
                label = analysis.recording.labels[column]
                rows.append([name, label, Cell(f"{len(frames)} of {len(deviation)}", place=place), f"{most:.1f}"])
            largest = max([largest, *(float(np.degrees(np.nanmax(one, initial=0.0))) for one in analysis.fill_sigmas.values())])
    if not rows:
        return []
    text = (
        "These markers were not seen in some frames; their places there follow from other markers. "
        f"That makes the angles of the cycles above uncertain by up to {largest:.1f}° (standard deviation), and is part of the ± of events."
    )
    return [Section("Filled markers", text, table=Table(["recording", "marker", "frames", "± mm"], rows, left=2), folded=True)]


def _findings(sessions: Sequence[GaitSession]) -> list[Section]:
    """What was found out, once for all recordings that it is true of."""
    of: dict[tuple[str, str], list[str]] = {}
    steps: list[list[str | Cell]] = []
    severe: dict[tuple[str, str], bool] = {}
    for session in sessions:
        for name, analysis in session.results:
            file = str(analysis.recording.metadata.get("file", "the recording"))
            for finding in analysis.findings:
                if finding.code == _LEFT_OUT:
                    steps.append([name, finding.sentence.removeprefix(f"{file}: "), finding.mend])
                    continue
                # The recording stands in a column of its own: paths would push the rest out of view.
                what = finding.sentence.removeprefix(f"{file}: ").replace(file, "the recording")
                key = (what[:1].upper() + what[1:], finding.mend)
                of.setdefault(key, []).append(name)
                severe[key] = severe.get(key, False) or finding.severity > Severity.NOTE
    rows: list[list[str | Cell]] = []
    for key in sorted(of, key=lambda one: not severe[one]):
        what, mend = key
        names = list(dict.fromkeys(of[key]))
        rows.append([Cell("look at this" if severe[key] else "note", 0.6 if severe[key] else 0.0), what, mend, ", ".join(names)])
    sections = [Section("What to know", table=Table(["", "found", "what to do", "in"], rows, left=4))] if rows else []
    if steps:
        # A treadmill has one of them in each second.
        table = Table(["recording", "step", "what to do"], steps, left=3)
        sections.append(
            Section("Steps on plates left out", "They count in parameters and angles, not in moments and powers.", table=table, folded=True)
        )
    return sections


def _events(sessions: Sequence[GaitSession]) -> list[Section]:
    rows: list[list[str | Cell]] = []
    for session in sessions:
        for number, (name, analysis) in enumerate(session.results):
            rate, last = analysis.recording.rate, len(analysis.recording) - 1
            for event in analysis.walking.events:
                side = "left" if event.side == "L" else "right"
                frame = min(max(round(event.time * rate), 0), last)
                shown = Cell(str(frame + analysis.recording.first_frame), place=(session.offset + number, frame, frame))
                source = f"{event.source}, filled" if event.filled else event.source
                rows.append([name, side, event.label, source, shown, f"{1000 * event.sigma:.0f}"])
    text = "An event on a force plate is told by its load, another by heel, toe and pelvis. ± is one standard uncertainty."
    return [Section("Events", text, table=Table(["recording", "side", "event", "by", "frame", "± ms"], rows, left=4), folded=True)]


def _player(sessions: Sequence[GaitSession]) -> Section:
    """All recordings, with force plates and the cycles of both feet."""
    shown = []
    for session in sessions:
        for name, analysis in session.results:
            recording = analysis.recording
            cycles = [
                ("left" if one.side == "L" else "right", one.strike.time, one.next_strike.time, one.off.time) for one in analysis.cycles
            ]
            start = round(analysis.cycles[0].strike.time * recording.rate) if analysis.cycles else 0
            shown.append(
                ShownRecording(
                    name if not session.name else f"{session.name}: {name}",
                    labelling_by_names(recording, label_confidence(recording)),
                    recording.clouds(),
                    recording.first_frame,
                    start=min(max(start, 0), max(len(recording) - 1, 0)),
                    names_shown="none",
                    plates=[plate for plate in analysis.plates if _as_long(plate, analysis)],
                    cycles=cycles,
                )
            )
    text = "Drag to turn. With the picture in focus, space plays, b plays backwards, and the arrow keys step. "
    text += "Arrows on the plates are the forces of the ground on the feet; the arrow on the floor shows which way the person faces."
    return Section("The recordings", text, player=pack_recordings(shown))


def _as_long(plate: ForcePlate, analysis: GaitAnalysis) -> bool:
    """Whether the plate has a sample for each frame; `inverse_dynamics` says so where it has not."""
    try:
        plate.at(analysis.recording.rate, len(analysis.recording))
    except AsterismError:
        return False
    return True
