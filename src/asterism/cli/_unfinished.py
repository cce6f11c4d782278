"""Long work in; the same work that goes on where an earlier run of it was broken off, out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from asterism import __version__
from asterism.cli import _console
from asterism.errors import AsterismError
from asterism.files.journal import Journal


def file_mark(path: Path) -> str:
    """A file as far as another one of its name is told from it: place, size and time of its last change."""
    try:
        state = path.stat()
    except OSError:
        return f"{path}: not there"
    return f"{_console.real_path(path)} {state.st_size} {state.st_mtime_ns}"


@contextmanager
def continued(output: Path, inputs: Iterable[Path], *options: object) -> Iterator[Journal]:
    """The steps of the work that makes `output`, kept beside it as OUTPUT.unfinished until it is done.

    inputs, options  all that the steps depend on; where anything of it changed the work begins anew

    The file stays after an interruption, a kill and a fault, and goes once the output is written or the input is refused.
    """
    work = "\n".join([__version__, *map(file_mark, inputs), *map(repr, options)])
    path = output.with_name(f"{output.name}.unfinished")
    journal = Journal(path, work)
    if journal.kept:
        _console.notice(f"{path}: the same work was broken off there; it goes on from step {journal.kept + 1}.")
    elif journal.other:
        _console.notice(f"{path} was of other work (its files or options changed); it begins anew.")
    try:
        yield journal
    except AsterismError:
        # the next run would be refused likewise
        journal.remove()
        raise
    except BaseException:
        journal.close()
        if path.exists():
            _console.notice(f"{path} holds what was done; the same command goes on from there.")
        raise
    journal.remove()
    if journal.lost:
        _console.notice(f"{path} could not be written ({journal.lost}); a run that is broken off would have begun anew.")
