"""A reconstruction in; what it says about points, cameras and rig out, as plain values and findings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from asterism.cameras import Rig
from asterism.findings import Finding, Severity
from asterism.reconstruction.camera_fit import RULES as FIT_RULES
from asterism.reconstruction.camera_fit import CameraFit, confusion, fit_of_cameras, misfit_limit
from asterism.reconstruction.observation_model import RULES as MODEL_RULES
from asterism.reconstruction.observation_model import noise_of
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.static_points import StaticPoint, find_static_points
from asterism.recording import Floats


@dataclass(frozen=True)
class SummaryRules:
    """When a rig or a recording is suspect: see tests/test_camera_fit.py for the rigs that must give a finding, and those that must not.

    max_noise         px: blobs of markers are found to a few tenths; more means that the rig is not the recording's, or not what it was
    joint_misfit      beside the camera with the largest systematic residual, those are named that have this share of it: a moved camera
                      draws the others away, too
    min_seen          a camera that shows this share of the points has the markers in its image
    min_used          a camera is suspect that uses a smaller share of its blobs than this times the best camera's share
    max_unused        share of all blobs that may show no point
    max_outside       share of a camera's blobs that may lie outside its image
    max_room_m        m, between cameras: no room is that large, but many a rig is written in millimetres
    max_static        a recording is a static trial where more of a frame's points than this share never move
    named_points      static points whose places are given
    """

    max_noise: float = 1.5
    joint_misfit: float = 0.7
    min_seen: float = 0.3
    min_used: float = 0.5
    max_unused: float = 0.25
    max_outside: float = 0.01
    max_room_m: float = 100.0
    max_static: float = 0.5
    named_points: int = 3


RULES = SummaryRules()


def summary(result: Reconstruction, rig: Rig) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Numbers on frames, points, cameras and residuals as plain values; and all findings, those of the reconstruction first.

    A camera's `residual_px` is the RMS distance between its blobs and the points' projections; `seen`, the share of the points which the
    others place in its image that it shows; `systematic_px`, by how much its image as a whole is not where the others place it: see
    `CameraFit`.
    """
    rig = rig.select(result.blobs.cameras)
    fits, static = fit_of_cameras(result, rig), find_static_points(result)
    numbers = {
        "method": result.method,
        "frames": len(result.clouds),
        "rate": result.clouds.rate,
        **_points(result),
        "static_points": [{"position_m": point.position.tolist(), "share": point.share, "cameras": point.cameras} for point in static],
        "cameras": [_camera(result, rig, c, fits[c]) for c in range(len(rig))],
    }
    return numbers, (*result.findings, *rig_findings(result, rig, fits), *_reflections(result, static))


def _points(result: Reconstruction) -> dict[str, Any]:
    counts, blobs = result.clouds.counts, result.blobs.counts.sum()
    return {
        "points": len(result.residual),
        "points_per_frame": {
            "fewest": int(counts.min()) if len(counts) else 0,
            "median": float(np.median(counts)) if len(counts) else 0.0,
            "most": int(counts.max(initial=0)),
        },
        "points_by_cameras": {int(n): int(k) for n, k in enumerate(np.bincount(result.cameras.sum(axis=1))) if k},
        "residual_px": _median_and_p95(result.residual),
        "deviation_m": _median_and_p95(result.deviation),
        "noise_px": float(result.noise.mean()),
        "unused_blobs": float(result.unused.sum() / max(1, blobs)),
        "gated_pairs_per_frame": float(result.gated.mean()) if len(counts) else 0.0,
        "frames_proved_best": float(result.proved.mean()) if len(counts) else 1.0,
    }


def _median_and_p95(values: Floats) -> dict[str, float] | None:
    return {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))} if len(values) else None


def _camera(result: Reconstruction, rig: Rig, c: int, fit: CameraFit) -> dict[str, Any]:
    blobs, shows = int(result.blobs.counts[:, c].sum()), result.cameras[:, c]
    error = rig[c].project(result.clouds.xyz[shows]) - result.blobs.xy[result.rays[shows, c]]
    return {
        "name": rig[c].name,
        "blobs": blobs,
        "used": float(1 - result.unused[:, c].sum() / blobs) if blobs else float("nan"),
        "points": int(shows.sum()),
        "masked_places": int(result.masked_places[c]),
        "residual_px": float(np.sqrt(np.nanmean((error**2).sum(axis=1)))) if len(error) else float("nan"),
        "expected": fit.expected,
        "seen": fit.seen,
        "systematic_px": fit.systematic,
    }


def _reflections(result: Reconstruction, static: Sequence[StaticPoint]) -> Iterator[Finding]:
    """Static points that only two of many cameras show, unless most points are static: a static trial."""
    # Any two cameras' lamps meet somewhere; a third camera that agrees makes it a thing in the room.
    suspect = [point for point in static if point.cameras == 2]
    if len(result.blobs.cameras) < 4 or not suspect or len(static) > RULES.max_static * float(np.median(result.clouds.counts)):
        return
    where = "; ".join(", ".join(f"{x:.2f}" for x in point.position) for point in suspect[: RULES.named_points])
    more = " and elsewhere" if len(suspect) > RULES.named_points else ""
    yield Finding(
        "reconstruct-static-points",
        Severity.WARNING,
        f"{where} m",
        f"{len(suspect)} points never move and are shown by two cameras only, at {where} m{more}: most are reflections.",
        "Cover them, or leave them out with --mask-static, unless markers rest there.",
    )


