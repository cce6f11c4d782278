"""Everything that must hold before a change goes in: lint, format, types, the order of the rooms and the site, beside the tests.

    python tools/check.py                          # all but the tests that are marked as slow, on all cores
    python tools/check.py --all                    # the slow ones too: damaged files by the thousand, browsers, waiting
    python tools/check.py -n 4 tests/test_cli.py   # options of pytest, and what it shall run
    python tools/check.py --bounds                 # only the tests of kernels, with each access to an array checked

All steps run at the same time. A line tells when one begins and how long it took; what it found is printed when it ends, and a
failing test when it fails. pytest's closing line comes last. The exit status is 0 only if all passed, and 130 after Ctrl-C.
"""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENCODING = {"encoding": "utf-8", "errors": "replace"}
PATIENCE = 3.0
"""Seconds that a step gets to end after it was told to, before it is killed: pytest removes its temporary folders in less than one."""


@dataclass(frozen=True)
class Step:
    """A program of this interpreter, so never a tool of another environment, and the environment variables that it needs."""

    name: str
    arguments: Sequence[str]
    variables: Mapping[str, str] = field(default_factory=dict)


CHECKED = {"NUMBA_BOUNDSCHECK": "1"}
"""Each index is held against its array. Kernels compile anew for it, so not all of their tests run this way each time."""
MARKED = [str(path) for path in sorted((ROOT / "tests").glob("test_*.py")) if "mark.bounds" in path.read_text(encoding="utf-8")]

STEPS = [
    Step("ruff check", ["-m", "ruff", "check", "."]),
    Step("ruff format --check", ["-m", "ruff", "format", "--check", "."]),
    Step("lint-imports", ["-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]),
    Step("mypy", ["-m", "mypy"]),
    # Kernels of what others write (images, files, clouds). To collect all files takes longer than to run these, so they are named.
    Step("kernels within bounds", ["-m", "pytest", "-q", "-m", "bounds", *MARKED], CHECKED),
    # All pages are read, and all links and names resolved; `--all` writes them as HTML, too, which is a fifth of the time.
    # -E: what an earlier build found is found again. Without the names of the reference in the side bars, which nothing here looks at.
    Step("site", ["-m", "sphinx", "-b", "dummy", "-W", "-E", "--keep-going", "-q", "-D", "toc_object_entries=0", "docs", "build/checked"]),
]
"""What runs beside the tests. A line more here is a step more."""

# A file's tests share models and recordings, so a file stays with one worker.
TESTS = Step("pytest", ["-m", "pytest", "-q", "-n", "auto", "--dist", "loadfile", "--tb", "short", "--at-once"])
QUICK = ["-m", "not slow"]


class Runner:
    """Starts steps, each with the processes that it starts itself as one group, and ends all that still run."""

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self._running: list[subprocess.Popen[str]] = []
        self._stopped = False
        self._lock = threading.Lock()

    def say(self, text: str) -> None:
        """A line with the time since the beginning, whole even if two threads speak."""
        with self._lock:
            print(f"[{time.perf_counter() - self.began:4.0f} s] {text}", flush=True)

    def start(self, step: Step, arguments: Sequence[str] = ()) -> subprocess.Popen[str]:
        """Start a step with its output piped to us."""
        # One thread of linear algebra per process: the workers already use all cores.
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        variables = {**threads, **os.environ, **step.variables, "PYTHONIOENCODING": "utf-8", "PYTHONUNBUFFERED": "1"}
        with self._lock:
            if self._stopped:
                raise KeyboardInterrupt
            process = subprocess.Popen(
                [sys.executable, *step.arguments, *arguments],
                cwd=ROOT,
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                text=True,
                **ENCODING,
            )
            self._running.append(process)
        return process

    def stop(self) -> None:
        """End every step and what it started."""
        with self._lock:
            self._stopped = True
        for process in self._running:
            _end(process, hard=False)
        limit = time.perf_counter() + PATIENCE
        for process in self._running:
            try:
                process.wait(max(0.0, limit - time.perf_counter()))
            except subprocess.TimeoutExpired:
                _end(process, hard=True)

    def run(self, step: Step) -> bool:
        """Run a step to its end and tell how it went: a line if it passed, its whole output if not."""
        began = time.perf_counter()
        process = self.start(step)
        output = process.communicate()[0]
        if not self._stopped:
            passed = process.returncode == 0
            verdict = "passed" if passed else f"FAILED (exit status {process.returncode})\n{output.rstrip()}\n"
            self.say(f"{step.name}: {time.perf_counter() - began:.1f} s, {verdict}")
        return process.returncode == 0

    def run_tests(self, arguments: Sequence[str], tests: Step) -> tuple[int, str]:
        """Pass on what pytest prints, line by line; return its exit status and its closing line, which is kept back."""
        process, closing = self.start(tests, arguments), ""
        assert process.stdout is not None
        with process.stdout:
            for line in filter(str.strip, process.stdout):
                print(closing, end="", flush=True)
                closing = line
        return process.wait(), closing.rstrip()


def _end(process: subprocess.Popen[str], hard: bool) -> None:
    """End a process and, where the system has groups, what it started."""
    if process.poll() is not None:
        return
    if os.name == "posix":
        os.killpg(process.pid, signal.SIGKILL if hard else signal.SIGTERM)
    else:
        process.terminate()


def check_bounds(runner: Runner, arguments: Sequence[str]) -> int:
    """Run the tests of kernels with each access checked; return the exit status."""
    try:
        status, closing = runner.run_tests(["-m", "kernels", *arguments], replace(TESTS, variables=CHECKED))
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        runner.stop()
        raise
    print(closing, flush=True)
    return status


def check(runner: Runner, arguments: Sequence[str]) -> int:
    """Run everything; return the exit status."""
    everything = "--all" in arguments
    chosen = [*([] if everything else QUICK), *(word for word in arguments if word != "--all")]
    steps = [replace(step, arguments=["html" if everything and word == "dummy" else word for word in step.arguments]) for step in STEPS]
    runner.say(f"{', '.join(step.name for step in steps)}; pytest {' '.join(chosen)}")
    with ThreadPoolExecutor(len(steps)) as pool:
        try:
            running: list[Future[bool]] = [pool.submit(runner.run, step) for step in steps]
            status, closing = runner.run_tests(chosen, TESTS)
            runner.say(f"pytest: {'passed' if status == 0 else f'FAILED (exit status {status})'}")
            failed = [step.name for step, future in zip(steps, running, strict=True) if not future.result()]
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not leave half of them running
            runner.stop()
            raise
    times = os.times()
    if failed:
        print(f"failed: {', '.join(failed)}")
    runner.say(f"processor seconds: {times.children_user + times.children_system:.0f}")
    print(closing, flush=True)
    return status or int(bool(failed))


def main(arguments: Sequence[str]) -> int:
    """Run everything, or end it at Ctrl-C; return the exit status."""
    for stream in (sys.stdout, sys.stderr):  # a console of another encoding shows a question mark, and goes on
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    runner = Runner()
    try:
        if "--bounds" in arguments:
            return check_bounds(runner, [word for word in arguments if word != "--bounds"])
        return check(runner, arguments)
    except KeyboardInterrupt:
        runner.say("stopped")
        return 130


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # whoever ends this ends the steps, too
    sys.exit(main(sys.argv[1:]))
