"""`asterism label`: files with anonymous or wrong labels in, labelled files out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import Files, FrameWise, Json, Models, Overwrite, Report, Rules, RulesOption, Vertical, Workers, vertical_axis
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.labelling import SolverEnsemble
    from asterism.progress import Progress
    from asterism.recording import Clouds, Labelling, MarkerSet, Recording


def label(
    files: Files,
    model: Models,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the labelled files go.", show_default=False)],
    keep: Annotated[bool, typer.Option("--keep", help="Labels that a file already has stay; only points without a name get one.")] = False,
    rules: RulesOption = Rules.WHOLE_BODY,
    frame_wise: FrameWise = False,
    subject: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A trial of the person, best standing: narrows the model to this body.", show_default=False),
    ] = None,
    workers: Workers = 1,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    report: Report = None,
    json: Json = None,
) -> None:
    """Label the points of recordings.

    Whatever names the points have now. Each file goes to FOLDER under its own name and format, with everything
    else in it as it was. Points that no marker took become *1, *2, ... A line per file says which share of all markers in all
    frames was labelled, and which share is unsure: not labelled though the frame has points left. The rules whole-body label a
    recording as a whole, by its tracks; --frame-wise turns that off. Where several people or objects are in the room, give
    --model once for each of them; names that two of them share become 1:LASI and 2:LASI. The trial given as --subject may be
    labelled or not.
    """
    from asterism.cli._recordings import labels_kept, outcome
    from asterism.labelling.ensemble import ANOTHER_PERSON

    in_time = rules is Rules.WHOLE_BODY and not frame_wise
    if len(model) > 1 and not in_time:
        raise AsterismError("several bodies are told apart by time and tracks; leave out --frame-wise and --rules, or give one --model.")
    if len(model) > 1 and subject is not None:
        raise AsterismError("a trial of the subject narrows one model; leave out --subject, or give one --model.")
    if subject is not None and rules is not Rules.WHOLE_BODY:
        raise AsterismError(f"the rules {rules.value} know no body that a trial could narrow; leave out --subject, or --rules.")
    targets = _targets(files, output)
    _console.check_new(report, overwrite)
    _console.check_new(json, overwrite)
    axis = vertical_axis(vertical)
    ensembles, subjects = _ensembles(model)
    general = ensembles[0]
    if subject is not None:
        ensembles = [_adapted(general, subject, axis)]
    batch = _console.Batch("labelled")
    rows: list[dict[str, Any]] = []
    shown: tuple[Recording, Labelling, Clouds, MarkerSet] | None = None
    with _console.progress("labelling") as progress:
        for path, target in zip(files, targets, strict=True):
            with batch.file(path):
                _check_target(path, target, overwrite)
                recording, clouds = _read(path, axis)
                if not batch.done and len(clouds):  # compiles, so that the rate below is that of the work
                    _label(ensembles, subjects, _first_frame(clouds), in_time, rules, 1, None)
                started = time.perf_counter()
                share = _share(progress, batch, len(files), path)
                labelling, marker_set, one_of_two = _label(ensembles, subjects, clouds, in_time, rules, workers, share)
                if ensembles[0].subject_fit(clouds, labelling) < ANOTHER_PERSON:
                    batch.doubt(path, f"{subject} is not of this body, or its markers were placed anew; labelled without it.")
                    labelling, marker_set, one_of_two = _label([general], subjects, clouds, in_time, rules, workers, share)
                seconds = time.perf_counter() - started
                if one_of_two:
                    batch.doubt(
                        path,
                        "two bodies wear the model's markers, and only one of them was labelled; give --model once for each of them.",
                    )
                if keep:
                    labelling = labels_kept(path, labelling, recording, clouds, marker_set)
                lost = _write(target, recording.with_labelling(labelling, clouds, keep_names=keep))
                summary = outcome(labelling, clouds)
                row = {
                    "file": path,
                    "output": target,
                    "frames": len(clouds),
                    "labelled": summary.labelled,
                    "unsure": summary.unsure,
                    "hidden": summary.hidden,
                    "frames_per_second": len(clouds) / seconds if seconds else float("nan"),
                    "not_carried": lost,
                }
                rows.append(row)
                shown = shown or (recording, labelling, clouds, marker_set)
                if json != "-":
                    _console.say(_line(row))
    if report is not None and shown is not None:
        from asterism.report import label_report

        label_report(
            report,
            title=f"{len(rows)} labelled recordings" if len(rows) > 1 else f"{rows[0]['file'].name}, labelled",
            files=rows,
            recording=shown[0],
            labelling=shown[1],
            clouds=shown[2],
            model_info={"model": ", ".join(map(str, model)), "rules": rules.value, "keep": keep, **ensembles[0].about},
            marker_set=shown[3],
        )
    used = model if len(model) > 1 else model[0]
    _console.write_json(
        json,
        {
            "command": "label",
            "model": used,
            "subject": subject,
            "rules": rules.value,
            "keep": keep,
            "files": rows,
            "failed": batch.failed,
            "doubted": batch.doubted,
        },
    )
    raise typer.Exit(batch.close())


def _ensembles(models: Sequence[Path]) -> tuple[list[SolverEnsemble], list[str]]:
    """The model of each body, one given twice read once, and what the body is called: its file's name, or a number where two have one."""
    from asterism.labelling import SolverEnsemble

    loaded = {path: SolverEnsemble.load(path) for path in dict.fromkeys(models)}
    names = [path.stem for path in models]
    distinct = len(set(names)) == len(names)
    return [loaded[path] for path in models], names if distinct else [str(i + 1) for i in range(len(names))]


