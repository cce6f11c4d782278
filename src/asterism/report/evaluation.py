"""An evaluation in; out comes a page with its tables (laid out as the thesis' 5.3 to 5.5) and curves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.report import figures
from asterism.report.page import Cell, Page, Section, Table, count, percent, tinted, write_page

if TYPE_CHECKING:
    from asterism.labelling import Condition, Evaluation


def evaluation_report(
    path: str | Path, evaluation: Evaluation, *, title: str = "How well the labels hold", settings: Mapping[str, Any] | None = None
) -> None:
    """Write an HTML page on an evaluation; `settings` (model, seed, rules, ...) are named at its foot.

    Raises AsterismError where the file cannot be written.
    """
    conditions = list(evaluation.conditions)
    names = [_name(c) for c in conditions]
    sections = [
        Section(
            "By number of hidden markers and ghosts",
            "FA: wrong among the labels that were given. FO: nulls that are wrong, because the marker was in view, among all nulls. "
            "Missed: markers in view that got no label. Perfect: frames in which every marker is right. ECE: how far, on average, "
            "the confidence is from the share that is right.",
            table=_summary(conditions),
        )
    ]
    if conditions:
        by_ghosts = {g: [c for c in conditions if c.ghosts == g] for g in dict.fromkeys(c.ghosts for c in conditions)}
        for key, heading, what in (("missed", "Markers missed", "missed"), ("fa", "Labels that are wrong", "FA")):
            lines = {
                "no ghosts" if g == 0 else f"{g} ghost{'s' if g > 1 else ''}": ([c.occlusions for c in own], [getattr(c, key) for c in own])
                for g, own in by_ghosts.items()
            }
            sections.append(Section(heading, figure=figures.curves(lines, "hidden markers per frame", what)))
        sections.append(
            Section(
                "Is the confidence as good as its word?",
                "Of the labels given at 99 %, 99 % should be right: points on the dotted line. A curve above the line is too modest, one "
                "below it promises too much. Each step of the scale is ten times fewer errors; the lower curves count the labels. "
                "Tap a name to show or hide its curves.",
                figure=figures.reliability({n: c.reliability for n, c in zip(names, conditions, strict=True)}, _ends(by_ghosts)),
                table=Table(
                    ["condition", "said", "right", "labels"],
                    [
                        [name, percent(said, 2), percent(right, 2), count(n)]
                        for name, c in zip(names, conditions, strict=True)
                        for said, right, n in c.reliability
                        if n > 0
                    ],
                ),
                folded=True,
            )
        )
    for key, heading, digits, kind in (
        ("fa", "FA by marker: wrong among the labels given", 3, "bad"),
        ("fo", "FO by marker: wrong among the nulls", 1, "warn"),
        ("missed", "Missed by marker: in view, without a label", 2, "warn"),
    ):
        head = [f"{c.occlusions} + {c.ghosts}" if c.ghosts else str(c.occlusions) for c in conditions]
        explained = "Columns: hidden markers per frame" + (", + ghosts." if any(c.ghosts for c in conditions) else ".")
        sections.append(Section(heading, explained, table=_by_marker(evaluation, conditions, head, key, digits, kind)))
    people = len(evaluation.subjects)
    frames = sum(c.frames for c in conditions)
    merits = [(count(people), "subjects", ""), (count(len(evaluation.markers)), "markers", ""), (count(frames), "frames labelled", "")]
    if conditions:
        easy, hard = conditions[0], conditions[-1]
        merits += [(percent(easy.fa, 3), f"FA, {names[0]}", "good" if easy.fa <= 0.0001 else "")]
        merits += [(percent(hard.fa, 3), f"FA, {names[-1]}", "")] if hard is not easy else []
        merits += [(count(easy.frames_per_second), f"frames per second, {names[0]}", "")]
    subjects = ", ".join(evaluation.subjects)
    lead = f"{len(evaluation.markers)} markers of {people} subject{'s' if people != 1 else ''}" + (f": {subjects}." if subjects else ".")
    write_page(path, Page(title, lead, {"rules": evaluation.rules, **(settings or {})}, merits, sections))


def _name(condition: Condition) -> str:
    ghosts = f", {condition.ghosts} ghost{'s' if condition.ghosts > 1 else ''}" if condition.ghosts else ""
    return f"{condition.occlusions} hidden{ghosts}"


def _ends(by_ghosts: Mapping[int, list[Condition]]) -> list[str]:
    """The names of the easiest and the hardest condition for each number of ghosts."""
    return list(dict.fromkeys(_name(condition) for own in by_ghosts.values() for condition in (own[0], own[-1])))


def _summary(conditions: list[Condition]) -> Table:
    head = ["hidden", "ghosts", "frames", "right", "FA", "FO", "missed", "perfect", "ECE", "frames/s", "evaluations per frame"]
    return Table(
        head,
        [
            [
                str(c.occlusions),
                str(c.ghosts),
                count(c.frames),
                percent(c.right, 3),
                tinted(float(c.fa), 3, 0.05, "bad"),
                percent(c.fo),
                tinted(float(c.missed), 2, 0.2),
                percent(c.perfect, 2),
                percent(c.ece, 3),
                count(c.frames_per_second),
                count(c.evaluations_per_frame),
            ]
            for c in conditions
        ],
    )


def _by_marker(evaluation: Evaluation, conditions: list[Condition], names: list[str], key: str, digits: int, kind: str) -> Table:
    worst = {"fa": 0.02, "fo": 1.0, "missed": 0.2}[key]
    rows: list[list[str | Cell]] = []
    for marker in evaluation.markers:
        values = [float(c.per_marker[marker][key]) for c in conditions]
        rows.append([marker, *(tinted(value, digits, worst, kind) for value in values)])
    means = [_mean([float(c.per_marker[m][key]) for m in evaluation.markers]) for c in conditions]
    rows.append(["mean of the markers", *(percent(mean, digits) for mean in means)])
    return Table(["marker", *names], rows)


def _mean(values: list[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")
