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


def parameters(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The first cycle of each side. Where no plate is, the files' events were set by hand, whose own uncertainty is not taken off."""
    apart: dict[str, list[tuple[float, float]]] = {"its": [], "our": []}
    for name in FILES[: 1 if benchmark.quick else None]:
        recording = asterism.read(folder() / name)
        analysis = analyse_gait(recording, force_plates(recording)[0])
        for whose, walking in (("our", analysis.walking), ("its", _by_the_file(recording, analysis.walking))):
            cycles = cycles_of(walking)
            first = [next(cycle for cycle in cycles if cycle.side == side) for side in "LR"]
            ours = analysis_values(replace(analysis, parameters=tuple(parameters_of(walking, first))))
            theirs = _by_name(recording)
            for one in ours:
                if (value := theirs.get((one.name, one.context, one.unit))) is not None:
                    apart[whose].append(
                        (abs(one.value / value - 1), abs(one.value - value) / float(one.description.split()[1].rstrip(",")))
                    )
    for whose, row in (("its", "by the files' events"), ("our", "by ours")):
        off = np.array(apart[whose])
        yield Figure(
            f"gait parameters against the files' own, {row}: median difference",
            "<= 0.01",
            float(np.median(off[:, 0])),
            "fraction",
            len(off),
        )
    yield Figure(
        "gait parameters against the files' own, by ours: within 95 %", ">= 0.9", float((off[:, 1] < 1.96).mean()), "fraction", len(off)
    )


def _by_the_file(recording: Recording, walking: Walking) -> Walking:
    """With the events that the file marks."""
    start = float(recording.times[0])
    own = [GaitEvent(event.context[0], event.label, event.time - start, 0.015, "file") for event in recording.events if event.context]
    return replace(walking, events=tuple(sorted(own, key=lambda event: event.time)))


def _by_name(recording: Recording) -> dict[tuple[str, str, str], float]:
    group = recording.source.parameters
    texts = [group.strings("ANALYSIS", name) for name in ("NAMES", "CONTEXTS", "UNITS")]
    return dict(zip(zip(*texts, strict=True), group.values("ANALYSIS", "VALUES").tolist(), strict=True))
