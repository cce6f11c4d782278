"""`asterism label`: files with anonymous or wrong labels in, labelled files out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._folders import Trial, check_folder, check_output, trials
from asterism.cli._labelling import ROW, check_labelling, file_labeller, file_names, labelled_line, labelled_row, model_json, model_text
from asterism.cli._options import (
    DropComputed,
    Files,
    ForProgram,
    FrameWise,
    Json,
    KeepLabels,
    KnownLabels,
    KnownLabelsOption,
    Models,
    NoStatic,
    Overwrite,
    Report,
    Rules,
    RulesOption,
    Subjects,
    Vertical,
    Workers,
    WornSets,
)
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.progress import Progress
    from asterism.recording import Clouds, Labelling
    from asterism.report import LabelledRecording
    from asterism.session import FileLabeller, FinishedFiles, LabelledFile

PAGE = "asterism-label.html"
"""The page on a folder of recordings, among the outputs, where --report names none."""
_MOST_SHOWN = 100
"""Recordings that the page shows frame by frame; its table has all. More would not fit into the memory of a small computer."""


@dataclass(frozen=True)
class LabelOptions:
    """What `asterism label` is asked to do."""

    files: Files
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the labelled files go.", show_default=False)]
    model: Models = None
    markers: WornSets = None
    known_labels: KnownLabelsOption = None
    keep_labels: KeepLabels = False
    drop_computed: DropComputed = False
    program: ForProgram = None
    rules: RulesOption = Rules.WHOLE_BODY
    frame_wise: FrameWise = False
    subject: Subjects = None
    no_static: NoStatic = False
    workers: Workers = 1
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None

    @property
    def page(self) -> Path | None:
        """The report: that which was asked for; of a folder, one beside the outputs."""
        in_folder = self.output / PAGE if any(path.is_dir() for path in self.files) else None
        return self.report or in_folder

    @property
    def how(self) -> dict[str, Any]:
        """The options that an output depends on, as plain values."""
        return {
            "known_labels": file_names(self),
            "drop_computed": self.drop_computed,
            "for": None if self.program is None else self.program.value,
            "rules": self.rules,
            "frame_wise": self.frame_wise,
            "no_static": self.no_static,
            "vertical": self.vertical,
            "markers": self.markers,
        }

    @property
    def how_made(self) -> dict[str, Any]:
        """`how`, with the files of marker sets by their names: they count by what they hold, see `inputs`."""
        return {**self.how, "markers": [Path(one).name if Path(one).is_file() else one for one in self.markers or ()] or None}

    @property
    def inputs(self) -> list[Path]:
        """The files beside the recordings that an output depends on: models, trials of the subject, marker sets."""
        sets = [path for path in map(Path, self.markers or ()) if path.is_file()]
        return [*(self.model or ()), *(self.subject or ()), *sets]


@takes(LabelOptions)
def label(options: LabelOptions) -> None:
    """Label the points of recordings.

    Without --model, the marker set that is worn is found among the shipped ones, by the names of the file or by its points, and a model of
    virtual people who wear it labels. It is made in seconds, the first time, and kept. The line of a file says which set was taken and how
    sure that is; --markers decides. Files of one folder are of one person where they agree. `asterism learn` teaches the model corrections.

    Names that the file has already count as --known-labels says.

    Each file is written to FOLDER under its name and format, with everything else in it unchanged. Points that are not labelled become
    *1, *2, ... A line per file says which share of all markers in all frames is labelled (confidence 99 % or more), likely (less) and
    unsure (not labelled, though a point left over may be it); the rest is hidden. The rules whole-body label a recording as a whole, by its
    tracks; --frame-wise turns that off. Recordings of more than two million points are labelled in stretches of minutes; C3D files of this
    length are never in memory as a whole, unless a report, a folder, --for or several models need that.
    Of a folder, all recordings below it are labelled, and keep their places below FOLDER, with a page on all of them. A trial in which the
    person stands, found by its name or by what it shows, narrows the model to the person. A run that was stopped goes on where it was.
    With several people or objects in the volume, give --model once for each of them; names that two of them share become 1:LASI and
    2:LASI. The trial given as --subject may be labelled or not.
    """
    _check(options)
    batch, results = _console.Batch("labelled"), list[_Result]()
    files = trials(options.files, batch, without=options.output)
    # models and the one trial given are loaded before any file: a wrong name costs no time
    run = LabelRun.of(options, files, batch)
    with _console.progress("labelling") as progress:
        for trial in files:
            with batch.file(trial.path):
                # a file that fails is named, and the others are still labelled
                result = run.result(trial, progress)
                results.append(result)
                if options.json != "-":
                    _console.result(_line(result.row))
    rows = [result.row for result in results]
    if len(rows) > 1 and options.json != "-":
        _table(rows)
    page = options.page
    if page is not None and results:
        _report(page, options, run.labeller, results, batch.findings)
    _console.write_json(
        options.json,
        {
            "command": "label",
            "model": model_json(options),
            **options.how,
            "subject": options.subject[0] if options.subject and len(options.subject) == 1 else options.subject,
            "keep_labels": file_names(options) is KnownLabels.KEEP,
            "files": rows,
            "passed_over": batch.passed_over,
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
        },
    )
    raise typer.Exit(batch.close())


@dataclass(frozen=True)
class _Result:
    """One labelled file: its row of the table and the JSON; and what the page shows, where there is one and the file was not finished."""

    row: dict[str, Any]
    shown: LabelledRecording | None = None


@dataclass(frozen=True)
class LabelRun:
    """What is the same for all files of a run."""

    options: LabelOptions
    labeller: FileLabeller
    finished: FinishedFiles
    batch: _console.Batch
    count: int

    @classmethod
    def of(cls, options: LabelOptions, files: Sequence[Trial], batch: _console.Batch) -> LabelRun:
        """What labels these files."""
        from asterism.session import FinishedFiles

        # the page shows the points, and the next program may want other axes: both need the whole recording
        in_memory = options.program is not None or options.page is not None
        labeller = file_labeller(options, [trial.path for trial in files], batch, rules=options.rules, in_memory=in_memory)
        return cls(options, labeller, FinishedFiles(options.output, options.how_made, options.inputs, ROW), batch, len(files))

    def result(self, trial: Trial, progress: Progress | None) -> _Result:
        """Label one file and write it, or take over what an earlier run has finished."""
        from asterism.cli._recordings import not_carried
        from asterism.recording import LABEL_STATES

        # the place tells what an earlier run has finished, so that its suffix comes first
        trial = self._as_program_reads(trial)
        target = self.options.output / trial.place
        if target.exists() and not self.options.overwrite:
            # an output that is the input itself is never taken for finished
            before = None if target.samefile(trial.path) else self.finished.finished(trial.place, trial.path, target)
            if before is not None:
                # a run that goes on warns of what the earlier one warned of
                for finding in before.findings:
                    self.batch.found(finding)
                here = {"file": trial.path, "output": target, "finished_before": True, "changed": before.changed}
                # JSON keeps a number that is not known as null
                unknown = {name: float("nan") for name in (*LABEL_STATES, "frames_per_second") if before.row.get(name) is None}
                return _Result({**before.row, **unknown, **here})
            check_output(trial.path, target, self.options.overwrite)
        state = _state(trial.path)
        labelled = self.labeller.label(trial.path, _share(progress, self.batch, self.count, trial.path))
        # half of one recording and half of another are labels of nobody
        if _state(trial.path) != state:
            raise AsterismError(f"{trial.path} was changed while it was labelled; run this again when it is whole.")
        row, findings = _row(target, labelled), self._findings(labelled)
        for finding in findings:
            self.batch.found(finding)
        # the record is written before the output: a run that is stopped between knows that the output is not whole
        target.parent.mkdir(parents=True, exist_ok=True)
        self.finished.begin(trial.place, trial.path, target, row, findings)
        program = None if self.options.program is None else self.options.program.value
        row["not_carried"] = labelled.write(target, program=program, drop_computed=self.options.drop_computed)
        left_out = not_carried(target, row["not_carried"])
        for finding in left_out:
            self.batch.found(finding)
        self.finished.end(trial.place, target, row, [*findings, *left_out])
        return _Result(row, self._shown(labelled))

    def _findings(self, labelled: LabelledFile) -> list[Finding]:
        """What was found in a file and on its labels, as far as it is still so in the output."""
        # what is left out cannot be out of date
        outdated = "label-computed-outdated" if self.options.drop_computed else None
        return [finding for finding in labelled.findings if finding.code != outdated]

    def _as_program_reads(self, trial: Trial) -> Trial:
        """The trial with a place of the suffix that the next program reads, where one is named."""
        from asterism.formats import PROGRAMS

        program = self.options.program
        return trial if program is None else replace(trial, place=trial.place.with_suffix(PROGRAMS[program.value].suffix))

    def _shown(self, labelled: LabelledFile) -> LabelledRecording | None:
        """What the page shows of a file, where there is a page that has room for it."""
        # the points of a hundred recordings are what a small computer holds
        if self.options.page is None or len(self.batch.done) >= _MOST_SHOWN:
            return None
        from asterism.report import LabelledRecording

        return LabelledRecording(labelled.labelling, labelled.clouds, labelled.marker_set, None, labelled.about.first_frame)


def _state(path: Path) -> tuple[int, int, int]:
    """What tells one state of a file from another; a file that has gone was read before."""
    try:
        found = path.stat()
    except OSError:
        return (0, 0, 0)
    return found.st_size, found.st_mtime_ns, found.st_ino


def _row(target: Path, labelled: LabelledFile) -> dict[str, Any]:
    """What the table and the JSON say of a labelled file."""
    speed = len(labelled.clouds) / labelled.seconds if labelled.seconds else float("nan")
    markers = _by_marker(labelled.labelling, labelled.clouds)
    return {**labelled_row(labelled), "output": target, "markers": markers, "frames_per_second": speed, "not_carried": []}


def _check(options: LabelOptions) -> None:
    """Raise AsterismError where options contradict each other, or an output cannot be made."""
    check_labelling(options, options.rules)
    check_folder(options.output)
    _console.check_new(options.report, options.overwrite)
    _console.check_new(options.json, options.overwrite)


def _by_marker(labelling: Labelling, clouds: Clouds) -> dict[str, dict[str, Any]]:
    """The shares of each marker, and the mean confidence of its labels, for JSON."""
    import numpy as np

    from asterism.recording import label_states

    states = vars(label_states(labelling, clouds))
    given = labelling.indices >= 0
    found = {}
    for m, name in enumerate(labelling.names):
        stated = labelling.confidence[given[:, m], m]
        # names that the file kept have no confidence of their own
        stated = stated[~np.isnan(stated)]
        shares = {state: float(held[:, m].mean()) if len(held) else float("nan") for state, held in states.items()}
        found[name] = {**shares, "confidence": float(stated.mean()) if len(stated) else float("nan")}
    return found


def _report(path: Path, options: LabelOptions, labeller: FileLabeller, results: Sequence[_Result], findings: Sequence[Finding]) -> None:
    """Write the page on all files; those that an earlier run has finished are in its table only."""
    from asterism.report import label_report

    # those of an earlier run were not read again, so that only their rows are known
    shown = [result for result in results if result.shown is not None]
    if not shown:
        if options.report is not None:
            _console.notice(f"{path} was not written, because an earlier run labelled all files; --overwrite labels them again.")
        return
    rows = [result.row for result in (*shown, *(result for result in results if result.shown is None))]
    about = {
        "model": model_text(options),
        "rules": options.rules.value,
        "keep_labels": file_names(options) is KnownLabels.KEEP,
    }
    label_report(
        path,
        [result.shown for result in shown if result.shown is not None],
        title=f"{len(rows)} labelled recordings" if len(rows) > 1 else f"{rows[0]['file'].name}, labelled",
        files=rows,
        model_info={**about, **labeller.about},
        findings=findings,
    )


def _share(progress: Progress | None, batch: _console.Batch, files: int, path: Path) -> Progress | None:
    """Progress within one file as progress of the whole batch."""
    if progress is None:
        return None
    # files that failed are done, too, as far as the bar goes
    before = len(batch.done) + len(batch.failed)
    return lambda fraction, _: progress((before + fraction) / files, path.name)


def _line(row: dict[str, Any]) -> str:
    changed = "was changed since and " if row.get("changed") else ""
    return labelled_line(row) + (f"; labelled by an earlier run, {row['output']} {changed}stays" if "finished_before" in row else "")


def _table(rows: Sequence[dict[str, Any]]) -> None:
    """All files of a run, those that an earlier run has finished among them."""
    from asterism.recording import LABEL_STATES

    _console.table(
        f"{len(rows)} recordings",
        ["file", "frames", *LABEL_STATES, "standing trial", "the model", "use"],
        [
            [
                str(row["file"]),
                _console.count(row["frames"]),
                *(_console.percent(row[name]) for name in LABEL_STATES),
                Path(str(row["subject"])).name if row["subject"] else "–",
                row["verdict"] or "–",
                row["use"],
            ]
            for row in rows
        ],
    )
