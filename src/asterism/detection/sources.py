"""One camera's images in, as a video, a folder, a numbered series or a TIFF of several pages; grey images with their frame numbers out."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.detection.blobs import Grey, as_grey
from asterism.errors import AsterismError

IMAGES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp", ".jp2"}
_PAGED = {".tif", ".tiff"}
_SPARSE = 10
"""Frame numbers that leave more than this many places for each image are no frame numbers."""


@dataclass(frozen=True)
class Source:
    """Where one camera's images come from.

    path     as it was given
    name     what the camera is called: the file's stem or the folder's name
    kind     "video", "images" or "pages"
    numbers  (N,) frame number of each image, from its file name where it has one, else counted from 0; for a video N is what its header
             says, which need not be true
    numbered whether the numbers are the file names'
    files    of a folder or series, one for each frame
    rate     frames per second by the file, NaN where it does not say
    """

    path: Path
    name: str
    kind: str
    numbers: NDArray[np.int64]
    numbered: bool = False
    files: tuple[Path, ...] = ()
    rate: float = float("nan")

    def __len__(self) -> int:
        return len(self.numbers)


def open_source(path: str | Path) -> Source:
    """Look at a path: a video, a folder of images, a series such as cam1.%d or a multi-page TIFF; a single image is a series of one.

    Images are put in natural order (2 before 10); where their names end in numbers these are the frames' numbers, so that a gap in them
    is a gap in time. Raises AsterismError where there is no such thing, or nothing in it that can be read.
    """
    path = Path(path)
    if "%" in path.name:
        pattern = re.compile(re.sub(r"%0?\d*d", r"(\\d+)", _escaped(path.name)))
        files = [file for file in _listed(path.parent) if pattern.fullmatch(file.name)]
        if not files:
            raise AsterismError(f"{path}: there is no image of that name with a number in place of %d; check the folder.")
        return _series(path, _plain_name(path), files)
    if path.is_dir():
        files = [file for file in _listed(path) if file.suffix.casefold() in IMAGES]
        if not files:
            raise AsterismError(f"{path} holds no images ({', '.join(sorted(IMAGES))}); give the folder of one camera.")
        return _series(path, path.resolve().name, files)
    if not path.is_file():
        raise AsterismError(f"{path} does not exist; give a video, a folder of images, a TIFF, or a series such as cam1.%d.")
    import cv2

    if path.suffix.casefold() in _PAGED:
        pages = int(cv2.imcount(str(path)))
        if pages > 1:
            return Source(path, path.stem, "pages", np.arange(pages))
    if path.suffix.casefold() in IMAGES or cv2.haveImageReader(str(path)):
        return _series(path, path.stem, [path])
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened() or not capture.grab():
            raise AsterismError(f"{path} is neither an image nor a video that can be opened; it may be cut off, record or copy it again.")
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        count = max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
    finally:
        capture.release()
    return Source(path, path.stem, "video", np.arange(count), rate=rate if 0 < rate < 1e5 else float("nan"))


def images(source: Source) -> Iterator[tuple[int, Grey | None]]:
    """All images in order, each with its place from 0, grey; None for one that cannot be decoded.

    A video ends where it can be read no further, which may be before `len(source)`. Raises AsterismError for images of other depths than
    8 and 16 bit.
    """
    if source.kind == "video":
        import cv2

        capture = cv2.VideoCapture(str(source.path))
        try:
            place = 0
            while True:
                there, image = capture.read()
                if not there:
                    return
                yield place, _grey(source.path, image)
                place += 1
        finally:
            capture.release()
    for place in range(len(source) if source.kind != "video" else 0):
        yield place, _image(source, place)


def some_images(source: Source, count: int) -> list[tuple[int, Grey]]:
    """Up to `count` images spread evenly over the whole, with their places from 0; what cannot be decoded is left out.

    Places in a video are sought, which is as exact as its key frames allow.
    """
    places = np.unique(np.linspace(0, max(len(source) - 1, 0), count).round().astype(int)).tolist()
    if source.kind != "video":
        found = ((place, _image(source, place)) for place in places)
        return [(place, image) for place, image in found if image is not None]
    import cv2

    kept: list[tuple[int, Grey]] = []
    capture = cv2.VideoCapture(str(source.path))
    try:
        for place in places:
            capture.set(cv2.CAP_PROP_POS_FRAMES, place)
            there, image = capture.read()
            if there:
                kept.append((place, _grey(source.path, image)))
    finally:
        capture.release()
    return kept or [(place, image) for place, image in images(source) if place < count and image is not None]


def _image(source: Source, place: int) -> Grey | None:
    if source.kind == "images":
        image = _decoded(source.files[place])
        return None if image is None else _grey(source.files[place], image)
    import cv2

    there, pages = cv2.imreadmulti(str(source.path), start=place, count=1, flags=cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
    return _grey(source.path, np.asarray(pages[0])) if there and len(pages) else None


def _decoded(file: Path) -> NDArray[Any] | None:
    """The image in a file, grey, with its own depth; None where it holds none. Read by NumPy: OpenCV trips over names on Windows."""
    import cv2

    content = np.fromfile(file, np.uint8)
    image: NDArray[Any] | None = cv2.imdecode(content, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE) if len(content) else None
    return image


def _grey(file: Path, image: NDArray[Any]) -> Grey:
    import cv2

    if image.ndim == 3 and image.shape[2] == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    try:
        return as_grey(image)
    except AsterismError as problem:
        raise AsterismError(f"{file}: {problem}") from None


def _series(path: Path, name: str, files: list[Path]) -> Source:
    files = sorted(files, key=lambda file: [(len(d.lstrip("0")), d) if d.isdigit() else (0, d) for d in re.split(r"(\d+)", file.name)])
    last = [re.findall(r"\d+", file.name if file.suffix[1:].isdigit() else file.stem) for file in files]
    numbers = np.array([int(found[-1]) if found and len(found[-1]) < 18 else -1 for found in last], dtype=np.int64)
    steps = np.diff(numbers)
    if len(files) > 1 and numbers.min() >= 0 and (steps > 0).all():
        step = int(steps.min())
        numbers = numbers // step if (steps % step == 0).all() else numbers
        if np.ptp(numbers) < _SPARSE * len(numbers) + 100:
            return Source(path, name, "images", numbers, True, tuple(files))
    return Source(path, name, "images", np.arange(len(files)), False, tuple(files))


def _listed(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise AsterismError(f"{folder} is no folder; give one that exists.")
    return [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]


def _escaped(name: str) -> str:
    return "".join(part if part.startswith("%") else re.escape(part) for part in re.split(r"(%0?\d*d)", name))


def _plain_name(path: Path) -> str:
    """cam1 for cam1.%d and for cam1_%04d.png; the folder's name for %d.png."""
    return re.sub(r"[\W_]*(frame|image|img)?[\W_]*%0?\d*d.*$", "", path.name) or path.resolve().parent.name
