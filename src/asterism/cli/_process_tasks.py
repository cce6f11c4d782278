"""The tasks of `asterism process`: one recording to label, or one person's labelled recordings to analyse; done by any process.

What a task is told and what it answers is small and plain. Results go to the disk, and so does a record by which a task that was done is
not done again. A task gives the same however often it is begun.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli import _console
from asterism.cli._folders import Trial
from asterism.cli._labelling import ROW
from asterism.cli._options import KnownLabels
from asterism.cli._process_places import Reference, SessionPlaces
from asterism.cli._process_skeleton import person_skeleton
from asterism.cli.gait import GaitOptions, analysed, write_results
from asterism.cli.label import LabelOptions, LabelRun
from asterism.errors import AsterismError, NoGait, guarded_reading
from asterism.files.atomic import write_atomically
from asterism.files.plain import as_json
from asterism.files.stalls import digest, that_answer
from asterism.findings import Finding, Severity
from asterism.session.spread import no_room

if TYPE_CHECKING:
    from asterism.gait import Band, GaitAnalysis

LABELLED, REPORTS, OUTPUTS, RECORDS, SKELETONS = "labelled", "reports", "gait", "records", "skeleton"
"""The folders of a session's results: labelled recordings, pages, recordings with model outputs, records, and skeletons."""


@dataclass(frozen=True)
class PersonOptions:
    """How a person's recordings are processed.

    name     of the person
    trials   each recording, and where its outputs go below their folders
    out      the folder of the results
    static   the standing trial that the settings name, or a file's name tells
    """

    name: str
    trials: tuple[tuple[Path, Path], ...]
    out: Path
    model: Path | None = None
    markers: str | None = None
    static: Path | None = None
    vertical: str | None = None
    known_labels: KnownLabels | None = None
    fill: str = "none"
    band: Path | None = None
    measures: tuple[tuple[str, float], ...] = ()
    skeleton: bool = False
    overwrite: bool = False

    @property
    def found_by_name(self) -> bool:
        """Whether the standing trial is one of the trials whose names say that the person stands, as labelling finds it."""
        from asterism.session import is_standing_name

        return self.static is not None and is_standing_name(self.static) and self.static in [path for path, _ in self.trials]

    @property
    def label(self) -> LabelOptions:
        """The same for `asterism label`."""
        return LabelOptions(
            files=[path for path, _ in self.trials],
            output=self.out / LABELLED,
            model=None if self.model is None else [self.model],
            markers=None if self.markers is None else [self.markers],
            subject=None if self.static is None or self.found_by_name else [self.static],
            vertical=self.vertical,
            known_labels=self.known_labels,
            overwrite=self.overwrite,
            json="-",
        )

    def plain(self, places: SessionPlaces) -> dict[str, Any]:
        """The same as plain values that another machine understands."""
        files = {name: places.reference(getattr(self, name)) for name in ("out", "model", "static", "band")}
        trials = [(places.reference(path), place.as_posix()) for path, place in self.trials]
        known = None if self.known_labels is None else self.known_labels.value
        # a set is shipped, or in a file
        markers = places.reference(Path(self.markers)) if self.markers and Path(self.markers).is_file() else self.markers
        return {**vars(self), **files, "trials": trials, "known_labels": known, "markers": markers}

    @classmethod
    def of_plain(cls, plain: dict[str, Any], places: SessionPlaces) -> PersonOptions:
        """The inverse of `plain`, with paths of this machine; files are brought, but for the trials."""
        files = {name: places.local(plain[name], bring=name != "out") for name in ("out", "model", "static", "band")}
        trials = tuple((places.local(path, bring=False), Path(place)) for path, place in plain["trials"])
        named = plain["markers"]
        markers = str(places.local((named[0], named[1]))) if isinstance(named, list) else named
        known = None if plain["known_labels"] is None else KnownLabels(plain["known_labels"])
        measures = tuple((name, value) for name, value in plain["measures"])
        return cls(**{**plain, **files, "trials": trials, "known_labels": known, "markers": markers, "measures": measures})


