"""The image sequences of several cameras in; their blobs in common frames, and what to know about each camera, out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.detection.alignment import names_of, numbered, on_common_clock, rate_of
from asterism.detection.blobs import Flag, Grey, Spots, automatic_threshold, find_blobs, static_mask
from asterism.detection.sources import Source, images, open_source, some_images
from asterism.detection.synchrony import lags, slips
from asterism.detection.times import read_times
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats

Progress = Callable[[float, str], None]

_LOOKED_AT = 24
_BEHIND = 2
"""Frames that a camera must lag to be called unsynchronised where no rig is known; one with a rig."""


@dataclass(frozen=True)
class CameraImages:
    """What was found in one camera's images.

    name, path   the camera and where its images come from
    size         (width, height) px
    frames       images read, of `expected` that there should be
    threshold    grey values above the background
    masked       share of the image under the mask of static reflections, and in how many places
    blobs        found and kept; at_border: left out because the image's edge or the mask cuts them; overlapping, unround, saturated: of
                 those kept
    behind       frames that it lags behind most cameras, NaN where nothing tells
    sample       one of its images, and the blobs in it
    """

    name: str
    path: Path
    size: tuple[int, int]
    frames: int
    expected: int
    threshold: float
    masked: float
    masked_places: int
    blobs: int
    at_border: int
    overlapping: int
    unround: int
    saturated: int
    behind: float
    sample: Grey
    sample_frame: int
    spots: Spots


@dataclass(frozen=True)
class Detection:
    """Blobs of all cameras, what each camera's images were like, what is wrong with them (one sentence each), and whether no clock and no
    video told the frame rate."""

    blobs: Blobs
    cameras: tuple[CameraImages, ...]
    problems: tuple[str, ...]
    rate_assumed: bool

    def to_dict(self) -> dict[str, Any]:
        """All but the images, as plain values."""
        left_out = ("sample", "spots")
        per_frame = self.blobs.counts.mean(axis=0) if len(self.blobs) else np.zeros(len(self.cameras))
        return {
            "frames": len(self.blobs),
            "rate": self.blobs.rate,
            "rate_assumed": self.rate_assumed,
            "blobs": len(self.blobs.xy),
            "cameras": [
                {key: value for key, value in vars(camera).items() if key not in left_out} | {"blobs_per_frame": float(mean)}
                for camera, mean in zip(self.cameras, per_frame, strict=True)
            ],
            "problems": list(self.problems),
        }


def detect(
    paths: Sequence[str | Path],
    *,
    rig: Rig | None = None,
    threshold: float | Sequence[float] | None = None,
    mask_static: bool = False,
    times: str | Path | None = None,
    rate: float | None = None,
    workers: int = 1,
    progress: Progress | None = None,
    **settings: Any,
) -> Detection:
    """Blobs in the images of one or more cameras, one path each: see `open_source` for what a path may be.

    rig          cameras are matched to it by name, else by order; images must have its sizes, and lags between cameras are told by it
    threshold    as in `find_blobs`, one for all cameras or one for each; None: the median of the automatic ones of some 24 images
    mask_static  leave out what is bright in nearly all of some 24 images: see `static_mask`
    times        CSV file of when each image was taken: blobs are interpolated to common instants (`to_common_clock`); where too few can
                 be linked from frame to frame, they stay as they are and `Blobs.times` says when they were seen
    rate         frames per second; else by the times, else by the videos, else 100
    workers      threads that share the cameras; the result is the same
    settings     others of `find_blobs`

    Frames are numbered by file names or from 0. Blobs that the image's edge or the mask cuts are left out. Raises AsterismError where a
    camera has nothing to read, image sizes differ from the rig's, or times are of other images.
    """
    if not paths:
        raise AsterismError("there is no camera to look at; give a video or a folder of images for each.")
    thresholds = list(threshold) if isinstance(threshold, Sequence) else [threshold] * len(paths)
    if len(thresholds) != len(paths):
        raise AsterismError(f"{len(thresholds)} thresholds for {len(paths)} cameras; give one for all or one for each.")
    sources = [open_source(path) for path in paths]
    names = names_of(sources, rig)
    stamps = None if times is None else read_times(times)
    total = max(sum(len(source) for source in sources), 1)
    done = [0] * len(sources)

    def advance(c: int) -> None:
        done[c] += 1
        if progress is not None and done[c] % 10 == 0:
            progress(min(sum(done) / total, 1.0), f"detecting: {names[c]}")

    def one(c: int) -> _Found:
        return _search(sources[c], names[c], rig, mask_static, {**settings, "threshold": thresholds[c]}, lambda: advance(c))

    with ThreadPoolExecutor(workers) as pool:
        found = list(pool.map(one, range(len(sources))))
    problems = [sentence for camera in found for sentence in camera.problems]
    numbers, when, first = numbered(sources, [camera.read for camera in found], names, stamps, problems)
    blobs = _gathered(found, names, numbers, when, first, rate_of(sources, rate, when, names, problems))
    if when is not None:
        blobs = on_common_clock(blobs, problems)
    posed = rig.select(names) if rig is not None and all(camera.posed for camera in rig.select(names)) else None
    behind = lags(blobs, posed)
    problems += _out_of_step(names, behind, slips(blobs, posed) if posed is not None else np.full(len(names), np.nan), rig)
    told = tuple(camera.told(lag) for camera, lag in zip(found, behind.tolist(), strict=True))
    assumed = rate is None and when is None and not all(np.isfinite(source.rate) for source in sources)
    return Detection(blobs, told, tuple(problems), assumed)


def _out_of_step(names: Sequence[str], behind: Floats, slipped: Floats, rig: Rig | None) -> Iterator[str]:
    """Cameras that started at another time than the others (`lags`), or that came to be out of step on the way (`slips`)."""
    for name, frames, more in zip(names, behind, slipped, strict=True):
        if abs(more) >= 1:
            way, why = ("ahead of", "it lost images") if more < 0 else ("behind", "it has images twice, or the others lost some")
            yield (
                f"camera {name} is {_frames(more)} farther {way} the others at the end than at the beginning: {why} on the way. "
                "Record again, or give --times."
            )
        elif abs(frames) >= (_BEHIND if rig is None else 1):
            way = "behind" if frames > 0 else "ahead of"
            yield f"camera {name} is {_frames(frames)} {way} the others; start them together or give --times."


def _frames(count: float) -> str:
    return f"{abs(count):.0f} frame{'s' if abs(count) != 1 else ''}"


@dataclass
class _Found:
    """One camera's blobs as they were found: per image read its place, and per blob the place, xy and size."""

    source: Source
    name: str
    size: tuple[int, int]
    read: NDArray[np.int64]
    place: NDArray[np.int64]
    xy: Floats
    sizes: Floats
    flags: NDArray[np.uint8]
    at_border: int
    threshold: float
    mask: NDArray[np.bool_] | None
    sample: tuple[int, Grey, Spots]
    problems: list[str]

    def told(self, behind: float) -> CameraImages:
        import cv2

        overlapping, unround, saturated = (int((self.flags & flag > 0).sum()) for flag in (Flag.OVERLAPPING, Flag.UNROUND, Flag.SATURATED))
        masked = 0.0 if self.mask is None else float(self.mask.mean())
        places = 0 if self.mask is None else cv2.connectedComponents(self.mask.astype(np.uint8))[0] - 1
        return CameraImages(
            self.name,
            self.source.path,
            self.size,
            len(self.read),
            len(self.source),
            self.threshold,
            masked,
            places,
            len(self.xy),
            self.at_border,
            overlapping,
            unround,
            saturated,
            behind,
            self.sample[1],
            self.sample[0],
            self.sample[2],
        )


