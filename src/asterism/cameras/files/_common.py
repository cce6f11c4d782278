"""What the readers of rig files share: numbers checked, the units of an unlabelled length, what a rig lacks."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import LARGEST_IMAGE, Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.text import read_bytes
from asterism.geometry import nearest_orthogonal, rotation_from_vector
from asterism.recording import Floats
from asterism.recording.display import metres

MILLIMETRES_ABOVE = 50.0
"""Cameras that stand further from the origin than this many units are in millimetres: no room is 50 m, no rig 50 mm wide."""

UNIT_TAKEN = "the unit of length"
"""How the phrase in `Rig.lacks` begins that says which unit was taken."""

_ABSURD = 1e15
_ROUNDED = 2e-4
_OFF_CENTRE = 0.25

OPENCV_FROM_UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""From axes x right, y up, z backwards (QTM, photogrammetry) to OpenCV's."""


def numbers(where: str, what: str, values: Any, count: int | None = None) -> Floats:
    """Finite numbers from a text with blanks or any nested list, flat. Raises AsterismError, naming the place, for anything else."""
    try:
        #
        found = np.array(values.split() if isinstance(values, str) else values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        found = np.array([np.nan])
    if not (np.abs(found) < _ABSURD).all() or (count is not None and len(found) != count):
        wanted = "numbers" if count is None else "a number" if count == 1 else f"{count} numbers"
        raise AsterismError(f"{where}: its {what} is not {wanted}; the file is damaged, export it again.")
    return found


def image_size(where: str, values: Any) -> tuple[int, int]:
    """Width and height in whole px. Raises AsterismError, naming the place, where they are not those of an image."""
    width, height = (float(side) for side in numbers(where, "image size", values, 2))
    if not 1 <= min(width, height) <= max(width, height) <= LARGEST_IMAGE:
        raise AsterismError(f"{where}: its image size {width:g} x {height:g} is not that of an image, in pixels; mend it.")
    return int(width), int(height)


def rotation_of(where: str, values: Any) -> Floats:
    """The rotation matrix (3, 3) of nine numbers, row by row, that may be rounded to four decimals, or of a rotation vector (3,) rad.

    Raises AsterismError, naming the place, for anything else, and for one that mirrors.
    """
    found = numbers(where, "rotation", values)
    if len(found) == 3:
        return rotation_from_vector(found)
    if len(found) != 9:
        raise AsterismError(f"{where}: its rotation has {len(found)} numbers, not 3 or 9; the file is damaged, export it again.")
    given = found.reshape(3, 3)
    nearest = nearest_orthogonal(given)
    if np.abs(nearest - given).max() > _ROUNDED:
        raise AsterismError(
            f"{where}: its rotation matrix is not a rotation: its rows are not of length 1 and at right angles; export it again."
        )
    # A mirrored matrix is as orthogonal as a rotation, and would turn right hands into left ones.
    if np.linalg.det(nearest) < 0:
        raise AsterismError(f"{where}: its rotation mirrors the room, its axes are left-handed; export it again with right-handed axes.")
    return nearest


def rig_of(
    path: Path, kind: str, cameras: Iterable[Camera], metadata: dict[str, Any], lacks: Sequence[str] = (), *, equivalent: bool = False
) -> Rig:
    """A rig that says where it came from and what it lacks: what every format may lack is added to `lacks`.

    equivalent  whether cameras were fitted to others of another model, so that a lens may be anywhere
    """
    made = tuple(cameras)
    missing = [
        *of_whom("the image size", made, [camera.size is None for camera in made]),
        *of_whom("the pose", made, [not camera.posed for camera in made]),
        *of_whom("the reprojection error", made, [camera.error != camera.error for camera in made]),
        *(["which way is up"] if any(camera.posed for camera in made) else []),
        *of_whom(
            "a lens in the middle of the image (is the image size that of the calibration?)",
            made,
            [_aside(camera) and not equivalent for camera in made],
        ),
    ]
    try:
        return Rig(made, None, {"file": str(path), "format": kind, **metadata}, (*missing, *lacks))
    except AsterismError as problem:
        raise AsterismError(f"{path}: {problem}") from None


def of_whom(what: str, cameras: Sequence[Camera], absent: list[bool]) -> list[str]:
    """One phrase that names the cameras of which something is absent; none where it is of none."""
    if not any(absent):
        return []
    names = [camera.name for camera, lacks in zip(cameras, absent, strict=True) if lacks]
    return [f"{what} of every camera" if all(absent) else f"{what} of {', '.join(names)}"]


def _aside(camera: Camera) -> bool:
    """Whether the principal point is nearer to the image's border than to its middle, as none of a camera's own images has it."""
    return camera.size is not None and bool(np.any(np.abs(np.array(camera.centre) / camera.size - 0.5) > _OFF_CENTRE))


def in_metres(cameras: list[Camera]) -> tuple[list[Camera], list[str]]:
    """Cameras whose file names no unit, in metres; and a phrase that says which unit was taken.

    Told by how far they stand from the origin, of those that do not stand in it.
    """
    far = [float(np.linalg.norm(camera.translation)) for camera in cameras if camera.posed and np.any(camera.translation)]
    if not far:
        return cameras, []
    middle = float(np.median(far))
    scale, unit = (1e-3, "millimetres") if middle > MILLIMETRES_ABOVE else (1.0, "metres")
    made = [replace(camera, translation=scale * camera.translation) for camera in cameras]
    return made, [f"{UNIT_TAKEN} ({unit} taken: the cameras then stand {metres(middle * scale)} from the origin)"]


def read_otherwise(rig: Rig, units_per_metre: float) -> list[str]:
    """What to say where a file without a unit of length, written in this one, would be read in another by `in_metres`."""
    written = [replace(camera, translation=units_per_metre * camera.translation) for camera in rig]
    read, _ = in_metres(written)
    same = all(np.allclose(one.translation, other.translation) for one, other in zip(rig, read, strict=True))
    return [] if same else [f"{UNIT_TAKEN}, and readers that guess it will take another for cameras so near or so far"]


def xml_root(path: Path, name: str) -> ET.Element:
    """The root of an XML file. Raises AsterismError where the file is no XML, breaks off, or its root is not called `name`."""
    try:
        root = ET.fromstring(read_bytes(path))
    except (ET.ParseError, LookupError, ValueError) as problem:  # ill-formed, or of an unknown encoding
        raise AsterismError(f"{path} is damaged: it is no whole XML ({problem}); export it again.") from problem
    if root.tag != name:
        raise AsterismError(f"{path}: its root is <{root.tag}>, not <{name}>; this is no rig file that Asterism knows.")
    return root


def attribute(element: ET.Element | None, name: str, where: str) -> str:
    """An attribute that must be there. Raises AsterismError, naming the place, where it is not."""
    value = None if element is None else element.get(name)
    if value is None:
        raise AsterismError(f"{where}: it has no {name}; the file is damaged, export it again.")
    return value


def within(path: Path, make: Any) -> Camera:
    """A camera from `make()`; what is wrong with it is said with the file's name."""
    try:
        camera: Camera = make()
    except AsterismError as problem:
        raise AsterismError(str(problem) if str(path) in str(problem) else f"{path}, {problem}") from None
    return camera
