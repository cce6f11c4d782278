"""Labels, rigs and points of the code as it is, compared bit for bit with those of the code before the house was put right.

`before.npz` beside this file was written by `python -m benchmarks.house.equality before.npz` with the sources of commit 6cb9ede in
front of the path. Floating point depends on the processor and on the versions of NumPy and SciPy: the file is valid for the machine
that wrote it.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import asterism
from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.reconstruction import reconstruct
from asterism.recording import Blobs, Recording
from asterism.simulation.cameras import ring_rig
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder, gait, people_and_trials
from benchmarks.figures import Figure

BEFORE = Path(__file__).with_name("before.npz")
TESTED = 3
"""How many subjects are labelled by a model of all others."""


def equality(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """How many numbers differ from before, of each kind of output."""
    if not BEFORE.exists():
        raise AsterismError(f"{BEFORE} is missing: write it with the sources of before, as the head of equality.py says.")
    with np.load(BEFORE) as file:
        before = dict(file)
    now = outputs()
    confidences = [name for name in before if name.endswith("confidence")]
    for kind in ("labels frame by frame", "labels of whole recordings", "rigs", "points"):
        names = [name for name in before if name.startswith(kind) and name not in confidences]
        differing = sum(_differing(before[name], now.get(name)) for name in names)
        numbers = sum(before[name].size for name in names)
        yield Figure(f"before and after, numbers that differ: {kind}", "== 0", differing, "numbers", numbers)
    # Kernels add in the order of their source since fast-math is gone, so confidences differ in their last digits.
    largest = max(float(np.abs(before[name] - now[name]).max()) for name in confidences)
    compared = sum(before[name].size for name in confidences)
    yield Figure("before and after, largest difference of a confidence", "none", largest, "fraction", compared)


def outputs() -> dict[str, NDArray[Any]]:
    """Labels and confidences of real walks with gaps and ghosts, rigs from a real board and a simulated wand, points of real blobs."""
    return {f"{kind}, {name}": array for kind, name, array in (*_labels(), *_rigs(), *_points())}


def _differing(before: NDArray[Any], now: NDArray[Any] | None) -> int:
    if now is None or now.shape != before.shape:
        return before.size
    same = (before == now) | ((before != before) & (now != now))
    return int(before.size - np.count_nonzero(same))


def _labels() -> Iterator[tuple[str, str, NDArray[Any]]]:
    trials = gait()
    for tested in list(trials)[:TESTED]:
        people, recordings = people_and_trials(trials, tested)
        mining = inspect.signature(asterism.SolverEnsemble.fit).parameters.get("miner")
        options: dict[str, Any] = {"miner": None} if mining and mining.default is not None else {}
        ensemble = asterism.SolverEnsemble.fit(recordings, seed=0, subjects=people, **options)
        clouds = _with_gaps(trials[tested][0])
        for kind, time in (("labels frame by frame", False), ("labels of whole recordings", True)):
            labelling = ensemble.label(clouds, time=time)
            yield kind, f"{tested}, indices", labelling.indices
            yield kind, f"{tested}, confidence", labelling.confidence


def _with_gaps(recording: Recording) -> Any:
    """Clouds in which three markers are in a gap at every moment and five ghosts pass through, by this file's own arithmetic."""
    rng = np.random.default_rng(7)
    positions = recording.positions.copy()
    frames, markers = positions.shape[:2]
    for start in range(0, frames, 40):
        positions[start : start + 40, rng.choice(markers, 3, replace=False)] = np.nan
    points = []
    middle = np.nanmean(recording.positions, axis=(0, 1))
    ghosts = middle + rng.uniform(-0.5, 0.5, (5, 3))
    for frame in range(frames):
        there = np.concatenate([positions[frame][np.isfinite(positions[frame, :, 0])], ghosts + 0.002 * frame])
        points.append(there[rng.permutation(len(there))])
    return asterism.Clouds.from_points(points, recording.rate, vertical=recording.vertical)


def _rigs() -> Iterator[tuple[str, str, NDArray[Any]]]:
    boards, wand = (_first(f"asterism.{room}.{kind}" for room in ("calibration", "cameras")) for kind in ("boards", "wand"))
    photographs = folder() / "cameras" / "chessboard-stereo"
    board = boards.calibrate_board(boards.find_board(boards.footage_of([photographs]), boards.Board("chessboard", 9, 6, 0.025)))
    yield "rigs", "chessboard-stereo", _numbers_of(board.rig)
    phases = np.arange(300)[:, None] / 20.0 * [0.9, 0.7, 1.3, 1.1, 0.8, 1.7] + [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    directions = np.sin(phases[:, 3:]) + np.array([0.3, 0.0, 0.2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    places = np.sin(phases[:, :3]) * [0.8, 0.8, 0.4] + [0.0, 0.0, 1.0]
    markers = places[:, None] + np.array([-0.3, -0.1, 0.3])[:, None] * directions[:, None]
    blobs = _seen_by(_ring(5), markers, 0.2, rate=20.0)
    yield "rigs", "simulated wand", _numbers_of(wand.calibrate_wand(blobs, [0.0, 0.2, 0.6], sizes=(1280, 1024)).rig)


def _points() -> Iterator[tuple[str, str, NDArray[Any]]]:
    walk = gait()[next(iter(gait()))][0]
    rig = _ring(6)
    centred = walk.positions - np.nanmean(walk.positions, axis=(0, 1)) * [1, 1, 0]
    result = reconstruct(_seen_by(rig, centred[:200], 0.3, walk.rate), rig)
    yield "points", "places", result.clouds.xyz
    yield "points", "covariances", result.covariance
    yield "points", "offsets of frames", result.clouds.offsets


def _ring(cameras: int) -> Rig:
    return ring_rig(cameras, rng=np.random.default_rng(cameras))


def _seen_by(rig: Rig, points: NDArray[np.float64], noise: float, rate: float) -> Blobs:
    """All markers (T, M, 3) m in all images that hold them, with noise in px, by this file's own arithmetic."""
    rng = np.random.default_rng(5)
    rows = []
    for number, camera in enumerate(rig):
        pixels = camera.project(points) + rng.normal(0.0, noise, (*points.shape[:2], 2))
        inside = ((pixels > 0) & (pixels < np.array(camera.size) - 1)).all(axis=2)
        frames, _ = np.nonzero(inside)
        rows.append((frames, np.full(len(frames), number), pixels[inside]))
    frame, seen_by, xy = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Blobs.from_rows(frame, seen_by, xy, rig.names, rate=rate, frames=len(points))


def _first(modules: Iterable[str]) -> Any:
    """The first of some modules that exists: rooms have moved since."""
    return next(import_module(name) for name in modules if find_spec(name.rpartition(".")[0]) and find_spec(name))


def _numbers_of(rig: Rig) -> NDArray[np.float64]:
    return np.concatenate(
        [np.concatenate([np.ravel(c.matrix), np.ravel(c.distortion), np.ravel(c.rotation), np.ravel(c.position)]) for c in rig]
    )


if __name__ == "__main__":
    np.savez_compressed(Path(sys.argv[1]), **outputs())
