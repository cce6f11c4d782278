"""Slow, readable twins of the kernels that read garments."""

from __future__ import annotations

import cv2
import numpy as np


def colourfulness(image):
    """The spread of each pixel's channels without the border, and the largest of each 16 pixels of a row."""
    out = np.ptp(image, axis=2)
    out[[0, -1]] = 0
    out[:, [0, -1]] = 0
    blocks = out.shape[1] // 16 + 1
    padded = np.pad(out, ((0, 0), (0, 16 * blocks - out.shape[1])))
    return out, padded.reshape(len(out), blocks, 16).max(axis=2)


def first_regions(grey, lowest, limits):
    """Regions above the lowest threshold that are ellipses as they are: their boxes and highest values."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((grey > lowest).astype(np.uint8), connectivity=4)
    found = set()
    for k in range(1, count):
        x, y, w, h, area = stats[k]
        rows, cols = np.nonzero(labels == k)
        most = int(grey[rows, cols].max())
        moments = np.cov(np.stack([cols, rows]), bias=True) + np.eye(2) / 12
        fill = area / (4 * np.pi * np.sqrt(np.linalg.det(moments)))
        inside = x > 1 and y > 1 and x + w < grey.shape[1] - 1 and y + h < grey.shape[0] - 1
        if area >= limits[0] and area <= limits[1] and most - lowest >= limits[3] and fill >= limits[2] and inside:
            found.add((x, x + w - 1, y, y + h - 1, most))
    return found


def candidates(centres, whiten, reach, most):
    """The nearest others of each by its own ellipse."""
    out = np.full((len(centres), most), -1)
    for i in range(len(centres)):
        far = np.linalg.norm((centres - centres[i]) @ whiten[i].T, axis=1)
        order = [j for j in np.argsort(far, kind="stable") if j != i and far[j] <= reach][:most]
        out[i, : len(order)] = order
    return out


def rings(links):
    """The eight circles around each, by walking both ways to those between two directions."""
    out = np.full((len(links), 8), -1)
    for i in range(len(links)):
        for d in range(4):
            out[i, 2 * d] = links[i, d, 0]
            ends = set()
            for first, turn in ((d, 1), ((d + 1) % 4, -1)):
                j, back = links[i, first]
                if j >= 0:
                    ends.add(int(links[j, (back + 2 + turn) % 4, 0]))
            ends.discard(-1)
            out[i, 2 * d + 1] = ends.pop() if len(ends) == 1 else -1
    return out


def posteriors(points, centres, spreads, outliers):
    """Normal densities plus a constant, normalised."""
    density = np.empty((len(points), len(centres)))
    for k, (centre, spread) in enumerate(zip(centres, spreads, strict=True)):
        off = points - centre
        density[:, k] = np.exp(-0.5 * np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off)) / np.sqrt(np.linalg.det(spread)) + outliers
    return density / density.sum(axis=1, keepdims=True)
