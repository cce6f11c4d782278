"""The movement of a skeleton in; its numbers as a table and in a C3D copy, and what a person should know of it, out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.files.tables import NumberTable
from asterism.findings import Finding, Severity
from asterism.geometry import z_up_rotation
from asterism.recording import Recording
from asterism.skeleton.inverse_kinematics import RULES, Kinematics
from asterism.skeleton.person import lengths_of_bones

if TYPE_CHECKING:
    from asterism.formats import AnalysisValue, ModelPoint

COLUMNS: Mapping[str, type] = {
    "file": str, "kind": str, "name": str, "frame": int, "time_s": float, "value": float, "uncertainty": float, "unit": str
}  # fmt: skip
"""Of the table. Kinds are "length" of a bone, "spread" and "miss" of a marker (root mean square), and "coordinate" in each frame.

Frames as the file counts them; the uncertainty is a standard deviation.
"""

_ASTRAY = 6.0
"""Spreads from which a marker is no longer about its place: skin is within 4, a wrong label beyond 10."""
_SHARE = 0.1
"""Of a marker's frames that may be astray: a single step on a wand, a single exchange, is told by the frame and needs no word."""
_UNSEEN_S = 0.2
"""s without a marker of its own from which a bone is told: a filled gap is as long; half of it, and each walk has some."""
_ROUGH = 3.0
"""How many times farther than their spreads markers are on a skeleton that is not that of the person."""


def kinematics_table(found: Sequence[tuple[str, Kinematics, Recording]]) -> NumberTable:
    """All numbers of movements, by the names of their files: bone lengths, marker spreads and misses, and the coordinates of each frame."""
    return NumberTable(COLUMNS, tuple(row for name, movement, recording in found for row in _rows(name, movement, recording)))


def _rows(file: str, found: Kinematics, recording: Recording) -> Iterator[tuple[Any, ...]]:
    for name, length in lengths_of_bones(found.tree).items():
        yield (file, "length", name, None, None, length, None, "m")
    for m, marker in enumerate(found.tree.markers):
        own = found.misses[:, m]
        if np.isfinite(own).any():
            yield (file, "spread", marker.name, None, None, marker.spread, None, "m")
            yield (file, "miss", marker.name, None, None, float(np.sqrt(np.nanmean(own**2))), None, "m")
    times = recording.times
    columns = [(f"{found.tree.bones[0].name} {axis}", found.places[:, i], found.sd[:, i], 1.0, "m") for i, axis in enumerate("xyz")]
    columns = columns if found.tree.free else []
    for i, coordinate in enumerate(found.tree.coordinates):
        factor, unit = (1.0, "m") if coordinate.slides else (np.degrees(1.0), "deg")
        columns.append((coordinate.name, found.coordinates[:, i], found.sd[:, 6 + i], factor, unit))
    for name, values, sd, factor, unit in columns:
        for t in np.nonzero(found.known)[0]:
            frame = recording.first_frame + int(t)
            yield (file, "coordinate", name, frame, float(times[t]), float(factor * values[t]), float(factor * sd[t]), unit)


def write_kinematics_c3d(path: str | Path, found: Kinematics, recording: Recording) -> list[str]:
    """Write a copy of the recording with the skeleton's joints, angles and bone lengths, whole or not at all; a file at `path` is replaced.

    Joints ("left shank joint") are points of the list MODELED_MARKERS. The coordinates of a joint ("left shank angles"), up to three in
    their order, and the root's turn (rotation vector), are in the list ANGLES; lengths are in the group ANALYSIS. Frames that show too
    little have none. Returns what a reader of the file must know. Raises AsterismError where the file cannot be written.
    """
    from asterism.formats import write_model_outputs

    return write_model_outputs(Path(path), recording, _points(found), _lengths(found))


def _points(found: Kinematics) -> list[ModelPoint]:
    from scipy.spatial.transform import Rotation

    from asterism.formats import ModelPoint

    joints = found.posed[1].copy()
    joints[~found.known] = np.nan
    column = {coordinate.name: i for i, coordinate in enumerate(found.tree.coordinates)}
    points = []
    for b, bone in enumerate(found.tree.bones):
        if b or found.tree.free:
            points.append(ModelPoint(f"{bone.name} joint", "MODELED_MARKERS", joints[:, b]))
        names = list(
            dict.fromkeys(m.coordinate for m in bone.motions if m.coordinate and not found.tree.coordinates[column[m.coordinate]].slides)
        )
        values = np.zeros((len(found), 3))
        values[:, : len(names[:3])] = found.coordinates[:, [column[name] for name in names[:3]]]
        if not b and found.tree.free:
            back = z_up_rotation(found.vertical)
            values = Rotation.from_matrix(back.T @ found.turns @ back).as_rotvec()
        elif not names:
            continue
        values[~found.known] = np.nan
        points.append(ModelPoint(f"{bone.name} angles", "ANGLES", values))
    return points


