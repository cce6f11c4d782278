"""Posed cameras and their images of a wand in; the final adjustment of everything, and what it left out, out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asterism.calibration.wand.frames import shown, spread_frames, widest
from asterism.calibration.wand.identify import Wand, agree
from asterism.calibration.wand.initialise import adjust_some, typical_noise
from asterism.calibration.wand.inputs import PERSPECTIVE, instead, shares
from asterism.calibration.wand.two_view import FEWEST, priors
from asterism.cameras.bundle import Adjustment, Sightings, adjust, free_parameters
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

_FINAL_FRAMES = 3000
"""More frames than these tell little more: they are spread over the recording."""
_WIDE, _REACH, _NARROW = 0.0036, 6.0, 4.5
"""Blobs are looked for within this share of the image's width, then within so many standard deviations; within fewer they are kept."""
_UNLIKE = 6.0
"""So many times as noisy as the others, or as quiet, a camera may be."""
_GROUPS = ("pose", "focal", "aspect", "centre", "k1", "k2", "tangential")


def adjusted(
    blobs: Blobs, chosen: Ints, wand: Wand, cameras: list[Camera | None], lenses: Sequence[Camera | None], noise: float
) -> tuple[Adjustment, Sightings, Ints, Ints]:
    """The final adjustment: everything freed, blobs that do not fit left out by what fits.

    Returns it, its sightings with frames counted without holes, the frames (m,) that these numbers stand for, and those it chose from.
    """
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    width = widest(cameras)
    known = [lenses[c] for c in posed]
    agreed = agree(blobs, chosen, wand, cameras, max(_WIDE * width, _REACH * noise))
    wide = adjust_some(blobs, agreed, wand, cameras, lenses, _GROUPS, max(2.0 * noise, 0.2), 60)
    relative = np.ones(len(cameras))
    if wide is not None:
        result, seen = wide
        cameras = list(cameras)
        for c, camera in zip(posed, result.cameras, strict=True):
            cameras[c] = camera
        noise = max(typical_noise(result.residuals), 0.01)
        relative[posed] = _relative_noise(result.residuals, seen.camera, len(posed), noise)
    agreed = agree(blobs, chosen, wand, cameras, np.maximum(_REACH * noise * relative, 1.5))
    offered = spread_frames(shown(chosen), _FINAL_FRAMES)
    sightings, used = agreed.sightings(blobs, offered).compact()
    if len(used) < FEWEST:
        told = instead(blobs, wand)
        if told:
            raise AsterismError(f"only {len(used)} frames fit the wand{told}")
        raise AsterismError(
            f"only {len(used)} frames show the wand to two cameras that agree on it; wave it longer where cameras overlap, and check that "
            "they ran in step."
        )
    sightings = sightings.among(cameras)
    own = [camera for camera in cameras if camera is not None]
    rotations, translations = (part[used] for part in agreed.placements())
    relative = relative[posed]
    result = _fitted(own, wand, sightings, (rotations, translations), known, noise, relative, _GROUPS, tolerance=1e-5)
    each = relative[sightings.camera]
    own, noise = list(result.cameras), max(typical_noise(result.residuals / each[:, None]), 1e-3)
    good = np.linalg.norm(result.residuals, axis=1) < _NARROW * noise * each
    sightings, rows = _determined(sightings.select(good), len(wand.lengths)).compact()
    placements = result.rotations[rows], result.translations[rows]
    groups = (*_GROUPS, "k3") if _wants_k3(own, wand, sightings, placements, known, noise, relative) else _GROUPS
    result = _fitted(own, wand, sightings, placements, known, noise, relative, groups, covariance=True, tolerance=1e-7)
    return result, sightings, used[rows], offered


