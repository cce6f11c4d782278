"""`asterism train`: labelled files in, a model out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._folders import recordings_of
from asterism.cli._options import (
    Dask,
    Features,
    Files,
    HitRate,
    Json,
    Markers,
    MarkerTargets,
    Overwrite,
    PartialSolvers,
    Processes,
    Seed,
    Vertical,
    VirtualPeople,
    check_hit_rate,
    feature_names,
    marker_targets,
)
from asterism.cli._sharing import shared
from asterism.cli.audit import LEARNED_AS_NAMED, as_numbered
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity, exit_status

if TYPE_CHECKING:
    from asterism.labelling import MarkerModel, TrainingRules
    from asterism.recording import MarkerSet, Recording


@dataclass(frozen=True)
class TrainOptions:
    """What `asterism train` is asked to do."""

    files: Files
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The model to write.", show_default=False)]
    markers: Markers = None
    target_hit_rate: HitRate = 0.999
    marker_target: MarkerTargets = None
    partial_solvers: PartialSolvers = None
    features: Features = None
    virtual_people: VirtualPeople = None
    seed: Seed = 0
    workers: Processes = 1
    dask: Dask = None
    audit: Annotated[
        bool,
        typer.Option("--audit/--no-audit", help="Look through the files first, and leave out labels that cannot be right."),
    ] = True
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(TrainOptions)
def train(options: TrainOptions) -> None:
    """Learn a marker set from files whose points are labelled.

    Recordings of several people make a model that holds for people it has not seen. Without --markers the set is the markers that most
    people wear; the others are named. A marker is learned from the files that have it. The files are audited first: labels that cannot be
    right are named and left out, and the exit status is then 1. A file that cannot be used stops the training before it starts, and is
    named. With --dask, the folder of the model must be one that all machines of the cluster see.
    """
    check_hit_rate(options.target_hit_rate)
    # mistakes in options are told before any file is read
    features, targets = feature_names(options.features), marker_targets(options.marker_target)
    _console.check_new(options.output, options.overwrite)
    _console.check_new(options.json, options.overwrite)
    from asterism.cli._recordings import left_out_markers, marker_set_of, uncovered_markers

    marker_set = marker_set_of(options.markers)
    recordings, absent, warned = _read(options.files, marker_set, options.vertical, options.virtual_people)
    from asterism.labelling import MarkerModel

    errors: list[Any] = []
    otherwise: list[Finding] = []
    # one exchanged pair of labels teaches a body that nobody has
    if options.audit:
        recordings, errors, otherwise = _without_damage(recordings, marker_set, options.seed)
    started = time.perf_counter()
    work = shared(options.workers, options.dask, options.output.absolute().parent)
    with work, _console.progress("training") as progress:
        model = MarkerModel.fit(
            recordings,
            seed=options.seed,
            target_hit_rate=options.target_hit_rate,
            miner=None if options.partial_solvers is None else options.partial_solvers.value,
            marker_set=marker_set,
            training=_rules(options.virtual_people, features=features, marker_targets=targets),
            progress=progress,
        )
    seconds = time.perf_counter() - started
    model.save(options.output)
    names, about = model.marker_set.names, model.about
    notes = [
        *absent,
        *left_out_markers(len(names), about["left_out_markers"]),
        *uncovered_markers(options.output, about["partial_solvers"]),
    ]
    known_movement = any(_moves(recording) for recording in recordings)
    of_training = _findings_of_training(options.output, model, known_movement)
    notes += of_training
    # what the audit found was reported when it was found
    audited = [*(error.finding for error in errors), *otherwise]
    findings = [*warned, *notes, *audited]
    for finding in notes:
        _console.report(finding)
    if options.json != "-":
        _print(options.output, len(names), len(recordings), about, seconds, known_movement)
    _console.write_json(
        options.json,
        {
            "command": "train",
            "model": options.output,
            "markers": names,
            "files": options.files,
            **about,
            "left_out": [asdict(error) for error in errors],
            "findings": [finding.to_dict() for finding in findings],
            "seconds": seconds,
        },
    )
    # labels that were left out, or are learned under doubtful names, change the status, and so does what is wrong with a file
    raise typer.Exit(exit_status([*warned, *audited, *of_training]))


def _rules(virtual_people: int | None, **given: Any) -> TrainingRules:
    """The rules of the training; the usual number of virtual people where none is given."""
    from asterism.labelling import TrainingRules

    return TrainingRules(**given) if virtual_people is None else TrainingRules(virtual_people=virtual_people, **given)


def _read(
    files: Sequence[Path], marker_set: MarkerSet | None, vertical: str | None, virtual_people: int | None
) -> tuple[list[Recording], list[Finding], list[Finding]]:
    """The files' recordings: with the set's markers, else each with all its named ones; which markers some files lack; and what was
    found while they were read, which is also printed.

    Raises AsterismError where a file cannot be used.
    """
    from asterism.cli._recordings import read_labelled, read_some, report_coincident

    batch = _console.Batch("read")
    files = recordings_of(files, batch)
    # without a set, all named markers count, and training chooses among them
    read = read_some if marker_set is None else read_labelled
    recordings = read(files, marker_set, vertical, batch)
    report_coincident(recordings, batch)
    batch.tell_passed_over()
    if batch.failed:
        raise AsterismError(f"{len(batch.failed)} of {len(files)} files cannot be used, named above; correct them or leave them out.")
    absent = [] if marker_set is None else _absent_markers(batch.done, recordings, marker_set, by_virtual_people=virtual_people != 0)
    return recordings, absent, batch.findings


def _absent_markers(
    files: Sequence[Path], recordings: Sequence[Recording], marker_set: MarkerSet, *, by_virtual_people: bool
) -> list[Finding]:
    """The finding that some files lack markers of the set, which are learned from the others; empty where none does.

    by_virtual_people: a marker that no file has is learned from virtual people, where the set says where it sits.

    Raises AsterismError where a file has less than half of the markers, or no file has one.
    """
    import numpy as np

    mend = "name a smaller set with --markers, or add the files' spelling to the set's aliases."
    shown = np.array([recording.visible.any(axis=0) for recording in recordings])
    for path, seen in zip(files, shown, strict=True):
        # so few are another set, or other spellings of this one
        if 2 * seen.sum() < len(seen):
            raise AsterismError(f"{path} has {seen.sum()} of the {len(seen)} markers, fewer than half; leave the file out, {mend}")
    # a marker that nobody shows, and no virtual person wears, would be in the model, and never be labelled
    known = marker_set.places if by_virtual_people else {}
    never = [name for name, count in zip(marker_set.names, shown.sum(axis=0), strict=True) if not count and name not in known]
    if never:
        raise AsterismError(f"no file has the marker {', '.join(never[:6])}{', ...' if len(never) > 6 else ''}; {mend}")
    some = [f"{name} (in {seen.sum()})" for name, seen in zip(marker_set.names, shown.T, strict=True) if not seen.all()]
    if not some:
        return []
    few = ", ".join(some[:8]) + (", ..." if len(some) > 8 else "")
    teachers = "those that do" if shown.any(axis=0).all() else "those that do, or from virtual people"
    sentence = f"not all of the {len(files)} files have each marker, which is learned from {teachers}: {few}."
    return [Finding("train-markers-absent", Severity.NOTE, "the files", sentence, f"If they are there under other names, {mend}")]


def _without_damage(
    recordings: Sequence[Recording], marker_set: MarkerSet | None, seed: int
) -> tuple[list[Recording], list[Any], list[Finding]]:
    """The recordings without the samples that cannot be right; the label errors found; and names that virtual people wear otherwise.

    All that is found is reported on the console. Names that differ are learned as they are.
    """
    from asterism.labelling import audit, check_names, remove_errors
    from asterism.labelling.training.markers import learned_marker_set

    names = (marker_set or learned_marker_set(recordings)[0]).names
    # points that are not learned need not be right
    audited = [recording.select([name for name in names if name in recording.labels]) for recording in recordings]
    with _console.progress("auditing") as progress:
        # what is odd but may be right is left in: it may be a posture of its own
        errors = [error for error in audit(audited, seed=seed, progress=progress) if error.damage]
    numbered = [as_numbered(error, audited) for error in errors]
    for error in numbered:
        _console.report(replace(error.finding, mend="The model learns without these samples."))
    otherwise = [
        replace(as_numbered(error, audited).finding, mend=LEARNED_AS_NAMED)
        for error in check_names(audited, marker_set, known=errors).errors
    ]
    for finding in otherwise:
        _console.report(finding)
    return remove_errors(audited, errors), numbered, otherwise


def _moves(recording: Recording) -> bool:
    """Whether anything moves in a recording that is long enough to show it."""
    from asterism.session.standing import StandingRules, stands

    return len(recording) > StandingRules().duration * recording.rate and not stands(recording)


def _findings_of_training(output: Path, model: MarkerModel, known_movement: bool) -> list[Finding]:
    """What a model does not know, where no virtual people have shown it."""
    from asterism.findings import Finding, Severity

    found, people = list[Finding](), len(model.about["subjects"])
    if model.about["virtual_people"]:
        return found
    if not known_movement:
        sentence = f"{output}: nobody moves in these recordings, so that no label of a movement will be sure, and some will not be given."
        mend = "Train on recordings in which the person moves as well; virtual people know movements, where the marker set has them."
        found.append(Finding("train-standing", Severity.WARNING, str(output), sentence, mend))
    if model.rigid_distances is not None and model.rigid_distances.few_people:
        who = "one person shows" if people == 1 else f"{people} people show"
        sentence = f"{output}: {who} little of how others differ; a stranger's labels may be right, and none of them be sure."
        # its confidence cannot be tried on anybody else
        sentence += " Of postures that one person has not shown, labels can be wrong at a confidence near 1." if people == 1 else ""
        mend = "Look once at what it labels first of a new person, and teach it with `asterism learn`."
        mend += " Recordings of several people need a folder for each." if people == 1 else ""
        found.append(Finding("train-few-people", Severity.NOTE, str(output), sentence, mend))
    return found


def _print(output: Path, markers: int, recordings: int, about: dict[str, Any], seconds: float, known_movement: bool) -> None:
    from asterism.recording.display import counted

    people = len(about["subjects"])
    _console.result(
        f"{output}: {markers} markers, from {counted(recordings, 'recording')} of {counted(people, 'subject')} "
        f"({counted(about['frames'], 'frame')}) in {seconds:.0f} s"
    )
    virtual = about["virtual_people"]
    still = "" if known_movement else "; nobody moves in these, so that movements are known from the virtual people alone"
    _console.result(
        f"started from {virtual} virtual people, who know bodies and movements that these do not show{still}."
        if virtual
        else "real people only: no virtual ones were asked for, or no marker set says where at least half of these markers sit."
    )
