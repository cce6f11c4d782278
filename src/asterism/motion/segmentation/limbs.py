"""A recording's trajectories in; limbs out: local subspace affinity, then rigidity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.motion.rigid._kernels import fit_frames, point_spread
from asterism.motion.rigid.limb import checked_positions
from asterism.motion.segmentation._kernels import stray_from_motions
from asterism.motion.segmentation.affinity import (
    fill_trajectories,
    local_subspaces,
    spectral_clusters,
    spread_landmarks,
    subspace_affinity,
    trajectory_coordinates,
)
from asterism.progress import Progress
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class SegmentationRules:
    """How limbs are found. Chosen on the simulated subjects 100 to 109 (seed 1): shoulder, knee, hip, leg; dense, sparse, with gaps.

    rank            dimensions in which trajectories are compared
    dimension       of local subspaces: 3, as GaMoCap has it; a patch of skin is flat
    neighbours      share of the points that span a local subspace; at least `least_neighbours`, at most `most_neighbours`
    landmarks       points to which affinities are computed
    clusters        with which the merging begins
    same_limb_m     two clusters are one limb where the smaller one's points stray less than this in the axes of the larger (median)
    rounds          of fitting limbs and assigning points anew
    fits            of a limb's motion in each round
    frames          clusters are merged on so many frames, evenly spread
    merge_rounds    of fitting and assigning after each merging
    smoothness_m    what it counts when all neighbours of a point are on another limb
    fill_rounds     of filling gaps
    least_points    a limb has at least so many points
    """

    rank: int = 16
    dimension: int = 3
    neighbours: float = 0.02
    least_neighbours: int = 4
    most_neighbours: int = 40
    landmarks: int = 250
    clusters: int = 8
    same_limb_m: float = 0.012
    rounds: int = 12
    fits: int = 3
    frames: int = 40
    merge_rounds: int = 3
    smoothness_m: float = 0.002
    fill_rounds: int = 10
    least_points: int = 3


RULES = SegmentationRules()


@dataclass(frozen=True)
class Segmentation:
    """Which points move together.

    limb_of    (N,) int, 0 to limbs - 1, the largest limb first; -1 for points that are never seen
    limbs      how many there are
    stray      (N, limbs) m, how far each point strays from its mean place in the axes of each limb; infinite where it cannot be said
    method     "lsa+rigidity" or "lsa"
    spectrum   (S,) singular values of the normalised affinity, the largest, 1, first
    merges     (median stray in m, limbs left) of each merging of two clusters, in order
    """

    limb_of: Ints
    limbs: int
    stray: Floats
    method: str
    spectrum: Floats
    merges: tuple[tuple[float, int], ...] = ()

    def fewer_than(self, asked: int | None, file: str) -> list[Finding]:
        """What to say where so many limbs were asked for, and these could be formed."""
        if asked is None or self.limbs >= asked:
            return []
        told = "the other points move as one of these, or fewer than three move together."
        sentence = f"{file}: {asked} limbs were asked for, and {self.limbs} were found: {told}"
        mend = f"Ask for {self.limbs}, or name each limb's markers with --markers."
        return [Finding("motion-fewer-limbs", Severity.WARNING, file, sentence, mend)]

    def points(self, limb: int) -> Ints:
        """The numbers of the points of one limb."""
        return np.nonzero(self.limb_of == limb)[0]


def segment_limbs(
    positions: ArrayLike,
    limbs: int | None = None,
    *,
    method: str = "lsa+rigidity",
    rules: SegmentationRules = RULES,
    progress: Progress | None = None,
) -> Segmentation:
    """The limbs that trajectories (T, N, 3) m belong to, NaN for missing samples.

    limbs   how many there are; None to find out: clusters are merged while the smaller one's points keep their places in the axes of the
            larger (`same_limb_m`). With method "lsa" it is the largest gap between singular values of the affinity (eigengap)
    method  "lsa+rigidity" begins with more clusters than limbs, merges what moves rigidly together, and assigns each point to the limb in
            whose axes it strays least; "lsa" is local subspace affinity alone, as in GaMoCap

    No random numbers: the same trajectories give the same limbs. Affinities to landmarks instead of all pairs: O(N (landmarks rank + T
    clusters)) time, O(N landmarks) memory. Raises AsterismError for other shapes, fewer than three points or two frames, points of which
    none is ever seen, and more limbs than the points can form.

    >>> from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue
    >>> leg = simulate_soft_tissue(TrialPlan("leg", points=90, frames=30), seed=3).recording
    >>> segment_limbs(leg.positions).limbs
    3
    """
    given = checked_positions(positions)
    if given.shape[0] < 2 or given.shape[1] < 3:
        raise AsterismError(f"{given.shape[1]} points in {given.shape[0]} frames have no limbs; three points and two frames are needed.")
    if limbs is not None and limbs < 1:
        raise AsterismError(f"{limbs} limbs were asked for; ask for one or more.")
    if method not in ("lsa+rigidity", "lsa"):
        raise AsterismError(f"{method} is no method; choose lsa+rigidity or lsa.")
    seen = np.isfinite(given[:, :, 0])
    # A point that is seen once has no motion.
    kept = np.nonzero(seen.sum(axis=0) >= 2)[0]
    if len(kept) < 3:
        raise AsterismError(f"only {len(kept)} points are seen in two frames or more; limbs need three points each.")
    if limbs is not None and limbs > len(kept) // 3:
        raise AsterismError(f"{len(kept)} points cannot form {limbs} limbs of three points each; ask for {len(kept) // 3} at most.")
    shown = np.ascontiguousarray(given[seen[:, kept].any(axis=1)][:, kept])  # a frame without any point compares none
    if progress is not None:
        progress(0.1, "comparing trajectories")
    coordinates, affinity = _affinity(shown, rules)
    if progress is not None:
        progress(0.5, "finding limbs")
    # More clusters than limbs: merging what moves together is easier than splitting what does not.
    start = max(rules.clusters, 2 * (limbs or 1)) if method == "lsa+rigidity" else (limbs or 0)
    spectrum = spectral_clusters(affinity, 1)[1]
    if start == 0:
        start = 1 + int(np.argmax(spectrum[:7] - spectrum[1:8])) if len(spectrum) > 8 else 1
    label = spectral_clusters(affinity, min(start, len(kept) // 3, affinity.shape[1]))[0]
    merges: tuple[tuple[float, int], ...] = ()
    if method == "lsa+rigidity":
        # Merging fits every cluster again and again: some frames, spread over the whole motion, keep it quick.
        some = np.unique(np.linspace(0, len(shown) - 1, min(rules.frames, len(shown))).round().astype(int))
        label, merges = _merge(np.ascontiguousarray(shown[some]), label, _neighbours(coordinates), limbs, rules)
        label = _split(shown, label, _neighbours(coordinates), limbs or 1, rules)
    label = _largest_first(label)
    count = int(label.max()) + 1
    stray = np.full((given.shape[1], count), np.inf)
    stray[kept] = _stray(shown, label, rules)
    limb_of = np.full(given.shape[1], -1)
    limb_of[kept] = label
    if progress is not None:
        progress(1.0, "finding limbs")
    return Segmentation(limb_of, count, stray, method, spectrum[: min(20, len(spectrum))], merges)


def _affinity(positions: Floats, rules: SegmentationRules) -> tuple[Floats, Floats]:
    """Coordinates (N, rank) m of the trajectories, and their affinity (N, landmarks)."""
    matrix = fill_trajectories(positions, rules.rank, rules.fill_rounds)
    coordinates = trajectory_coordinates(matrix, rules.rank)
    count = int(np.clip(round(rules.neighbours * len(coordinates)), rules.least_neighbours, rules.most_neighbours))
    # Directions, not sizes: a point far from the joint moves more, but in the same subspace.
    size = np.maximum(np.linalg.norm(coordinates, axis=1, keepdims=True), 1e-12)
    dimension = min(rules.dimension, coordinates.shape[1])
    bases = local_subspaces(coordinates / size, max(count, dimension), dimension)
    return coordinates, subspace_affinity(bases, spread_landmarks(coordinates, rules.landmarks))


def _neighbours(coordinates: Floats) -> Ints:
    """(N, k) int: the points that stay nearest to each point; none where there are few points."""
    count = min(9, len(coordinates) // 12)
    if count < 2:
        return np.empty((len(coordinates), 0), dtype=np.int64)
    return np.asarray(cKDTree(coordinates).query(coordinates, k=count)[1][:, 1:])


def _motions(positions: Floats, label: Ints, rules: SegmentationRules) -> tuple[Floats, Floats]:
    """The motions of all clusters, (L, T, 3, 3) and (L, T, 3) m: a few rounds of fitting, points that stray more weighing less."""
    count, frames = int(label.max()) + 1, len(positions)
    rotations, translations = np.full((count, frames, 3, 3), np.nan), np.full((count, frames, 3), np.nan)
    for limb in range(count):
        points = np.ascontiguousarray(positions[:, label == limb])
        size = points.shape[1]
        means, squares, counts = np.empty((size, 3)), np.empty(size), np.empty(size, dtype=np.int64)
        template = points[int(np.argmax(np.isfinite(points[:, :, 0]).sum(axis=1)))]
        weights = np.ones((1, size))
        # Points that belong elsewhere stray most, and count least in the next fit.
        for _ in range(rules.fits):
            fit_frames(template, points, weights, 0.01, rotations[limb], translations[limb])
            if not np.isfinite(rotations[limb, :, 0, 0]).any():
                break
            point_spread(points, rotations[limb], translations[limb], means, squares, counts)
            template = means.copy()
            scale = max(float(np.nanmedian(squares)), 1e-12)
            weights[0] = np.where(np.isfinite(squares), 1.0 / (1.0 + squares / scale), 1.0)
    return rotations, translations


def _stray(positions: Floats, label: Ints, rules: SegmentationRules) -> Floats:
    rotations, translations = _motions(positions, label, rules)
    out = np.empty((positions.shape[1], len(rotations)))
    stray_from_motions(positions, rotations, translations, out)
    return out


def _assign(stray: Floats, label: Ints, near: Ints, rules: SegmentationRules) -> Ints:
    """Each point to the limb in whose axes it strays least; neighbours on another limb count as `smoothness_m` of straying."""
    cost = stray.copy()
    if near.shape[1]:
        # A point among neighbours of another limb must stray clearly less to stay alone.
        for limb in range(stray.shape[1]):
            cost[:, limb] += rules.smoothness_m * (label[near] != limb).mean(axis=1)
    best = np.argmin(cost, axis=1)
    return np.where(np.isfinite(cost.min(axis=1)), best, label)


def _settle(positions: Floats, label: Ints, near: Ints, rules: SegmentationRules, rounds: int) -> tuple[Ints, Floats]:
    """Fit limbs and assign points until nothing changes. Returns the labels, and the straying (N, L) m that they rest on."""
    for _ in range(rounds):
        label = _dense_numbers(label, rules)
        stray = _stray(positions, label, rules)
        new = _assign(stray, label, near, rules)
        if (new == label).all():
            return label, stray
        label = new
    label = _dense_numbers(label, rules)
    return label, _stray(positions, label, rules)


def _dense_numbers(label: Ints, rules: SegmentationRules) -> Ints:
    """Labels from 0 without holes; limbs of too few points go to the largest one, from where the next assignment takes them."""
    sizes = np.bincount(label)
    small = (sizes > 0) & (sizes < rules.least_points)
    label = np.where(small[label], int(np.argmax(sizes)), label)
    return np.unique(label, return_inverse=True)[1]


def _merge(
    positions: Floats, label: Ints, near: Ints, limbs: int | None, rules: SegmentationRules
) -> tuple[Ints, tuple[tuple[float, int], ...]]:
    """Merge the two clusters of which the smaller one's points stray least in the axes of the larger, as long as that is little."""
    merges = []
    label, stray = _settle(positions, label, near, rules, rules.merge_rounds)
    # The pair that agrees best first: each merging changes what the others would cost.
    while stray.shape[1] > 1 and (limbs is None or stray.shape[1] > limbs):
        apart, one, other = _nearest_pair(stray, label)
        if limbs is None and not apart < rules.same_limb_m:
            break
        label, stray = _settle(positions, np.where(label == one, other, label), near, rules, rules.merge_rounds)
        merges.append((apart, stray.shape[1]))
    return label, tuple(merges)


