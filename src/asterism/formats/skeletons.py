"""Files of skeletons: BVH and glTF in, bones over time out, and back; the suffix says which."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError, guarded_reading
from asterism.formats._bones import SkeletonFile, located_file
from asterism.recording import SkeletonMotion, as_vertical, axis_name

SUFFIXES = (".bvh", ".glb", ".gltf")


def is_skeleton_file(path: str | Path) -> bool:
    """Whether a name's suffix is that of a skeleton; nothing is read.

    >>> is_skeleton_file("walk.BVH"), is_skeleton_file("walk.c3d")
    (True, False)
    """
    return Path(path).suffix.casefold() in SUFFIXES


def read_skeleton(
    path: str | Path, *, unit: str | float | None = None, vertical: ArrayLike | str | None = None, animation: str | int | None = None
) -> SkeletonFile:
    """The skeleton of a BVH or glTF file over time, in metres and in the file's axes, with what was assumed of it.

    unit       of length of a BVH, which does not say it: "cm", "in", or metres per unit; None: what fits the size of a person
    vertical   None: y, unless the skeleton stands along another axis; or an axis
    animation  of a glTF file: its name or number; None: the first

    Raises AsterismError, naming the file, where it cannot be read or holds no skeleton.
    """
    from asterism.formats import bvh, gltf

    path, up = Path(path), None if vertical is None else as_vertical(vertical)
    with guarded_reading(path):
        with path.open("rb") as file:
            head = file.read(512)
        if path.suffix.casefold() == ".bvh" or head.lstrip(b"\xef\xbb\xbf \t\r\n").upper().startswith(b"HIERARCHY"):
            found = bvh.read_bvh(path, unit, up)
        elif is_skeleton_file(path) or head.startswith(b"glTF"):
            found = gltf.read_gltf(path, animation, up)
        else:
            raise AsterismError(f"{path} holds no skeleton; give a BVH or glTF file.")
    return located_file(path, found)


def check_skeleton_form(unit: str | float, order: str) -> None:
    """Raise AsterismError where a BVH cannot be written in this unit of length, or with angles in this order."""
    from asterism.formats import bvh

    bvh.metres_in(unit)
    bvh.checked_order(order)


def write_skeleton(
    path: str | Path,
    motion: SkeletonMotion,
    *,
    like: str | Path | None = None,
    unit: str | float = "cm",
    order: str = "ZXY",
    missing: str = "hold",
) -> list[str]:
    """Write a skeleton over time as BVH or glTF; returns what the format cannot carry, a phrase each.

    like     a file of the same format whose skeleton, names, axes and unit are kept; of a glTF file with its meshes and all else
    unit     of length of a BVH; glTF has metres
    order    of the Euler angles of a BVH, the outermost first
    missing  "hold" or "interpolate": what becomes of bones in frames in which they are not known

    New files have y up and face z in the rest pose. Raises AsterismError where the suffix is another, or the file cannot be written.

    >>> import numpy as np
    >>> motion = SkeletonMotion(("hips",), (-1,), np.zeros((1, 3)), np.array([[0, 0, 0.4]]), np.tile(np.eye(3), (2, 1, 1, 1)),
    ...                         np.zeros((2, 3)), rate=100.0)
    >>> write_skeleton("hips.bvh", motion)
    ['the axes of the room: its x, y, z became z, x, y, so that y is up']
    >>> read_skeleton("hips.bvh", unit="cm").motion
    SkeletonMotion(bones: 1, frames: 2 at 100 Hz (0.02 s))
    """
    from asterism.formats import bvh, gltf

    path, source = Path(path), None if like is None else Path(like)
    if not is_skeleton_file(path):
        raise AsterismError(f"{path} has not the suffix of a skeleton; write .bvh, .glb or .gltf.")
    if source is not None and (path.suffix.casefold() == ".bvh") != (source.suffix.casefold() == ".bvh"):
        raise AsterismError(f"{path} is another format than {source}, whose skeleton it is to keep; write {source.suffix}.")
    if path.suffix.casefold() == ".bvh":
        return bvh.write_bvh(path, motion, like=source, unit=unit, order=order, missing=missing)
    return gltf.write_gltf(path, motion, like=source, missing=missing)


def describe_skeleton(path: Path) -> dict[str, Any]:
    """What a skeleton's file holds, as plain values: format, frames, rate, unit, vertical, bones with their lengths in m, findings."""
    found = read_skeleton(path)
    motion = found.motion
    lengths = [None if np.isnan(length) else round(float(length), 4) for length in motion.lengths]
    return {
        "file": str(path),
        "format": found.kind,
        "frames": len(motion),
        "rate": motion.rate,
        "metres_per_unit": found.unit,
        "vertical": axis_name(motion.vertical),
        "bones": dict(zip(motion.names, lengths, strict=True)),
        "findings": found.findings,
    }
