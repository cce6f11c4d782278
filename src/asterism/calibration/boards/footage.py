"""Images and videos of synchronised cameras: paths in; for each camera its images, and the moment that each was taken, out."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from asterism.detection.image_files import read_eight_bits, refuse_unread, unread_kind
from asterism.errors import AsterismError, guarded_reading
from asterism.files.text import decoded, read_bytes
from asterism.findings import Finding, Severity
from asterism.recording import Ints
from asterism.synchronization.rates import rates_apart

_IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".webp")
_VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm", ".gif")
_LISTS = (".yml", ".yaml", ".xml")
TIMES_FILE = "timestamps.csv"
UNNUMBERED = -1
"""Images without a number belong to no frame of other cameras: their frames count down from here."""


@dataclass(frozen=True)
class Footage:
    """What one camera took.

    name     of the camera
    images   the image files in order, empty for a video
    video    the video file, or None
    frames   (n,) int: images of different cameras with the same number were taken together
    findings what is wrong with its files; images that cannot be read are known once they were gone through
    rate     frames per second of a video without a file of times, else NaN
    """

    name: str
    images: tuple[Path, ...]
    video: Path | None
    frames: Ints
    findings: list[Finding] = field(default_factory=list)
    rate: float = float("nan")

    def __len__(self) -> int:
        return len(self.frames)

    def image(self, frame: int) -> str:
        """What to call the image of a frame in a message."""
        at = int(np.argmax(self.frames == frame))
        return str(self.images[at]) if self.video is None else f"{self.video}, frame {at}"

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """Each frame number with its grey image (H, W) uint8. What cannot be read is left out, which is a finding."""
        import cv2

        if self.video is None:
            for frame, path in zip(self.frames.tolist(), self.images, strict=True):
                image = read_eight_bits(path, colour=False) if path.is_file() else None
                if image is None:
                    self.findings.append(_unreadable(path))
                    continue
                yield frame, image
            return
        # Frames are read in order: seeking in compressed video is slow, and in some files inexact.
        film, read = cv2.VideoCapture(str(self.video)), 0
        try:
            for frame in self.frames.tolist():
                there, image = film.read()
                if not there:
                    break
                read += 1
                yield frame, image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        finally:
            film.release()
        if read < len(self.frames):
            self.findings.append(
                Finding(
                    "board-video-cut",
                    Severity.WARNING,
                    str(self.video),
                    f"{self.video} breaks off after {read} of {len(self.frames)} frames; the rest is missing.",
                    "Copy or convert it again.",
                )
            )


def _unreadable(path: Path) -> Finding:
    return Finding(
        "board-image-unreadable",
        Severity.WARNING,
        str(path),
        f"{path} {unread_kind(path) or 'cannot be read as an image'}; it was left out.",
        "Copy it again.",
    )


def footage_of(paths: Sequence[str | Path]) -> list[Footage]:
    """The cameras in these files and folders.

    A video is a camera, named as the file; its frames are numbered 0, 1, ..., or as those of a timestamps.csv beside it (caliscope's
    sync_index, cam_id). A folder with images is a camera, named as the folder, unless its images' names begin with several cameras'
    names (left01.jpg, right01.jpg); the number at a name's end is that of the frame. A folder with folders or videos has one camera in
    each. An OpenCV image list (.yml, .xml) stands for its images. Raises AsterismError, naming the path, where nothing can be read or
    two cameras have one name.
    """
    images: list[tuple[Path, str | None]] = []
    videos: list[Path] = []
    for path in map(Path, paths):
        _collect(path, images, videos)
    found = [_video(path) for path in videos] + _image_cameras(images)
    if not found:
        for file in [file for path in map(Path, paths) if path.is_dir() for file in sorted(path.rglob("*")) if file.is_file()]:
            refuse_unread(file)
        raise AsterismError(f"{', '.join(map(str, paths)) or 'nothing'}: no image or video there; name files or folders of them.")
    names = [one.name for one in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise AsterismError(f"two cameras would be called {twice}; give their folders or videos names of their own.")
    apart = rates_apart(names, [one.rate for one in found], [len(one) for one in found])
    if apart is not None:
        mend = f"Give the frames that were taken together in a {TIMES_FILE}, or film at one rate."
        found[names.index(apart[0])].findings.append(Finding("board-rates-differ", Severity.WARNING, *apart, mend))
    # By the numbers in names, so that cam10 comes after cam2; every tuple has a number first, so that all compare.
    return sorted(found, key=lambda one: [(int(p), "") if p.isdigit() else (-1, p) for p in re.split(r"(\d+)", one.name) if p])


def _collect(path: Path, images: list[tuple[Path, str | None]], videos: list[Path], depth: int = 0) -> None:
    if path.is_dir():
        inside = sorted(path.iterdir())
        own = [file for file in inside if file.suffix.casefold() in _IMAGES]
        # Several names before the numbers mean several cameras in one folder, as in left01.jpg, right01.jpg.
        prefixes = {_parts(file)[0] for file in own if _parts(file)[1] is not None}
        images += [(file, None if len(prefixes) > 1 else path.resolve().name) for file in own]
        videos += [file for file in inside if file.suffix.casefold() in _VIDEOS]
        for folder in [file for file in inside if file.is_dir()] if depth == 0 else []:
            _collect(folder, images, videos, depth + 1)
    elif not path.exists():
        raise AsterismError(f"{path} does not exist; check its name and folder.")
    elif path.suffix.casefold() in _VIDEOS:
        videos.append(path)
    elif path.suffix.casefold() in _LISTS:
        images += [(file, None) for file in _listed(path)]
    elif path.suffix.casefold() in _IMAGES:
        images.append((path, None))
    else:
        refuse_unread(path)
        raise AsterismError(f"{path} is not an image, video, image list or folder; name those that show the board.")


def _listed(path: Path) -> list[Path]:
    from asterism.cameras.files.opencv import file_list

    files = [path.parent / name for name in file_list(path)]
    if not files:
        raise AsterismError(f"{path} lists no images; write their names into it.")
    return files


def _parts(path: Path) -> tuple[str, int | None]:
    """A file's name without the number at its end, and that number."""
    match = re.fullmatch(r"(.*?)[-_. ]?(\d+)", path.stem)
    return (match[1], int(match[2])) if match and len(match[2]) < 16 else (path.stem, None)


