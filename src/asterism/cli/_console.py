"""How all commands print: results to standard output, failures and progress to standard error."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli._printable import printable
from asterism.cli._streams import StandardOutputError
from asterism.errors import AsterismError, NoMarkers, refuse_special, sentence_of
from asterism.files.plain import as_json
from asterism.findings import Finding, exit_status
from asterism.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console


_WIDTH_WHEN_PIPED = 160


def console() -> Console:
    """Standard output as Rich sees it; wide where it is not a terminal, so that nothing is cut off."""
    from rich.console import Console

    # a file has no width, and a table that is cut there is lost
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDTH_WHEN_PIPED
    return Console(width=width, highlight=False, soft_wrap=False)


def result(line: str) -> None:
    """One plain line of result."""
    print(printable(line), flush=True)


def error(sentence: str) -> None:
    """One plain line on standard error."""
    # results first, in the order in which they came; None where a stream could not be written
    if sys.stdout is not None:
        sys.stdout.flush()
    # where even this cannot be shown, the exit status still tells
    with suppress(OSError):
        print(f"asterism: {printable(sentence)}", file=sys.stderr, flush=True)


def report(finding: Finding) -> None:
    """A finding as one line on standard error: where, what, the mend, and the code that docs/findings.md explains."""
    sentence = str(finding) if finding.where in finding.sentence else f"{finding.where}: {finding}"
    error(f"{sentence} [{finding.code}]")


def reason(problem: Exception) -> str:
    """What an exception means to a user: one line."""
    # the system's words, without its number and the name of the class
    if isinstance(problem, OSError) and problem.filename:
        return f"{problem.filename}: {(problem.strerror or 'cannot be opened').lower()}."
    sentence = sentence_of(problem)
    # whatever else gets here is ours to mend
    expected = isinstance(problem, AsterismError | OSError)
    return sentence if expected else f"{sentence}; this is a fault of Asterism, please report it with the file."


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> None:
    """Print a table: the first `left` columns are text, the others numbers, which are never cut.

    A table that is too wide for the terminal is printed with a column for each row, if that fits.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    screen = console()
    lines = [tuple(map(printable, row)) for row in (columns, *rows)]
    # many columns and few rows read better the other way round
    turned = list(zip(*lines, strict=True))
    if _width(lines) > screen.width >= _width(turned):
        lines, left = turned, 1
    sheet = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, cells in enumerate(zip(*lines, strict=True)):
        # numbers are never folded: half a number is another number
        widest = max(map(len, cells[1:]), default=0)
        sheet.add_column(
            Text(cells[0]), justify="left" if i < left else "right", overflow="fold", min_width=min(widest, 8) if i < left else widest
        )
    for line in lines[1:]:
        sheet.add_row(*(Text(cell) for cell in line))
    screen.print(Text(printable(title), style="bold"), sheet, sep="\n", crop=False)


def _width(lines: Sequence[Sequence[str]]) -> int:
    """The width of a table in characters, with each cell in one line."""
    return sum(max(map(len, cells)) + 3 for cells in zip(*lines, strict=True))


def facts(title: str, rows: Sequence[tuple[str, str]]) -> None:
    """Print names with their values under a title; long values go on below, as wide as the terminal."""
    import shutil
    import textwrap

    width = shutil.get_terminal_size().columns if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDTH_WHEN_PIPED
    indent = max((len(name) for name, _ in rows), default=0) + 4
    lines = [title]
    for name, value in ((printable(name), printable(value)) for name, value in rows):
        first, *others = textwrap.wrap(value, max(width - indent, 20), break_on_hyphens=False) or [""]
        lines += [f"  {name}".ljust(indent) + first, *(" " * indent + line for line in others)]
    print(printable("\n".join(lines)), flush=True)


def percent(fraction: float, digits: int = 2) -> str:
    """0.1234 as 12.34 %, or a dash for NaN."""
    return "–" if math.isnan(fraction) else f"{100 * fraction:.{digits}f} %"


