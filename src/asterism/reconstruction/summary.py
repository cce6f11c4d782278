"""A reconstruction in; what it tells about points, cameras and rig out, as plain values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from asterism.cameras import Rig
from asterism.reconstruction.agreement import OFF_NOISES, OFF_PX, Agreement, agreement, cause
from asterism.reconstruction.belief import noise_of
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.static_points import StillPoint, still_points

MUCH_NOISE = 1.5
"""px: blobs of markers are found to a few tenths; more means that the rig is not the recording's, or not what it was."""
_NEARLY = 0.7
"""Beside the camera that is off most, those are named that are off by this share of it: it draws the others away, too."""
FEW_SEEN, FEW_USED, MANY_UNUSED = 0.3, 0.5, 0.25
MANY_OUTSIDE = 0.01
FAR_APART = 100.0
"""m, between cameras: no room is that large, but many a rig is written in millimetres."""
_FEW_POINTS = 10
_STATIC, _MOST_PLACES = 0.5, 3


def summary(result: Reconstruction, rig: Rig) -> dict[str, Any]:
    """Frames, points, cameras per point, residuals (px), deviations (m), and for each camera its blobs, its used share and residual.

    A camera's `residual_px` is the RMS distance between its blobs and the points' projections; `seen`, the share of the points which the
    others place in its image that it shows; `off_px`, by how much its image as a whole is not where the others say: see `Agreement`.
    """
    counts = result.clouds.counts
    rig = rig.select(result.blobs.cameras)
    blobs, used = result.blobs.counts.sum(axis=0), result.cameras.sum(axis=0)
    agree, still = agreement(result, rig), still_points(result)
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
                "masked_places": int(result.masked[c]),
                "residual_px": float(np.sqrt(np.nanmean((off**2).sum(axis=1)))) if len(off) else float("nan"),
                "expected": agree[c].expected,
                "seen": agree[c].seen,
                "off_px": agree[c].off,
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
        "still_points": [{"place_m": point.place.tolist(), "share": point.share, "cameras": point.cameras} for point in still],
        "cameras": cameras,
        "remarks": [*result.remarks, *doubts(result, rig, agree), *_reflections(result, still)],
    }


def _reflections(result: Reconstruction, still: Sequence[StillPoint]) -> Iterator[str]:
    """Still points that only two of many cameras show, unless most points are still: a static trial."""
    doubtful = [point for point in still if point.cameras == 2]
    if len(result.blobs.cameras) < 4 or not doubtful or len(still) > _STATIC * float(np.median(result.clouds.counts)):
        return
    where = "; ".join(", ".join(f"{x:.2f}" for x in point.place) for point in doubtful[:_MOST_PLACES])
    more = " and elsewhere" if len(doubtful) > _MOST_PLACES else ""
    yield (
        f"{len(doubtful)} points never move and are shown by two cameras only, at {where} m{more}: most are reflections. "
        "Cover them, or leave them out with --mask-static, unless markers rest there."
    )


def doubts(result: Reconstruction, rig: Rig, agree: Sequence[Agreement]) -> list[str]:
    """What makes a rig or a recording suspect, one sentence each; `agree`: how each camera agrees with the others."""
    blobs = int(result.blobs.counts.sum())
    if blobs and not len(result.residual):
        return [
            *_units(result, rig),
            "no point was found at all: is this the recording's rig, and are the cameras' names those of the blobs?",
        ]
    found = [*_units(result, rig), *_noisy(result, agree), *_misfits(result, rig, agree)]
    if not found and result.unused.sum() > MANY_UNUSED * blobs:
        found.append(
            f"{100 * result.unused.sum() / blobs:.0f} % of the blobs show no point: is this the recording's rig, "
            "and do reflections or single views fill the images?"
        )
    return found


def _units(result: Reconstruction, rig: Rig) -> Iterator[str]:
    """Pixels of other images, metres that are millimetres."""
    camera_of = result.blobs.camera_of
    outside = {}
    for c, camera in enumerate(rig):
        mine = result.blobs.xy[camera_of == c]
        if camera.size is not None and len(mine):
            share = float(((mine < -1.5) | (mine > np.array(camera.size) + 0.5)).any(axis=1).mean())
            if share > MANY_OUTSIDE:
                outside[camera.name] = f"{100 * share:.0f} % of the blobs of camera {camera.name} ({camera.size[0]} x {camera.size[1]} px)"
    if outside:
        yield f"{', '.join(outside.values())} lie outside its image; give the rig of these images, or blobs in its pixels."
    places = np.array([camera.position for camera in rig])
    apart = float(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    if apart > FAR_APART:
        yield f"the cameras stand some {apart:,.0f} m from their middle, so the points are as large: is the rig in millimetres?"


def _noisy(result: Reconstruction, agree: Sequence[Agreement]) -> Iterator[str]:
    if len(result.residual) < _FEW_POINTS:
        return
    noise = noise_of(result.residual, result.cameras.sum(axis=1))
    if noise > MUCH_NOISE:
        lie = f"blobs lie {noise:.1f} px from where the rig has their points, a few tenths are usual"
        if all(camera.off < OFF_NOISES * noise for camera in agree):
            yield f"{lie}; no camera is off as a whole, so the blobs are found no better, or their times differ from frame to frame."
        else:
            yield f"{lie}: do not use these points before `asterism calibrate refine` has said which camera was moved."


def _misfits(result: Reconstruction, rig: Rig, agree: Sequence[Agreement]) -> Iterator[str]:
    """Cameras whose blobs make few points, or make points and are off."""
    names, blobs = result.blobs.cameras, result.blobs.counts.sum(axis=0)
    used = 1 - result.unused.sum(axis=0) / np.maximum(blobs, 1)
    off = np.nan_to_num([camera.off for camera in agree])
    draws = (off > np.maximum(OFF_PX, OFF_NOISES * result.noise)) & (off > _NEARLY * off.max(initial=0.0))
    idle = (blobs > 0) & (used < FEW_USED * used.max(initial=0.0))
    lit = idle & np.array([camera.seen > FEW_SEEN for camera in agree])
    if draws.sum() > len(names) / 2:
        yield (
            f"most cameras do not fit each other: their images are off by up to {off.max():.1f} px as a whole. Do not use these points "
            "before `asterism calibrate refine` has said which were moved; where it does not, calibrate the rig again."
        )
        return
    for c, name in enumerate(names):
        shares = f"{100 * used[c]:.0f} % of its blobs show a point, of another camera's {100 * used.max():.0f} %"
        if lit[c]:
            yield f"camera {name}: {shares}; it shows the markers, and much that is none: reflections or lamps."
        elif draws[c] or (idle[c] and used.max() > FEW_USED):
            what = f"its image is off by {off[c]:.1f} px as a whole, and draws points away" if draws[c] else shares
            yield cause(result, rig, c) or (
                f"camera {name} does not fit the others: {what}; before you use these points, see with `asterism calibrate refine` "
                "whether it was moved."
            )
