"""`asterism label`: files with anonymous or wrong labels in, labelled files out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import (
    Files,
    FrameWise,
    Json,
    KeepLabels,
    Models,
    Overwrite,
    Report,
    Rules,
    RulesOption,
    Subject,
    Vertical,
    Workers,
    vertical_axis,
)
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity

if TYPE_CHECKING:
    from asterism.labelling import SolverEnsemble
    from asterism.progress import Progress
    from asterism.recording import Clouds, Labelling, MarkerSet, Recording


@dataclass(frozen=True)
class LabelOptions:
    """What `asterism label` is asked to do."""

    files: Files
    model: Models
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the labelled files go.", show_default=False)]
    keep_labels: KeepLabels = False
    rules: RulesOption = Rules.WHOLE_BODY
    frame_wise: FrameWise = False
    subject: Subject = None
    workers: Workers = 1
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None

    @property
    def in_time(self) -> bool:
        """Whether recordings are labelled as a whole, by their tracks."""
        return self.rules is Rules.WHOLE_BODY and not self.frame_wise


@takes(LabelOptions)
def label(options: LabelOptions) -> None:
    """Label the points of recordings, whatever names the points have now.

    Each file is written to FOLDER under its name and format, with everything else in it unchanged. Points that are not labelled become
    *1, *2, ... A line per file says which share of all markers in all frames is labelled (confidence 99 % or more), likely (less) and
    unsure (not labelled in a frame with points left over). The rules whole-body label a recording as a whole, by its tracks;
    --frame-wise turns that off.
    With several people or objects in the volume, give --model once for each of them; names that two of them share become 1:LASI and
    2:LASI. The trial given as --subject may be labelled or not.
    """
    _check(options)
    targets = _targets(options.files, options.output)
    labeller = _Labeller.of(options)
    batch, results = _console.Batch("labelled"), list[_Result]()
    with _console.progress("labelling") as progress:
        for path, target in zip(options.files, targets, strict=True):
            with batch.file(path):
                _check_target(path, target, options.overwrite)
                result = _labelled(labeller, batch, path, target, progress)
                results.append(result)
                if options.json != "-":
                    _console.result(_line(result.row))
    if options.report is not None and results:
        _report(options, labeller, results)
    _console.write_json(
        options.json,
        {
            "command": "label",
            "model": options.model if len(options.model) > 1 else options.model[0],
            "subject": options.subject,
            "rules": options.rules.value,
            "keep_labels": options.keep_labels,
            "files": [result.row for result in results],
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
        },
    )
    raise typer.Exit(batch.close())


@dataclass(frozen=True)
class _Labeller:
    """The models and their names; `general` is the first model before a trial of the subject narrowed it."""

    options: LabelOptions
    ensembles: Sequence[SolverEnsemble]
    names: Sequence[str]
    general: SolverEnsemble

    @classmethod
    def of(cls, options: LabelOptions) -> _Labeller:
        ensembles, names = _ensembles(options.model)
        general = ensembles[0]
        if options.subject is not None:
            ensembles = [_adapted(general, options.subject, vertical_axis(options.vertical))]
        return cls(options, ensembles, names, general)

    def label(self, clouds: Clouds, progress: Progress | None = None, *, generally: bool = False) -> tuple[Labelling, MarkerSet, bool]:
        """A file's labelling, its marker set, and whether it is that of one of two bodies, because one was expected."""
        from asterism.labelling import SeveralBodies, join_labellings, label_together

        ensembles, workers = [self.general] if generally else self.ensembles, self.options.workers
        if len(ensembles) > 1:
            found = label_together(ensembles, clouds, workers=workers, progress=progress)
            return *join_labellings(found, [ensemble.marker_set for ensemble in ensembles], self.names), False
        one = ensembles[0]
        try:
            given = one.label(clouds, time=self.options.in_time, rules=self.options.rules.value, workers=workers, progress=progress)
            return given, one.marker_set, False
        except SeveralBodies:
            both = label_together([one, one], clouds, workers=workers, progress=progress)
            return max(both, key=lambda labelling: int((labelling.indices >= 0).sum())), one.marker_set, True


@dataclass(frozen=True)
class _Result:
    """One labelled file, for the table, the JSON and the report."""

    row: dict[str, Any]
    labelling: Labelling
    clouds: Clouds
    marker_set: MarkerSet
    first_frame: int