@dataclass(frozen=True)
class PersonTask:
    """A person, whose options are in a file of the results: a folder of a thousand recordings is no message.

    out     the folder of the results
    name    of the person
    digest  of the file
    place   of the recording among the person's trials; None for all of them
    """

    out: Reference
    name: str
    digest: str
    place: int | None = None


def write_plan(person: PersonOptions, places: SessionPlaces) -> PersonTask:
    """Write the options of a person for the processes that share the work; the task that names them."""
    data = json.dumps(person.plain(places), indent=1).encode()
    path = _plan(person.out, person.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, data)
    places.take(path)
    out = places.reference(person.out)
    assert out is not None
    return PersonTask(out, person.name, hashlib.sha256(data).hexdigest()[:16])


def _plan(out: Path, name: str) -> Path:
    return out / RECORDS / "plan" / f"{file_name(name)}.json"


@dataclass
class TaskResult:
    """What a task answers: rows of the table, what was found, and files that failed, each with a sentence."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    findings: list[dict[str, str]] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)

    def told(self, places: SessionPlaces) -> TaskResult:
        """The same with addresses in place of the paths of temporary files."""
        return TaskResult(**places.told(as_json(vars(self)))) if places.folders else self


class _Kept(_console.Batch):
    """A batch that says nothing: what is found, what cannot be analysed and what fails is kept for whoever gave the task."""

    def __init__(self) -> None:
        super().__init__("done")
        self.problems: dict[str, str] = {}
        self.no_gait: dict[str, str] = {}
        self.faults: dict[str, str] = {}

    @contextmanager
    def file(self, path: Path) -> Iterator[None]:
        try:
            yield
        except Exception as problem:
            # all others would meet the same
            if no_room(problem):
                raise
            # a full disk is no property of the recording: what could not be written is tried again by the next run
            told = isinstance(problem, AsterismError) and not isinstance(problem.__cause__, OSError)
            kept = self.no_gait if isinstance(problem, NoGait) else self.problems if told else self.faults
            kept[str(path)] = _console.reason(problem)
            self.failed.append(path)
        else:
            self.done.append(path)

    def found(self, finding: Finding) -> None:
        self.findings.append(finding)


@dataclass
class _Work:
    """What a process keeps of the person of its last task: the options, where the files are, and what labels them."""

    person: PersonOptions
    places: SessionPlaces
    run: LabelRun | None = None
    batch: _Kept = field(default_factory=_Kept)

    @classmethod
    def of(cls, task: PersonTask) -> _Work:
        """The work on the person of a task."""
        if task not in _WORK:
            _WORK.clear()
            places = SessionPlaces()
            out = places.local(task.out, bring=False)
            assert out is not None
            path = _plan(out, task.name)
            if not places.bring(path):
                raise AsterismError(f"{path} is not there; a worker must see the folder of the results under this path, or at an address.")
            data = path.read_bytes()
            if hashlib.sha256(data).hexdigest()[:16] != task.digest:
                raise AsterismError(f"{path} is not what this run has written; is another run at work in the folder?")
            _WORK[task] = cls(PersonOptions.of_plain(json.loads(data), places), places)
        return _WORK[task]

    def labelling(self) -> LabelRun:
        """What labels this person's recordings: models are loaded and narrowed once for all of them."""
        from asterism.session import is_standing_name

        if self.run is None:
            for path, _ in self.person.trials:
                # one that cannot be brought is named when it is labelled itself
                with suppress(AsterismError):
                    self.places.bring(path)
            answering = set(that_answer(path for path, _ in self.person.trials))
            # of several standing trials, the one that counts is the one that labelling sees, too
            if self.person.found_by_name:
                answering -= {path for path in answering if is_standing_name(path)} - {self.person.static}
            trials = [Trial(*trial) for trial in self.person.trials if trial[0] in answering]
            self.run = LabelRun.of(self.person.label, trials, self.batch)
        return self.run


_WORK: dict[PersonTask, _Work] = {}


