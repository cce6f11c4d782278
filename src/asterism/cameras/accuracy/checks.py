"""A rig and its map in; what to know before recording with it, out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from asterism.cameras.accuracy.maps import RigMap
from asterism.cameras.accuracy.sensitivity import sees
from asterism.cameras.rig import Rig
from asterism.findings import Finding, Severity

IDLE_SHARE = 0.01
"""Of the volume: a camera that sees less of it measures next to nothing there."""


def check_map(rig: Rig, result: RigMap) -> tuple[Finding, ...]:
    """What speaks against measuring with this rig in the volume of its map."""
    return tuple(_findings(rig, result))


def _findings(rig: Rig, result: RigMap) -> Iterator[Finding]:
    if rig.vertical is None:
        yield Finding(
            "rig-no-vertical",
            Severity.NOTE,
            "",
            "the rig does not say which way is up: z was taken.",
            "Set it with `asterism convert --vertical`.",
        )
    if not np.isfinite(result.error).any():
        yield Finding(
            "rig-measures-nothing",
            Severity.ERROR,
            "",
            "no place of the volume can be measured: two cameras must see it, from two places.",
            "Move the cameras apart, or turn them to one place.",
        )
    for camera, share in zip(rig, sees(rig, result.places).mean(axis=1), strict=True):
        if share < IDLE_SHARE:
            yield Finding(
                "rig-camera-idle",
                Severity.WARNING,
                camera.name,
                f"camera {camera.name} sees next to nothing of the volume.",
                "Turn it, or give the volume that is meant (--volume).",
            )