def _check(options: LabelOptions) -> None:
    """Raise AsterismError where options contradict each other, or an output cannot be made."""
    if len(options.model) > 1 and not options.in_time:
        raise AsterismError(
            "several bodies are separated by their tracks over time; leave out --frame-wise and --rules, or give one --model."
        )
    if len(options.model) > 1 and options.subject is not None:
        raise AsterismError("a trial of the subject narrows one model; leave out --subject, or give one --model.")
    if options.subject is not None and options.rules is not Rules.WHOLE_BODY:
        raise AsterismError(
            f"the rules {options.rules.value} do not use a body model that a trial could narrow; leave out --subject, or --rules."
        )
    _console.check_new(options.report, options.overwrite)
    _console.check_new(options.json, options.overwrite)


def _labelled(labeller: _Labeller, batch: _console.Batch, path: Path, target: Path, progress: Progress | None) -> _Result:
    """Label one file and write it."""
    from asterism import __version__, formats
    from asterism.cli._recordings import labels_kept, not_carried, report_warnings
    from asterism.labelling.ensemble import OTHER_SUBJECT_FIT
    from asterism.recording import label_shares

    options = labeller.options
    recording, clouds = _read(path, vertical_axis(options.vertical))
    report_warnings(recording, batch)
    if not batch.done and len(clouds):  # compiles the kernels, so that the rate below leaves that out
        labeller.label(clouds.frames([0]))
    started = time.perf_counter()
    share = _share(progress, batch, len(options.files), path)
    labelling, marker_set, one_of_two = labeller.label(clouds, share)
    if labeller.ensembles[0].subject_fit(clouds, labelling) < OTHER_SUBJECT_FIT:
        batch.found(
            Finding(
                "label-other-subject",
                Severity.WARNING,
                str(path),
                f"{options.subject} is not of this body, or its markers were placed again; the file was labelled without it.",
                "Give a trial of the same session with --subject.",
            )
        )
        labelling, marker_set, one_of_two = labeller.label(clouds, share, generally=True)
    seconds = time.perf_counter() - started
    if one_of_two:
        batch.found(
            Finding(
                "label-two-bodies",
                Severity.WARNING,
                str(path),
                "two bodies wear the model's markers, and only one of them was labelled.",
                "Give --model once for each of them.",
            )
        )
    for finding in () if labelling.verdict is None else labelling.verdict.findings(str(path)):
        batch.found(finding)
    if options.keep_labels:
        labelling = labels_kept(path, labelling, recording, clouds, marker_set)
    by = f"asterism {__version__}, {', '.join(model.name for model in options.model)}"
    target.parent.mkdir(parents=True, exist_ok=True)
    lost = formats.write(target, recording.with_labelling(labelling, clouds, keep_names=options.keep_labels, by=by))
    for finding in not_carried(target, lost):
        batch.found(finding)
    shares = label_shares(labelling, clouds)
    row = {
        "file": path,
        "output": target,
        "frames": len(clouds),
        **asdict(shares),
        "verdict": None if labelling.verdict is None else labelling.verdict.kind,
        "frames_per_second": len(clouds) / seconds if seconds else float("nan"),
        "not_carried": lost,
    }
    return _Result(row, labelling, clouds, marker_set, recording.first_frame)


def _report(options: LabelOptions, labeller: _Labeller, results: Sequence[_Result]) -> None:
    from asterism.report import LabelledRecording, label_report

    assert options.report is not None
    rows = [result.row for result in results]
    about = {"model": ", ".join(map(str, options.model)), "rules": options.rules.value, "keep_labels": options.keep_labels}
    label_report(
        options.report,
        [LabelledRecording(result.labelling, result.clouds, result.marker_set, None, result.first_frame) for result in results],
        title=f"{len(rows)} labelled recordings" if len(rows) > 1 else f"{rows[0]['file'].name}, labelled",
        files=rows,
        model_info={**about, **labeller.ensembles[0].about},
    )


def _ensembles(models: Sequence[Path]) -> tuple[list[SolverEnsemble], list[str]]:
    """The model of each body, and the body's name: that of the model's file, or a number where two files have one name."""
    from asterism.labelling import SolverEnsemble

    loaded = {path: SolverEnsemble.load(path) for path in dict.fromkeys(models)}
    names = [path.stem for path in models]
    distinct = len(set(names)) == len(names)
    return [loaded[path] for path in models], names if distinct else [str(i + 1) for i in range(len(names))]


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


def _line(row: dict[str, Any]) -> str:
    from asterism.cli._recordings import shares_text

    return f"{row['file']}: {row['frames']:,} frames, {shares_text(row)}, {_console.count(row['frames_per_second'])} frames/s"