def label_trial(task: PersonTask) -> TaskResult:
    """Label one recording of a person, unless this was done."""
    assert task.place is not None
    work = _Work.of(dataclasses.replace(task, place=None))
    try:
        return _labelled(work, task.place).told(work.places)
    except AsterismError as problem:
        raise _told(problem, work.places) from problem


def _told(problem: AsterismError, places: SessionPlaces) -> AsterismError:
    return type(problem)(places.told(str(problem)))


def _labelled(work: _Work, number: int) -> TaskResult:
    from asterism.session import FinishedFiles

    person, places = work.person, work.places
    path, place = person.trials[number]
    places.bring(path)
    # a disk that stalls is told here, by a thread that can be left alone
    with guarded_reading(path):
        digest(path)
    run, batch = work.labelling(), work.batch
    shared = list(batch.findings)
    try:
        # a record for each output: several processes write at once
        inputs = [*run.options.inputs, *([person.static] if person.static is not None and person.static != path else [])]
        record = person.out / RECORDS / LABELLED / f"{place.as_posix()}.jsonl"
        target = run.options.output / place
        for one in (record, target):
            places.bring(one, again=places.remote(one) is not None)
        record.parent.mkdir(parents=True, exist_ok=True)
        finished = FinishedFiles(record.parent, run.options.how_made, inputs, ROW, record.name)
        before = None if person.overwrite or not target.exists() else finished.finished(place, path, target)
        if target.exists() and not person.overwrite and before is None:
            if not finished.made_here(place, target):
                raise AsterismError(
                    f"{path}: {target} was changed by somebody, and the recording or the options are others since; it stays. "
                    "Move it away, or replace it with --overwrite."
                )
            run = dataclasses.replace(run, options=dataclasses.replace(run.options, overwrite=True))
        result = dataclasses.replace(run, finished=finished).result(Trial(path, place), None)
        if before is None:
            # the record first: it knows the outputs before, too, so that none of them is taken for somebody's
            places.take(record)
            places.take(target)
        places.forget((record, target))
        row = {name: value for name, value in result.row.items() if name != "markers"}
        return TaskResult([as_json(row)], [finding.to_dict() for finding in batch.findings])
    finally:
        batch.findings[:] = shared


def analyse_person(task: PersonTask) -> TaskResult:
    """Analyse the labelled recordings of a person, unless this was done with the same ones."""
    work = _Work.of(task)
    try:
        return _analysed(work.person, work.places).told(work.places)
    except AsterismError as problem:
        raise _told(problem, work.places) from problem


def _analysed(person: PersonOptions, places: SessionPlaces) -> TaskResult:
    from asterism.session import FinishedFiles

    labelled = [(place, person.out / LABELLED / place) for _, place in person.trials]
    labelled = [(place, path) for place, path in labelled if places.bring(path)]
    if not labelled:
        return TaskResult()
    folder = person.out / RECORDS / OUTPUTS
    folder.mkdir(parents=True, exist_ok=True)
    # files count by what they hold, wherever they are
    but = ("out", "overwrite", "trials", "model", "markers", "static", "band")
    how = {name: value for name, value in dataclasses.asdict(person).items() if name not in but}
    how["places"] = [place.as_posix() for place, _ in labelled]
    others = [path for path in (person.static, person.band) if path is not None]
    name = file_name(person.name)
    table = person.out / OUTPUTS / f"{name}.csv"
    for kept in (folder / f"{name}.jsonl", table):
        places.bring(kept, again=places.remote(kept) is not None)
    finished = FinishedFiles(folder, how, [*(path for _, path in labelled), *others], (), f"{name}.jsonl")
    source, key = labelled[0][1], Path(name)
    before = None if person.overwrite else finished.finished(key, source, table)
    if before is not None and all(places.exists(person.out / one) for one in before.row["outputs"]):
        return TaskResult(list(before.row["rows"]), [finding.to_dict() for finding in before.findings])
    result, outputs, findings, write = _analysis(person, labelled, table)
    row = {"rows": result.rows, "outputs": outputs}
    # what has failed is tried again by the next run
    if not result.failed:
        finished.begin(key, source, table, row, findings)
    write()
    for output in outputs:
        places.take(person.out / output)
    if not result.failed:
        finished.end(key, table, row, findings)
        places.take(finished.path)
    places.forget([*(path for _, path in labelled), *(person.out / one for one in outputs), finished.path])
    return result


