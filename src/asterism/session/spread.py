"""A function and its tasks in; what it gives for each, in the tasks' order, from this process, from several, or from a Dask cluster, out.

A task costs a few hundred bytes of message each way: what is large stays on the disk. Nothing is promised twice: a task must come out the
same however often it is begun, since one whose process was lost is begun again.
"""

from __future__ import annotations

import errno
import os
import pickle
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Generic, TypeVar

from asterism.errors import AsterismError, sentence_of
from asterism.files.processes import clean_context
from asterism.labelling.shared_work import Each

Task = TypeVar("Task")
Value = TypeVar("Value")

_QUEUED = 2
"""Tasks that each worker of a cluster has: the one that it works on, and the next. With one it waits for each answer; with a hundred the
scheduler holds what it need not."""
_PATIENCE = 60.0
"""s for which a scheduler that does not answer is called again: it starts anew in seconds. At half, a slow start is a failure."""


_ENDING = 5.0
"""s for which a process that has nothing left to do may remove what it made; a folder of temporary files goes in a tenth of this."""
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class Outcome(Generic[Value]):
    """What became of one task: its value, or the problem in one sentence where it has none.

    no_room  whether the disk is full, or the share of it that the user may fill: all other tasks will meet the same
    """

    value: Value | None
    problem: str = ""
    no_room: bool = False


def spread(
    function: Callable[[Task], Value], tasks: Sequence[Task], *, workers: int = 1, dask: str | None = None
) -> Iterator[tuple[int, Outcome[Value]]]:
    """What the function gives for each task, with the task's place, in the order in which they end.

    function  of a module, which may raise nothing that must be told apart: an error is the task's, and costs this task alone
    workers   processes; with one, all is done in this process
    dask      address of a scheduler ("tcp://host:8786"), or "local:N" for N processes of a cluster of this machine; in place of `workers`

    A task whose process dies is done once more, alone, in a process of its own; if that dies, too, the outcome says so.
    Raises AsterismError where the cluster cannot be used. O(tasks) messages; of tasks and values, `workers` are in flight.
    """
    if dask is not None:
        yield from _on_cluster(function, tasks, dask)
    elif workers < 2 or len(tasks) < 2:
        for place, task in enumerate(tasks):
            yield place, _outcome(function, task)
    else:
        yield from _in_processes(function, tasks, min(workers, len(tasks)))


def in_order(outcomes: Iterator[tuple[int, Outcome[Value]]]) -> Iterator[Outcome[Value]]:
    """The outcomes in the order of the tasks, each as soon as all before it are there."""
    early: dict[int, Outcome[Value]] = {}
    following = 0
    for place, outcome in outcomes:
        early[place] = outcome
        while following in early:
            yield early.pop(following)
            following += 1


def _outcome(function: Callable[[Task], Value], task: Task) -> Outcome[Value]:
    try:
        return Outcome(function(task))
    except Exception as problem:
        return Outcome(None, sentence_of(problem), no_room(problem))


def no_room(problem: BaseException | None) -> bool:
    """Whether a problem, or what it came from, is a disk that is full."""
    while problem is not None:
        if isinstance(problem, OSError) and problem.errno in _NO_ROOM:
            return True
        problem = problem.__cause__
    return False


@dataclass
class _Worker(Generic[Task]):
    """A process, the end of its pipe, and the place of the task that it works on."""

    process: BaseProcess
    pipe: Connection[Any, Any]
    place: int = -1

    @classmethod
    def begin(cls, function: Callable[[Any], Any]) -> _Worker[Task]:
        context = clean_context(__name__, function.__module__)
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(there, function), daemon=True)
        process.start()
        # with our copy open, the end of the process would not end the pipe
        there.close()
        return cls(process, here)

    def give(self, place: int, task: Task) -> None:
        self.place = place
        # a process that ended at its start is seen as one that ends later is
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send(task)

    def end(self, *, idle: bool = False) -> None:
        """End the process; idle: it has no task, and ends by itself, with what it kept on the disk."""
        self.pipe.close()
        if idle:
            self.process.join(_ENDING)
        self.process.terminate()
        self.process.join()


def _serve(pipe: Connection[Any, Any], function: Callable[[Any], Any]) -> None:
    """Work on tasks until the pipe is closed."""
    # Ctrl-C reaches all processes of a terminal: the first one decides
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        pipe.send(_outcome(function, task))


def _in_processes(function: Callable[[Task], Value], tasks: Sequence[Task], workers: int) -> Iterator[tuple[int, Outcome[Value]]]:
    waiting, again = deque(enumerate(tasks)), list[int]()
    working: list[_Worker[Task]] = []
    try:
        for _ in range(workers):
            working.append(_Worker.begin(function))
            working[-1].give(*waiting.popleft())
        while working:
            ready = set(wait([worker.pipe for worker in working]))
            for worker in [worker for worker in working if worker.pipe in ready]:
                try:
                    outcome = worker.pipe.recv()
                except (EOFError, OSError):
                    again.append(worker.place)
                    worker.end()
                    working.remove(worker)
                    if waiting:
                        working.append(_Worker.begin(function))
                        working[-1].give(*waiting.popleft())
                    continue
                place = worker.place
                if waiting:
                    worker.give(*waiting.popleft())
                else:
                    worker.end(idle=True)
                    working.remove(worker)
                yield place, outcome
    finally:
        for worker in working:
            worker.end()
    for place in again:
        yield place, _alone(function, tasks[place])


