"""All key figures of one commit on one machine, into docs/figures/VERSION.json.

Two scripts run at a time, each in a process of its own. What is done is kept in a folder of the commit, which git ignores: a run that was
stopped goes on. A script that fails costs its own rows.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.data import has_recordings
from benchmarks.key import KEY, Group

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "docs" / "figures"
KEPT = ROOT / ".release"


class Refused(Exception):
    """A release that cannot begin, or whose commit has changed: the sentence says what to do."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is not yet measured of this commit. Returns 0; 1 where a script failed; 2 where nothing could be measured."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks release", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few frames, from a tree that may be dirty; nothing is written into docs")
    parser.add_argument("--only", nargs="+", metavar="SCRIPT", help='some of them, such as "recordings gaps"; nothing is written into docs')
    given = parser.parse_args(arguments)
    strangers = set(given.only or ()) - {group.script for group in KEY}
    if strangers:
        parser.error(f"no key figure comes from {sorted(strangers)[0]!r}; choose from {', '.join(group.script for group in KEY)}")
    partial = given.quick or bool(given.only)
    try:
        commit = commit_of(ROOT, dirty_is_refused=not given.quick)
        kept = KEPT / (f"{commit}-quick" if given.quick else commit)
        failed = measure([group for group in KEY if not given.only or group.script in given.only], kept, given.quick)
        if not given.quick and commit_of(ROOT, dirty_is_refused=True) != commit:
            raise Refused("the commit has changed while its figures were measured; check out the first one and run this again")
    except Refused as problem:
        print(f"{problem}.", file=sys.stderr)
        return 2
    for name, problem in failed.items():
        print(f"FAILED {name}: {problem}", file=sys.stderr)
    if not partial:
        path = FIGURES / f"{version()}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(release_of(commit, kept, failed), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"written: {path.relative_to(ROOT)}")
    return int(bool(failed))


def version() -> str:
    """The version in pyproject.toml: the tree's own, whatever is installed."""
    match = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert match
    return match[1]


def commit_of(root: Path, *, dirty_is_refused: bool) -> str:
    """The commit of a tree. Raises Refused where the tree differs from it, figures of releases apart, or is none of git's."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Refused(f"git {words[0]} failed in {root}: {done.stderr.strip()}; a release needs a clone with git")
        return done.stdout

    changed = [line for line in git("status", "--porcelain").splitlines() if not line[3:].startswith("docs/figures/")]
    if changed and dirty_is_refused:
        raise Refused(
            f"{len(changed)} files differ from the commit ({changed[0][3:]}); commit or stash them, so that figures have a commit"
        )
    return git("rev-parse", "HEAD").strip()


def measure(groups: Sequence[Group], kept: Path, quick: bool, workers: int = 2) -> dict[str, str]:
    """Run the scripts that have no result yet, timed ones alone, the others two at a time; the problem of each that failed."""
    kept.mkdir(parents=True, exist_ok=True)
    waiting = sorted((group for group in groups if not _result(kept, group).exists()), key=lambda group: -group.minutes)
    for group in groups:
        if group not in waiting:
            print(f"{group.script}: measured before", file=sys.stderr, flush=True)
    failed: dict[str, str] = {}
    for count, some in ((1, [g for g in waiting if g.alone]), (workers, [g for g in waiting if not g.alone])):
        with ThreadPoolExecutor(count) as pool:
            for group, problem in zip(some, pool.map(lambda group: _run(group, kept, quick), some), strict=True):
                if problem:
                    failed[group.script] = problem
    return failed


def _result(kept: Path, group: Group) -> Path:
    return kept / f"{group.script.replace(' ', '-')}.json"


def _run(group: Group, kept: Path, quick: bool) -> str:
    """One script in a process of its own; its key figures are kept once it has given all of them. Returns what went wrong, or nothing."""
    path = _result(kept, group)
    unfinished = path.with_suffix(".part")
    words = [sys.executable, "-m", "benchmarks", *group.script.split(), "--jobs", "1", "--models", str(kept / "models")]
    words += ["--json", str(unfinished), *(["--quick"] if quick else [])]
    started = time.perf_counter()
    with path.with_suffix(".log").open("w", encoding="utf-8") as log:
        status = subprocess.run(words, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, check=False).returncode
    seconds = time.perf_counter() - started
    told = path.with_suffix(".log").read_text(encoding="utf-8", errors="replace").strip().splitlines()
    problem = f"exit status {status}; {path.with_suffix('.log')} ends with: {' | '.join(told[-3:])[-300:]}" if status else ""
    if not problem:
        entries = {entry["row"]: entry for entry in json.loads(unfinished.read_text(encoding="utf-8"))}
        absent = [row for row in group.rows if row not in entries]
        if absent and not quick:
            problem = f"it gave no row {absent[0]!r}"
        else:
            rows = [entries[row] for row in group.rows if row in entries]
            unfinished.write_text(json.dumps({"seconds": round(seconds, 1), "rows": rows}), encoding="utf-8")
            os.replace(unfinished, path)
    print(f"{group.script}: {'FAILED' if problem else 'measured'}, {seconds:.0f} s", file=sys.stderr, flush=True)
    return problem


def release_of(commit: str, kept: Path, failed: dict[str, str]) -> dict[str, Any]:
    """What a release's file says: version, commit, date, machine, rows in the order of `KEY`, and the scripts that failed."""
    return {
        "version": version(),
        "commit": commit,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
        "recordings": "real" if has_recordings() else "simulated",
        "rows": list(_rows(kept)),
        "failed": failed,
    }


def _rows(kept: Path) -> Iterator[dict[str, Any]]:
    for group in KEY:
        if _result(kept, group).exists():
            yield from json.loads(_result(kept, group).read_text(encoding="utf-8"))["rows"]


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    cpu, info = platform.processor(), Path("/proc/cpuinfo")
    if info.exists():
        names = re.findall(r"^model name\s*: (.+)$", info.read_text(encoding="utf-8"), re.MULTILINE)
        cpu = names[0] if names else cpu
    return {"cores": os.cpu_count(), "processor": cpu, "system": platform.system(), "python": platform.python_version()}
