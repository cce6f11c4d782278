"""What the formats of skeletons have in common: axes, Euler angles, bones that are missing, and which way is up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats._findings import vertical_assumed, vertical_conflict
from asterism.geometry import axis_rotations
from asterism.recording import Floats, Ints, SkeletonMotion, axis_name
from asterism.recording.bone_names import parts_of, split_name

_LOCKED = 1e-9
"""Cosine of the middle Euler angle below which the outer two turn about one axis, and only their sum is known."""


@dataclass(frozen=True)
class SkeletonFile:
    """A skeleton from a file. unit: metres per unit of the file; findings name no file until `read_skeleton` gives them."""

    motion: SkeletonMotion
    kind: str
    unit: float
    findings: tuple[Finding, ...] = ()


def from_euler(order: str, angles: Floats) -> Floats:
    """The rotations (T, 3, 3) of angles (T, n) rad about the axes of `order`, the outermost first; of no angles the identity."""
    out = np.tile(np.eye(3), (len(angles), 1, 1))
    for axis, column in zip(order, angles.T, strict=True):
        out = out @ axis_rotations(axis.lower(), column)
    return out


def as_euler(rotations: Floats, order: str) -> Floats:
    """(T, ..., n) rad, the angles about up to three different axes, the outermost first, that give rotations (T, ..., 3, 3).

    Of the angles that give a rotation, those nearest to the frame before are taken, so that curves have no jumps. Where the middle
    angle is a right angle, the innermost one stays as it was. With fewer than three axes the rest of the rotation is left out.
    """
    axes = ["XYZ".index(axis) for axis in order.upper()]
    i, j, k = (*axes, *(axis for axis in range(3) if axis not in axes))
    odd = 1.0 if (j - i) % 3 == 1 else -1.0
    r = rotations.reshape(len(rotations), -1, 3, 3)
    cosine = np.hypot(r[..., i, i], r[..., i, j])
    middle = odd * np.arctan2(r[..., i, k], cosine)
    inner = np.where(cosine > _LOCKED, -odd * np.arctan2(r[..., i, j], r[..., i, i]), 0.0)
    frames = np.maximum.accumulate(np.where(cosine > _LOCKED, np.arange(len(r))[:, None], 0), axis=0)
    inner = np.take_along_axis(inner, frames, axis=0)
    # the outer angle is what is left when the inner one is taken out, exact also near a right angle
    back = axis_rotations("xyz"[k], inner.ravel()).swapaxes(1, 2).reshape(r.shape)
    rest = np.einsum("tbxy,tbyz->tbxz", r, back)
    outer = np.arctan2(odd * rest[..., k, j], rest[..., j, j])
    one = np.stack([outer, middle, inner], axis=2)
    other = np.stack([outer + np.pi, np.pi - middle, inner + np.pi], axis=2)
    # From a frame to the next, angles of both kinds change alike: what counts is where the kind must change. The first frame has the
    # angles that a person would write.
    kept, changed = (np.abs(_wrapped(after[1:] - one[:-1])).sum(axis=2) for after in (one, other))
    kind = np.cumsum(np.concatenate([np.zeros((1, r.shape[1]), dtype=np.int64), changed < kept - 1e-9]), axis=0) % 2
    found = np.unwrap(np.where(kind[:, :, None] == 1, other, one), axis=0)
    return found.reshape(*rotations.shape[:-2], 3)[..., : len(axes)]


def _wrapped(angles: Floats) -> Floats:
    """Angles within half a turn to both sides."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def unlike(names: list[str]) -> tuple[str, ...]:
    """The names, with a number behind those that stand twice."""
    seen: dict[str, int] = {}
    out = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        out.append(name if seen[name] == 1 else f"{name} {seen[name]}")
    return tuple(out) if len(set(out)) == len(out) else tuple(f"{name} #{n}" for n, name in enumerate(out))


def fill_missing_bones(motion: SkeletonMotion, how: str) -> tuple[SkeletonMotion, list[str]]:
    """The motion without missing bones, and what became of them, a phrase each: BVH and glTF have no sign for a missing value.

    how  "hold": a bone stays turned as it last was, at the beginning as it first is; "interpolate": it turns evenly across a gap

    Raises AsterismError where the root has no frame.
    """
    if how not in ("hold", "interpolate"):
        raise AsterismError(f"missing={how!r} is not known; give hold or interpolate.")
    known: NDArray[np.bool_] = np.asarray(np.isfinite(motion.rotations).all(axis=(2, 3)))
    placed: NDArray[np.bool_] = np.asarray(np.isfinite(motion.root).all(axis=1))
    if known.all() and placed.all():
        return motion, []
    if not placed.any() or not known[:, 0].any():
        raise AsterismError("the root of the skeleton is missing in every frame; there is nothing to write.")
    root = motion.root.copy()
    root[~placed] = root[_last_known(placed)[~placed]] if how == "hold" else _interpolated(root, placed)[~placed]
    rotations = motion.rotations.copy()
    for b in np.nonzero(~known.all(axis=0))[0]:
        there = known[:, b]
        if not there.any():
            rotations[:, b] = np.eye(3)
        elif how == "hold" or there.sum() == 1:
            rotations[~there, b] = rotations[_last_known(there)[~there], b]
        else:
            rotations[~there, b] = _slerped(rotations[:, b], there)
    never = [motion.names[b] for b in np.nonzero(~known.any(axis=0))[0]]
    gaps = [motion.names[b] for b in np.nonzero(~known.all(axis=0) & known.any(axis=0))[0]]
    frames = int((~(known | ~known.any(axis=0)).all(axis=1) | ~placed).sum())
    what = "are held as they last were" if how == "hold" else "were interpolated"
    said = [f"which bones are missing in {frames} of {len(motion)} frames ({_some(gaps)}): they {what}"] if frames else []
    return replace(motion, rotations=rotations, root=root), said + (
        [f"that {_some(never)} are never known: as in the rest pose"] if never else []
    )


