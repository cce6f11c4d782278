"""Sessions in; when which foot was on the floor and on a force plate, a strip for each recording, as SVG, out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from asterism.report.figures import SIDES
from asterism.report.gait_session import SIDE, GaitSession

if TYPE_CHECKING:
    from asterism.gait import GaitAnalysis

_WIDTH, _LEFT, _ROW = 1000, 60, 16
"""Units of a strip, about pixels: its width, where the time begins, and the height of a row."""
_USED, _LEFT_OUT = "#12805c", "#b8c1d0"


def drawn_steps(sessions: Sequence[GaitSession]) -> str:
    """A strip for each recording; a step leads to its frames."""
    strips = [
        _strip(name, session.offset + number, analysis)
        for session in sessions
        for number, (name, analysis) in enumerate(session.results)
        if len(analysis.recording) and analysis.walking.events
    ]
    if not strips:
        return ""
    keys = [(SIDES["left"]["color"], "left foot on the floor"), (SIDES["right"]["color"], "right foot on the floor")]
    keys += [key for key in ((_USED, "on a force plate, used"), (_LEFT_OUT, "on a force plate, left out")) if key[0] in "".join(strips)]
    legend = "".join(
        f'<span><svg viewBox="0 0 26 12"><rect width="26" height="10" fill="{colour}"/></svg>{text}</span>' for colour, text in keys
    )
    return f'<div class="keys">{legend}</div>\n<div class="steps">\n{"".join(strips)}</div>'


def _strip(name: str, number: int, analysis: GaitAnalysis) -> str:
    recording = analysis.recording
    per_second = (_WIDTH - _LEFT) / max(len(recording) / recording.rate, 1e-9)
    last = len(recording) - 1

    def bar(row: int, begins: float, ends: float, colour: str, said: str) -> str:
        frames = [min(max(round(time * recording.rate), 0), last) for time in (begins, ends)]
        x, wide = _LEFT + per_second * begins, max(per_second * (ends - begins), 1.0)
        title = f"<title>{escape(said)}, frames {frames[0] + recording.first_frame} to {frames[1] + recording.first_frame}</title>"
        return (
            f'<rect x="{x:.1f}" y="{row * _ROW + 2}" width="{wide:.1f}" height="{_ROW - 4}" fill="{colour}" '
            f'data-go="{number}:{frames[0]}:{frames[1]}">{title}</rect>'
        )

    bars = [
        bar(row, strike, off, SIDES[side]["color"], f"{side} foot on the floor")
        for row, (letter, side) in enumerate(SIDE.items())
        for strike, off in _stances(analysis, letter)
    ]
    plates = [
        bar(2, begins, ends, _USED if used else _LEFT_OUT, f"plate {plate}, {'used' if used else 'left out'}")
        for plate, begins, ends, used in _contacts(analysis)
    ]
    names = [*SIDE.values(), *(["plates"] if plates else [])]
    words = "".join(f'<text x="{_LEFT - 8}" y="{row * _ROW + 12}" text-anchor="end">{word}</text>' for row, word in enumerate(names))
    return (
        f'<figure><figcaption>{escape(name)}</figcaption><svg viewBox="0 0 {_WIDTH} {_ROW * len(names)}" role="img" '
        f'aria-label="{escape(name)}: {len(bars)} steps">{words}{"".join(bars)}{"".join(plates)}</svg></figure>\n'
    )


def _stances(analysis: GaitAnalysis, side: str) -> Iterator[tuple[float, float]]:
    """From each strike of a foot to its off, s."""
    from asterism.gait.events import OFF, STRIKE

    own = [event for event in analysis.walking.events if event.side == side]
    for one, other in pairwise(own):
        if (one.label, other.label) == (STRIKE, OFF):
            yield one.time, other.time


def _contacts(analysis: GaitAnalysis) -> Iterator[tuple[int, float, float, bool]]:
    """Each load on a plate: the plate, from and to s, and whether it counts in moments and powers."""
    from asterism.gait import plate_contacts

    recording, kinetics = analysis.recording, analysis.kinetics
    for contact in plate_contacts(recording, analysis.walking.feet, analysis.plates):
        ground = None if kinetics is None or contact.side is None else kinetics.ground.get(f"{contact.side}GroundReactionForce")
        middle = min(round(0.5 * (contact.begins + contact.ends) * recording.rate), len(recording) - 1)
        yield contact.plate, contact.begins, contact.ends, ground is not None and bool(np.isfinite(ground[middle]).all())