def count(number: float) -> str:
    """12345.6 as 12,346."""
    return "–" if math.isnan(number) else f"{number:,.0f}"


_PROGRESS_INTERVAL = 60.0
"""s between two lines of progress where standard error is no terminal."""
_bars: list[Callable[[str], None]] = []
"""The progress bar that is on the terminal: sets its description."""


@contextmanager
def progress(what: str) -> Iterator[Progress | None]:
    """A bar with the remaining time on standard error, where that is a terminal; elsewhere a line each minute. None within another bar."""
    if _bars:
        yield None
        return
    # a bar in a log is a thousand lines
    if not sys.stderr.isatty():
        yield _each_minute(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True, redirect_stdout=sys.stdout.isatty()) as bar:
        task = bar.add_task(what, total=1.0)
        # what compiles meanwhile says so in the bar, not above it
        _bars.append(lambda text: bar.update(task, description=printable(text)))
        try:
            yield lambda fraction, doing: bar.update(task, completed=fraction, description=printable(doing or what))
        finally:
            _bars.pop()


def _each_minute(what: str) -> Progress:
    """Progress for a file or another program that reads standard error: one line each minute, none in the first."""
    import time

    last = time.monotonic()

    def tell(fraction: float, doing: str = "") -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _PROGRESS_INTERVAL:
            last = now
            print(f"{what}: {100 * fraction:.0f} %{f', {doing}' if doing else ''}", file=sys.stderr, flush=True)

    return tell


def notice(sentence: str, *, in_progress_line: bool = False) -> None:
    """Print a line on standard error that is no failure; in the progress line where there is one and `in_progress_line` is set."""
    # the bar says it, and forgets it with the next step
    if _bars and in_progress_line:
        _bars[-1](sentence.rstrip("."))
        return
    # what nobody can read must not end the work that it tells of
    with suppress(OSError):
        if _bars:
            from rich.console import Console

            Console(stderr=True, highlight=False).print(printable(sentence), markup=False)
            return
        sys.stdout.flush()
        print(printable(sentence), file=sys.stderr, flush=True)


class Batch:
    """A run over many files: a file that fails is named, and the others are still done."""

    def __init__(self, verb: str) -> None:
        self.verb = verb
        self.in_folders: frozenset[Path] = frozenset()
        self.passed_over: list[Path] = []
        self.done: list[Path] = []
        self.failed: list[Path] = []
        self.reasons: dict[Path, str] = {}
        self.findings: list[Finding] = []

    @contextmanager
    def file(self, path: Path) -> Iterator[None]:
        """Work on one file; whatever it raises costs this file only and becomes one line on standard error.

        A file that was found in a folder (`in_folders`) and holds no markers is passed over. Work may come in several steps: a file is
        counted once, and is done only where no step failed.
        """
        try:
            yield
        # the reader of our output has gone: no file is to blame
        except (BrokenPipeError, StandardOutputError):
            raise
        except Exception as problem:
            # an exit is no failure of the file
            if type(problem).__module__.startswith(("typer", "click")):
                raise
            # of a folder, nobody said that each file holds markers; of a file that was named, somebody did
            if isinstance(problem, NoMarkers) and path in self.in_folders:
                self.passed_over.append(path)
                return
            sentence = reason(problem)
            error(sentence if path.name in sentence else f"{path}: {sentence}")
            # what an earlier step has done does not make the file done
            self.done = [other for other in self.done if other != path]
            if path not in self.failed:
                self.failed.append(path)
            self.reasons[path] = sentence
        else:
            if path not in self.done and path not in self.failed:
                self.done.append(path)

    def found(self, finding: Finding) -> None:
        """Print a finding on a file, and count it in the exit status."""
        report(finding)
        self.findings.append(finding)

    @property
    def status(self) -> int:
        """0: all files done, without warnings. 1: some files failed, or a warning or error was found. 2: no file done."""
        return 2 if (self.failed or self.passed_over) and not self.done else 1 if self.failed else exit_status(self.findings)

    def tell_passed_over(self) -> None:
        """Name the files in folders that hold no markers."""
        if self.passed_over:
            holds = "1 file in the folders holds" if len(self.passed_over) == 1 else f"{len(self.passed_over)} files in the folders hold"
            few = ", ".join(map(str, self.passed_over[:8])) + (", ..." if len(self.passed_over) > 8 else "")
            notice(f"{holds} no markers and {'was' if len(self.passed_over) == 1 else 'were'} passed over: {few}")

    def close(self) -> int:
        """Name the failed files once more where the batch had several files; returns the status."""
        total = len(self.done) + len(self.failed)
        self.tell_passed_over()
        # the reasons have scrolled away by now
        if self.failed and total > 1:
            error(f"{total} files: {len(self.done)} {self.verb}, {len(self.failed)} failed: {', '.join(map(str, self.failed))}")
        return self.status


