"""Everything that must hold before a change goes in: lint, format, types and the order of the rooms beside the tests.

    python tools/check.py                    # all of it, tests on all cores
    python tools/check.py -n 4 tests/test_cli.py   # options of pytest, and what it shall run
    python tools/check.py --bounds           # the tests of all kernels, with each access to an array checked, and nothing else

Lint, format, types and imports run at the same time as the tests. So do the tests of the kernels that read what others write (images,
files, clouds), a second time: with each access to an array checked. What they find is printed in full after the tests, and
pytest's closing line comes last. The exit status is 0 only if all passed.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

MARKED = [str(path) for path in sorted((ROOT / "tests").glob("test_*.py")) if "mark.bounds" in path.read_text(encoding="utf-8")]

# As modules of this interpreter: the same on all systems, and never a tool of another environment.
TOOLS = {
    "ruff check": ["-m", "ruff", "check", "."],
    "ruff format --check": ["-m", "ruff", "format", "--check", "."],
    "lint-imports": ["-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"],
    "mypy": ["-m", "mypy"],
    # Only the files that have the marker: to collect the others takes longer than to run these.
    "kernels within bounds": ["-m", "pytest", "-q", "-m", "bounds", *MARKED],
}
# Numba checks each index against its array then. Kernels compile anew for it, so not all tests run this way each time.
CHECKED = {"NUMBA_BOUNDSCHECK": "1"}
# A file's tests share models and recordings, so a file stays with one worker.
PYTEST = ["-m", "pytest", "-q", "-n", "auto", "--dist", "loadfile"]


@dataclass(frozen=True)
class Report:
    """What one tool said: its exit status, its output and how long it took, in seconds."""

    name: str
    status: int
    output: str
    seconds: float


def environment() -> dict[str, str]:
    """One thread of linear algebra per process: the workers already use all cores."""
    return {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", **os.environ, "PYTHONIOENCODING": "utf-8"}


def run_tool(name: str) -> Report:
    """Run one of `TOOLS` to its end."""
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *TOOLS[name]],
        cwd=ROOT,
        env=environment() | (CHECKED if "bounds" in name else {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
    )
    return Report(name, done.returncode, done.stdout, time.perf_counter() - started)


def run_pytest(arguments: Sequence[str]) -> tuple[int, str]:
    """Run the tests and pass on what they print, line by line; return their exit status and the closing line, which is kept back."""
    closing = ""
    with subprocess.Popen(
        [sys.executable, *PYTEST, *arguments],
        cwd=ROOT,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.strip():
                print(closing, end="", flush=True)
                closing = line
    return process.returncode, closing


def show(report: Report) -> None:
    """One line for a tool that passed, its whole output for one that failed."""
    if report.status == 0:
        print(f"{report.name}: passed ({report.seconds:.0f} s)", flush=True)
    else:
        print(f"\n{report.name}: FAILED (exit status {report.status})\n{report.output.rstrip()}\n", flush=True)


def main(arguments: Sequence[str]) -> int:
    """Run everything; return the exit status."""
    if "--bounds" in arguments:
        chosen = [argument for argument in arguments if argument != "--bounds"]
        return subprocess.run([sys.executable, *PYTEST, "-m", "kernels", *chosen], cwd=ROOT, env=environment() | CHECKED).returncode
    for stream in (sys.stdout, sys.stderr):  # a console of another encoding shows a question mark, and goes on
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    with ThreadPoolExecutor(len(TOOLS)) as pool:
        running: list[Future[Report]] = [pool.submit(run_tool, name) for name in TOOLS]
        status, closing = run_pytest(arguments)
        reports = [future.result() for future in running]
    print()
    for report in reports:
        show(report)
    failed = [report.name for report in reports if report.status != 0]
    if failed:
        print(f"failed: {', '.join(failed)}", flush=True)
    print(closing.rstrip(), flush=True)
    return status or int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
