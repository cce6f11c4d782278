"""One front door for rig files: what a file holds chooses who reads it, its name who writes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from asterism.cameras.camera import Camera
from asterism.cameras.files import anipose, datasets, opencv, openptv, own, qualisys, vicon
from asterism.cameras.files._common import UNIT_TAKEN
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError, guarded_reading
from asterism.files.toml import read_toml

_OPENCV = (".yml", ".yaml", ".xml")
_SUFFIXES = (".toml", ".xcp", ".ori", ".json", *_OPENCV)
_MEND = "calibrate with asterism calibrate, or export it again"
_KNOWN = "Asterism's, anipose's or caliscope's TOML, OpenCV's YAML or XML, .xcp, .qca.txt, .ori, Human3.6M's or Shelf's JSON"
_WRITERS: tuple[tuple[tuple[str, ...], Callable[[Path, Rig], list[str]]], ...] = (
    (("anipose.toml", "aniposelib.toml"), anipose.write_anipose),
    (("camera_array.toml",), anipose.write_caliscope),
    ((".toml",), own.write_own),
    (_OPENCV, opencv.write_opencv),
    ((".xcp",), vicon.write_vicon),
    ((".qca.txt",), qualisys.write_qualisys),
    ((".ori",), openptv.write_openptv),
)


def is_rig_file(path: str | Path) -> bool:
    """Whether a name is that of a rig file, or of a folder with such names.

    >>> [is_rig_file(name) for name in ("lab.xcp", "lab.qca.txt", "walk.c3d")]
    [True, True, False]
    """
    path = Path(path)
    if path.is_dir():
        return any(is_rig_file(inside) for inside in path.iterdir() if inside.is_file())
    return path.name.casefold().endswith((*_SUFFIXES, ".qca.txt"))


def read_rig(*paths: str | Path) -> Rig:
    """The rig in a calibration file, or in several or a folder of them, in metres and pixels; `lacks` says what it does not say.

    Several files are one rig where each holds a part: OpenCV's YAML and XML, OpenPTV's .ori (with its .addpar and ptv.par).
    Raises AsterismError, naming file and camera, where one is damaged or no rig file.
    """
    files = [file for path in paths for file in _files(Path(path))]
    if not files:
        raise AsterismError("no rig file was named; name one.")
    kinds = {_kind(file) for file in files}
    # Only OpenCV's and OpenPTV's rigs come in parts.
    if len(kinds) > 1 or (len(files) > 1 and kinds <= {"one"}):
        raise AsterismError(f"{', '.join(map(str, files[:4]))} are not parts of one rig; name one of them.")
    with guarded_reading(", ".join(map(str, files[:4])), _MEND):
        if kinds == {"OpenCV"}:
            return opencv.read_opencv(files)
        if kinds == {"OpenPTV"}:
            return openptv.read_openptv(files)
        return _read_one(files[0])


def write_rig(rig: Rig, path: str | Path) -> list[str]:
    """Write a rig. A file there is replaced at once or not at all.

    The name says the format: .toml is Asterism's own, which keeps everything; *anipose.toml, camera_array.toml, .yml, .yaml, .xml (OpenCV),
    .xcp, .qca.txt, .ori are others'.

    Returns what the format could not carry, one phrase each. Raises AsterismError where the name says no format, the format
    cannot carry a camera, or the file cannot be written.

    >>> from asterism.cameras import Camera, Rig
    >>> rig = Rig((Camera("c1", (640, 480), (500.0, 500.0), (319.5, 239.5)),), vertical=[0, 0, 1])
    >>> write_rig(rig, "rig.toml")
    []
    >>> write_rig(rig, "rig.yml")
    ['the vertical']
    >>> read_rig("rig.toml")["c1"].focal
    (500.0, 500.0)
    """
    path = Path(path)
    for endings, writer in _WRITERS:
        if path.name.casefold().endswith(endings):
            return writer(path, rig)
    raise AsterismError(
        f"{path}: a rig is written as .toml, *anipose.toml, camera_array.toml, .yml, .xml, .xcp, .qca.txt or .ori; choose one."
    )


def guesses(rig: Rig) -> list[str]:
    """What a reader had to guess that scales everything measured with the rig: of `rig.lacks` what is about the unit of length."""
    return [phrase for phrase in rig.lacks if phrase.startswith(UNIT_TAKEN)]


def describe_rig(rig: Rig) -> dict[str, Any]:
    """What a rig is, as plain values: where it came from, its cameras with lens, position and error, the vertical, what it lacks."""
    return {
        "source": rig.metadata.get("format", "Asterism rig"),
        "cameras": [_described(camera) for camera in rig],
        "vertical": None if rig.vertical is None else rig.vertical.tolist(),
        "metadata": {key: value for key, value in rig.metadata.items() if key not in ("file", "format", "files")},
        "lacks": list(rig.lacks),
    }


def _described(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size": None if camera.size is None else list(camera.size),
        "focal": list(camera.focal),
        "centre": list(camera.centre),
        "radial": list(camera.radial),
        "tangential": list(camera.tangential),
        "denominator": list(camera.denominator),
        "position": camera.position.tolist() if camera.posed else None,
        "error": camera.error if camera.error == camera.error else None,
    }


def _files(path: Path) -> Sequence[Path]:
    """A file itself; of a folder its .ori, else its OpenCV files with cameras, else its only rig file."""
    if not path.is_dir():
        return [path]
    inside = sorted(file for file in path.iterdir() if file.is_file() and is_rig_file(file))
    # Many small files are one rig; only without such does a single whole file have to be the one.
    parts = [file for file in inside if file.suffix.casefold() == ".ori"] or [file for file in inside if _holds_cameras(file)]
    if parts:
        return parts
    rigs = [file for file in inside if _kind(file) == "one" and _is_rig(file)]
    if len(rigs) != 1:
        found = ", ".join(file.name for file in rigs[:5]) or "none"
        raise AsterismError(f"{path} is a folder with {len(rigs)} rig files ({found}); name one of them.")
    return rigs


def _holds_cameras(path: Path) -> bool:
    if path.suffix.casefold() not in _OPENCV:
        return False
    try:
        with guarded_reading(path):
            opencv.read_opencv([path])
    except AsterismError:
        return False
    return True


def _is_rig(path: Path) -> bool:
    try:
        with guarded_reading(path):
            _read_one(path)
    except AsterismError:
        return False
    return True


def _kind(path: Path) -> str:
    suffix = path.suffix.casefold()
    return "OpenCV" if suffix in _OPENCV else "OpenPTV" if suffix == ".ori" else "one"


def _read_one(path: Path) -> Rig:
    name = path.name.casefold()
    if name.endswith(".xcp"):
        return vicon.read_vicon(path)
    if name.endswith(".txt"):
        return qualisys.read_qualisys(path)
    if name.endswith(".json"):
        return datasets.read_json(path)
    if name.endswith(".toml"):
        table = read_toml(path)
        if table.get("format") == own.FORMAT:
            return own.rig_of_table(path, table)
        if anipose.tables_of(table):
            return anipose.rig_of_tables(path, table)
    elif name.endswith(".addpar"):
        raise AsterismError(f"{path} is the lens of an OpenPTV camera; name its .ori, the lens is read with it.")
    raise AsterismError(
        f"{path} is no rig file that Asterism knows ({_KNOWN}); calibrate with asterism calibrate, or export it in one of them."
    )
