"""Live labelling in flicker: what it costs against clean clouds with as many markers hidden, and how long the worst push takes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from asterism.recording import Floats
from asterism.simulation import Clutter
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.dirt.walks import Condition, ensemble_of, reporting, samples
from benchmarks.figures import Figure
from benchmarks.recordings.stream import pushed
from benchmarks.score import Tally

CLEAN = "clean"
CONDITIONS = {
    f"{hidden} hidden": {
        CLEAN: Condition(hidden),
        "3 flickering, 80 mm": Condition(hidden, clutter=Clutter(3.0, 1, "beside", 0.08)),
        "3 flickering, 30 mm": Condition(hidden, clutter=Clutter(3.0, 1, "beside", 0.03)),
        "10 flickering, 80 mm": Condition(hidden, clutter=Clutter(10.0, 1, "beside", 0.08)),
    }
    for hidden in (0, 3)
}
DELAYS = (0, 10)
"""Frames, at 100 Hz."""


def stream(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The subjects reported on, 15 markers. Times need a quiet machine."""
    for hidden, conditions in CONDITIONS.items():
        for delay in DELAYS:
            tallies: dict[str, Tally] = defaultdict(Tally)
            spent: dict[str, list[Floats]] = defaultdict(list)
            for subject in reporting()[: 1 if benchmark.quick else None]:
                ensemble = ensemble_of(benchmark, subject)
                for name, condition in conditions.items():
                    for one in samples(subject, condition, 1):
                        labelling, times = pushed(ensemble, one.clouds, delay)
                        tallies[name].add(labelling, one.truth)
                        spent[name].append(times)
            for name, tally in tallies.items():
                row = f"stream in clutter, {hidden}, delay {delay}, {name}"
                yield tally.figure(f"{row}: right", "none", tally.right_share)
                yield tally.figure(f"{row}: wrong", "none", tally.false_assignments)
                if name != CLEAN:
                    lost = tallies[CLEAN].right_share - tally.right_share
                    yield tally.figure(f"{row}: right lost against clean", "<= 0.005", lost)
                slowest = float(np.quantile(np.concatenate(spent[name]), 0.999))
                yield Figure(f"{row}: p99.9 of a push", "< 10", slowest, "ms", tally.frames)
