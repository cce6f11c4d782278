"""Anipose's, Pose2Sim's and caliscope's rig files: TOML tables with matrix, distortions, rotation and translation, in and out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import image_size, in_metres, numbers, of_whom, read_otherwise, rig_of, rotation_of, within
from asterism.cameras.files._lens import OPENCV, lens_lost, with_fisheye, with_shapes
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.toml import toml_line
from asterism.geometry import vector_from_rotation

ANIPOSE, CALISCOPE = "anipose TOML", "caliscope TOML"


def tables_of(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The cameras' tables by their keys; empty where the file is of another kind."""
    inside = document.get("cameras")
    tables = inside if isinstance(inside, dict) else document
    return {str(key): table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}


def rig_of_tables(path: Path, document: dict[str, Any]) -> Rig:
    """A rig from anipose's, Pose2Sim's or caliscope's tables.

    Anipose names no unit of length (millimetres, mostly; Pose2Sim writes metres): `in_metres` tells them apart and `lacks` says
    so. Caliscope's cameras have a `cam_id`, metres, rotation matrices or vectors, and no pose where they were not solved.
    A fisheye lens (OpenCV's) becomes a radial one by a fit over its image. Raises AsterismError, naming the camera, where that misses
    it by more than 0.1 px, and for what is damaged.
    """
    tables = tables_of(document)
    # Caliscope's older versions call a camera's number its port.
    caliscope = all("cam_id" in table or "port" in table for table in tables.values())
    cameras, ignored = [], []
    for key, table in tables.items():
        name = str(table.get("name") or (f"cam_{table.get('cam_id', table.get('port'))}" if caliscope else key))
        where = f"{path}, camera {name}"
        if table.get("ignore"):
            ignored.append(name)
        cameras.append(within(path, lambda name=name, where=where, table=table: _camera(name, where, table)))
    metadata = {"error": document["metadata"].get("error")} if isinstance(document.get("metadata"), dict) else {}
    lacks = of_whom("the lens distortion", cameras, ["distortions" not in table for table in tables.values()])
    lacks += [f"a calibration of {', '.join(ignored)}: its makers ignored it"] if ignored else []
    if caliscope:
        return rig_of(path, CALISCOPE, cameras, metadata, lacks)
    #
    cameras, unit = in_metres(cameras)
    return rig_of(path, ANIPOSE, cameras, metadata, [*lacks, *unit])


def _camera(name: str, where: str, table: dict[str, Any]) -> Camera:
    size = image_size(where, table["size"]) if table.get("size") is not None else None
    matrix = numbers(where, "matrix", table["matrix"], 9).reshape(3, 3)
    distortion = numbers(where, "distortions", table.get("distortions") or [])
    posed = table.get("translation") is not None and table.get("rotation") is not None
    camera = Camera.from_opencv(
        name,
        matrix,
        [] if table.get("fisheye") else distortion,
        rotation_of(where, table["rotation"]) if posed else None,
        numbers(where, "translation", table["translation"], 3) if posed else None,
        size,
    )
    if table.get("fisheye"):
        camera = with_fisheye(where, camera, distortion)
    error = table.get("error")
    return camera if error is None else Camera(**{**vars(camera), "error": float(numbers(where, "error", error, 1)[0])})


def write_anipose(path: Path, rig: Rig) -> list[str]:
    """Write aniposelib's TOML, in millimetres. Returns what it does not carry. Raises AsterismError for a lens or pose it cannot carry."""
    lines: list[str] = []
    lefts: dict[str, float] = {}
    for i, given in enumerate(rig):
        _check_posed(path, given)
        camera, lefts[given.name] = with_shapes(str(path), given, OPENCV)
        lines += [f"[cam_{i}]", toml_line("name", camera.name)]
        lines += [toml_line("size", list(camera.size))] if camera.size else []
        lines += [toml_line("matrix", camera.matrix.tolist()), toml_line("distortions", camera.distortion.tolist())]
        lines += [toml_line("rotation", vector_from_rotation(camera.rotation).tolist())]
        lines += [toml_line("translation", (1000.0 * camera.translation).tolist()), ""]
    lines += ["[metadata]", toml_line("adjusted", True)]
    error = rig.metadata.get("error")
    lines += [toml_line("error", float(error))] if isinstance(error, int | float) else []
    write_atomically(path, utf8("\n".join(lines) + "\n"))
    lost = [*(["the vertical"] if rig.vertical is not None else []), *_errors_lost(rig), *lens_lost(lefts)]
    return lost + read_otherwise(rig, 1000.0)


def write_caliscope(path: Path, rig: Rig) -> list[str]:
    """Write caliscope's camera_array.toml, in metres. Returns what it does not carry."""
    lines: list[str] = []
    lefts: dict[str, float] = {}
    numbered = [camera.name[4:] if camera.name[4:].isdigit() and camera.name.startswith("cam_") else "" for camera in rig]
    # Caliscope's names are numbers: cameras that we read from it get theirs back.
    own = all(numbered) and len({int(number) for number in numbered}) == len(rig)
    for i, given in enumerate(rig):
        camera, lefts[given.name] = with_shapes(str(path), given, OPENCV)
        number = int(numbered[i]) if own else i
        lines += [f"[cameras.{number}]", toml_line("cam_id", number), toml_line("rotation_count", 0), toml_line("ignore", False)]
        lines += [toml_line("size", list(camera.size))] if camera.size else []
        lines += [toml_line("error", camera.error)] if camera.error == camera.error else []
        lines += [toml_line("matrix", camera.matrix.tolist()), toml_line("distortions", camera.distortion.tolist())]
        if camera.posed:
            lines += [toml_line("translation", camera.translation.tolist()), toml_line("rotation", camera.rotation.tolist())]
        lines += [""]
    write_atomically(path, utf8("\n".join(lines)))
    lost = [*(["the vertical"] if rig.vertical is not None else []), *lens_lost(lefts)]
    return [*lost, *([] if own else ["the names of the cameras (numbers stand for them)"])]


def _check_posed(path: Path, camera: Camera) -> None:
    if not camera.posed:
        raise AsterismError(f"{path}: camera {camera.name} has no pose and this format needs one; write .toml or .yml instead.")


def _errors_lost(rig: Rig) -> list[str]:
    return ["the reprojection error of each camera"] if any(camera.error == camera.error for camera in rig) else []
