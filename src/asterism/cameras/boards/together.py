"""Cameras calibrated each by itself in; which of them share views, and a first rig of those that do, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.cameras.boards.alone import Alone
from asterism.cameras.camera import Camera, vector_from_rotation
from asterism.recording import Floats, Ints

_MOST_COMPARED = 80


@dataclass(frozen=True)
class Links:
    """How cameras hang together by views that they share.

    shared     (C, C) moments that two cameras share
    groups     cameras by place that hang together, the largest group first (by views, then by order)
    tree       (from, to) pairs that reach every camera of the first group from its best connected one, strongest links first
    """

    shared: Ints
    groups: tuple[tuple[int, ...], ...]
    tree: tuple[tuple[int, int], ...]


def links_between(frames: Sequence[Ints]) -> Links:
    """The view graph of cameras that saw the board at these moments, and its maximum spanning tree. O(C2 T)."""
    count = len(frames)
    shared = np.array([[len(np.intersect1d(a, b)) for b in frames] for a in frames], dtype=np.int64).reshape(count, count)
    left = set(range(count))
    groups: list[tuple[int, ...]] = []
    while left:
        reached = {min(left)}
        while True:
            more = {j for i in reached for j in left - reached if shared[i, j]}
            if not more:
                break
            reached |= more
        left -= reached
        groups.append(tuple(sorted(reached)))
    groups.sort(key=lambda group: (-len(group), -sum(len(frames[c]) for c in group), group))
    strength = [sum(shared[c, other] for other in groups[0] if other != c) for c in groups[0]]
    inside = [groups[0][int(np.argmax(strength))]]
    tree: list[tuple[int, int]] = []
    while len(inside) < len(groups[0]):
        _, start, end = max((shared[i, j], -i, -j) for i in inside for j in groups[0] if j not in inside)
        tree.append((-start, -end))
        inside.append(-end)
    return Links(shared, tuple(groups), tuple(tree))


def first_rig(alone: dict[int, Alone], links: Links) -> dict[int, Camera]:
    """Poses along the tree, the root's axes being the world: each link is the relative pose that most shared views agree on."""
    root = links.tree[0][0] if links.tree else links.groups[0][0]
    cameras = {root: replace(alone[root].camera, posed=True)}
    for start, end in links.tree:
        turn, shift = _relative(alone[start], alone[end])
        base = cameras[start]
        cameras[end] = replace(alone[end].camera, rotation=turn @ base.rotation, translation=turn @ base.translation + shift, posed=True)
    return cameras


def _relative(one: Alone, other: Alone) -> tuple[Floats, Floats]:
    """The pose other from one, (3, 3) and (3,) m: of the shared views' poses the one to which the others are nearest in the median."""
    _, mine, theirs = np.intersect1d(one.frames, other.frames, return_indices=True)
    order = np.argsort(one.errors[mine] + other.errors[theirs], kind="stable")[:_MOST_COMPARED]
    mine, theirs = mine[order], theirs[order]
    turns = other.rotations[theirs] @ one.rotations[mine].transpose(0, 2, 1)
    shifts = other.translations[theirs] - np.einsum("nij,nj->ni", turns, one.translations[mine])
    reach = np.median(np.linalg.norm(other.translations[theirs], axis=1))
    apart = np.array(
        [
            np.median(
                [
                    np.linalg.norm(vector_from_rotation(turns[k].T @ turns[i])) + np.linalg.norm(shifts[k] - shifts[i]) / reach
                    for k in range(len(turns))
                ]
            )
            for i in range(len(turns))
        ]
    )
    best = int(np.argmin(apart))
    return turns[best], shifts[best]


def first_boards(alone: dict[int, Alone], cameras: dict[int, Camera], frames: Ints) -> tuple[Floats, Floats]:
    """The board at each of these moments, world from board, (T, 3, 3) and (T, 3) m: as the camera with the least error saw it."""
    turned, placed = np.empty((len(frames), 3, 3)), np.empty((len(frames), 3))
    best = np.full(len(frames), np.inf)
    for c, camera in cameras.items():
        _, mine, at = np.intersect1d(alone[c].frames, frames, return_indices=True)
        better = alone[c].errors[mine] < best[at]
        mine, at = mine[better], at[better]
        best[at] = alone[c].errors[mine]
        turned[at] = camera.rotation.T @ alone[c].rotations[mine]
        placed[at] = (alone[c].translations[mine] - camera.translation) @ camera.rotation
    return turned, placed
