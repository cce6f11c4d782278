"""Trajectories in; their coordinates in a space of few dimensions, local subspaces there, and clusters by local subspace affinity, out.

Yan and Pollefeys 2006, from the image plane to space as GaMoCap chapter 3 has it: the trajectories of one rigid body's points, each a
vector of 3 T coordinates, lie in one subspace of four dimensions, of three when the points lie in a plane or the limb only turns about its
origin. Nearby points span (nearly) their body's subspace, and the angles between such local subspaces say which points share a body.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr
from scipy.spatial import cKDTree

from asterism.recording import Floats, Ints


def fill_trajectories(positions: Floats, rank: int, rounds: int) -> Floats:
    """(N, 3 T) m: trajectories about the points' mean, gaps filled as a matrix of this rank has them.

    positions (T, N, 3) m, NaN for missing. Gaps begin as what the nearest points that are present do, then the rank is imposed `rounds`
    times (hard impute, Mazumder et al. 2010). O(rounds (T^2 N + T^3)).
    """
    frames, points = positions.shape[:2]
    seen = np.isfinite(positions[:, :, 0])
    # Zeros are places only until they are filled: nothing is compared before.
    filled = np.where(seen[:, :, None], positions, 0.0)
    if not seen.all():
        filled = _follow_neighbours(positions, seen)
    matrix = filled.transpose(1, 0, 2).reshape(points, 3 * frames)
    missing = np.repeat(~seen.T, 3, axis=1)
    if missing.any():
        # Impose the rank, keep what was measured, repeat: the gaps settle into the space of the others.
        for _ in range(rounds):
            centre = matrix.mean(axis=0)
            basis = _principal(matrix - centre, rank)
            matrix = np.where(missing, (matrix - centre) @ basis @ basis.T + centre, matrix)
    return np.asarray(matrix - matrix.mean(axis=0))


def _follow_neighbours(positions: Floats, seen: np.ndarray) -> Floats:
    """Each missing sample is the mean of the point's offset from its four nearest points, carried by where those are."""
    out = positions.copy()
    # About the cloud's mean, so that a walk does not count as an offset.
    mean = np.nanmean(np.where(seen[:, :, None], positions, np.nan), axis=1, keepdims=True)
    steady = np.nanmean(positions - mean, axis=0)
    count = min(9, positions.shape[1])
    # Neighbours by their mean place: most of them are on the same limb.
    near = cKDTree(steady).query(steady, k=count)[1].reshape(len(steady), count)[:, 1:]
    for n in np.nonzero(~seen.all(axis=0))[0]:
        frames = ~seen[:, n]
        moved = positions[frames][:, near[n]] - steady[near[n]] + steady[n]
        present = np.isfinite(moved[:, :, :1])
        total = np.where(present, moved, 0.0).sum(axis=1)
        share = present.sum(axis=1)
        out[frames, n] = np.where(share > 0, total / np.maximum(share, 1), mean[frames, 0] + steady[n])
    return out


def _principal(matrix: Floats, rank: int) -> Floats:
    """(columns, rank): the right singular vectors of the largest singular values, each with the sign of its largest entry."""
    basis = np.linalg.eigh(matrix.T @ matrix)[1]
    basis = basis[:, ::-1][:, :rank]
    # A singular vector's sign is arbitrary; fixed, the same file gives the same limbs.
    largest = np.argmax(np.abs(basis), axis=0)
    return np.asarray(basis * np.sign(basis[largest, np.arange(basis.shape[1])]))


def trajectory_coordinates(matrix: Floats, rank: int) -> Floats:
    """(N, rank) m: trajectories (N, 3 T) m in their principal coordinates, over the root of the frames: distances are RMS over time."""
    few = min(rank, *matrix.shape)
    return np.asarray(matrix @ _principal(matrix, few) / np.sqrt(matrix.shape[1] / 3))


def spread_landmarks(coordinates: Floats, count: int) -> Ints:
    """Rows that lie far from each other: from the row farthest from the mean, always the one farthest from all before. O(N count)."""
    if count >= len(coordinates):
        return np.arange(len(coordinates))
    chosen = [int(np.argmax((coordinates**2).sum(axis=1)))]
    nearest = ((coordinates - coordinates[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, ((coordinates - coordinates[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)


def local_subspaces(coordinates: Floats, neighbours: int, dimension: int) -> Floats:
    """(N, rank, dimension): orthonormal bases of the subspaces that each row and its nearest rows span. O(N rank^2 neighbours)."""
    near = cKDTree(coordinates).query(coordinates, k=min(neighbours, len(coordinates)))[1].reshape(len(coordinates), -1)
    patches = coordinates[near]
    scatter = np.einsum("nki,nkj->nij", patches, patches)
    return np.asarray(np.linalg.eigh(scatter)[1][:, :, -dimension:])


def subspace_affinity(bases: Floats, landmarks: Ints) -> Floats:
    """(N, landmarks): exp(-sum of sin^2 of the principal angles) between local subspaces (N, rank, dimension). O(N landmarks rank)."""
    count, rank, dimension = bases.shape
    others = bases[landmarks].transpose(1, 0, 2).reshape(rank, -1)
    squares = np.empty((count, len(landmarks)))
    # In blocks: the products of all points at once are N landmarks dimension^2 numbers.
    for begin in range(0, count, 500):
        block = bases[begin : begin + 500].transpose(0, 2, 1).reshape(-1, rank) @ others
        squares[begin : begin + 500] = (block**2).reshape(-1, dimension, len(landmarks), dimension).sum(axis=(1, 3))
    return np.asarray(np.exp(-np.maximum(dimension - squares, 0.0)))


def spectral_clusters(affinity: Floats, clusters: int) -> tuple[Ints, Floats]:
    """Clusters of rows by their affinity to landmarks (N, M), and the singular values that tell how many there are.

    The normalised affinity's left singular vectors place the rows (Dhillon 2001). Rows that point apart most begin the clusters (pivoted
    QR, Damle et al. 2019), then Lloyd's rounds; no random start, so the same trajectories always give the same clusters.
    O(N M clusters + M^3).
    """
    rows, columns = affinity.sum(axis=1), affinity.sum(axis=0)
    # Normalised by rows and columns: a dense part of the skin must not outweigh a sparse one.
    scaled = affinity / np.sqrt(rows[:, None] * columns[None, :])
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values, vectors = np.sqrt(np.maximum(values[::-1], 0.0)), vectors[:, ::-1][:, :clusters]
    places = scaled @ vectors
    places /= np.maximum(np.linalg.norm(places, axis=1, keepdims=True), 1e-12)
    # Rows that point apart most are sure to be of different clusters: a start without chance.
    starts = qr(places.T, mode="r", pivoting=True)[1][:clusters]
    centres = places[starts]
    label = np.full(len(places), -1)
    # Lloyd ends where nothing changes; the bound is for cycles between equal distances.
    for _ in range(100):
        new = np.argmax(places @ centres.T, axis=1)
        if (new == label).all():
            break
        label = new
        for cluster in range(len(centres)):
            rows_of = label == cluster
            if rows_of.any():
                mean = places[rows_of].mean(axis=0)
                centres[cluster] = mean / max(float(np.linalg.norm(mean)), 1e-12)
    return np.unique(label, return_inverse=True)[1], values
