"""Figures: one measured number each, whether it does what was asked, and how it is written."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_COMPARE = {
    "<=": lambda measured, bound: measured <= bound,
    ">=": lambda measured, bound: measured >= bound,
    "<": lambda measured, bound: measured < bound,
    ">": lambda measured, bound: measured > bound,
    "==": lambda measured, bound: measured == bound,
}


@dataclass(frozen=True)
class Figure:
    """One measured number.

    row       what was measured
    asked     the bound that it must keep, such as "<= 0.01", or "none"
    measured  the number
    unit      its unit; "fraction" is shown in percent
    n         how many different samples it comes from: frames, points, files, runs
    """

    row: str
    asked: str
    measured: float
    unit: str
    n: int

    def __post_init__(self) -> None:
        if not (self.unit and self.n > 0 and math.isfinite(self.measured)):
            raise ValueError(f"a figure needs a unit, samples and a finite number: {self}")
        reached(self.asked, self.measured)


def reached(asked: str, measured: float) -> bool | None:
    """Whether a number does what was asked; None where nothing was asked.

    Raises ValueError where `asked` is neither "none" nor a comparison with a number.
    """
    if asked == "none":
        return None
    match = re.fullmatch(r"(<=|>=|<|>|==) (\S+)", asked)
    if not match:
        raise ValueError(f"{asked!r} is no expression such as '<= 0.01'")
    return _COMPARE[match[1]](measured, float(match[2]))


def asked_text(asked: str, unit: str) -> str:
    """The bound as the pages show it; empty where nothing was asked."""
    if asked == "none":
        return ""
    sign, bound = asked.split()
    return f"{sign} {100 * float(bound):.6g} %" if unit == "fraction" else f"{sign} {float(bound):,.6g}"


def measured_text(measured: float, unit: str) -> str:
    """The number with its unit as the pages show it."""
    if unit == "fraction":
        return f"{100 * measured:.{6 if measured > 0.99 else 4}g} %"
    return f"{measured:,.5g} {unit}" if abs(measured) < 1000 else f"{measured:,.0f} {unit}"