def of_recording(place: str) -> list[str]:
    """The results of a recording, below the folder of results."""
    path = Path(place)
    found = ((LABELLED, path.suffix), (OUTPUTS, ".c3d"), (REPORTS, ".html"), (SKELETONS, ".bvh"))
    return [f"{folder}/{path.with_suffix(suffix).as_posix()}" for folder, suffix in found]


def of_person(name: str) -> list[str]:
    """The results of a person, who is called so as a file."""
    return [f"{OUTPUTS}/{name}.csv", f"{REPORTS}/{name}.html", f"{SKELETONS}/{name}.csv"]


def file_name(name: str) -> str:
    """A person's name as a file's."""
    return "".join(letter if letter.isalnum() or letter in " ._-" else "-" for letter in name).strip(" .") or "person"


@dataclass(frozen=True)
class _Own:
    """The labelled recordings of one subject: the standing trial, those that are analysed, and other standing trials, which are not."""

    name: str
    standing: Path | None
    walks: tuple[Path, ...]
    others: tuple[Path, ...] = ()


def _analysis(
    person: PersonOptions, labelled: Sequence[tuple[Path, Path]], table: Path
) -> tuple[TaskResult, list[str], list[Finding], Callable[[], None]]:
    """What is said of a person, the outputs below the folder of results, what was found, and what writes them."""
    from asterism.gait import Band

    band = None if person.band is None else Band.load(person.band)
    batch, rows, writers, outputs = _Kept(), list[dict[str, Any]](), list[Callable[[], None]](), [_below(person.out, table)]
    parameters: list[tuple[Path, GaitAnalysis]] = []
    of_place = {path: place for place, path in labelled}
    originals = {place: str(path) for path, place in person.trials}
    subjects = _subjects(person, labelled, batch)
    for own in subjects:
        report = person.out / REPORTS / f"{file_name(own.name)}.html"
        options = GaitOptions(
            files=list(own.walks),
            static=own.standing,
            measure=[f"{name}={value!r}" for name, value in person.measures],
            fill=person.fill,
            vertical=person.vertical,
            overwrite=True,
            json="-",
        )
        copies = {path: person.out / OUTPUTS / of_place[path].with_suffix(".c3d") for path in own.walks}
        results = analysed(options, own.walks, batch, copies)
        outputs += [_below(person.out, copies[path]) for path, _ in results]
        parameters += results
        pages = [(report, results)] + [(_page(person.out, of_place[path], report), [(path, one)]) for path, one in results]
        # one walk is a page already
        for page, shown in pages[: 1 if len(results) < 2 else None] if results else ():
            outputs.append(_below(person.out, page))
            writers.append(partial(_write_page, dataclasses.replace(options, report=page, json=None), shown, band))
        if person.skeleton and results:
            moves = {path: person.out / SKELETONS / of_place[path].with_suffix(".bvh") for path, _ in results}
            joints = person.out / SKELETONS / f"{file_name(own.name)}.csv"
            written, said, draw = person_skeleton(moves, own.standing, joints, person.vertical)
            outputs += [_below(person.out, one) for one in written]
            writers.append(draw)
            for finding in said:
                batch.found(finding)
        analyses = dict(results)
        for place, path in labelled:
            if path in (own.standing, *own.others, *own.walks):
                kind = "standing" if path == own.standing else "walk" if path in analyses else "not analysed"
                kind = "standing, not used" if path in own.others else kind
                rows.append(
                    {"place": place.as_posix(), "file": originals[place], "person": own.name, "kind": kind, **_summary(analyses.get(path))}
                )
                rows[-1]["report"] = _below(person.out, report) if path in analyses else None
    # a recording that shows no gait is none that failed
    findings = [*batch.findings, *(_not_analysed(path, sentence, False) for path, sentence in batch.problems.items())]
    findings += [_not_analysed(path, sentence, True) for path, sentence in batch.no_gait.items()]

    def write() -> None:
        table.parent.mkdir(parents=True, exist_ok=True)
        write_results(GaitOptions(files=[], output=table, overwrite=True), parameters, None, _Kept())
        for one in writers:
            one()

    return TaskResult(rows, [finding.to_dict() for finding in findings], batch.faults), outputs, findings, write


