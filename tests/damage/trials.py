"""Numbered damaged copies in; what reading each of them did wrong, out. In processes of their own, which may crash and are ended."""

from __future__ import annotations

import os
import resource
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from tests.damage.mutations import damaged
from tests.damage.specimens import Specimen, place_beside, specimens

SEED = 19
HANG_S, CRASH = 10.0, "the process ended"
MOST_BYTES = 4 << 30


@dataclass(frozen=True)
class Fault:
    """What went wrong with a damaged copy: its number and kind; "exception", "hang", "memory" or "crash"; and what or where."""

    number: int
    kind: str
    what: str
    where: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as JSON keeps them."""
        return asdict(self)


def copy_of(number: int, known: Sequence[Specimen]) -> tuple[Specimen, bytes]:
    """The damaged copy of this number: specimens take turns, everything else is drawn from a generator of the number's own."""
    specimen = known[number % len(known)]
    return specimen, damaged(specimen.content, np.random.default_rng([SEED, number]), specimen.packed)


def read_copy(number: int, known: Sequence[Specimen], folder: Path) -> list[Fault]:
    """Read a damaged copy by all its readers."""
    specimen, content = copy_of(number, known)
    path = place_beside(specimen, folder)
    path.write_bytes(content)
    faults = []
    for read in specimen.reads:
        try:
            read(path)
        except AsterismError as problem:
            if isinstance(problem.__cause__, MemoryError):
                faults.append(Fault(number, specimen.kind, "memory", str(problem)))
            elif not _names_a_file(str(problem), specimen):
                faults.append(Fault(number, specimen.kind, "exception", f"names no file: {problem}"[:300]))
        except Exception as problem:
            place = next((f for f in reversed(traceback.extract_tb(problem.__traceback__)) if "asterism" in f.filename), None)
            at = f"{Path(place.filename).name}:{place.lineno}" if place else "elsewhere"
            faults.append(Fault(number, specimen.kind, "exception", f"{type(problem).__name__} at {at}: {problem}"[:300]))
    return faults


def _names_a_file(sentence: str, specimen: Specimen) -> bool:
    return any(Path(name).name in sentence for name in (specimen.name, *(name for name, _ in specimen.beside)))


def run(numbers: range, jobs: int, model: bool = True) -> Iterator[tuple[int, list[Fault]]]:
    """Read so many copies; after each stretch of them, how many are done and the faults found in it.

    `jobs` processes share them. One that hangs for more than 10 s at a copy is ended, and one that crashed is replaced; both go on with
    the next copy.
    """
    with tempfile.TemporaryDirectory() as folder:
        workers = [_Worker(Path(folder) / str(job), numbers[job::jobs], model) for job in range(jobs)]
        try:
            while any(not worker.finished for worker in workers):
                time.sleep(0.2)
                for worker in workers:
                    done, faults = worker.look()
                    if done:
                        yield done, faults
        finally:
            for worker in workers:
                worker.stop()


class _Worker:
    """A process that reads copies one after the other and says so; it is replaced where it hangs or crashes."""

    def __init__(self, folder: Path, numbers: range, model: bool) -> None:
        self.folder, self.numbers, self.model = folder, numbers, model
        self.finished = not numbers
        self.next = 0
        self.stale_since = time.monotonic()
        if not self.finished:
            self._start()

    def _start(self) -> None:
        context = get_context("spawn")
        self.told, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=_read_all, args=(self.folder, self.numbers[self.next :], self.model, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.begun = False

    def look(self) -> tuple[int, list[Fault]]:
        """How many copies were read since the last look, and what was found."""
        done, faults = 0, list[Fault]()
        if self.finished:
            return done, faults
        try:
            while self.told.poll():
                self.begun, found = True, self.told.recv()
                self.stale_since = time.monotonic()
                if found is None:  # ready to begin
                    continue
                self.next, done = self.next + 1, done + 1
                faults += found
        except EOFError:
            if not self.begun:
                raise AsterismError("a process that reads damaged files ended before it began; what it said is above.") from None
            if self.next < len(self.numbers):
                faults.append(self._lost("crash", CRASH))
                done += 1
        if self.begun and not faults and self.next < len(self.numbers) and time.monotonic() - self.stale_since > HANG_S:
            self.stop()
            faults.append(self._lost("hang", f"more than {HANG_S:g} s"))
            done += 1
        self.finished = self.next >= len(self.numbers)
        return done, faults

    def _lost(self, what: str, where: str) -> Fault:
        """Go on behind the copy that was being read."""
        number = self.numbers[self.next]
        self.next += 1
        if self.next < len(self.numbers):
            self._start()
        return Fault(number, "", what, where)

    def stop(self) -> None:
        """End the process."""
        if hasattr(self, "process") and self.process.is_alive():
            self.process.kill()
            self.process.join()


def _read_all(folder: Path, numbers: range, model: bool, told: Any) -> None:
    """In a process of its own: send None once, then what each copy did wrong."""
    warnings.simplefilter("ignore")
    known = specimens(folder / "whole", model)
    resource.setrlimit(resource.RLIMIT_AS, (_virtual_bytes() + MOST_BYTES, resource.RLIM_INFINITY))
    told.send(None)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what image libraries say about damage
    for number in numbers:
        told.send(read_copy(number, known, folder / "damaged"))
    told.close()


def _virtual_bytes() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
