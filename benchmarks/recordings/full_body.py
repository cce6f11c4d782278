"""All physical markers of the gait subjects, two subjects left out in turn: what the row `gaps` measures with 15 markers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure
from benchmarks.recordings.contradictions import believable
from benchmarks.recordings.gaps import FRAMEWISE, WHOLE, Tallies, summed
from benchmarks.recordings.walks import unseen_ensemble, walks, with_gaps
from benchmarks.score import Tally

CONSISTENT = f"{WHOLE}, without parts whose hand labels contradict the standing trial or the body"
"""See `contradictions`: what the labels are compared with is wrong itself there."""
CONDITIONS = {"3 hidden": (3, 0), "3 hidden + 3 ghosts": (3, 3)}
ASKED = {("3 hidden", "right"): ">= 0.999", ("3 hidden", "FA"): "<= 0.0005"}


def full_body(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right, FA and missed; every subject by name. Not all subjects: learning one such model takes minutes."""
    subjects = full_body_subjects()[: 1 if benchmark.quick else None]
    outcomes = dict(zip(subjects, benchmark.each(_left_out, subjects), strict=True))
    for (condition, method), tally in summed(list(outcomes.values())).items():
        for rate, measured in (("right", tally.right_share), ("FA", tally.false_assignments), ("missed", tally.missed_share)):
            asked = ASKED.get((condition, rate), "none") if method == WHOLE else "none"
            yield tally.figure(f"{len(GAIT_BODY)} markers, {condition}, {method}: {rate}", asked, measured)
    for subject, outcome in outcomes.items():
        tally = outcome["3 hidden", WHOLE]
        row = f"{len(GAIT_BODY)} markers, subject {subject} not seen, 3 hidden"
        yield tally.figure(f"{row}: right", "none", tally.right_share)
        yield tally.figure(f"{row}: FA", "none", tally.false_assignments)


def full_body_subjects() -> list[str]:
    """Those who are left out of models of all markers, for every row that needs one: such a model takes minutes."""
    return list(gait())[3:7:3]


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    ensemble, tallies = unseen_ensemble(benchmark, subject, GAIT_BODY), defaultdict(Tally)
    for condition, (hidden, ghosts) in CONDITIONS.items():
        trials = with_gaps(benchmark, subject, hidden, ghosts, GAIT_BODY, seeds=1)
        for walk, (clouds, truth) in zip(walks(subject, GAIT_BODY), trials, strict=True):
            labelling = ensemble.label(clouds)
            tallies[condition, WHOLE].add(labelling, truth)
            tallies[condition, CONSISTENT].add(*believable(labelling, truth, walk))
            tallies[condition, FRAMEWISE].add(ensemble.label_frames(clouds), truth)
    told = (f"{c}, {m} {t.right_share:.5f}, FA {t.false_assignments:.5f}" for (c, m), t in tallies.items())
    benchmark.report(f"{subject} left out: {'; '.join(told)}")
    return dict(tallies)
