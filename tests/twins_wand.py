"""Slow, readable twins of the kernels that identify a wand."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np

from asterism.calibration.wand.identify import SEARCH
from asterism.cameras import Camera
from asterism.cameras.bundle import Sightings, triangulate
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


def agree(blobs: Blobs, chosen: np.ndarray, lengths: np.ndarray, cameras: list[Camera], gate: float) -> list[tuple[float, np.ndarray]]:
    """For each frame, how well the best wand is supported, and its blobs (C, K), before it is laid again by all of them."""
    best = []
    for t in range(len(blobs)):
        found = (0.0, np.full((len(cameras), len(lengths)), -1))
        for a, b in combinations(range(len(cameras)), 2):
            if (chosen[t, [a, b]] < 0).any():
                continue
            xy = blobs.xy[chosen[t, [a, b]]]
            points = triangulate([cameras[a], cameras[b]], Sightings.from_array(xy[None]), 1, len(lengths))[0]
            slope = ((lengths - lengths.mean())[:, None] * (points - points.mean(axis=0))).sum(axis=0)
            wand = points.mean(axis=0) + (lengths - lengths.mean())[:, None] * slope / np.linalg.norm(slope)
            score, sights = 0.0, np.full((len(cameras), len(lengths)), -1)
            for c, camera in enumerate(cameras):
                first = blobs.offsets[t * len(cameras) + c]
                for k, place in enumerate(camera.project(wand)):
                    off = np.linalg.norm(blobs.of(t, c) - place, axis=1)
                    off[[int(s - first) for s in sights[c, :k] if s >= 0]] = np.inf
                    if len(off) and off.min() < gate:
                        sights[c, k] = first + off.argmin()
                        score += 1 - (off.min() / gate) ** 2
            if score > found[0]:
                found = (score, sights)
        best.append(found)
    return best
