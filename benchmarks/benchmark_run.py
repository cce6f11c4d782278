"""What the scripts share: how much to measure, trained models, processes, timing."""

from __future__ import annotations

import hashlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import TypeVar

import asterism
from asterism.recording import Recording
from asterism.session import each_of

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass
class BenchmarkRun:
    """One run: `quick` takes few frames and folds, to see that a script runs.

    models   a folder that keeps trained models for the processes of this run, or None. Whoever names one that outlives the code empties it.
    jobs     processes that share the folds of a row; rows that measure time run in one
    dask     in place of these, a cluster as `asterism process --dask` takes it, whose machines see the folder of the models
    """

    quick: bool = False
    models: Path | None = None
    jobs: int = 1
    dask: str | None = None
    trained: dict[str, asterism.MarkerModel] = field(default_factory=dict)

    def report(self, text: str) -> None:
        """Print what is being done, to standard error."""
        print(f"  {text}", file=sys.stderr, flush=True)

    def each(self, work: Callable[[BenchmarkRun, Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """The results of a function over items, in their order; with several jobs both must be picklable."""
        if (self.jobs == 1 and self.dask is None) or len(items) == 1:
            yield from (work(self, item) for item in items)
            return
        alone = replace(self, jobs=1, dask=None, trained={})
        kept = self.models or Path(tempfile.gettempdir())
        kept.mkdir(parents=True, exist_ok=True)
        with each_of(kept, workers=self.jobs, dask=self.dask) as each:
            yield from each(partial(work, alone), items)

    def fit(self, recordings: Sequence[Recording], people: Sequence[str], **options: object) -> asterism.MarkerModel:
        """Train a model, or take the one that this run has trained from the same recordings."""
        key = _key(recordings, people, options)
        kept = self.models / f"{key}.model" if self.models else None
        if key not in self.trained and kept and kept.exists():
            self.trained[key] = asterism.MarkerModel.load(kept)
        if key not in self.trained:
            started = time.perf_counter()
            self.trained[key] = asterism.MarkerModel.fit(list(recordings), seed=0, subjects=list(people), miner=None, **options)
            self.report(
                f"trained on {len(recordings)} recordings, {len(recordings[0].labels)} markers: {time.perf_counter() - started:.1f} s"
            )
            if kept:
                kept.parent.mkdir(parents=True, exist_ok=True)
                self.trained[key].save(kept)
        return self.trained[key]


def frames_per_second(run: Callable[[], object], frames: int, repeats: int = 5) -> float:
    """Frames per second of a call that works on so many frames: warmed by one call, then the median of several."""
    run()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return frames / median(times)


def _key(recordings: Sequence[Recording], people: Sequence[str], options: dict[str, object]) -> str:
    digest = hashlib.sha256(repr((list(people), sorted(options.items()), recordings[0].labels)).encode())
    for recording in recordings:
        digest.update(recording.positions.tobytes())
    return digest.hexdigest()[:24]
