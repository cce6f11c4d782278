"""Recordings turned under a declaration that stays, and pairs of walkers without one: which vertical is believed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from asterism.formats import read, write
from asterism.geometry import z_up_rotation
from asterism.recording import Recording, as_vertical
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure


def vertical(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Real recordings that declare z, turned four ways, and pairs of real walkers side by side, all written and read as C3D."""
    paths = [path for part in ("cameras", "gait", "gait-events", "movement") for path in sorted((folder() / part).rglob("*.c3d"))]
    files = [whole for whole in map(read, paths) if whole.source.parameters.text("POINT", "Y_SCREEN").endswith("Z")]
    files, silent, wrong = files[:: 20 if benchmark.quick else 1], 0, 0
    for whole in files:
        ups = [as_vertical(up) for up in ("y", "-y", "x", "-x")]
        told = [_read_again(Recording(whole.positions @ z_up_rotation(up), whole.labels, whole.rate)) for up in ups]
        right = [again.vertical @ up > 0.99 for again, up in zip(told, ups, strict=True)]
        said = ["format-vertical-conflict" in {finding.code for finding in again.warnings} for again in told]
        silent += sum(not one and not other for one, other in zip(right, said, strict=True))
        wrong += not all(one or other for one, other in zip(right, said, strict=True))
    yield Figure("turned under a declared z: recordings right or said, all four ways", ">= 74", len(files) - wrong, "files", len(files))
    yield Figure("turned under a declared z: readings wrong and silent", "== 0", silent, "readings", 4 * len(files))
    walks = [read(path).positions[:170] for path in paths if path.name == "straight.c3d"]
    pairs = [
        (one, np.add(other, [gap, 0.0, 0.0])) for one, other in zip(walks, walks[1:10] + walks[:1], strict=False) for gap in (0.6, 1.2, 2.0)
    ]
    merged = [np.concatenate(pair, axis=1) for pair in pairs]
    read_as = [_read_again(Recording(both, ("*",) * both.shape[1], 100.0), declared=False) for both in merged]
    yield Figure("pairs of walkers, undeclared: z", ">= 30", sum(float(again.vertical[2]) for again in read_as), "files", len(pairs))


def _read_again(recording: Recording, declared: bool = True) -> Recording:
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "turned.c3d"
        write(path, recording)
        path.write_bytes(path.read_bytes() if declared else path.read_bytes().replace(b"_SCREEN", b"_NOWHER").replace(b"VERTIC", b"NOWHER"))
        return read(path)
