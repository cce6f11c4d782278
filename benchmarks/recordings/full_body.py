"""All physical markers of the gait subjects, two subjects left out in turn: what the script `gaps` measures with 15 markers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure
from benchmarks.recordings.contradictions import believable
from benchmarks.recordings.gaps import WHOLE, Tallies, summed
from benchmarks.recordings.walks import unseen_ensemble, walks, with_gaps
from benchmarks.score import Tally

CONSISTENT = f"{WHOLE}, without parts whose hand labels contradict the standing trial or the body"
"""See `contradictions`: what the labels are compared with is wrong itself there."""
CONDITIONS = {"3 hidden": (3, 0), "3 hidden + 3 ghosts": (3, 3)}
ASKED = {("3 hidden", "right"): ">= 0.999", ("3 hidden", "wrong"): "<= 0.0005"}


def full_body(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right, wrong and missed. Not all subjects: learning one such model takes a minute."""
    subjects = full_body_subjects()[: 1 if benchmark.quick else None]
    for (condition, method), tally in summed(benchmark.each(_left_out, subjects)).items():
        for rate, measured in (("right", tally.right_share), ("wrong", tally.false_assignments), ("missed", tally.missed_share)):
            yield tally.figure(f"{len(GAIT_BODY)} markers, {condition}, {method}: {rate}", ASKED.get((condition, rate), "none"), measured)


def full_body_subjects() -> list[str]:
    """Those who are left out of models of all markers, for every script that needs one."""
    return list(gait())[3:7:3]


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    ensemble, tallies = unseen_ensemble(benchmark, subject, GAIT_BODY), defaultdict(Tally)
    for condition, (hidden, ghosts) in CONDITIONS.items():
        trials = with_gaps(benchmark, subject, hidden, ghosts, GAIT_BODY, seeds=1)
        for walk, (clouds, truth) in zip(walks(subject, GAIT_BODY), trials, strict=True):
            labelling = ensemble.label(clouds)
            tallies[condition, WHOLE].add(labelling, truth)
            tallies[condition, CONSISTENT].add(*believable(labelling, truth, walk))
    told = (f"{c}, {m} {t.right_share:.5f}, wrong {t.false_assignments:.5f}" for (c, m), t in tallies.items())
    benchmark.report(f"{subject} left out: {'; '.join(told)}")
    return dict(tallies)
