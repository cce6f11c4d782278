"""The bones of a skeleton over time: which bone hangs on which, how long they are, how they turn."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from asterism.errors import AsterismError
from asterism.recording.arrays import Floats, as_vertical, checked_rate
from asterism.recording.display import Rows, as_html, as_text, duration

_ORTHONORMAL = 1e-6
"""How far R R^T may be off the identity. Angles kept as 6 decimals of a degree are 1e-8 off; a matrix that scales by 1 %, 0.02."""


@dataclass(frozen=True, repr=False, eq=False)
class SkeletonMotion:
    """Rigid bones joined to a tree, over T frames; what BVH and glTF hold.

    names      of the B bones; each bone stands behind its parent
    parents    (B,) the bone on which each hangs, -1 for the root, which is the first bone and the only one
    offsets    (B, 3) m, the joint of each bone in the axes of its parent; of the root zero
    ends       (B, 3) m, where each bone ends in its own axes; NaN where another bone hangs on that end
    rotations  (T, B, 3, 3) from the axes of each bone to those of its parent, of the root to the room's
    root       (T, 3) m, the joint of the root in the room
    rate       frames per second
    vertical   (3,) unit vector, up
    forward    (3,) unit vector, where the body faces in the rest pose, in which no bone is turned

    In the rest pose every rotation is the identity, so that `offsets` and `ends` draw the standing body in the room's axes.
    A bone that is not known in a frame has rotations of NaN there, and so have all that hang on it.
    Raises AsterismError where shapes do not fit, a bone stands before its parent, or a known rotation is none.

    >>> motion = SkeletonMotion(
    ...     ("thigh", "shank"), (-1, 0), np.array([[0, 0, 0], [0, 0, -0.4]]), np.array([[np.nan] * 3, [0, 0, -0.4]]),
    ...     np.tile(np.eye(3), (1, 2, 1, 1)), np.array([[0, 0, 0.9]]), rate=100.0)
    >>> motion.joints[0, 1].round(3).tolist()
    [0.0, 0.0, 0.5]
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Floats
    ends: Floats
    rotations: Floats
    root: Floats
    rate: float
    vertical: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    forward: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))

    def __post_init__(self) -> None:
        for name in ("offsets", "ends", "rotations", "root"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        bones, frames = len(self.names), len(self.root)
        for name, shape in {"offsets": (bones, 3), "ends": (bones, 3), "rotations": (frames, bones, 3, 3), "root": (frames, 3)}.items():
            if getattr(self, name).shape != shape:
                raise AsterismError(
                    f"{name} of a skeleton of {bones} bones and {frames} frames have shape {getattr(self, name).shape}, expected {shape}."
                )
        if len(set(self.names)) != bones or not bones:
            raise AsterismError("the bones of a skeleton need names of their own, and there must be one; give each another name.")
        if len(self.parents) != bones or self.parents[0] != -1 or any(not 0 <= p < b for b, p in enumerate(self.parents) if b):
            raise AsterismError(
                f"the parents of a skeleton are {self.parents}; the root comes first with -1, and each bone behind its parent."
            )
        known = self.rotations[np.isfinite(self.rotations).all(axis=(2, 3))]
        if len(known) and (np.abs(known @ known.swapaxes(1, 2) - np.eye(3)).max() > _ORTHONORMAL or (np.linalg.det(known) < 0).any()):
            raise AsterismError("a rotation of a bone scales, shears or mirrors; give rotations only.")
        object.__setattr__(self, "rate", checked_rate(self.rate))
        object.__setattr__(self, "vertical", as_vertical(self.vertical))
        object.__setattr__(self, "forward", np.asarray(self.forward, dtype=np.float64))

    def __len__(self) -> int:
        return len(self.root)

    @cached_property
    def _posed(self) -> tuple[Floats, Floats]:
        turned, joints = np.empty_like(self.rotations), np.empty((len(self), len(self.names), 3))
        turned[:, 0], joints[:, 0] = self.rotations[:, 0], self.root
        for bone, parent in enumerate(self.parents[1:], start=1):
            turned[:, bone] = turned[:, parent] @ self.rotations[:, bone]
            joints[:, bone] = joints[:, parent] + turned[:, parent] @ self.offsets[bone]
        return turned, joints

    @property
    def turned(self) -> Floats:
        """(T, B, 3, 3) from the axes of each bone to the room's."""
        return self._posed[0]

    @property
    def joints(self) -> Floats:
        """(T, B, 3) m, the joint of each bone in the room."""
        return self._posed[1]

    @cached_property
    def rest_joints(self) -> Floats:
        """(B, 3) m, the joint of each bone in the rest pose, the root at the origin."""
        joints = np.zeros((len(self.names), 3))
        for bone, parent in enumerate(self.parents[1:], start=1):
            joints[bone] = joints[parent] + self.offsets[bone]
        return joints

    @property
    def tips(self) -> Floats:
        """(T, B, 3) m, the end of each bone in the room; NaN where `ends` is."""
        return self.joints + np.einsum("tbij,bj->tbi", self.turned, self.ends)

    @property
    def lengths(self) -> Floats:
        """(B,) m, from the joint of each bone to its end, or to the first bone that hangs on it; NaN where neither is told."""
        lengths = np.linalg.norm(self.ends, axis=1)
        for bone, parent in reversed(list(enumerate(self.parents))):
            if parent >= 0 and np.isnan(self.ends[parent]).any():
                lengths[parent] = np.linalg.norm(self.offsets[bone])
        return lengths

    def in_axes(self, vertical: Floats, forward: Floats) -> SkeletonMotion:
        """The same motion in a room whose axes are turned so that up and forward are these (3,)."""
        turn = _level_frame(vertical, forward) @ _level_frame(self.vertical, self.forward).T
        # exchanged axes keep every digit
        exact = np.round(turn) + 0.0
        turn = exact if np.abs(turn - exact).max() < 1e-9 else turn
        if np.array_equal(turn, np.eye(3)):
            return self
        return replace(
            self,
            offsets=self.offsets @ turn.T,
            ends=self.ends @ turn.T,
            rotations=turn @ self.rotations @ turn.T,
            root=self.root @ turn.T,
            vertical=turn @ self.vertical,
            forward=turn @ self.forward,
        )

    def _rows(self) -> Rows:
        return [("bones", str(len(self.names))), ("frames", duration(len(self), self.rate))]

    def __repr__(self) -> str:
        return as_text("SkeletonMotion", self._rows())

    def _repr_html_(self) -> str:
        return as_html("SkeletonMotion", self._rows())


def _level_frame(up: Floats, forward: Floats) -> Floats:
    """(3, 3) columns: forward over the floor, left, up. Where forward is not level or not known, any level direction."""
    level = forward - (forward @ up) * up
    if not np.isfinite(level).all() or np.linalg.norm(level) < 1e-6:
        other = np.eye(3)[int(np.abs(up).argmin())]
        level = other - (other @ up) * up
    ahead = level / np.linalg.norm(level)
    return np.stack([ahead, np.cross(up, ahead), up], axis=1)