def _relative_noise(residuals: Floats, camera: Ints, cameras: int, noise: float) -> Floats:
    """(C,) each camera's noise by all cameras'; 1 for two cameras, which share what they miss."""
    if cameras < 3:
        return np.ones(cameras)
    own = [residuals[camera == c] for c in range(cameras)]
    each = [typical_noise(part) / noise if len(part) > FEWEST else 1.0 for part in own]
    return np.clip(each, 1.0 / _UNLIKE, _UNLIKE)


def _fitted(
    cameras: list[Camera],
    wand: Wand,
    sightings: Sightings,
    placements: tuple[Floats, Floats],
    known: Sequence[Camera | None],
    noise: float,
    relative: Floats,
    groups: tuple[str, ...],
    *,
    tolerance: float,
    steps: int = 60,
    covariance: bool = False,
) -> Adjustment:
    """Adjust these groups of parameters of all cameras for blobs of this noise, px, times each camera's relative one (C,)."""
    return adjust(
        cameras, wand.template, sightings, *placements, free=free_parameters(len(cameras), *groups), prior=priors(cameras, known, noise),
        scale=3.0 * noise, relative=relative, tolerance=tolerance, steps=steps, covariance=covariance,
    )  # fmt: skip


def inner_place(blobs: Blobs, chosen: Ints, wand: Wand, cameras: Sequence[Camera], positions: Floats) -> float:
    """Where single images (m, C, K) put the inner marker, m from the first: the median of where their rays pass the measured wand's line.

    Of wands that look alike from both ends, where images usually show it, where that is far from what was given; NaN otherwise.
    """
    if len(wand.lengths) < 3:
        return float("nan")
    if wand.either:
        share, given = shares(blobs, wand)
        return share * float(wand.lengths[2]) if abs(share - given) > PERSPECTIVE else float("nan")
    start, along = positions[:, 0], positions[:, 2] - positions[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    places = []
    for c, camera in enumerate(cameras):
        rows = np.nonzero((chosen[:, c] >= 0).all(axis=1) & np.isfinite(along[:, 0]))[0]
        ray, line = camera.rays(blobs.xy[chosen[rows, c, 1]]), along[rows]
        to = camera.position - start[rows]
        across = (ray * line).sum(axis=1)
        place = ((to * line).sum(axis=1) - across * (to * ray).sum(axis=1)) / (1.0 - across**2)
        places.append(place[np.isfinite(place) & (across**2 < 0.9)])
    every = np.concatenate(places)
    return float(np.median(every)) if len(every) else float("nan")


def _wants_k3(
    cameras: list[Camera],
    wand: Wand,
    sightings: Sightings,
    placements: tuple[Floats, Floats],
    known: Sequence[Camera | None],
    noise: float,
    relative: Floats,
) -> bool:
    """Whether a third radial coefficient explains more than noise would let it explain, on a part of the frames."""
    some = sightings.frame % max(1, len(placements[0]) // 400) == 0
    part, rows = sightings.select(some).compact()
    at = placements[0][rows], placements[1][rows]
    without, with_it = (
        _fitted(cameras, wand, part, at, known, noise, relative, groups, tolerance=1e-5, steps=10).cost
        for groups in (_GROUPS, (*_GROUPS, "k3"))
    )
    n = len(cameras)
    return bool(2.0 * (without - with_it) / noise**2 > n + 4.0 * np.sqrt(2.0 * n))


def _determined(sightings: Sightings, markers: int) -> Sightings:
    """Those of frames that two cameras see, with more coordinates than a wand has freedoms."""
    frames = int(sightings.frame.max(initial=-1)) + 1
    count = np.bincount(sightings.frame, minlength=frames)
    cameras = np.bincount(np.unique(sightings.frame * 1024 + sightings.camera) // 1024, minlength=frames)
    points = np.bincount(np.unique(sightings.frame * 8 + sightings.point) // 8, minlength=frames)
    good = (cameras >= 2) & (2 * count > (3 if markers == 1 else 5)) & (points >= min(2, markers))
    return sightings.select(good[sightings.frame])