def _lengths(found: Kinematics) -> list[AnalysisValue]:
    from asterism.formats import AnalysisValue

    sides = {"left": "Left", "right": "Right"}
    values = []
    for name, length in lengths_of_bones(found.tree).items():
        side, _, plain = name.partition(" ")
        context, bone = (sides[side], plain) if side in sides else ("General", name)
        values.append(AnalysisValue(f"Length {bone}", context, length, "m", "of the fitted skeleton"))
    return values


def kinematics_findings(found: Kinematics, recording: Recording) -> list[Finding]:
    """What a person should know before they use a movement."""
    where = str(recording.metadata.get("file", "the recording"))
    out: list[Finding] = []
    scale = np.array([np.hypot(marker.spread, RULES.noise) for marker in found.tree.markers]) * max(found.noise_scale, 1.0)
    seen = np.isfinite(found.misses)
    if found.noise_scale > _ROUGH:
        miss = 1000 * float(np.nanmedian(found.misses))
        out.append(
            Finding(
                "skeleton-rough",
                Severity.WARNING,
                where,
                f"the markers are {miss:.0f} mm (median) from where the skeleton has them: it is another person's, or labels are wrong.",
                "Give the person's own standing trial with --static, and check the labels with asterism audit.",
            )
        )
    astray = seen & (np.nan_to_num(found.misses) > _ASTRAY * scale)
    shares = astray.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    for m in np.nonzero(shares > _SHARE)[0]:
        name, frames = found.tree.markers[m].name, np.nonzero(astray[:, m])[0]
        first, last = (recording.first_frame + int(frame) for frame in (frames[0], frames[-1]))
        miss = 1000 * float(np.median(found.misses[frames, m]))
        out.append(
            Finding(
                "skeleton-marker-astray",
                Severity.WARNING,
                f"{where}, {name}",
                f"{name} is {miss:.0f} mm from its place on the {found.tree.markers[m].bone} in {len(frames)} frames ({first} to {last}): "
                "a wrong label, or a marker that came off. It hardly counts there.",
                "Look at it with asterism review.",
            )
        )
    for bone in found.tree.bones:
        own = [m for m, marker in enumerate(found.tree.markers) if marker.bone == bone.name]
        hidden = found.known & ~seen[:, own].any(axis=1)
        longest = _longest(hidden)
        if own and len(longest) >= max(2, _UNSEEN_S * found.rate):
            numbers = [6 + i for i, c in enumerate(found.tree.coordinates) if any(m.coordinate == c.name for m in bone.motions)]
            most = np.degrees(found.sd[longest][:, numbers].max()) if numbers else np.nan
            certain = f", with standard deviations up to {most:.0f} degrees" if np.isfinite(most) else ""
            first, last = recording.first_frame + int(longest[0]), recording.first_frame + int(longest[-1])
            out.append(
                Finding(
                    "skeleton-bone-unseen",
                    Severity.NOTE,
                    f"{where}, {bone.name}",
                    f"no marker of the {bone.name} is seen in frames {first} to {last}: its joint is led by the frames around{certain}.",
                    "Fill the gap, or leave these frames out.",
                )
            )
    if not found.known.all():
        out.append(
            Finding(
                "skeleton-frames-left-out",
                Severity.NOTE,
                where,
                f"{int((~found.known).sum())} of {len(found)} frames show fewer than three markers of the skeleton, and have no pose.",
                "None is needed where the person is out of view.",
            )
        )
    return out


def _longest(flags: np.ndarray) -> np.ndarray:
    """The frames of the longest run that is true."""
    edges = np.nonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))[0].reshape(-1, 2)
    if not len(edges):
        return np.empty(0, dtype=np.int64)
    first, last = edges[int(np.argmax(edges[:, 1] - edges[:, 0]))]
    return np.arange(first, last)
