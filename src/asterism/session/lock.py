"""A folder of results in; while a run is at work in it, nobody else is, and who would be is told who is, out.

Where the system knows locks, it lets go of one whatever ends the run. Other machines, and stores of objects, see a file that says who is at
work, and that is written again every half minute; ages are told by the clock of the disk that holds it, which is one for all.
"""

from __future__ import annotations

import getpass
import json
import os
import platform
import secrets
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from asterism.errors import AsterismError
from asterism.files.addresses import RemoteFolder
from asterism.files.atomic import holds

LOCK = "asterism-process.lock"
"""The file in a folder of results that says who is at work in it; empty after a run that has ended."""
BEAT = 30.0
"""s between two signs of a run that is at work. Each is a request to the disk: at half twice as many; at double a lost run holds twice as
long."""
LOST = 10 * BEAT
"""s without a sign after which a run on another machine counts as lost: nine missed in a row are no slow disk."""


@dataclass(frozen=True)
class Holder:
    """Who is at work in a folder: user, machine, process, when the run began, and a word of its own by which it knows itself."""

    user: str
    machine: str
    process: int
    since: str
    word: str

    @classmethod
    def here(cls) -> Holder:
        """This process."""
        try:
            user = getpass.getuser()
        except (OSError, KeyError, ImportError):  # a container may give its user no name
            user = "somebody"
        since = datetime.now().astimezone().isoformat(" ", "seconds")
        return cls(user, platform.node() or "a machine", os.getpid(), since, secrets.token_hex(8))

    @classmethod
    def read(cls, text: str) -> Holder | None:
        """Who a file of a run names; None where it names nobody."""
        try:
            return cls(**json.loads(text))
        except (ValueError, TypeError):
            return None

    def __str__(self) -> str:
        return f"{self.user} on {self.machine} (process {self.process}, begun {self.since})"


_OURS: set[str] = set()
"""The words of the runs of this process."""


class Held:
    """A folder that this run holds: `check` raises where another run has taken it over meanwhile."""

    def __init__(self, write: Callable[[Holder], None], read: Callable[[], Holder | None]) -> None:
        self.holder, self._write, self._read = Holder.here(), write, read
        self._taken: Holder | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._beats, daemon=True)

    def begin(self) -> None:
        """Say that this run is at work, from now on."""
        _OURS.add(self.holder.word)
        self._write(self.holder)
        self._thread.start()

    def check(self) -> None:
        """Raise AsterismError where another run has taken the folder over, as after a machine that slept."""
        if self._taken is not None:
            raise AsterismError(f"{self._taken} has taken over the folder of results, since this run gave no sign; it ends here.")

    def end(self) -> None:
        """Give no more signs."""
        _OURS.discard(self.holder.word)
        self._end.set()
        self._thread.join(1.0)

    def _beats(self) -> None:
        while not self._end.wait(BEAT):
            # a disk that fails now may answer the next time
            with suppress(AsterismError, OSError):
                found = self._read()
                if found is not None and found.word != self.holder.word:
                    self._taken = found
                    return
                self._write(self.holder)


@contextmanager
def held(folder: Path | RemoteFolder, tell: Callable[[str], None]) -> Iterator[Held]:
    """While this holds, no other run writes to the folder. tell: is called with a sentence where a run that was lost is taken over.

    Raises AsterismError, with who it is, where another run is at work.
    """
    with _held_at(folder, tell) if isinstance(folder, RemoteFolder) else _held_here(folder, tell) as one:
        try:
            yield one
        finally:
            one.end()


@contextmanager
def _held_here(folder: Path, tell: Callable[[str], None]) -> Iterator[Held]:
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        free = holds(handle)
        before = Holder.read(_text(handle))
        if free is False:
            _refuse(folder, before, None)
        if before is not None:
            age = _now(folder) - os.fstat(handle).st_mtime
            # of this machine the system has told already
            if (before.machine != platform.node() or free is None) and age < LOST:
                _refuse(folder, before, age)
            tell(f"{folder}: {before} has not ended its run and is at work no longer; this run goes on from there.")
        one = Held(lambda holder: _put(handle, json.dumps(asdict(holder))), lambda: Holder.read(_text(handle)))
        one.begin()
        yield one
        one.end()
        _put(handle, "")
    finally:
        os.close(handle)


@contextmanager
def _held_at(folder: RemoteFolder, tell: Callable[[str], None]) -> Iterator[Held]:
    with tempfile.TemporaryDirectory() as scratch:
        local = Path(scratch) / LOCK

        def put(text: str) -> None:
            local.write_text(text, encoding="utf-8")
            folder.store(local, LOCK)

        def read() -> Holder | None:
            return Holder.read(local.read_text(encoding="utf-8")) if folder.fetch(LOCK, local) else None

        before = read()
        if before is not None:
            folder.store(local, f"{LOCK}.now")
            now, then = folder.modified(f"{LOCK}.now"), folder.modified(LOCK)
            folder.remove(f"{LOCK}.now")
            if now is None or then is None:
                # without a clock of the disk: whoever is at work gives another sign meanwhile
                raise AsterismError(f"{folder.address}: {before} may be at work in it, and its disk does not tell since when; {_BY_HAND}")
            age = (now - then).total_seconds()
            same = before.machine == platform.node() and not _runs(before)
            if age < LOST and not same:
                _refuse(folder.address, before, age)
            tell(f"{folder.address}: {before} has not ended its run and is at work no longer; this run goes on from there.")
        one = Held(lambda holder: put(json.dumps(asdict(holder))), read)
        one.begin()
        found = read()
        # of two that begin at once, the one whose name was written last goes on
        if found is None or found.word != one.holder.word:
            one.end()
            _refuse(folder.address, found, 0.0)
        yield one
        one.end()
        put("")


_BY_HAND = f"wait for its end, or remove {LOCK} where no run is at work."


def _refuse(folder: object, holder: Holder | None, age: float | None) -> None:
    who = "another run of asterism process" if holder is None else f"another run, of {holder},"
    sign = "" if age is None else f", its last sign {max(age, 0.0):.0f} s ago"
    other = f"; {_BY_HAND}" if age is not None else "; wait for its end, or choose another -o."
    raise AsterismError(f"{folder}: {who} is at work in it{sign}{other}")


def _text(handle: int) -> str:
    return os.pread(handle, 4096, 0).decode("utf-8", "replace") if hasattr(os, "pread") else ""


def _put(handle: int, text: str) -> None:
    """Write the file anew in place: another file of this name would not be held."""
    os.ftruncate(handle, 0)
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, text.encode())


def _now(folder: Path) -> float:
    """s of the clock of the disk of a folder."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            return os.fstat(file.fileno()).st_mtime
    except OSError:
        return time.time()


def _runs(holder: Holder) -> bool:
    """Whether a run of this machine is at work; a process that has this one's number and is not this run has ended."""
    if holder.process == os.getpid() or os.name != "posix":
        return holder.word in _OURS or os.name != "posix"
    try:
        os.kill(holder.process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
