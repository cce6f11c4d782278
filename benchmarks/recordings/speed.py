"""Frames per second of whole recordings on one core, everything included, and of the peers on the same clouds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from asterism.recording import Clouds
from benchmarks.benchmark_run import BenchmarkRun, frames_per_second
from benchmarks.data import GAIT_BODY, spread
from benchmarks.figures import Figure
from benchmarks.peer import KeyPoses
from benchmarks.recordings.baselines import POSES, POSES_FRAMES, TRACKING
from benchmarks.recordings.gaps import FRAMEWISE, WHOLE
from benchmarks.recordings.walks import CONDITIONS, unseen_ensemble, unseen_training, walks, with_gaps
from benchmarks.score import some_frames
from benchmarks.tracking import follow

SUBJECT = "HC031"
"""Who is left out: one of those that the row `full-body` leaves out too."""


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """One subject's walks, each labelled by a call of its own: 15 markers, then all of them."""
    ensemble, poses = unseen_ensemble(benchmark, SUBJECT), KeyPoses.fit(unseen_training(benchmark, SUBJECT)[1])
    first = [walk.positions[0] for walk in walks(SUBJECT)]
    for condition in ("3 hidden", "3 hidden + 3 ghosts"):
        pairs = list(with_gaps(benchmark, SUBJECT, *CONDITIONS[condition], seeds=1))
        clouds = [cloud for cloud, _ in pairs]
        few = [some_frames(cloud, truth, spread(len(cloud), POSES_FRAMES))[0] for cloud, truth in pairs]
        row = f"speed, 15 markers, {condition}"
        yield _rate(f"{row}, {WHOLE}", "> 5000", lambda cloud: ensemble.label(cloud), clouds)
        yield _rate(f"{row}, {FRAMEWISE}", "none", ensemble.label, clouds)
        places = dict(zip(map(id, clouds), first, strict=True))
        yield _rate(f"{row}, {TRACKING}", "none", lambda cloud, at=places: follow(at[id(cloud)], cloud, poses.names), clouds)
        yield _rate(f"{row}, {POSES}", "none", poses.label, few)
    if not benchmark.quick:
        body = unseen_ensemble(benchmark, SUBJECT, GAIT_BODY)
        clouds = [cloud for cloud, _ in with_gaps(benchmark, SUBJECT, 3, 0, GAIT_BODY, seeds=1)]
        row = f"speed, {len(GAIT_BODY)} markers, 3 hidden"
        yield _rate(f"{row}, {WHOLE}", "> 1000", lambda cloud: body.label(cloud), clouds)
        yield _rate(f"{row}, {FRAMEWISE}", "none", body.label, clouds)


def _rate(row: str, asked: str, label: Callable[[Clouds], object], clouds: Sequence[Clouds]) -> Figure:
    frames = sum(map(len, clouds))
    rate = frames_per_second(lambda: [label(cloud) for cloud in clouds], frames, repeats=3)
    return Figure(f"{row}, one core", asked, rate, "frames/s", frames)
