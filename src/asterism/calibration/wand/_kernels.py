"""Which blobs are the wand: in single images by line and ratio, then by what several posed cameras agree on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.cameras.lens_kernels import CX, CY, FX, FY, distorted
from asterism.geometry.shared_kernels import nearest_to_rays

MOST_BLOBS = 40
"""Images with more blobs than this are not searched for a wand."""
PARALLEL = 1e-7
"""Of the normal equations' determinant per cubed number of rays: rays below it count as parallel."""
NEARLY_ALL = 0.9
"""Share of the blobs that may be on the wand: a proposal with a higher support is taken without a look at the others."""


class WandImages(NamedTuple):
    """P blobs of T frames and C cameras, and what single images took for the wand's K markers.

    xy          (P, 2) px
    rays        (P, 3) unit directions in the world, NaN where there is none
    offsets     (T * C + 1,) where the blobs of each image begin
    detections  (T, C, K) int: rows of xy, -1 for none
    """

    xy: np.ndarray
    rays: np.ndarray
    offsets: np.ndarray
    detections: np.ndarray


class WandCameras(NamedTuple):
    """C cameras.

    lens                   (C, LENS)
    rotation, translation  (C, 3, 3), (C, 3) m: the world into each camera
    origin                 (C, 3) m
    posed                  (C,) bool; what is not posed yet does not count
    gate                   (C,) px, how far a blob may be from the wand
    """

    lens: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    origin: np.ndarray
    posed: np.ndarray
    gate: np.ndarray


class WandPlaces(NamedTuple):
    """Where the wand lay in T frames.

    start, direction  (T, 3) m: its first marker and its unit direction; NaN where no two cameras agree
    observations      (T, C, K) int: the blobs on it, -1 for none
    support           (T,) how well the images agree: 0 to 1 per marker and camera, added
    """

    start: np.ndarray
    direction: np.ndarray
    observations: np.ndarray
    support: np.ndarray


class WandWorkspace(NamedTuple):
    """Working arrays: C rays, the normal equations of their crossing, the K markers of a proposal, and the proposal itself."""

    origin: np.ndarray
    ray: np.ndarray
    normal: np.ndarray
    right: np.ndarray
    points: np.ndarray
    there: np.ndarray
    start: np.ndarray
    direction: np.ndarray
    observations: np.ndarray


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
        # A second choice nearly as good leaves it open.
        certain[cell] = False
        first, last = offsets[cell], offsets[cell + 1]
        # Triples of many blobs are too many, and one of them is in line by chance.
        if last - first < 3 or last - first > MOST_BLOBS:
            continue
        best, second = 2.0, 2.0
        middle, one_end, other_end = -1, -1, -1
        for i in range(first, last):
            for j in range(i + 1, last):
                dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
                length = math.sqrt(dx * dx + dy * dy)
                # So short a wand is not seen well enough to tell its ends.
                if length < shortest:
                    continue
                for k in range(first, last):
                    if k in (i, j):
                        continue
                    px, py = xy[k, 0] - xy[i, 0], xy[k, 1] - xy[i, 1]
                    along = (px * dx + py * dy) / (length * length)
                    # The inner marker lies between the ends, however the wand is seen.
                    if along <= 0.0 or along >= 1.0:
                        continue
                    # Noise, and the lens, which bends a long line more.
                    off = abs(px * dy - py * dx) / length / (slack + bend * length)
                    if off > 1.0:
                        continue
                    # In log odds of the share, perspective only adds the log of the ends' ratio of depths.
                    seen = math.log(along / (1.0 - along))
                    # Either end may be the first marker.
                    for turned in range(2):
                        tilt = abs((-seen if turned else seen) - aim) / limit
                        if tilt > 1.0:
                            continue
                        score = off + tilt
                        # The other order of the same blobs is no rival where the order does not matter.
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
    # Beyond the fold of the lens model no pixel is meant.
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
    # One marker has no direction: any one serves.
    if len(lengths) == 1:
        direction[0] = 1.0
        return True
    for k in range(len(lengths)):
        if there[k]:
            for j in range(3):
                # The first moment about the middle is the least-squares direction, since the distances along it are known.
                direction[j] += (lengths[k] - mean) * (points[k, j] - start[j])
    size = math.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    # One marker, or all in one place.
    if n < 2 or not size > 1e-12:
        return False
    for j in range(3):
        direction[j] /= size
        start[j] -= mean * direction[j]
    return True


@kernel(inline=True)
def _nearest_blob(xy, first, last, u, v, gate, taken, markers):
    """The blob nearest to a pixel, within the gate and none of the first markers' blobs: its row, -1 for none, and its squared distance."""
    nearest, best = gate * gate, -1
    for b in range(first, last):
        square = (xy[b, 0] - u) ** 2 + (xy[b, 1] - v) ** 2
        # Nearest first, then the walk along what is taken: few blobs are near.
        if square < nearest:
            free = True
            for other in range(markers):
                free = free and taken[other] != b
            if free:
                nearest, best = square, b
    return best, nearest


