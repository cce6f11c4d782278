"""An evaluation in; a page with its tables (in the layout of the thesis' tables 5.3 to 5.5) and curves out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.report import figures
from asterism.report.page import Cell, Page, Section, Table, count, decimal, percent, tinted, write_page

if TYPE_CHECKING:
    from asterism.labelling import Condition, Evaluation
    from asterism.labelling.reliability import ConfidenceScore


def evaluation_report(path: str | Path, evaluation: Evaluation, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on an evaluation; `settings` (model, seed, rules, ...) stand at its foot.

    Raises AsterismError where the file cannot be written.
    """
    conditions = list(evaluation.conditions)
    sections = [
        Section(
            "By number of hidden markers and ghosts",
            "Wrong: of the labels given. In view: of the markers without a label. "
            "Missed: of the markers in view, those without a label. Perfect: frames in which every marker is right. "
            "Log score: how little the confidence said of what came, as the mean of -ln of the probability that it gave to it; "
            "beside it that of the best constant confidence. Less is better.",
            table=_summary(conditions),
        ),
        *([_levels(evaluation.confidence)] if conditions and evaluation.confidence.levels else []),
        *(_curves(conditions) if conditions else []),
        *_marker_sections(evaluation, conditions),
    ]
    people, frames = len(evaluation.subjects), sum(c.frames for c in conditions)
    merits = [(count(people), "subjects", ""), (count(len(evaluation.markers)), "markers", ""), (count(frames), "frames labelled", "")]
    if conditions:
        # The easiest and the hardest stand for all at the head of the page.
        easy, hard = conditions[0], conditions[-1]
        merits += [(percent(easy.fa, 3), f"wrong labels, {_name(easy)}", "good" if easy.fa <= 0.0001 else "")]
        merits += [(percent(hard.fa, 3), f"wrong labels, {_name(hard)}", "")] if hard is not easy else []
        merits += [(count(easy.frames_per_second), f"frames per second, {_name(easy)}", "")]
    subjects = ", ".join(evaluation.subjects)
    lead = f"{len(evaluation.markers)} markers of {people} subject{'s' if people != 1 else ''}" + (f": {subjects}." if subjects else ".")
    title = "How often the labels are right"
    write_page(path, Page(title, lead, {"rules": evaluation.rules, **(settings or {})}, merits, sections))


def _curves(conditions: list[Condition]) -> list[Section]:
    """Missed markers and wrong labels by the number of hidden markers; the confidence against the share of right labels."""
    names = [_name(c) for c in conditions]
    by_ghosts = {g: [c for c in conditions if c.ghosts == g] for g in dict.fromkeys(c.ghosts for c in conditions)}
    sections = []
    # One line for each number of ghosts: hidden markers and ghosts hurt in different ways.
    for key, heading, what in (("missed", "Missed markers", "missed"), ("fa", "Wrong labels", "wrong")):
        lines = {
            "no ghosts" if g == 0 else f"{g} ghost{'s' if g > 1 else ''}": ([c.occlusions for c in each], [getattr(c, key) for c in each])
            for g, each in by_ghosts.items()
        }
        sections.append(Section(heading, figure=figures.curves(lines, "hidden markers per frame", what)))
    rows = [
        [name, percent(confidence, 2), percent(right, 2), count(n)]
        for name, c in zip(names, conditions, strict=True)
        for confidence, right, n in c.reliability
        if n > 0
    ]
    sections.append(
        Section(
            "Is the confidence right?",
            "Of the labels with a confidence of 99 %, 99 % should be right: points on the dotted line. A curve above the line means that "
            "the confidence is too low, a curve below it that the confidence is too high. Each step of the scale means ten times fewer "
            "errors. The lower curves count the labels. Click a name to show or hide its curves.",
            figure=figures.reliability({n: c.reliability for n, c in zip(names, conditions, strict=True)}, _ends(by_ghosts)),
            table=Table(["condition", "confidence", "right", "labels"], rows),
            folded=True,
        )
    )
    return sections


def _marker_sections(evaluation: Evaluation, conditions: list[Condition]) -> list[Section]:
    head = [f"{c.occlusions} + {c.ghosts}" if c.ghosts else str(c.occlusions) for c in conditions]
    text = "Columns: hidden markers per frame" + (", + ghosts." if any(c.ghosts for c in conditions) else ".")
    kinds = (
        ("fa", "Wrong labels by marker, of the labels given", 3, "bad"),
        ("fo", "In view by marker, of the frames without a label", 1, "warn"),
        ("missed", "Missed by marker: without a label, of the frames in view", 2, "warn"),
    )
    return [
        Section(heading, text, table=_by_marker(evaluation, conditions, head, key, digits, kind)) for key, heading, digits, kind in kinds
    ]


def _name(condition: Condition) -> str:
    ghosts = f", {condition.ghosts} ghost{'s' if condition.ghosts > 1 else ''}" if condition.ghosts else ""
    return f"{condition.occlusions} hidden{ghosts}"


def _ends(by_ghosts: Mapping[int, list[Condition]]) -> list[str]:
    """The names of the easiest and the hardest condition for each number of ghosts."""
    return list(dict.fromkeys(_name(condition) for each in by_ghosts.values() for condition in (each[0], each[-1])))


def _summary(conditions: list[Condition]) -> Table:
    head = ["hidden", "ghosts", "frames", "right", "wrong", "in view", "missed", "perfect", "log score", "best constant", "frames/s"]
    head += ["evaluations per frame"]
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
                decimal(c.confidence.log_score, 4),
                decimal(c.confidence.constant_log_score, 4),
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
    # Markers without a value are left out of the mean.
    means = [_mean([float(c.per_marker[m][key]) for m in evaluation.markers]) for c in conditions]
    rows.append(["mean of the markers", *(percent(mean, digits) for mean in means)])
    return Table(["marker", *names], rows)


def _levels(score: ConfidenceScore) -> Section:
    """What the confidence stated, and what came of it, over all conditions."""
    rows = [
        [
            f"{level.least:g} to {level.below:g}",
            count(level.labels),
            percent(level.confidence, 3),
            percent(level.right, 3),
            f"{percent(level.low, 3)} to {percent(level.high, 3)}",
        ]
        for level in score.levels
    ]
    text = (
        "All labels given, by their confidence: the mean confidence should lie in the 95 % interval of the share that was right. "
        f"{percent(score.share_at_999, 1)} of the labels, the most confident ones, can be given at 99.9 % right. "
        f"Log score {decimal(score.log_score, 4)}, of the best constant {decimal(score.constant_log_score, 4)}; "
        f"Brier score {score.brier:.5f}, of the best constant {score.constant_brier:.5f}."
    )
    return Section("Reliability", text, table=Table(["confidence", "labels", "stated", "right", "95 % interval"], rows))


def _mean(values: list[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")
