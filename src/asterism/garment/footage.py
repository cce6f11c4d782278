"""Images and videos of synchronised cameras in; the colour images of one moment after the other out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.calibration.boards.footage import Footage, footage_of
from asterism.cameras import Rig
from asterism.detection.image_files import read_eight_bits, unread_kind
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import Ints

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class ColourFootage:
    """What several cameras filmed together.

    cameras  the footage of each
    frames   (T,) the numbers of the moments, ascending; images with the same number were taken together
    expected (width, height) px of each camera's images where they are known; else its first image tells. Images of another size are left
             out, which is a finding
    """

    cameras: tuple[Footage, ...]
    frames: Ints
    expected: tuple[tuple[int, int] | None, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the cameras."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong with the files; what cannot be read is known once it was reached."""
        return tuple(dict.fromkeys(finding for camera in self.cameras for finding in camera.findings))

    def __len__(self) -> int:
        return len(self.frames)

    def sizes(self) -> list[tuple[int, int]]:
        """(width, height) px of each camera's first image; (0, 0) where none can be read."""
        found = []
        for camera in self.cameras:
            single = ColourFootage((camera,), camera.frames)
            first = next((images[0] for _, images in single if images[0] is not None), None)
            found.append((0, 0) if first is None else (int(first.shape[1]), int(first.shape[0])))
        return found

    def __iter__(self) -> Iterator[tuple[int, list[Image | None]]]:
        """Each moment's number with the image (h, w, 3) uint8, blue, green, red, of each camera; None where there is none."""
        with ExitStack() as opened:
            sizes = self.expected or (None,) * len(self.cameras)
            films = [_Film(camera, opened, size) for camera, size in zip(self.cameras, sizes, strict=True)]
            for number in self.frames.tolist():
                yield number, [film.at(number) for film in films]


class _Film:
    """One camera's images in the order of their numbers."""

    def __init__(self, camera: Footage, opened: ExitStack, size: tuple[int, int] | None) -> None:
        import cv2

        self._numbers = {number: i for i, number in enumerate(camera.frames.tolist())}
        self._images, self._camera = camera.images, camera
        self._size = size
        self._next = 0
        self._video: Any = None
        if camera.video is not None:
            self._video = cv2.VideoCapture(str(camera.video))
            opened.callback(self._video.release)

    def at(self, number: int) -> Image | None:
        place = self._numbers.get(number)
        if place is None:
            return None
        if self._video is None:
            return self._of_size(self._photo(self._images[place], number), number)
        # A video is read forwards only: seeking is inexact in many codecs.
        image = None
        while self._next <= place:
            there, image = self._video.read()
            self._next += 1
            if not there:
                # Frames after a broken one are missing, too, and are not each reported.
                what = str(self._camera.video)
                self._left_out(what, f"{what} cannot be read from frame {number} on; it was left out.")
                return None
        return self._of_size(_colour(image), number)

    def _photo(self, file: Path, number: int) -> Image | None:
        why = ""
        try:
            image = _colour(read_eight_bits(file, colour=True) if file.is_file() else None)
        except (AsterismError, OSError) as problem:
            # One damaged file must not cost the others.
            image, why = None, f" ({' '.join(str(problem).split()).rstrip('.')})"
        if image is None:
            what = self._camera.image(number)
            kind = unread_kind(file) or f"cannot be read as an image{why}"
            self._left_out(what, f"{what} {kind}; it was left out.")
        return image

    def _of_size(self, image: Image | None, number: int) -> Image | None:
        """The image, or None where it is not of the camera's size: pixels of another size are other directions."""
        if image is None:
            return None
        size = (int(image.shape[1]), int(image.shape[0]))
        self._size = self._size or size
        if size == self._size:
            return image
        what, usual = self._camera.image(number), f"{self._size[0]} x {self._size[1]}"
        sentence = f"{what} has {size[0]} x {size[1]} pixels, camera {self._camera.name} {usual}; it was left out."
        self._add(Finding("garment-image-size", Severity.WARNING, what, sentence, "Give the image as the camera took it."))
        return None

    def _left_out(self, what: str, sentence: str) -> None:
        self._add(Finding("garment-image-unreadable", Severity.WARNING, what, sentence, "Copy it again."))

    def _add(self, finding: Finding) -> None:
        # Footage is gone through more than once, and a video that ends early would be reported for each frame that is missing.
        if not any(known.where == finding.where for known in self._camera.findings):
            self._camera.findings.append(finding)


def _colour(image: Any) -> Image | None:
    if image is None or image.size == 0:
        return None
    # Grey images have no third axis.
    return np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else np.ascontiguousarray(image)


def colour_footage(paths: Sequence[str | Path], rig: Rig | None = None) -> ColourFootage:
    """The cameras in these files and folders, see `calibration.boards.footage_of`; with a rig in its order.

    Images without a number in their name are one moment if each camera has one. Raises AsterismError, naming the path, where nothing can be
    read, or where the names of cameras are not the rig's.
    """
    cameras = footage_of(paths)
    if rig is not None:
        cameras = _in_order(cameras, rig)
    expected = () if rig is None else tuple(camera.size for camera in rig)
    # Single photos are of one moment, whatever their names say.
    if all(len(camera) == 1 for camera in cameras):
        return ColourFootage(
            tuple(Footage(c.name, c.images, c.video, np.zeros(1, dtype=np.int64), c.findings) for c in cameras), np.zeros(1, int), expected
        )
    frames = np.unique(np.concatenate([camera.frames for camera in cameras]))
    # Without numbers nothing tells which images were taken together.
    if (frames < 0).any():
        raise AsterismError(
            f"camera {next(c.name for c in cameras if (c.frames < 0).any())}: some of its images have no number at the end of their names, "
            "so it is not known which were taken together; number them."
        )
    return ColourFootage(tuple(cameras), frames, expected)


def _in_order(cameras: Sequence[Footage], rig: Rig) -> list[Footage]:
    """The footage of the rig's cameras, in its order; each must be there."""
    by_name = {camera.name.casefold(): camera for camera in cameras}
    missing = [name for name in rig.names if name.casefold() not in by_name]
    if missing:
        raise AsterismError(
            f"the rig has a camera {missing[0]}, and the images are of {', '.join(camera.name for camera in cameras)}; name each video, "
            "or folder of images, as its camera."
        )
    strangers = [camera.name for camera in cameras if camera.name.casefold() not in {name.casefold() for name in rig.names}]
    if strangers:
        raise AsterismError(f"there are images of {strangers[0]}, which the rig does not have; it has {', '.join(rig.names)}.")
    return [by_name[name.casefold()] for name in rig.names]
