"""What the readers of rig files share: numbers checked, the units of an unlabelled length, what a rig lacks."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.formats._text import read_bytes
from asterism.recording import Floats

MILLIMETRES_ABOVE = 50.0
"""Cameras that stand further from the origin than this many units are in millimetres: no room is 50 m, no rig 50 mm wide."""

OPENCV_FROM_UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""From axes x right, y up, z backwards (QTM, photogrammetry) to OpenCV's."""


def numbers(where: str, what: str, values: Any, count: int | None = None) -> Floats:
    """Finite numbers from a text with blanks or any nested list, flat. Raises AsterismError, naming the place, for anything else."""
    try:
        found = np.array(values.split() if isinstance(values, str) else values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        found = np.array([np.nan])
    if not np.isfinite(found).all() or (count is not None and len(found) != count):
        wanted = "numbers" if count is None else "a number" if count == 1 else f"{count} numbers"
        raise AsterismError(f"{where}: its {what} is not {wanted}; the file is damaged, export it again.")
    return found


def rig_of(
    path: Path, kind: str, cameras: Iterable[Camera], metadata: dict[str, Any], lacks: Sequence[str] = (), vertical: Floats | None = None
) -> Rig:
    """A rig that says where it came from and what it lacks: what every format may lack is added to `lacks`."""
    made = tuple(cameras)
    missing = [
        *_of_whom("the image size", made, [camera.size is None for camera in made]),
        *_of_whom("the pose", made, [not camera.posed for camera in made]),
        *_of_whom("the reprojection error", made, [camera.error != camera.error for camera in made]),
        *(["which way is up"] if vertical is None and any(camera.posed for camera in made) else []),
    ]
    try:
        return Rig(made, vertical, {"file": str(path), "format": kind, **metadata}, (*missing, *lacks))
    except AsterismError as problem:
        raise AsterismError(f"{path}: {problem}") from None


def _of_whom(what: str, cameras: Sequence[Camera], absent: list[bool]) -> list[str]:
    if not any(absent):
        return []
    names = [camera.name for camera, lacks in zip(cameras, absent, strict=True) if lacks]
    return [f"{what} of every camera" if all(absent) else f"{what} of {', '.join(names)}"]


def metres_per_unit(positions: Sequence[Floats]) -> tuple[float, str]:
    """The scale of a rig whose file names no unit, by how far its cameras stand from the origin; and a phrase that says so."""
    far = float(np.median([np.linalg.norm(position) for position in positions]))
    millimetres = far > MILLIMETRES_ABOVE
    scale = 1e-3 if millimetres else 1.0
    unit = "millimetres" if millimetres else "metres"
    return scale, f"the unit of length ({unit} taken: the cameras then stand {far * scale:.2g} m from the origin)"


def xml_root(path: Path, name: str) -> ET.Element:
    """The root of an XML file. Raises AsterismError where the file is no XML, breaks off, or its root is not called `name`."""
    try:
        root = ET.fromstring(read_bytes(path))
    except ET.ParseError as problem:
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
