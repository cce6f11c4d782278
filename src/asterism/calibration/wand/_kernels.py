"""Which blobs are the wand: in single images by line and ratio, then by what several posed cameras agree on."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.cameras._kernels import CX, CY, FX, FY, distorted
from asterism.geometry._kernels import nearest_to_rays

MOST_BLOBS = 40
"""Images with more blobs than this are not searched for a wand."""
PARALLEL = 1e-7
"""Of the normal equations' determinant per cubed number of rays: rays below it count as parallel."""


@kernel
def find_lines(xy, offsets, share, depth_ratio, slack, bend, shortest, symmetric, detections, certain):
    """The three blobs of a wand in each image: in line, the inner one where the ratio and perspective allow it.

    IN  xy (P, 2) px; offsets (cells + 1,): whose blobs; share: d_UV / d_UW of the wand, in (0, 1); depth_ratio > 1: how much farther one
        end can be than the other; slack (px) and bend (share of the length): how far the inner blob may be off the line, by noise and by
        the lens; shortest: px between the ends; symmetric: the order of the markers need not be certain
    OUT detections (cells, 3) int: places of U, V, W in xy, -1 where there is no wand; certain (cells,) bool: no other choice or order is
        nearly as good
    O(sum n^3) over images of n blobs. A point at share a of a segment whose ends are at depths z_U and z_W is seen at
    a z_W / ((1 - a) z_U + a z_W) of its image. Twin: tests/twins_wand.py
    """
    limit = math.log(depth_ratio)
    aim = math.log(share / (1.0 - share))
    for cell in range(len(detections)):
        detections[cell, :] = -1
        certain[cell] = False
        first, last = offsets[cell], offsets[cell + 1]
        if last - first < 3 or last - first > MOST_BLOBS:
            continue
        best, second = 2.0, 2.0
        middle, one_end, other_end = -1, -1, -1
        for i in range(first, last):
            for j in range(i + 1, last):
                dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
                length = math.sqrt(dx * dx + dy * dy)
                if length < shortest:
                    continue
                for k in range(first, last):
                    if k in (i, j):
                        continue
                    px, py = xy[k, 0] - xy[i, 0], xy[k, 1] - xy[i, 1]
                    along = (px * dx + py * dy) / (length * length)
                    if along <= 0.0 or along >= 1.0:
                        continue
                    off = abs(px * dy - py * dx) / length / (slack + bend * length)
                    if off > 1.0:
                        continue
                    seen = math.log(along / (1.0 - along))
                    for turned in range(2):
                        tilt = abs((-seen if turned else seen) - aim) / limit
                        if tilt > 1.0:
                            continue
                        score = off + tilt
                        same = symmetric and k == middle and i == one_end and j == other_end
                        if score < best:
                            best, second = score, second if same else best
                            middle, one_end, other_end = k, i, j
                            detections[cell, 0], detections[cell, 1], detections[cell, 2] = (j, k, i) if turned else (i, k, j)
                        elif score < second and not same:
                            second = score
        certain[cell] = detections[cell, 0] >= 0 and second > best + 0.35


@kernel(inline=True)
def _pixel(lens, rotation, translation, x, y, z):
    depth = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2]
    if not depth > 1e-6:
        return np.nan, np.nan
    u = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0]) / depth
    v = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1]) / depth
    a, b, ux, uy, vx, vy = distorted(lens, u, v)
    if not (ux * vy - uy * vx > 0.0 and ux + vy > 0.0):
        return np.nan, np.nan
    return lens[FX] * a + lens[CX], lens[FY] * b + lens[CY]


@kernel(inline=True)
def _fit_line(lengths, points, there, start, direction):
    """The wand nearest to its markers' positions (K, 3): its first marker's place and its direction; False where it has none."""
    n, mean = 0, 0.0
    start[:] = 0.0
    for k in range(len(lengths)):
        if there[k]:
            n += 1
            mean += lengths[k]
            for j in range(3):
                start[j] += points[k, j]
    if n == 0:
        return False
    mean /= n
    start /= n
    direction[:] = 0.0
    if len(lengths) == 1:
        direction[0] = 1.0
        return True
    for k in range(len(lengths)):
        if there[k]:
            for j in range(3):
                direction[j] += (lengths[k] - mean) * (points[k, j] - start[j])
    size = math.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    if n < 2 or not size > 1e-12:
        return False
    for j in range(3):
        direction[j] /= size
        start[j] -= mean * direction[j]
    return True


