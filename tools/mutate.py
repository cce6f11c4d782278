"""Deliberate faults: change one place of the sources at a time, and see whether a test fails.

    python tools/mutate.py map                         # once: which functions each test reaches (as long as the tests take)
    python tools/mutate.py run --faults 300 --seed 0   # sample so many faults and try those that have no result yet; stop it when you like
    python tools/mutate.py list                        # the survivors

The working tree is never touched: faults are put into a copy in `--work`. For each fault the tests that reach its function run, nearest
first, until one fails; that test then runs on the sources without the fault, where it must pass. Results are in `--results`.

Why not mutmut or cosmic-ray: both choose tests, if at all, by line coverage, which does not see compiled kernels; mutmut keeps all faults
of a file in one source and switches between them while Python runs, which a compiled kernel cannot do; and both compile every kernel anew
for each fault, or none, because they do not know which compiled kernels a change leaves valid (`asterism._jit`).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from faults import Fault, sample
from which_tests import Program, Recording, Test

TOOLS = Path(__file__).resolve().parent
ROOMS = ("src/asterism/labelling", "src/asterism/reconstruction", "src/asterism/cameras", "src/asterism/formats")
COPIED = ("src", "tests", "benchmarks", "docs", "tools")
NOT_COPIED = shutil.ignore_patterns("__pycache__", ".*", "*.egg-info")
UNCOUNTED = ("no import", "no compile")
"""Outcomes that say nothing about the tests: the module cannot be imported, or Numba cannot compile the kernel."""
INTERNAL_ERROR, USAGE_ERROR, NO_TESTS = 3, 4, 5
"""What pytest ends with."""
HANGS = 240.0
"""s: a test that runs longer, and twenty times as long as recorded, hangs."""


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    status   caught, survived, undecided (time ran out), no import, no compile
    by       the test that failed
    why      the last line of its message
    tests    how many were chosen
    seconds  how long it took
    """

    status: str
    by: str = ""
    why: str = ""
    tests: int = 0
    seconds: float = 0.0


