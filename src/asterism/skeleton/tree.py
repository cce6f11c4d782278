"""A body of bones and joints in; the same as a kinematic tree, whose joints are given by coordinates, and as the kernels take it, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints
from asterism.skeleton.body import ArticulatedBody, Point

ROOT_NUMBERS = ("root x", "root y", "root z", "root turn x", "root turn y", "root turn z")
"""What moves a root that is free: its joint (m) and its rotation (rad, rotation vector), in the room's axes."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A function of a coordinate: cubic pieces from knots (K,) on, coefficients (K, 4) from the constant upwards; straight outside."""

    knots: Floats
    cubics: Floats


@dataclass(frozen=True)
class JointMotion:
    """One motion of a joint: a turn about an axis, or a slide along it, by a function of a coordinate.

    axis        (3,) unit vector in the axes that the motions before it leave
    coordinate  its name; "" for a constant
    slide       whether the bone slides (m) instead of turning (rad)
    curve       of the coordinate; None for the coordinate itself
    """

    axis: Point
    coordinate: str
    slide: bool = False
    curve: Curve | None = None


@dataclass(frozen=True, eq=False)
class TreeBone:
    """A bone: its parent ("" for the root), its joint in the parent's axes (3,) m, the joint's axes there (3, 3), its motions in order."""

    name: str
    parent: str
    offset: Floats
    motions: tuple[JointMotion, ...] = ()
    frame: Floats = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of a joint: rad, or m where it slides a bone.

    usual, spread  where it usually is, and its standard deviation; an infinite spread: nothing is known beforehand
    low, high      its range
    start          where a fit begins
    locked         whether it stays at `start`
    """

    name: str
    usual: float = 0.0
    spread: float = np.inf
    low: float = -np.inf
    high: float = np.inf
    start: float = 0.0
    locked: bool = False
    slides: bool = False


@dataclass(frozen=True)
class TreeMarker:
    """A marker: its bone, its place in the bone's axes (3,) m, and how far it moves about it (m, standard deviation per axis)."""

    name: str
    bone: str
    place: Point
    spread: float = 0.01


