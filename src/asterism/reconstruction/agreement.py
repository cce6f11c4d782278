"""Points and a rig in; how well each camera agrees with what the others say about the points out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera, Rig
from asterism.cameras.accuracy._kernels import image_slopes
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.setting import image_borders
from asterism.recording import Blobs, Floats, Ints
from asterism.synchronization.lags import out_of_step

OFF_PX, OFF_NOISES = 0.3, 0.5
"""A camera whose image is off by more than both, in px and in standard deviations of the noise, does not fit."""
_MOST, _FEWEST = 4000, 50
_PLACES, _PLACE = 12, 0.02
"""How many different places of its image, in focal lengths apart, a camera must show points in to be judged."""
_BORDER = 3.0
"""px: a point nearer to the image border need not be seen."""
_ROUNDS, _CUT = 4, 3.0
_BY_NOISE = 2.0
"""How many standard deviations of the smooth part noise may make."""
_LONGEST, _FRAMES, _POINTS = 20, 40, 60
_ENOUGH, _BETTER = 0.25, 0.15
"""The share of the points that a camera must show another way, and by how much more than the way it should."""


@dataclass(frozen=True)
class Agreement:
    """One camera against the others.

    expected  points of three other cameras (of two, in a rig of three) that lie inside its image, of those looked at
    seen      the share of them that it shows, NaN where there are fewer than 50
    off       px, how far its whole image is shifted, turned, scaled or bent against where the others put the points: the part of its
              residuals that noise does not make (RMS); NaN where fewer than 50 of its blobs, or than 12 places in its image, tell
    """

    expected: int
    seen: float
    off: float


def agreement(result: Reconstruction, rig: Rig) -> tuple[Agreement, ...]:
    """How each camera of a reconstruction agrees with the others, in the order of the blobs' cameras.

    Looks at 4,000 points for each camera, evenly spread, and makes no new ones. O(cameras * points).
    """
    rig = rig.select(result.blobs.cameras)
    borders = image_borders(result.blobs, rig)
    told = []
    for c, camera in enumerate(rig):
        points = _some(np.flatnonzero(_by_others(result, c)))
        pixels = camera.project(result.clouds.xyz[points])
        inside = ((pixels > borders[0, c] + _BORDER) & (pixels < borders[1, c] - _BORDER)).all(axis=1)
        seen = result.cameras[points[inside], c]
        told.append(Agreement(len(seen), float(seen.mean()) if len(seen) >= _FEWEST else float("nan"), _off(result, camera, c)))
    return tuple(told)


def _by_others(result: Reconstruction, c: int) -> NDArray[np.bool_]:
    """(P,) the points that three other cameras show, or two where there are but three cameras."""
    others = result.cameras.sum(axis=1) - result.cameras[:, c]
    enough: NDArray[np.bool_] = others >= min(3, result.cameras.shape[1] - 1)
    return enough


def cause(result: Reconstruction, rig: Rig, c: int) -> str:
    """What is amiss with the images of camera c, which does not fit the others, in words: out of step, or another camera's; else ""."""
    rig = rig.select(result.blobs.cameras)
    good, offsets = _by_others(result, c), result.clouds.offsets
    clouds = [result.clouds.xyz[a:b][good[a:b]] for a, b in pairwise(offsets)]
    frames, gate = range(len(clouds)), near(float(result.noise[c]))
    behind = frames_behind(clouds, frames, result.blobs, c, rig[c], gate)
    if behind:
        return out_of_step(rig[c].name, behind)
    share = [shown(clouds, frames, result.blobs, c, camera, gate, [0])[0] for camera in rig]
    other = int(np.argmax(share))
    if share[other] > max(_ENOUGH, share[c] + _BETTER):
        return f"camera {rig[c].name} shows what camera {rig[other].name} of the rig should: were their names exchanged?"
    return ""


def near(noise: float) -> float:
    """px, how near to where a point should show its blob is."""
    return max(4.0 * noise, 1.0)


def frames_behind(clouds: Sequence[Floats], frames: Sequence[int], blobs: Blobs, number: int, camera: Camera, gate: float) -> int:
    """By how many frames a camera is behind the others, up to 20; 0 where it is in step or nothing tells.

    At the right lag a camera shows more of the points that others compose than at any other, clearly more than at none. Takes
    what `shown` does.
    """
    lags = list(range(-_LONGEST, _LONGEST + 1))
    share = shown(clouds, frames, blobs, number, camera, gate, lags)
    best = int(np.argmax(share))
    return lags[best] if share[best] > max(_ENOUGH, share[_LONGEST] + _BETTER) else 0


