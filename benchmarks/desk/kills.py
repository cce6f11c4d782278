"""A program that takes touches, killed at any moment: how many touches that were answered are lost, and whether the labels are the same."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import asterism
from asterism import formats
from asterism.labelling.correction import Correction, CorrectionLog, log_path
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.desk.resolve import as_columns
from benchmarks.figures import Figure

KILLS = 50
TAKES_TOUCHES = """
import sys
from pathlib import Path
from asterism import MarkerModel, formats
from asterism.labelling.correction import Correction, CorrectionLog, Ghost, Name, log_path
file = Path(sys.argv[1])
correction = Correction(MarkerModel.load(sys.argv[2]), formats.read(file))
correction.attach(CorrectionLog(log_path(file), *correction.identity))
pieces, number = [int(piece) for piece in correction.pieces.id], 0
print(len(correction.touches), flush=True)
while True:
    number += 1
    piece = pieces[7 * number % len(pieces)]
    if number % 5 == 0:
        correction.undo()
    elif number % 3 == 0:
        correction.apply(Ghost(piece))
    else:
        correction.apply(Name(piece, correction.names[number % len(correction.names)]))
    print(len(correction.touches), flush=True)
"""
"""Prints how many touches are held, after each answer."""


def kills(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Each run goes on where the one before was killed; the log must hold what was answered, or the one touch more that was on its way."""
    number = 3 if benchmark.quick else KILLS
    train = simulate_walks(subjects=5, frames=120, markers="helen-hayes", seed=3)
    ensemble = benchmark.fit(train[:4], [f"person {n}" for n in range(4)])
    lost = damaged = other = 0
    with tempfile.TemporaryDirectory() as made:
        file, model = Path(made) / "walk.c3d", Path(made) / "gait.model"
        ensemble.save(model)
        formats.write(file, as_columns(simulate_gaps_and_ghosts(train[4], 2, 1, seed=1)[0]))
        rng = np.random.default_rng(0)
        for _ in range(number):
            answered = _killed(file, model, float(rng.uniform(0.0, 0.4)))
            found = _replayed(ensemble, file)
            if found is None:
                damaged += 1
                continue
            lost += abs(found[0] - answered) > 1
            other += not found[1]
    yield Figure("killed while touches are taken: kills that lost a touch that was answered", "<= 0", lost, "kills", number)
    yield Figure("killed while touches are taken: logs that cannot be read", "<= 0", damaged, "logs", number)
    yield Figure("killed while touches are taken: logs that give other labels when read again", "<= 0", other, "logs", number)


def _killed(file: Path, model: Path, seconds: float) -> int:
    """Start the program, let it take touches for so long, kill it: how many touches it held when it last answered."""
    command = [sys.executable, "-c", TAKES_TOUCHES, str(file), str(model)]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    answered = [run.stdout.readline()]
    time.sleep(seconds)
    os.kill(run.pid, signal.SIGKILL)
    answered += [line for line in run.stdout.read().splitlines(keepends=True) if line.endswith("\n")]
    run.wait()
    run.stdout.close()
    return int(answered[-1])


def _replayed(ensemble: asterism.MarkerModel, file: Path) -> tuple[int, bool] | None:
    """How many touches the log holds, and whether taking them one by one gives the same labels; None where it cannot be read."""
    recording = formats.read(file)
    correction, again = Correction(ensemble, recording), Correction(ensemble, recording)
    try:
        correction.attach(CorrectionLog(log_path(file), *correction.identity))
    except asterism.AsterismError:
        return None
    for touch in correction.touches:
        again.touch(touch)
    same = np.array_equal(correction.labelling.indices, again.labelling.indices)
    correction.close()
    return len(correction.touches), same and np.array_equal(correction.labelling.confidence, again.labelling.confidence)
