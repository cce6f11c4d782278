"""Real walks: the knee's flexion from clusters, against the angle that Plug-in-Gait left in the file."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import asterism
from asterism.motion.joints import functional_flexion, grood_suntay, joint_rotation, leg_frames
from asterism.motion.rigid import estimate_limb_motion
from asterism.recording import Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

SHANK = ("HFB", "TUB", "SHN", "TIB", "ANK")
THIGH = ("THI", "KNE")
"""The thigh has two markers; the hip centre, from the pelvis' markers, is the third point of its cluster."""


def knee(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """RMS after removing the constant offset, by subject: clusters with anatomical or functional axes, frames of the markers."""
    subjects = sorted(path.name for path in (folder() / "gait").iterdir() if path.is_dir())[: 1 if benchmark.quick else None]
    found = {subject: _of_subject(subject) for subject in subjects}
    for place, name in enumerate(("clusters, anatomical axes", "clusters, functional axis", "frames of the markers")):
        values = [result[place] for result in found.values()]
        asked = "< 3" if place < 2 else "none"
        yield Figure(
            f"gait, {name}: knee flexion, RMS to Plug-in-Gait, mean of subjects", "none", float(np.mean(values)), "degrees", len(values)
        )
        yield Figure(f"gait, {name}: knee flexion, RMS to Plug-in-Gait, worst subject", asked, float(max(values)), "degrees", len(values))


def _of_subject(subject: str) -> list[float]:
    """degrees, over both walks and sides."""
    squares: list[list[float]] = [[], [], []]
    for walk in ("straight", "turn"):
        recording = asterism.read(folder() / "gait" / subject / f"{walk}.c3d")
        for side in "LR":
            computed = recording.source.coordinates[:, list(recording.source.labels).index(f"{side}KneeAngles")]
            known = np.isfinite(computed).all(axis=1) & (np.abs(computed).sum(axis=1) > 0)
            for place, flexion in enumerate(_flexions(recording, side)):
                both = known & np.isfinite(flexion)
                errors = [np.var(sign * np.degrees(flexion[both]) - computed[both, 0]) for sign in (1, -1)]
                squares[place].append(float(min(errors)))
    return [float(np.sqrt(np.mean(part))) for part in squares]


def _flexions(recording: Recording, side: str) -> list[np.ndarray]:
    """(T,) rad by each way; signs are the axes'."""
    frames = leg_frames(recording, side)

    def markers(names: tuple[str, ...]) -> np.ndarray:
        return recording.positions[:, [recording.labels.index(side + name) for name in names]]

    thigh = estimate_limb_motion(np.concatenate([markers(THIGH), frames.hip[:, None]], axis=1), "svd")
    shank = estimate_limb_motion(markers(SHANK))
    axes = [_mean_axes(motion.rotations, own) for motion, own in ((thigh, frames.thigh), (shank, frames.shank))]
    anatomical = grood_suntay(thigh.rotations @ axes[0], shank.rotations @ axes[1])[:, 0]
    functional = functional_flexion(joint_rotation(thigh.rotations, shank.rotations))[0]
    return [anatomical, functional, grood_suntay(frames.thigh, frames.shank)[:, 0]]


def _mean_axes(rotations: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """(3, 3): anatomical axes in those of the limb, the mean over the walk."""
    from asterism.geometry import best_rotation

    local = np.einsum("tji,tjk->tik", rotations, frames)
    return best_rotation(local[np.isfinite(local).all(axis=(1, 2))].sum(axis=0))
