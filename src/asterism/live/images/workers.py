"""Cameras in; the blobs of all of them, found in processes of their own, as one source out."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from asterism.detection.running import MOST_BLOBS
from asterism.errors import AsterismError
from asterism.files.plain import as_json
from asterism.files.processes import clean_context
from asterism.findings import Finding, Severity
from asterism.live.camera_frames import LiveBlobs
from asterism.live.cameras import CameraHealth, CameraSpec, SettingOutcome, camera_findings, save_cameras
from asterism.live.cameras.settings import setting_value
from asterism.live.frames import TURN, SourceEnded
from asterism.live.images.worker import CameraPlace, CameraReport, SearchCounts, SettingOrder, WorkerReady, WorkerSettings, work
from asterism.recording.display import counted, how_often

_LEAD = 1.0
"""s from when all processes are there to when files begin to play, in which they are opened. At half a long video is late; at double a
person waits."""
_OPENING = 60.0
"""s in which a camera must open or say why not. Cameras in a network take 10 s; at half one that starts up is given up, at double a driver
that hangs is waited for in vain for two minutes."""
_AGAIN = 1.0
"""s between two starts of a process that dies, so that one that cannot live takes no processor: starting takes about as long. Half of it
takes a core where a process cannot live; with twice as much its cameras are blind for a second longer."""
_HANGS = 10.0
"""s without a word, four of which each process says a second, after which it is ended and begun anew. Half of it is a machine that swaps;
at double the cameras are blind for as long again."""
_ENDING = 3.0
"""s in which a process ends by itself: its camera's driver closes in one. Half of it kills one whose driver is slow; twice as much is
waited for in vain."""
_AHEAD = 100
"""Images by which a process that reads videos may be ahead of another. Half of them stop it at each pause of the system; twice as many hold
twice the memory."""
_ENDS_APART = 2
"""Images by which files may end apart before it is told, as of `asterism detect`. Half of it tells cameras that were stopped one by one;
twice as much keeps quiet of a video that was cut."""
_ORDERS = 32
"""Settings that wait until they are passed on, a tenth of a second: more than a person asks for; half and double do as well."""
_WAITING = 1000
"""Images' blobs that are kept while the cameras open: four seconds of four webcams. More would be old when they are used. Half of them do
as well."""


@dataclass
class _CameraProcess:
    """A process and the ends of its pipes."""

    places: tuple[CameraPlace, ...]
    process: BaseProcess
    pipe: Connection[Any, Any]
    orders: Connection[Any, Any]
    begun: float
    heard: float
    ready: bool = False
    dead: bool = False
    pending: deque[LiveBlobs] = field(default_factory=deque)
    """What waits for the blobs of others that come before."""

    @classmethod
    def begin(cls, places: Sequence[CameraPlace], settings: WorkerSettings) -> _CameraProcess:
        context = clean_context(work.__module__, "cv2")
        pipe, out = context.Pipe(duplex=False)
        theirs, orders = context.Pipe(duplex=False)
        names = ", ".join(place.name for place in places)
        process = context.Process(target=work, args=(tuple(places), settings, out, theirs), name=f"cameras {names}", daemon=True)
        try:
            with _interrupts_held():
                process.start()
        except BaseException:
            pipe.close()
            orders.close()
            raise
        finally:
            # With our copies open, the end of the process would not end the pipe.
            out.close()
            theirs.close()
        now = time.monotonic()
        return cls(tuple(places), process, pipe, orders, now, now)

    def end(self, patience: float = _ENDING) -> None:
        """End the process: it is asked to, and killed where it does not."""
        self.orders.close()
        self.pipe.close()
        self.process.join(patience)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


@dataclass
class _CameraProgress:
    """What was reported of a camera by the process that reads it, and what by those before it, which died."""

    report: CameraReport | None = None
    health: CameraHealth | None = None
    """Counts of the processes before."""
    search: SearchCounts = field(default_factory=SearchCounts)
    restarts: int = 0
    problem: str = ""
    """Why no process reads it."""

    @property
    def is_known(self) -> bool:
        """Whether it has opened, or failed to."""
        return self.report is not None and (self.report.health is not None or bool(self.report.problem) or self.report.ended)

    @property
    def is_closed(self) -> bool:
        """Whether it could not be opened so far."""
        return self.report is not None and self.report.health is None and bool(self.report.problem)

    @property
    def has_ended(self) -> bool:
        """Whether it was played to its end."""
        return self.report is not None and self.report.ended


class CameraWorkers:
    """A `BlobSource` of cameras that are read and searched in processes of their own.

    places    the cameras, such as `CameraSpec`s; names must differ
    settings  how their images are searched
    workers   processes, at most one for each camera; None: as many as there are cores. Machine vision cameras have one each
    numbered_together  whether equal numbers are one exposure of all cameras, as of videos that were taken together

    What crosses a pipe is blobs, not images. A process that cannot keep up searches the newest image of each camera, and counts the others
    as dropped. One that dies or hangs is begun anew, and counted; a camera that is gone is opened again each second. All processes end with
    this one, however it ends. In a script that is run, the line `if __name__ == "__main__":` must guard what makes this.
    Raises AsterismError where no camera can be opened in the first place, or where what is asked for makes no sense, such as a file that is
    not there.
    """

    def __init__(
        self,
        places: Sequence[CameraPlace],
        settings: WorkerSettings | None = None,
        *,
        workers: int | None = None,
        numbered_together: bool = False,
    ) -> None:
        self.numbered_together = numbered_together
        self.cameras = tuple(place.name for place in places)
        if not self.cameras or len(set(self.cameras)) < len(self.cameras):
            raise AsterismError(f"cameras are named {', '.join(self.cameras) or '(none)'}; give each camera another name.")
        self._settings = WorkerSettings() if settings is None else settings
        self._settings.blobs.check()
        self._states = {name: _CameraProgress() for name in self.cameras}
        self._waiting: deque[LiveBlobs] = deque(maxlen=None if self._settings.by_number else _WAITING)
        self._at: float | None = None
        self._closed, self._reading = threading.Event(), threading.Lock()
        self._last_read = time.monotonic()
        self._orders: deque[SettingOrder] = deque(maxlen=_ORDERS)
        self._workers: list[_CameraProcess] = []
        try:
            for group in _grouped(places, _cores() if workers is None else max(workers, 1)):
                self._workers.append(_CameraProcess.begin(group, self._settings))
            self._open()
        except BaseException:
            self.close()
            raise

    @property
    def name(self) -> str:
        """How many cameras there are."""
        return f"{len(self.cameras)} camera{'s' if len(self.cameras) > 1 else ''}"

    @property
    def rate(self) -> float:
        """Images per second that the cameras say, in the median; NaN where none does."""
        rates = [state.report.rate for state in self._states.values() if state.report is not None and state.report.rate > 0]
        return float(np.median(rates)) if rates else math.nan

    @property
    def damaged(self) -> int:
        """Images of all cameras that could not be read."""
        refused = sum(counts.refused for counts in self.searches().values())
        return refused + sum(health.damaged for health in self.healths())

    @property
    def begins(self) -> float:
        """s on `time.monotonic` when files begin to play: see `LiveCamera.start`."""
        return math.nan if self._at is None else self._at

    @property
    def processes(self) -> tuple[int | None, ...]:
        """The ids of the processes."""
        return tuple(worker.process.pid for worker in self._workers)

    def healths(self) -> list[CameraHealth]:
        """How each camera that was opened does. Images that were not searched, since newer ones waited, count as dropped."""
        return [health for state in self._states.values() if (health := _health(state)) is not None]

    def searches(self) -> dict[str, SearchCounts]:
        """What is counted of the search, by the camera's name."""
        return {name: _search(state) for name, state in self._states.items()}

    def camera_numbers(self) -> list[dict[str, Any]]:
        """How each camera that was opened does, and its search, as plain values; None for what is not known."""
        searches = self.searches()
        return [as_json({**asdict(health), "search": asdict(searches[health.camera])}) for health in self.healths()]

    def read(self, timeout: float) -> LiveBlobs | None:
        """The next blobs of some camera; None where none came within so many seconds. Raises SourceEnded where all cameras have ended."""
        until = time.monotonic() + timeout
        while True:
            if self._waiting:
                return self._waiting.popleft()
            with self._reading:
                if self._closed.is_set():
                    raise SourceEnded
                if not self._take(min(TURN, max(0.0, until - time.monotonic()))):
                    raise SourceEnded
            if not self._waiting and time.monotonic() >= until:
                return None

    def close(self) -> None:
        """End the processes, from any thread."""
        self._closed.set()
        with self._reading:
            workers, self._workers = self._workers, []
            for worker in workers:
                # All at once, and then each is waited for.
                worker.orders.close()
                worker.pipe.close()
            until = time.monotonic() + _ENDING
            for worker in workers:
                worker.end(max(0.0, until - time.monotonic()))

    def set(self, setting: str, value: object, only: Sequence[str] = ()) -> None:
        """Set cameras while they run, all or only some; `outcomes` tells what became of it when they have answered.

        A process that is begun anew sets it again. Raises AsterismError where there is no such setting, value or camera.
        """
        asked, names = setting_value(setting, value), tuple(only) or self.cameras
        if not frozenset(names) <= frozenset(self.cameras):
            raise AsterismError(
                f"there is no camera {next(name for name in names if name not in self.cameras)}, only {', '.join(self.cameras)}."
            )
        # The thread that reads does it: it alone begins processes anew.
        self._orders.append(SettingOrder(setting, asked, names))

    def camera_states(self) -> list[dict[str, Any]]:
        """How each camera does, what it has, and what of its settings is not as it was asked, as plain values."""
        healths = {health.camera: as_json(asdict(health)) for health in self.healths()}
        outcomes = [outcome for outcome in self.outcomes() if not outcome.as_asked]
        return [
            {
                **healths.get(
                    name,
                    {"camera": name, "problem": state.problem or (state.report.problem if state.report else "") or "it is not open yet."},
                ),
                "has": {} if state.report is None else state.report.said,
                "told": [str(outcome) for outcome in outcomes if outcome.camera == name],
            }
            for name, state in self._states.items()
        ]

    def outcomes(self) -> list[SettingOutcome]:
        """What became of the settings of all cameras."""
        return [outcome for state in self._states.values() if state.report is not None for outcome in state.report.outcomes]

    def save(self, path: Path) -> None:
        """Write the cameras beside a recording: what was to be set on each, and what it said that it had. See `load_cameras`."""
        places = {place.name: place for worker in self._workers for place in worker.places if isinstance(place, CameraSpec)}
        said = {name: state.report.said for name, state in self._states.items() if state.report is not None}
        save_cameras(path, [places[name] for name in self.cameras if name in places], said)

    def findings(self) -> list[Finding]:
        """What went wrong with cameras and processes, and how often."""
        # A camera that has just been opened is not silent yet.
        has_begun = self._at is not None and time.monotonic() > self._at + _LEAD
        found = list(camera_findings(self.healths() if has_begun or self._closed.is_set() else (), self.outcomes()))
        for name, state in self._states.items():
            found += _search_findings(name, _search(state), state)
            if state.is_closed and state.report is not None:
                sentence = f"camera {name}: {state.report.problem}"
                mend = "The others go on without it; it takes part when it comes."
                found.append(Finding("live-camera-not-opened", Severity.ERROR, name, sentence, mend))
        return [*found, *self._ended_early()]

    def _ended_early(self) -> Iterator[Finding]:
        """Files that are over while others go on, or were longer."""
        lengths = {name: _length(health) for name, state in self._states.items() if (health := _health(state)) is not None}
        longest = max(lengths, key=lambda name: lengths[name], default="")
        for name, length in lengths.items():
            # Cameras that are stopped by hand end a frame or two apart.
            if self._states[name].has_ended and lengths[longest] - length > _ENDS_APART:
                other = f"has {lengths[longest]:,}" if self._states[longest].has_ended else "goes on"
                sentence = f"camera {name} ends after {counted(length, 'image')}, camera {longest} {other}."
                mend = "Cut the videos alike: frames behind its end are seen by the others alone."
                yield Finding("live-camera-ended", Severity.WARNING, name, sentence, mend)

    def _open(self) -> None:
        """Wait until all processes are there and all cameras open, or say which is not."""
        while not all(worker.ready for worker in self._workers):
            for worker in self._workers:
                if worker.dead or not worker.process.is_alive():
                    raise AsterismError(
                        f"the process that reads {_listed(worker.places)} ended {_how(worker.process)} before it began; in a script, guard "
                        'what is run by `if __name__ == "__main__":`.'
                    )
            self._take(TURN)
        self._at = time.monotonic() + _LEAD
        for worker in self._workers:
            worker.orders.send(self._at)
        begin = time.monotonic()
        while silent := [name for name, state in self._states.items() if not state.is_known]:
            if time.monotonic() > begin + _OPENING:
                raise AsterismError(f"camera {', '.join(silent)} does not answer; look at its cable and its power.")
            self._take(TURN)
        # A camera that is not there costs itself, and takes part when it comes; what is wrong in what was asked for costs all.
        closed = {name: state.report for name, state in self._states.items() if state.report is not None and state.is_closed}
        for name, report in closed.items():
            if len(closed) == len(self._states) or not report.is_missing:
                raise AsterismError(f"camera {name}: {report.problem}")

    def _pass_on(self, order: SettingOrder) -> None:
        for worker in self._workers:
            worker.places = tuple(_with(place, order) if place.name in order.names else place for place in worker.places)
            # One that has just died is begun anew with it.
            with suppress(OSError):
                worker.orders.send(order)

    def _take(self, timeout: float) -> bool:
        """Take what the processes have sent; False where all have ended with their cameras."""
        while self._orders:
            self._pass_on(self._orders.popleft())
        now = time.monotonic()
        if now - self._last_read > 1.0:
            # Nobody listened: what they said waits in the pipes.
            for worker in self._workers:
                worker.heard = now
        pipes = {worker.pipe: worker for worker in self._workers if not worker.dead and len(worker.pending) < _AHEAD}
        for pipe in wait(list(pipes), timeout) if pipes else ():
            worker = pipes[pipe]  # type: ignore[index]
            try:
                # What is there already is taken at once: each wait costs more than a message.
                while True:
                    self._told(worker, worker.pipe.recv())
                    if len(worker.pending) >= _AHEAD or not worker.pipe.poll():
                        break
            except (EOFError, OSError):
                self._died(worker)
        self._last_read = now = time.monotonic()
        # Of videos the next is that of the least number or time, which is known when all processes have sent one.
        while (first := [worker for worker in self._workers if worker.pending]) and all(
            worker.pending or worker.dead for worker in self._workers
        ):
            worker = min(first, key=lambda worker: self._settings.rank(worker.pending[0]))
            self._waiting.append(worker.pending.popleft())
        for place, worker in enumerate(self._workers):
            if not worker.dead and worker.ready and now - worker.heard > _HANGS:
                worker.process.kill()
            if worker.dead and not self._has_ended(worker) and now >= worker.begun + _AGAIN and self._at is not None:
                self._workers[place] = _CameraProcess.begin(worker.places, self._settings)
        if not pipes:
            if all(self._has_ended(worker) for worker in self._workers):
                return False
            self._closed.wait(timeout)
        return True

    def _told(self, worker: _CameraProcess, message: object) -> None:
        worker.heard = time.monotonic()
        if isinstance(message, LiveBlobs):
            (worker.pending if self._settings.by_number else self._waiting).append(message)
        elif isinstance(message, CameraReport):
            state = self._states[message.camera]
            state.report, state.problem = message, ""
        elif isinstance(message, WorkerReady):
            worker.ready = True
            if self._at is not None:
                worker.orders.send(self._at)

    def _died(self, worker: _CameraProcess) -> None:
        worker.dead = True
        worker.end(0.5)
        if self._settings.by_number and not self._has_ended(worker) and self._at is not None:
            # From its beginning a video would come again.
            raise AsterismError(f"the process that plays {_listed(worker.places)} ended {_how(worker.process)}; play it again.")
        for place in worker.places:
            state = self._states[place.name]
            if self._at is not None and not state.has_ended:
                state.health, state.search, state.report = _health(state), _search(state), None
                state.restarts += 1
                state.problem = f"the process that reads it ended {_how(worker.process)} and is begun anew."

    def _has_ended(self, worker: _CameraProcess) -> bool:
        return worker.dead and all(self._states[place.name].has_ended for place in worker.places)


