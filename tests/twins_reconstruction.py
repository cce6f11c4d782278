"""Reconstruction's kernels that decide, again: slow, readable, with sets and lists instead of arrays that are filled in place."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise
from math import atan2, inf, pi

import numpy as np

from asterism.cameras import Rig
from asterism.reconstruction._compose_kernels import LEAST_BASELINE_SINE, WELL_SUPPORTED_CAMERAS, _grow_hypothesis
from asterism.reconstruction._fit_kernels import MOST_DROPPED, FitWorkspace, fit, fit_and_prune, fit_workspace
from asterism.reconstruction._input_kernels import END, FIRST, GAIN, GATE, LENS, MISSING, NOISE, PRIOR, FrameArrays, RigArrays
from asterism.reconstruction._score_kernels import BORDER, MERGED, best_blob, score
from asterism.reconstruction._shared_kernels import LEAST_RIVAL, MULTI_CAMERA

Rays = tuple[int, ...]


def first_of_duplicates(xy: np.ndarray, offsets: np.ndarray) -> list[bool]:
    """Whether a blob is the first of its image at its position."""
    first = []
    for begin, end in pairwise(offsets):
        seen: set[tuple[float, float]] = set()
        for x, y in xy[begin:end].tolist():
            first.append((x, y) not in seen)
            seen.add((x, y))
    return first


def normal_equations(
    rig: RigArrays, frame: FrameArrays, rays: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, dict[int, float]]:
    """Information (3, 3) 1/m2, gradient (3,) 1/m and each camera's squared residual in units of the noise, at a point in front of all."""
    information, gradient, squares = np.zeros((3, 3)), np.zeros(3), {}
    for c in np.flatnonzero(rays >= 0).tolist():
        rotation, translation = rig.cameras[c, :9].reshape(3, 3), rig.cameras[c, 9:12]
        u, v, w = rotation @ x + translation
        blob = frame.blobs[rays[c]]
        to_pixels = blob[2:6].reshape(2, 2) / rig.cameras[c, NOISE]
        residual = to_pixels @ (blob[:2] - np.array([u, v]) / w)
        jacobian = to_pixels @ (rotation[:2] - np.outer([u / w, v / w], rotation[2])) / w
        information += jacobian.T @ jacobian
        gradient += jacobian.T @ residual
        squares[c] = float(residual @ residual)
    return information, gradient, squares


def pruned(rig: RigArrays, frame: FrameArrays, rays: np.ndarray, x: np.ndarray, steps: int) -> tuple[list[int], bool]:
    """The rays that are left when those that do not fit were dropped, worst first; and whether a point is left."""
    rays, x = rays.copy(), x.copy()
    limit = rig.limits[GATE] ** 2
    for _ in range(MOST_DROPPED + 1):
        for _ in range(steps):
            information, gradient, _ = normal_equations(rig, frame, rays, x)
            x = x + np.linalg.solve(information, gradient)
        squares = normal_equations(rig, frame, rays, x)[2]
        worst = max(squares, key=squares.__getitem__)
        if squares[worst] <= limit and (len(squares) > 2 or sum(squares.values()) <= limit):
            return rays.tolist(), True
        if len(squares) <= 2:
            return rays.tolist(), False
        rays[worst] = -1
    return rays.tolist(), False


