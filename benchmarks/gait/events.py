"""Strikes and offs by markers alone, against force plates and the events that the files hold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import asterism
from asterism.formats import force_plates
from asterism.gait import find_events
from asterism.gait.events import OFF, STRIKE, GaitEvent
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

NEAR = 0.15
"""s: an event with no other of its foot and kind so near is missed."""
GROUPS = {
    "children, straight": ("gait/*/straight.c3d", 7.0, 11.0),
    "children, turns": ("gait/*/turn*.c3d", 12.0, 12.0),
    "plates, other people": ("gait-events/plates/*/*.c3d", 7.0, 11.0),
    "treadmills": ("gait-events/treadmill/*.c3d", 7.0, 11.0),
    "Parkinson": ("gait-events/parkinson/*.c3d", 12.0, 15.0),
}
"""Files, and the mean absolute errors in ms that are asked for strikes and offs."""
STORED = {"LHS": ("L", STRIKE), "RHS": ("R", STRIKE), "LTO": ("L", OFF), "RTO": ("R", OFF)}


def events(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Mean absolute error in ms, and events that were missed."""
    for name, (pattern, *asked) in GROUPS.items():
        files = sorted(folder().glob(pattern))[: 2 if benchmark.quick else None]
        apart: dict[str, list[float]] = {STRIKE: [], OFF: []}
        for path in files:
            recording = asterism.read(path)
            found = find_events(recording)
            for side, label, time in _true(path, name == "plates, other people"):
                apart[label].append(min((abs(one.time - time) for one in found.of(side, label)), default=np.inf))
        for label, most in zip((STRIKE, OFF), asked, strict=True):
            off = np.array(apart[label])
            seen = off[off < NEAR]
            if len(off):
                yield Figure(
                    f"events by markers, {name}, {label}: mean absolute error", f"<= {most:g}", 1000 * float(seen.mean()), "ms", len(seen)
                )
                yield Figure(f"events by markers, {name}, {label}: missed", "<= 0", int((off >= NEAR).sum()), "events", len(off))


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
