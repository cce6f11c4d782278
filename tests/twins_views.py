"""Slow, readable twins of the kernels of labelling in images."""

from __future__ import annotations

import itertools

import numpy as np

from asterism.recording import Floats
from asterism.skeleton import ArticulatedBody


def rotation_about(axis: Floats, angle: float) -> Floats:
    """Rodrigues."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def posed_markers(body: ArticulatedBody, pose: Floats, rotation: Floats) -> Floats:
    """Each marker moved by its bone's joints, from its own bone up to the root, then scaled bones placed in the world."""
    root = np.array(body.bones[0].pivot)
    bones = {bone.name: bone for bone in body.bones}
    angles = dict(zip(body.hinge_names, pose[9:], strict=True))
    out = []
    for marker in body.markers:
        place = pose[:3] * (np.array(marker.place) - root)
        bone = bones[marker.bone]
        while True:
            pivot = pose[:3] * (np.array(bone.pivot) - root)
            turn = np.eye(3)
            for hinge in bone.hinges:
                turn = turn @ rotation_about(np.array(hinge.axis), angles[hinge.name])
            place = pivot + turn @ (place - pivot)
            if not bone.parent:
                break
            bone = bones[bone.parent]
        out.append(rotation @ place + pose[3:6])
    return np.array(out)


def sight_depth(eye: Floats, point: Floats, start: Floats, end: Floats, radii: Floats, clearance: float) -> float:
    """How deep the line from eye to point runs in a cone, by trying many places along both."""
    shares = np.linspace(0.0, 1.0, 801)
    axis = start + shares[:, None] * (end - start)
    sight = point + shares[:, None] * (eye - point)
    room = np.linalg.norm(axis - point, axis=1).min() - clearance
    apart = np.linalg.norm(axis[:, None] - sight[None], axis=2)
    nearest, _ = np.unravel_index(np.argmin(apart), apart.shape)
    return float(min(radii[0] + shares[nearest] * (radii[1] - radii[0]), room) - apart.min())


def best_total(gain: Floats) -> float:
    """The greatest total gain of a one-to-one assignment, by trying all."""
    rows, columns = gain.shape
    wide = np.concatenate([gain, np.zeros((rows, rows))], axis=1)
    best = -np.inf
    for chosen in itertools.permutations(range(columns + rows), rows):
        best = max(best, sum(wide[i, k] for i, k in enumerate(chosen)))
    return best


def margin_by_trying(gain: Floats, chosen: Floats, m: int) -> float:
    """The gain lost by the best assignment in which marker m does not have its blob."""
    without = gain.copy()
    without[m, chosen[m]] = -1e6
    total = sum(gain[i, k] for i, k in enumerate(chosen) if k >= 0)
    return float(total - best_total(without))


def shared_cost(uv: Floats, variances: Floats, shares: Floats, blobs: list[Floats], strays: float) -> float:
    """Minus the log of the probability of all blobs, each of a marker or a stray."""
    cost = 0.0
    for c, own in enumerate(blobs):
        for blob in own:
            square = ((uv[c] - blob) ** 2).sum(axis=1)
            density = shares[c] * np.exp(-0.5 * square / variances[c]) / (2 * np.pi * variances[c])
            cost -= np.log(strays + density[square < 25 * variances[c]].sum())
    return cost


def chained_labels(positions: Floats, weights: Floats, fastest: float, near: float, window: int) -> Floats:
    """(T, M) nats by which each placed marker has the label of its chain, NaN where it was not placed; chains: lists of (frame, marker)."""
    chains: list[list[tuple[int, int]]] = []
    for t, frame in enumerate(positions):
        for m in np.nonzero(np.isfinite(frame[:, 0]))[0].tolist():
            for chain in chains:
                last, old = chain[-1]
                if last != t - 1:
                    continue
                step = float(np.linalg.norm(frame[m] - positions[last, old]))
                others = [np.linalg.norm(frame[k] - positions[last, old]) for k in range(len(frame)) if k != m]
                others += [np.linalg.norm(frame[m] - positions[last, k]) for k in range(len(frame)) if k != old]
                if step <= fastest and min([each for each in others if np.isfinite(each)], default=np.inf) >= 3 * (step / 2 + near):
                    chain.append((t, m))
                    break
            else:
                chains.append([(t, m)])
    out = np.full(positions.shape[:2], np.nan)
    for chain in chains:
        for t, m in chain:
            around = [(u, k) for u, k in chain if abs(u - t) <= window]
            total = {k: sum(weights[u, j] for u, j in around if j == k) for _, k in around}
            out[t, m] = total.pop(m) - max(total.values(), default=0.0)
    return out
