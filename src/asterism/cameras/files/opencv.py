"""OpenCV's YAML and XML (cv2.FileStorage): single cameras, stereo pairs, whole rigs in one file or several, in and out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import image_size, in_metres, numbers, read_otherwise, rig_of, rotation_of, within
from asterism.cameras.files._lens import OPENCV, lens_lost, with_fisheye, with_shapes
from asterism.cameras.files._opencv_text import values_of_xml, values_of_yaml
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import decoded, read_bytes
from asterism.recording import Floats

KIND = "OpenCV"
_MATRIX = re.compile(r"(?i)(?:camera_?matrix|intrinsic(?:s|_?matrix)?|K|M)_?(\w*)")
_DISTORTION = re.compile(r"(?i)(?:distortion_?coeff(?:icient)?s?|dist_?coeffs?|distortion|dist|D)_?(\w*)")
_SIZE = re.compile(r"(?i)(?:image_?size|camera_?resolution|size)_?(\w*)")
_TURN = re.compile(r"(?i)(?:rvec|rotation|rot|R)_?(\w*)")
_MODEL = re.compile(r"(?i)(?:distortion_model|camera_model|fisheye_model|fisheye)_?(\w*)")
_PINHOLES = ("", "0", "plumb_bob", "rational_polynomial", "radtan", "brown", "brown_conrady", "pinhole", "perspective", "opencv", "false")
_FISHEYES = ("1", "fisheye", "equidistant", "kannala_brandt", "opencv_fisheye", "true")
_SHIFT = re.compile(r"(?i)(?:T|translation|tvec)_?(\w*)")
_ERROR = re.compile(r"(?i)(?:avg_reprojection_error|reprojection_error|rms|error)_?(\w*)")

_LONGEST = 20_000
"""Items of a list that are looked at."""


def read_opencv(paths: Sequence[Path]) -> Rig:
    """The cameras in OpenCV's files as one rig; the values of several files are put together (intrinsics beside extrinsics).

    A camera is whatever has a 3 x 3 matrix called K, M or camera_matrix, with or without a suffix (K_left, M1); a file with one camera
    without a suffix gives it its own name. A stereo pair (M1, M2, R, T) has its first camera as world frame. Units of
    length are those of the board that was filmed: `lacks` says what was taken.
    Raises AsterismError where a file is damaged or lists images instead of cameras.
    """
    cameras: list[Camera] = []
    values: dict[str, Any] = {}
    contents = [(path, _values(path)) for path in paths]
    for _, content in contents:
        # A value without a suffix belongs to its own file's camera and must not reach another's.
        values.update({key: value for key, value in content.items() if not _is_bare(key)})
    titles = _titles(values.get("names", []))
    marks = [match[1] for key, value in values.items() if (match := _MATRIX.fullmatch(key)) and np.shape(value) == (3, 3)]
    if set(marks) <= set(titles):
        titles = []  # the suffixes are the names themselves
    lacks: list[str] = []
    for path, content in contents:
        for key, value in content.items():
            match = _MATRIX.fullmatch(key)
            if match and np.shape(value) == (3, 3):
                own = content if match[1] == "" else values
                # Files that we write ourselves number their cameras where names cannot be keys, and list the names.
                number = int(match[1]) if match[1].isdigit() else -1
                listed = titles[number] if 0 <= number < len(titles) else match[1]
                cameras.append(within(path, lambda m=match[1], t=listed, v=value, p=path, o=own: _camera(p, m, t, v, o, lacks)))
    if not cameras:
        lists = any(isinstance(value, list) for _, content in contents for value in content.values())
        # An image list has the same suffix, and is often given by mistake.
        what = "lists files" if lists else "holds no camera matrix"
        use = "; to calibrate from the images that it lists, give it to asterism calibrate board" if lists else "; export it again"
        raise AsterismError(f"{', '.join(map(str, paths))} {what} and no camera{use}.")
    cameras = _stereo(f"{paths[0]}, R and T", cameras, [content for _, content in contents])
    #
    cameras, unit = in_metres(cameras)
    return rig_of(paths[0], KIND, cameras, {"files": [str(path) for path in paths]} if len(paths) > 1 else {}, [*lacks, *unit])


def write_opencv(path: Path, rig: Rig) -> list[str]:
    """Write all cameras as K_name, D_name, R_name, T_name, size_name, error_name and their names, in metres. Returns what is lost.

    Where a name cannot be part of a key, numbers from 0 stand for all of them.
    """
    import cv2

    suffix = path.suffix.casefold()
    file = cv2.FileStorage(".xml" if suffix == ".xml" else ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    file.startWriteStruct("names", cv2.FILE_NODE_SEQ if hasattr(cv2, "FILE_NODE_SEQ") else cv2.FileNode_SEQ)
    for camera in rig:
        file.write("", camera.name)
    file.endWriteStruct()
    lefts: dict[str, float] = {}
    plain = all(re.fullmatch(r"[A-Za-z0-9_]+", name) for name in rig.names)
    for i, given in enumerate(rig):
        mark = given.name if plain else str(i)
        camera, lefts[given.name] = with_shapes(str(path), given, OPENCV)
        file.write(f"K_{mark}", camera.matrix)
        file.write(f"D_{mark}", camera.distortion.reshape(1, -1))
        if camera.size:
            file.write(f"size_{mark}", np.array([camera.size], dtype=np.int32))
        if camera.error == camera.error:
            file.write(f"error_{mark}", camera.error)
        if camera.posed:
            file.write(f"R_{mark}", camera.rotation)
            file.write(f"T_{mark}", camera.translation.reshape(3, 1))
    write_atomically(path, utf8(file.releaseAndGetString()))
    return [*(["the vertical"] if rig.vertical is not None else []), *lens_lost(lefts), *read_otherwise(rig, 1.0)]


def _titles(names: Any) -> list[str]:
    """The names of cameras that a file lists; in XML a single one is no list."""
    return [str(title) for title in ([names] if isinstance(names, str) else names if isinstance(names, list) else [])]


def _is_bare(key: str) -> bool:
    """Whether a key names a value of the only camera of its file."""
    matches = (pattern.fullmatch(key) for pattern in (_MATRIX, _DISTORTION, _SIZE, _ERROR))
    return any(match and match[1] == "" for match in matches) or key.startswith("image_")


def _camera(path: Path, mark: str, title: str, matrix: Floats, values: dict[str, Any], lacks: list[str]) -> Camera:
    name = title or path.stem
    where = f"{path}, camera {name}"
    distortion = _one(values, _DISTORTION, mark)
    size = _one(values, _SIZE, mark)
    if size is None and {"image_width", "image_height"} <= set(values):
        size = [values["image_width"], values["image_height"]]
    turn, shift = _one(values, _TURN, mark), _one(values, _SHIFT, mark)
    posed = turn is not None and shift is not None
    bends = numbers(where, "distortion", [] if distortion is None else distortion)
    fisheye = _is_fisheye(where, values, mark)
    if distortion is None:
        lacks.append(f"the lens distortion of {name}")
    # Four numbers are what a fisheye has, too; the file that does not say which is read as the commoner one, and the rig says so.
    elif fisheye is None and len(bends) == 4:
        lacks.append(f"the lens model of {name}: its four coefficients were taken as k1, k2, p1, p2, not as a fisheye's")
    camera = Camera.from_opencv(
        name,
        matrix,
        [] if fisheye else bends,
        rotation_of(where, turn) if posed else None,
        numbers(where, "translation", shift, 3) if posed else None,
        None if size is None else image_size(where, size),
    )
    if fisheye:
        camera = with_fisheye(where, camera, bends)
    error = _one(values, _ERROR, mark)
    return camera if error is None else Camera(**{**vars(camera), "error": float(numbers(where, "error", error, 1)[0])})


def _is_fisheye(where: str, values: dict[str, Any], mark: str) -> bool | None:
    """Whether the lens is OpenCV's fisheye, None where the file does not say. Raises AsterismError for a model of another kind."""
    said = [value for key, value in values.items() if (match := _MODEL.fullmatch(key)) and match[1] in (mark, "")]
    models = [value.casefold() if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else "" for value in said]
    for model in models:
        if model not in (*_PINHOLES, *_FISHEYES):
            raise AsterismError(f"{where}: the lens model {model[:40]} is not understood; calibrate it with OpenCV's pinhole or fisheye.")
    return any(model in _FISHEYES for model in models) if any(models) else None


