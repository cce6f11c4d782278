"""Residuals of a calibration in their order in time in; whether a camera was moved during the recording out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.calibration.wand.recording import shows_wand
from asterism.cameras.bundle import Sightings
from asterism.recording import Floats, Ints

PARTS = 10
"""A recording is divided into this many parts to say when a camera's images were left out."""


@dataclass(frozen=True)
class StepRules:
    """When a camera's residuals have changed at one moment, and when a share of its images is known.

    blocks          of frames, whose mean residuals are compared
    least_blocks    that a camera needs, and `least_in_block` sightings in each
    least_side      blocks before the moment and after it, at least, and `least_share` of all
    significant     standard deviations by which residuals must change; the best of many splits differs by up to four where nothing
                    happened
    least_markers   that a part of the recording must show for a share of them to be computed

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    blocks: int = 40
    least_blocks: int = 8
    least_in_block: int = 5
    least_side: int = 3
    least_share: float = 0.125
    significant: float = 5.0
    least_markers: int = 30


RULES = StepRules()


def residual_steps(sightings: Sightings, residuals: Floats, cameras: int) -> tuple[Floats, Floats]:
    """By how many px each camera's residuals change at one moment (C,), and after what share of the recording; 0 where they do not.

    A camera that was moved, and is calibrated as if it was not, has residuals to one side before and to the other side after. Means of
    some seconds are compared rather than single residuals, which depend on where the wand was. The scatter of these means is the unit.
    """
    size, moment = np.zeros(cameras), np.zeros(cameras)
    if not len(sightings):
        return size, moment
    edges = np.unique(np.percentile(np.unique(sightings.frame), np.linspace(0.0, 100.0, RULES.blocks + 1)))
    block = np.clip(np.searchsorted(edges, sightings.frame, side="right") - 1, 0, len(edges) - 2)
    for c in range(cameras):
        own = sightings.camera == c
        count = np.bincount(block[own], minlength=RULES.blocks)
        there = np.nonzero(count >= RULES.least_in_block)[0]
        n = len(there)
        if n < RULES.least_blocks:
            continue
        mean = np.stack([np.bincount(block[own], part, minlength=RULES.blocks)[there] / count[there] for part in residuals[own].T], axis=1)
        best, side = RULES.significant, max(RULES.least_side, int(RULES.least_share * n))
        for split in range(side, n - side + 1):
            before, after = mean[:split], mean[split:]
            step = float(np.linalg.norm(after.mean(axis=0) - before.mean(axis=0)))
            scatter = np.square(before - before.mean(axis=0)).sum() + np.square(after - after.mean(axis=0)).sum()
            error = np.sqrt(scatter / (2 * n - 4) * (1.0 / split + 1.0 / (n - split)))
            if step > best * error:
                best = step / max(error, 1e-12)
                size[c], moment[c] = step, there[split] / len(edges)
    return size, moment


def rejected_shares(detections: Ints, offered: Ints, used: Sightings, frames: int) -> tuple[Floats, Floats]:
    """The share of each camera's images of the wand that was not used: (C,) of all, (C, PARTS) of each part of the recording.

    detections  (m, C, K) what single images took for the wand in the frames offered (m,); those that two cameras or more show count
    used        the sightings that were used; their frames are those of the recording, which has so many
    NaN where hardly an image of that part shows the wand.
    """
    own = shows_wand(detections)
    own &= (own.sum(axis=1) >= 2)[:, None]
    given, kept = np.zeros((own.shape[1], PARTS)), np.zeros((own.shape[1], PARTS))
    frame, camera = np.nonzero(own)
    np.add.at(given, (camera, offered[frame] * PARTS // frames), detections.shape[2])
    np.add.at(kept, (used.camera, used.frame * PARTS // frames), 1)
    parts = np.where(given >= RULES.least_markers, np.maximum(1.0 - kept / np.maximum(given, 1.0), 0.0), np.nan)
    return np.maximum(1.0 - kept.sum(axis=1) / np.maximum(given.sum(axis=1), 1.0), 0.0), parts
