"""One camera's images in, as a video, a folder, a numbered series or a TIFF of several pages; grey images with their frame numbers out."""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from asterism.detection.claimed_sizes import check_claimed_chunks, check_claimed_size, claimed_size
from asterism.detection.grey import Grey, grey_of_colour
from asterism.detection.image_files import refuse_unread
from asterism.errors import AsterismError, guarded_reading

if TYPE_CHECKING:
    import cv2

IMAGES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp", ".jp2"}
_ANIMATED = {".gif", ".webp", ".avif", ".png"}
_PAGED = {".tif", ".tiff"}
_MOST_BYTES = 2**31 - 1
"""What OpenCV takes as one file in memory."""
_LEAST_PAGE = 50
"""Bytes that describe a page of a TIFF at least: its width, its height, how its pixels are meant and where they are."""
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
    pages    of a TIFF, where in the file each one is described
    cut      whether a TIFF ends before its last page
    rate     frames per second by the file, NaN where it does not say
    """

    path: Path
    name: str
    kind: str
    numbers: NDArray[np.int64]
    numbered: bool = False
    files: tuple[Path, ...] = ()
    pages: tuple[int, ...] = ()
    cut: bool = False
    rate: float = float("nan")

    def __len__(self) -> int:
        return len(self.numbers)


def open_source(path: str | Path) -> Source:
    """Open a path: a video, a folder of images, a series such as cam1.%d or a multi-page TIFF; a single image is a series of one.

    Images are put in natural order (2 before 10); where their names end in numbers these are the frames' numbers, so that a gap in them
    is a gap in time. Raises AsterismError where there is no such thing, or nothing in it that can be read.
    """
    with guarded_reading(path, "record or copy it again"):
        return _opened(Path(path))


def _opened(path: Path) -> Source:
    if re.search(r"%0?\d*d", path.name):
        #
        pattern = re.compile(re.sub(r"%0?\d*d", r"(\\d+)", _escaped(path.name)))
        files = [file for file in _listed(path.parent) if pattern.fullmatch(file.name)]
        if not files:
            raise AsterismError(f"{path}: there is no image of that name with a number in place of %d; check the folder.")
        return _series(path, _plain_name(path), files)
    if path.is_dir():
        files = [file for file in _listed(path) if file.suffix.casefold() in IMAGES]
        if not files:
            for file in _listed(path):
                refuse_unread(file)
            raise AsterismError(f"{path} holds no images ({', '.join(sorted(IMAGES))}); give the folder of one camera.")
        return _series(path, path.resolve().name, files)
    if not path.is_file():
        raise AsterismError(f"{path} does not exist; give a video, a folder of images, a TIFF, or a series such as cam1.%d.")
    import cv2

    # A TIFF with one page is an image like others; with several it is a sequence.
    if path.suffix.casefold() in _PAGED:
        pages, cut = _pages(path)
        if len(pages) > 1 or cut:
            return Source(path, path.stem, "pages", np.arange(len(pages)), pages=pages, cut=cut)
    # FFmpeg reads all images of an animated GIF, of which OpenCV would read the first as a picture.
    moving = path.suffix.casefold() in _ANIMATED and _count_images(path) > 1
    if not moving and (path.suffix.casefold() in IMAGES or cv2.haveImageReader(str(path))):
        return _series(path, path.stem, [path])
    with _film(path) as capture:
        there, image = capture.read()
        if moving and capture.get(cv2.CAP_PROP_FRAME_COUNT) < 2:
            raise AsterismError(
                f"{path} is an animation, of which only the first image could be read; make a video or single images of it."
            )
        if not there:
            refuse_unread(path)
            raise AsterismError(f"{path} cannot be opened as an image or a video; it may be cut off, record or copy it again.")
        if _is_deep(capture) and image.dtype != np.uint16:
            raise AsterismError(f"{path} has more than 8 bits, of which OpenCV {cv2.__version__} reads 8; make 16 bit PNG or TIFF of it.")
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        #
        if not 1 <= count <= path.stat().st_size:  # a frame takes a byte at least: the header is wrong
            count = 1
            while capture.grab():
                count += 1
    return Source(path, path.stem, "video", np.arange(count), rate=rate if 0 < rate < 1e5 else float("nan"))


@contextmanager
def _film(path: Path) -> Iterator[cv2.VideoCapture]:
    """A video, open; one of more than 8 bits grey delivers all of them, where OpenCV would leave the upper 8."""
    import cv2

    capture = cv2.VideoCapture(str(path))
    try:
        check_claimed_size(path, capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if _is_deep(capture):
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        yield capture
    finally:
        capture.release()


def _is_deep(capture: cv2.VideoCapture) -> bool:
    """Whether a video holds grey images of more than 8 bits: FFmpeg calls them Y1, 0 and the bits, or backwards."""
    import cv2

    name = (int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xFFFFFFFF).to_bytes(4, "little")
    return re.fullmatch(rb"Y1\0[\x09-\x10]|[\x09-\x10]\0001Y", name, re.DOTALL) is not None


def images(source: Source, times: list[float] | None = None) -> Iterator[tuple[int, Grey | None]]:
    """All images in order, each with its place from 0, grey; None for one that cannot be decoded.

    A video ends where it can be read no further, which may be before `len(source)`; when its frames are shown, in s by its own clock, is
    added to `times`. Raises AsterismError for images of other depths than 8 and 16 bit.
    """
    if source.kind != "video":
        yield from ((place, _image(source, place)) for place in range(len(source)))
        return
    import cv2

    with _film(source.path) as capture:
        place = 0
        while True:
            with guarded_reading(source.path, "record or copy it again"):
                there, image = capture.read()
                if not there:
                    return
                # The time of the frame that was just read, which OpenCV forgets with the next one.
                if times is not None:
                    times.append(1e-3 * float(capture.get(cv2.CAP_PROP_POS_MSEC)))
                image = _grey(source.path, image)
            yield place, image
            place += 1


def some_images(source: Source, count: int) -> list[tuple[int, Grey]]:
    """Up to `count` images spread evenly over the whole, with their places from 0; what cannot be decoded is left out.

    Places in a video are sought, which is as exact as its key frames allow; one that cannot be sought in is read through.
    """
    places = np.unique(np.linspace(0, max(len(source) - 1, 0), count).round().astype(int)).tolist()
    if source.kind != "video":
        found = ((place, _image(source, place)) for place in places)
        return [(place, image) for place, image in found if image is not None]
    import cv2

    kept: list[tuple[int, Grey]] = []
    with _film(source.path) as capture:
        for place in places:
            capture.set(cv2.CAP_PROP_POS_FRAMES, place)
            there, image = capture.read()
            if there:
                kept.append((place, _grey(source.path, image)))
    # Some videos cannot be sought in; half of the places is enough to tell thresholds.
    if 2 * len(kept) >= len(places):
        return kept
    return [(place, image) for place, image in images(source) if place in places and image is not None]


def _image(source: Source, place: int) -> Grey | None:
    file = source.files[place] if source.files else source.path
    with guarded_reading(file, "record or copy it again"):
        image = _page(file, source.pages[place], place) if source.pages else _decoded(file, np.fromfile(file, np.uint8))
        return None if image is None else _grey(file, image)


def _page(file: Path, at: int, place: int) -> NDArray[Any] | None:
    """One page of a TIFF: the file as if that page were its first, since OpenCV counts through all pages before the one it is asked for."""
    import cv2

    content = np.memmap(file, np.uint8, "c")
    #
    if len(content) > _MOST_BYTES:
        check_claimed_size(file, *claimed_size(content, at))
        there, pages = cv2.imreadmulti(str(file), start=place, count=1, flags=cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
        return np.asarray(pages[0]) if there and len(pages) else None
    order, big = _tiff(content)
    # The mapping is private: the file on disk stays as it is. This page becomes the last one, too, or OpenCV counts those behind it.
    kind = order + ("Q" if big else "I")
    struct.pack_into(kind, content.data, 8 if big else 4, at)
    struct.pack_into(kind, content.data, _next_page(content, at, order, big), 0)
    return _decoded(file, np.asarray(content), at)


def _tiff(content: NDArray[np.uint8]) -> tuple[str, bool]:
    """The order of bytes in a TIFF, and whether its offsets have eight of them; "" for what is not a TIFF."""
    head = content[:4].tobytes()
    orders = {b"II*\0": ("<", False), b"MM\0*": (">", False), b"II+\0": ("<", True), b"MM\0+": (">", True)}
    return orders.get(head, ("", False))


def _pages(file: Path) -> tuple[tuple[int, ...], bool]:
    """Where each page of a TIFF is described, and whether the file ends before the last one; nothing for what is not a TIFF."""
    content = np.memmap(file, np.uint8, "r") if file.stat().st_size else np.zeros(0, np.uint8)
    order, big = _tiff(content)
    if not order:
        return (), False
    kind = order + ("Q" if big else "I")
    found: dict[int, None] = {}
    try:
        at = int(struct.unpack_from(kind, content.data, 8 if big else 4)[0])
        # A damaged file may lead back to a page that was read, or through pages that share their bytes: that would not end.
        while at and at not in found:
            end = _next_page(content, at, order, big)
            following = int(struct.unpack_from(kind, content.data, end)[0])
            if end - at < _LEAST_PAGE or len(found) * _LEAST_PAGE > len(content):
                return tuple(found), True
            found[at] = None
            at = following
    except struct.error:
        return tuple(found), True
    return tuple(found), at != 0


def _count_images(path: Path) -> int:
    """The images of an animation. Raises AsterismError where the file claims more than it has: OpenCV would first ask for the memory."""
    import cv2

    content = np.fromfile(path, dtype=np.uint8)
    check_claimed_size(path, *claimed_size(content))
    check_claimed_chunks(path, content)
    return int(cv2.imcount(str(path)))


def _next_page(content: NDArray[np.uint8], at: int, order: str, big: bool) -> int:
    """Where the description of a TIFF's page says where the next one is. Raises struct.error where it is beyond the file."""
    count, entry = ("Q", 20) if big else ("H", 12)
    entries = int(struct.unpack_from(order + count, content.data, at)[0])
    return at + struct.calcsize(order + count) + entry * entries