def _with(place: CameraPlace, order: SettingOrder) -> CameraPlace:
    """A camera with a setting over its own."""
    return replace(place, settings={**place.settings, order.setting: order.value}) if isinstance(place, CameraSpec) else place


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """A process that begins here is not reached by Ctrl-C while it imports: it says nothing, and this one decides."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    # Each process is begun after this helper of Python's, whose own beginning would let interrupts through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _grouped(places: Sequence[CameraPlace], processes: int) -> list[list[CameraPlace]]:
    """The cameras of each process: dealt like cards, since those that stand side by side see equally much.

    Each machine vision camera has its own: a producer that is loaded once a process finds a camera again only while it has no other open.
    """
    alone = [place for place in places if str(getattr(place, "address", "")).startswith("genicam://")]
    others = [place for place in places if place not in alone]
    groups = min(len(others), processes)
    return [[place] for place in alone] + [others[group::groups] for group in range(groups)]


def _cores() -> int:
    """Cores that this process may use."""
    with suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _listed(places: Sequence[CameraPlace]) -> str:
    return f"camera {', '.join(place.name for place in places)}"


def _how(process: BaseProcess) -> str:
    """How a process ended."""
    code = process.exitcode
    if code is None:
        return "without a word"
    if code >= 0:
        return f"with status {code}"
    with suppress(ValueError):
        return f"by {signal.Signals(-code).name}"
    return f"by signal {-code}"


def _health(state: _CameraProgress) -> CameraHealth | None:
    """How a camera does, what was counted before its process died added."""
    now, before = None if state.report is None else state.report.health, state.health
    if now is None:
        return before if before is None else replace(before, problem=state.problem or before.problem)
    dropped = 0 if state.report is None else state.report.search.dropped
    now = replace(now, dropped=now.dropped + dropped, problem=state.problem or now.problem)
    if state.has_ended:
        now = replace(now, last_seen=0.0, problem="")
    if before is None:
        return now
    counts = {name: getattr(before, name) + getattr(now, name) for name in ("images", "lost", "late", "dropped", "damaged", "reopened")}
    return replace(now, **counts, seconds={trouble: before.seconds[trouble] + spent for trouble, spent in now.seconds.items()})


def _length(health: CameraHealth) -> int:
    """Images of a file up to here, those too that could not be used."""
    return health.images + health.lost + health.dropped + health.damaged


def _search(state: _CameraProgress) -> SearchCounts:
    """What is counted of the search, what was counted before the process died added."""
    if state.report is None:
        return state.search
    now, before = state.report.search, state.search
    return replace(now, **{name: getattr(before, name) + getattr(now, name) for name in ("searched", "dropped", "refused", "crowded")})


def _search_findings(name: str, counts: SearchCounts, state: _CameraProgress) -> list[Finding]:
    found = list[Finding]()
    if state.restarts:
        sentence = f"camera {name}: the process that reads it ended {how_often(state.restarts)} and was begun anew."
        mend = "Look at the memory of this machine, and at the camera's driver."
        found.append(Finding("live-camera-process", Severity.WARNING, name, sentence, mend))
    if counts.refused:
        why, _, mend = counts.problem.partition("; ")
        sentence = (
            f"camera {name}: {counted(counts.refused, 'image')} not searched: {why.rstrip('.') or 'they were of another size or depth'}."
        )
        severity = Severity.ERROR if counts.problem else Severity.WARNING
        found.append(
            Finding("live-camera-size", severity, name, sentence, mend[:1].upper() + mend[1:] or "Leave its size alone while it runs.")
        )
    if counts.crowded:
        sentence = f"camera {name}: {counts.crowded} images showed more than {MOST_BLOBS} blobs, of which the largest are used."
        mend = "Darken the room, lower its exposure, or set its threshold."
        found.append(Finding("live-camera-crowded", Severity.WARNING, name, sentence, mend))
    return found