@kernel
def _support(t, images, cameras, lengths, work):
    """How well the images agree with the wand in the workspace: 0 to 1 per marker and camera, added; writes the blobs (C, K) that do."""
    start, direction, observations = work.start, work.direction, work.observations
    total, many = 0.0, len(cameras.posed)
    for c in range(many):
        for k in range(len(lengths)):
            observations[c, k] = -1
        first, last = images.offsets[t * many + c], images.offsets[t * many + c + 1]
        # What is not posed yet cannot agree or disagree.
        if not cameras.posed[c] or first == last:
            continue
        gate = cameras.gate[c]
        for k in range(len(lengths)):
            u, v = _pixel(
                cameras.lens[c], cameras.rotation[c], cameras.translation[c],
                start[0] + lengths[k] * direction[0], start[1] + lengths[k] * direction[1], start[2] + lengths[k] * direction[2],
            )  # fmt: skip
            if not math.isfinite(u):
                continue
            observations[c, k], nearest = _nearest_blob(images.xy, first, last, u, v, gate, observations[c], k)
            if observations[c, k] >= 0:
                # A blob at the gate's edge counts nearly nothing, so that the gate is no cliff.
                total += 1.0 - nearest / (gate * gate)
    return total


@kernel
def _improve(t, images, cameras, lengths, places, work):
    """Lay the wand through the markers of the workspace, and keep it where more blobs lie on it than on the one so far."""
    if not _fit_line(lengths, work.points, work.there, work.start, work.direction):
        return False
    score = _support(t, images, cameras, lengths, work)
    # More blobs on the wand, or as many lying nearer.
    if not score > places.support[t]:
        return False
    places.support[t] = score
    places.start[t], places.direction[t] = work.start, work.direction
    places.observations[t] = work.observations
    return True


@kernel
def _propose(t, images, cameras, lengths, symmetric, places, work):
    """The best of the wands that pairs of cameras propose.

    Bounds: rows 0 and 1 of `work.origin` and `work.ray` are written for two different cameras only, so they have two rows.
    """
    many, markers = len(cameras.posed), len(lengths)
    possible = 0
    for c in range(many):
        if cameras.posed[c]:
            # No camera can support more markers than it has blobs.
            possible += min(images.offsets[t * many + c + 1] - images.offsets[t * many + c], markers)
    for a in range(many):
        # Only cameras in which a wand was found propose; the others are asked afterwards.
        if not cameras.posed[a] or images.detections[t, a, 0] < 0:
            continue
        for b in range(a + 1, many):
            if not cameras.posed[b] or images.detections[t, b, 0] < 0:
                continue
            for turned in range(2 if symmetric and markers > 1 else 1):
                for k in range(markers):
                    i, j = images.detections[t, a, k], images.detections[t, b, markers - 1 - k if turned else k]
                    work.origin[0], work.origin[1] = cameras.origin[a], cameras.origin[b]
                    work.ray[0], work.ray[1] = images.rays[i], images.rays[j]
                    work.there[k] = math.isfinite(work.ray[0, 0] + work.ray[1, 0]) and nearest_to_rays(
                        work.origin, work.ray, 0, 2, PARALLEL, work.normal, work.right, work.points[k]
                    )
                _improve(t, images, cameras, lengths, places, work)
            # So good a proposal is not worth the other pairs.
            if places.support[t] > NEARLY_ALL * possible:
                return


@kernel
def _lay_again(t, images, cameras, lengths, places, work):
    """Lay the wand through all blobs on it; whether more lie on it then.

    Bounds: n counts cameras, and `work.origin` and `work.ray` have a row for each.
    """
    for k in range(len(lengths)):
        n = 0
        for c in range(len(cameras.posed)):
            blob = places.observations[t, c, k]
            if blob >= 0 and math.isfinite(images.rays[blob, 0]):
                work.origin[n], work.ray[n] = cameras.origin[c], images.rays[blob]
                n += 1
        # One ray is no point.
        work.there[k] = n >= 2 and nearest_to_rays(work.origin, work.ray, 0, n, PARALLEL, work.normal, work.right, work.points[k])
    return _improve(t, images, cameras, lengths, places, work)


@kernel
def locate_wand(images, cameras, lengths, symmetric, places):
    """Where the wand lay in each frame by what posed cameras agree on, whatever single images took for it.

    Every pair of cameras that found a wand proposes one; the one that most blobs of all posed cameras lie on is taken, laid again by all of
    these, twice at most, and the blobs on it are its sightings.

    IN  images, cameras; lengths (K,) m from the wand's first marker; symmetric: whether images leave the order of the markers open
    OUT places
    O(T * C^2 * C * K). Twin: tests/twins_wand.py
    """
    frames, many, markers = images.detections.shape
    work = WandWorkspace(
        np.empty((many, 3)), np.empty((many, 3)), np.empty((3, 3)), np.empty(3), np.empty((markers, 3)), np.zeros(markers, np.bool_),
        np.empty(3), np.empty(3), np.empty((many, markers), np.int64),
    )  # fmt: skip
    for t in range(frames):
        places.start[t], places.direction[t], places.support[t] = np.nan, np.nan, 0.0
        places.observations[t] = -1
        _propose(t, images, cameras, lengths, symmetric, places, work)
        # With all its blobs the wand lies better, and may reach more blobs; after two times that is over.
        for _ in range(2):
            if places.support[t] == 0.0 or not _lay_again(t, images, cameras, lengths, places, work):
                break
