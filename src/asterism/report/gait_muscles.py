"""Sessions in; panels of the muscles' activity over the gait cycle out."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from asterism.recording import Floats
from asterism.recording.display import listed
from asterism.report.cycle_panels import CurvesOfSide, CycleCurve, CyclePanel, drawn_panels
from asterism.report.gait_curves import session_names, shown_curve
from asterism.report.gait_session import SIDE, GaitSession
from asterism.report.page import Section


def muscle_section(sessions: Sequence[GaitSession]) -> list[Section]:
    """Envelopes of muscles, both sides of a muscle in one panel; none where no recording has them."""
    from asterism.gait import EmgRules

    named: dict[str, dict[str, None]] = {}
    channels = [channel for session in sessions for analysis in session.analyses for channel in analysis.emg]
    for channel in channels:
        # Without a side nobody knows which two channels belong together.
        title = channel.muscle if channel.muscle and channel.side else channel.name
        named.setdefault(title, {})[channel.name] = None
    if not named:
        return []
    panels = []
    for title in sorted(named, key=_natural):
        names = list(named[title])
        sides = [one for number, session in enumerate(sessions) for one in _sides(session, names, len(sessions) > 1 and number == 0)]
        panels.append(CyclePanel(title, "%", sides, notes=[", ".join(names)] if names != [title] else []))
    rules, told = EmgRules(), dict.fromkeys(channel.told_by for channel in channels)
    text = (
        f"Linear envelopes: band-pass {rules.low:g} to {rules.high:g} Hz, rectified, low-pass {rules.smooth:g} Hz. 100 % is the highest "
        "point of the mean over the cycles of the channel in its session: heights tell nothing from muscle to muscle or from day to day. "
        f"Channels count as muscles where they are in volts and there is {' or '.join(told)}."
    )
    if known := [channel.spread for channel in channels if channel.spread is not None]:
        text += f" The envelope of one cycle is certain to {100 * float(np.median(known)):.0f} % of its height (one standard uncertainty)."
    if any(channel.side is None for channel in channels):
        text += " The files do not say which side some of them are of; these are drawn over the cycles of both feet."
        text += " --emg EMG1=LRF names them."
    if rectified := list(dict.fromkeys(channel.name for channel in channels if channel.rectified)):
        text += f" The files hold {listed(rectified)} rectified, so that the band-pass is left out there."
    drawing = drawn_panels(panels, session_names(sessions), "mean ± 1 SD of the cycles")
    return [Section("Muscle activity over the gait cycle", text, drawing=drawing)]


def _sides(session: GaitSession, names: Collection[str], earlier: bool) -> list[CurvesOfSide]:
    """The cycles of both feet of the channels with these names, % of their peaks."""
    from asterism.gait import analyses_without_turns
    from asterism.gait.emg import peak

    own = [(analysis, channel) for analysis in session.analyses for channel in analysis.emg if channel.name in names]
    counted = [channel for analysis in analyses_without_turns(session.analyses) for channel in analysis.emg]
    highest = {name: peak([channel for channel in counted if channel.name == name]) for name in names}
    found = []
    for letter, side in SIDE.items():
        cycles, offs = [], []
        for analysis, channel in own:
            feet = [cycle for cycle in analysis.cycles if cycle.side == letter]
            # A muscle that is silent throughout has no height to compare with.
            if letter not in channel.cycles or not highest[channel.name] > 0:
                continue
            for curve, cycle in zip(channel.cycles[letter], feet, strict=True):
                values, shown = 100 * curve / highest[channel.name], session.shown(cycle)
                cycles.append(CycleCurve(values) if shown is None else shown_curve(values, shown, session))
                offs += [100 * cycle.off_share] if session.counts(cycle) else []
        found.append(CurvesOfSide(side, cycles, float(np.mean(offs)) if offs else None, _spread(cycles), earlier))
    return found


def _spread(cycles: Sequence[CycleCurve]) -> tuple[Floats, Floats] | None:
    """Mean less and more one standard deviation of the cycles, which never are below zero; None for a single one."""
    counted = [one for one in cycles if one.counts]
    if len(counted) < 2:
        return None
    every = np.stack([one.values for one in counted])
    mean, deviation = every.mean(axis=0), every.std(axis=0, ddof=1)
    return np.maximum(mean - deviation, 0.0), mean + deviation


def _natural(name: str) -> list[tuple[int, str]]:
    """By which EMG2 comes before EMG10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]
