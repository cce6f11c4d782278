"""The whole chain on simulated sessions: wand, rig, points, labels, as `asterism demo cameras` runs it, over several seeds."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from asterism.cameras.accuracy import covariance
from asterism.labelling import MarkerModel
from asterism.recording import Floats
from asterism.simulation import simulate_walks
from asterism.simulation.pipeline import PipelineResult, run_pipeline
from asterism.simulation.session import NOISE, Session, simulate_session
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

WALKERS, FRAMES = 9, 300
MARKERS = "plug-in-gait"
SEEDS = 5


def _best_possible(session: Session) -> Floats:
    """Errors (m) of composing with the true rig and known identities: drawn from the covariance of each marker that two see."""
    blobs, alone = session.blobs, session.identity >= 0
    shown = np.zeros((len(session.rig), *session.seen.shape), dtype=bool)
    shown[blobs.camera_of[alone], blobs.frame_of[alone], session.identity[alone]] = True
    wanted = (session.seen >= 2).ravel()
    places = session.walk.positions.reshape(-1, 3)[wanted]
    spread = covariance(session.rig, places, NOISE, shown.reshape(len(session.rig), -1)[:, wanted])
    spread = spread[np.isfinite(spread[:, 0, 0])]
    draws = np.linalg.cholesky(spread) @ np.random.default_rng(0).normal(size=(len(spread), 3, 10))
    errors: Floats = np.linalg.norm(draws, axis=1).ravel()
    return errors


def demo(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """A rig and a walker of its own for each seed; 39 markers, whose model has not seen the walker."""
    results: list[PipelineResult] = []
    possible: list[Floats] = []
    seconds: list[float] = []
    for seed in range(1 if benchmark.quick else SEEDS):
        walks = simulate_walks(subjects=WALKERS, frames=FRAMES, rate=100.0, markers=MARKERS, seed=seed)
        ensemble: MarkerModel = benchmark.fit(walks[:-1], [str(walk.metadata["subject"]) for walk in walks[:-1]])
        session = simulate_session(walks[-1], seed)
        started = time.perf_counter()
        results.append(run_pipeline(session, ensemble))
        seconds.append(time.perf_counter() - started)
        possible.append(_best_possible(session))
    wanted = sum(int(result.points.wanted.sum()) for result in results)
    error = np.concatenate([result.points.error[result.points.wanted] for result in results])
    points = sum(result.points.points for result in results)
    right, wrong = sum(result.right for result in results), sum(result.wrong for result in results)
    found = right + sum(result.unlabelled for result in results)
    row = f"simulated session, 8 cameras, {NOISE} px, body, strays"
    for millimetres in (1, 2, 3):
        share = float((error <= 0.001 * millimetres).mean())
        yield Figure(f"{row}: markers seen by two cameras, found within {millimetres} mm", "none", share, "fraction", wanted)
    best = np.concatenate(possible)
    share = float((best <= 0.001).mean())
    yield Figure(f"{row}: within 1 mm, by the true rig and the blobs' noise alone", "none", share, "fraction", len(best))
    yield Figure(f"{row}: distance from the truth, median", "none", 1000 * float(np.nanmedian(error)), "mm", wanted)
    yield Figure(
        f"{row}: ghosts per 1,000 points", "none", 1000 * sum(result.points.ghosts for result in results) / points, "points", points
    )
    yield Figure(f"{row}: markers found that are labelled right", "none", right / found, "fraction", found)
    yield Figure(f"{row}: labels that are wrong", "none", wrong / max(right + wrong, 1), "fraction", right + wrong)
    focal = max(float(result.rig_errors.focal.max()) for result in results)
    yield Figure(f"{row}: focal length, largest error", "none", 100 * focal, "%", 8 * len(results))
    yield Figure(f"{row}: from blobs to labels", "none", float(np.median(seconds)), "s", len(results))
