"""Cameras calibrated each by itself in; which of them share views, and a first rig of those that do, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.calibration.boards.intrinsics import Intrinsics
from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.recording import Floats, Ints

_MOST_COMPARED = 80
"""Shared views, those of least error, whose relative poses are compared."""


@dataclass(frozen=True)
class CameraLinks:
    """How cameras hang together by views that they share.

    shared     (C, C) frames that two cameras share
    groups     cameras by place that hang together, the largest group first (by views, then by order)
    tree       (from, to) pairs that reach every camera of the first group from its best connected one, strongest links first
    """

    shared: Ints
    groups: tuple[tuple[int, ...], ...]
    tree: tuple[tuple[int, int], ...]


def links_between(frames: Sequence[Ints]) -> CameraLinks:
    """The view graph of cameras that saw the board in these frames, and its maximum spanning tree. O(C2 T)."""
    count = len(frames)
    shared = np.array([[len(np.intersect1d(a, b)) for b in frames] for a in frames], dtype=np.int64).reshape(count, count)
    left = set(range(count))
    groups: list[tuple[int, ...]] = []
    while left:
        # Grow a group from one camera until no camera outside shares a view with it.
        reached = {min(left)}
        while True:
            more = {j for i in reached for j in left - reached if shared[i, j]}
            if not more:
                break
            reached |= more
        left -= reached
        groups.append(tuple(sorted(reached)))
    # Only the first group becomes a rig, so it must be the one that loses least; ties go by order, so that results repeat.
    groups.sort(key=lambda group: (-len(group), -sum(len(frames[c]) for c in group), group))
    # The root should have many views with the others: every pose is chained from it.
    strength = [sum(shared[c, other] for other in groups[0] if other != c) for c in groups[0]]
    inside = [groups[0][int(np.argmax(strength))]]
    tree: list[tuple[int, int]] = []
    while len(inside) < len(groups[0]):
        # The strongest link from inside to outside, as in Prim's algorithm; negated numbers let the lower camera win a tie.
        _, start, end = max((shared[i, j], -i, -j) for i in inside for j in groups[0] if j not in inside)
        tree.append((-start, -end))
        inside.append(-end)
    return CameraLinks(shared, tuple(groups), tuple(tree))


def first_rig(intrinsics: dict[int, Intrinsics], links: CameraLinks, middle: Floats | None = None) -> dict[int, Camera]:
    """Poses along the tree, the root's axes being the world: each link is the relative pose that most shared views agree on.

    middle  (3,) m of a board that looks the same upside down, else None: each view then allows two poses, of which one is right
    """
    root = links.tree[0][0] if links.tree else links.groups[0][0]
    cameras = {root: replace(intrinsics[root].camera, posed=True)}
    for start, end in links.tree:
        turn, shift = _relative(intrinsics[start], intrinsics[end], middle)
        base = cameras[start]
        cameras[end] = replace(
            intrinsics[end].camera, rotation=turn @ base.rotation, translation=turn @ base.translation + shift, posed=True
        )
    return cameras


def _relative(one: Intrinsics, other: Intrinsics, middle: Floats | None) -> tuple[Floats, Floats]:
    """The pose other from one, (3, 3) and (3,) m: of the shared views' poses the one to which the others are nearest in the median."""
    _, mine, theirs = np.intersect1d(one.frames, other.frames, return_indices=True)
    # Views with small errors only: all pairs of views are compared, which costs the square of their number.
    order = np.argsort(one.errors[mine] + other.errors[theirs], kind="stable")[:_MOST_COMPARED]
    mine, theirs = mine[order], theirs[order]
    ways = [(other.rotations[theirs], other.translations[theirs])]
    ways += [] if middle is None else [_upside_down(*ways[0], middle)]
    turns = np.stack([turned @ one.rotations[mine].transpose(0, 2, 1) for turned, _ in ways])
    shifts = np.stack([placed for _, placed in ways]) - np.einsum("wnij,nj->wni", turns, one.translations[mine])
    reach = np.median(np.linalg.norm(other.translations[theirs], axis=1))
    # candidates k against both ways w of each view n: their angle, and their distance as a share of that to the board
    cosines = 0.5 * (np.einsum("kij,wnij->kwn", turns.reshape(-1, 3, 3), turns) - 1.0)
    far = np.linalg.norm(shifts.reshape(-1, 1, 1, 3) - shifts, axis=3) / reach
    # The median view, not the mean: boards seen at a grazing angle give poses that are far off, and would spoil a mean.
    disagreement = np.median((np.arccos(np.clip(cosines, -1.0, 1.0)) + far).min(axis=1), axis=1)
    best = int(np.argmin(disagreement))
    return turns.reshape(-1, 3, 3)[best], shifts.reshape(-1, 3)[best]


def _upside_down(turned: Floats, placed: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Poses (V, 3, 3) and (V, 3) m of a board that is numbered from its other end."""
    return turned @ np.diag([-1.0, -1.0, 1.0]), placed + 2.0 * turned @ middle


def numbered_alike(
    intrinsics: dict[int, Intrinsics], cameras: dict[int, Camera], seen: Sightings, last: int, middle: Floats
) -> tuple[dict[int, Intrinsics], Sightings]:
    """A board that looks the same upside down, numbered in each frame from the end that the camera with the least error took.

    last    the number of the board's last point; middle (3,) m of the board
    Returns the views of these cameras, and all sightings, with points renumbered.
    """
    frames = np.unique(np.concatenate([intrinsics[c].frames for c in cameras]))
    ends, _ = first_boards(intrinsics, cameras, frames)
    numbered: dict[int, Intrinsics] = {}
    point = seen.point.copy()
    for c, camera in cameras.items():
        own = intrinsics[c]
        # The board's own x axis in the world tells from which end this camera numbered it.
        along = (camera.rotation.T @ own.rotations)[:, :, 0]
        other = (along * ends[np.searchsorted(frames, own.frames), :, 0]).sum(axis=1) < 0
        turned, placed = _upside_down(own.rotations, own.translations, middle)
        numbered[c] = replace(
            own,
            rotations=np.where(other[:, None, None], turned, own.rotations),
            translations=np.where(other[:, None], placed, own.translations),
        )
        rows = (seen.camera == c) & np.isin(seen.frame, own.frames[other])
        point[rows] = last - point[rows]
    return numbered, Sightings.of(seen.frame, seen.camera, point, seen.xy)


def first_boards(intrinsics: dict[int, Intrinsics], cameras: dict[int, Camera], frames: Ints) -> tuple[Floats, Floats]:
    """The board in each of these frames, world from board, (T, 3, 3) and (T, 3) m: as the camera with the least error saw it."""
    turned, placed = np.empty((len(frames), 3, 3)), np.empty((len(frames), 3))
    best = np.full(len(frames), np.inf)
    for c, camera in cameras.items():
        _, mine, at = np.intersect1d(intrinsics[c].frames, frames, return_indices=True)
        # Of all cameras that saw the board in a frame, the one with the least error has the best pose of it.
        better = intrinsics[c].errors[mine] < best[at]
        mine, at = mine[better], at[better]
        best[at] = intrinsics[c].errors[mine]
        turned[at] = camera.rotation.T @ intrinsics[c].rotations[mine]
        placed[at] = (intrinsics[c].translations[mine] - camera.translation) @ camera.rotation
    return turned, placed
