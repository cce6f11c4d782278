"""How often bands of angles hold the curve that the vendor's program gave once it knew the person's measures, and how wide they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import asterism
from asterism.gait import analyse_gait, over_cycle
from asterism.gait.intervals import SOURCES, angle_bands
from asterism.motion.clinical import LegMeasures, SubjectMeasures, subject_measures
from asterism.motion.clinical.measures import all_computed_by_the_file
from asterism.motion.clinical.plug_in_gait import radius_by_the_file
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

PATTERNS = ("gait/*/[st][tu]r*.c3d", "gait-events/plates/*/*.c3d")
"""Walks of people who gave no number; each person once, by the first walk that has a whole cycle."""
AXES = ("flexion", "adduction", "rotation")
LEGS = [(joint, axis) for joint in ("Hip", "Knee", "Ankle", "FootProgress") for axis in range(3)]
UPPER = [(joint, axis) for joint in ("Head", "Shoulder", "Wrist") for axis in range(3)] + [("Neck", 0), ("Elbow", 0)]
"""Those that hang on a measure; for their widths nothing was asked."""
LENGTHS = ("leg_length", "knee_width", "ankle_width", "asis_trochanter")
KNOWN = {"no measures": LEGS + UPPER, "lengths alone": LEGS, "all measures, another session": LEGS}
"""What the band knows, and which angles are shown."""


def bands(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """How often the band of this session holds the vendor's curve, where measures are hidden: all, or those that a standing trial tells.

    With all measures that band is the curve itself; of the band of another session there is only a width to tell, since nobody walked
    twice. 19 people tell a share of 95 % to 5 %, so that one person more or less is seven angles within 93 to 97 % or without.
    """
    people: set[Path] = set()
    told: dict[str, dict[tuple[str, int], list[tuple[float, float]]]] = {known: {} for known in KNOWN}
    for path in [path for pattern in PATTERNS for path in sorted(folder().glob(pattern))]:
        if path.parent in people or (benchmark.quick and len(people) > 2):
            continue
        for known, found in told.items():
            for key, pairs in _of_walk(path, known).items():
                found.setdefault(key, []).extend(pairs)
                people.add(path.parent)
    for known, found in told.items():
        shown = {key: np.mean(found[key], axis=0) for key in KNOWN[known] if key in found}
        for (joint, axis), (inside, width) in shown.items():
            row = f"bands of angles, {known}: {joint} {AXES[axis]}"
            yield Figure(f"{row}, holds the vendor's curve", ">= 0.93", float(inside), "fraction", len(found[joint, axis]))
            yield Figure(f"{row}, width", "<= 20" if (joint, axis) in LEGS else "none", float(width), "degrees", len(found[joint, axis]))
        every = float(np.mean([inside for inside, _ in shown.values()]))
        asked = "none" if known.startswith("all") else "<= 0.97"
        yield Figure(f"bands of angles, {known}: all hold the vendor's curve", asked, every, "fraction", len(people))


def _of_walk(path: Path, known: str) -> dict[tuple[str, int], list[tuple[float, float]]]:
    """Of each side: the share of the cycle at which the vendor's curve is inside, and the mean width in degrees."""
    recording = asterism.read(path)
    measures = subject_measures(recording)
    given = SubjectMeasures()
    if known != "no measures":
        given = replace(measures, marker_radius=radius_by_the_file(recording, measures) or measures.marker_radius)
    if known == "lengths alone":
        for side in "LR":
            own = measures.of(side)
            given = given.with_leg(side, LegMeasures().with_values({name: getattr(own, name) for name in LENGTHS if name in own.from_file}))
    every = known.startswith("all")
    analysis = analyse_gait(recording if every else replace(recording, source=None), measures=given)
    found: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for name, band in angle_bands(analysis, SOURCES if every else ("measures",)).items():
        theirs = all_computed_by_the_file(recording, (name,)).get(name)
        cycles = [cycle for cycle in analysis.cycles if cycle.side == name[0]]
        if theirs is None or not cycles:
            continue
        curve = np.nanmean([over_cycle(np.radians(theirs), recording.rate, cycle) for cycle in cycles], axis=0)
        middle, half = (band.high + band.low) / 2, (band.high - band.low) / 2
        off = np.abs((curve - middle + np.pi) % (2 * np.pi) - np.pi)
        seen = np.isfinite(off).all(axis=1)
        for axis in range(3) if seen.any() else ():
            pair = (float((off <= half)[seen, axis].mean()), 2 * float(np.degrees(half[seen, axis].mean())))
            found.setdefault((name[1:].removesuffix("Angles"), axis), []).append(pair)
    return found
