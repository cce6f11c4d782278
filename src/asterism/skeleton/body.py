"""Body models: bones with hinges, the markers on them and the capsules around them, in one rest pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints, MarkerSet, canonical
from asterism.recording.display import Rows, as_html, as_text, listed, significant
from asterism.skeleton.arrays import ArticulatedBodyArrays

Point = tuple[float, float, float]
"""A place in space, m."""


def as_point(place: Floats) -> Point:
    """A row (3,) as three plain numbers."""
    return (float(place[0]), float(place[1]), float(place[2]))


@dataclass(frozen=True)
class Hinge:
    """One angle of a joint.

    name    "left knee flexion"
    axis    (3,) unit vector in the rest pose; angles are right-handed about it
    usual   rad, where the angle usually is
    spread  rad, its standard deviation in movement
    low, high  rad, its range
    """

    name: str
    axis: tuple[float, float, float]
    usual: float = 0.0
    spread: float = 0.5
    low: float = -3.0
    high: float = 3.0


@dataclass(frozen=True)
class Bone:
    """A part that moves as one: its parent ("" for the root), its joint with it (3,) m in the rest pose, and the hinges in their order."""

    name: str
    parent: str
    pivot: tuple[float, float, float]
    hinges: tuple[Hinge, ...] = ()


@dataclass(frozen=True)
class BodyMarker:
    """A marker on a bone: its place (3,) m in the rest pose, and how far off it is on other people and under way (m, per axis)."""

    name: str
    bone: str
    place: tuple[float, float, float]
    spread: float = 0.015


@dataclass(frozen=True)
class Capsule:
    """A cone with round ends around a part of a bone: ends (3,) m in the rest pose, and the radius at each (m)."""

    name: str
    bone: str
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radii: tuple[float, float]


@dataclass(frozen=True, repr=False)
class ArticulatedBody:
    """A body in its rest pose: x ahead, y left, z up, the floor at z = 0.

    title     what it is
    height    m, of the person in the rest pose
    bones     the root first, parents before children
    markers   in order; names are unique
    capsules  what hides markers
    poses     name -> hinge angles (J,) rad: poses from which a fit without a start begins; the rest pose is one if there is none
    aliases   marker -> other spellings in files
    scale_spread  standard deviation of people's size as a share of this body's, and of each direction's beside it
    """

    title: str
    height: float
    bones: tuple[Bone, ...]
    markers: tuple[BodyMarker, ...]
    capsules: tuple[Capsule, ...] = ()
    poses: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    scale_spread: tuple[float, float] = (0.12, 0.04)

    def __post_init__(self) -> None:
        names = [bone.name for bone in self.bones]
        if not names or self.bones[0].parent or any(not bone.parent for bone in self.bones[1:]):
            # Kernels walk the bones once from the root down, so a parent has to come before its children.
            raise AsterismError(f"body {self.title}: exactly the first bone has no parent; give each other bone one.")
        for place, bone in enumerate(self.bones):
            if bone.parent and bone.parent not in names[:place]:
                raise AsterismError(f"body {self.title}: the parent of {bone.name}, {bone.parent}, is not listed before it; move it up.")
        for what, given in (("bone", names), ("marker", self.labels), ("hinge", self.hinge_names)):
            twice = next((name for name in given if list(given).count(name) > 1), None)
            if twice is not None:
                raise AsterismError(f"body {self.title}: the {what} {twice} is listed twice; keep it once.")
        if not self.markers:
            raise AsterismError(f"body {self.title} has no markers; add some.")
        on = [(part.name, part.bone) for part in self.markers] + [(part.name, part.bone) for part in self.capsules]
        stray = next((each for each in on if each[1] not in names), None)
        if stray is not None:
            raise AsterismError(f"body {self.title}: {stray[0]} is on {stray[1]}, no bone of it; name one of {', '.join(names)}.")
        self._check_numbers()

    def _check_numbers(self) -> None:
        where = f"body {self.title}"
        # Lengths in millimetres are the usual mistake: no body is taller than 10 m or shorter than 5 cm.
        if not 0.05 < self.height < 10:
            raise AsterismError(f"{where}: its height is {self.height:g} m; give metres.")
        numbers = [x for part in self.bones for x in part.pivot] + [x for part in self.markers for x in (*part.place, part.spread)]
        numbers += [x for part in self.capsules for x in (*part.start, *part.end, *part.radii)]
        if not np.isfinite(numbers).all() or np.abs(numbers).max() > 10:
            raise AsterismError(f"{where}: a place or size is not finite, or beyond 10 m; give metres.")
        if any(part.spread <= 0 for part in self.markers) or any(min(part.radii) <= 0 for part in self.capsules):
            raise AsterismError(f"{where}: a marker's spread or a capsule's radius is not above 0; correct it.")
        for hinge in self.hinges:
            length = float(np.linalg.norm(hinge.axis))
            if not (abs(length - 1) < 1e-6 and hinge.spread > 0 and hinge.low <= hinge.usual <= hinge.high):
                raise AsterismError(
                    f"{where}: hinge {hinge.name} needs an axis of length 1, a spread above 0 and a usual angle within its range."
                )
        count = len(self.hinges)
        wrong = next((name for name, angles in self.poses.items() if len(angles) != count or not np.isfinite(angles).all()), None)
        if wrong is not None:
            raise AsterismError(f"{where}: the pose {wrong} does not have one finite angle for each of {count} hinges.")

    @property
    def labels(self) -> tuple[str, ...]:
        """Marker names, in order."""
        return tuple(marker.name for marker in self.markers)

    @cached_property
    def hinges(self) -> tuple[Hinge, ...]:
        """All hinges, in the order of the pose."""
        return tuple(hinge for bone in self.bones for hinge in bone.hinges)

    @property
    def hinge_names(self) -> tuple[str, ...]:
        """Names of the hinges."""
        return tuple(hinge.name for hinge in self.hinges)

    @property
    def places(self) -> Floats:
        """(M, 3) m, the markers in the rest pose."""
        return np.array([marker.place for marker in self.markers], dtype=np.float64)

    @cached_property
    def marker_set(self) -> MarkerSet:
        """The markers with their other spellings; markers whose names differ in a first L and R are pairs."""
        known = {canonical(name): name for name in self.labels}
        pairs = [
            (name, known["r" + canonical(name)[1:]])
            for name in self.labels
            if canonical(name).startswith("l") and "r" + canonical(name)[1:] in known
        ]
        return MarkerSet(self.labels, self.title, self.aliases, tuple(pairs), self._segments())

    def _segments(self) -> dict[str, tuple[str, ...]]:
        on = {bone.name: tuple(marker.name for marker in self.markers if marker.bone == bone.name) for bone in self.bones}
        return {bone: names for bone, names in on.items() if names}

    def select(self, names: Sequence[str]) -> ArticulatedBody:
        """The body with these markers alone, in this order; bones and hinges stay. Raises AsterismError where a name is absent."""
        by_name = {marker.name: marker for marker in self.markers}
        absent = next((name for name in names if name not in by_name), None)
        if absent is not None:
            raise AsterismError(f"body {self.title} has no marker {absent}; it has {', '.join(self.labels)}.")
        return replace(
            self,
            markers=tuple(by_name[name] for name in names),
            aliases={name: spelled for name, spelled in self.aliases.items() if name in names},
        )

    def mirrored(self) -> ArticulatedBody:
        """The body with left and right exchanged, the names of markers, bones and hinges kept: what a mirror shows."""

        def flip(place: tuple[float, float, float]) -> tuple[float, float, float]:
            return (place[0], -place[1], place[2])

        def turn(hinge: Hinge) -> Hinge:
            # A mirrored right-handed turn is left-handed: of the axis, what lies in the mirror changes its sign.
            return replace(hinge, axis=(-hinge.axis[0], hinge.axis[1], -hinge.axis[2]))

        return replace(
            self,
            bones=tuple(replace(bone, pivot=flip(bone.pivot), hinges=tuple(turn(hinge) for hinge in bone.hinges)) for bone in self.bones),
            markers=tuple(replace(marker, place=flip(marker.place)) for marker in self.markers),
            capsules=tuple(replace(part, start=flip(part.start), end=flip(part.end)) for part in self.capsules),
        )

    def sized(self, height: float) -> ArticulatedBody:
        """The body of a person of this height (m), the same everywhere else. Raises AsterismError where it is not a height in metres."""
        if not 0.3 < height < 2.8:
            raise AsterismError(f"a height of {height:g} m is not a person's; give metres, 0.3 to 2.8.")
        # All lengths grow alike; angles, and how much people differ, stay.
        k = height / self.height

        def grown(place: Sequence[float]) -> tuple[float, float, float]:
            return (k * place[0], k * place[1], k * place[2])

        return replace(
            self,
            height=height,
            bones=tuple(replace(bone, pivot=grown(bone.pivot)) for bone in self.bones),
            markers=tuple(replace(marker, place=grown(marker.place)) for marker in self.markers),
            capsules=tuple(
                replace(part, start=grown(part.start), end=grown(part.end), radii=(k * part.radii[0], k * part.radii[1]))
                for part in self.capsules
            ),
        )

    @cached_property
    def arrays(self) -> ArticulatedBodyArrays:
        """The body as the kernels take it."""
        index = {bone.name: i for i, bone in enumerate(self.bones)}
        parents: Ints = np.array([index.get(bone.parent, -1) for bone in self.bones], dtype=np.int64)
        root = np.array(self.bones[0].pivot)
        starts = np.concatenate([[0], np.cumsum([len(bone.hinges) for bone in self.bones])]).astype(np.int64)
        hinges = self.hinges
        moves = np.zeros((len(self.bones), len(hinges)), dtype=np.bool_)
        # A hinge moves its own bone and all below it; parents come first, so each bone inherits a complete row.
        for b in range(len(self.bones)):
            if parents[b] >= 0:
                moves[b] = moves[parents[b]]
            moves[b, starts[b] : starts[b + 1]] = True
        ends = [part.start for part in self.capsules] + [part.end for part in self.capsules]
        on = [index[part.bone] for part in self.capsules]
        return ArticulatedBodyArrays(
            parents,
            np.array([bone.pivot for bone in self.bones], dtype=np.float64) - root,
            starts,
            np.array([hinge.axis for hinge in hinges], dtype=np.float64).reshape(-1, 3),
            moves,
            np.array([hinge.low for hinge in hinges]),
            np.array([hinge.high for hinge in hinges]),
            np.array([hinge.usual for hinge in hinges]),
            np.array([hinge.spread**-2.0 for hinge in hinges]),
            np.array([index[marker.bone] for marker in self.markers], dtype=np.int64),
            self.places - root,
            np.array([marker.spread for marker in self.markers]),
            np.array(on + on, dtype=np.int64),
            np.array(ends, dtype=np.float64).reshape(-1, 3) - root,
            np.array([part.radii for part in self.capsules], dtype=np.float64).reshape(-1, 2),
        )

    @property
    def start_angles(self) -> Floats:
        """(N, J) rad, the poses from which a fit without a start begins."""
        return np.array(list(self.poses.values()) or [self.arrays.usual.tolist()], dtype=np.float64).reshape(-1, len(self.hinges))

    def _facts(self) -> Rows:
        return (
            ("title", self.title),
            ("height", f"{significant(self.height, 3)} m"),
            ("bones", listed([bone.name for bone in self.bones])),
            ("hinges", str(len(self.hinges))),
            ("markers", listed(self.labels)),
            ("capsules", str(len(self.capsules))),
            ("poses", listed(list(self.poses))),
        )

    def __repr__(self) -> str:
        return as_text("ArticulatedBody", self._facts())

    def _repr_html_(self) -> str:
        return as_html("ArticulatedBody", self._facts())
