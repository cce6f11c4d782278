"""Frames per second of whole recordings on one core, everything included, beside the machine's speed at a fixed piece of work."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from asterism.recording import Clouds
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from benchmarks.benchmark_run import BenchmarkRun, frames_per_second
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure
from benchmarks.recordings.gaps import WHOLE
from benchmarks.recordings.walks import Condition, samples, unseen_model
from benchmarks.reference import reference


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """One subject's walks, each labelled by a call of its own: 15 markers, simulated walks of 39, then 59. The median of five."""
    yield from reference(benchmark)
    subject = list(gait())[3]
    ensemble = unseen_model(benchmark, subject)
    for condition, ghosts in (("3 hidden", 0), ("3 hidden + 3 ghosts", 3)):
        clouds = [one.clouds for one in samples(benchmark, subject, Condition(3, ghosts), seeds=1)]
        yield _rate(f"speed, 15 markers, {condition}, {WHOLE}", "> 5000", lambda cloud: ensemble.label(cloud), clouds)
    if benchmark.quick:
        return
    own, *others = simulate_walks(7, 600, markers="plug-in-gait", seed=5)
    plug_in = benchmark.fit(others, [str(n) for n in range(len(others))])
    clouds = [simulate_gaps_and_ghosts(own, 3, 0, seed=1)[0]]
    yield _rate(f"speed, 39 markers, 3 hidden, {WHOLE}", "> 2000", lambda cloud: plug_in.label(cloud), clouds)
    body = unseen_model(benchmark, subject, GAIT_BODY)
    clouds = [one.clouds for one in samples(benchmark, subject, Condition(3), GAIT_BODY, seeds=1)]
    yield _rate(f"speed, {len(GAIT_BODY)} markers, 3 hidden, {WHOLE}", "> 1000", lambda cloud: body.label(cloud), clouds)


def _rate(row: str, asked: str, label: Callable[[Clouds], object], clouds: Sequence[Clouds]) -> Figure:
    frames = sum(map(len, clouds))
    return Figure(f"{row}, one core", asked, frames_per_second(lambda: [label(cloud) for cloud in clouds], frames), "frames/s", frames)
