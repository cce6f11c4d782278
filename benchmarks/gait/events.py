"""Strikes and offs by markers alone, against force plates and the events that the files hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import asterism
from asterism.formats import force_plates
from asterism.gait import find_events
from asterism.gait.events import OFF, STRIKE, GaitEvent
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure
from benchmarks.gait.models import angles

NEAR = 0.15
"""s: an event with no other of its foot and kind so near is missed."""
GROUPS = {
    "children, straight": ("gait/*/straight.c3d", 7.0, 11.0),
    "children, turns": ("gait/*/turn*.c3d", 12.0, 12.0),
    "children, turns, by plates": ("gait/*/turn*.c3d", 12.0, 12.0),
    "plates, other people": ("gait-events/plates/*/*.c3d", 7.0, 11.0),
    "treadmills": ("gait-events/treadmill/*.c3d", 7.0, 11.0),
    "Parkinson": ("gait-events/parkinson/*.c3d", 12.0, 15.0),
}
"""Files, and the mean absolute errors in ms that are asked for strikes and offs. Where plates are named, they tell the truth; elsewhere the
file's events do, of which those off plates were set by hand: in turns 20 to 35 ms before all that tells a strike in the curves."""
STORED = {"LHS": ("L", STRIKE), "RHS": ("R", STRIKE), "LTO": ("L", OFF), "RTO": ("R", OFF)}


Finder = Callable[[Path], list[GaitEvent]]

PEERS = ("zeni", "intellevent", "bike")
"""Methods of the package `gaitkit`, which this row needs and nothing else does."""


def events(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Mean absolute error in ms, events that were missed, and how many of them the stated +- holds (95 %)."""

    def ours(path: Path) -> list[GaitEvent]:
        return list(find_events(asterism.read(path)).events)

    for name, (pattern, *asked) in GROUPS.items():
        apart, shares = _apart(benchmark, name, pattern, ours)
        for label, most in zip((STRIKE, OFF), asked, strict=True):
            yield from _figures(f"events by markers, {name}, {label}", f"<= {most:g}", apart[label])
            held = float((np.array(shares[label]) < 1.96).mean())
            yield Figure(f"events by markers, {name}, {label}: within the stated 95 %", "none", held, "fraction", len(shares[label]))


def peers(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The same of published methods, as `gaitkit` has them; and angles by the package `pyCGM`."""
    yield from angles(benchmark)
    try:
        import gaitkit
    except ImportError:
        benchmark.report("gaitkit is not installed (pip install gaitkit): no peers of events")
        return
    for method in PEERS:

        def theirs(path: Path, method: str = method) -> list[GaitEvent]:
            told = gaitkit.detect(str(path), method=method, auto_install_deps=False)
            kinds = {STRIKE: {"L": told.left_hs, "R": told.right_hs}, OFF: {"L": told.left_to, "R": told.right_to}}
            return [
                GaitEvent(side, label, float(one["time"]), 1.0, method)
                for label, sides in kinds.items()
                for side, own in sides.items()
                for one in own
            ]

        for name, (pattern, *_) in GROUPS.items():
            try:
                apart, _ = _apart(benchmark, name, pattern, theirs)
            except Exception as problem:  # a peer's failure is its own figure
                benchmark.report(f"{method}, {name}: {type(problem).__name__}: {problem}")
                continue
            for label in (STRIKE, OFF):
                yield from _figures(f"events by {method} of gaitkit, {name}, {label}", "none", apart[label])


def _apart(benchmark: BenchmarkRun, name: str, pattern: str, find: Finder) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """s from each true event to the nearest that was found, by kind; and in standard uncertainties, of those that were found."""
    apart: dict[str, list[float]] = {STRIKE: [], OFF: []}
    shares: dict[str, list[float]] = {STRIKE: [], OFF: []}
    for path in sorted(folder().glob(pattern))[: 2 if benchmark.quick else None]:
        found = find(path)
        for side, label, time in _true(path, "plates" in name):
            own = [(abs(one.time - time), one.sigma) for one in found if (one.side, one.label) == (side, label)]
            off, sigma = min(own, default=(np.inf, 1.0))
            apart[label].append(off)
            shares[label] += [off / sigma] if off < NEAR else []
    return apart, shares


def _figures(row: str, asked: str, apart: list[float]) -> Iterator[Figure]:
    off = np.array(apart)
    seen = off[off < NEAR]
    if len(seen):
        yield Figure(f"{row}: mean absolute error", asked, 1000 * float(seen.mean()), "ms", len(seen))
    if len(off):
        yield Figure(f"{row}: missed", "none" if asked == "none" else "<= 0", int((off >= NEAR).sum()), "events", len(off))


def _true(path: Path, by_plates: bool) -> Iterator[tuple[str, str, float]]:
    """Side, kind and seconds from the first frame: what plates told where they count as the truth, else what the file holds."""
    recording = asterism.read(path)
    end = (len(recording) - 1) / recording.rate
    told: list[GaitEvent] = list(find_events(recording, force_plates(recording)[0]).events) if by_plates else []
    yield from ((one.side, one.label, one.time) for one in told if one.source != "markers")
    for event in () if by_plates else recording.events:
        side, label = STORED.get(event.label, STORED.get(event.context, (event.context[:1], event.label)))
        time = event.time - float(recording.times[0])
        if side in "LR" and label in (STRIKE, OFF) and 0.02 < time < end - 0.02:
            yield side, label, time
