"""The page of a live session in Chromium without a window: how late a sound begins, how many pictures are drawn, what grows."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from asterism.live import (
    Feedback,
    FeedbackRule,
    HostPort,
    JsonDatagrams,
    LiveFrame,
    LiveSession,
    LiveSource,
    frame_as_json,
    make_labeller,
)
from asterism.live.chain import MakeLabeller
from asterism.recording import Clouds, Recording
from asterism.web.live_page import ToPage, serve_live
from asterism.web.serving import PageAddress
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY
from benchmarks.figures import Figure
from benchmarks.recordings.walks import Condition, full_body_subjects, sample, unseen_model, walks
from tests.browser import CHROMIUM, Tab

RATE = 200.0
FEET = ("LHEE", "RHEE", "LTOE", "RTOE")
_SENDER = """
import socket, sys, time
rate, port = float(sys.argv[1]), int(sys.argv[2])
lines, sent = sys.stdin.buffer.read().splitlines(), []
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
    begin = time.monotonic()
    for n, line in enumerate(lines):
        time.sleep(max(0.0, begin + n / rate - time.monotonic()))
        sent.append(time.time())
        out.sendto(line, ("127.0.0.1", port))
print(*sent)
"""
_HOUR = """new Promise(done => {
  let n = 0, time = globalThis.hourTime || NEWS.time;
  const tell = content => { TELL };
  const picture = () => {
    const words = n % 120 < 60 ? time.toFixed(1) : "";
    const cues = NEWS.cues.map(() => [Math.sin(time), time.toFixed(3), n % 120 < 60, null, words]);
    tell({ ...NEWS, picture: NEWS.picture + n, time, values: NEWS.values.map(() => Math.sin(time)), cues });
  };
  const moments = () => {
    const at = Asterism.live ? Asterism.live.clock.at(performance.now()) : 0;
    const event = { kind: "heel strike", side: n % 60 ? "left" : "right", time };
    tell({ sent: at, moments: [{ event, at, done: at }, { cue: { name: "beep", sound: "beep" }, at, done: at, time }] });
  };
  const some = () => {
    for (let k = 0; k < 600 && n < PICTURES; k++, n++) {
      time += 1 / 60;
      picture();
      if (n % 30 === 0) moments();
    }
    globalThis.hourTime = time;
    if (n < PICTURES) setTimeout(some); else done(n);
  };
  some();
})"""
_PAGE_HOUR = _HOUR.replace("NEWS", "Asterism.live.newest").replace("TELL", "Asterism.live.told(JSON.stringify(content));")
_WORKER_HOUR = _HOUR.replace("NEWS", "Asterism.drawing.newest").replace(
    "TELL", "Asterism.drawing.tell({ told: JSON.stringify(content) }); if (n % 6 === 0) Asterism.drawing.draw();"
)
_LATE = """new Promise(done => {
  const live = Asterism.live, told = live.drawnIs, late = [];
  live.drawnIs = one => { told.call(live, one); late.push(live.clock.at(one.when - performance.timeOrigin) - one.at); };
  setTimeout(() => { live.drawnIs = told; done(late); }, 1000 * SECONDS);
})"""


def tone(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """59 markers at 200 Hz over UDP; a foot that passes a height: from the packet's departure to the beginning of the sound in the page."""
    if CHROMIUM is None:
        benchmark.report("Chromium is not installed.")
        return
    subject = full_body_subjects()[0]
    model = unseen_model(benchmark, subject, GAIT_BODY)
    truth = next(iter(walks(subject, GAIT_BODY)))
    clouds = sample(truth, Condition(3, 3), 0).clouds
    count = 3000 if benchmark.quick else 22_000
    rules = Feedback([_passes(truth, name) for name in FEET])
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    with _shown(source, make_labeller(model, None, 0), rules) as (tab, session, page):
        tab.value("document.getElementById('sound').click()")
        tab.wait("Asterism.live.sounds.context.state === 'running'")
        sent = _sent(clouds, count, source.port)
        time.sleep(1.0)
        log, added = (
            tab.value("Asterism.live.log"),
            tab.value("[Asterism.live.sounds.context.baseLatency, Asterism.live.sounds.context.outputLatency]"),
        )
        wall = time.time() - time.monotonic()
        said = page.tone_latency()
        session.stop()
    ours = {name: np.array([wall + each[name] / 1000 for each in log]) for name in ("at", "done", "sent")}
    theirs = {name: np.array([each[name] / 1000 for each in log]) for name in ("handled", "begins")}
    times = [np.array([sent[round(each["time"] * RATE)] for each in log]), *ours.values(), *theirs.values()]
    spent, n = 1000 * (times[-1] - times[0]), len(log)
    row = "live, event of a rule to its tone in the page"
    yield Figure(f"{row}: p50", "none", float(np.quantile(spent, 0.5)), "ms", n)
    yield Figure(f"{row}: p99", "< 30", float(np.quantile(spent, 0.99)), "ms", n)
    for name, begin, end in zip(
        ("packet to frame", "frame to labels", "labels to socket", "socket to handler", "handler to sound"), times, times[1:], strict=False
    ):
        part = 1000 * (end - begin)
        yield Figure(f"{row}, {name}: p50", "none", float(np.quantile(part, 0.5)), "ms", n)
        yield Figure(f"{row}, {name}: p99", "none", float(np.quantile(part, 0.99)), "ms", n)
    yield Figure(f"{row}, as the page itself tells it, from the frame: p99", "none", said[1], "ms", said[2])
    for name, seconds in zip(("base", "output"), added, strict=True):
        yield Figure(f"{row}: not in it, the browser's {name} latency", "none", 1000 * seconds, "ms", 1)


