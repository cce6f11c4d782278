"""The frames of a stream in; what studies of them say, made in a process of its own, out.

The process is a fresh Python that runs this module: it imports nothing of the program that started it, so that any script may start one. It
reads messages from its standard input and answers on its standard output. It ends when the pipe ends, however the program at the other end
ended, and Ctrl-C does not reach it.
"""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
import sys
import threading
import time
import weakref
from contextlib import suppress
from dataclasses import replace
from typing import IO, Any, get_args

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

import numpy as np

from asterism.errors import AsterismError
from asterism.files.processes import FreeCores, give_way
from asterism.findings import Finding, Severity
from asterism.labelling.body.model import gram_of
from asterism.labelling.live.study import Studies, Study, StudyPlace, StudyPlan, StudyRules
from asterism.labelling.live.study_worker import StudiesInPush, StudyWorker, warm_up
from asterism.labelling.recording_labeller import TrainedModel
from asterism.recording import Floats, Ints

_COUNTED = 0.1
"""s without a study in which free cores are counted: ten ticks of the system's clock. Half of it counts them to a fifth; at double the
second study comes a tenth of a second later."""
_FREE = 1.5
"""Cores that nobody uses, for a study to begin: it takes one, and the two threads of a core slow each other down. At 1.0 frames of twelve
cameras, which leave 1.1 of two, wait for 20 ms instead of 10; at double nothing is studied on two cores."""
_REST = 3.0
"""Times as long as a study took that the next one comes after it, once the whole window has been studied: a quarter of a core. Half of it
takes two fifths of one; at double, new tracks of 59 markers, whose studies take 0.8 s, wait for 5 s and not for 2.4."""
_LONG = 20.0
"""s without a free core, in most of the time, from which a person is told: some steps, each of which shows all markers. At half of it a
session that begins beside a browser that opens is told; at double, trials of half a minute are not."""
_HEAD = struct.Struct("<Q")
"""Before each message: its length in bytes."""
_PIPE = 1 << 20
"""Bytes of an answer that are read at once, the most that Linux allows everybody. Half of it takes twice as many pieces."""
_ENDING = 5.0
"""s that the end of the process and of the thread is waited for: both are killed or closed, and take a hundredth of one."""


class StudyProcess:
    """Studies in a process of their own, which takes cores that nobody else uses. It begins at once, and studies when it knows the model.

    rate   frames per second of the stream
    rules  what is studied, and when

    Where the process ends or cannot begin, `findings` says so, and no study is made any more. It ends with `close`, or when nobody has this
    object any more.
    """

    def __init__(self, rate: float, rules: StudyRules) -> None:
        self._plan, self._talk = StudyPlan(rate, rules), _Talk()
        self.rate, self.rules, self._session = rate, rules, 0
        self._free, self._under_way = FreeCores(), False
        self._rest: float | None = None
        self._waits = _Waits()
        self._looker: StudyWorker | None = None
        self._ended = weakref.finalize(self, self._talk.close)

    def teach(self, model: TrainedModel) -> None:
        """Give the model; once."""
        # Its class goes along: this file cannot import the one that makes streams.
        self._talk.say((type(model), model.state, self.rate, self.rules))
        # One frame is looked at here: its labels are wanted before an answer could come.
        self._looker = StudyWorker(model, self.rate, self.rules)
        warm_up(self._looker, model)

    def look(self, xyz: Floats, serials: Ints) -> Study | None:
        """See `Studies.look`."""
        return None if self._looker is None else self._looker.look(xyz, serials)

    def wait(self, seconds: float) -> bool:
        """Wait until the process knows the model, and is done with the study under way, at most so long. Gives whether it is."""
        return self._talk.wait(seconds)

    @property
    def process(self) -> int | None:
        """The id of the process; None where it could not be started."""
        return None if self._talk.process is None else self._talk.process.pid

    def add(self, number: int, xyz: Floats, serials: Ints, *, unsure: bool) -> None:
        """See `Studies.add`. Another thread speaks with the process, so that this one does not wait."""
        self._plan.add(number, xyz, serials)
        self._waits.begin()
        if not self._talk.is_idle:
            return
        if self._under_way:
            # It is done: the cores that are free from now on are those that nobody else uses.
            self._rest = max(_COUNTED, _REST * self._free.seconds) if self._plan.is_full else _COUNTED
            self._free.begin()
            self._under_way = False
        if self._plan.is_due(unsure=unsure) and self._has_room():
            self._free.begin()
            self._waits.end()
            self._under_way = True
            self._talk.say((self._session, self._plan.frames()))

    def _has_room(self) -> bool:
        """Whether a core is free for a study: two threads of one core slow each other down, at whatever priority."""
        # Nothing was counted before the first one, which is short.
        if self._rest is None:
            return True
        if self._free.seconds < self._rest:
            return False
        free = self._free.count()
        # Where there is no room, it is looked for again in what comes next.
        self._free.begin()
        self._rest = _COUNTED
        if free >= _FREE:
            return True
        self._waits.go_on()
        return False

    def taken(self, number: int) -> Study | None:
        """See `Studies.taken`."""
        if self._talk.found is None:
            return None
        session, study = self._talk.take()
        if session != self._session:
            return None
        self._plan.take()
        return study

    def restart(self) -> None:
        """See `Studies.restart`."""
        self._session += 1
        self._plan.restart()

    def made(self) -> tuple[int, float]:
        """See `Studies.made`."""
        return self._plan.made()

    def findings(self) -> list[Finding]:
        """See `Studies.findings`."""
        problem = self._talk.problem
        if not problem:
            return self._waits.findings()
        sentence = f"the last seconds are not labelled as a whole any more: {problem}"
        mend = "Labels go on, and are less sure; begin the session anew for surer ones."
        return [Finding("live-no-studies", Severity.WARNING, "the labels", f"the labels: {sentence}", mend)]

    def close(self) -> None:
        """End the process."""
        self._ended()


