"""Slow, readable twins of the kernels that identify a wand."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, permutations

import numpy as np

from asterism.calibration.wand._kernels import PARALLEL
from asterism.calibration.wand.identify import SEARCH, Wand
from asterism.cameras import Camera
from asterism.recording import Blobs


def find_wand(xy: np.ndarray, share: float, symmetric: bool) -> list[int] | None:
    """The places of U, V, W among the blobs (n, 2) px of one image; None where there is no wand, or another choice is nearly as good."""
    scored = []
    for u, v, w in permutations(range(len(xy)), 3):
        along = xy[w] - xy[u]
        length = np.linalg.norm(along)
        if length < SEARCH.shortest:
            continue
        part = (xy[v] - xy[u]) @ along / length**2
        if not 0 < part < 1:
            continue
        off = np.linalg.norm(xy[v] - xy[u] - part * along) / (SEARCH.slack + SEARCH.bend * length)
        # z_W / z_U as the image shows it
        ratio = part * (1 - share) / (share * (1 - part))
        tilt = abs(np.log(ratio)) / np.log(SEARCH.depth_ratio)
        if off <= 1 and tilt <= 1:
            scored.append((off + tilt, [u, v, w]))
    scored.sort()
    if not scored:
        return None
    rivals = [score for score, who in scored[1:] if not (symmetric and who == scored[0][1][::-1])]
    return scored[0][1] if not rivals or rivals[0] > scored[0][0] + 0.35 else None


def locate_wand(
    blobs: Blobs, detections: np.ndarray, wand: Wand, cameras: Sequence[Camera | None], gate: float
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each frame the first marker's place, the direction and the blobs (C, K) of the wand that posed cameras agree on.

    Each pair of cameras proposes a wand; the one that most blobs support is fitted again, twice at most, to all blobs on it.
    """
    return [_locate_in_frame(blobs, detections[t], wand, cameras, gate, t) for t in range(len(blobs))]


def _locate_in_frame(blobs, detected, wand, cameras, gate, t):  # type: ignore[no-untyped-def]
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    markers, showing = len(wand), [c for c in posed if detected[c, 0] >= 0]
    enough = 0.9 * sum(min(len(blobs.of(t, c)), markers) for c in posed)
    best = (0.0, np.full(3, np.nan), np.full(3, np.nan), np.full((len(cameras), markers), -1))
    done = False
    for a, b in combinations(showing, 2):
        if done:
            break
        for step in (1, -1) if wand.symmetric and markers > 1 else (1,):
            rays = [[(a, detected[a, k]), (b, detected[b, ::step][k])] for k in range(markers)]
            tried = _supported(blobs, wand, cameras, gate, t, rays)
            if tried is not None and tried[0] > best[0]:
                best, done = tried, tried[0] > enough
    for _ in range(2 if best[0] > 0 else 0):
        rays = [[(c, best[3][c, k]) for c in range(len(cameras)) if best[3][c, k] >= 0] for k in range(markers)]
        tried = _supported(blobs, wand, cameras, gate, t, rays)
        if tried is None or tried[0] <= best[0]:
            break
        best = tried
    return best[1:]


def _supported(blobs, wand, cameras, gate, t, rays):  # type: ignore[no-untyped-def]
    """The wand through these rays (camera, blob) of each marker: its support, place, direction and blobs; None where there is no wand."""
    points = np.array([_crossing(blobs, cameras, own) for own in rays])
    there = np.isfinite(points[:, 0])
    if there.sum() < min(2, len(wand)):
        return None
    along, seen = wand.lengths[there], points[there]
    slope = ((along - along.mean())[:, None] * (seen - seen.mean(axis=0))).sum(axis=0)
    if len(wand) > 1 and not np.linalg.norm(slope) > 1e-12:
        return None
    direction = slope / np.linalg.norm(slope) if len(wand) > 1 else np.array([1.0, 0.0, 0.0])
    start = seen.mean(axis=0) - along.mean() * direction
    score, observations = 0.0, np.full((len(cameras), len(wand)), -1)
    for c, camera in enumerate(cameras):
        if camera is None or not len(blobs.of(t, c)):
            continue
        first = blobs.offsets[t * len(cameras) + c]
        for k, place in enumerate(camera.project(start + wand.lengths[:, None] * direction)):
            off = np.linalg.norm(blobs.of(t, c) - place, axis=1)
            off[[int(taken - first) for taken in observations[c, :k] if taken >= 0]] = np.inf
            if off.min() < gate:
                observations[c, k] = first + off.argmin()
                score += 1 - (off.min() / gate) ** 2
    return score, start, direction, observations


def _crossing(blobs, cameras, rays):  # type: ignore[no-untyped-def]
    """The point nearest to rays (camera, blob) by least squares; NaN where fewer than two have a direction, or all are parallel."""
    lines = [(cameras[c].position, cameras[c].rays(blobs.xy[row])) for c, row in rays]
    lines = [(origin, ray) for origin, ray in lines if np.isfinite(ray).all()]
    across = [np.eye(3) - np.outer(ray, ray) for _, ray in lines]
    if len(lines) < 2 or not np.linalg.det(sum(across)) > PARALLEL * len(lines) ** 3:
        return np.full(3, np.nan)
    return np.linalg.solve(sum(across), sum(part @ origin for part, (origin, _) in zip(across, lines, strict=True)))
