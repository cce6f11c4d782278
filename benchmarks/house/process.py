"""What a session of eleven people costs in one command, that its results do not depend on who did the work, and what a cluster costs."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np

import asterism
from asterism.recording import Recording
from asterism.session import spread
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure

FILES = 40
"""Recordings of the session: those of the eleven people, and walks of nine of them, turned about the vertical."""
EMPTY = (2_000, 20_000)
MOST = 100_000


def process(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """`asterism process` of forty recordings of eleven people without names: two processes, one, Dask, and Dask with a worker lost."""
    with tempfile.TemporaryDirectory() as scratch:
        session, out = Path(scratch) / "people", Path(scratch) / "out"
        files = _write(session, benchmark.quick)
        seconds, told = _run(session, out / "two", "--workers", "2")
        row = f"process, 11 people, {FILES} raw files"
        yield Figure(f"{row}, two processes: time", "< 120", seconds, "s", files)
        said = sum(bool(one.get("verdict")) and bool(one.get("use")) for one in told["files"]) + len(told["failed"])
        yield Figure(f"{row}: without a verdict", "== 0", files - said, "files", files)
        analysed = sum(one.get("kind") == "walk" for one in told["files"])
        yield Figure(f"{row}: walks analysed", "none", analysed, "walks", files)
        first = _content(out / "two")
        before = _processor()
        alone, _ = _run(session, out / "one")
        yield Figure(f"{row}, one process: time", "none", alone, "s", files)
        yield Figure(f"{row}, one process: processor time", "none", _processor() - before, "s", files)
        yield Figure(f"{row}, one process and two: other bytes", "== 0", _others(first, out / "one"), "files", len(first))
        with _cluster() as (address, workers):
            seconds, _ = _run(session, out / "dask", "--dask", address)
            yield Figure(f"{row}, Dask, two workers: time", "none", seconds, "s", files)
            yield Figure(f"{row}, Dask: other bytes", "== 0", _others(first, out / "dask"), "files", len(first))
            half = Thread(target=_kill_half_way, args=(out / "killed", files // 2, workers[0]))
            half.start()
            _, told = _run(session, out / "killed", "--dask", address)
            half.join()
            yield Figure(f"{row}, Dask, a worker killed half-way: other bytes", "== 0", _others(first, out / "killed"), "files", len(first))
            begun = [path.read_text().count('"begun"') for path in (out / "killed" / "records" / "labelled").rglob("*.jsonl")]
            yield Figure(f"{row}, Dask, a worker killed half-way: files begun again", "<= 1", sum(begun) - files, "files", files)


def cluster(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """What a Dask cluster of two workers adds to each task, and what its scheduler holds, by tasks that do nothing."""
    counts = tuple(count // 20 for count in EMPTY) if benchmark.quick else EMPTY
    held = []
    with _cluster() as (address, _):
        scheduler = int(_SCHEDULER["process"])
        for count in counts:
            started = time.perf_counter()
            done = sum(outcome.value == number for number, outcome in spread(abs, range(count), dask=address))
            each = 1000.0 * (time.perf_counter() - started) / count
            yield Figure(f"Dask, {count:,} empty tasks: cost of a task", "< 20", each, "ms", done)
            held.append(_resident(scheduler))
            yield Figure(f"Dask, {count:,} empty tasks: memory of the scheduler", "none", held[-1], "MB", done)
    growth = (held[1] - held[0]) / (counts[1] - counts[0])
    row = f"Dask, {MOST:,} tasks: memory of the scheduler, by its growth"
    yield Figure(row, "< 2000", held[1] + max(growth, 0.0) * (MOST - counts[1]), "MB", sum(counts))


def _write(session: Path, quick: bool) -> int:
    """Write the recordings without names, the points of each in another order; how many there are."""
    trials = [(person, Path(str(one.metadata["file"])).name, one) for person, own in gait(GAIT_BODY).items() for one in own]
    walks = [(person, f"back {name}", _turned(one)) for person, name, one in trials if "straight" in name]
    count = 0
    for person, name, one in (trials + walks)[: 6 if quick else FILES]:
        order = np.random.default_rng(count).permutation(len(one.labels))
        raw = replace(one, labels=tuple(f"*{m + 1}" for m in order), positions=one.positions[:, order], events=(), metadata={})
        (session / person).mkdir(parents=True, exist_ok=True)
        asterism.write((session / person / name).with_suffix(".c3d"), raw)
        count += 1
    return count


def _turned(recording: Recording) -> Recording:
    """The recording turned by half a turn about the vertical."""
    return replace(recording, positions=recording.positions * np.array([-1.0, -1.0, 1.0]))


def _run(session: Path, out: Path, *options: str) -> tuple[float, dict]:
    out.parent.mkdir(exist_ok=True)
    report = out.parent / f"{out.name}.json"
    started = time.perf_counter()
    words = [sys.executable, "-m", "asterism", "process", str(session), "-o", str(out), *options, "--json", str(report)]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    if done.returncode == 2:
        raise RuntimeError(done.stderr)
    return time.perf_counter() - started, json.loads(report.read_text())


def _processor() -> float:
    """s of processor time of all processes that this one has waited for: they do not grow with what else runs."""
    used = os.times()
    return used.children_user + used.children_system


def _content(out: Path) -> dict[str, bytes]:
    """The labelled recordings, and those with model outputs."""
    return {str(path.relative_to(out)): path.read_bytes() for one in ("labelled", "gait") for path in (out / one).rglob("*.c3d")}


def _others(first: dict[str, bytes], out: Path) -> int:
    """How many files are not the same bytes, or are in one of the two only."""
    other = _content(out)
    return sum(first.get(name) != other.get(name) for name in first.keys() | other.keys())


def _kill_half_way(out: Path, count: int, process: int) -> None:
    """Kill a process once so many recordings are labelled."""
    until = time.monotonic() + 600.0
    while len(list((out / "labelled").rglob("*.c3d"))) < count and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(process, signal.SIGKILL)


_SCHEDULER: dict[str, int] = {}
"""The process of the scheduler of `_cluster`."""


@contextmanager
def _cluster() -> Iterator[tuple[str, list[int]]]:
    """A scheduler and two workers with one thread each, in processes of their own: its address, and the workers' processes.

    Nobody starts a worker again that was killed: half a cluster goes on.
    """
    with tempfile.TemporaryDirectory() as scratch, _ended() as start:
        scheduler = start([sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"], scratch)
        address = _said(scheduler, r"Scheduler at:\s+(tcp://\S+)")
        _SCHEDULER["process"] = scheduler.pid
        words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        workers = [start(words, scratch) for _ in range(2)]
        for worker in workers:
            _said(worker, r"(Registered to)")
        yield address, [worker.pid for worker in workers]


@contextmanager
def _ended() -> Iterator[Callable[[list[str], str], subprocess.Popen[str]]]:
    """What starts processes, which are ended afterwards."""
    started: list[subprocess.Popen[str]] = []

    def start(words: list[str], folder: str) -> subprocess.Popen[str]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        started.append(subprocess.Popen(words, cwd=folder, stderr=subprocess.PIPE, text=True, env=environment))
        return started[-1]

    try:
        yield start
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()


def _said(process: subprocess.Popen[str], pattern: str) -> str:
    """The first match of a pattern in what a process says; what it says later is read and forgotten."""
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.search(pattern, line):
            Thread(target=process.stderr.read, daemon=True).start()
            return found[1]
    raise RuntimeError(f"{process.args} ended and did not say {pattern}")


def _resident(process: int) -> float:
    """MB that a process has in memory."""
    found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    assert found
    return int(found[1]) / 1000.0