def page(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """59 markers at 100 Hz: pictures drawn a second; then an hour of pictures as fast as they are taken: what the memory grows by."""
    if CHROMIUM is None:
        benchmark.report("Chromium is not installed.")
        return
    subject = full_body_subjects()[0]
    clouds = sample(next(iter(walks(subject, GAIT_BODY))), Condition(0, 0), 0).clouds
    seconds, pictures = (5, 20_000) if benchmark.quick else (60, 216_000)
    rules = Feedback([FeedbackRule(name, "height", (name,), above=0.12, text="{value}", colour="green") for name in FEET])
    source, stopped = JsonDatagrams(HostPort("127.0.0.1", 0), 100.0), threading.Event()
    sender = threading.Thread(target=_send_on, args=(clouds, source.port, stopped))
    with _shown(source, make_labeller(None, "helen-hayes", 0), rules) as (tab, session, _):
        sender.start()
        tab.wait("Asterism.live.drawn > 100")
        for name, width, height in (("1400 x 900", 1400, 900), ("800 x 1100", 800, 1100), ("390 x 844", 390, 844)):
            tab.resize(width, height, is_phone=width < 1000)
            time.sleep(1.0)
            late = tab.value(_LATE.replace("SECONDS", str(seconds)))
            yield Figure(f"live page, {name}: drawn", ">= 55", len(late) / seconds, "pictures/s", seconds)
            for share in (0.5, 0.99):
                after = float(np.quantile(late, share))
                yield Figure(f"live page, {name}: frame to its picture drawn, p{100 * share:.0f}", "none", after, "ms", len(late))
        stopped.set()
        sender.join()
        session.stop()
        tab.resize(1400, 900)
        tab.value("document.getElementById('sound').click()")
        heaps = []
        # The first minute fills what is kept; what comes after it may not grow.
        for some in (3600, pictures):
            tab.value(_WORKER_HOUR.replace("PICTURES", str(some)), in_worker=True)
            tab.value(_PAGE_HOUR.replace("PICTURES", str(some)))
            time.sleep(1.0)
            used = []
            for in_worker in (False, True):
                tab.call("HeapProfiler.collectGarbage", in_worker=in_worker)
                used.append(tab.call("Runtime.getHeapUsage", in_worker=in_worker)["usedSize"] / 1e6)
            metrics = {each["name"]: each["value"] for each in tab.call("Performance.getMetrics")["metrics"]}
            heaps.append((sum(used), metrics.get("Nodes", 0.0)))
        row = f"live page, {pictures / 3600:.0f} minutes of pictures"
        yield Figure(f"{row}: memory of its scripts at the end", "none", heaps[1][0], "MB", pictures)
        yield Figure(f"{row}: growth of it", "< 0.5", heaps[1][0] - heaps[0][0], "MB", pictures)
        yield Figure(f"{row}: growth of its elements", "<= 10", heaps[1][1] - heaps[0][1], "elements", pictures)


@contextmanager
def _shown(source: LiveSource, make: MakeLabeller, rules: Feedback) -> Iterator[tuple[Tab, LiveSession, ToPage]]:
    """A session that runs, and its page in a browser."""
    to_page, said = ToPage(), list[str]()
    session = LiveSession(source, make, [to_page], feedback=rules)
    stop = serve_live(session, to_page, PageAddress(), said.append)
    running = threading.Thread(target=session.run)
    running.start()
    try:
        with Tab(said[0].rpartition(" ")[2]) as tab:
            tab.call("Performance.enable")
            tab.wait("Asterism.live && Asterism.live.clock.isKnown")
            yield tab, session, to_page
    finally:
        session.stop()
        running.join()
        stop()


def _passes(truth: Recording, name: str) -> FeedbackRule:
    """A beep as a marker passes the middle of its heights."""
    heights = truth.positions[:, truth.labels.index(name), 2]
    return FeedbackRule(name, "height", (name,), above=float(np.nanmin(heights) + np.nanmax(heights)) / 2, hysteresis=0.02, sound="beep")


def _lines(clouds: Clouds, count: int, rate: float) -> list[bytes]:
    points: list[Any] = [np.round(each, 6) for each in clouds]
    return [frame_as_json(LiveFrame(n, n / rate, 0.0, points[n % len(points)])) for n in range(count)]


def _sent(clouds: Clouds, count: int, port: int) -> list[float]:
    """Send frames at their rate from another process, as a camera system does; when each went, s since 1970."""
    words = [sys.executable, "-c", _SENDER, str(RATE), str(port)]
    done = subprocess.run(words, input=b"\n".join(_lines(clouds, count, RATE)), stdout=subprocess.PIPE, check=True)
    return [float(word) for word in done.stdout.split()]


def _send_on(clouds: Clouds, port: int, stopped: threading.Event) -> None:
    """Send frames at 100 Hz until somebody stops it."""
    words = [sys.executable, "-c", _SENDER, "100", str(port)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as process:
        assert process.stdin is not None
        process.stdin.write(b"\n".join(_lines(clouds, 60_000, 100.0)))
        process.stdin.close()
        stopped.wait()
        process.kill()
