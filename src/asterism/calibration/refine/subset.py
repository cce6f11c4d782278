"""A part of a recording: some frames, some cameras; and the pixel noise that the best of them have."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from asterism.calibration.refine.rules import RULES
from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.reconstruction.reconstruct import reconstruct
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.settings import ReconstructionSettings
from asterism.recording import Blobs, Ints


def some_frames(blobs: Blobs, seeing: list[int], most: int) -> tuple[Blobs, Ints]:
    """Frames in which most cameras see something, evenly spread, without times and sizes; and their numbers."""
    cameras = (blobs.counts[:, seeing] > 0).sum(axis=1)
    useful = np.nonzero(cameras >= min(3, len(seeing)))[0]
    if not len(useful):
        raise AsterismError("in no frame do three cameras see anything; give a recording of markers that several cameras see.")
    picked = useful[np.unique(np.linspace(0, len(useful) - 1, min(most, len(useful))).astype(np.int64))]
    some = blobs.frames(picked)
    return replace(some, sizes=np.full(len(some.xy), np.nan), times=None, first_frame=0), picked


def estimate_noise(blobs: Blobs, rig: Rig, cameras: list[int]) -> float:
    """px, the pixel noise by the small group of cameras that shows least of it: in some group none was moved.

    Groups are three cameras, neighbours first, two where there are but three; one with no more noise than good blobs have ends it.
    Raises AsterismError where no group agrees.
    """
    few, _ = some_frames(blobs, cameras, RULES.noise_frames)
    groups = list(combinations(cameras, 2 if len(cameras) == 3 else 3))
    places = np.array([camera.position for camera in rig])
    spread = [float(np.linalg.norm(places[list(group)] - places[list(group)].mean(axis=0))) for group in groups]
    least = np.inf
    for n in np.argsort(spread, kind="stable")[: RULES.noise_groups]:
        reconstructed = reconstruct_by(few, rig, list(groups[n]), None)
        if reconstructed.noise_known:
            least = min(least, float(np.median(reconstructed.noise)))
        if least < RULES.usual_noise and len(cameras) > 3:
            break
    if least > RULES.most_noise:
        raise AsterismError(
            f"no few cameras agree on points to {RULES.most_noise:g} px: this is not the rig of the recording (image size, names of "
            "cameras, y counted from the top?), or too few markers move in it; calibrate the rig again, or record more of them."
        )
    return least


def reconstruct_by(blobs: Blobs, rig: Rig, cameras: list[int], noise: float | None) -> Reconstruction:
    """Points by some cameras only, those that three of them show where there are four."""
    part = replace(rig, cameras=tuple(rig[c] for c in cameras))
    return reconstruct(blobs_of(blobs, cameras), part, ReconstructionSettings(noise=noise, min_cameras=3 if len(cameras) >= 4 else 2))


def blobs_of(blobs: Blobs, cameras: list[int]) -> Blobs:
    """The blobs of some cameras only, without times."""
    return replace(blobs.select_cameras([blobs.cameras[c] for c in cameras]), times=None, first_frame=0)
