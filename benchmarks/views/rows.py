"""Gait and whole body before two to four cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from asterism.recording import Ints
from asterism.simulation.views_laboratory import ViewsSession
from asterism.skeleton import ArticulatedBody
from asterism.views import ViewsRules, label_views
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.views.sessions import (
    Tally,
    gait_sessions,
    motion_sessions,
    visibility_agreement,
)

Sessions = Iterable[tuple[str, ArticulatedBody, ViewsSession]]


@dataclass
class Labelled:
    """What became of whole recordings.

    tally    of all blobs
    single   (error, stated deviation) in m of each marker that one camera shows
    visible  (4,) markers and cameras with visibility predicted right, and all, see `visibility_agreement`
    """

    tally: Tally
    single: list[tuple[float, float]]
    visible: Ints


def labelled(sessions: Sessions, rules: ViewsRules | None = None) -> Labelled:
    """Whole recordings, labelled."""
    out = Labelled(Tally(), [], np.zeros(4, dtype=np.int64))
    for person, body, session in sessions:
        result = label_views(session.blobs, session.rig, body, rules=ViewsRules() if rules is None else rules)
        out.tally.add(result.labels, session.identity, person)
        one = result.views == 1
        away = np.linalg.norm(result.positions - session.recording.positions, axis=2)
        out.single += [pair for pair in zip(away[one], result.deviations[one], strict=True) if np.isfinite(pair[0])]
        out.visible += visibility_agreement(result, session)
    return out


def gait(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Real gait recordings before simulated cameras, all subjects, bodies of the other subjects; two to four cameras."""
    for cameras in (4, 3, 2):
        name, done = f"gait, 15 markers, {cameras} cameras", labelled(gait_sessions(benchmark, cameras))
        yield from _shares(name, done.tally, cameras == 4)
        yield from _visibility(name, done, ">= 0.97" if cameras == 4 else "none")
        yield from _single(name, done.single)


def whole_body(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """26 markers: simulated people who move everything, and the real walks; two to four cameras."""
    for cameras in (4, 3, 2):
        name, done = f"whole body, 26 markers, simulated motion, {cameras} cameras", labelled(motion_sessions(benchmark, cameras))
        yield from _shares(name, done.tally, cameras == 4, least=0.99)
        yield from _visibility(name, done)
        yield from _single(name, done.single)
    name, done = "whole body, 26 markers, gait recordings, 4 cameras", labelled(gait_sessions(benchmark, 4, "body26"))
    yield from _shares(name, done.tally, True, least=0.99)
    yield from _visibility(name, done)


def _shares(row: str, tally: Tally, asked: bool, least: float = 0.995) -> Iterator[Figure]:
    yield Figure(f"{row}: right", f">= {least:g}" if asked else "none", tally.right / tally.shown, "fraction", tally.shown)
    yield Figure(f"{row}: wrong", "<= 0.003" if asked and least == 0.995 else "none", tally.wrong / tally.shown, "fraction", tally.shown)
    yield Figure(f"{row}: right, person with the least", "none", tally.worst, "fraction", len(tally.by_subject))


def _visibility(row: str, done: Labelled, asked: str = "none") -> Iterator[Figure]:
    *right, of = done.visible.tolist()
    kinds = ("alone", "and the labels of the frame before", "and the labels of the frames before and after")
    for share, kind, wanted in zip(right, kinds, ("none", asked, "none"), strict=True):
        yield Figure(f"{row}: visibility predicted right by the body {kind}", wanted, share / of, "fraction", of)


def _single(row: str, single: list[tuple[float, float]]) -> Iterator[Figure]:
    if not single:
        return
    away, stated = np.array(single).T
    yield Figure(f"{row}, markers of one camera: error, median", "none", 1e3 * float(np.median(away)), "mm", len(away))
    yield Figure(f"{row}, markers of one camera: stated deviation, median", "none", 1e3 * float(np.median(stated)), "mm", len(away))
    yield Figure(f"{row}, markers of one camera: within three deviations", "none", float((away < 3 * stated).mean()), "fraction", len(away))