def rig_findings(result: Reconstruction, rig: Rig, fits: Sequence[CameraFit]) -> list[Finding]:
    """What makes a rig or a recording suspect; `fits`: how each camera fits the others."""
    blobs = int(result.blobs.counts.sum())
    found = [*_outside_images(result, rig), *_units(rig)]
    if blobs and not len(result.residual):
        none = Finding(
            "reconstruct-no-points",
            Severity.ERROR,
            "",
            "no point was found at all.",
            "Is this the recording's rig, and are the cameras' names those of the blobs?",
        )
        return [*found, none]
    found += [*_noisy(result, fits), *_misfits(result, rig, fits)]
    # Where something else was found wrong, unused blobs follow from it and need no sentence of their own.
    if not found and result.unused.sum() > RULES.max_unused * blobs:
        found.append(
            Finding(
                "reconstruct-many-unused",
                Severity.WARNING,
                "",
                f"{100 * result.unused.sum() / blobs:.0f} % of the blobs show no point.",
                "Is this the recording's rig, and do reflections or single views fill the images?",
            )
        )
    return found


def _outside_images(result: Reconstruction, rig: Rig) -> Iterator[Finding]:
    """Blobs in the pixels of other images."""
    camera_of = result.blobs.camera_of
    outside = {}
    for c, camera in enumerate(rig):
        xy = result.blobs.xy[camera_of == c]
        if camera.size is not None and len(xy):
            # A pixel of grace, since programs count from the corner or from the centre of the first one.
            share = float(((xy < -1.5) | (xy > np.array(camera.size) + 0.5)).any(axis=1).mean())
            if share > RULES.max_outside:
                outside[camera.name] = f"{100 * share:.0f} % of the blobs of camera {camera.name} ({camera.size[0]} x {camera.size[1]} px)"
    if outside:
        yield Finding(
            "reconstruct-outside-image",
            Severity.WARNING,
            ", ".join(outside),
            f"{', '.join(outside.values())} lie outside its image.",
            "Give the rig of these images, or blobs in its pixels.",
        )


def _units(rig: Rig) -> Iterator[Finding]:
    """Metres that are millimetres."""
    positions = np.array([camera.position for camera in rig])
    spread = float(np.median(np.linalg.norm(positions - np.median(positions, axis=0), axis=1)))
    if spread > RULES.max_room_m:
        yield Finding(
            "reconstruct-units",
            Severity.WARNING,
            "",
            f"the cameras stand some {spread:,.0f} m from their middle, so the points are as large.",
            "Is the rig in millimetres? Give it in metres.",
        )


def _noisy(result: Reconstruction, fits: Sequence[CameraFit]) -> Iterator[Finding]:
    """Blobs that lie too far from where the rig has their points."""
    if len(result.residual) < MODEL_RULES.min_points:
        return
    noise = noise_of(result.residual, result.cameras.sum(axis=1))
    if noise <= RULES.max_noise:
        return
    sentence = f"blobs lie {noise:.1f} px from where the rig has their points, a few tenths are usual"
    # Noise that no camera has as a whole is in the blobs; a rig that was moved shows as whole images that are off.
    if all(fit.systematic < FIT_RULES.misfit_noises * noise for fit in fits):
        yield Finding(
            "reconstruct-noisy-blobs",
            Severity.WARNING,
            "",
            f"{sentence}; no camera is off as a whole, so the blobs are found no better, or their times differ from frame to frame.",
            "Check focus and threshold of the cameras, and that they are triggered together.",
        )
    else:
        yield Finding(
            "reconstruct-rig-changed",
            Severity.ERROR,
            "",
            f"{sentence}.",
            "Do not use these points before `asterism calibrate refine` has said which camera was moved.",
        )


def _misfits(result: Reconstruction, rig: Rig, fits: Sequence[CameraFit]) -> Iterator[Finding]:
    """Cameras whose blobs make few points, and cameras that make points and do not fit the others."""
    names, blobs = result.blobs.cameras, result.blobs.counts.sum(axis=0)
    used = 1 - result.unused.sum(axis=0) / np.maximum(blobs, 1)
    systematic = np.nan_to_num([fit.systematic for fit in fits])
    limits = np.array([misfit_limit(float(noise)) for noise in result.noise])
    # A moved camera draws the others' points away, so only those near the largest misfit are named.
    draws = (systematic > limits) & (systematic > RULES.joint_misfit * systematic.max(initial=0.0))
    idle = (blobs > 0) & (used < RULES.min_used * used.max(initial=0.0))
    # Where most are off, nobody can say who moved.
    if draws.sum() > len(names) / 2:
        yield Finding(
            "reconstruct-rig-misfit",
            Severity.ERROR,
            ", ".join(name for name, moved in zip(names, draws, strict=True) if moved),
            f"most cameras do not fit each other: their images are off by up to {systematic.max():.1f} px as a whole.",
            "Do not use these points before `asterism calibrate refine` has said which were moved; where it does not, calibrate the rig "
            "again.",
        )
        return
    for c, name in enumerate(names):
        shares = f"{100 * used[c]:.0f} % of its blobs show a point, of another camera's {100 * used.max():.0f} %"
        if idle[c] and fits[c].seen > RULES.min_seen:
            yield Finding(
                "reconstruct-camera-reflections",
                Severity.WARNING,
                name,
                f"camera {name}: {shares}; it shows the markers and many other lights.",
                "Cover reflections and lamps in its view, or leave them out with --mask-static.",
            )
        elif draws[c] or (idle[c] and used.max() > RULES.min_used):
            misfit = f"its image is off by {systematic[c]:.1f} px as a whole, and draws points away" if draws[c] else shares
            yield confusion(result, rig, c) or _camera_misfit(name, misfit)


def _camera_misfit(name: str, misfit: str) -> Finding:
    return Finding(
        "reconstruct-camera-misfit",
        Severity.WARNING,
        name,
        f"camera {name} does not fit the others: {misfit}.",
        "Before you use these points, find with `asterism calibrate refine` whether it was moved.",
    )
