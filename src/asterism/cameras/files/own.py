"""Asterism's own rig file: TOML with a format version, metres and pixels, every field of every camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.toml import toml_line

FORMAT = "asterism-rig"
FORMAT_VERSION = 1
_REMADE = "write it again with asterism calibrate or asterism convert"


def rig_of_table(path: Path, table: dict[str, Any]) -> Rig:
    """The rig that `write_own` wrote, bit for bit, from its tables. Raises AsterismError where it is damaged or of a later version."""
    version = table.get("version")
    if not isinstance(version, int) or version < 1:
        raise AsterismError(f"{path} is damaged: its format version is {version!r}; {_REMADE}.")
    # A later format may mean other things by the same keys.
    if version > FORMAT_VERSION:
        raise AsterismError(f"{path} was written by a later Asterism (rig format {version}); update Asterism.")
    cameras = table.get("camera", [])
    if not isinstance(cameras, list) or not all(isinstance(camera, dict) for camera in cameras):
        raise AsterismError(f"{path} is damaged: its cameras are not tables [[camera]]; {_REMADE}.")
    metadata, lacks = table.get("metadata", {}), table.get("lacks", [])
    try:
        return Rig(
            tuple(_camera(path, place, camera) for place, camera in enumerate(cameras)),
            np.array(_floats(table["vertical"], 3)) if "vertical" in table else None,
            dict(metadata),
            tuple(str(phrase) for phrase in lacks),
        )
    except AsterismError as problem:
        #
        raise AsterismError(str(problem) if str(path) in str(problem) else f"{path}: {problem}") from None
    except (TypeError, ValueError) as problem:
        raise AsterismError(f"{path} is damaged ({problem}); {_REMADE}.") from problem


def write_own(path: Path, rig: Rig) -> list[str]:
    """Write a rig with all that it is. Returns an empty list: nothing is lost. Raises AsterismError where the place cannot be written."""
    lines = [toml_line("format", FORMAT), toml_line("version", FORMAT_VERSION), toml_line("units", "m, px, OpenCV's axes and lens model")]
    lines += [toml_line("vertical", rig.vertical.tolist())] if rig.vertical is not None else []
    lines += [toml_line("lacks", list(rig.lacks))] if rig.lacks else []
    for camera in rig:
        lines += ["", "[[camera]]", toml_line("name", camera.name)]
        lines += [toml_line("size", list(camera.size))] if camera.size else []
        lines += [toml_line(key, list(getattr(camera, key))) for key in ("focal", "centre", "radial", "tangential", "denominator")]
        lines += [toml_line("error", camera.error)] if camera.error == camera.error else []
        if camera.posed:
            lines += [toml_line("rotation", camera.rotation.tolist()), toml_line("translation", camera.translation.tolist())]
    if rig.metadata:
        lines += ["", "[metadata]", *(toml_line(str(key), value) for key, value in rig.metadata.items() if value is not None)]
    write_atomically(path, utf8("\n".join(lines) + "\n"))
    return []


def _camera(path: Path, place: int, table: dict[str, Any]) -> Camera:
    name = table.get("name")
    where = f"{path}, camera {name if isinstance(name, str) else place + 1}"
    posed = "rotation" in table or "translation" in table
    needed = ["name", "focal", "centre", *(["rotation", "translation"] if posed else [])]
    absent = [key for key in needed if key not in table]
    if absent:
        raise AsterismError(f"{where}: no {', '.join(absent)}; {_REMADE}.")
    try:
        rotation = np.array([_floats(row, 3) for row in table["rotation"]]) if posed else np.eye(3)
        return Camera(
            str(name),
            _size(table["size"]) if "size" in table else None,
            _pair(table["focal"]),
            _pair(table["centre"]),
            rotation,
            np.array(_floats(table["translation"], 3)) if posed else np.zeros(3),
            tuple(_floats(table.get("radial", []))),
            _pair(table.get("tangential", [0.0, 0.0])),
            tuple(_floats(table.get("denominator", [0.0, 0.0, 0.0]), 3)),  # type: ignore[arg-type]
            float(table.get("error", float("nan"))),
            posed,
        )
    except AsterismError as problem:
        raise AsterismError(f"{path}, {problem}") from None
    except (TypeError, ValueError, IndexError, OverflowError) as problem:
        raise AsterismError(f"{where}: one of its values has the wrong type or length ({problem}); {_REMADE}.") from problem


def _size(values: Any) -> tuple[int, int]:
    width, height = _pair(values)
    return int(width), int(height)


def _pair(values: Any) -> tuple[float, float]:
    first, second = _floats(values, 2)
    return first, second


def _floats(values: Any, count: int | None = None) -> list[float]:
    numbers = [float(value) for value in values if not isinstance(value, str | bool)]
    if len(numbers) != len(values) or (count is not None and len(numbers) != count):
        raise ValueError(f"{len(numbers)} numbers where {count} belong")
    return numbers