def _image_cameras(images: list[tuple[Path, str | None]]) -> list[Footage]:
    cameras: dict[str, list[tuple[int, Path]]] = {}
    for path, folder in images:
        prefix, number = _parts(path)
        own = cameras.setdefault(folder or prefix or "camera", [])
        # Images without a number get negative ones, which no image of another camera shares.
        own.append((number if number is not None else UNNUMBERED - len(own), path))
    listed = []
    for name, own in cameras.items():
        own.sort()
        frames = [frame for frame, _ in own]
        twice = next((path for i, (frame, path) in enumerate(own) if i and frame == frames[i - 1]), None)
        if twice is not None:
            raise AsterismError(f"{twice}: camera {name} has two images with this number; keep one of them.")
        listed.append(Footage(name, tuple(path for _, path in own), None, np.array(frames, dtype=np.int64)))
    return listed


def _video(path: Path) -> Footage:
    import cv2

    film = cv2.VideoCapture(str(path))
    count = int(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
    rate = float(film.get(cv2.CAP_PROP_FPS)) if count else float("nan")
    film.release()
    if count <= 0:
        raise AsterismError(f"{path} {unread_kind(path) or 'cannot be read as a video; it may be cut off, convert or copy it again'}.")
    findings: list[Finding] = []
    frames = np.arange(count, dtype=np.int64)
    times = path.with_name(TIMES_FILE)
    if times.is_file():
        given = _synchronised_frames(times, path)
        if len(given) != count:
            findings.append(
                Finding(
                    "board-times-differ",
                    Severity.WARNING,
                    str(times),
                    f"{times} has {len(given)} frames of {path.stem} and the video has {count}; they were matched from the first on.",
                    "Give the file that belongs to the video, or remove it.",
                )
            )
        if len(given):
            # Frames that are matched one by one do not come apart.
            frames, rate = given[:count], float("nan")
    return Footage(path.stem, (), path, frames, findings, rate)


def _synchronised_frames(times: Path, video: Path) -> Ints:
    """The sync_index of each frame of a video; empty where the file does not know its camera."""
    with guarded_reading(times):
        rows = list(csv.DictReader(decoded(times, read_bytes(times)).splitlines()))
    if not rows or not {"sync_index", "cam_id"} <= set(rows[0]):
        raise AsterismError(f"{times} has no columns sync_index and cam_id; remove it, or write which frames belong together.")
    number = _parts(video)[1]
    try:
        own = [
            (int(row.get("frame_index") or i), int(row["sync_index"]))
            for i, row in enumerate(rows)
            if row["cam_id"]
            and row["sync_index"]
            and (row["cam_id"] == video.stem or (number is not None and row["cam_id"] == str(number)))
        ]
    except ValueError as problem:
        raise AsterismError(f"{times}: a cell is not a number ({problem}); correct it.") from problem
    return np.array([frame for _, frame in sorted(own)], dtype=np.int64)