def _some(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "") if names else "the root"


def _last_known(known: NDArray[np.bool_]) -> Ints:
    """(T,) for each frame the last known one, before the first the first."""
    at = np.where(known, np.arange(len(known)), -1)
    last = np.maximum.accumulate(at)
    return np.where(last < 0, int(np.argmax(known)), last)


def _interpolated(values: Floats, known: NDArray[np.bool_]) -> Floats:
    frames = np.arange(len(values))
    return np.stack([np.interp(frames, frames[known], column[known]) for column in values.T], axis=1)


def _slerped(rotations: Floats, known: NDArray[np.bool_]) -> Floats:
    from scipy.spatial.transform import Rotation, Slerp

    frames = np.arange(len(rotations))
    ends = frames[known]
    turn = Slerp(ends, Rotation.from_matrix(rotations[known]))
    found: Floats = turn(np.clip(frames[~known], ends[0], ends[-1])).as_matrix()
    return found


def turned_into(motion: SkeletonMotion, up: Floats, forward: Floats) -> tuple[SkeletonMotion, str]:
    """The motion in axes in which up and forward are these, and what became of the axes, "" where nothing."""
    turned = motion.in_axes(up, forward)
    if turned is motion:
        return motion, ""
    # where the axes went, by a skeleton of which nothing else is known
    news = [axis_name(replace(motion, root=np.tile(axis, (len(motion), 1))).in_axes(up, forward).root[0]) for axis in np.eye(3)]
    return turned, f"the axes of the room: its x, y, z became {', '.join(news)}, so that {axis_name(up)} is up"


def vertical_of(motion: SkeletonMotion, vertical: Floats | None, usual: str = "y") -> tuple[SkeletonMotion, list[Finding]]:
    """The motion with the vertical that is given, else the format's own, or another where rest pose or movement show so.

    A head is above the feet, in the rest pose or over the frames: where both show the same axis and it is not the usual one, that is up.
    """
    if vertical is not None:
        return replace(motion, vertical=vertical), []
    along = np.eye(3)["xyz".index(usual)]
    shown = _head_over_feet(motion)
    if shown is None:
        return replace(motion, vertical=along), []
    rest, moving = shown
    best = [np.eye(3)[int(np.abs(v).argmax())] * np.sign(v[np.abs(v).argmax()]) for v in (rest, moving)]
    # someone who lies in all frames shows no vertical, and has a rest pose that does
    if (best[0] @ along > 0.5 and rest @ along > 0.5) or (best[1] @ along > 0.5 and moving @ along > 0.5):
        return replace(motion, vertical=along), []
    agreed = np.array_equal(best[0], best[1]) and min(np.abs(rest).max(), np.abs(moving).max()) > 0.7
    if agreed:
        said = f"{usual} should be up, but the skeleton stands along {axis_name(best[0])}, which was taken"
        return replace(motion, vertical=best[0]), [vertical_conflict(said)]
    return replace(motion, vertical=along), [vertical_assumed(f"neither rest pose nor frames show which way is up; {usual} was taken")]


def _head_over_feet(motion: SkeletonMotion) -> tuple[Floats, Floats] | None:
    """Two unit vectors from the feet to the head: in the rest pose, and on average over the frames. None without such names."""
    parts = parts_of(motion.names, motion.parents)
    feet = [parts[f"{side} {part}"] for side in ("left", "right") for part in ("foot", "shank") if f"{side} {part}" in parts]
    head = parts.get("head", parts.get("neck"))
    if head is None or not feet:
        return None
    some = motion.joints[:: max(1, len(motion) // 200)]
    rest = motion.rest_joints
    found = []
    for joints in (rest[None], some[np.isfinite(some).all(axis=(1, 2))]):
        up = (joints[:, head] - joints[:, feet].mean(axis=1)).mean(axis=0) if len(joints) else np.zeros(3)
        length = np.linalg.norm(up)
        found.append(up / length if length > 0 else up)
    return found[0], found[1]


def forward_of(motion: SkeletonMotion) -> SkeletonMotion:
    """The motion with the direction in which its rest pose faces: left of it are the bones whose names say so. Without such names, z."""
    joints, by_name = motion.rest_joints, {split_name(name): b for b, name in enumerate(motion.names)}
    across = np.zeros(3)
    for (side, word, number), b in by_name.items():
        other = by_name.get(("right", word, number))
        if side == "left" and other is not None:
            apart = joints[b] - joints[other]
            across += apart - (apart @ motion.vertical) * motion.vertical
    if np.linalg.norm(across) < 1e-9:
        usual = np.array([0.0, 0.0, 1.0]) if abs(motion.vertical[2]) < 0.5 else np.array([0.0, -1.0, 0.0])
        return replace(motion, forward=usual)
    ahead = np.cross(across / np.linalg.norm(across), motion.vertical)
    # rest poses are made along axes: a figure that is a little askew keeps its axis
    axis = int(np.abs(ahead).argmax())
    if abs(ahead[axis]) > 0.9:
        ahead = np.eye(3)[axis] * np.sign(ahead[axis])
    return replace(motion, forward=ahead)


def located_file(path: Path, found: SkeletonFile) -> SkeletonFile:
    """The same, with findings that name the file."""
    from asterism.formats._findings import located

    return replace(found, findings=located(path, found.findings))