def shown(
    clouds: Sequence[Floats], frames: Sequence[int], blobs: Blobs, number: int, camera: Camera, gate: float, lags: Sequence[int]
) -> Floats:
    """(lags,) the share of points that have a blob nearby, so many frames later; 0 where few frames are there to look at.

    clouds  for each of `frames` the points (P, 3) m that the other cameras compose; at most 40 frames and 60 points of each are looked at
    blobs   the whole recording, of which the camera is the `number`-th; camera: as which it is looked at
    gate    px, how near a blob must be to where a point should show
    """
    filled = [n for n in range(len(clouds)) if len(clouds[n])]
    hits, looked = np.zeros(len(lags)), np.zeros(len(lags))
    for place in np.unique(np.linspace(0, len(filled) - 1, min(_FRAMES, len(filled))).astype(np.int64)):
        n = filled[place]
        places = camera.project(clouds[n][:_POINTS])
        places = places[np.isfinite(places).all(axis=1)]
        for k, lag in enumerate(lags):
            if 0 <= frames[n] + lag < len(blobs) and len(places):
                xy = blobs.of(frames[n] + lag, number)
                away = np.linalg.norm(places[:, None] - xy[None], axis=2).min(axis=1, initial=np.inf)
                hits[k] += (away < gate).sum()
                looked[k] += len(places)
    share: Floats = np.where(looked > 0.5 * looked.max(initial=1.0), hits / np.maximum(looked, 1.0), 0.0)
    return share


def _some(which: Ints) -> Ints:
    """At most so many of them, evenly spread."""
    return which[np.unique(np.linspace(0, len(which) - 1, min(_MOST, len(which))).astype(np.int64))]


def _off(result: Reconstruction, camera: Camera, c: int) -> float:
    """The smooth part of a camera's residuals: a shift, a linear map and a cubic radial term, over its image.

    A residual r of a point that all its cameras made is (1 - H) of what it would be had this camera had no say, H = J S J' / noise²
    with the point's covariance S; (1 - H) / noise² is also the weight of that. So the smooth field a with A a = (1 - H)^-1 r has the normal
    equations A' (1 - H) A a = A' r. Blobs that fit far worse than most have little weight. What noise may make is taken off.
    """
    mine = _some(np.flatnonzero(result.cameras[:, c] & (result.cameras.sum(axis=1) >= 3)))
    points = np.ascontiguousarray(result.clouds.xyz[mine])
    residual = result.blobs.xy[result.rays[mine, c]] - camera.project(points)
    slopes = np.empty((len(points), 2, 3))
    image_slopes(camera.lens, camera.rotation, camera.translation, points, slopes)
    known = np.isfinite(residual).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
    residual, slopes, mine = residual[known], slopes[known], mine[known]
    flat = (result.blobs.xy[result.rays[mine, c]] - camera.centre) / camera.focal
    if len(mine) < _FEWEST or len(np.unique(np.rint(flat / _PLACE), axis=0)) < _PLACES:
        return float("nan")
    own: Floats = np.eye(2) - slopes @ result.covariance[mine] @ slopes.transpose(0, 2, 1) / result.noise[c] ** 2
    field = _smooth(flat)
    weights, a, normal = np.ones(len(mine)), np.zeros(field.shape[2]), np.eye(field.shape[2])
    for _ in range(_ROUNDS):
        weighted = weights[:, None, None] * field
        normal = np.einsum("nij,nik,nkl->jl", weighted, own, field, optimize=True)
        a = np.linalg.lstsq(normal, np.einsum("nij,ni->j", weighted, residual), rcond=1e-9)[0]
        left = np.square(residual - np.einsum("nik,nkl,l->ni", own, field, a, optimize=True)).sum(axis=1)
        weights = 1.0 / (1.0 + left / (_CUT**2 * np.median(left) + 1e-12))
    spread = np.einsum("nij,jk,nik->n", field, np.linalg.pinv(normal), field, optimize=True).mean() * result.noise[c] ** 2
    return float(np.sqrt(max(float(np.square(field @ a).sum(axis=1).mean()) - _BY_NOISE**2 * float(spread), 0.0)))


def _smooth(flat: Floats) -> Floats:
    """(n, 2, 7) what a shift, a linear map and a cubic radial term do at places (n, 2) of the normalized plane."""
    field = np.zeros((len(flat), 2, 7))
    linear = np.column_stack([np.ones(len(flat)), flat])
    field[:, 0, :3], field[:, 1, 3:6] = linear, linear
    field[:, :, 6] = flat * np.square(flat).sum(axis=1)[:, None]
    return field