class TreeArrays(NamedTuple):
    """A kinematic tree on flat arrays.

    parents (B,), offsets (B, 3) m, frames (B, 3, 3): bones; element_starts (B + 1,), slides (E,), axes (E, 3), coordinates (E,), functions
    (E,), entries (E,): motions, -1 for no coordinate, no function; entry_starts (B + 1,), numbers (N,): what of a step moves a bone by its
    own joint, the root's six first; function_starts, knots, cubics: see `Curve`; bones (M,), places (M, 3) m: markers; usual, precision,
    low, high (Q,); moves (D,) whether a number of a step may move; row_starts (D + 1,), row_columns: the pattern of the normal equations
    """

    parents: Ints
    offsets: Floats
    frames: Floats
    element_starts: Ints
    slides: NDArray[np.bool_]
    axes: Floats
    coordinates: Ints
    functions: Ints
    entries: Ints
    entry_starts: Ints
    numbers: Ints
    function_starts: Ints
    knots: Floats
    cubics: Floats
    bones: Ints
    places: Floats
    usual: Floats
    precision: Floats
    low: Floats
    high: Floats
    moves: NDArray[np.bool_]
    row_starts: Ints
    row_columns: Ints


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """Bones, joints with coordinates, and markers.

    bones        the root first, parents before children
    coordinates  of all joints; each moves one or several bones
    markers      names are unique
    free         whether the root moves in the room by itself; else it stays at the room's origin
    ends         bone -> (3,) m in its axes, where it ends; bones on whose end another one hangs need none
    starts       (N, Q) poses from which a fit without a start begins
    title        what it is

    Raises AsterismError where a bone, a coordinate or a marker is named twice or not at all.
    """

    bones: tuple[TreeBone, ...]
    coordinates: tuple[Coordinate, ...]
    markers: tuple[TreeMarker, ...]
    free: bool = True
    ends: Mapping[str, Point] = field(default_factory=dict)
    starts: Floats = field(default_factory=lambda: np.empty((0, 0)))
    title: str = "skeleton"

    def __post_init__(self) -> None:
        names = [bone.name for bone in self.bones]
        if not names or self.bones[0].parent or any(bone.parent not in names[:i] for i, bone in enumerate(self.bones) if i):
            raise AsterismError(f"{self.title}: the root has no parent and comes first, and each other bone stands behind its parent.")
        for what, given in (("bone", names), ("coordinate", [c.name for c in self.coordinates]), ("marker", list(self.labels))):
            twice = next((name for name in given if given.count(name) > 1), None)
            if twice is not None:
                raise AsterismError(f"{self.title}: the {what} {twice} is listed twice; keep it once.")
        stray = next((marker for marker in self.markers if marker.bone not in names), None)
        if stray is not None:
            raise AsterismError(f"{self.title}: the marker {stray.name} is on {stray.bone}, no bone of it; name one of {', '.join(names)}.")
        known = {c.name for c in self.coordinates}
        for bone in self.bones:
            for motion in bone.motions:
                if motion.coordinate and motion.coordinate not in known:
                    raise AsterismError(f"{self.title}: {bone.name} moves with {motion.coordinate}, which is no coordinate of it; add it.")

    @property
    def labels(self) -> tuple[str, ...]:
        """Marker names, in order."""
        return tuple(marker.name for marker in self.markers)

    @property
    def bone_names(self) -> tuple[str, ...]:
        """Names of the bones."""
        return tuple(bone.name for bone in self.bones)

    @property
    def numbers(self) -> tuple[str, ...]:
        """(D,) names of what a step changes: the root's six numbers, then the coordinates."""
        return (*ROOT_NUMBERS, *(coordinate.name for coordinate in self.coordinates))

    @property
    def start(self) -> Floats:
        """(Q,) where a fit begins."""
        return np.array([coordinate.start for coordinate in self.coordinates], dtype=np.float64)

    def with_markers(self, markers: Sequence[TreeMarker]) -> KinematicTree:
        """The same bones with other markers."""
        return replace(self, markers=tuple(markers))

    @cached_property
    def arrays(self) -> TreeArrays:
        """The tree as the kernels take it."""
        index = {name: i for i, name in enumerate(self.bone_names)}
        column = {coordinate.name: j for j, coordinate in enumerate(self.coordinates)}
        parents = [index.get(bone.parent, -1) for bone in self.bones]
        numbers, entry_starts, entries = list(range(6)), [0], []
        element_starts, motions = [0], list[JointMotion]()
        for b, bone in enumerate(self.bones):
            own: dict[str, int] = {}
            for motion in bone.motions:
                if motion.coordinate and motion.coordinate not in own:
                    own[motion.coordinate] = len(numbers)
                    numbers.append(6 + column[motion.coordinate])
                entries.append(own.get(motion.coordinate, -1))
            motions += bone.motions
            element_starts.append(len(motions))
            entry_starts.append(len(numbers))
            assert b or entry_starts[1] >= 6
        curves = [motion.curve for motion in motions if motion.curve is not None]
        count = np.cumsum([motion.curve is not None for motion in motions]) - 1
        starts, columns = _pattern(parents, entry_starts, numbers, 6 + len(self.coordinates))
        spreads = np.array([coordinate.spread for coordinate in self.coordinates])
        return TreeArrays(
            np.array(parents, dtype=np.int64),
            np.array([bone.offset for bone in self.bones], dtype=np.float64).reshape(-1, 3),
            np.array([bone.frame for bone in self.bones], dtype=np.float64).reshape(-1, 3, 3),
            np.array(element_starts, dtype=np.int64),
            np.array([motion.slide for motion in motions], dtype=np.bool_),
            np.array([motion.axis for motion in motions], dtype=np.float64).reshape(-1, 3),
            np.array([column.get(motion.coordinate, -1) for motion in motions], dtype=np.int64),
            np.array([c if motion.curve is not None else -1 for motion, c in zip(motions, count, strict=True)], dtype=np.int64),
            np.array(entries, dtype=np.int64),
            np.array(entry_starts, dtype=np.int64),
            np.array(numbers, dtype=np.int64),
            np.concatenate([[0], np.cumsum([len(curve.knots) for curve in curves])]).astype(np.int64),
            np.concatenate([np.zeros(0), *(curve.knots for curve in curves)]),
            np.concatenate([np.zeros((0, 4)), *(curve.cubics for curve in curves)]),
            np.array([index[marker.bone] for marker in self.markers], dtype=np.int64),
            np.array([marker.place for marker in self.markers], dtype=np.float64).reshape(-1, 3),
            np.array([coordinate.usual for coordinate in self.coordinates], dtype=np.float64),
            spreads**-2.0,
            np.array([coordinate.low for coordinate in self.coordinates], dtype=np.float64),
            np.array([coordinate.high for coordinate in self.coordinates], dtype=np.float64),
            np.array([self.free] * 6 + [not coordinate.locked for coordinate in self.coordinates], dtype=np.bool_),
            starts,
            columns,
        )


