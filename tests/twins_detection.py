"""Detection's kernels again, slow and readable."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label as label_regions

BESIDE = ((-1, 0), (1, 0), (0, -1), (0, 1))


def grown(weight: np.ndarray, step: float, lowest: float) -> list[set[tuple[int, int]]]:
    """The pixels (row, column) of each blob that grows from a peak: see `grow_from_peaks`. weight (H, W), 0 where dark."""
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
    """The level (H, W) raised in components larger than `largest`: see `raise_threshold`."""
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
    """How much brighter a blob's box is than the pixels 2 px around it: see `stands_out`."""
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


def parted(weight: np.ndarray, share: float) -> list[set[tuple[int, int]]]:
    """The pixels (row, column) of the blobs that a component parts into at its saddles: see `split_at_saddles`. 0 around the component."""
    pixels = [tuple(map(int, place)) for place in np.argwhere(weight > 0)]
    around = [(dr, dc) for dr in (-1, 0, 1) for dc in (-1, 0, 1)]
    distance = edge_distance(weight)
    height = {p: distance[p] * sum(int(weight[p[0] + dr, p[1] + dc]) for dr, dc in around) for p in pixels}
    blobs: list[list[tuple[int, int]]] = []  # the first pixel of each is its peak
    for r, c in sorted(pixels, key=lambda p: (-height[p], p)):
        home: list[tuple[int, int]] | None = None
        for other in [(r + dr, c + dc) for dr, dc in around]:
            group = next((blob for blob in blobs if other in blob), None)
            if group is None or group is home:
                continue
            if home is None:
                home = group
                continue
            high, low = sorted((home, group), key=lambda blob: (-height[blob[0]], blob[0]))
            if height[low[0]] - height[r, c] < share * height[low[0]]:
                high += low
                blobs = [blob for blob in blobs if blob is not low]
            home = high
        if home is None:
            blobs.append([(r, c)])
        else:
            home.append((r, c))
    return [set(blob) for blob in blobs]


def edge_distance(weight: np.ndarray) -> np.ndarray:
    """The shortest way of each pixel to one without weight, 3 for a step aside and 4 for one across, by relaxing until nothing changes."""
    away = np.where(weight > 0, 10**6, 0)
    steps = [((dr, dc), 3 if 0 in (dr, dc) else 4) for dr in (-1, 0, 1) for dc in (-1, 0, 1) if (dr, dc) != (0, 0)]
    while True:
        nearer = np.min([away, *(np.roll(away, step, axis=(0, 1)) + cost for step, cost in steps)], axis=0)
        if (nearer == away).all():
            return away
        away = nearer


def shared(weight: np.ndarray, places: np.ndarray, centres: np.ndarray, spread: float, settled: float) -> np.ndarray:
    """Centres (m, 2) of round Gaussians after expectation and maximization over weighted pixels (n,), (n, 2): see `share_pixels`."""
    spreads, totals = np.full(len(centres), spread + 0.1), np.full(len(centres), 1000.0)
    for _ in range(100):
        squares = ((places[:, None] - centres[None]) ** 2).sum(axis=2)
        share = totals / spreads * np.exp(-0.5 * squares / spreads)
        part = weight[:, None] * share / share.sum(axis=1, keepdims=True)
        totals = part.sum(axis=0)
        moved = part.T @ places / totals[:, None]
        spreads = 0.5 * ((part.T @ (places**2)) / totals[:, None] - moved**2).sum(axis=1) + 0.1
        still = np.abs(moved - centres).max() < settled
        centres = moved
        if still:
            break
    return centres
