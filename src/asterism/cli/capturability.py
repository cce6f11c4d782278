"""`asterism capturability`: labelled files in; whether their marker set can be labelled, and what would help, out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from asterism.cli import _console
from asterism.cli._folders import recordings_of
from asterism.cli._options import Files, Json, Markers, Overwrite, Report, Seed, Vertical

if TYPE_CHECKING:
    from asterism.labelling import Capturability


def capturability(
    files: Files,
    markers: Markers = None,
    seed: Seed = 0,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    report: Report = None,
    json: Json = None,
) -> None:
    """Tell whether a marker set can be labelled.

    Which markers are taken for which, how the hit rate falls when markers are hidden, and what dropping, moving or adding one
    marker would change. Judged are single frames and partial solvers that know these people. asterism label also uses the paths of points
    and the whole body, and finds more; asterism evaluate measures how much, on people that its model does not know.
    """
    _console.check_new(report, overwrite)
    _console.check_new(json, overwrite)
    from asterism import labelling
    from asterism.cli._recordings import read_labelled

    batch = _console.Batch("read")
    # a marker that some files lack would look hidden, and the set worse than it is
    recordings = read_labelled(recordings_of(files, batch), markers, vertical, batch)
    with _console.progress("capturability") as progress:
        result = labelling.capturability(recordings, seed=seed, progress=progress)
    if json != "-":
        _print(result)
    if report is not None:
        from asterism.report import capturability_report

        capturability_report(report, result, settings={"recordings": len(recordings), "seed": seed})
    _console.write_json(
        json,
        {
            "command": "capturability",
            "files": batch.done,
            "failed": batch.failed,
            "seed": seed,
            "capturability": result.to_dict(),
            "findings": [finding.to_dict() for finding in batch.findings],
        },
    )
    raise typer.Exit(batch.close())


def _print(result: Capturability) -> None:
    percent = _console.percent
    _console.table(
        "Markers, nothing hidden",
        ["marker", "could be taken for, a third of the labels known", "hit rate"],
        [[name, _taken_for(result, i), percent(float(result.hit_rates[i]))] for i, name in enumerate(result.markers)],
        left=2,
    )
    _console.table(
        "With markers hidden",
        ["hidden", "hit rate", "worst marker"],
        [
            [
                str(hidden),
                percent(float(rate)),
                f"{result.markers[int(per_marker.argmin())]} {percent(float(per_marker.min()))}",
            ]
            for hidden, rate, per_marker in result.by_occlusions
        ],
        left=0,
    )
    if result.changes:
        _console.table(
            "What one change would do",
            ["change", "marker", "how", "hit rate before", "after"],
            [[c.action, c.marker, c.description, percent(c.hit_rate_before), percent(c.hit_rate_after)] for c in result.changes],
            left=3,
        )
    _console.result(result.verdict)
    _console.result(result.judged)


def _taken_for(result: Capturability, row: int) -> str:
    """The three markers that this one is most often taken for."""
    shares = [(float(share), name) for j, (share, name) in enumerate(zip(result.confusion[row], result.markers, strict=True)) if j != row]
    # by name where shares are equal, so that runs print the same
    worst = sorted((pair for pair in shares if pair[0] > 0), key=lambda pair: (-pair[0], pair[1]))[:3]
    return ", ".join(f"{name} {_console.percent(share)}" for share, name in worst)
