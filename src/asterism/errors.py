"""The exceptions that a user of Asterism is meant to read, and the guard that makes one of whatever reading a file raises."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

__all__ = ["AsterismError", "NoGait", "NoMarkers", "cause_of", "guarded_reading", "refuse_special", "sentence_of"]

_LONGEST_CAUSE = 160

_CAUSES = {
    "BadZipFile": "its archive is broken",
    "error": "its bytes are not what its head announces",  # of struct and zlib
    "IndexError": "it ends too early, or counts wrongly",
    "EOFError": "it ends too early",
    "UnicodeDecodeError": "its text is in no encoding that is known",
    "OverflowError": "a number in it is too large",
    "SyntaxError": "its text is garbled",
    "TypeError": "a part of it is of the wrong kind",
    "AttributeError": "a part of it is of the wrong kind",
}
"""What exceptions mean whose own text speaks of programs, by their names: some are of modules that need not be loaded."""


class AsterismError(Exception):
    """Input that cannot be worked with.

    The message is one sentence: which file or argument, what is wrong with it, and how to mend it.
    The command line prints it and leaves with status 2 (or goes on with the next file of a batch).
    """


class NoMarkers(AsterismError):
    """A file that holds something else than markers: forces, joint angles, points of cameras. In a folder of files it is passed over."""


class NoGait(AsterismError):
    """A recording in which nobody can be seen to walk: feet or pelvis have no markers, or are hidden. In a session that is no fault."""


@contextmanager
def guarded_reading(path: str | PathLike[str], mend: str = "export it again, or check what it is") -> Iterator[None]:
    """Make an AsterismError, which names the file, of everything that reading it raises; the cause is chained.

    path is the file that is named, mend what to do about a damaged one. An AsterismError passes, because what a reader says itself is
    more exact; where it does not name the file, the name is put before it. What is not an `Exception`, such as an interrupt, passes too.
    """
    try:
        refuse_special(path)
        yield
    except AsterismError as problem:
        if Path(path).name in str(problem):
            raise
        raise type(problem)(f"{path}: {problem}") from problem
    except FileNotFoundError as problem:
        raise AsterismError(f"{path} does not exist; check its name and folder.") from problem
    except IsADirectoryError as problem:
        raise AsterismError(f"{path} is a folder; name a file in it.") from problem
    except OSError as problem:
        raise AsterismError(f"{path} cannot be read ({problem.strerror or problem}); check its permissions.") from problem
    except MemoryError as problem:
        raise AsterismError(f"{path} claims to hold more than fits into the memory; it is damaged, {mend}.") from problem
    except RecursionError as problem:
        raise AsterismError(f"{path} is damaged: it is nested too deeply; {mend}.") from problem
    except Exception as problem:
        raise AsterismError(f"{path} is damaged ({cause_of(problem)}); {mend}.") from problem


def refuse_special(path: str | PathLike[str]) -> None:
    """Raise AsterismError where a path leads to a device, a pipe or a socket. Nothing is said of one that leads nowhere.

    Reading a pipe may wait for ever and a device never end; renaming another file to its name would replace it.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        kind = "pipe" if stat.S_ISFIFO(mode) else "socket" if stat.S_ISSOCK(mode) else "device"
        raise AsterismError(f"{path} is a {kind} and no file; give the name of a file.")


def cause_of(problem: Exception) -> str:
    """What is wrong with a file, for a person, by what reading it has raised: a phrase without names of exceptions.

    >>> import zipfile
    >>> cause_of(zipfile.BadZipFile("File is not a zip file")), cause_of(KeyError("rate"))
    ('its archive is broken', 'it lacks rate')
    """
    kind, said = type(problem).__name__, " ".join(str(problem).split())
    if isinstance(problem, KeyError) and problem.args:
        return f"it lacks {problem.args[0]}"[:_LONGEST_CAUSE]
    if kind in _CAUSES or not said:
        return _CAUSES.get(kind, "its content cannot be read")
    return said if len(said) <= _LONGEST_CAUSE else f"{said[: _LONGEST_CAUSE - 3]}..."


def sentence_of(problem: BaseException) -> str:
    """What went wrong, in one line: what is meant to be read as it is, and the name of the exception before anything else.

    >>> sentence_of(AsterismError("walk.c3d does not exist.")), sentence_of(ValueError("not enough values"))
    ('walk.c3d does not exist.', 'ValueError: not enough values')
    """
    said = " ".join(str(problem).split())
    return said if isinstance(problem, AsterismError | OSError) else f"{type(problem).__name__}: {said}"
