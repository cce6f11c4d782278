"""The peer on the very clouds of the script `gaps`: key poses, frame by frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait, spread
from benchmarks.figures import Figure
from benchmarks.peer import KeyPoses
from benchmarks.recordings.gaps import Tallies, rates, summed
from benchmarks.recordings.walks import CONDITIONS, unseen_training, walk_of_draw, with_gaps
from benchmarks.score import Tally, some_frames

POSES = "key poses"
POSES_FRAMES = 8
"""Frames of each cloud that the slow peer gets, evenly spread; each frame stands alone for it."""


def baselines(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right, wrong and missed of the peer by condition."""
    subjects = list(gait())[: 1 if benchmark.quick else None]
    for (condition, method), tally in summed(benchmark.each(_left_out, subjects)).items():
        yield from rates(condition, method, tally, asked=False)


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    tallies: Tallies = defaultdict(Tally)
    poses = KeyPoses.fit(unseen_training(benchmark, subject)[1])
    for condition, (hidden, ghosts) in CONDITIONS.items():
        for number, (clouds, truth) in enumerate(with_gaps(benchmark, subject, hidden, ghosts)):
            walk = walk_of_draw(benchmark, subject, number)
            few, few_truth = some_frames(clouds, truth, spread(len(truth), POSES_FRAMES))
            tallies[condition, POSES].add(poses.label(few), few_truth, recording=walk)
    benchmark.report(f"{subject} left out: {'; '.join(f'{c}, {m} {tally.right_share:.4f}' for (c, m), tally in tallies.items())}")
    return dict(tallies)