def scored(
    arrays: RigArrays, rig: Rig, frame: FrameArrays, rays: np.ndarray, work: FitWorkspace, square: float, bounds: np.ndarray
) -> float:
    """nats: see `score`; pixels by the rig's own projection, the determinant by NumPy."""
    xx, xy, xz, yy, yz, zz = work.information
    determinant = np.linalg.det(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if not determinant > 0 or not square < inf:
        return -inf
    total = float(arrays.limits[PRIOR]) - 0.5 * np.log(determinant) - 0.5 * square
    for c, camera in enumerate(rig):
        pixel = camera.project(work.point)
        visible = np.isfinite(pixel).all() and (pixel >= bounds[0, c] + BORDER).all() and (pixel <= bounds[1, c] - BORDER).all()
        if rays[c] >= 0:
            total += arrays.cameras[c, GAIN]
        elif visible:
            u, v, w = camera.rotation @ work.point + camera.translation
            own = frame.blobs[int(frame.grid[c, FIRST]) : int(frame.grid[c, END]), :2]
            reach = MERGED / arrays.cameras[c, LENS : LENS + 2]
            if not (np.abs(own - [u / w, v / w]) <= reach).all(axis=1).any():
                total += arrays.cameras[c, MISSING]
    return total


def composed(rig: RigArrays, frame: FrameArrays) -> tuple[list[Rays], int]:
    """The rays of all hypotheses in the order in which they are found, and how many pairs pass the gate; by trying all pairs of blobs."""
    found: list[Rays] = []
    well_supported: set[int] = set()
    gated, gate = 0, rig.limits[GATE]
    for pair, (a, b) in enumerate(rig.pairs.tolist()):
        firsts = {c: (int(frame.grid[c, FIRST]), int(frame.grid[c, END])) for c in (a, b)}
        angles = {c: {blob: _angle(rig, frame, pair, c, blob) for blob in range(*firsts[c])} for c in (a, b)}
        for i, (angle, variance) in angles[a].items():
            partners = []
            for turn in (-1, 0, 1):
                aim = angle + 2 * pi * turn
                near = [(other, j) for j, (other, spread) in angles[b].items() if (other - aim) ** 2 <= gate**2 * (variance + spread)]
                partners += [j for _, j in sorted(near)] if angle < inf else []
            gated += len(partners)
            for j in partners:
                covered = any(rays[a] == i and rays[b] == j for rays in found)
                if covered or {i, j} <= well_supported:
                    continue
                rays, work = np.empty(len(rig.cameras), np.int64), fit_workspace()
                many, worth = _grow_hypothesis(rig, frame, pair, i, j, np.ones(len(frame.blobs), np.bool_), rays, work)
                if worth > 0 and tuple(rays.tolist()) not in found:
                    found.append(tuple(rays.tolist()))
                    if many >= WELL_SUPPORTED_CAMERAS:
                        well_supported |= set(rays[rays >= 0].tolist())
    return found, gated


def _angle(rig: RigArrays, frame: FrameArrays, pair: int, c: int, blob: int) -> tuple[float, float]:
    """A blob's epipolar angle (rad) about a pair's baseline, and its variance, by a numerical derivative; infinite along the baseline."""
    rotation = rig.cameras[c, :9].reshape(3, 3)

    def about(xy: np.ndarray) -> tuple[float, float]:
        ray = rotation.T @ [*xy, 1.0]
        across = rig.axes[pair] @ ray
        return atan2(across[1], across[0]), float(np.linalg.norm(across) / np.linalg.norm(ray))

    xy, to_pixels = frame.blobs[blob, :2], frame.blobs[blob, 2:6].reshape(2, 2)
    angle, sine = about(xy)
    if sine < LEAST_BASELINE_SINE:
        return inf, 0.0
    step = 1e-6
    slopes = [((about(xy + step * d)[0] - about(xy - step * d)[0] + pi) % (2 * pi) - pi) / (2 * step) for d in np.eye(2)]
    per_pixel = np.linalg.solve(to_pixels.T, slopes)
    return angle, float(rig.cameras[c, NOISE] ** 2 * per_pixel @ per_pixel)


def without_shared(
    rig: RigArrays, frame: FrameArrays, rays: np.ndarray, points: np.ndarray, scores: np.ndarray
) -> list[tuple[Rays, float]]:
    """What `add_without_shared` adds to hypotheses (n, C): the rays and score of each."""
    added: list[tuple[Rays, float]] = []
    members = [n for n in range(len(rays)) if (rays[n] >= 0).sum() >= MULTI_CAMERA]
    for n in members:
        own: set[Rays] = set()
        for blob in rays[n][rays[n] >= 0]:
            for rival in members:
                if rival == n or blob not in rays[rival] or scores[rival] < LEAST_RIVAL * scores[n]:
                    continue
                left = np.where(rays[n] == rays[rival], -1, rays[n])
                if (left >= 0).sum() < max(2, rig.limits[2]) or tuple(left.tolist()) in own:
                    continue
                work = fit_workspace()
                work.point[:] = points[n]
                worth = score(rig, frame, left, work, fit(rig, frame, left, work, 2)[0])
                low, high = rig.limits[3:6], rig.limits[6:9]
                if worth > 0 and (low <= work.point).all() and (work.point <= high).all():
                    own.add(tuple(left.tolist()))
                    added.append((tuple(left.tolist()), worth))
    return added


def attached(rig: RigArrays, frame: FrameArrays, rays: np.ndarray, point: np.ndarray, available: set[int]) -> tuple[Rays, set[int]]:
    """The rays of a point with the available blobs that it fits, and the blobs that are available then."""
    work = fit_workspace()
    work.point[:] = point
    fit(rig, frame, rays, work, 1)
    mask = np.array([blob in available for blob in range(len(frame.blobs))])
    wider = np.array([ray if ray >= 0 else best_blob(rig, frame, c, work, mask)[0] for c, ray in enumerate(rays)])
    square, left = fit_and_prune(rig, frame, wider, work, 1)
    if square == inf or left < (rays >= 0).sum():
        return tuple(rays.tolist()), available
    lost = {int(ray) for ray in rays if ray >= 0} - set(wider.tolist())
    return tuple(wider.tolist()), (available | lost) - set(wider.tolist())


def visibility(rig: Rig, points: np.ndarray, rays: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many points of three other rays or more lie inside each camera's image, and how many of them it saw."""
    pixels = rig.project(points)
    expected, seen = np.zeros(len(rig), int), np.zeros(len(rig), int)
    for c in range(len(rig)):
        inside = ((pixels[c] >= bounds[0, c] + BORDER) & (pixels[c] <= bounds[1, c] - BORDER)).all(axis=1)
        others = (np.delete(rays, c, axis=1) >= 0).sum(axis=1) >= 3
        expected[c], seen[c] = (inside & others).sum(), (inside & others & (rays[:, c] >= 0)).sum()
    return expected, seen


def merged(
    rays: np.ndarray, points: np.ndarray, order: list[int], limit: Callable[[int, int, np.ndarray], float]
) -> list[tuple[Rays, np.ndarray]]:
    """Versions of points as groups: the rays of each, and the mean of its versions.

    `limit` (m) of a version, the first version of a group and the place between version and group: nearer ones are one point.
    """
    groups: list[list[int]] = []
    for n in order:
        nearest = inf
        home = None
        for group in groups:
            place = np.mean(points[group], axis=0)
            distance = float(np.linalg.norm(place - points[n]))
            union = rays[group].max(axis=0)
            fits = ((rays[n] < 0) | (union < 0) | (rays[n] == union)).all()
            if distance < nearest and fits and distance < limit(n, group[0], (place + points[n]) / 2):
                nearest, home = distance, group
        if home is None:
            groups.append([n])
        else:
            home.append(n)
    return [(tuple(rays[group].max(axis=0).tolist()), points[group].mean(axis=0)) for group in groups]


def conflict_free(rays: np.ndarray, chosen: tuple[int, ...]) -> bool:
    """Whether no blob is in two of the chosen hypotheses."""
    taken = [int(blob) for n in chosen for blob in rays[n] if blob >= 0]
    return len(set(taken)) == len(taken)


def best_set(rays: np.ndarray, scores: np.ndarray) -> float:
    """The greatest total score of a set without conflict, by trying all sets."""
    sets = (chosen for size in range(len(rays) + 1) for chosen in combinations(range(len(rays)), size))
    return max(float(scores[list(chosen)].sum()) for chosen in sets if conflict_free(rays, chosen))


def exchanged(rays: np.ndarray, scores: np.ndarray, chosen: set[int]) -> set[int]:
    """A set improved by putting one hypothesis in, its rivals out and then in what became free, while that is worth more.

    Hypotheses are by falling score.
    """
    blobs = [set(row[row >= 0].tolist()) for row in rays]
    improved = True
    while improved:
        improved = False
        for k in range(len(rays)):
            if k in chosen:
                continue
            removed = [n for n in _in_order(rays[k], blobs) if n in chosen]
            trial = (chosen - set(removed)) | {k}
            for r in removed:
                for n in _in_order(rays[r], blobs):
                    if n not in trial and not any(blobs[n] & blobs[other] for other in trial):
                        trial = trial | {n}
            if scores[list(trial)].sum() > scores[list(chosen)].sum() + 1e-9:
                chosen, improved = trial, True
    return chosen


def _in_order(row: np.ndarray, blobs: list[set[int]]) -> list[int]:
    """The hypotheses that share a blob with a row of rays, blob by blob, each once."""
    return list(dict.fromkeys(n for blob in row if blob >= 0 for n in range(len(blobs)) if int(blob) in blobs[n]))