class Copy:
    """A copy of the tree in which tests run, with caches of its own that begin with links to the kept ones."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root, self.folder = root, folder
        self.tree = folder / "tree"
        shutil.rmtree(folder, ignore_errors=True)
        self.tree.mkdir(parents=True)
        for name in COPIED:
            if (root / name).is_dir():
                shutil.copytree(root / name, self.tree / name, ignore=NOT_COPIED)
        for file in root.iterdir():
            if file.is_file() and file.name != ".git":
                shutil.copy2(file, self.tree)
        self.caches = {"NUMBA_CACHE_DIR": folder / "kernels", "ASTERISM_TEST_CACHE": folder / "models"}
        self.link_caches()

    def link_caches(self) -> None:
        """Throw away what a fault compiled and learned, and begin anew with what is kept."""
        for name, place in self.caches.items():
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            kept = Path(os.environ.get(name) or self.folder.parent / "kept" / place.name)
            kept.mkdir(parents=True, exist_ok=True)
            for entry in kept.iterdir():
                if not entry.name.endswith(".lock"):
                    (place / entry.name).symlink_to(entry)

    def environment(self, kept: bool) -> dict[str, str]:
        """What the tests run in; `kept`: with the kept caches, for sources without a fault."""
        places = {"PYTHONPATH": os.pathsep.join([str(self.tree / "src"), str(TOOLS)]), "PYTHONIOENCODING": "utf-8"}
        own = {} if kept else {name: str(place) for name, place in self.caches.items()}
        return {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **os.environ, **places, **own}

    def pytest(self, *options: str, kept: bool = False) -> subprocess.Popen[bytes]:
        """Start pytest in the copy, in a process group of its own."""
        command = [sys.executable, "-m", "pytest", "-q", "-p", "reached", "-p", "no:cacheprovider", *options]
        with (self.folder / "output").open("wb") as output:
            return subprocess.Popen(
                command, cwd=self.tree, env=self.environment(kept), stdout=output, stderr=subprocess.STDOUT, start_new_session=True
            )

    def put(self, path: str, source: bytes) -> None:
        """Write a source, and remove what Python compiled of it: a change within a second can leave time and size the same."""
        file = self.tree / path
        file.write_bytes(source)
        for compiled in (file.parent / "__pycache__").glob(f"{file.stem}.*.pyc"):
            compiled.unlink()


def record(root: Path, work: Path, minutes: float, jobs: int) -> None:
    """Record what the tests of each file reach, so many files at a time; files that did not change since are not run again."""
    folder = work / "reached"
    folder.mkdir(parents=True, exist_ok=True)
    copies: SimpleQueue[Copy] = SimpleQueue()
    for job in range(jobs):
        copies.put(Copy(root, work / f"recording{job}"))
    until = time.monotonic() + 60 * minutes

    def attempt(file: Path) -> bool:
        out = folder / f"{file.stem}.json"
        if out.exists() and out.stat().st_mtime > file.stat().st_mtime:
            return True
        copy = copies.get()
        try:
            began = time.monotonic()
            if began > until:
                return False
            copy.pytest(f"tests/{file.name}", f"--record-reached={out}", kept=True).wait()
            tests = len(json.loads(out.read_text(encoding="utf-8"))["tests"]) if out.exists() else 0
            if not tests:
                out.unlink(missing_ok=True)
            print(f"{file.name}: {tests} tests passed, {time.monotonic() - began:.0f} s", flush=True)
            return True
        finally:
            copies.put(copy)

    with ThreadPoolExecutor(jobs) as pool:
        if not all(list(pool.map(attempt, sorted((root / "tests").glob("test_*.py"), key=lambda file: file.stat().st_size)))):
            print("time is up; run `map` again to go on.")


class Trials:
    """Sampled faults and what became of them, kept in a file after each."""

    def __init__(self, root: Path, path: Path) -> None:
        self.path = path
        self.lock = threading.Lock()
        self.entries: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        done = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=root, capture_output=True, text=True)
        self.commit = done.stdout.strip()

    def add(self, fault: Fault, outcome: Outcome) -> None:
        """Keep a result, the status of the first one, and, while the fault survives, the note on it."""
        with self.lock:
            first = self.entries.get(fault.key, {}).get("first", outcome.status)
            change = {name: value for name, value in asdict(fault).items() if name not in ("begin", "nth")}
            note = self.entries.get(fault.key, {}).get("note", "") if outcome.status == "survived" else ""
            self.entries[fault.key] = {**change, **asdict(outcome), "first": first, "commit": self.commit, "note": note}
            self.save()

    def save(self) -> None:
        """Write the file, whole or not at all."""
        part = self.path.with_suffix(".part")
        part.write_text(json.dumps(self.entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        part.replace(self.path)


def try_fault(copy: Copy, fault: Fault, tests: Sequence[Test], limit: float) -> Outcome:
    """Run tests on the sources with a fault until one fails; `limit` in s."""
    if not tests:
        return Outcome("survived", why="no test reaches it")
    began = time.monotonic()
    clean = (copy.tree / fault.path).read_bytes()
    copy.link_caches()
    copy.put(fault.path, fault.apply(clean))
    try:
        status, by, why = _run_tests(copy, tests, limit)
        if status == "failed" and not by:
            status, by = ("caught", "collection") if _imports(copy, fault.path) else ("no import", "")
    finally:
        copy.put(fault.path, clean)
    if status == "failed":
        compiles = not any(name in why for name in ("TypingError", "LoweringError", "UnsupportedError", "numba.core.errors"))
        status = "no compile" if not compiles else "caught" if _passes(copy, by, limit) else "undecided"
    return Outcome(status, by, why.strip().rpartition("\n")[2][-200:], len(tests), round(time.monotonic() - began, 1))


def _run_tests(copy: Copy, tests: Sequence[Test], limit: float) -> tuple[str, str, str]:
    """survived, failed, caught (hangs or crashed) or undecided; the test; its message."""
    chosen, log = copy.folder / "chosen.json", copy.folder / "log.jsonl"
    chosen.write_text(json.dumps([test.name for test in tests]), encoding="utf-8")
    log.unlink(missing_ok=True)
    process = copy.pytest("-x", f"--chosen-tests={chosen}", f"--log-tests={log}", *dict.fromkeys(test.file for test in tests))
    seconds = {test.name: test.seconds for test in tests}
    until = time.monotonic() + limit
    while process.poll() is None:
        time.sleep(0.2)
        now = _last(log, "began")
        name = now.get("began", "")
        hangs = bool(name) and time.time() - now["at"] > max(HANGS, 20 * seconds.get(name, 0.0))
        if hangs or time.monotonic() > until:
            _end(process)
            return ("caught", name, "hangs") if hangs else ("undecided", "", "time ran out")
    failed = _last(log, "failed")
    if failed:
        return "failed", failed["failed"], failed["why"]
    if process.returncode < 0:
        return "caught", _last(log, "began").get("began", ""), f"ended by signal {-process.returncode}"
    if process.returncode in (NO_TESTS, USAGE_ERROR, INTERNAL_ERROR):
        return "undecided", "", f"pytest ended with {process.returncode}: are the recorded tests still there?"
    return ("survived", "", "") if process.returncode == 0 else ("failed", "", "")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a run and what it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _last(log: Path, what: str) -> dict[str, Any]:
    """The last whole line of a log that tells what began or failed."""
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    found = [line for line in lines if line.startswith(f'{{"{what}"') and line.endswith("}")]
    entry: dict[str, Any] = json.loads(found[-1]) if found else {}
    return entry


def _imports(copy: Copy, path: str) -> bool:
    module = path.removeprefix("src/").removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    return not subprocess.run([sys.executable, "-c", f"import {module}"], env=copy.environment(True), capture_output=True).returncode


def _passes(copy: Copy, name: str, limit: float) -> bool:
    """Whether a test passes by itself on the sources without a fault."""
    chosen = copy.folder / "chosen.json"
    chosen.write_text(json.dumps([name]), encoding="utf-8")
    process = copy.pytest(f"--chosen-tests={chosen}", name.partition("::")[0], kept=True)
    try:
        return process.wait(limit) == 0
    except subprocess.TimeoutExpired:
        _end(process)
        return False


@dataclass(frozen=True)
class RunOptions:
    """What `run` is asked to do; `again`: the statuses of faults that are tried once more."""

    faults: int
    seed: int
    jobs: int
    limit: float
    minutes: float
    rooms: Sequence[str] = ROOMS
    again: Sequence[str] = ()


def run(root: Path, work: Path, results: Path, options: RunOptions) -> None:
    """Try the sampled faults that have no result yet."""
    recording = Recording(work / "reached", Program(root))
    if not recording.tests:
        sys.exit("which tests reach what is not recorded; run `map` first.")
    faults, there = sample(root, options.rooms, options.seed, options.faults)
    trials = Trials(root, results)
    waiting = [fault for fault in faults if fault.key not in trials.entries or trials.entries[fault.key]["status"] in options.again]
    print(f"{there:,} faults are possible; of the {len(faults)} sampled, {len(waiting)} are to be tried.", flush=True)
    copies: SimpleQueue[Copy] = SimpleQueue()
    for job in range(options.jobs):
        copies.put(Copy(root, work / f"copy{job}"))
    until = time.monotonic() + 60 * options.minutes

    def attempt(fault: Fault) -> None:
        copy = copies.get()
        try:
            if time.monotonic() < until:
                trials.add(fault, try_fault(copy, fault, recording.can_notice(fault), options.limit))
                print(_line(fault.key, trials.entries[fault.key]), flush=True)
        finally:
            copies.put(copy)

    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(attempt, waiting))
    print(summary(trials.entries))


def _line(key: str, entry: dict[str, Any]) -> str:
    change = f"{entry['before']} -> {entry['after']}".replace("\n", " ")
    told = entry["note"] or entry["by"] or entry["why"]
    return f"{key} {entry['status']:10} {entry['path']}:{entry['line']} {entry['place']}: {change} [{told}; {entry['seconds']} s]"


def summary(entries: dict[str, dict[str, Any]]) -> str:
    """How many faults have which outcome."""
    counted = Counter(entry["status"] for entry in entries.values())
    counts = sum(count for status, count in counted.items() if status not in UNCOUNTED)
    return f"{counted['caught']} of {counts} caught; " + ", ".join(f"{count} {status}" for status, count in counted.most_common())


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=TOOLS.parent, help="the repository")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "asterism-faults", help="copies and recordings")
    parser.add_argument("--results", type=Path, help="default: benchmarks/faults.json")
    commands = parser.add_subparsers(dest="command", required=True)
    recorder = commands.add_parser("map", help="record which functions each test reaches")
    recorder.add_argument("--jobs", type=int, default=1)
    recorder.add_argument("--minutes", type=float, default=1e6, help="begin no file after so long")
    runner = commands.add_parser("run", help="try faults that have no result yet")
    runner.add_argument("--faults", type=int, default=300)
    runner.add_argument("--seed", type=int, default=0)
    runner.add_argument("--jobs", type=int, default=1)
    runner.add_argument("--limit", type=float, default=600.0, help="seconds for the tests of one fault")
    runner.add_argument("--minutes", type=float, default=1e6, help="begin no fault after so long")
    runner.add_argument("--rooms", nargs="+", default=ROOMS, help="folders or files, from the root")
    runner.add_argument("--again", nargs="+", default=(), metavar="STATUS", help="also those that survived, are undecided, ...")
    commands.add_parser("list", help="print what was not caught")
    judge = commands.add_parser("judge", help="write down why a fault that survived changes nothing")
    judge.add_argument("key")
    judge.add_argument("note")
    return parser.parse_args()


def main() -> None:
    """Do what the command line asks."""
    options = _options()
    root, results = options.root.resolve(), options.results or options.root / "benchmarks" / "faults.json"
    if options.command == "map":
        record(root, options.work, options.minutes, options.jobs)
    elif options.command == "run":
        given = {name: getattr(options, name) for name in ("faults", "seed", "jobs", "limit", "minutes", "rooms", "again")}
        run(root, options.work, results, RunOptions(**given))
    else:
        trials = Trials(root, results)
        if options.command == "judge":
            trials.entries[options.key]["note"] = options.note
            trials.save()
        for key, entry in trials.entries.items():
            if entry["status"] != "caught":
                print(_line(key, entry))
        print(summary(trials.entries))


if __name__ == "__main__":
    main()
