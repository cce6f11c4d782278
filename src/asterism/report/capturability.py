"""The capturability of a marker set in; a page that says whether it can be labelled, and what would help, out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, percent, tinted, write_page

if TYPE_CHECKING:
    from asterism.labelling import Capturability


def capturability_report(path: str | Path, capturability: Capturability, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on a marker set's capturability; `settings` (files, seed, ...) stand at its foot.

    Raises AsterismError where the file cannot be written.
    """
    names = list(capturability.markers)
    rates = np.asarray(capturability.hit_rates, dtype=np.float64)
    confusion = np.asarray(capturability.confusion, dtype=np.float64)
    sections = [
        Section(
            "Which marker could be taken for which",
            "The share of frames in which the point of the row's marker could also be the column's marker when a third of the labels are "
            "known. White: never.",
            figure=figures.matrix(names, confusion),
            table=_pairs(names, confusion),
        ),
        _hidden_markers(capturability, names),
        Section(
            "Markers that the full solver does not find, nothing hidden",
            "" if (rates < 1.0).any() else "It finds each marker in every frame.",
            figure=figures.bars(names, 1.0 - rates, "not found (100 % less the hit rate)") if (rates < 1.0).any() else None,
            table=Table(
                ["marker", "hit rate", "taken for"],
                [[name, percent(float(rates[i]), 3), _taken_for(names, confusion, i)] for i, name in enumerate(names)],
            ),
            folded=True,
        ),
    ]
    # The largest gain first.
    if capturability.changes:
        ordered = sorted(capturability.changes, key=lambda c: c.hit_rate_before - c.hit_rate_after)
        sections.append(
            Section(
                "What one change would do",
                "The best change comes first. Where a marker is dropped, the hit rate is that of the markers that remain.",
                table=Table(["change", "marker", "how", "hit rate before", "after", "gain"], [_change(c) for c in ordered], left=3),
            )
        )
    sections += _thesis_sections(capturability)
    merits = [(str(len(names)), "markers", "")]
    if len(rates):
        merits.append((percent(float(rates.mean()), 2), "hit rate of the full solver, nothing hidden", ""))
        name, rate = _worst(names, rates, digits=2)
        merits.append((rate, f"hit rate of {name}, the worst", ""))
    if capturability.by_occlusions:
        hidden, together, _ = capturability.by_occlusions[-1]
        merits.append((percent(float(together), 2), f"hit rate with {hidden} hidden", ""))
    write_page(
        path, Page("Can this marker set be labelled?", f"{capturability.verdict} {capturability.judged}", settings or {}, merits, sections)
    )


def _thesis_sections(capturability: Capturability) -> list[Section]:
    """The thesis' figure 5.2, table 5.1 and figure 5.1 of this marker set, as far as they were examined."""
    sections = []
    if capturability.by_target:
        rates = capturability.by_target
        lines = {
            f"{hidden} hidden": (
                [one.false_assignments for one in rates if one.hidden == hidden],
                [one.false_occlusions for one in rates if one.hidden == hidden],
            )
            for hidden in sorted({one.hidden for one in rates})
        }
        rows: list[list[str | Cell]] = [
            [percent(one.target, 3), str(one.hidden), percent(one.false_assignments, 3), percent(one.false_occlusions, 2)] for one in rates
        ]
        sections.append(
            Section(
                "Wrong labels against missing ones",
                "Each line is a number of hidden markers, each point a target hit rate of the partial solvers (thesis, figure 5.2). "
                "The higher the target, the fewer labels are wrong, and the more markers in sight are taken for hidden.",
                figure=figures.trade_off(lines),
                table=Table(["target hit rate", "hidden", "wrong, of the labels given", "in view, of those without a label"], rows),
                folded=True,
            )
        )
    if capturability.first_classifiers:
        together, listed = 0.0, []
        for number, chosen in enumerate(capturability.first_classifiers, start=1):
            # Each score counts what no classifier before it rejected, so they add up.
            together += chosen.score
            listed.append([str(number), chosen.description, percent(chosen.score, 2), percent(together, 2)])
        sections.append(
            Section(
                "What tells a right labelling from a wrong one",
                "The weak classifiers that boosting chooses first, and the share of wrong labellings that each rejects and none before it "
                "does (thesis, table 5.1). Below: what more of them gain, and the evaluations until the first feasible labelling "
                "(thesis, figure 5.1).",
                figure=figures.effort([(one.classifiers, one.accuracy, one.evaluations) for one in capturability.solver_sizes]),
                table=Table(["", "weak classifier", "score", "sum"], listed, left=2),
                folded=True,
            )
        )
    return sections


def _hidden_markers(capturability: Capturability, names: list[str]) -> Section:
    """How the hit rate falls with the number of hidden markers."""
    rows = [
        [str(hidden), percent(float(rate), 3), *_worst(names, np.asarray(each, dtype=np.float64))]
        for hidden, rate, each in capturability.by_occlusions
    ]
    return Section(
        "With markers hidden",
        "The share of the markers in sight that partial solvers find while others are hidden. Grey: each marker. Thick line: all markers "
        "together. The full solver needs all markers; where none is hidden, it finds more.",
        figure=_hit_rate_curves(capturability),
        table=Table(["hidden", "hit rate", "worst marker", "its hit rate"], rows),
    )


def _worst(names: list[str], rates: np.ndarray, digits: int = 3) -> tuple[str, str]:
    """The marker with the lowest hit rate that is known, and that rate."""
    # Where all are hidden none has a rate.
    if np.isnan(rates).all():
        return NOTHING, NOTHING
    place = int(np.nanargmin(rates))
    return names[place], percent(float(rates[place]), digits)


def _pairs(names: list[str], confusion: np.ndarray) -> Table:
    """The ten most confused pairs."""
    # A marker taken for itself is no confusion.
    off = confusion.copy()
    np.fill_diagonal(off, 0.0)
    order = np.argsort(-off, axis=None, kind="stable")[:10]
    pairs = [divmod(int(place), len(names)) for place in order if off.flat[place] > 0]
    rows: list[list[str | Cell]] = [[names[a], names[b], tinted(float(off[a, b]), 3, max(float(off.max()), 0.01))] for a, b in pairs]
    return Table(["the point of", "could be taken for", "share of frames"], rows or [["no marker", "any other", percent(0.0)]], left=2)


def _taken_for(names: list[str], confusion: np.ndarray, row: int) -> str:
    others = [(float(share), name) for j, (share, name) in enumerate(zip(confusion[row], names, strict=True)) if j != row and share > 0]
    return ", ".join(f"{name} {percent(share, 2)}" for share, name in sorted(others, reverse=True)[:3]) or "no other"


def _hit_rate_curves(capturability: Capturability) -> figures.Figure:
    hidden = [entry[0] for entry in capturability.by_occlusions]
    each = {name: (hidden, [entry[2][m] for entry in capturability.by_occlusions]) for m, name in enumerate(capturability.markers)}
    together = {"all markers": (hidden, [entry[1] for entry in capturability.by_occlusions])}
    return figures.curves({**each, **together}, "hidden markers", "hit rate", faint=list(each))


def _change(change: Any) -> list[str | Cell]:
    gain = float(change.hit_rate_after - change.hit_rate_before)
    return [
        change.action,
        change.marker,
        change.description,
        percent(change.hit_rate_before, 3),
        percent(change.hit_rate_after, 3),
        f"{100 * gain:+.3f} points",
    ]
