"""The image sequences of several cameras in; their blobs in common frames, and what to know about each camera, out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, CancelledError, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.detection.alignment import names_of, numbered, on_common_clock, rate_of
from asterism.detection.blobs import Flag, Grey, Spots, background_of, find_blobs, static_mask, tell_thresholds, uneven_light
from asterism.detection.sources import Source, images, open_source, some_images
from asterism.detection.times import read_times
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Blobs, Floats
from asterism.synchronization.lags import lags, out_of_step, slips

_LOOKED_AT = 24
_BEHIND = 2
"""Frames that a camera must lag to be called unsynchronised where no rig is known; one with a rig."""
_FEWEST_TO_MASK = 10
"""Images that tell what stands still."""
_MOST_SINGLE = 0.1
"""Share of blobs that may be one row of pixels."""
_MOST_LIT = 0.25
"""Share of an image that may be bright and no blob."""
_CLOCK_S, _LONGEST_S = 1e-3, 3600.0
"""How finely some videos tell when a frame is shown; between two frames of which it is no clock but garbage when more passes."""


@dataclass(frozen=True)
class CameraImages:
    """What was found in one camera's images.

    name, path   the camera and where its images come from
    size         (width, height) px
    frames       images read, of `expected` that there should be
    threshold    grey values above the background that a blob's pixels exceed, and min_peak that its brightest one exceeds
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
    min_peak: float
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
    """Blobs of all cameras, what each camera's images were like, what is wrong with them (one sentence each), whether no clock and no
    video told the frame rate, and the share of blobs left out since they could not be followed to a common clock."""

    blobs: Blobs
    cameras: tuple[CameraImages, ...]
    problems: tuple[str, ...]
    rate_assumed: bool
    not_followed: float

    def to_dict(self) -> dict[str, Any]:
        """All but the images, as plain values."""
        left_out = ("sample", "spots")
        per_frame = self.blobs.counts.mean(axis=0) if len(self.blobs) else np.zeros(len(self.cameras))
        return {
            "frames": len(self.blobs),
            "rate": self.blobs.rate,
            "rate_assumed": self.rate_assumed,
            "not_followed": self.not_followed,
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
    threshold    as in `find_blobs`, one for all cameras or one for each; None: the median of the automatic ones of some 24 images; there
                 `uneven_light` is the background where none is given
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
    stop = Event()

    def advance(c: int) -> None:
        if stop.is_set():
            raise CancelledError
        done[c] += 1
        if progress is not None and done[c] % 10 == 0:
            progress(min(sum(done) / total, 1.0), f"detecting: {names[c]}")

    def one(c: int) -> _Found:
        own = {**settings, "threshold": thresholds[c]}
        return _search(sources[c], names[c], rig, mask_static, stamps is not None, own, lambda: advance(c))

    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, c) for c in range(len(sources))]
        try:
            finished = wait(futures, return_when=FIRST_EXCEPTION).done
            found = [future.result() for future in futures if future in finished]
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    problems = [sentence for camera in found for sentence in camera.problems]
    numbers, when, first = numbered(sources, [camera.read for camera in found], names, stamps, problems)
    blobs = _gathered(found, names, numbers, when, first, rate_of(sources, rate, when, names, problems))
    blobs, not_followed = (blobs, 0.0) if when is None else on_common_clock(blobs, problems)
    posed = rig.select(names) if rig is not None and all(camera.posed for camera in rig.select(names)) else None
    behind = lags(blobs, posed)
    problems += _out_of_step(names, behind, slips(blobs, posed) if posed is not None else np.full(len(names), np.nan), rig)
    told = tuple(camera.told(lag) for camera, lag in zip(found, behind.tolist(), strict=True))
    assumed = rate is None and when is None and not all(np.isfinite(source.rate) for source in sources)
    return Detection(blobs, told, tuple(problems), assumed, not_followed)


def _out_of_step(names: Sequence[str], behind: Floats, slipped: Floats, rig: Rig | None) -> Iterator[str]:
    """Cameras that started at another time than the others (`lags`), or that came to be out of step on the way (`slips`)."""
    for name, frames, more in zip(names, behind, slipped, strict=True):
        if abs(more) >= 1:
            images = f"{abs(more):.0f} image{'s' if abs(more) > 1 else ''}"
            what = f"lost {images} on the way" if more < 0 else f"has {images} twice, or the others lost as many on the way"
            yield f"camera {name} {what} and is out of step from there on; record again, or give the time of each image."
        elif abs(frames) >= (_BEHIND if rig is None else 1):
            yield " ".join(out_of_step(name, frames))


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
    min_peak: float
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
            self.min_peak,
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