def _split(positions: Floats, label: Ints, near: Ints, limbs: int, rules: SegmentationRules) -> Ints:
    """Settled labels; where there are fewer than so many limbs, those whose points stray most are taken apart as long as they can be."""
    label, stray = _settle(positions, label, near, rules, rules.rounds)
    tried = 0
    while stray.shape[1] < limbs and tried < stray.shape[1]:
        own = [float(np.median(stray[label == limb, limb])) for limb in range(stray.shape[1])]
        points = np.nonzero(label == np.argsort(own)[-1 - tried])[0]
        tried += 1
        if len(points) < 2 * rules.least_points:
            continue
        # Two limbs in one, of three points each at least, are told apart as in a recording of their own.
        alone = positions[:, points]
        affinity = _affinity(np.ascontiguousarray(alone[np.isfinite(alone[:, :, 0]).any(axis=1)]), rules)[1]
        parts = spectral_clusters(affinity, 2)[0]
        split = label.copy()
        split[points[parts == 1]] = stray.shape[1]
        split, after = _settle(positions, split, near, rules, rules.rounds)
        if after.shape[1] > stray.shape[1]:
            label, stray, tried = split, after, 0
    return label


def _nearest_pair(stray: Floats, label: Ints) -> tuple[float, int, int]:
    """The median straying (m) of the smaller cluster in the axes of the larger one, least over all pairs, and the two."""
    sizes = np.bincount(label, minlength=stray.shape[1])
    best = (np.inf, 0, 1)
    for one in range(stray.shape[1]):
        for other in range(stray.shape[1]):
            # The smaller one in the axes of the larger, which are known better.
            if one != other and (sizes[one], one) < (sizes[other], other):
                known = stray[label == one, other]
                known = known[np.isfinite(known)]
                apart = float(np.median(known)) if len(known) else 0.0
                best = min(best, (apart, one, other))
    return best


def _largest_first(label: Ints) -> Ints:
    sizes = np.bincount(label)
    order = np.argsort(-sizes, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return np.asarray(place[label])
