"""People and cameras in; what the cameras of the paper see of them, and how right labels of it are, out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from asterism.recording import Ints
from asterism.simulation.views_laboratory import ViewsSession, simulate_views
from asterism.simulation.views_motion import simulate_motion
from asterism.skeleton import ArticulatedBody, load_body
from asterism.views import ViewsLabelling
from asterism.views.sights import FROM_BOTH_SIDES
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.views.bodies import body_of_others, trials


@dataclass
class Tally:
    """Blobs that show one marker, and what became of them; strays with a label count as wrong, blobs of two markers do not count."""

    right: int = 0
    wrong: int = 0
    shown: int = 0
    by_subject: dict[str, list[int]] = field(default_factory=dict)

    def add(self, labels: Ints, identity: Ints, subject: str = "") -> None:
        """Count one recording."""
        marker = identity >= 0
        right, shown = int(((labels == identity) & marker).sum()), int(marker.sum())
        wrong = int(((labels >= 0) & (labels != identity) & (identity != -2)).sum())
        self.right, self.wrong, self.shown = self.right + right, self.wrong + wrong, self.shown + shown
        own = self.by_subject.setdefault(subject, [0, 0])
        own[0], own[1] = own[0] + right, own[1] + shown

    @property
    def worst(self) -> float:
        """The share right of the subject with the least."""
        return min(right / shown for right, shown in self.by_subject.values() if shown)


@cache
def gait_session(person: str, trial: int, cameras: int, kind: str) -> ViewsSession:
    """One trial of one subject before the paper's cameras; the same blobs in every row."""
    recording = trials()[person][trial]
    markers = body_of_others(person, kind).labels
    return simulate_views(recording, markers, rng=np.random.default_rng([trial, cameras]), cameras=cameras)


def gait_sessions(benchmark: BenchmarkRun, cameras: int = 4, kind: str = "gait15") -> Iterator[tuple[str, ArticulatedBody, ViewsSession]]:
    """Person, body of the other people, and session of each trial; in a quick run of one trial of two subjects."""
    people = list(trials())[: 2 if benchmark.quick else None]
    for person in people:
        for trial in range(1 if benchmark.quick else len(trials()[person])):
            yield person, body_of_others(person, kind), gait_session(person, trial, cameras, kind)


@cache
def motion_session(number: int, cameras: int, frames: int) -> ViewsSession:
    """A simulated person of 26 markers who moves everything, before the paper's cameras."""
    rng = np.random.default_rng([number, 26])
    recording, capsules = simulate_motion(load_body("body26"), frames, rng=rng)
    return simulate_views(recording, recording.labels, rng=rng, cameras=cameras, body=capsules)


def motion_sessions(benchmark: BenchmarkRun, cameras: int = 4) -> Iterator[tuple[str, ArticulatedBody, ViewsSession]]:
    """Simulated people who move everything: twelve of 180 frames, in a quick run one of 20."""
    for number in range(1 if benchmark.quick else 12):
        yield f"S{number}", load_body("body26"), motion_session(number, cameras, 20 if benchmark.quick else 180)


def visibility_agreement(result: ViewsLabelling, session: ViewsSession) -> Ints:
    """(4,) markers and cameras for which it is predicted rightly whether the marker is in view, and all of the frames with the body.

    First by the body alone, then with the labels of the frame before, then with those of the frames before and after.
    """
    there = np.isfinite(result.poses[:, 0])
    truth = session.in_view[there]
    right = [
        int(((told[there] > 0.5) == truth).sum())
        for told in (result.expected, result.predict_visibility(), result.predict_visibility(FROM_BOTH_SIDES))
    ]
    return np.array([*right, truth.size], dtype=np.int64)
