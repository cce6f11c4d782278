"""The images of one camera in; its blobs, what the images were like, and what is wrong with them, out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.detection.blobs import BlobSettings, Flag, ImageBlobs, find_blobs, static_mask
from asterism.detection.grey import Grey, background_of
from asterism.detection.image_files import refuse_unread
from asterism.detection.sources import Source, images, some_images
from asterism.detection.thresholds import RULES, estimate_background, estimate_thresholds
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import Floats


@dataclass(frozen=True)
class ImageCheckRules:
    """When the images of a camera are suspect.

    sampled         images, spread over the whole sequence, that tell thresholds, background and mask
    min_to_mask     images without which static reflections are not looked for
    max_single_row  share of blobs that may be one row of pixels: more where a video is interlaced
    max_lit         share of an image that may be bright and not a blob
    clock_s         s, how finely some videos tell when a frame is shown
    max_step_s      s, between two frames, beyond which the clock of a video is not believed
    max_uneven      share of the usual step by which a step between two frames may differ
    """

    sampled: int = 24
    min_to_mask: int = 10
    max_single_row: float = 0.1
    max_lit: float = 0.25
    clock_s: float = 1e-3
    max_step_s: float = 3600.0
    max_uneven: float = 0.5


CHECKS = ImageCheckRules()


@dataclass(frozen=True)
class CameraImages:
    """What was found in one camera's images.

    name, path     the camera and where its images come from
    size           (width, height) px
    frames         images read, of `expected` that there should be
    threshold      grey values above the background that a blob's pixels exceed, and min_peak that its brightest one exceeds
    masked         share of the image under the mask of static reflections, and in how many places
    blobs          found and kept; at_border: left out because the image's edge or the mask cuts them; overlapping, unround, saturated: of
                   those kept
    lag_frames     frames that it lags behind most cameras, NaN where nothing tells
    sample         one of its images, and the blobs in it
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
    lag_frames: float
    sample: Grey
    sample_frame: int
    sample_blobs: ImageBlobs


@dataclass(frozen=True)
class FoundBlobs:
    """One camera's blobs as they were found.

    size        (width, height) px
    read        (N,) the places in the sequence of the images that were read
    place       (P,) the place of each blob's image; xy (P, 2) px, sizes (P,) px, flags (P,)
    at_border   blobs left out because the image's edge or the mask cuts them
    threshold, min_peak, mask, sample  see `CameraImages`
    """

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
    sample: tuple[int, Grey, ImageBlobs]
    findings: tuple[Finding, ...]

    def summary(self, lag_frames: float) -> CameraImages:
        """What was found, without the blobs themselves."""
        import cv2

        overlapping, unround, saturated = (int((self.flags & flag > 0).sum()) for flag in (Flag.OVERLAPPING, Flag.UNROUND, Flag.SATURATED))
        return CameraImages(
            name=self.name,
            path=self.source.path,
            size=self.size,
            frames=len(self.read),
            expected=len(self.source),
            threshold=self.threshold,
            min_peak=self.min_peak,
            masked=0.0 if self.mask is None else float(self.mask.mean()),
            masked_places=0 if self.mask is None else cv2.connectedComponents(self.mask.astype(np.uint8))[0] - 1,
            blobs=len(self.xy),
            at_border=self.at_border,
            overlapping=overlapping,
            unround=unround,
            saturated=saturated,
            lag_frames=lag_frames,
            sample=self.sample[1],
            sample_frame=self.sample[0],
            sample_blobs=self.sample[2],
        )