def _alone(function: Callable[[Task], Value], task: Task) -> Outcome[Value]:
    """What a task gives in a process of its own, whose end costs nothing else."""
    worker = _Worker[Task].begin(function)
    try:
        worker.give(0, task)
        outcome: Outcome[Value] = worker.pipe.recv()
        return outcome
    except (EOFError, OSError):
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with status {code}"
        return Outcome(None, f"the process that worked on it ended twice, {how}; it needs more memory, or it is a fault of Asterism.")
    finally:
        worker.end()


def _on_cluster(function: Callable[[Task], Value], tasks: Sequence[Task], address: str) -> Iterator[tuple[int, Outcome[Value]]]:
    number = _number(address) if address.startswith("local:") else 0
    try:
        from distributed import Client, LocalCluster, as_completed  # type: ignore[import-not-found, unused-ignore]
        from distributed.scheduler import KilledWorker  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        raise AsterismError("--dask needs Dask; install it with `pip install 'asterism[cluster]'`.") from None
    left, killed = dict(enumerate(tasks)), list[int]()
    cluster = None
    try:
        if number:
            cluster = LocalCluster(n_workers=number, threads_per_worker=1, dashboard_address=None)
        lost = time.monotonic()
        while left:
            try:
                with Client(cluster or address, timeout=_PATIENCE / 6) as client:
                    for place, outcome in _through(client, as_completed, KilledWorker, function, left, killed):
                        lost = time.monotonic()
                        yield place, outcome
            # the scheduler has gone: what it had not answered is asked again
            except (OSError, TimeoutError, _Lost) as problem:
                if time.monotonic() - lost > _PATIENCE:
                    raise AsterismError(f"the scheduler {address} does not answer ({problem}); run the same command again.") from problem
                time.sleep(1.0)
    finally:
        if cluster is not None:
            cluster.close()
    for place in killed:
        yield place, _alone(function, tasks[place])


class _Lost(Exception):
    """The scheduler has gone with the tasks that it held."""


def _through(
    client: Any, as_completed: Any, gone: type[Exception], function: Callable[[Task], Value], left: dict[int, Task], killed: list[int]
) -> Iterator[tuple[int, Outcome[Value]]]:
    """The outcomes of the tasks that are left, which leave `left`; those that killed their workers go to `killed`."""
    waiting = deque(left.items())
    running: dict[Any, int] = {}
    answers = as_completed()

    def submit() -> None:
        place, task = waiting.popleft()
        # a worker that is lost costs its task one more beginning, not the run
        future = client.submit(_outcome, function, task, pure=False)
        running[future] = place
        answers.add(future)

    for _ in range(min(len(waiting), _QUEUED * max(len(client.scheduler_info()["workers"]), 1))):
        submit()
    for future in answers:
        place = running.pop(future)
        if future.status in ("cancelled", "lost"):
            raise _Lost("it has forgotten its tasks")
        problem = future.exception()
        outcome = None if problem is not None else future.result()
        del left[place]
        if waiting:
            submit()
        if isinstance(problem, gone):
            killed.append(place)
        elif outcome is None:
            yield place, Outcome(None, sentence_of(problem))
        else:
            yield place, outcome
        future.release()


def _number(address: str) -> int:
    number = address.removeprefix("local:")
    if not number.isdecimal() or int(number) < 1:
        raise AsterismError(f"--dask {address} is no cluster; write local:2 for two processes, or a scheduler such as tcp://host:8786.")
    return int(number)


@contextmanager
def each_of(folder: Path, *, workers: int = 1, dask: str | None = None) -> Iterator[Each]:
    """An `Each` whose function may hold much, such as frames or a model, and may give much: both go over the disk, not as messages.

    folder  in which a folder for them is made meanwhile; all workers must see it under this path

    The first task that fails ends all, with AsterismError.
    """
    with tempfile.TemporaryDirectory(prefix=".asterism-", dir=folder) as scratch:
        calls = iter(range(2**31))

        def each(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
            shared = Path(scratch) / f"{next(calls)}.function"
            shared.write_bytes(pickle.dumps(function, pickle.HIGHEST_PROTOCOL))
            tasks = [(str(shared.absolute()), place, item) for place, item in enumerate(items)]
            for outcome in in_order(spread(_through_disk, tasks, workers=workers, dask=dask)):
                if outcome.value is None:
                    raise AsterismError(outcome.problem)
                kept = Path(outcome.value)
                yield pickle.loads(kept.read_bytes())
                kept.unlink()

        yield each


_FUNCTIONS: dict[str, Callable[[Any], Any]] = {}
"""The function of the last task: it is read once by each process."""


def _through_disk(task: tuple[str, int, Any]) -> str:
    """Call the function in a file, and write what it gives into another one, whose path is returned."""
    shared, place, item = task
    if shared not in _FUNCTIONS:
        _FUNCTIONS.clear()
        _FUNCTIONS[shared] = pickle.loads(Path(shared).read_bytes())
    # of its own name, since a task that was begun twice is written twice
    kept = f"{shared}.{place}.{os.getpid()}"
    Path(kept).write_bytes(pickle.dumps(_FUNCTIONS[shared](item), pickle.HIGHEST_PROTOCOL))
    return kept
