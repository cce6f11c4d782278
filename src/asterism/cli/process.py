"""`asterism process`: the folders of a session in; labelled recordings, gait reports of each person and one table of all, out."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._filling import Fill, fill_limit
from asterism.cli._folders import Trial, check_folder, trials
from asterism.cli._options import Json, KnownLabels, KnownLabelsOption, Vertical, vertical_axis
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cli._process_tasks import PersonOptions, TaskResult
    from asterism.session import FolderSettings, Outcome, PlannedPerson

LOCK, TABLE, PARAMETERS, PAGE = "asterism-process.lock", "session.csv", "parameters.csv", "index.html"
"""In the folder of the results: what one run holds, the table of all recordings, that of all parameters, and the page on all."""
_COLUMNS = ("file", "person", "kind", "frames", "labelled", "use", "look_at", "cycles", "cadence", "speed", "subject", "worn", "report")


@dataclass(frozen=True)
class ProcessOptions:
    """What `asterism process` is asked to do."""

    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION", help="Folders of recordings, one for each person.", show_default=False)
    ]
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where all results go.", show_default=False)]
    model: Annotated[
        Path | None,
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
        Path | None,
        typer.Option("--band", metavar="FILE", help="A band of controls, which `asterism gait --save-band` wrote.", show_default=False),
    ] = None
    vertical: Vertical = None
    workers: Annotated[int, typer.Option(metavar="N", min=1, help="Processes that share the work; the result is the same.")] = 1
    dask: Annotated[
        str | None,
        typer.Option(
            "--dask", metavar="ADDRESS", help="A Dask scheduler (tcp://host:8786), or local:N, in place of --workers.", show_default=False
        ),
    ] = None
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")] = False
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Do all anew, also what somebody has corrected.")] = False
    json: Json = None


@takes(ProcessOptions)
def process(options: ProcessOptions) -> None:
    """Label and analyse a whole session.

    The recordings of one folder are one person's. Each is labelled as `asterism label` does it, with the person's standing trial. Then gaps
    are filled, and gait is analysed as `asterism gait` does it, with the measures and offsets of the standing trial. FOLDER gets the
    labelled recordings (labelled), a page for each person and each walk (reports), the parameters of each person (gait), a table of all
    recordings (session.csv), one of all parameters (parameters.csv), and a page on all (index.html).

    A run that was stopped goes on where it was. What was corrected since (`asterism review --serve`) stays, and what depends on it is made
    anew. A file session.toml in a folder says otherwise for it and those below: person, model, markers, static, vertical, fill, leave_out
    (patterns of files that are no trials) and a table of measures.
    """
    batch = _console.Batch("processed")
    _check(options)
    persons = _persons(options, batch)
    if options.dry_run:
        _show_plan(persons, options)
        raise typer.Exit(0)
    options.output.mkdir(parents=True, exist_ok=True)
    with _held(options.output):
        run = _Run(options, persons, batch)
        with _console.progress("processing") as progress:
            run.label(progress)
            run.analyse(progress)
        run.close()
    raise typer.Exit(batch.close())


def _check(options: ProcessOptions) -> None:
    """Raise AsterismError where options contradict each other, or an output cannot be made."""
    if options.model is not None and options.markers is not None:
        raise AsterismError(f"{options.model} has its own marker set; leave out --markers, or --model.")
    fill_limit(options.fill)
    _check_vertical(options.vertical)
    for path in options.sessions:
        if not path.is_dir():
            raise AsterismError(f"{path} is no folder; name the folder in which the recordings are.")
    for given in (options.model, options.band):
        if given is not None and not given.is_file():
            raise AsterismError(f"{given} does not exist; correct the name.")
    check_folder(options.output)
    _console.check_new(options.json, options.overwrite)


def _persons(options: ProcessOptions, batch: _console.Batch) -> list[tuple[PlannedPerson, PersonOptions]]:
    """Who is processed, and how: options, over which the settings of folders count."""
    from asterism.cli._process_tasks import PersonOptions
    from asterism.session import plan_session

    found = _recordings(options, batch)
    planned = plan_session([(trial.path, trial.place) for trial in found], options.sessions)
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
                    out=options.output,
                    model=settings.model or (None if settings.markers else options.model),
                    markers=settings.markers or (None if settings.model else options.markers),
                    static=person.standing,
                    vertical=settings.vertical or options.vertical,
                    known_labels=options.known_labels if settings.known_labels is None else KnownLabels(settings.known_labels),
                    fill=settings.fill or options.fill,
                    band=options.band,
                    measures=tuple(sorted(settings.measures.items())),
                    overwrite=options.overwrite,
                ),
            )
        )
    _check_places([how for _, how in persons])
    _tell_left_out(found, persons)
    return persons


def _recordings(options: ProcessOptions, batch: _console.Batch) -> list[Trial]:
    """The recordings of the session, without the results of other runs that lie in it: they would be persons of their own."""
    found = trials(options.sessions, batch, without=options.output)
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
    return [trial for trial in found if results[trial.path] is None]


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


def _show_plan(persons: Sequence[tuple[PlannedPerson, PersonOptions]], options: ProcessOptions) -> None:
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
    if options.json != "-":
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
    _console.write_json(options.json, {"command": "process", "dry_run": True, "persons": rows})


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """While this holds, no other run writes to the folder. Raises AsterismError where one does."""
    from asterism.files.atomic import holds

    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        # the system lets go of it whatever ends the run
        if holds(handle) is False:
            raise AsterismError(f"{folder}: another run of asterism process is at work in it; wait for its end, or choose another -o.")
        yield
    finally:
        os.close(handle)


class _Run:
    """A run over the persons of a session, and the rows of its table by the place of each recording."""

    def __init__(self, options: ProcessOptions, persons: Sequence[tuple[PlannedPerson, PersonOptions]], batch: _console.Batch) -> None:
        self.options, self.batch = options, batch
        self.persons = [how for _, how in persons]
        self.rows: dict[str, dict[str, Any]] = {}
        self.trials = sum(len(person.trials) for person in self.persons)

    def label(self, progress: Any) -> None:
        """Label all recordings; what cannot be labelled is named."""
        from asterism.cli._process_tasks import LabelTask, label_trial
        from asterism.session import in_order, spread

        tasks = [LabelTask(person, place) for person in self.persons for place in range(len(person.trials))]
        outcomes = spread(label_trial, tasks, workers=self.options.workers, dask=self.options.dask)
        for done, (task, outcome) in enumerate(zip(tasks, in_order(outcomes), strict=True)):
            path, place = task.person.trials[task.place]
            with self.batch.file(path):
                (row,) = self._result(outcome).rows
                self.rows[place.as_posix()] = {"person": task.person.name, **row, "file": path}
            if progress is not None:
                # analysing a walk takes a tenth of labelling it
                progress(0.9 * (done + 1) / len(tasks), path.name)

    def analyse(self, progress: Any) -> None:
        """Analyse the recordings of each person."""
        from asterism.cli._process_tasks import analyse_person
        from asterism.session import in_order, spread

        outcomes = spread(analyse_person, self.persons, workers=self.options.workers, dask=self.options.dask)
        for done, (person, outcome) in enumerate(zip(self.persons, in_order(outcomes), strict=True)):
            with self._failing(person.name):
                result = self._result(outcome)
                for row in result.rows:
                    self.rows.setdefault(row["place"], {}).update({name: value for name, value in row.items() if name != "place"})
                for path, sentence in result.failed.items():
                    with self._failing(path):
                        raise AsterismError(sentence)
            if progress is not None:
                progress(0.9 + 0.1 * (done + 1) / len(self.persons), person.name)

    def _result(self, outcome: Outcome[TaskResult]) -> TaskResult:
        """What a task has answered; its findings are told. Raises AsterismError with the problem of one that has none."""
        from asterism.findings import Finding

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

    def close(self) -> None:
        """Write the tables and the page, and print what became of each recording."""
        from asterism.report.session import session_report

        out, rows = self.options.output, list(self.rows.values())
        if not rows:
            return
        _console.write_csv(out / TABLE, _COLUMNS, [["" if row.get(name) is None else row.get(name) for name in _COLUMNS] for row in rows])
        _join(out / PARAMETERS, sorted({out / "gait" / f"{name}.csv" for name in self._tables()}))
        session_report(out / PAGE, rows, self.batch.findings, [*map(str, self.batch.failed)])
        if self.options.json != "-":
            self._print(rows)
        _console.write_json(
            self.options.json,
            {
                "command": "process",
                "output": out,
                "files": rows,
                "passed_over": self.batch.passed_over,
                "failed": self.batch.failed,
                "findings": [finding.to_dict() for finding in self.batch.findings],
            },
        )

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
                for row in rows
            ],
            left=3,
        )
        _console.result(f"{counted(walks, 'walk')} analysed; open {self.options.output / PAGE}")


def _join(target: Path, tables: Sequence[Path]) -> None:
    """One table of those that are there, which have the same columns."""
    from asterism.files.atomic import write_atomically

    lines: list[str] = []
    for path in tables:
        if path.is_file():
            own = path.read_text(encoding="utf-8").splitlines()
            lines += own if not lines else own[1:]
    write_atomically(target, "".join(f"{line}\n" for line in lines).encode())