def _write_page(options: GaitOptions, results: list[tuple[Path, GaitAnalysis]], band: Band | None) -> None:
    assert options.report is not None
    options.report.parent.mkdir(parents=True, exist_ok=True)
    write_results(options, results, band, _Kept())


def _page(out: Path, place: Path, of_person: Path) -> Path:
    """The page of a walk: beside that of the person, also where the walk is called as the person is."""
    page = out / REPORTS / place.with_suffix(".html")
    return page if str(page).casefold() != str(of_person).casefold() else page.with_name(f"{page.stem} (walk).html")


def _below(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix()


def _subjects(person: PersonOptions, labelled: Sequence[tuple[Path, Path]], batch: _Kept) -> list[_Own]:
    """The recordings by the subject that files name: one person, unless several are named in one folder, which is told."""
    from asterism import formats
    from asterism.session import is_standing_name, stands

    by_subject: dict[str, tuple[list[Path], list[Path]]] = {}
    originals = {place: path for path, place in person.trials}
    for place, path in labelled:
        with batch.file(path):
            recording = formats.read(path)
            subject = str(recording.metadata.get("subject") or "")
            still = originals[place] == person.static or is_standing_name(path) or stands(recording)
            by_subject.setdefault(subject, ([], []))[0 if still else 1].append(path)
    named = sorted(set(by_subject) - {""})
    if len(named) < 2:
        standing = [path for own, _ in by_subject.values() for path in own]
        walks = [path for _, own in by_subject.values() for path in own]
        outside = person.static if person.static not in originals.values() else None
        # the one that the names or the settings tell; else the last that shows somebody who stands
        told = [path for place, path in labelled if path in standing and originals[place] == person.static]
        used = outside or next(iter(told + standing[::-1]), None)
        return [_Own(person.name, used, tuple(walks), tuple(path for path in standing if path != used))]
    sentence = (
        f"{person.name}: its recordings are of {len(named)} subjects by their own names ({', '.join(named)}); each is analysed alone."
    )
    mend = "Give each person a folder, or correct the names of the subjects."
    batch.found(Finding("session-two-people", Severity.WARNING, person.name, sentence, mend))
    return [
        _Own(f"{person.name} {subject}".strip(), standing[-1] if standing else None, tuple(walks), tuple(standing[:-1]))
        for subject, (standing, walks) in sorted(by_subject.items())
    ]


def _not_analysed(path: str, sentence: str, shows_no_gait: bool) -> Finding:
    said = sentence if Path(path).name in sentence else f"{path}: {sentence}"
    if shows_no_gait:
        mend = "Nothing, where nobody walks in it: its labels are written. Where somebody does, label heels, toes and the pelvis."
        return Finding("session-no-gait", Severity.NOTE, path, said, mend)
    mend = "Mend what is said, and run again; its labels are written, and the person's other recordings are analysed."
    return Finding("session-not-analysed", Severity.WARNING, path, said, mend)


def _summary(analysis: GaitAnalysis | None) -> dict[str, Any]:
    """What the table of a session says of a walk."""
    from asterism.gait import summarise

    if analysis is None:
        return {"cycles": 0, "cadence": None, "speed": None}
    means: dict[str, list[float]] = {}
    for one in summarise(analysis.parameters):
        means.setdefault(one.name, []).append(one.mean)
    found = {name: sum(values) / len(values) for name, values in means.items()}
    return {"cycles": len(analysis.cycles), "cadence": found.get("cadence"), "speed": found.get("walking speed")}
