"""Parameters of two sessions of one person in; how far they differ, and whether by more than they are certain to, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from asterism.gait.parameters import PARAMETERS, Parameter, ParameterSummary, summarise

PROBABILITY = 0.95
"""Of the interval about a difference, two-sided, as clinical reports state it."""


@dataclass(frozen=True)
class ParameterChange:
    """A parameter of one side, "L" or "R", in two sessions.

    first, second  its summaries
    """

    name: str
    side: str
    first: ParameterSummary
    second: ParameterSummary

    @property
    def difference(self) -> float:
        """Of the means, second less first, in the parameter's unit."""
        return self.second.mean - self.first.mean

    @property
    def interval(self) -> float:
        """Half of the width of the 95 % interval about the difference, in the same unit."""
        parts = [_uncertainty(one) for one in (self.first, self.second)]
        variance = sum(sigma**2 for sigma, _ in parts)
        # Degrees of freedom by Welch and Satterthwaite, as in the GUM, annex G.4: few cycles tell their spread badly.
        weight = sum(sigma**4 / degrees for sigma, degrees in parts)
        degrees = variance**2 / weight if weight > 0 else np.inf
        return float(student.ppf(0.5 + PROBABILITY / 2, degrees) * np.sqrt(variance))

    @property
    def exceeds(self) -> bool:
        """Whether the difference is larger than the interval about it."""
        return abs(self.difference) > self.interval


def _uncertainty(one: ParameterSummary) -> tuple[float, float]:
    """Standard uncertainty of a mean, and its degrees of freedom: by the scatter of its cycles, or by the events where these tell more."""
    by_scatter = one.deviation / np.sqrt(one.count) if one.count > 1 else 0.0
    # The scatter holds what the events add. Where few cycles agree by chance, the events say how far they may be off.
    return (by_scatter, one.count - 1.0) if by_scatter >= one.sigma else (one.sigma, np.inf)


def compare_sessions(first: Sequence[Parameter], second: Sequence[Parameter]) -> list[ParameterChange]:
    """Parameters that both sessions have, in the order of `PARAMETERS`, left before right. O(cycles).

    >>> before, after = ([Parameter("stance", "L", value, 0.5, 0.0, 1.0) for value in values] for values in ((60.0, 61.0), (66.0, 67.0)))
    >>> change = compare_sessions(before, after)[0]
    >>> change.difference, change.exceeds
    (6.0, True)
    """
    of = [{(one.name, one.side): one for one in summarise(parameters)} for parameters in (first, second)]
    keys = [(name, side) for name in PARAMETERS for side in "LR"]
    return [ParameterChange(*key, of[0][key], of[1][key]) for key in keys if key in of[0] and key in of[1]]
