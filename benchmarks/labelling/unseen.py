"""Subjects that training has not seen: each of the gait subjects in turn, frame by frame, beside the peer on the same clouds."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

from asterism.labelling.simulated_occlusions import simulate_occlusions
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import evenly, gait, people_and_trials, spread
from benchmarks.figures import Figure
from benchmarks.peer import KeyPoses
from benchmarks.score import Tally, some_frames

CONDITIONS = {
    (0, 0): "0 occlusions",
    (2, 0): "2 occlusions",
    (4, 0): "4 occlusions",
    (5, 0): "5 occlusions",
    (3, 3): "3 occlusions + 3 ghosts",
}
ASKED = {
    ("0 occlusions", "right"): ">= 0.9999",
    ("0 occlusions", "FA"): "<= 0.0001",
    ("2 occlusions", "FA"): "<= 0.001",
    ("4 occlusions", "FA"): "<= 0.002",
    ("5 occlusions", "FA"): "<= 0.005",
    ("2 occlusions", "missed"): "<= 0.005",
    ("4 occlusions", "missed"): "<= 0.01",
    ("5 occlusions", "missed"): "<= 0.02",
    ("3 occlusions + 3 ghosts", "right"): ">= 0.95",
    ("3 occlusions + 3 ghosts", "FA"): "<= 0.01",
}
PEER_FRAMES = 24
"""Frames of each recording that the slow peer gets, evenly spread."""


@dataclass
class Outcome:
    """What came of one subject left out, by condition; the peer's seconds over all its frames."""

    ours: dict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    peers: dict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    peer_seconds: float = 0.0


def unseen(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Leave one subject out over all of them: ours, the peer, the confidence's error, and every subject by name."""
    subjects = list(gait())[: 1 if benchmark.quick else None]
    outcomes = dict(zip(subjects, benchmark.each(_left_out, subjects), strict=True))
    pooled = Tally()
    for name in CONDITIONS.values():
        total, peers = Tally(), Tally()
        for outcome in outcomes.values():
            total += outcome.ours[name]
            peers += outcome.peers[name]
        pooled += total
        yield from _rates(f"subjects not seen, {name}", total, name, asked=True)
        yield from _rates(f"peer, subjects not seen, {name}", peers, name, asked=False)
        yield total.figure(f"subjects not seen, {name}: frames perfect", "none", total.perfect_share)
        yield Figure(f"subjects not seen, {name}: calibration error", "none", total.calibration_error, "fraction", total.given)
    yield Figure("subjects not seen, all conditions: calibration error", "<= 0.01", pooled.calibration_error, "fraction", pooled.given)
    labelled = sum(tally.frames for outcome in outcomes.values() for tally in outcome.peers.values())
    seconds = sum(outcome.peer_seconds for outcome in outcomes.values())
    yield Figure("peer, subjects not seen: speed", "none", labelled / seconds, "frames/s", labelled)
    for subject, outcome in outcomes.items():
        for name, tally in outcome.ours.items():
            yield tally.figure(f"subject {subject} not seen, {name}: FA", "none", tally.false_assignments)
            yield tally.figure(f"subject {subject} not seen, {name}: missed", "none", tally.missed_share)


def _left_out(benchmark: BenchmarkRun, subject: str) -> Outcome:
    trials = gait()
    people, train = people_and_trials(trials, leave_out=subject)
    if benchmark.quick:
        train = [evenly(recording, 40) for recording in train]
    ensemble, peer, outcome = benchmark.fit(train, people), KeyPoses.fit(train), Outcome()
    for (hidden, ghosts), name in CONDITIONS.items():
        for number, recording in enumerate(trials[subject]):
            clouds, truth = simulate_occlusions(recording, hidden, ghosts, seed=number)
            outcome.ours[name].add(ensemble.label(clouds), truth)
            few, few_truth = some_frames(clouds, truth, spread(len(truth), PEER_FRAMES))
            started = time.perf_counter()
            labelling = peer.label(few)
            outcome.peer_seconds += time.perf_counter() - started
            outcome.peers[name].add(labelling, few_truth)
    told = (f"{name} FA {tally.false_assignments:.5f} missed {tally.missed_share:.5f}" for name, tally in outcome.ours.items())
    benchmark.report(f"{subject} left out: {', '.join(told)}")
    outcome.ours, outcome.peers = dict(outcome.ours), dict(outcome.peers)
    return outcome


def _rates(row: str, tally: Tally, condition: str, asked: bool) -> Iterator[Figure]:
    for rate, measured in (("right", tally.right_share), ("FA", tally.false_assignments), ("missed", tally.missed_share)):
        yield tally.figure(f"{row}: {rate}", ASKED.get((condition, rate), "none") if asked else "none", measured)
