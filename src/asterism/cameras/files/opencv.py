"""OpenCV's YAML and XML (cv2.FileStorage): single cameras, stereo pairs, whole rigs in one file or several, in and out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import metres_per_unit, numbers, rig_of, within
from asterism.cameras.files._lens import OPENCV, lens_lost, with_shapes
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.formats._text import decoded, read_bytes, write_atomically
from asterism.recording import Floats

KIND = "OpenCV"
_MATRIX = re.compile(r"(?i)(?:camera_?matrix|intrinsic(?:s|_?matrix)?|K|M)_?(\w*)")
_DISTORTION = re.compile(r"(?i)(?:distortion_?coeff(?:icient)?s?|dist_?coeffs?|distortion|dist|D)_?(\w*)")
_SIZE = re.compile(r"(?i)(?:image_?size|camera_?resolution|size)_?(\w*)")
_TURN = re.compile(r"(?i)(?:rot|R|rotation)_?(\w*)")
_SHIFT = re.compile(r"(?i)(?:T|translation|tvec)_?(\w*)")
_ERROR = re.compile(r"(?i)(?:avg_reprojection_error|reprojection_error|rms|error)_?(\w*)")


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
        values.update({key: value for key, value in content.items() if not _is_bare(key)})
    titles = [str(title) for title in values.get("names", [])]
    marks = [match[1] for key in values if (match := _MATRIX.fullmatch(key))]
    if set(marks) <= set(titles):
        titles = []  # the suffixes are the names themselves
    for path, content in contents:
        for key, value in content.items():
            match = _MATRIX.fullmatch(key)
            if match and isinstance(value, np.ndarray) and value.shape == (3, 3):
                own = content if match[1] == "" else values
                number = int(match[1]) if match[1].isdigit() else -1
                listed = titles[number] if 0 <= number < len(titles) else match[1]
                cameras.append(within(path, lambda m=match[1], t=listed, v=value, p=path, o=own: _camera(p, m, t, v, o)))
    if not cameras:
        lists = any(isinstance(value, list) for _, content in contents for value in content.values())
        what = "lists files" if lists else "holds no camera matrix"
        use = "; to calibrate from the images that it lists, give it to asterism calibrate board" if lists else "; export it again"
        raise AsterismError(f"{', '.join(map(str, paths))} {what} and no camera{use}.")
    cameras = _stereo(cameras, [content for _, content in contents])
    posed = [camera.position for camera in cameras if camera.posed and np.any(camera.translation)]
    lacks: list[str] = []
    if posed:
        scale, phrase = metres_per_unit(posed)
        lacks.append(phrase)
        cameras = [Camera(**{**vars(camera), "translation": scale * camera.translation}) for camera in cameras]
    return rig_of(paths[0], KIND, cameras, {"files": [str(path) for path in paths]} if len(paths) > 1 else {}, lacks)


def write_opencv(path: Path, rig: Rig) -> list[str]:
    """Write all cameras as K_0, D_0, R_0, T_0, size_0, error_0, ... and their names, in metres. Returns what is lost."""
    import cv2

    suffix = path.suffix.casefold()
    file = cv2.FileStorage(".xml" if suffix == ".xml" else ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    file.startWriteStruct("names", cv2.FILE_NODE_SEQ if hasattr(cv2, "FILE_NODE_SEQ") else cv2.FileNode_SEQ)
    for camera in rig:
        file.write("", camera.name)
    file.endWriteStruct()
    lefts: dict[str, float] = {}
    for i, given in enumerate(rig):
        camera, lefts[given.name] = with_shapes(str(path), given, OPENCV)
        file.write(f"K_{i}", camera.matrix)
        file.write(f"D_{i}", camera.distortion.reshape(1, -1))
        if camera.size:
            file.write(f"size_{i}", np.array([camera.size], dtype=np.int32))
        if camera.error == camera.error:
            file.write(f"error_{i}", camera.error)
        if camera.posed:
            file.write(f"R_{i}", camera.rotation)
            file.write(f"T_{i}", camera.translation.reshape(3, 1))
    write_atomically(path, file.releaseAndGetString().encode())
    return [*(["the vertical"] if rig.vertical is not None else []), *lens_lost(lefts)]


def _is_bare(key: str) -> bool:
    """Whether a key names a value of the only camera of its file."""
    matches = (pattern.fullmatch(key) for pattern in (_MATRIX, _DISTORTION, _SIZE, _ERROR))
    return any(match and match[1] == "" for match in matches) or key.startswith("image_")


def _camera(path: Path, mark: str, title: str, matrix: Floats, values: dict[str, Any]) -> Camera:
    name = title or path.stem
    where = f"{path}, camera {name}"
    distortion = _one(values, _DISTORTION, mark)
    size = _one(values, _SIZE, mark)
    if size is None and {"image_width", "image_height"} <= set(values):
        size = [values["image_width"], values["image_height"]]
    turn, shift = (_one(values, _TURN, mark), _one(values, _SHIFT, mark)) if mark else (None, None)
    posed = turn is not None and shift is not None
    camera = Camera.from_opencv(
        name,
        matrix,
        [] if distortion is None else numbers(where, "distortion", distortion),
        _turn(turn) if posed else None,
        numbers(where, "translation", shift, 3) if posed else None,
        None if size is None else [int(side) for side in numbers(where, "size", size, 2)],
    )
    error = _one(values, _ERROR, mark)
    return camera if error is None else Camera(**{**vars(camera), "error": float(numbers(where, "error", error, 1)[0])})


def _one(values: dict[str, Any], pattern: re.Pattern[str], mark: str) -> Any:
    """The value whose key has this suffix; where one has several spellings (R and Rot), the matrix."""
    found = [value for key, value in values.items() if (match := pattern.fullmatch(key)) and match[1] == mark]
    return max(found, key=np.size) if found else None


def _turn(values: Any) -> Floats:
    """A rotation matrix (3, 3) or vector (3,)."""
    found = np.asarray(values, dtype=np.float64)
    return found.reshape(3, 3) if found.size == 9 else found.ravel()


def _stereo(cameras: list[Camera], contents: list[dict[str, Any]]) -> list[Camera]:
    """A pair with one R and T between: the first camera is the world frame."""
    turn = next((content["R"] for content in contents if np.shape(content.get("R", 0)) in ((3, 3), (3, 1))), None)
    shift = next((content["T"] for content in contents if np.size(content.get("T", 0)) == 3), None)
    if len(cameras) != 2 or turn is None or shift is None or any(camera.posed for camera in cameras):
        return cameras
    first, second = cameras
    return [
        Camera(**{**vars(first), "posed": True}),
        Camera.from_opencv(second.name, second.matrix, second.distortion, _turn(turn), np.ravel(shift), second.size),
    ]


def _values(path: Path) -> dict[str, Any]:
    """All values of a file: matrices, numbers, texts, lists. Raises AsterismError where OpenCV cannot read it."""
    import cv2

    text = decoded(path, read_bytes(path))
    if path.suffix.casefold() in (".yml", ".yaml") and not text.startswith("%YAML"):
        text = f"%YAML:1.0\n---\n{text}"
    log: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5 has it there, 4 at the top
    level = log.getLogLevel()
    log.setLogLevel(getattr(log, "LOG_LEVEL_SILENT", 0))
    try:
        file = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = file.root()
        return {key: _value(root.getNode(key)) for key in root.keys()} if root.isMap() else {}  # noqa: SIM118
    except (cv2.error, SystemError) as problem:
        raise AsterismError(f"{path} is damaged, or no YAML or XML of OpenCV's; export it again.") from problem
    finally:
        log.setLogLevel(level)


def _value(node: Any) -> Any:
    if node.isMap():
        keys = set(node.keys())
        if {"rows", "cols", "data"} <= keys:
            cells = node.getNode("data")
            data = [_number(cells.at(i)) for i in range(cells.size())]
            shape = (_number(node.getNode("rows")), _number(node.getNode("cols")))
            fits = len(data) == shape[0] * shape[1]
            return np.array(data).reshape(int(shape[0]), int(shape[1])) if fits else np.array([])
        return {}
    if node.isSeq():
        items = [node.at(i) for i in range(node.size())]
        return [item.string() if item.isString() else _number(item) for item in items]
    return node.string() if node.isString() else _number(node)


def _number(node: Any) -> float:
    """A node's number, NaN where it is none (OpenCV gives its largest number then)."""
    return float(node.real()) if node.isInt() or node.isReal() else float("nan")


def file_list(path: Path) -> list[str]:
    """The file names that an OpenCV image list holds. Raises AsterismError where OpenCV cannot read it."""
    return [text for value in _values(path).values() if isinstance(value, list) for text in value if isinstance(text, str)]