def search_images(
    source: Source, name: str, rig: Rig | None, settings: BlobSettings, mask_static: bool, timed: bool, advance: Callable[[], None]
) -> FoundBlobs:
    """Blobs in all images of one camera.

    timed    whether it is known when the images were taken, so that a video's own clock does not matter
    advance  called before each image is looked at

    Raises AsterismError where no image can be read, or images have different sizes or depths, or others than the rig's.
    """
    some = some_images(source, CHECKS.sampled)
    if not some:
        refuse_unread(source.files[0] if source.files else source.path)
        raise AsterismError(f"{source.path}: none of its images can be read; record or copy them again.")
    first = some[0][1]
    _check_size(source, name, first, rig)
    for place, image in some:
        _check_alike(source, place, image, first)
    given = settings
    # One threshold for all images of a camera: blobs must not grow and shrink as its noise is estimated anew.
    settings, threshold, peak = common_thresholds([image for _, image in some], settings)
    if mask_static:
        settings = replace(settings, mask=_static_mask(source, [image for _, image in some], settings))
    read = _read_all(source, first, settings, timed, advance)
    middle = some[len(some) // 2]
    #
    sample = find_blobs(middle[1], settings)
    xy, sizes, flags = (np.concatenate(column) for column in zip(*read.blobs, strict=True))
    findings = [*_sequence_findings(source, len(read.places), read.broken, np.diff(read.shown))]
    if not len(xy):
        findings.append(_no_markers(name, len(read.places), peak))
    elif given.threshold is None and _shows_more_than_markers(middle[1], peak, sample, settings, given):
        findings.append(_lit_room(name))
    if read.single_row > CHECKS.max_single_row * len(xy):
        findings.append(_interlaced(name, read.single_row, len(xy)))
    return FoundBlobs(
        source=source,
        name=name,
        size=(first.shape[1], first.shape[0]),
        read=np.array(read.places, dtype=np.int64),
        place=np.repeat(np.array(read.places, dtype=np.int64), [len(part[0]) for part in read.blobs]),
        xy=xy,
        sizes=sizes,
        flags=flags,
        at_border=read.at_border,
        threshold=threshold,
        min_peak=peak,
        mask=None if settings.mask is None else np.asarray(settings.mask, dtype=np.bool_),
        sample=(*middle, sample),
        findings=tuple(findings),
    )


@dataclass
class _Read:
    """What the images of a sequence gave: their places, the blobs of each, images that cannot be read, and a video's own times (s)."""

    places: list[int]
    blobs: list[tuple[Floats, Floats, NDArray[np.uint8]]]
    broken: list[int]
    shown: list[float]
    at_border: int = 0
    single_row: int = 0


def _read_all(source: Source, first: Grey, settings: BlobSettings, timed: bool, advance: Callable[[], None]) -> _Read:
    read = _Read([], [], [], [])
    for place, grey in images(source, None if timed else read.shown):
        advance()
        if grey is None:
            read.broken.append(place)
            continue
        _check_alike(source, place, grey, first)
        blobs = find_blobs(grey, settings)
        # The centroid of half a marker lies beside the marker.
        whole = (blobs.flags & Flag.AT_BORDER) == 0
        read.at_border += int((~whole).sum())
        read.single_row += int((blobs.extent[whole, 1] == 1).sum())
        read.places.append(place)
        read.blobs.append((blobs.xy[whole], blobs.size[whole], blobs.flags[whole]))
    return read


def common_thresholds(some: Sequence[Grey], settings: BlobSettings) -> tuple[BlobSettings, float, float]:
    """Settings for all images of a camera, what blobs' pixels exceed, and what the brightest one does.

    Where no threshold is given, it is the median of the images' automatic ones, unless some image's dark would be above it, as where a
    camera changes its gain: then each image has its own. So is the background where the light is uneven.
    """
    if settings.threshold is not None:
        threshold = float(settings.threshold)
        return settings, threshold, max(threshold, settings.min_peak or 0.0)
    background = estimate_background(some) if settings.background is None else settings.background
    settings = replace(settings, background=background, nested_regions=True)
    each = [estimate_thresholds(image, background) for image in some]
    blob, peak, noise = np.median([(found.blob, found.peak, found.noise) for found in each], axis=0).tolist()
    every = RULES.every
    # Where the dark of some image lies above the threshold that suits most, the camera changed its gain in between.
    darks = [np.median(image[::every, ::every].astype(np.int64) - background_of(image, background)[::every, ::every]) for image in some]
    if max(darks) <= peak:
        least = max(peak, settings.min_peak or 0.0)
        settings = replace(settings, threshold=blob, min_peak=least, contrast=RULES.peak_sigmas * noise)
    return settings, blob, max(peak, blob, settings.min_peak or 0.0)


def _static_mask(source: Source, some: Sequence[Grey], settings: BlobSettings) -> NDArray[np.bool_]:
    if len(some) < CHECKS.min_to_mask:
        raise AsterismError(f"{source.path}: {len(some)} images are too few to find what never moves; leave the static mask off.")
    return static_mask(some, threshold=settings.threshold, background=settings.background)


def _check_size(source: Source, name: str, first: Grey, rig: Rig | None) -> None:
    """Raise AsterismError where images have another size than the rig's camera."""
    height, width = first.shape
    if rig is not None and rig[name].size not in (None, (width, height)):
        wide, tall = rig[name].size or (0, 0)
        raise AsterismError(f"{source.path}: images are {width} x {height}, the rig says {wide} x {tall}; give the rig of these images.")


def _check_alike(source: Source, place: int, image: Grey, first: Grey) -> None:
    """Raise AsterismError where an image has another size or depth than the first."""
    file = source.files[place] if source.files else f"{source.path}, image {place}"
    if image.shape != first.shape:
        (tall, wide), (high, broad) = image.shape, first.shape
        raise AsterismError(f"{file}: {wide} x {tall} after images of {broad} x {high}; give one camera's.")
    if image.dtype != first.dtype:
        raise AsterismError(f"{file}: {image.dtype} after images of {first.dtype}; give images of one depth.")


def _shows_more_than_markers(image: Grey, threshold: float, blobs: ImageBlobs, settings: BlobSettings, given: BlobSettings) -> bool:
    """Whether much of an image is above the threshold, unmasked, and not a blob; or its light has texture."""
    if isinstance(settings.background, int) and given.background is None:
        return True
    bright = image > np.minimum(background_of(image, settings.background) + threshold, np.iinfo(image.dtype).max)
    if settings.mask is not None:
        bright &= ~np.asarray(settings.mask, dtype=np.bool_)
    return float(bright.mean() - np.pi / 4 * (blobs.size**2).sum() / image.size) > CHECKS.max_lit


def _no_markers(name: str, images: int, peak: float) -> Finding:
    return Finding(
        "detect-no-markers",
        Severity.WARNING,
        name,
        f"camera {name}: no marker in {images} images at a threshold of {peak:.0f}.",
        "Is it covered, dark or masked?",
    )


def _lit_room(name: str) -> Finding:
    return Finding(
        "detect-lit-room",
        Severity.WARNING,
        name,
        f"camera {name}: its images show more than markers before a dark ground, such as windows or a lit room, so that some blobs are "
        "not markers.",
        "Darken the room, or give --threshold, --background or --mask-static.",
    )


def _interlaced(name: str, single: int, blobs: int) -> Finding:
    return Finding(
        "detect-interlaced",
        Severity.WARNING,
        name,
        f"camera {name}: {single} of {blobs} blobs are one row of pixels, as where every other row is taken later (interlaced) and one "
        "marker becomes several.",
        "Deinterlace the video, or leave these blobs out with --min-width 2.",
    )


def _sequence_findings(source: Source, read: int, broken: Sequence[int], steps: Floats) -> Iterator[Finding]:
    """What is wrong with one camera's sequence. steps (N,) s between the frames of a video by its own clock."""
    where = str(source.path)
    if broken:
        yield Finding(
            "detect-unreadable-images",
            Severity.WARNING,
            where,
            f"{where}: {len(broken)} of {len(source)} images cannot be read, image {broken[0]} first; they are left out.",
            "Copy them again.",
        )
    if source.cut:
        yield Finding(
            "detect-cut-file", Severity.WARNING, where, f"{where} breaks off after image {read}; what was read is used.", "Copy it again."
        )
    if source.kind == "video" and read + 1 < len(source):
        yield Finding(
            "detect-short-video",
            Severity.WARNING,
            where,
            f"{where}: {read} of {len(source)} frames can be read: it breaks off, or lost some and shifts later ones.",
            "Copy it again.",
        )
    usual = float(np.median(steps)) if len(steps) else 0.0
    # Some containers carry clocks that run backwards or stand still, which tell nothing.
    believed = usual > 0 and steps.min() >= 0 and steps.max() < CHECKS.max_step_s
    if believed and np.abs(steps - usual).max() > CHECKS.max_uneven * usual + CHECKS.clock_s:
        yield Finding(
            "detect-uneven-frames",
            Severity.WARNING,
            where,
            f"{where}: from one frame to the next {1e3 * steps.min():.0f} to {1e3 * steps.max():.0f} ms pass, mostly {1e3 * usual:.0f}; "
            "frames were dropped or the rate changes, so that they do not match other cameras'.",
            "Give --times.",
        )
