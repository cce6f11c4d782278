"""Real walks mapped to characters of other proportions: how far feet slip and sink, and how far they would if bones were only copied."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

import asterism
from asterism.recording import Recording, SkeletonMotion
from asterism.skeleton import fit_person, solve_kinematics
from asterism.skeleton.retargeting import retarget as map_to
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import CHOOSING, folder
from benchmarks.figures import Figure
from tests.characters import character

PROPORTIONS = (0.7, 1.0, 1.4)
"""Of the legs and of the arms, each with each; trunk and head as usual."""
STILL = {"Foot": (0.15, 0.35), "ToeBase": (0.15, 0.50)}
"""Of a stance by the file's own events, when ankle and toes are still (textbooks: flat from 8 %, heel off at 55 %; earlier in turns)."""


def retarget(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Walks and turns of subjects on whom nothing was chosen. Slip is judged by joints and the files' events, sinking by all bones."""
    slips: dict[str, list[float]] = {"copied": [], "held": []}
    depths: dict[str, list[float]] = {"copied": [], "held": []}
    people = [path for path in sorted((folder() / "gait").iterdir()) if path.is_dir() and path.name not in CHOOSING]
    for path in people[: 1 if benchmark.quick else None]:
        for name in ("straight", "turn"):
            recording = asterism.read(path / f"{name}.c3d")
            standing = [asterism.read(path / "static.c3d")] if (path / "static.c3d").exists() else []
            motion = solve_kinematics(fit_person(standing, [recording]).tree, recording).motion()
            begin = float(recording.times[0])
            events = [replace(event, time=event.time - begin) for event in recording.events]
            known = np.isfinite(motion.root).all(axis=1)
            if not known.all():
                continue
            for legs in PROPORTIONS:
                for arms in PROPORTIONS[:: 2 if legs == 1.0 else 1]:
                    found = map_to(motion, character(legs, arms), events=events)
                    for whose, one in (("copied", found.copied), ("held", found.motion)):
                        upright = one.in_axes(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
                        slips[whose] += _slips(upright, recording)
                        depths[whose].append(-min(float(upright.joints[:, :, 2].min()), float(np.nanmin(upright.tips[:, :, 2]))))
    for whose, asked in (("copied", "none"), ("held", "< 5")):
        row = f"feet of characters, legs and arms 0.7 to 1.4, {whose}"
        yield Figure(f"{row}: largest slip in a stance", asked, 1e3 * max(slips[whose]), "mm", len(slips[whose]))
        yield Figure(f"{row}: median slip in a stance", "none", 1e3 * float(np.median(slips[whose])), "mm", len(slips[whose]))
        yield Figure(f"{row}: deepest below the floor", asked, 1e3 * max(0.0, *depths[whose]), "mm", len(depths[whose]))


def _slips(motion: SkeletonMotion, recording: Recording) -> list[float]:
    """m, the largest distance over the floor of ankle and toes from their median places, of each whole stance of the file's events."""
    found = []
    for side in ("Left", "Right"):
        own = sorted((e.time, "strike" in e.label.casefold()) for e in recording.events if e.context.casefold()[:1] == side[0].casefold())
        for (strike, is_strike), (off, is_off) in pairwise(own):
            for part, shares in STILL.items():
                begin, end = (strike + share * (off - strike) - float(recording.times[0]) for share in shares)
                frames = slice(round(begin * motion.rate), round(end * motion.rate) + 1)
                if not is_strike or is_off or begin < 0 or frames.stop > len(motion):
                    continue
                path = motion.joints[frames, motion.names.index(side + part), :2]
                found.append(float(np.linalg.norm(path - np.median(path, axis=0), axis=1).max()))
    return found