def _label(
    ensembles: Sequence[SolverEnsemble],
    subjects: Sequence[str],
    clouds: Clouds,
    in_time: bool,
    rules: Rules,
    workers: int,
    progress: Progress | None,
) -> tuple[Labelling, MarkerSet, bool]:
    """A file's labelling, its marker set, and whether it is that of one of two bodies only, because one was expected."""
    from asterism.labelling import SeveralBodies, join_labellings, label_together

    if len(ensembles) > 1:
        found = label_together(ensembles, clouds, workers=workers, progress=progress)
        return *join_labellings(found, [ensemble.marker_set for ensemble in ensembles], subjects), False
    one = ensembles[0]
    try:
        return one.label(clouds, time=in_time, rules=rules.value, workers=workers, progress=progress), one.marker_set, False
    except SeveralBodies:
        both = label_together([one, one], clouds, workers=workers, progress=progress)
        return max(both, key=lambda labelling: int((labelling.indices >= 0).sum())), one.marker_set, True


def _share(progress: Progress | None, batch: _console.Batch, files: int, path: Path) -> Progress | None:
    """Progress within one file as progress of the whole batch."""
    if progress is None:
        return None
    before = len(batch.done) + len(batch.failed)
    return lambda fraction, _: progress((before + fraction) / files, path.name)


def _targets(files: Sequence[Path], output: Path) -> list[Path]:
    """Where each file goes. Raises AsterismError where two would go to one place, or `output` is no folder."""
    if output.exists() and not output.is_dir():
        raise AsterismError(f"{output} is a file; -o takes the folder for the labelled files.")
    taken: dict[str, Path] = {}
    for path in files:
        other = taken.setdefault(path.name.casefold(), path)
        if other is not path:
            raise AsterismError(f"{other} and {path} would both become {output / path.name}; label them into two folders.")
    return [output / path.name for path in files]


def _check_target(path: Path, target: Path, overwrite: bool) -> None:
    if target.exists() and not overwrite:
        what = "is the input itself" if target.samefile(path) else "exists"
        raise AsterismError(f"{path}: {target} {what}; choose another folder with -o, or replace it with --overwrite.")


def _read(path: Path, axis: str | list[float] | None) -> tuple[Recording, Clouds]:
    from asterism import formats

    recording = formats.read(path, vertical=axis)
    return recording, recording.clouds()


def _adapted(ensemble: SolverEnsemble, subject: Path, axis: str | list[float] | None) -> SolverEnsemble:
    try:
        return ensemble.adapt(_read(subject, axis)[0])
    except AsterismError as problem:
        sentence = str(problem)
        raise AsterismError(sentence if subject.name in sentence else f"{subject}: {sentence}") from problem


def _first_frame(clouds: Clouds) -> Clouds:
    from asterism.recording import Clouds

    return Clouds.from_points([clouds[0]], clouds.rate, clouds.vertical)


def _write(target: Path, recording: Recording) -> list[str]:
    from asterism import formats

    target.parent.mkdir(parents=True, exist_ok=True)
    lost = formats.write(target, recording)
    for what in lost:
        _console.complain(f"{target} leaves out {what}.")
    return lost


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['file']}: {row['frames']:,} frames, {_console.percent(row['labelled'])} labelled, {_console.percent(row['unsure'])} unsure, "
        f"{_console.count(row['frames_per_second'])} frames/s"
    )
