"""What a demo promises and what it measured: one table, and one finding for each criterion that was missed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.findings import Finding, Severity

if TYPE_CHECKING:
    from asterism.simulation.pipeline import Criterion


def criterion_row(criterion: Criterion) -> list[str]:
    """Name, measured, promised, and whether it was kept."""
    return [criterion.name, _value(criterion.measured, criterion.unit), _promised(criterion), "kept" if criterion.met else "MISSED"]


def print_criteria(criteria: Iterable[Criterion], seconds: float) -> None:
    """The table of a demo that took so many seconds."""
    _console.table(
        f"Results against the truth ({seconds:.0f} s)",
        ["", "measured", "promised", ""],
        [criterion_row(criterion) for criterion in criteria],
    )


def missed_criteria(criteria: Iterable[Criterion]) -> list[Finding]:
    """A finding for each criterion that was missed."""
    return [
        Finding(
            "demo-criterion-missed",
            Severity.WARNING,
            criterion.name,
            f"{criterion.name}: {_value(criterion.measured, criterion.unit)}, promised {_promised(criterion)}.",
            "Run another --seed; where that misses too, report it as a defect.",
        )
        for criterion in criteria
        if not criterion.met
    ]


def _promised(criterion: Criterion) -> str:
    return f"{'≥' if criterion.at_least else '≤'} {_value(criterion.limit, criterion.unit)}"


def _value(value: float, unit: str) -> str:
    from asterism.recording.display import significant

    return f"{significant(value, 4)} {unit}".strip()
