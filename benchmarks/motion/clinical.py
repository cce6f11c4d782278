"""Angles of legs, trunk, head and arms against those that the recordings' own programs computed; offsets of standing trials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.motion.clinical import StaticRules, clinical_angles, subject_measures, with_static_offsets
from asterism.motion.clinical.measures import computed_by_the_file
from asterism.recording import Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

NEAR = {
    ("Hip", "Knee", "Ankle"): 0.1,
    ("Pelvis", "FootProgress", "Thorax", "Spine"): 0.2,
    ("Head", "Neck", "Shoulder", "Elbow", "Wrist"): 0.2,
}
"""degrees RMS that are asked."""
OFFSETS = {"foot_flexion": 0.002, "foot_rotation": 0.005, "thigh_rotation": 0.002, "shank_rotation": 0.002, "tibial_torsion": 0.002}
"""rad that are asked; for the wands and the torsion nothing was."""


def plug_in_gait(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Share of curves of walks within what is asked, and how far the offsets of standing trials are off."""
    files = [path for part in ("gait", "gait-events", "movement") for path in sorted((folder() / part).rglob("*.c3d"))]
    walks = [path for path in files if "static" not in path.name][: 6 if benchmark.quick else None]
    apart = {name: curves for path in walks for name, curves in _off(path).items()}
    for joints, asked in NEAR.items():
        rms = np.concatenate([curves for (_, name), curves in apart.items() if name in joints])
        row = f"angles of {', '.join(joints)} against the file's own"
        yield Figure(f"{row}: curves within {asked} degrees RMS", ">= 0.98", float((rms < asked).mean()), "fraction", len(rms))
        yield Figure(f"{row}: median RMS", "none", float(np.median(rms)), "degrees", len(rms))
    offsets = [one for path in files if "static" in path.name for one in _offsets(path)]
    for name, asked in OFFSETS.items():
        off = np.array([value for measure, value in offsets if measure == name])
        yield Figure(
            f"standing trials, {name}: within {asked} rad of the file's", ">= 1", float((off <= asked).mean()), "fraction", len(off)
        )
        yield Figure(f"standing trials, {name}: largest difference to the file's", "none", float(off.max()), "rad", len(off))


def _read(path: Path) -> Recording | None:
    try:
        recording = asterism.read(path)
    except AsterismError:
        return None
    return recording if computed_by_the_file(recording, "LHipAngles") is not None else None


def _off(path: Path) -> dict[tuple[Path, str], np.ndarray]:
    """degrees RMS of each curve of both sides, by quantity."""
    recording = _read(path)
    try:
        outputs = {} if recording is None else clinical_angles(recording, model="plug-in-gait").outputs
    except AsterismError:
        return {}
    found: dict[tuple[Path, str], list[float]] = {}
    for name, angles in outputs.items():
        theirs = computed_by_the_file(recording, name)
        if theirs is not None and np.isfinite(theirs + angles).all(axis=1).sum() > 3:
            apart = (np.degrees(angles) - theirs + 180.0) % 360.0 - 180.0
            found.setdefault((path, name[1:].removesuffix("Angles")), []).extend(np.sqrt(np.nanmean(apart**2, axis=0)))
    return {key: np.array(values) for key, values in found.items()}


def _offsets(path: Path) -> Iterator[tuple[str, float]]:
    """rad off the file's own offsets, by the way of reading the trial that comes nearest: which one the program used, no file says."""
    recording = _read(path)
    given = None if recording is None else subject_measures(recording)
    if recording is None or given is None or "foot_flexion" not in given.left.from_file:
        return
    ways = []
    for radius in (0.005, 0.007):
        for rules in (StaticRules(), StaticRules(tilted=True), StaticRules(flat_foot=False)):
            told = with_static_offsets(recording, replace(given, marker_radius=radius), rules)
            ways.append([(name, abs(getattr(told.of(s), name) - getattr(given.of(s), name))) for s in "LR" for name in OFFSETS])
    yield from min(ways, key=lambda way: sum(off for _, off in way))
