"""`asterism evaluate`: labelled files in; how often a model's labels are right, wrong or missing, out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._folders import recordings_of
from asterism.cli._options import (
    Dask,
    Files,
    FrameWise,
    HitRate,
    Json,
    Markers,
    Overwrite,
    PartialSolvers,
    Processes,
    Report,
    Rules,
    RulesOption,
    Seed,
    Vertical,
    check_hit_rate,
    marker_names,
    numbers,
)
from asterism.cli._sharing import shared
from asterism.cli.audit import as_numbered
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.labelling import Evaluation, MarkerModel
    from asterism.labelling.reliability import ConfidenceScore


@dataclass(frozen=True)
class EvaluateOptions:
    """What `asterism evaluate` is asked to do."""

    files: Files
    model: Annotated[
        Path | None,
        typer.Option(
            "--model", "-m", metavar="FILE", help="The model to test. Else that of virtual people who wear --markers.", show_default=False
        ),
    ] = None
    leave_one_subject_out: Annotated[
        bool, typer.Option("--leave-one-subject-out", help="Instead of a model: train on all subjects but one, test on that one, for each.")
    ] = False
    occlusions: Annotated[str, typer.Option(metavar="N N ...", help="How many markers are hidden at every moment.")] = "0 1 2 3 4 5"
    ghosts: Annotated[str, typer.Option(metavar="N N ...", help="How many ghost points there are at every moment.")] = "0"
    markers: Markers = None
    rules: RulesOption = Rules.WHOLE_BODY
    frame_wise: FrameWise = False
    target_hit_rate: HitRate = 0.999
    partial_solvers: PartialSolvers = None
    seed: Seed = 0
    workers: Processes = 1
    dask: Dask = None
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(EvaluateOptions)
def evaluate(options: EvaluateOptions) -> None:
    """Measure how far labels can be trusted.

    The labels of the files are taken away, markers are hidden, ghost points are added, and the labels that the model gives are compared
    with the truth. The rules whole-body label recordings as a whole, as asterism label does; --frame-wise turns that off.

    Labelled: share of all markers in all frames with a label of a confidence of 99 % or more. Likely: with less.
    Right: share of the visible markers that have their own point. Missed: share of them that have no label.
    Wrong: share of wrong labels among those given. In view: share of visible markers among those left without a label.
    Perfect: share of frames without an error. Log score: how little the confidence said of what came, as the mean of -ln of the
    probability that it gave to it; in brackets that of the best constant confidence. Less is better.

    Without --model, --markers names the set whose virtual people label: none of them was ever recorded.

    With --leave-one-subject-out the figures hold for people that the model has not seen; --markers, --target-hit-rate and --partial-solvers
    belong to it. Rules other than whole-body need partial solvers, searched bottom-up where nothing else is said. With --dask, the command
    must run in a folder that all machines of the cluster see.
    """
    settings = _settings(options)
    from asterism import labelling
    from asterism.cli._recordings import read_labelled

    model = None if options.leave_one_subject_out else _model(options)
    batch = _console.Batch("read")
    # under the names of the model, or of the training that is to come
    recordings = read_labelled(
        recordings_of(options.files, batch), options.markers if model is None else model.marker_set, options.vertical, batch
    )
    # before the minutes of training, not after them
    count, hidden = len(recordings[0].labels), max(settings["occlusions"])
    if hidden > count:
        raise AsterismError(f"--occlusions {hidden} hides more than the {count} markers that there are; give smaller numbers.")
    # names that are exchanged make right labels wrong
    for error in labelling.check_names(recordings, None if model is None else model.marker_set).errors:
        batch.found(as_numbered(error, recordings).finding)
    with shared(options.workers, options.dask, Path.cwd()), _console.progress("evaluating") as progress:
        if model is not None:
            evaluation = labelling.evaluate(model, recordings, **settings, progress=progress)
        else:
            # the whole-body rules need no partial solvers, and their search takes most of the training
            miner = None if options.rules is Rules.WHOLE_BODY or options.partial_solvers is None else options.partial_solvers.value
            evaluation = labelling.leave_one_subject_out(
                recordings, **settings, progress=progress, target_hit_rate=options.target_hit_rate, miner=miner
            )
    if options.json != "-":
        _print(evaluation)
    # after the table: they explain its figures
    for finding in evaluation.findings():
        batch.found(finding)
    if options.report is not None:
        from asterism.report import evaluation_report

        people = "each subject left out in turn" if options.leave_one_subject_out else f"virtual people, {options.markers}"
        said = {"model": options.model or people, **settings}
        # the page names what the option means
        said["recordings_as_a_whole"] = said.pop("time")
        evaluation_report(options.report, evaluation, settings=said)
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
            "findings": [finding.to_dict() for finding in batch.findings],
        },
    )
    raise typer.Exit(batch.close())


def _settings(options: EvaluateOptions) -> dict[str, Any]:
    """The settings of the evaluation. Raises AsterismError where options contradict each other or an output exists."""
    # people whom the model has learned would flatter it: the choice is the user's, and must be made
    given = options.model is not None or options.markers is not None
    if (options.model is not None and options.leave_one_subject_out) or (not given and not options.leave_one_subject_out):
        raise AsterismError(
            "evaluate takes --model FILE, --leave-one-subject-out, or --markers SET alone for a model of virtual people; give one of them."
        )
    if options.model is None and not options.leave_one_subject_out and options.rules is not Rules.WHOLE_BODY:
        raise AsterismError(f"a model of virtual people has no solvers for the rules {options.rules.value}; leave out --rules.")
    if options.model is not None and options.markers is not None:
        raise AsterismError(f"{options.model} has its own marker set; leave out --markers.")
    check_hit_rate(options.target_hit_rate)
    occlusions, ghosts = numbers(options.occlusions, "--occlusions"), numbers(options.ghosts, "--ghosts")
    _console.check_new(options.report, options.overwrite)
    _console.check_new(options.json, options.overwrite)
    # the votes of partial solvers know no time
    in_time = options.rules is Rules.WHOLE_BODY and not options.frame_wise
    return {"occlusions": occlusions, "ghosts": ghosts, "seed": options.seed, "rules": options.rules.value, "time": in_time}


def _model(options: EvaluateOptions) -> MarkerModel:
    """The model to test: the one that was given, or that of virtual people."""
    from asterism import labelling

    if options.model is not None:
        return labelling.MarkerModel.load(options.model)
    assert options.markers is not None
    with _console.progress("making a model of virtual people") as progress:
        return labelling.virtual_model(marker_names(options.markers) or (), progress=progress)


def _print(evaluation: Evaluation) -> None:
    percent, count = _console.percent, _console.count
    # only single frames are labelled by counted evaluations
    counted = [] if evaluation.time else ["evaluations/frame"]
    _console.table(
        f"Hidden markers and ghosts at every moment, {'recordings as a whole' if evaluation.time else 'each frame by itself'}",
        [
            "hidden",
            "ghosts",
            "frames",
            "labelled",
            "likely",
            "right",
            "wrong",
            "in view",
            "missed",
            "perfect",
            "log score",
            "frames/s",
            *counted,
        ],
        [
            [
                str(c.occlusions),
                str(c.ghosts),
                count(c.frames),
                percent(c.shares.labelled),
                percent(c.shares.likely),
                percent(c.right),
                percent(c.fa, 3),
                percent(c.fo),
                percent(c.missed),
                percent(c.perfect),
                _log_score(c.confidence),
                count(c.frames_per_second),
                *([] if evaluation.time else [count(c.evaluations_per_frame)]),
            ]
            for c in evaluation.conditions
        ],
        left=0,
    )
    _print_reliability(evaluation)
    names = [f"{c.occlusions}+{c.ghosts}" if c.ghosts else f"{c.occlusions}" for c in evaluation.conditions]
    for key, title, digits in (("fa", "Wrong labels, of those given", 3), ("fo", "Markers in view, of those without a label", 1)):
        _console.table(
            f"{title}, by marker and hidden{' + ghost' if any('+' in name for name in names) else ''} points per frame",
            ["marker", *names],
            [[marker, *(percent(c.per_marker[marker][key], digits) for c in evaluation.conditions)] for marker in evaluation.markers],
        )


def _log_score(score: ConfidenceScore) -> str:
    """The log score, and in brackets that of the best constant; a dash without labels."""
    return f"{score.log_score:.4f} ({score.constant_log_score:.4f})" if score.labels else "–"


def _print_reliability(evaluation: Evaluation) -> None:
    """What the confidence stated and what came of it, over all conditions."""
    percent, score = _console.percent, evaluation.confidence
    if not score.levels:
        return
    _console.table(
        f"Confidence of all labels given: {percent(score.share_at_999, 1)} of them can be given at 99.9 % right",
        ["confidence", "labels", "stated", "right", "95 % interval"],
        [
            [
                f"{level.least:g} to {level.below:g}",
                _console.count(level.labels),
                percent(level.confidence, 3),
                percent(level.right, 3),
                f"{percent(level.low, 3)} to {percent(level.high, 3)}",
            ]
            for level in score.levels
        ],
    )
