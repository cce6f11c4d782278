"""`asterism process`: the folders of a session in; labelled recordings, gait reports of each person and one table of all, out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._filling import Fill, fill_limit
from asterism.cli._folders import Trial, check_folder, trials
from asterism.cli._options import Dask, Json, KnownLabels, KnownLabelsOption, Processes, Vertical, vertical_axis
from asterism.cli._process_places import SessionPlaces
from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically
from asterism.files.plain import as_json
from asterism.files.stalls import unless_stalled
from asterism.findings import Finding, Severity

if TYPE_CHECKING:
    from asterism.cli._process_tasks import PersonOptions, PersonTask, TaskResult
    from asterism.session import FolderSettings, Held, Outcome, PlannedPerson

TABLE, PARAMETERS, PAGE = "session.csv", "parameters.csv", "index.html"
"""In the folder of the results: the table of all recordings, that of all parameters, and the page on all."""
_MOST_PRINTED = 200
"""Lines of the table on the terminal: what somebody may scroll through."""
LEDGER = "session.json"
"""Among the records: which recordings and persons the sessions had."""
_COLUMNS = ("file", "person", "kind", "frames", "labelled", "use", "look_at", "cycles", "cadence", "speed", "subject", "worn", "report")


@dataclass(frozen=True)
class ProcessOptions:
    """What `asterism process` is asked to do."""

    sessions: Annotated[
        list[str],
        typer.Argument(
            metavar="SESSION", help="Folders of recordings, one for each person, or their addresses (s3://...).", show_default=False
        ),
    ]
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FOLDER", help="Where all results go; or an address.", show_default=False)
    ]
    model: Annotated[
        str | None,
        typer.Option(
            "--model", "-m", metavar="FILE", help="The model that labels; else virtual people who wear the set.", show_default=False
        ),
    ] = None
    markers: Annotated[
        str | None,
        typer.Option("--markers", metavar="SET", help="Without a model, the marker set worn. Else it is found.", show_default=False),
    ] = None
    known_labels: KnownLabelsOption = None
    fill: Fill = "auto"
    band: Annotated[
        str | None,
        typer.Option("--band", metavar="FILE", help="A band of controls, which `asterism gait --save-band` wrote.", show_default=False),
    ] = None
    vertical: Vertical = None
    skeleton: Annotated[bool, typer.Option("--skeleton", help="Write each walk's skeleton (BVH) and a table of joints, too.")] = False
    workers: Processes = 1
    dask: Dask = None
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")] = False
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Do all anew, also what somebody has corrected.")] = False
    json: Json = None


@takes(ProcessOptions)
def process(options: ProcessOptions) -> None:
    """Label and analyse a whole session.

    The recordings of one folder are one person's. Each is labelled as `asterism label` does it, with the person's standing trial. Then gaps
    are filled, and gait is analysed as `asterism gait` does it, with the measures and offsets of the standing trial. FOLDER gets the
    labelled recordings (labelled), a page for each person and each walk (reports), the parameters of each person (gait), a table of all
    recordings (session.csv), one of all parameters (parameters.csv), and a page on all (index.html). With --skeleton, bones over time too.

    A run that was stopped goes on where it was. What was corrected since (`asterism review --serve`) stays, and what depends on it is made
    anew. A file session.toml in a folder says otherwise for it and those below: person, model, markers, static, vertical, fill, leave_out
    (patterns of files that are no trials) and a table of measures.
    """
    batch = _console.Batch("processed")
    given = _Given.of(options)
    _check(given)
    persons = _persons(given, batch)
    if options.dry_run:
        _show_plan(persons, given)
        raise typer.Exit(1 if batch.failed else 0)
    from asterism.session import held

    out, remote = given.output, given.places.folders.get(given.output)
    out.mkdir(parents=True, exist_ok=True)
    with held(remote or out, lambda sentence: _console.notice(f"asterism: {sentence}")) as hold:
        run = _Run(given, persons, batch, hold)
        with _console.progress("processing") as progress:
            run.label(progress)
            run.analyse(progress)
        run.close()
    raise typer.Exit(batch.close())


@dataclass(frozen=True)
class _Given:
    """The options, and the paths of what they name: folders of sessions and results, model and band."""

    options: ProcessOptions
    places: SessionPlaces
    sessions: list[Path]
    output: Path
    model: Path | None
    band: Path | None

    @classmethod
    def of(cls, options: ProcessOptions) -> _Given:
        places = SessionPlaces()
        sessions, output = [places.path(one) for one in options.sessions], places.path(options.output)
        return cls(options, places, sessions, output, places.file(options.model), places.file(options.band))


def _check(given: _Given) -> None:
    """Raise AsterismError where options contradict each other, or an output cannot be made. Of addresses, show what is there."""
    options = given.options
    if options.model is not None and options.markers is not None:
        raise AsterismError(f"{options.model} has its own marker set; leave out --markers, or --model.")
    fill_limit(options.fill)
    _check_vertical(options.vertical)
    for path in given.sessions:
        given.places.show(path)
        # a folder of a network that is gone would be waited for without end
        if not unless_stalled(path, partial(_is_folder, path)):
            raise AsterismError(f"{path} is no folder; name the folder in which the recordings are.")
    for file in (given.model, given.band):
        if file is not None and not file.is_file():
            raise AsterismError(f"{file} does not exist; correct the name.")
    remote = given.places.folders.get(given.output)
    if remote is None:
        check_folder(given.output)
    elif not options.dry_run:
        remote.check(given.places.scratch)
    _console.check_new(options.json, options.overwrite)


def _persons(given: _Given, batch: _console.Batch) -> list[tuple[PlannedPerson, PersonOptions]]:
    """Who is processed, and how: options, over which the settings of folders count."""
    from asterism.cli._process_tasks import PersonOptions
    from asterism.session import plan_session

    options = given.options
    found = _recordings(given, batch)
    planned = plan_session([(trial.path, trial.place) for trial in found], given.sessions)
    persons: list[tuple[PlannedPerson, PersonOptions]] = []
    for person in planned:
        settings = person.settings
        _check_settings(settings)
        persons.append(
            (
                person,
                PersonOptions(
                    name=person.name,
                    trials=tuple((trial.path, trial.place) for trial in person.trials),
                    out=given.output,
                    model=settings.model or (None if settings.markers else given.model),
                    markers=settings.markers or (None if settings.model else options.markers),
                    static=person.standing,
                    vertical=settings.vertical or options.vertical,
                    known_labels=options.known_labels if settings.known_labels is None else KnownLabels(settings.known_labels),
                    fill=settings.fill or options.fill,
                    band=given.band,
                    measures=tuple(sorted(settings.measures.items())),
                    skeleton=options.skeleton,
                    overwrite=options.overwrite,
                ),
            )
        )
    _check_places([how for _, how in persons])
    _tell_left_out(found, persons)
    return persons


def _recordings(given: _Given, batch: _console.Batch) -> list[Trial]:
    """The recordings of the session, without the results of other runs that lie in it: they would be persons of their own."""
    from asterism.session import LOCK

    found = trials(given.sessions, batch, without=given.output)
    results: dict[Path, Path | None] = {}
    for trial in found:
        # what lies above the session says nothing: results may go there
        inside = [one for one in trial.path.parents if trial.folder is not None and one.is_relative_to(trial.folder)]
        results[trial.path] = next((one for one in inside if (one / LOCK).is_file()), None)
    for folder in sorted({one for one in results.values() if one is not None}):
        said = f"{folder} holds results of asterism process"
        if all(results.values()):
            raise AsterismError(f"{said}; name the folder of the recordings.")
        _console.notice(f"asterism: {said} and is left out; move it out of the session.")
    return _without_copies([trial for trial in found if results[trial.path] is None], batch)


_RICHEST = (".c3d", ".npz", ".mat", ".trc", ".tsv", ".csv")
"""Of files of one name, the first of these kinds is the recording: C3D holds most, and others were exported from it."""


def _without_copies(found: Sequence[Trial], batch: _console.Batch) -> list[Trial]:
    """The recordings without those that lie beside one of the same name and a richer kind: walk.trc and walk.csv beside walk.c3d."""
    named: dict[tuple[Path, str], list[Trial]] = {}
    for trial in found:
        named.setdefault((trial.path.parent, trial.path.stem.casefold()), []).append(trial)
    rank = {suffix: number for number, suffix in enumerate(_RICHEST)}
    kept = {min(own, key=lambda one: rank.get(one.path.suffix.lower(), len(rank))).path for own in named.values()}
    copies = [trial.path for trial in found if trial.path not in kept]
    if copies:
        from asterism.recording.display import counted

        few = ", ".join(map(str, copies[:6])) + (", ..." if len(copies) > 6 else "")
        said = f"{counted(len(copies), 'file')} of the names of other recordings beside them are taken for copies and left out: {few}."
        mend = "Nothing, where they are; else give them names of their own."
        batch.found(Finding("session-copies", Severity.NOTE, str(copies[0].parent), said, mend))
    return [trial for trial in found if trial.path in kept]


def _check_settings(settings: FolderSettings) -> None:
    """Raise AsterismError, with the name of the file, where it says what an option of the same name could not."""
    from asterism.cli._clinical import given_measures

    known = "known_labels"
    if settings.known_labels is not None and settings.known_labels not in set(KnownLabels):
        raise AsterismError(f"{settings.said[known]}: {known} is {settings.known_labels}; write {', '.join(KnownLabels)}.")
    with _named(settings, "vertical"):
        _check_vertical(settings.vertical)
    with _named(settings, "fill"):
        fill_limit(settings.fill or "none")
    with _named(settings, "measures"):
        given_measures([f"{name}={value!r}" for name, value in settings.measures.items()])


def _check_vertical(given: str | None) -> None:
    from asterism.recording import as_vertical

    axis = vertical_axis(given)
    if axis is not None:
        as_vertical(axis)


@contextmanager
def _named(settings: FolderSettings, key: str) -> Iterator[None]:
    """What is wrong with a setting is told with the file that says it."""
    try:
        yield
    except AsterismError as problem:
        raise AsterismError(f"{settings.said[key]}: {problem}") from None


def _tell_left_out(found: Sequence[Trial], persons: Sequence[tuple[PlannedPerson, PersonOptions]]) -> None:
    """Say of which folders settings leave out every recording; raises AsterismError where that is all of them."""
    folders = {trial.path.parent for trial in found} - {path.parent for _, how in persons for path, _ in how.trials}
    for folder in sorted(folders):
        said = f"{folder}: leave_out in session.toml leaves out all of its recordings; correct the patterns if that is not what is meant."
        if not persons:
            raise AsterismError(said)
        _console.notice(f"asterism: {said}")


def _check_places(persons: Sequence[PersonOptions]) -> None:
    """Raise AsterismError where two recordings, or two persons, would have one file between them: the second would replace the first."""
    from asterism.cli._process_tasks import OUTPUTS, REPORTS, file_name

    taken: dict[str, str] = {}
    for person in persons:
        targets = [(f"{OUTPUTS}/{place.with_suffix('.c3d').as_posix()}", str(path)) for path, place in person.trials]
        targets += [(f"{REPORTS}/{file_name(person.name)}.html", f"the person {person.name}")]
        for target, whose in targets:
            # some file systems do not distinguish capital letters
            if (other := taken.setdefault(target.casefold(), whose)) != whose:
                raise AsterismError(
                    f"{other} and {whose} would both be written to {target}; rename one, or say in session.toml which files are no "
                    "trials (leave_out) or what the person is called (person)."
                )


def _show_plan(persons: Sequence[tuple[PlannedPerson, PersonOptions]], given: _Given) -> None:
    """What would be done, as a table and as JSON."""
    from asterism.recording.display import counted

    rows = [
        {
            "person": how.name,
            "recordings": [path for path, _ in how.trials],
            "static": how.static,
            "model": how.model,
            "markers": how.markers,
            "fill": how.fill,
            "measures": dict(how.measures),
            "settings": list(person.settings.files),
        }
        for person, how in persons
    ]
    if given.options.json != "-":
        _console.table(
            counted(len(rows), "person"),
            ["person", "recordings", "standing trial", "labelled by", "fill", "settings"],
            [
                [
                    how.name,
                    str(len(how.trials)),
                    "by what trials show" if how.static is None else how.static.name,
                    str(how.model or f"virtual people, {how.markers or 'set to be found'}"),
                    how.fill,
                    ", ".join(map(str, person.settings.files)) or "–",
                ]
                for person, how in persons
            ],
            left=6,
        )
    plan = given.places.told(as_json({"command": "process", "dry_run": True, "persons": rows}))
    _console.write_json(given.options.json, plan)


class _Run:
    """A run over the persons of a session, and the rows of its table by the place of each recording."""

    def __init__(self, given: _Given, persons: Sequence[tuple[PlannedPerson, PersonOptions]], batch: _console.Batch, hold: Held) -> None:
        self.options, self.places, self.out, self.batch, self.hold = given.options, given.places, given.output, batch, hold
        self.sessions = given.sessions
        self.persons = [how for _, how in persons]
        self.rows: dict[str, dict[str, Any]] = {}
        self.tasks: list[PersonTask] = []
        self.workers = self._workers()

    def _workers(self) -> int:
        """The processes that share the work: as many as were asked for, or fewer where the memory does not hold them, which is told."""
        from asterism.session.memory import free_memory, need_of, that_fit

        asked = self.options.workers
        if asked < 2 or self.options.dask is not None:
            return asked
        needs = {person.name: need_of([_size(path) for path, _ in person.trials]) for person in self.persons}
        largest, free = max(needs, key=lambda name: needs[name]), free_memory()
        found = that_fit(asked, needs[largest], free)
        if found < asked and free is not None:
            need, has = needs[largest] / 1e9, free / 1e9
            _console.notice(
                f"asterism: {found} of {asked} processes: one may need {need:.1f} GB, for {largest}, and {has:.1f} GB of memory are free."
            )
        return found

    def label(self, progress: Any) -> None:
        """Label all recordings; what cannot be labelled is named."""
        from asterism.cli._process_tasks import label_trial, write_plan

        self.tasks = [write_plan(person, self.places) for person in self.persons]
        tasks = [
            replace(task, place=place) for task, person in zip(self.tasks, self.persons, strict=True) for place in range(len(person.trials))
        ]
        of_tasks = [(person, *trial) for person in self.persons for trial in person.trials]
        for done, ((person, path, place), outcome) in enumerate(zip(of_tasks, self._spread(label_trial, tasks), strict=True)):
            with self.batch.file(path):
                (row,) = self._result(outcome).rows
                self.rows[place.as_posix()] = {"person": person.name, **row, "file": self.places.name(path)}
            if progress is not None:
                # analysing a walk takes a tenth of labelling it
                progress(0.9 * (done + 1) / len(tasks), path.name)

    def analyse(self, progress: Any) -> None:
        """Analyse the recordings of each person."""
        from asterism.cli._process_tasks import analyse_person

        for done, (person, outcome) in enumerate(zip(self.persons, self._spread(analyse_person, self.tasks), strict=True)):
            with self._failing(person.name):
                result = self._result(outcome)
                for row in result.rows:
                    self.rows.setdefault(row["place"], {}).update({name: value for name, value in row.items() if name != "place"})
                for path, sentence in result.failed.items():
                    with self._failing(path):
                        raise AsterismError(sentence)
            if progress is not None:
                progress(0.9 + 0.1 * (done + 1) / len(self.persons), person.name)

    def _spread(self, function: Callable[[PersonTask], TaskResult], tasks: Sequence[PersonTask]) -> Iterator[Outcome[TaskResult]]:
        """What the function gives for each task, in their order. Ends the run where the disk is full: no other task would fare better."""
        from asterism.session import in_order, spread

        for done, outcome in enumerate(in_order(spread(function, tasks, workers=self.workers, dask=self.options.dask))):
            self.hold.check()
            if outcome.no_room:
                _console.error(
                    f"{outcome.problem} The run ends after {done} of {len(tasks)} tasks: free some space, and run the same command "
                    "again; it goes on from there."
                )
                raise typer.Exit(1)
            yield outcome

    def _result(self, outcome: Outcome[TaskResult]) -> TaskResult:
        """What a task has answered; its findings are told. Raises AsterismError with the problem of one that has none."""
        if outcome.value is None:
            raise AsterismError(outcome.problem)
        for finding in outcome.value.findings:
            self.batch.found(Finding.from_dict(finding))
        return outcome.value

    @contextmanager
    def _failing(self, name: str) -> Iterator[None]:
        """A person or recording that cannot be analysed is named; the recordings that were labelled count by themselves."""
        try:
            yield
        except AsterismError as problem:
            _console.error(str(problem) if name in str(problem) else f"{name}: {problem}")
            self.batch.failed.append(Path(name))
            self.batch.reasons[Path(name)] = str(problem)

    def close(self) -> None:
        """Write the tables and the page, and print what became of each recording."""
        from asterism.report.session import session_report

        for finding in self._left_over():
            self.batch.found(finding)
        out, rows = self.out, list(self.rows.values())
        failed = [self.places.name(path) for path in self.batch.failed]
        findings = [Finding.from_dict(one) for one in self.places.told([finding.to_dict() for finding in self.batch.findings])]
        if rows:
            cells = [["" if row.get(name) is None else row.get(name) for name in _COLUMNS] for row in rows]
            _console.write_csv(out / TABLE, _COLUMNS, cells)
            tables = sorted({out / "gait" / f"{name}.csv" for name in self._tables()})
            _join(out / PARAMETERS, [path for path in tables if self.places.bring(path)])
            reasons = [self.places.told(self.batch.reasons.get(path, "")) for path in self.batch.failed]
            session_report(out / PAGE, rows, findings, dict(zip(failed, reasons, strict=True)))
            for name in (TABLE, PARAMETERS, PAGE):
                self.places.take(out / name)
            if self.options.json != "-":
                self._print(rows)
        content = {
            "command": "process",
            "output": self.places.name(out),
            "files": rows,
            "passed_over": self.batch.passed_over,
            "failed": failed,
            "findings": [finding.to_dict() for finding in findings],
        }
        _console.write_json(self.options.json, self.places.told(as_json(content)))

    def _left_over(self) -> list[Finding]:
        """The results of recordings and persons that the session had in an earlier run and has no longer, as a finding; and keep today's.

        Nothing is removed: a folder that is not mounted looks as if all were gone, and somebody may have corrected the labels.
        """
        from asterism.cli._process_tasks import RECORDS, of_person, of_recording
        from asterism.recording.display import counted

        ledger = self.out / RECORDS / LEDGER
        try:
            before = json.loads(ledger.read_bytes()) if self.places.bring(ledger) else {}
        except ValueError:  # cut off by a power failure
            before = {}
        # what an earlier run has made from other sessions is none of ours
        session = " ".join(sorted(self.places.name(path) for path in self.sessions))
        places, persons = {place.as_posix() for person in self.persons for _, place in person.trials}, set(self._tables())
        earlier = before.get(session, {})
        gone = {place: of_recording(place) for place in earlier.get("recordings", []) if place not in places}
        gone |= {f"the person {name}": of_person(name) for name in earlier.get("persons", []) if name not in persons}
        left = {name: [one for one in outputs if self.places.exists(self.out / one)] for name, outputs in gone.items()}
        # until somebody has moved them, they are told by each run
        kept = {
            "recordings": sorted(places | {one for one in earlier.get("recordings", []) if left.get(one)}),
            "persons": sorted(persons | {one for one in earlier.get("persons", []) if left.get(f"the person {one}")}),
        }
        ledger.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(ledger, json.dumps({**before, session: kept}).encode())
        self.places.take(ledger)
        stale = [one for outputs in left.values() for one in outputs]
        if not stale:
            return []
        few = ", ".join(stale[:6]) + (", ..." if len(stale) > 6 else "")
        said = f"{self.places.name(self.out)}: the session has no longer what {counted(len(stale), 'result')} were made from: {few}."
        mend = "Move them away, or bring the recordings back; tables and pages of this run do not count them."
        return [Finding("session-left-over", Severity.WARNING, self.places.name(self.out), said, mend)]

    def _tables(self) -> list[str]:
        from asterism.cli._process_tasks import file_name

        return [file_name(person.name) for person in self.persons]

    def _print(self, rows: Sequence[dict[str, Any]]) -> None:
        from asterism.recording.display import counted

        walks = sum(row.get("kind") == "walk" for row in rows)
        _console.table(
            f"{counted(len(rows), 'recording')} of {counted(len(self.persons), 'person')}",
            ["file", "person", "kind", "labelled", "use", "cycles", "cadence", "m/s"],
            [
                [
                    str(row["file"]),
                    row["person"],
                    row.get("kind") or "–",
                    _console.percent(row["labelled"] if row.get("labelled") is not None else float("nan")),
                    row.get("use") or "–",
                    str(row.get("cycles") or "–"),
                    "–" if row.get("cadence") is None else f"{row['cadence']:.1f}",
                    "–" if row.get("speed") is None else f"{row['speed']:.2f}",
                ]
                for row in rows[:_MOST_PRINTED]
            ],
            left=3,
        )
        if len(rows) > _MOST_PRINTED:
            _console.result(f"... and {len(rows) - _MOST_PRINTED} more; {self.out / TABLE} has all.")
        _console.result(f"{counted(walks, 'walk')} analysed; open {self.out / PAGE}")


def _is_folder(path: Path, _: object) -> bool:
    return path.is_dir()


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # it is named when it is labelled
        return 0


def _join(target: Path, tables: Sequence[Path]) -> None:
    """One table of those that are there, which have the same columns."""
    lines: list[str] = []
    for path in tables:
        if path.is_file():
            own = path.read_text(encoding="utf-8").splitlines()
            lines += own if not lines else own[1:]
    write_atomically(target, "".join(f"{line}\n" for line in lines).encode())