def _one(values: dict[str, Any], pattern: re.Pattern[str], mark: str) -> Any:
    """The value whose key has this suffix; where one has several spellings (R and Rot), the matrix."""
    found = [value for key, value in values.items() if (match := pattern.fullmatch(key)) and match[1] == mark]
    return max(found, key=np.size) if found else None


def _stereo(where: str, cameras: list[Camera], contents: list[dict[str, Any]]) -> list[Camera]:
    """A pair of which the first has no pose, and with one R and T between: the first camera is the world frame."""
    # One R and T without a suffix belong to a pair and stand between its cameras.
    between = [content for content in contents if np.size(content.get("R", 0)) in (3, 9) and np.size(content.get("T", 0)) == 3]
    if len(cameras) != 2 or len(between) != 1 or cameras[0].posed:
        return cameras
    turn, shift = rotation_of(where, between[0]["R"]), numbers(where, "translation", between[0]["T"], 3)
    return [replace(cameras[0], posed=True), replace(cameras[1], rotation=turn, translation=shift, posed=True)]


def _values(path: Path) -> dict[str, Any]:
    """All values of a file: matrices, numbers, texts, lists. Raises AsterismError where it is no YAML or XML of OpenCV's."""
    text = decoded(path, read_bytes(path))
    try:
        found = values_of_xml(text) if text.lstrip().startswith("<") else values_of_yaml(text)
    except ValueError as problem:
        raise AsterismError(f"{path} is damaged, or no YAML or XML of OpenCV's ({problem}); export it again.") from problem
    return {key: _value(value) for key, value in found.items()}


def _value(value: Any) -> Any:
    """A matrix where a mapping is one, else nothing of it; the numbers and texts of a list; a number; a text."""
    if isinstance(value, dict):
        if not {"rows", "cols", "data"} <= set(value):
            return {}
        cells = value["data"] if isinstance(value["data"], list) else [value["data"]]
        data = [_number(cell) for cell in cells[:_LONGEST]]
        shape = (_number(value["rows"]), _number(value["cols"]))
        fits = len(data) == shape[0] * shape[1]
        return np.array(data).reshape(int(shape[0]), int(shape[1])) if fits else np.array([])
    if isinstance(value, list):
        return [item if isinstance(item, str) else _number(item) for item in value[:_LONGEST]]
    return value


def _number(value: Any) -> float:
    """A number, NaN where it is none."""
    return value if isinstance(value, float) else float("nan")


def file_list(path: Path) -> list[str]:
    """The file names that an OpenCV image list holds. Raises AsterismError where it is no such list."""
    return [text for value in _values(path).values() if isinstance(value, list) for text in value if isinstance(text, str)]