@kernel(inline=True)
def _support(frame, lengths, start, direction, lens, rotation, translation, posed, xy, offsets, gate, observations):
    """How well the images agree with a wand lying there: 0 to 1 per marker and camera; writes the blobs (C, K) that do."""
    total, cameras = 0.0, len(posed)
    for c in range(cameras):
        for k in range(len(lengths)):
            observations[c, k] = -1
        first, last = offsets[frame * cameras + c], offsets[frame * cameras + c + 1]
        if not posed[c] or first == last:
            continue
        for k in range(len(lengths)):
            u, v = _pixel(
                lens[c], rotation[c], translation[c],
                start[0] + lengths[k] * direction[0], start[1] + lengths[k] * direction[1], start[2] + lengths[k] * direction[2],
            )  # fmt: skip
            if not math.isfinite(u):
                continue
            nearest = gate[c] * gate[c]
            for b in range(first, last):
                square = (xy[b, 0] - u) ** 2 + (xy[b, 1] - v) ** 2
                if square < nearest:
                    taken = False
                    for other in range(k):
                        taken = taken or observations[c, other] == b
                    if not taken:
                        nearest = square
                        observations[c, k] = b
            if observations[c, k] >= 0:
                total += 1.0 - nearest / (gate[c] * gate[c])
    return total


@kernel
def locate_wand(
    xy, rays, offsets, detections, lengths, symmetric, lens, rotation, translation, origins, posed, gate,
    starts, directions, observations, support,
):  # fmt: skip
    """Where the wand lay in each frame by what posed cameras agree on, whatever single images took for it.

    Every pair of cameras that found a wand proposes one; the one that most blobs of all posed cameras lie on is taken, laid again by all of
    these, and the blobs on it are its sightings.

    IN  xy (P, 2) px and rays (P, 3), unit directions in the world, of all blobs; offsets (T * C + 1,); detections (T, C, K): blobs
        by single images, -1 for none; lengths (K,) m from the wand's first marker; symmetric: whether images leave the order of the
        markers open; lens (C, LENS), rotation (C, 3, 3), translation (C, 3), origins (C, 3) m of the cameras, posed (C,) bool;
        gate (C,) px
    OUT starts (T, 3) m, directions (T, 3): NaN where no two cameras agree; observations (T, C, K) int: blobs on the wand; support (T,)
    O(T * C^2 * C * K). Twin: tests/twins_wand.py
    """
    frames, cameras, markers = detections.shape
    origin, ray, normal, right = np.empty((cameras, 3)), np.empty((cameras, 3)), np.empty((3, 3)), np.empty(3)
    points, there = np.empty((markers, 3)), np.zeros(markers, np.bool_)
    start, direction, tried = np.empty(3), np.empty(3), np.empty((cameras, markers), np.int64)
    for t in range(frames):
        starts[t], directions[t], support[t] = np.nan, np.nan, 0.0
        observations[t] = -1
        found, seen = 0, 0
        for c in range(cameras):
            if posed[c]:
                found += 1 if detections[t, c, 0] >= 0 else 0
                seen += min(offsets[t * cameras + c + 1] - offsets[t * cameras + c], markers)
        if found < 2:
            continue
        done = False
        for a in range(cameras):
            if done or not posed[a] or detections[t, a, 0] < 0:
                continue
            for b in range(a + 1, cameras):
                if done or not posed[b] or detections[t, b, 0] < 0:
                    continue
                for turned in range(2 if symmetric and markers > 1 else 1):
                    for k in range(markers):
                        i, j = detections[t, a, k], detections[t, b, markers - 1 - k if turned else k]
                        origin[0], origin[1] = origins[a], origins[b]
                        ray[0], ray[1] = rays[i], rays[j]
                        there[k] = math.isfinite(ray[0, 0] + ray[1, 0]) and nearest_to_rays(
                            origin, ray, 0, 2, PARALLEL, normal, right, points[k]
                        )
                    if not _fit_line(lengths, points, there, start, direction):
                        continue
                    score = _support(t, lengths, start, direction, lens, rotation, translation, posed, xy, offsets, gate, tried)
                    if score > support[t]:
                        support[t] = score
                        starts[t], directions[t] = start, direction
                        observations[t] = tried
                        done = score > 0.9 * seen
        for _ in range(2):
            if support[t] == 0.0:
                break
            for k in range(markers):
                n = 0
                for c in range(cameras):
                    if observations[t, c, k] >= 0 and math.isfinite(rays[observations[t, c, k], 0]):
                        origin[n], ray[n] = origins[c], rays[observations[t, c, k]]
                        n += 1
                there[k] = n >= 2 and nearest_to_rays(origin, ray, 0, n, PARALLEL, normal, right, points[k])
            if not _fit_line(lengths, points, there, start, direction):
                break
            score = _support(t, lengths, start, direction, lens, rotation, translation, posed, xy, offsets, gate, tried)
            if score <= support[t]:
                break
            support[t] = score
            starts[t], directions[t] = start, direction
            observations[t] = tried
