"""Analysed walks of one person on one day in; their cycles and parameters, each with the frames that it came from, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from asterism.report.figures import SIDES

if TYPE_CHECKING:
    from asterism.gait import Cycle, GaitAnalysis, Parameter

SIDE = dict(zip("LR", SIDES, strict=True))
"""Names of the sides by their letters."""


@dataclass(frozen=True)
class ShownCycle:
    """A cycle with its name on the page ("walk 2, cycle 1") and its place: recording of the player, first and last frame."""

    cycle: Cycle
    name: str
    place: tuple[int, int, int]


@dataclass(frozen=True)
class GaitSession:
    """Walks (name, analysis) of one session, which has no name where it is the only one.

    offset  the number of its first recording in the page's player
    """

    name: str
    results: Sequence[tuple[str, GaitAnalysis]]
    offset: int = 0

    @property
    def analyses(self) -> list[GaitAnalysis]:
        """Of all walks."""
        return [analysis for _, analysis in self.results]

    @cached_property
    def all_turn(self) -> bool:
        """Whether the person turns in each cycle, so that all count."""
        return all(cycle.turns for analysis in self.analyses for cycle in analysis.cycles)

    def counts(self, cycle: Cycle) -> bool:
        """Whether a cycle is in means and scores."""
        return self.all_turn or not cycle.turns

    @property
    def parameters(self) -> list[Parameter]:
        """Of all cycles of all walks."""
        return [parameter for analysis in self.analyses for parameter in analysis.parameters]

    def values(self, name: str) -> list[float]:
        """Of a parameter, of the cycles of both sides that count."""
        from asterism.gait import without_turns

        return [one.value for one in without_turns(self.parameters) if one.name == name]

    @cached_property
    def cycles(self) -> list[ShownCycle]:
        """Of all walks."""
        found = []
        for number, (name, analysis) in enumerate(self.results):
            count = {side: 0 for side in SIDE}
            for cycle in analysis.cycles:
                count[cycle.side] += 1
                last = len(analysis.recording) - 1
                frames = [min(max(round(event.time * analysis.recording.rate), 0), last) for event in (cycle.strike, cycle.next_strike)]
                found.append(ShownCycle(cycle, f"{name}, cycle {count[cycle.side]}", (self.offset + number, frames[0], frames[1])))
        return found

    def shown(self, cycle: Cycle) -> ShownCycle | None:
        """What the page calls a cycle of an analysis, and where it is; None for one of another analysis."""
        return next((one for one in self.cycles if one.cycle is cycle), None)

    def typical(self, name: str, side: str) -> ShownCycle | None:
        """The cycle of a side in which a parameter is nearest to its mean: the frames to look at for the mean."""
        from asterism.gait import analyses_without_turns

        values = []
        for analysis in analyses_without_turns(self.analyses):
            of_cycle = {(cycle.side, cycle.strike.time): cycle for cycle in analysis.cycles}
            values += [
                (one.value, of_cycle.get((one.side, one.begins))) for one in analysis.parameters if (one.name, one.side) == (name, side)
            ]
        if not values:
            return None
        mean = sum(value for value, _ in values) / len(values)
        cycle = min(values, key=lambda one: abs(one[0] - mean))[1]
        return None if cycle is None else self.shown(cycle)
