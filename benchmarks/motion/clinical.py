"""Angles of legs, trunk, head and arms against those that the recordings' own programs computed; offsets of standing trials."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.motion.clinical import clinical_angles, gathered_measures, subject_measures
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
    """Share of curves of walks within what is asked, and how far the offsets of standing trials are off.

    One trial (HC040) holds offsets that it does not show itself: those of another trial, with which its program computed it as a walk
    (`clinical-static-differs`). The others come out to 0.001 rad.
    """
    files = [path for part in ("gait", "gait-events", "movement") for path in sorted((folder() / part).rglob("*.c3d"))]
    walks = [path for path in files if "static" not in path.name][: 6 if benchmark.quick else None]
    apart = {name: curves for path in walks for name, curves in _off(path).items()}
    for joints, asked in NEAR.items():
        rms = np.concatenate([curves for (_, name), curves in apart.items() if name in joints])
        row = f"angles of {', '.join(joints)} against the file's own"
        yield Figure(f"{row}: curves within {asked} degrees RMS", ">= 0.98", float((rms < asked).mean()), "fraction", len(rms))
        yield Figure(f"{row}: median RMS", "none", float(np.median(rms)), "degrees", len(rms))
    beside = [path for path in walks if path.with_name("static.c3d").exists()]
    if beside:
        rms = np.array([off for path in beside for off in _with_static(path)])
        row = "angles with the standing trial given, against the file's own: curves within 0.1 degrees RMS"
        yield Figure(row, ">= 0.9", float((rms < 0.1).mean()), "fraction", len(rms))
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
    """rad off the file's own offsets, as `--static` reads the trial: by the rule that comes nearest, since no file says which it was."""
    recording = _read(path)
    given = None if recording is None else subject_measures(recording)
    if recording is None or given is None or "foot_flexion" not in given.left.from_file:
        return
    told = gathered_measures(recording, recording)[0]
    yield from [(name, abs(getattr(told.of(side), name) - getattr(given.of(side), name))) for side in "LR" for name in OFFSETS]


def _with_static(path: Path) -> list[float]:
    """degrees RMS off the file's own angles of hip, knee and ankle of a walk whose offsets come from the standing trial beside it."""
    recording, static = asterism.read(path), asterism.read(path.with_name("static.c3d"))
    outputs = clinical_angles(recording, measures=gathered_measures(recording, static)[0], model="plug-in-gait").outputs
    found = []
    for name in (f"{side}{joint}Angles" for side in "LR" for joint in ("Hip", "Knee", "Ankle")):
        theirs = computed_by_the_file(recording, name)
        if theirs is not None and name in outputs:
            found += np.sqrt(np.nanmean(((np.degrees(outputs[name]) - theirs + 180.0) % 360.0 - 180.0) ** 2, axis=0)).tolist()
    return found
