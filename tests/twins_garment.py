"""Slow, readable twins of the kernels of garments."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np


def fuse_midpoints(origins, rays, starts, parallel):
    """The mean of all pairs' mid-points, weighted by the inverse square of the rays' distance."""
    out = np.full((len(starts) - 1, 3), np.nan)
    for g in range(len(out)):
        points, weights = [], []
        for i, j in combinations(range(starts[g], starts[g + 1]), 2):
            if np.linalg.norm(np.cross(rays[i], rays[j])) <= parallel:
                continue
            along, *_ = np.linalg.lstsq(np.stack([rays[i], -rays[j]], axis=1), origins[j] - origins[i], rcond=None)
            ends = origins[i] + along[0] * rays[i], origins[j] + along[1] * rays[j]
            points.append(0.5 * (ends[0] + ends[1]))
            weights.append(1.0 / max(float(np.sum((ends[0] - ends[1]) ** 2)), 1e-18))
        if points:
            out[g] = np.average(points, axis=0, weights=weights)
    return out


def rasterise(xy, nearness, triangles, samples, corner, shape):
    """Which triangle is nearest at each sample of a window: nearness and number, sample by sample."""
    front, owner = np.zeros(shape), np.full(shape, -1)
    for y in range(shape[0]):
        for x in range(shape[1]):
            point = (np.array([x, y]) + corner + 0.5) / samples - 0.5
            for t, triangle in enumerate(triangles):
                corners = np.vstack([xy[triangle].T, np.ones(3)])
                if abs(np.linalg.det(corners)) < 1e-9:
                    continue
                weights = np.linalg.solve(corners, [*point, 1.0])
                near = float(weights @ nearness[triangle])
                if (weights >= 0).all() and near > front[y, x]:
                    front[y, x], owner[y, x] = near, t
    return front, owner


def shade(xy, nearness, triangles, sheet, light, piece, facing, cells, colours, inks, print_rules, samples, corner, owner, size):
    """The picture (h, w, 4) and the samples in each circle, from what each sample of a window sees."""
    image, seen = np.zeros((*size, 4)), np.zeros(colours.shape, dtype=int)
    radius, soft, share = print_rules
    for y, x in np.argwhere(owner >= 0):
        corners = triangles[owner[y, x]]
        point = (np.array([x, y]) + corner + 0.5) / samples - 0.5
        flat = np.linalg.solve(np.vstack([xy[corners].T, np.ones(3)]), [*point, 1.0])
        weights = flat * nearness[corners] / (flat * nearness[corners]).sum()
        p, shown = piece[owner[y, x]], inks[-2]
        if p < 0:
            shown = inks[-1]
        elif facing[owner[y, x]]:
            place = weights @ sheet[corners]
            i, j = np.floor(place + 0.5).astype(int)
            if cells[p, 0] <= i <= cells[p, 1] and cells[p, 2] <= j <= cells[p, 3] and colours[i, j] >= 0:
                off = np.linalg.norm(place - [i, j])
                seen[i, j] += off <= radius
                cover = 0.5 * math.erfc((off - radius) / (math.sqrt(2) * soft))
                shown = inks[-2] + cover * (inks[colours[i, j]] - inks[-2])
        at = (y + corner[1]) // samples, (x + corner[0]) // samples
        image[at] += share * np.array([*(weights @ light[corners] * shown), 1.0])
    return image, seen