def _decoded(file: Path, content: NDArray[np.uint8], page: int = 0) -> NDArray[Any] | None:
    """The image in a file's bytes, grey, with its own depth; None where they hold none. OpenCV itself trips over names on Windows.

    page  where the page of a TIFF is described. Raises AsterismError where the image claims more pixels than an image has.
    """
    import cv2

    check_claimed_size(file, *claimed_size(content, page))
    check_claimed_chunks(file, content)
    #
    image: NDArray[Any] | None = cv2.imdecode(content, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE) if len(content) else None
    return image


def _grey(file: Path, image: NDArray[Any]) -> Grey:
    try:
        return grey_of_colour(image)
    except AsterismError as problem:
        raise AsterismError(f"{file}: {problem}") from None


def _series(path: Path, name: str, files: list[Path]) -> Source:
    files = sorted(files, key=lambda file: [(len(d.lstrip("0")), d) if d.isdigit() else (0, d) for d in re.split(r"(\d+)", file.name)])
    kinds = Counter(_kind(file) for file in files)
    usual, most = kinds.most_common(1)[0]
    other = next((file for file in files if _kind(file) != usual), None)
    if most > 1 and other is not None:
        image = next(file for file in files if _kind(file) == usual)
        raise AsterismError(f"{path} holds {other.name} beside {image.name}: are these one camera's? Give the folder or series of one.")
    last = [re.findall(r"\d+", file.name if file.suffix[1:].isdigit() else file.stem) for file in files]
    numbers = np.array([int(found[-1]) if found and len(found[-1]) < 18 else -1 for found in last], dtype=np.int64)
    steps = np.diff(numbers)
    # Numbers that rise steadily count frames; serial numbers and dates leave gaps that no recording has.
    if len(files) > 1 and numbers.min() >= 0 and (steps > 0).all() and np.ptp(numbers) // steps.min() < _SPARSE * len(numbers) + 100:
        return Source(path, name, "images", numbers, True, tuple(files))
    return Source(path, name, "images", np.arange(len(files)), False, tuple(files))


def _kind(file: Path) -> str:
    """A file's name without its numbers: images of one camera have the same."""
    return re.sub(r"\d+", "#", file.name.casefold())


def _listed(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise AsterismError(f"{folder} is not a folder; give one that exists.")
    return [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]


def _escaped(name: str) -> str:
    return "".join(part if part.startswith("%") else re.escape(part) for part in re.split(r"(%0?\d*d)", name))


def _plain_name(path: Path) -> str:
    """cam1 for cam1.%d and for cam1_%04d.png; the folder's name for %d.png."""
    return re.sub(r"[\W_]*(frame|image|img)?[\W_]*%0?\d*d.*$", "", path.name) or path.resolve().parent.name
