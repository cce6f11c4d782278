"""A reconstruction in; what it tells about points, cameras and rig out, as plain values."""

from __future__ import annotations

from typing import Any

import numpy as np

from asterism.cameras import Rig
from asterism.reconstruction.result import Reconstruction

MUCH_NOISE = 1.5
"""px: blobs of markers are found to a few tenths; more means that the rig is not the recording's, or not what it was."""
MANY_UNUSED, FEW_USED = 0.25, 0.5


def summary(result: Reconstruction, rig: Rig) -> dict[str, Any]:
    """Frames, points, cameras per point, residuals (px), deviations (m), and for each camera its blobs, its used share and residual.

    A camera's `residual_px` is the RMS distance between its blobs and the points' projections; one far above the others' was moved.
    """
    counts = result.clouds.counts
    rig = rig.select(result.blobs.cameras)
    blobs, used = result.blobs.counts.sum(axis=0), result.cameras.sum(axis=0)
    cameras = []
    for c, camera in enumerate(rig):
        mine = result.cameras[:, c]
        off = camera.project(result.clouds.xyz[mine]) - result.blobs.xy[result.rays[mine, c]]
        cameras.append(
            {
                "name": camera.name,
                "blobs": int(blobs[c]),
                "used": float(1 - result.unused[:, c].sum() / blobs[c]) if blobs[c] else float("nan"),
                "points": int(used[c]),
                "residual_px": float(np.sqrt(np.nanmean((off**2).sum(axis=1)))) if len(off) else float("nan"),
            }
        )
    many = len(result.residual) > 0
    return {
        "method": result.method,
        "frames": len(counts),
        "rate": result.clouds.rate,
        "points": len(result.residual),
        "points_per_frame": {
            "fewest": int(counts.min()) if len(counts) else 0,
            "median": float(np.median(counts)) if len(counts) else 0.0,
            "most": int(counts.max(initial=0)),
        },
        "points_by_cameras": {int(n): int(k) for n, k in enumerate(np.bincount(result.cameras.sum(axis=1))) if k},
        "residual_px": {"median": float(np.median(result.residual)), "p95": float(np.quantile(result.residual, 0.95))} if many else None,
        "deviation_m": {"median": float(np.median(result.deviation)), "p95": float(np.quantile(result.deviation, 0.95))} if many else None,
        "noise_px": float(result.noise.mean()),
        "unused_blobs": float(result.unused.sum() / max(1, blobs.sum())),
        "gated_pairs_per_frame": float(result.gated.mean()) if len(counts) else 0.0,
        "frames_proved_best": float(result.proved.mean()) if len(counts) else 1.0,
        "cameras": cameras,
        "remarks": [*result.remarks, *doubts(result)],
    }


def doubts(result: Reconstruction) -> list[str]:
    """What makes a rig or a recording suspect, one sentence each."""
    found = []
    blobs = int(result.blobs.counts.sum())
    if len(result.residual) and result.noise.mean() > MUCH_NOISE:
        found.append(
            f"blobs lie {result.noise.mean():.1f} px from where the rig has their points, a few tenths are usual: "
            "do not use these points before `asterism calibrate refine` has said which camera was moved."
        )
    share = 1 - result.unused.sum(axis=0) / np.maximum(result.blobs.counts.sum(axis=0), 1)
    for name, mine, many in zip(result.blobs.cameras, share, result.blobs.counts.sum(axis=0), strict=True):
        if many and mine < FEW_USED * share.max():
            found.append(
                f"camera {name}: {100 * mine:.0f} % of its blobs show a point, of another camera's {100 * share.max():.0f} %; "
                "it was moved, or sees much that others do not: `asterism calibrate refine` tells."
            )
    if blobs and result.unused.sum() > MANY_UNUSED * blobs:
        found.append(
            f"{100 * result.unused.sum() / blobs:.0f} % of the blobs show no point: is this the recording's rig, "
            "and do reflections or single views fill the images?"
        )
    if blobs and not len(result.residual):
        found.append("no point was found at all: is this the recording's rig, and are the cameras' names those of the blobs?")
    return found