class _Waits:
    """For how long no study could begin since no core was free."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._since: float | None = None
        self._seconds = 0.0

    def begin(self) -> None:
        """A frame came."""
        if self._first is None:
            self._first = time.monotonic()

    def go_on(self) -> None:
        """No core is free."""
        if self._since is None:
            self._since = time.monotonic()

    def end(self) -> None:
        """A study begins."""
        if self._since is not None:
            self._seconds, self._since = self._seconds + time.monotonic() - self._since, None

    def findings(self) -> list[Finding]:
        """That no study could begin for long, and for most of the time."""
        now = time.monotonic()
        seconds = self._seconds + (0.0 if self._since is None else now - self._since)
        if self._first is None or seconds < max(_LONG, 0.5 * (now - self._first)):
            return []
        sentence = f"the labels: for {seconds:.0f} s no processor core was free to label the last seconds as a whole."
        mend = "Labels are less sure without; close other programs, lower the rate, or use a computer with more cores."
        return [Finding("live-few-studies", Severity.NOTE, "the labels", sentence, mend)]


class _Talk:
    """A process and the thread that speaks with it: one message, one answer.

    found    (session, study) that nobody has taken yet
    problem  why there are no more answers, "" while there are
    """

    def __init__(self) -> None:
        self._there = threading.Condition()
        self._messages: list[object] = []
        self._is_ready = self._closed = False
        self._asked = 0
        self.found: tuple[int, Study] | None = None
        self.problem = ""
        self.process = _started()
        self._thread = threading.Thread(target=self._run, name="live studies", daemon=True)
        self._thread.start()

    @property
    def is_idle(self) -> bool:
        """Whether the process waits for frames."""
        return self._is_ready and not self._asked and not self.problem

    def say(self, message: object) -> None:
        """Send a message when the process has answered those before."""
        with self._there:
            self._asked += 1
            self._messages.append(message)
            self._there.notify_all()

    def take(self) -> tuple[int, Study]:
        """What was found."""
        with self._there:
            found, self.found = self.found, None
        assert found is not None
        return found

    def wait(self, seconds: float) -> bool:
        """Wait until the process waits for frames, at most so long."""
        with self._there:
            self._there.wait_for(lambda: self.is_idle or bool(self.problem) or self._closed, seconds)
            return self.is_idle

    def close(self) -> None:
        """End the process and the thread."""
        with self._there:
            self._closed = True
            self._there.notify_all()
        if self.process is not None:
            # It holds nothing that could be lost.
            self.process.kill()
            self.process.wait(_ENDING)
        if self._thread is not threading.current_thread():
            self._thread.join(_ENDING)

    def _run(self) -> None:
        """The thread."""
        process = self.process
        if process is None or process.stdin is None or process.stdout is None:
            self._end("the process that does it could not be started.")
            return
        with suppress(OSError), process.stdin as there, process.stdout as back, suppress(OSError, EOFError, pickle.UnpicklingError):
            while (message := self._next()) is not None:
                _write(there, message)
                del message
                answer = _whole(_read(back))
                if isinstance(answer, str) and answer:
                    self._end(answer)
                    return
                with self._there:
                    self.found = answer or self.found
                    self._is_ready, self._asked = True, self._asked - 1
                    self._there.notify_all()
        if not self._closed:
            process.kill()
            self._end(f"the process that does it ended with status {process.wait(_ENDING)}.")

    def _next(self) -> object:
        """The next message; None at the end."""
        with self._there:
            self._there.wait_for(lambda: bool(self._messages) or self._closed)
            return None if self._closed else self._messages.pop(0)

    def _end(self, problem: str) -> None:
        with self._there:
            self.problem, self._is_ready = problem, False
            self._there.notify_all()


def make_studies(place: StudyPlace | Studies, rate: float, model: TrainedModel) -> Studies | None:
    """The studies of a stream, in the place given, or as they were made. Raises AsterismError where there is no such place."""
    if isinstance(place, StudyProcess):
        place.teach(model)
        return place
    if not isinstance(place, str):
        return place
    if place == "push":
        return StudiesInPush(model, rate, StudyRules())
    if place == "process":
        process = StudyProcess(rate, StudyRules())
        process.teach(model)
        return process
    if place != "none":
        raise AsterismError(f"studies cannot be made in {place!r}; choose from {', '.join(get_args(StudyPlace))}.")
    return None


def _started() -> subprocess.Popen[bytes] | None:
    """The process; None where it cannot be started."""
    # As many threads as libraries like would take the cores from those who label frames.
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with suppress(OSError):
        started = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads},
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0) | getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0),
        )
        # An answer has 0.7 MB: read in eleven pieces, it takes Python eleven times from who labels frames.
        if hasattr(fcntl, "F_SETPIPE_SZ") and started.stdout is not None:
            with suppress(OSError):
                fcntl.fcntl(started.stdout, fcntl.F_SETPIPE_SZ, _PIPE)
        return started
    return None


def _lean(study: Study) -> Study:
    """A study without what follows from the rest: 2 MB of 59 markers, which whoever reads them would hold Python for."""
    return study if study.body is None else replace(study, body=study.body._replace(gram=np.empty(0)))


def _whole(answer: Any) -> Any:
    """An answer with what `_lean` left out: half a millisecond of 59 markers, during which NumPy lets other threads run."""
    if not isinstance(answer, tuple) or answer[1].body is None:
        return answer
    session, study = answer
    return session, replace(study, body=study.body._replace(gram=gram_of(study.body.load)))


def _write(pipe: IO[bytes], message: object) -> None:
    data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.write(_HEAD.pack(len(data)))
    pipe.write(data)
    pipe.flush()


def _read(pipe: IO[bytes]) -> Any:
    """The next message. Raises EOFError at the end."""
    head = pipe.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise EOFError
    (length,) = _HEAD.unpack(head)
    data = pipe.read(length)
    if len(data) < length:
        raise EOFError
    return pickle.loads(data)


def main() -> None:
    """Answer messages until the pipe ends."""
    there, back = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What is printed by anything that is called here is no message.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    with suppress(EOFError, OSError):
        of_kind, state, rate, rules = _read(there)
        model = of_kind(state)
        worker = StudyWorker(model, rate, rules)
        warm_up(worker, model)
        # Until now frames waited for it.
        give_way()
        _write(back, "")
        before = 0
        while True:
            session, frames = _read(there)
            if session != before:
                worker.restart()
            before = session
            try:
                _write(back, (session, _lean(worker.study(frames))))
            except (AsterismError, ValueError, ArithmeticError, MemoryError, LookupError) as problem:
                _write(back, f"a study failed ({type(problem).__name__}: {problem}).")
                return


if __name__ == "__main__":
    main()
