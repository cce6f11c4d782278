"""Work on a disk that may never answer in; what it gives, or an error after a minute without any progress, out."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path
from threading import Thread
from typing import TypeVar

from asterism.errors import AsterismError, refuse_special

Value = TypeVar("Value")

STALLED = 60.0
"""s without a byte after which a disk is given up. A network file system that has lost its server tries for about as long before it says
so, and a tape or a sleeping disk begins within half a minute. At half these would be given up; at double a dead folder costs twice."""
_PIECE = 1 << 20


def unless_stalled(name: object, work: Callable[[Callable[[int], object]], Value]) -> Value:
    """What `work` gives, which is called with a function that takes how many bytes have come.

    The system cannot break off reading from a dead server: the work is left alone in a thread that ends with the process.
    Raises AsterismError where nothing came for `STALLED` s, and whatever the work raises.
    """
    done = list[Value]()
    failed = list[BaseException]()
    came = [0]

    def run() -> None:
        try:
            done.append(work(lambda count: came.__setitem__(0, count)))
        except BaseException as problem:
            failed.append(problem)

    thread = Thread(target=run, daemon=True)
    thread.start()
    before = -1
    while thread.is_alive():
        thread.join(STALLED)
        if thread.is_alive() and came[0] == before:
            raise AsterismError(f"{name}: its disk has not answered for {STALLED:.0f} s; look at the network, and run the command again.")
        before = came[0]
    if failed:
        raise failed[0]
    return done[0]


def digest(path: Path) -> str:
    """The SHA-256 of a file's bytes. Raises AsterismError where its disk stalls or it is a device or a pipe, OSError as reading does."""
    refuse_special(path)

    def read(came: Callable[[int], object]) -> str:
        found, count = hashlib.sha256(), 0
        with path.open("rb") as file:
            while piece := file.read(_PIECE):
                found.update(piece)
                count += len(piece)
                came(count)
        return found.hexdigest()

    return unless_stalled(path, read)


def that_answer(paths: Iterable[Path]) -> list[Path]:
    """Those of some files whose beginnings come in time; what cannot be read answers, too. All are asked at once."""
    given = list(paths)
    answered = set[Path]()

    def ask(path: Path) -> None:
        try:
            refuse_special(path)
            with path.open("rb") as file:
                file.read(1)
        except (OSError, AsterismError):
            pass
        answered.add(path)

    threads = [Thread(target=ask, args=(path,), daemon=True) for path in given]
    for thread in threads:
        thread.start()
    for thread in threads:
        # one after the other: after the first that stalls, the others have had its time, too
        thread.join(STALLED if len(answered) < len(given) else 0.0)
        if thread.is_alive():
            break
    return [path for path in given if path in answered]