def _pattern(parents: Sequence[int], entry_starts: Sequence[int], numbers: Sequence[int], size: int) -> tuple[Ints, Ints]:
    """The columns left of the diagonal in which each row of the normal equations, and of their factor, has entries: starts, columns."""
    rows: list[set[int]] = [set() for _ in range(size)]
    for b in range(len(parents)):
        chain, above = list[int](), b
        while above >= 0:
            chain += numbers[entry_starts[above] : entry_starts[above + 1]]
            above = parents[above]
        for row in numbers[entry_starts[b] : entry_starts[b + 1]]:
            for other in chain:
                if other != row:
                    rows[max(row, other)].add(min(row, other))
    # What the elimination of a row adds to its nearest column; none where the tree is one of single coordinates.
    for row in range(size - 1, -1, -1):
        if rows[row]:
            nearest = max(rows[row])
            rows[nearest] |= rows[row] - {nearest}
    starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64)
    return starts, np.array([column for row in rows for column in sorted(row)], dtype=np.int64)


def tree_of(body: ArticulatedBody) -> KinematicTree:
    """A body model as a kinematic tree: the bones' axes are the body's in its rest pose, and each bone's origin is its joint."""
    at = {bone.name: np.array(bone.pivot) for bone in body.bones}

    def local(bone: str, place: Sequence[float]) -> Point:
        x, y, z = np.subtract(place, at[bone])
        return (float(x), float(y), float(z))

    bones = tuple(
        TreeBone(
            bone.name,
            bone.parent,
            at[bone.name] - at[bone.parent] if bone.parent else np.zeros(3),
            tuple(JointMotion(hinge.axis, hinge.name) for hinge in bone.hinges),
        )
        for bone in body.bones
    )
    coordinates = tuple(Coordinate(h.name, h.usual, h.spread, h.low, h.high, h.usual) for h in body.hinges)
    markers = tuple(TreeMarker(m.name, m.bone, local(m.bone, m.place), m.spread) for m in body.markers)
    # The far end of its longest capsule is where a bone ends on which none hangs.
    ends: dict[str, Point] = {}
    for part in body.capsules:
        far = max((part.start, part.end), key=lambda end: float(np.linalg.norm(np.subtract(end, at[part.bone]))))
        if part.bone not in ends or np.linalg.norm(local(part.bone, far)) > np.linalg.norm(ends[part.bone]):
            ends[part.bone] = local(part.bone, far)
    hung = {bone.parent for bone in body.bones}
    return KinematicTree(
        bones, coordinates, markers, True, {name: end for name, end in ends.items() if name not in hung}, body.start_angles, body.title
    )
