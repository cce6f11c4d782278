"""A person's answers in the log of corrections: cut off, moved away, and saved by a program that is killed."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from asterism import MarkerModel
from asterism.errors import AsterismError
from asterism.formats import write
from asterism.labelling.correction import CorrectionLog, Ghost
from asterism.simulation import simulate_walks
from asterism.web import CorrectionSession, SessionOptions
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure


def logs(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every truncation read and continued; answers that are acknowledged and in no file; saves that are refused after a kill."""
    with TemporaryDirectory() as scratch:
        path = Path(scratch, "log.jsonl")
        _append(path, 5)
        whole = path.read_bytes()
        cuts = [whole[:end] for end in range(0, len(whole) + 1, 50 if benchmark.quick else 1)]
        read = sum(path.write_bytes(cut) >= 0 and _append(path, 2) == max((cut + b"\n").count(b"}\n"), 1) + 1 for cut in cuts)
        yield Figure("truncated logs, read and continued", ">= 1", read / len(cuts), "share", len(cuts))
        lost = 304 - _append(Path(scratch, "moved.jsonl"), 304, moved=True)
        yield Figure("answers acknowledged under a log that is moved or deleted, in no file", "<= 0", lost, "answers", 304)
        model, kills = MarkerModel.fit(simulate_walks(2, frames=60, seed=0)), 3 if benchmark.quick else 100
        write(Path(scratch, "walk.c3d"), simulate_walks(1, frames=60, seed=1)[0])
        sessions = [(kill, CorrectionSession([Path(scratch, "walk.c3d")], model, SessionOptions((), *2 * [Path(scratch, str(kill))])))
                    for kill in range(kills)]  # fmt: skip
        refused = sum(_is_refused(session, 0.0001 * kill) for kill, session in sessions)
        yield Figure("saves refused after a kill within one", "<= 0", refused, "saves", kills)


def _append(path: Path, count: int, moved: bool = False) -> int:
    """Append answers to a log, which is deleted or renamed after two of three; how many it has at the end."""
    log = CorrectionLog(path, "a", "b")
    for number in range(count):
        log.append({"kind": "ghost", "cuts": [], "labels": []})
        if moved and number % 3:
            path.unlink() if number % 3 == 1 else path.rename(f"{path}.{number}")
    log.close()
    log = CorrectionLog(path, "a", "b")
    log.close()
    return len(log.entries)


def _is_refused(session: CorrectionSession, seconds: float) -> bool:
    """Whether a file cannot be saved after a program that answered, and saved again and again, was killed; of POSIX."""
    [trial], child = session.trials, os.fork()
    while not child:
        if trial.state == "waiting":
            trial.label(session.labeller)
        trial.change(trial._correction.revision, lambda correction: correction.apply(Ghost(0)))
        trial.save()
    while not trial.target.exists():
        time.sleep(0.001)
    first = trial.target.stat().st_ino
    # just when another file has the target's name, which is what the log may not say yet
    while trial.target.stat().st_ino == first:
        pass
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    trial.label(session.labeller)
    try:
        trial.save()
    except AsterismError:
        return True
    return False