def _search(
    source: Source, name: str, rig: Rig | None, mask_static: bool, timed: bool, settings: dict[str, Any], advance: Callable[[], None]
) -> _Found:
    """Blobs in all images of one camera; `timed`: when they were taken is known."""
    some = some_images(source, _LOOKED_AT)
    if not some:
        raise AsterismError(f"{source.path}: none of its images can be read; record or copy them again.")
    first = some[0][1]
    height, width = first.shape
    if rig is not None and rig[name].size not in (None, (width, height)):
        wide, tall = rig[name].size or (0, 0)
        raise AsterismError(f"{source.path}: images are {width} x {height}, the rig says {wide} x {tall}; give the rig of these images.")
    for place, image in some:
        _alike(source, place, image, first)
    looked_at = [image for _, image in some]
    told, around = settings["threshold"] is None, settings.get("background") is not None
    threshold, peak = _tell_threshold(looked_at, settings) if told else (float(settings["threshold"]), 0.0)
    peak = max(peak, threshold, settings.get("min_peak") or 0.0)
    if mask_static:
        if len(some) < _FEWEST_TO_MASK:
            raise AsterismError(f"{source.path}: {len(some)} images do not tell what stands still; leave the mask of static things off.")
        settings["mask"] = static_mask(looked_at, threshold=settings["threshold"], background=settings.get("background"))
    read: list[int] = []
    at_border = single = 0
    parts: list[tuple[Floats, Floats, NDArray[np.uint8]]] = []
    broken: list[int] = []
    shown: list[float] = []
    for place, grey in images(source, None if timed else shown):
        advance()
        if grey is None:
            broken.append(place)
            continue
        _alike(source, place, grey, first)
        spots = find_blobs(grey, **settings)
        whole = (spots.flags & Flag.AT_BORDER) == 0
        at_border += int((~whole).sum())
        single += int((spots.extent[whole, 1] == 1).sum())
        read.append(place)
        parts.append((spots.xy[whole], spots.size[whole], spots.flags[whole]))
    middle = some[len(some) // 2]
    sample = find_blobs(middle[1], **settings)
    problems = _wrong(source, len(read), broken, np.diff(shown))
    xy, sizes, flags = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not len(xy):
        problems.append(f"camera {name}: no marker in {len(read)} images at a threshold of {peak:.0f}; is it covered, dark or masked?")
    elif told and (_lit(middle[1], peak, sample, settings) > _MOST_LIT or (isinstance(settings["background"], int) and not around)):
        problems.append(
            f"camera {name}: its images show more than markers before a dark ground, such as windows or a lit room, so that blobs may be "
            "none; darken the room, or give --threshold, --background or --mask-static."
        )
    if single > _MOST_SINGLE * len(xy):
        problems.append(
            f"camera {name}: {single} of {len(xy)} blobs are one row of pixels, as where every other row is taken later (interlaced) "
            "and one marker becomes several; deinterlace it, or leave them out with --min-width 2."
        )
    places = np.repeat(np.array(read, dtype=np.int64), [len(part[0]) for part in parts])
    return _Found(
        source,
        name,
        (width, height),
        np.array(read, dtype=np.int64),
        places,
        xy,
        sizes,
        flags,
        at_border,
        threshold,
        peak,
        settings.get("mask"),
        (*middle, sample),
        problems,
    )


def _tell_threshold(images: Sequence[Grey], settings: dict[str, Any]) -> tuple[float, float]:
    """The median of the images' automatic thresholds: what blobs' pixels exceed, and what the brightest one does.

    They go into the settings, unless some image's dark would be above them, as where a camera changes its gain: then each image has its
    own. So does the light where it is uneven."""
    if settings.get("background") is None:
        settings["background"] = uneven_light(images)
    background, settings["inside"] = settings["background"], True
    foot, peak, noise = np.median([tell_thresholds(image, background)[:3] for image in images], axis=0).tolist()
    darks = [np.median(image[::4, ::4].astype(np.int64) - background_of(image, background)[::4, ::4]) for image in images]
    if max(darks) <= peak:
        settings["threshold"], settings["min_peak"], settings["contrast"] = foot, max(peak, settings.get("min_peak") or 0.0), 6.0 * noise
    return foot, peak


def _lit(image: Grey, threshold: float, spots: Spots, settings: dict[str, Any]) -> float:
    """The share of an image that is above the threshold, unmasked, and no blob."""
    bright = image > np.minimum(background_of(image, settings.get("background")) + threshold, np.iinfo(image.dtype).max)
    if settings.get("mask") is not None:
        bright &= ~settings["mask"]
    return float(bright.mean() - np.pi / 4 * (spots.size**2).sum() / image.size)


def _alike(source: Source, place: int, image: Grey, first: Grey) -> None:
    """Raise AsterismError where an image has another size or depth than the first."""
    file = source.files[place] if source.files else f"{source.path}, image {place}"
    if image.shape != first.shape:
        (tall, wide), (high, broad) = image.shape, first.shape
        raise AsterismError(f"{file}: {wide} x {tall} after images of {broad} x {high}; give one camera's.")
    if image.dtype != first.dtype:
        raise AsterismError(f"{file}: {image.dtype} after images of {first.dtype}; give images of one depth.")


def _wrong(source: Source, read: int, broken: Sequence[int], steps: Floats) -> list[str]:
    """What is wrong with one camera's sequence: sentences. steps (N,) s between the frames of a video by its own clock."""
    problems = []
    if broken:
        problems.append(f"{source.path}: {len(broken)} of {len(source)} images cannot be read, image {broken[0]} first; they are left out.")
    if source.cut:
        problems.append(f"{source.path} breaks off after image {read}; what was read is used, copy it again.")
    if source.kind == "video" and read + 1 < len(source):
        problems.append(
            f"{source.path}: {read} of {len(source)} frames can be read: it breaks off, or lost some and shifts later ones; copy it again."
        )
    usual = float(np.median(steps)) if len(steps) else 0.0
    sane = usual > 0 and steps.min() >= 0 and steps.max() < _LONGEST_S
    if sane and np.abs(steps - usual).max() > 0.5 * usual + _CLOCK_S:
        problems.append(
            f"{source.path}: from one frame to the next {1e3 * steps.min():.0f} to {1e3 * steps.max():.0f} ms pass, mostly "
            f"{1e3 * usual:.0f}; frames were dropped or the rate changes, so that they do not match other cameras'; give --times."
        )
    return problems


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
