"""Gait parameters against those that the recordings' own program wrote into them: by its events, for what they mean, and by ours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import asterism
from asterism.formats import force_plates
from asterism.gait import GaitEvent, Walking, analyse_gait, analysis_values, cycles_of, parameters_of
from asterism.recording import Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

FILES = ("movement/clinical-lower/sydney_gait03.c3d", "movement/clinical-lower/sydney_gait06.c3d", "gait-events/fullbody/small.c3d")
"""All files at hand that have the group ANALYSIS and markers of heels. Their program shows the first cycle of each side."""


BY_HAND, BY_PLATE = 0.010, 0.004
"""s, standard uncertainty of the files' own events: set by hand on frames of 10 ms, unless a plate tells them. The first is more likely too
small: in `sydney_gait03` three steps by these events last 0.52, 0.56 and 0.47 s, by ours 0.52, 0.53 and 0.52."""


def parameters(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The first cycle of each side. Where no plate is, the files' events were set by hand: what that leaves open counts beside ours."""
    apart: dict[str, list[tuple[float, float]]] = {"its": [], "our": []}
    for name in FILES[: 1 if benchmark.quick else None]:
        recording = asterism.read(folder() / name)
        analysis = analyse_gait(recording, force_plates(recording)[0])
        told, theirs = {}, _by_name(recording)
        for whose, walking in (("its", _by_the_file(recording, analysis.walking)), ("our", analysis.walking)):
            cycles = cycles_of(walking)
            first = [next(cycle for cycle in cycles if cycle.side == side) for side in "LR"]
            values = analysis_values(replace(analysis, parameters=tuple(parameters_of(walking, first))))
            told[whose] = {(one.name, one.context, one.unit): (one.value, float(one.description.split()[1].rstrip(","))) for one in values}
        for whose, own in told.items():
            for key in own.keys() & told["its"].keys() & theirs.keys():
                open_ = np.hypot(own[key][1], told["its"][key][1])
                apart[whose].append((abs(own[key][0] / theirs[key] - 1), abs(own[key][0] - theirs[key]) / float(open_)))
    for whose, row in (("its", "by the files' events"), ("our", "by ours")):
        off = np.array(apart[whose])
        title = f"gait parameters against the files' own, {row}"
        yield Figure(f"{title}: median difference", "<= 0.01", float(np.median(off[:, 0])), "fraction", len(off))
    yield Figure(f"{title}: within 95 % of both", ">= 0.9", float((off[:, 1] < 1.96).mean()), "fraction", len(off))


def _by_the_file(recording: Recording, walking: Walking) -> Walking:
    """With the events that the file marks."""
    start, found = float(recording.times[0]), list[GaitEvent]()
    for event in recording.events:
        if event.context:
            side, time = event.context[0], event.time - start
            ours = [one for one in walking.of(side, event.label) if one.source != "markers" and abs(one.time - time) < 2 * BY_HAND]
            found.append(GaitEvent(side, event.label, time, BY_PLATE if ours else BY_HAND, "file"))
    return replace(walking, events=tuple(sorted(found, key=lambda event: event.time)))


def _by_name(recording: Recording) -> dict[tuple[str, str, str], float]:
    group = recording.source.parameters
    texts = [group.strings("ANALYSIS", name) for name in ("NAMES", "CONTEXTS", "UNITS")]
    return dict(zip(zip(*texts, strict=True), group.values("ANALYSIS", "VALUES").tolist(), strict=True))
