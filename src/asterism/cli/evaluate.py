"""`asterism evaluate`: labelled files in; how often a model's labels are right, wrong or missing, out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import (
    Files,
    HitRate,
    Json,
    Markers,
    MinerOption,
    Overwrite,
    Report,
    Rules,
    RulesOption,
    Seed,
    Vertical,
    check_hit_rate,
    numbers,
)
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.labelling import Evaluation


@dataclass(frozen=True)
class EvaluateOptions:
    """What `asterism evaluate` is asked to do."""

    files: Files
    model: Annotated[Path | None, typer.Option("--model", "-m", metavar="FILE", help="The model to test.", show_default=False)] = None
    leave_one_subject_out: Annotated[
        bool, typer.Option("--leave-one-subject-out", help="Instead of a model: train on all subjects but one, test on that one, for each.")
    ] = False
    occlusions: Annotated[str, typer.Option(metavar="N N ...", help="How many markers to hide in each frame.")] = "0 1 2 3 4 5"
    ghosts: Annotated[str, typer.Option(metavar="N N ...", help="How many ghost points to add to each frame.")] = "0"
    markers: Markers = None
    rules: RulesOption = Rules.WHOLE_BODY
    target_hit_rate: HitRate = 0.999
    miner: MinerOption = None
    seed: Seed = 0
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(EvaluateOptions)
def evaluate(options: EvaluateOptions) -> None:
    """Measure how far labels can be trusted.

    The labels of the files are taken away, markers are hidden, ghost points are added, and the labels that the model gives are compared
    with the truth.

    FA: share of wrong labels among those given. FO: share of visible markers among those left without a label.
    Missed: share of visible markers left without a label.
    Perfect: share of frames without an error. ECE: expected calibration error, how far the confidence is off.

    With --leave-one-subject-out the figures hold for people that
    the model has not seen; --markers, --target-hit-rate and --miner belong to it. Rules other than whole-body need a miner:
    bottom-up where none is named.
    """
    settings = _settings(options)
    from asterism import labelling
    from asterism.cli._recordings import read_labelled

    ensemble = None if options.model is None else labelling.SolverEnsemble.load(options.model)
    batch = _console.Batch("read")
    recordings = read_labelled(options.files, options.markers if ensemble is None else ensemble.marker_set, options.vertical, batch)
    count, hidden = len(recordings[0].labels), max(settings["occlusions"])
    if hidden > count:
        raise AsterismError(f"--occlusions {hidden} hides more than the {count} markers that there are; give smaller numbers.")
    with _console.progress("evaluating") as progress:
        if ensemble is not None:
            evaluation = labelling.evaluate(ensemble, recordings, **settings, progress=progress)
        else:
            # the whole-body rules need no partial solvers, and their search takes most of the training
            miner = None if options.rules is Rules.WHOLE_BODY or options.miner is None else options.miner.value
            evaluation = labelling.leave_one_subject_out(
                recordings, **settings, progress=progress, target_hit_rate=options.target_hit_rate, miner=miner
            )
    if options.json != "-":
        _print(evaluation)
    if options.report is not None:
        from asterism.report import evaluation_report

        evaluation_report(options.report, evaluation, settings={"model": options.model or "each subject left out in turn", **settings})
    _console.write_json(
        options.json,
        {
            "command": "evaluate",
            "model": options.model,
            "leave_one_subject_out": options.leave_one_subject_out,
            "files": batch.done,
            "failed": batch.failed,
            **settings,
            "evaluation": evaluation.to_dict(),
        },
    )
    raise typer.Exit(batch.close())


def _settings(options: EvaluateOptions) -> dict[str, Any]:
    """The settings of the evaluation. Raises AsterismError where options contradict each other or an output exists."""
    if (options.model is None) == (not options.leave_one_subject_out):
        raise AsterismError("evaluate takes either --model FILE or --leave-one-subject-out; give one of them.")
    if options.model is not None and options.markers is not None:
        raise AsterismError(f"{options.model} has its own marker set; leave out --markers.")
    check_hit_rate(options.target_hit_rate)
    occlusions, ghosts = numbers(options.occlusions, "--occlusions"), numbers(options.ghosts, "--ghosts")
    _console.check_new(options.report, options.overwrite)
    _console.check_new(options.json, options.overwrite)
    return {"occlusions": occlusions, "ghosts": ghosts, "seed": options.seed, "rules": options.rules.value}


def _print(evaluation: Evaluation) -> None:
    percent, count = _console.percent, _console.count
    _console.table(
        "Hidden markers and ghosts per frame",
        ["hidden", "ghosts", "frames", "right", "FA", "FO", "missed", "perfect", "ECE", "frames/s", "evaluations/frame"],
        [
            [
                str(c.occlusions),
                str(c.ghosts),
                count(c.frames),
                percent(c.right),
                percent(c.fa, 3),
                percent(c.fo),
                percent(c.missed),
                percent(c.perfect),
                percent(c.ece, 3),
                count(c.frames_per_second),
                count(c.evaluations_per_frame),
            ]
            for c in evaluation.conditions
        ],
        left=0,
    )
    names = [f"{c.occlusions}+{c.ghosts}" if c.ghosts else f"{c.occlusions}" for c in evaluation.conditions]
    for key, title, digits in (("fa", "FA, wrong among the labels given", 3), ("fo", "FO, visible among the labels not given", 1)):
        _console.table(
            f"{title}, by marker and hidden{' + ghost' if any('+' in name for name in names) else ''} points per frame",
            ["marker", *names],
            [[marker, *(percent(c.per_marker[marker][key], digits) for c in evaluation.conditions)] for marker in evaluation.markers],
        )