def _search(source: Source, name: str, rig: Rig | None, mask_static: bool, settings: dict[str, Any], advance: Callable[[], None]) -> _Found:
    """Blobs in all images of one camera."""
    some = some_images(source, _LOOKED_AT)
    if not some:
        raise AsterismError(f"{source.path}: none of its images can be read; record or copy them again.")
    height, width = some[0][1].shape
    if rig is not None and rig[name].size not in (None, (width, height)):
        wide, tall = rig[name].size or (0, 0)
        raise AsterismError(f"{source.path}: images are {width} x {height}, the rig says {wide} x {tall}; give the rig of these images.")
    background = settings.get("background")
    if settings["threshold"] is None:
        settings["threshold"] = float(np.median([automatic_threshold(image, background) for _, image in some]))
    if mask_static:
        settings["mask"] = static_mask((image for _, image in some), threshold=settings["threshold"], background=background)
    read: list[int] = []
    found: list[Spots] = []
    problems: list[str] = []
    broken: list[int] = []
    for place, image in images(source):
        advance()
        if image is None:
            broken.append(place)
            continue
        if image.shape != (height, width):
            file = source.files[place] if source.files else f"{source.path}, image {place}"
            raise AsterismError(f"{file}: {image.shape[1]} x {image.shape[0]} after images of {width} x {height}; give one camera's.")
        read.append(place)
        found.append(find_blobs(image, **settings))
    if broken:
        problems.append(f"{source.path}: {len(broken)} of {len(source)} images cannot be read, image {broken[0]} first; they are left out.")
    if source.kind == "video" and len(read) + 1 < len(source):
        problems.append(f"{source.path} breaks off after frame {len(read)} of {len(source)}; what was read is used, copy it again.")
    kept = [(spots.flags & Flag.AT_BORDER) == 0 for spots in found]
    places = np.repeat(np.array(read, dtype=np.int64), [int(keep.sum()) for keep in kept])
    middle = some[len(some) // 2]
    return _Found(
        source,
        name,
        (width, height),
        np.array(read, dtype=np.int64),
        places,
        np.concatenate([spots.xy[keep] for spots, keep in zip(found, kept, strict=True)]),
        np.concatenate([spots.size[keep] for spots, keep in zip(found, kept, strict=True)]),
        np.concatenate([spots.flags[keep] for spots, keep in zip(found, kept, strict=True)]),
        int(sum((~keep).sum() for keep in kept)),
        settings["threshold"],
        settings.get("mask"),
        (*middle, find_blobs(middle[1], **settings)),
        problems,
    )


def _gathered(
    found: Sequence[_Found], names: Sequence[str], numbers: Sequence[NDArray[np.int64]], when: Floats | None, first: int, rate: float
) -> Blobs:
    frame = np.concatenate([number[camera.place] for number, camera in zip(numbers, found, strict=True)])
    camera_of = np.repeat(np.arange(len(found)), [len(camera.place) for camera in found])
    xy, sizes = np.concatenate([camera.xy for camera in found]), np.concatenate([camera.sizes for camera in found])
    there = frame >= 0
    last = max(int(number[camera.read].max()) for number, camera in zip(numbers, found, strict=True))
    frames = last + 1 if when is None else len(when)
    blobs = Blobs.from_rows(frame[there], camera_of[there], xy[there], names, rate=rate, sizes=sizes[there], frames=frames, times=when)
    return replace(blobs, first_frame=first)
