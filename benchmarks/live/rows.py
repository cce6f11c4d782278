"""Real packets over the loopback address, a process that is killed, and hours of frames in accelerated time."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import asterism
from asterism.live import (
    AnalysedFrame,
    HostPort,
    JsonDatagrams,
    LiveFrame,
    LiveRecorder,
    LiveSession,
    SessionWatch,
    SourceAbout,
    SourceEnded,
    frame_as_json,
    make_labeller,
)
from asterism.recording import Clouds
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY
from benchmarks.figures import Figure
from benchmarks.recordings.walks import Condition, full_body_subjects, sample, unseen_model, walks

RATE = 200.0


def packets(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """59 markers at 200 Hz, 3 hidden and 3 ghosts, as JSON over UDP: from the last byte of a frame to its labels. Needs a quiet machine."""
    subject = full_body_subjects()[0]
    model = unseen_model(benchmark, subject, GAIT_BODY)
    clouds = sample(next(iter(walks(subject, GAIT_BODY))), Condition(3, 3), 0).clouds
    count = 400 if benchmark.quick else 6000
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    sink = _Times()
    session = LiveSession(source, make_labeller(model, None, 0), [sink])
    sender = threading.Thread(target=_send, args=(clouds, count, source.port, session))
    sender.start()
    health = session.run()
    sender.join()
    spent = np.array(sink.seconds[50:])
    row = "live, 59 markers at 200 Hz, 3 hidden + 3 ghosts"
    yield Figure(f"{row}, packet to labels: p50", "< 4", 1000 * float(np.quantile(spent, 0.5)), "ms", len(spent))
    yield Figure(f"{row}, packet to labels: p99.9", "< 10", 1000 * float(np.quantile(spent, 0.999)), "ms", len(spent))
    unsaid = count - health.labelled - health.dropped - health.lost - health.late
    yield Figure(f"{row}: frames lost and not told", "== 0", unsaid, "frames", count)
    yield Figure(f"{row}: frames left out, and told", "none", health.dropped, "frames", count)


def killed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """`asterism live` that records at 100 Hz and is killed at any moment: the seconds that the recording lacks.

    Half of the sessions are told to end before, and killed while the C3D file is written. What is left behind is written by `--finish`.
    """
    rng, runs = np.random.default_rng(0), 4 if benchmark.quick else 50
    lost: dict[bool, list[float]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as scratch:
        walk = asterism.simulation.simulate_walks(subjects=1, frames=1500, seed=3)[0]
        path = Path(scratch) / "walk.c3d"
        asterism.write(path, walk)
        for run in range(runs):
            out, ends = Path(scratch) / f"{run}.c3d", run % 2 == 1
            last = _killed(rng, path, out, ends)
            if not out.exists():
                _asterism("--finish", f"{out}.live", "-o", str(out)).wait()
            lost[ends].append(max(0, last + 1 - len(asterism.read(out))) / walk.rate)
    yield Figure("live, killed while recording: most that is lost", "<= 0.5", max(lost[False]), "s", len(lost[False]))
    yield Figure("live, killed while the file is written: most that is lost", "<= 0.5", max(lost[True]), "s", len(lost[True]))


def _killed(rng: np.random.Generator, path: Path, out: Path, ends: bool) -> int:
    """The last frame that a session told the labels of, before it was killed; ends: told to end just before."""
    process = _asterism("--replay", str(path), "--loop", "--markers", "helen-hayes", "--no-analysis", "--lines", "-o", str(out))
    assert process.stdout is not None
    until, last = math.inf, 0
    for line in process.stdout:
        until = min(until, time.monotonic() + rng.uniform(0.3, 2.0))
        last = int(line.split(",", 1)[0].partition(":")[2])
        if time.monotonic() >= until:
            break
    if ends:
        process.send_signal(signal.SIGTERM)
        time.sleep(rng.uniform(0.0, 0.3))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return last


def _asterism(*words: str) -> subprocess.Popen[str]:
    """`asterism live` with these words."""
    return subprocess.Popen(
        [sys.executable, "-m", "asterism.cli", "live", *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1
    )


def soak(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Four hours at 100 Hz as fast as they are labelled, 15 markers, recorded, the source silent and begun anew 200 times: what grows.

    A frame takes half a millisecond, so that it runs for a quarter of an hour.
    """
    subject = full_body_subjects()[0]
    model = unseen_model(benchmark, subject, "helen-hayes")
    clouds = sample(next(iter(walks(subject, "helen-hayes"))), Condition(1, 1), 0).clouds
    frames = 20_000 if benchmark.quick else 4 * 3600 * 100
    source, times = _Endless(clouds, frames, frames // 201), _Times(keep=frames)
    held = list[tuple[float, int]]()
    source.at = dict.fromkeys((frames // 10, frames - 1), lambda: held.append((resident(), sys.getallocatedblocks())))
    with tempfile.TemporaryDirectory() as scratch:
        recorder = LiveRecorder(Path(scratch) / "soak.live", "soak", None)
        watch = SessionWatch("soak", timed=False)
        health = LiveSession(source, make_labeller(model, None, 0), [times], waits=True, recorder=recorder, watch=watch).run()
        recorder.close()
    row = f"live, {frames / 360_000:.2g} hours at 100 Hz, source begun anew {health.restarts} times"
    (before, blocks), (after, more) = held
    yield Figure(f"{row}: growth of memory", "< 5", after - before, "MB", health.labelled)
    yield Figure(f"{row}: growth of objects in memory", "none", more - blocks, "blocks", health.labelled)
    pushes = np.array(times.spent)
    early, late = np.median(pushes[frames // 10 : frames // 5]), np.median(pushes[-frames // 10 :])
    yield Figure(f"{row}: time of a frame, last tenth by second", "<= 1.2", float(late / early), "times", health.labelled)
    unsaid = frames - health.labelled - health.dropped - health.late + frames - recorder.kept - recorder.lost - health.late
    yield Figure(f"{row}: frames not labelled or not recorded, and not told", "== 0", unsaid, "frames", frames)


def resident() -> float:
    """MB of this process that are in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


class _Times:
    """When frames were labelled."""

    def __init__(self, keep: int = 0) -> None:
        self.seconds, self._last = list[float](), time.perf_counter()
        # Written once, so that all of it is in memory from the beginning: it must not count as growth of the session.
        self.spent = np.full(keep, np.nan, dtype=np.float32)
        self._count = 0

    def send(self, frame: AnalysedFrame) -> None:
        if len(self.spent):
            now = time.perf_counter()
            self.spent[min(self._count, len(self.spent) - 1)] = now - self._last
            self._last, self._count = now, self._count + 1
        else:
            self.seconds.append(frame.labelled.done - frame.labelled.frame.arrived)

    def close(self) -> None:
        pass


class _Endless:
    """Clouds again and again, as fast as they are taken; after so many frames it is silent, and its numbers and its clock begin anew."""

    damaged = 0

    def __init__(self, clouds: Clouds, frames: int, each: int) -> None:
        self.about = SourceAbout("soak", clouds.rate, clouds.vertical)
        self._points, self._frames, self._each, self._next = list(clouds), frames, each, 0
        self._silent, self._before = 0, 0.0
        self.at: dict[int, Callable[[], None]] = {}

    def read(self, timeout: float) -> LiveFrame | None:
        if self._next >= self._frames:
            raise SourceEnded
        n = self._next
        if n and n % self._each == 0 and self._silent < 20:
            # Two seconds without a frame, by its own clock.
            self._silent, self._before = self._silent + 1, self._before + timeout
            return None
        self._next, self._silent = n + 1, 0
        if (act := self.at.get(n)) is not None:
            act()
        since = n % self._each
        return LiveFrame(since, since / self.about.rate, self._before + n / self.about.rate, self._points[n % len(self._points)])

    def close(self) -> None:
        pass


_SENDER = """
import socket, sys, time
rate, count, port = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
lines = sys.stdin.buffer.read().splitlines()
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
    begin = time.monotonic()
    for n in range(count):
        time.sleep(max(0.0, begin + n / rate - time.monotonic()))
        out.sendto(lines[n], ("127.0.0.1", port))
"""


def _send(clouds: Clouds, count: int, port: int, session: LiveSession) -> None:
    """Send frames at their rate from another process, as a camera system does; the end is told by stopping the session."""
    points = [np.round(each, 6) for each in clouds]
    lines = b"\n".join(frame_as_json(LiveFrame(n, n / RATE, 0.0, points[n % len(points)])) for n in range(count))
    time.sleep(3.0)  # labels begin when the model is ready
    subprocess.run([sys.executable, "-c", _SENDER, str(RATE), str(count), str(port)], input=lines, check=True)
    time.sleep(1.0)
    session.stop()
