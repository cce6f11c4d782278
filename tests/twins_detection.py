"""Detection's kernels again, slow and readable."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label as label_regions

BESIDE = ((-1, 0), (1, 0), (0, -1), (0, 1))


def grown(weight: np.ndarray, step: float, lowest: float) -> list[set[tuple[int, int]]]:
    """The pixels (row, column) of each blob that grows from a peak: see `_grow` in detection's kernels. weight (H, W), 0 where dark."""
    padded = {place: float(w) for place, w in np.ndenumerate(weight)}
    at = lambda r, c: padded.get((r, c), 0.0)  # noqa: E731
    components, _ = label_regions(weight > 0, np.ones((3, 3)))
    blobs: list[set[tuple[int, int]]] = []
    for component in range(1, components.max() + 1):
        pixels = [tuple(map(int, place)) for place in np.argwhere(components == component)]
        owner: dict[tuple[int, int], int] = {}
        peaks: list[float] = []
        for r, c in pixels:
            around = [at(r + dr, c + dc) for dr in (-1, 0, 1) for dc in (-1, 0, 1)]
            if (r, c) in owner or at(r, c) <= lowest or at(r, c) < max(around):
                continue
            owner[r, c] = len(peaks)
            reached = [(r, c)]
            for row, column in reached:
                for dr, dc in BESIDE:
                    near = (row + dr, column + dc)
                    brightest = max(at(*near), *(at(near[0] + er, near[1] + ec) for er, ec in BESIDE))
                    if at(*near) > 0 and near not in owner and brightest <= at(row, column) + step:
                        owner[near] = len(peaks)
                        reached.append(near)
            peaks.append(at(r, c))
        group = list(range(len(peaks)))
        for a in range(len(peaks)):
            for b in range(a + 1, len(peaks)):
                mine, other = ([place for place in owner if owner[place] == k] for k in (a, b))
                if any(max(abs(p[0] - q[0]), abs(p[1] - q[1])) <= 1 for p in mine for q in other):
                    ends = [np.average(side, axis=0, weights=[at(*place) for place in side]) for side in (mine, other)]
                    away = float(np.linalg.norm(ends[1] - ends[0]))
                    line = [ends[0] + k / away * (ends[1] - ends[0]) for k in range(1, int(np.ceil(away)))] if away >= 2 else []
                    if all(at(int(r + 0.5), int(c + 0.5)) >= max(peaks[a], peaks[b]) - step for r, c in line):
                        group = [group[a] if g == group[b] else g for g in group]
        blobs += [{place for place in owner if group[owner[place]] == g} for g in dict.fromkeys(group)]
    return blobs


def crossing(flat, offsets, cameras, a, b, frames, essential, near, longest, crowd, fewest) -> list[float]:
    """The share of camera a's blobs with one of b's within `near` of their epipolar line, at each lag: see detection's kernel."""
    of = lambda frame, camera: flat[offsets[frame * cameras + camera] : offsets[frame * cameras + camera + 1]]  # noqa: E731
    scores = []
    for lag in range(-longest, longest + 1):
        pairs = [(of(f, a), of(f + lag, b)) for f in frames if 0 <= f + lag < (len(offsets) - 1) // cameras]
        pairs = [pair for pair in pairs if 0 < len(pair[1]) <= crowd]
        hits = []
        for mine, others in pairs:
            for place in mine:
                line = essential @ [*place, 1.0]
                away = np.abs(np.column_stack([others, np.ones(len(others))]) @ line) / np.hypot(line[0], line[1])
                hits.append(away.min() < near)
        scores.append(np.mean(hits) if len(pairs) >= fewest and hits else np.nan)
    return scores


def raised(image: np.ndarray, level: np.ndarray, largest: float, noise: float, some: int) -> np.ndarray:
    """The level (H, W) with components larger than `largest` as grounds of their own: see `raise_levels` in detection's kernels."""
    out = level.astype(float)
    components, count = label_regions(image > level, np.ones((3, 3)))
    for component in range(1, count + 1):
        values = image[components == component].astype(float)
        if len(values) > largest:
            values = np.sort(values[:: -(-len(values) // some)])
            middle, quarter = values[len(values) // 2], values[len(values) // 4]
            own = middle + 6 * max(noise, (middle - quarter) / 0.6745)
            out[components == component] = np.maximum(out[components == component], min(own, np.iinfo(image.dtype).max))
    return np.floor(out).astype(image.dtype)


def contrast(image: np.ndarray, xy: np.ndarray, extent: np.ndarray) -> float:
    """How much brighter a blob's box is than the pixels 2 px around it: see `stand_out` in detection's kernels."""
    left, upper = np.trunc(xy - extent / 2).astype(int) - 2
    right, lower = np.ceil(xy + extent / 2).astype(int) + 2
    box = np.full((lower - upper + 1, right - left + 1), np.nan)
    for row, column in np.ndindex(box.shape):
        if 0 <= row + upper < image.shape[0] and 0 <= column + left < image.shape[1]:
            box[row, column] = image[row + upper, column + left]
    inner = box[1:-1, 1:-1].copy()
    box[1:-1, 1:-1] = np.nan
    around = np.sort(box[np.isfinite(box)])
    return float(max(np.nanmax(inner), 0) - around[len(around) // 2])
