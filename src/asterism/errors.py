"""The exceptions that a user of Asterism is meant to read, and the guard that makes one of whatever reading a file raises."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

__all__ = ["AsterismError", "NoMarkers", "guarded_reading"]

_LONGEST_CAUSE = 160


class AsterismError(Exception):
    """Input that cannot be worked with.

    The message is one sentence: which file or argument, what is wrong with it, and how to mend it.
    The command line prints it and leaves with status 2 (or goes on with the next file of a batch).
    """


class NoMarkers(AsterismError):
    """A file that holds something else than markers: forces, joint angles, points of cameras. In a folder of files it is passed over."""


@contextmanager
def guarded_reading(path: str | PathLike[str], mend: str = "export it again, or check what it is") -> Iterator[None]:
    """Make an AsterismError, which names the file, of everything that reading it raises; the cause is chained.

    path is the file that is named, mend what to do about a damaged one. An AsterismError passes, because what a reader says itself is
    more exact; where it does not name the file, the name is put before it. What is not an `Exception`, such as an interrupt, passes too.
    """
    try:
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
        cause = " ".join(f"{type(problem).__name__}: {problem}".rstrip(": ").split())
        short = cause if len(cause) <= _LONGEST_CAUSE else f"{cause[: _LONGEST_CAUSE - 3]}..."
        raise AsterismError(f"{path} is damaged ({short}); {mend}.") from problem
