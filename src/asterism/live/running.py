"""A source, a labeller and outputs in; labelled frames out, while they come, until the source ends or somebody stops it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.live.analysis import NOTHING, AnalysedFrame, LiveAnalysis
from asterism.live.chain import LabelChain, LabelledFrame, MakeLabeller
from asterism.live.clock import FrameCount, SourceClock, rows_of
from asterism.live.feedback import Feedback
from asterism.live.frames import TURN, LiveFrame, LiveSource, SourceEnded
from asterism.live.numbering import NUMBER_FRAMES, wrong_numbers
from asterism.live.pauses import short_pauses
from asterism.live.waiting import WaitingFrames
from asterism.recording import Floats
from asterism.recording.rates import TO_RATE, RateOfTimes, rate_of_times

_QUEUE = 0.1
"""s of frames that wait for their labels at most. A walking body is found again after it. Half of it drops frames at each pause of the
system; with twice as much what is shown is a fifth of a second old."""
_SILENT = 1.0
"""s without a frame after which the source counts as silent: ten frames of the slowest camera. Half of it calls five of these a silence;
with twice as much a cable that is out is shown a second later."""
_SHOWN = 0.5
"""s over which frames of the last second must be spread to tell their rate, else they are counted. Of half of it, frames that radio brings
together show twice their rate; double is more than there is."""
_AT_ONCE = 0.002
"""s within which a frame that was there already is read; a tenth of a millisecond is usual. Twice as long takes a new frame for an old one
at 500 Hz; with half of it a busy machine takes an old one for new."""
_FEWEST, _SURE = 4, 0.01
"""Frames from which on times may tell the rate, and the share of it by which they may be off then, so that a slow sender's is known in a
second. Three frames say nothing of how times scatter; five take one frame more. Half of the share takes 8 frames of 5 Hz instead of 5, with
twice as much irregular times are off by a tenth. Where they never tell it so well, `TO_RATE` frames have to do."""
_SLOWEST = 1.0
"""s from frame to frame from which on times are no seconds: milliseconds of 1,000 Hz. Half of it still tells those of 500 Hz, with twice as
much a body cannot be followed anyway."""
_LATENCIES = 4096
"""Latest frames whose latency is kept: 20 s at 200 Hz, so that one in a thousand is four frames. Half of them make one in a thousand two
frames; with twice as many a pause is shown for 40 s."""


class LiveOutput(Protocol):
    """Where labelled frames go; must not wait, since the next frame does.

    One that sends in a thread of its own may have `dropped`, how many frames it left out; `name` is what a person calls it.
    """

    def send(self, frame: AnalysedFrame) -> None:
        """Pass a frame on with what follows from it. Raises OSError where that fails; it is then counted as not sent."""

    def close(self) -> None:
        """Finish."""


class Watch(Protocol):
    """What looks whether the whole of the frames can be right. now: what is wrong, as long as it is."""

    now: tuple[Finding, ...]

    def add(self, found: LabelledFrame, rate: float, refusal: str = "") -> None:
        """Take a labelled frame; refusal: why no marker set was found yet."""


class FrameRecorder(Protocol):
    """Where frames are recorded, as they come and as they are labelled."""

    def frame(self, frame: LiveFrame) -> None:
        """Keep a frame as it came."""

    def labelled(self, frame: LabelledFrame) -> None:
        """Keep its labels."""


@dataclass
class Health:
    """What is counted while a session runs.

    before     frames that came while the labelling was made, and have no labels
    frames, lost, late, restarts, others  see `FrameCount`
    damaged    packets that could not be read
    dropped    frames that were taken and not labelled, since newer ones waited
    labelled   frames with their labels
    markers    how many the marker set has, 0 while it is not known
    shown      frames since the set is known that had points
    named      sure labels in those
    bare       those of them with points for half of the markers, so that a person may be there, and without a single sure label
    unsent     frames that an output did not take, by the output's name
    jumps      times that the source's clock was set
    searched   s from the first frame until the marker set was known and labels could be given, 0 where it was known before
    rate       frames per second as the source, --rate or the frames' own times say, by which they are labelled; NaN while it is not known
    arriving   frames that came per second, in the last second
    latency    (p50, p99.9) s from a frame's arrival to its labels, of the last thousands that came after `searched`
    studies    how many times the last seconds were labelled as a whole
    studied    s of frames since the last time, NaN before it
    lateness   s longer than the fastest frame that the last one was on its way
    silent     s since the last frame
    problem    why the session ended early, "" where it did not
    """

    before: int = 0
    frames: int = 0
    lost: int = 0
    late: int = 0
    restarts: int = 0
    others: int = 0
    damaged: int = 0
    dropped: int = 0
    labelled: int = 0
    markers: int = 0
    shown: int = 0
    named: int = 0
    bare: int = 0
    unsent: dict[str, int] = field(default_factory=dict)
    jumps: int = 0
    searched: float = 0.0
    rate: float = float("nan")
    arriving: float = 0.0
    latency: tuple[float, float] = (float("nan"), float("nan"))
    studies: int = 0
    studied: float = float("nan")
    lateness: float = 0.0
    silent: float = 0.0
    problem: str = ""

    @property
    def is_silent(self) -> bool:
        """Whether nothing comes."""
        return self.silent > _SILENT

    @property
    def labels(self) -> str:
        """How many labels a frame has, of how many markers, as a person reads it."""
        return f"{self.named / max(1, self.shown):.0f} of {self.markers}" if self.markers else "none yet"


@dataclass
class LiveSession:
    """Reads a source in one thread and labels its frames in another.

    source      closed at the end
    make        the labeller, made when the rate is known
    outputs     get each labelled frame, in the order of the frames
    delay       frames that the labels wait for
    recorder      records all frames, those too that are not labelled since newer ones waited
    analysis    finds angles and events; None for none
    feedback    what the person is told
    vertical    (3,) what points up; None for what the source says
    watch       looks whether the whole of the frames can be right; None for nothing
    waits       whether the source waits until there is room for its next frame: a file can, a camera cannot

    Where frames come faster than they are labelled, the oldest that waits is dropped and counted: what is shown is never old.
    Memory is bounded by `_QUEUE`. `run` ends with the source; `stop` ends it from any thread.
    """

    source: LiveSource
    make: MakeLabeller
    outputs: Sequence[LiveOutput] = ()
    delay: int = 0
    recorder: FrameRecorder | None = None
    waits: bool = False
    analysis: LiveAnalysis | None = None
    feedback: Feedback | None = None
    vertical: Floats | None = None
    watch: Watch | None = None
    _queue: WaitingFrames[LiveFrame] = field(init=False)
    _count: FrameCount = field(default_factory=FrameCount)
    _clock: SourceClock = field(default_factory=SourceClock)
    _health: Health = field(default_factory=Health)
    _refused: dict[int, int] = field(default_factory=dict)
    _arrivals: deque[float] = field(default_factory=lambda: deque(maxlen=1000))
    _latencies: deque[float] = field(default_factory=lambda: deque(maxlen=_LATENCIES))
    _rate: float = float("nan")
    _chain: LabelChain | None = None
    _is_made: bool = False
    _pushed_at: float = math.inf
    """when the frame that is being labelled was begun, s on `time.monotonic`; infinite between two frames"""
    _begun: float = -math.inf
    _overflowed: int = 0
    """frames that the source's socket had left out before the first one that was taken"""
    _first: float | None = None
    _ready: float | None = None
    _searches: bool = False
    _failed: Exception | None = None

    def __post_init__(self) -> None:
        self._queue = WaitingFrames(waits=self.waits)

    def run(self, seconds: float = math.inf) -> Health:
        """Read and label until the source ends, or so many seconds have passed since the first frame could come.

        Raises AsterismError where the labelling cannot begin.
        """
        with short_pauses():
            return self._run(seconds)

    def _run(self, seconds: float) -> Health:
        self._rate, self._begun = self.source.about.rate, time.monotonic()
        threads = [
            threading.Thread(target=self._read, name="live source", daemon=True),
            threading.Thread(target=self._work, name="live labels", daemon=True),
        ]
        try:
            # What can be made before the first frame keeps none of them waiting.
            if np.isfinite(self._rate):
                self._chain = self._made()
                if not self.has_ended:
                    self._chain.wait_for_studies()
            if self.has_ended:
                self._health.problem = "It was stopped while its labelling was made; give it until the first labels are there."
            self._pass_over(time.monotonic() - self._begun)
            self._is_made = self._chain is not None
            for thread in threads:
                thread.start()
            until = time.monotonic() + seconds
            # This thread only waits, so that Ctrl-C breaks no frame off: it ends the session with all that came.
            while threads[1].is_alive():
                if time.monotonic() >= until:
                    self.stop()
                with suppress(KeyboardInterrupt):
                    threads[1].join(min(TURN, max(0.001, until - time.monotonic())))
                    continue
                self.stop()
        finally:
            self.stop()
            if threads[0].ident is not None:
                threads[0].join(timeout=5 * TURN)
            for output in self.outputs:
                output.close()
            if self._chain is not None:
                self._chain.close()
            self.source.close()
        if self._failed is not None:
            raise self._failed
        return self.health()

    def stop(self) -> None:
        """End the session: no frame is taken any more, and those that wait are labelled."""
        self._queue.stop()

    @property
    def up(self) -> Floats | None:
        """(3,) what points up; None where nobody says so."""
        return self.source.about.vertical if self.vertical is None else self.vertical

    @property
    def pending(self) -> str:
        """Why nothing is labelled although frames may come, as a person reads it; "" where they are labelled."""
        if self._is_made:
            if time.monotonic() - self._pushed_at <= _SILENT:
                return ""
            return (
                "this machine is busy, and labels come when it is done"
                if self._health.markers
                else "the marker set is being found, which takes some seconds"
            )
        if np.isfinite(self._rate):
            return "the labelling is being made, which takes longest the first time"
        return "its rate is sought by the times of its frames; with --rate labels begin at once" if self._arrivals else ""

    @property
    def has_ended(self) -> bool:
        """Whether no frame comes any more."""
        return self._queue.is_stopped

    def findings(self) -> list[Finding]:
        """What a person should know of the marker set that was found, of the studies, and of frames whose numbers or times are none."""
        count = self._count
        where, jumps = self.source.about.name, self._clock.jumps
        wrong = wrong_numbers(where, count.received, count.late, jumps) if count.received + count.late >= TO_RATE else []
        return [*wrong, *([] if self._chain is None else self._chain.findings())]

    def health(self) -> Health:
        """What was counted so far."""
        now, health = time.monotonic(), self._health
        count = self._count
        health.frames, health.lost, health.late, health.restarts = count.received, count.lost, count.late, count.restarts
        health.others = count.others
        # What a source left out itself or could not read, and tells, was not lost on the way.
        told = sum(int(getattr(self.source, name, 0)) for name in ("dropped", "unread", "overflowed"))
        health.lost = max(0, health.lost - told + self._overflowed)
        health.damaged, health.jumps = self.source.damaged, self._clock.jumps
        health.unsent = {}
        for output in self.outputs:
            unsent = self._refused.get(id(output), 0) + int(getattr(output, "dropped", 0))
            if unsent:
                name = str(getattr(output, "name", type(output).__name__))
                health.unsent[name] = health.unsent.get(name, 0) + unsent
        if self._chain is not None:
            health.studies, health.studied = self._chain.studies_made()
        arrivals = np.array(self._arrivals)
        health.silent = float(now - arrivals[-1]) if len(arrivals) else 0.0
        recent = arrivals[arrivals > now - 1.0]
        # Frames of one moment say nothing of how many come in a second.
        shown = float(recent[-1] - recent[0]) if len(recent) > 1 else 0.0
        health.arriving = (len(recent) - 1) / shown if shown > _SHOWN else float(len(recent))
        health.rate = self._rate
        if self._latencies:
            p50, p999 = np.quantile(np.array(self._latencies), (0.5, 0.999))
            health.latency = (float(p50), float(p999))
        return health

    def _read(self) -> None:
        """The reader's thread."""
        try:
            while not self._queue.is_stopped:
                frame = self.source.read(TURN)
                if frame is not None:
                    self._take(frame)
        except SourceEnded:
            pass
        except Exception as problem:  # the labelling thread must not wait for ever
            self._health.problem = f"{self.source.about.name} failed ({problem}); start it again."
        finally:
            self._queue.close()

    def _take(self, frame: LiveFrame) -> None:
        silent = bool(self._arrivals) and frame.arrived - self._arrivals[-1] > _SILENT
        if not self._count.received:
            self._overflowed = int(getattr(self.source, "overflowed", 0))
        if not self._count.takes(frame.number, silent=silent):
            return
        # A source that waits was held back by us: its clock and ours say nothing of each other.
        if not self.waits:
            self._health.lateness = self._clock.lateness(frame.time, frame.arrived)
        self._arrivals.append(frame.arrived)
        if self.recorder is not None:
            self.recorder.frame(frame)
        # Until the rate is known nothing is labelled, and the first frames wait for it.
        most = max(2, round(_QUEUE * self._rate)) if np.isfinite(self._rate) else TO_RATE
        self._leave_out(self._queue.put(frame, most))

    def _pass_over(self, seconds: float) -> None:
        """Leave out what came while the labelling was made for so many seconds: labels of it would be old, and hold the next ones back."""
        # What came in a shorter time waits for its labels, as always.
        if self.waits or seconds <= _QUEUE:
            return
        ready, looks = time.monotonic(), math.ceil(2 * seconds * self._rate)
        try:
            while looks > 0:
                begin = time.monotonic()
                frame = self.source.read(_AT_ONCE)
                if frame is None:
                    return
                if frame.arrived >= ready and time.monotonic() - begin > _AT_ONCE / 2:
                    # It was waited for, so that it is new. Of many sources all are as new as they are read.
                    self._take(frame)
                    return
                # What says that it came before ends by itself; of others no more are passed over than can have come.
                looks -= frame.arrived >= ready
                self._health.before += 1
        except SourceEnded:
            self._queue.stop()

    def _made(self) -> LabelChain:
        return LabelChain(self.make(self._rate, self.up), self._rate, self.delay)

    def _work(self) -> None:
        """The labelling thread."""
        try:
            begin = list[LiveFrame]()
            if self._chain is None:
                begin = self._frames_for_rate()
                if not np.isfinite(self._rate):
                    return
                self._chain = self._made()
            self._is_made = True
            for frame in begin:
                self._label(self._chain, frame)
            while (next_frame := self._next()) is not None:
                self._label(self._chain, next_frame)
            for found in self._chain.flush():
                self._passed_on(found)
        except Exception as problem:  # raised by the thread that waits; who looks on hears of it, too
            self._failed, self._health.problem = problem, f"The labelling failed: {problem}"
        finally:
            self.stop()

    def _label(self, chain: LabelChain, frame: LiveFrame) -> None:
        self._pushed_at = time.monotonic()
        self._passed_on(chain.push(frame))
        self._pushed_at = math.inf

    def _frames_for_rate(self) -> list[LiveFrame]:
        """The first frames, by whose times the rate is found."""
        taken, found = list[LiveFrame](), RateOfTimes(math.nan, 0.0, math.inf)
        while len(taken) < TO_RATE and not (len(taken) >= _FEWEST and 0 < found.sd < _SURE * found.step):
            frame = self._queue.take()
            if frame is None:
                return taken
            taken.append(frame)
            found = rate_of_times(rows_of([each.number for each in taken]), [each.time for each in taken])
        name = self.source.about.name
        # Where numbers stand still, only those frames were taken that came after a silence: of their times nothing follows.
        if not found.step < _SLOWEST and self._count.late > self._count.received:
            raise AsterismError(f"{name}: most of its frames have the number of an earlier one; {NUMBER_FRAMES}")
        if not found.step > 0:
            raise AsterismError(f"{name}: its times do not grow from frame to frame; say its rate with --rate.")
        if found.step >= _SLOWEST:
            raise AsterismError(f"{name}: its times grow by {found.step:g} from frame to frame, and are read as seconds; send seconds.")
        self._rate = found.rate
        return taken

    def _next(self) -> LiveFrame | None:
        """The oldest frame that waits; None at the end."""
        # However slow this is, what is shown is not old. What waits at the end is labelled.
        frame, left_out = self._queue.take_fresh(math.inf, lambda each: not (self.waits or self._queue.is_stopped) and _is_old(each))
        self._leave_out(left_out)
        return frame

    def _leave_out(self, frames: list[LiveFrame]) -> None:
        for frame in frames:
            # It came before the session, or the labelling is still being made where the rate had to be found first: no machine is too slow.
            before = self._chain is None or frame.arrived < self._begun
            self._health.before += before
            self._health.dropped += not before

    def _passed_on(self, found: LabelledFrame | None) -> None:
        if found is None:
            return
        self._health.labelled += 1
        self._health.markers = len(found.markers)
        if found.markers and len(found.frame.points):
            named = int((found.indices >= 0).sum())
            self._health.shown += 1
            self._health.named += named
            self._health.bare += not named and 2 * len(found.frame.points) >= len(found.markers)
        self._first = found.frame.arrived if self._first is None else self._first
        self._searches = self._searches or not found.markers
        if not self._searches or (self._ready is not None and found.frame.arrived >= self._ready):
            self._latencies.append(found.done - found.frame.arrived)
        if self.watch is not None and self._chain is not None:
            self.watch.add(found, self._rate, self._chain.refusal)
        if self.recorder is not None:
            self.recorder.labelled(found)
        analysis = NOTHING if self.analysis is None else self.analysis.push(found)
        analysed = AnalysedFrame(found, analysis, () if self.feedback is None else self.feedback.judge(found, analysis))
        for output in self.outputs:
            try:
                output.send(analysed)
            except OSError:
                self._refused[id(output)] = self._refused.get(id(output), 0) + 1
        if found.markers and self._ready is None:
            # Frames that waited while the set was sought, and what follows from its labels was made, say nothing of those after them.
            self._ready = time.monotonic()
            self._health.searched = max(0.0, self._ready - self._first) if self._searches else 0.0


def _is_old(frame: LiveFrame) -> bool:
    return time.monotonic() - frame.arrived > _QUEUE