def silence_opencv() -> None:
    """Keep OpenCV and FFmpeg, which are not imported yet, from repeating on standard error what is said here in one sentence."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


def check_new(given: Path | str | None, overwrite: bool) -> None:
    """Raise AsterismError where a file exists and may not be overwritten, or its folder is missing. None and "-" are no files."""
    if given is None or given == "-":
        return
    from tempfile import TemporaryFile

    from asterism.files.atomic import on_removed

    # what a killed run has left beside the target is told before it goes
    on_removed(lambda unfinished: notice(f"{unfinished} was left by a run that was killed; it is removed."))
    path = Path(given)
    refuse_special(path)
    if path.is_dir():
        raise AsterismError(f"{path} is a folder; give the name of a file in it.")
    if path.exists() and not overwrite:
        raise AsterismError(f"{path} exists; choose another name, or replace it with --overwrite.")
    if not path.absolute().parent.is_dir():
        raise AsterismError(f"{path}: its folder does not exist; make it first.")
    try:
        # asking for permissions says less than trying
        with TemporaryFile(dir=path.absolute().parent):
            pass
    except OSError:
        raise AsterismError(f"{path}: its folder cannot be written to; choose another.") from None


def real_path(path: Path) -> Path:
    """The file behind all links, whether it exists or not."""
    # `Path.resolve` raises on a link that leads to itself, which opening the file names better
    return Path(os.path.realpath(path))


def check_outputs(outputs: Sequence[Path | str | None], inputs: Sequence[Path | None], overwrite: bool) -> None:
    """Raise AsterismError where an output cannot be made (`check_new`), is an input, or is named twice."""
    read = {real_path(path) for path in inputs if path is not None}
    written: set[Path] = set()
    for given in outputs:
        check_new(given, overwrite)
        if given is None or given == "-":
            continue
        # two spellings of one place are one file
        path = real_path(Path(given))
        if path in read or path in written:
            raise AsterismError(f"{given} is {'an input' if path in read else 'named twice'}; write to another file.")
        written.add(path)


def write_csv(target: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table, whole or not at all."""
    import csv
    import io

    from asterism.files.atomic import write_atomically

    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    write_atomically(target, text.getvalue().encode())


def write_json(where: str | None, content: Mapping[str, Any]) -> None:
    """Write `content` to the file `where`, or to standard output for "-"; NaN becomes null. Nothing for None."""
    if where is None:
        return
    import json

    text = json.dumps(as_json(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if where == "-":
        if sys.stdout is None or getattr(sys.stdout, "name", "") == os.devnull:
            raise StandardOutputError("standard output is closed; give --json the name of a file.")
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    from asterism.files.atomic import write_atomically

    write_atomically(Path(where), text.encode("utf-8", "backslashreplace"))  # as JSON writes what is no character
