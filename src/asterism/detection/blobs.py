"""A grey image in; the bright blobs in it out: positions, sizes, shapes, and flags for what is doubtful about each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.detection import _moment_kernels as moments
from asterism.detection._region_kernels import raise_threshold, stands_out
from asterism.detection._run_kernels import Components, Runs, find_runs, group_runs
from asterism.detection.grey import Grey, as_grey, levels_of, saturated_from, size_text
from asterism.detection.thresholds import RULES, automatic_threshold, estimate_background, estimate_thresholds
from asterism.errors import AsterismError
from asterism.recording import Floats

_NESTED = 3
"""How many regions may lie one in the other, such as a window, a body before it, and a shirt."""

_QUICK = 100_000
"""Sweeps times pixels times blobs in which a component is shared quickly, 2 ms. Two markers of 25 px that overlap have all sweeps. Half of
it cuts those short whose centres still move by hundredths of a pixel; twice as much holds up the next image for what is no marker."""


class Flag(IntFlag):
    """What may be wrong with a blob."""

    AT_BORDER = moments.AT_BORDER
    """Touches the image's border or the mask: part of it may be missing, its centroid drawn away."""
    SATURATED = moments.SATURATED
    """Has pixels at the end of the grey scale."""
    OVERLAPPING = moments.OVERLAPPING
    """Split from a neighbour that it overlaps."""
    UNROUND = moments.UNROUND
    """Longer than round markers are: two that overlap without a valley between them, one that moves fast, or not a marker."""


@dataclass(frozen=True)
class ImageBlobs:
    """The blobs of one image, in the order of their first pixel.

    xy         (N, 2) px, intensity-weighted centroids; the centre of the top left pixel is (0, 0)
    size       (N,) px, diameter of the circle of as many pixels as are above the threshold
    extent     (N, 2) px, width and height of its pixels
    roundness  (N,) shorter over longer axis, by second moments: 1 is a disc
    peak       (N,) grey value of the brightest pixel above the background
    weight     (N,) sum of the pixels' weights: grey values above the threshold, or above the background
    flags      (N,) sums of `Flag`
    """

    xy: Floats
    size: Floats
    extent: Floats
    roundness: Floats
    peak: Floats
    weight: Floats
    flags: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.xy)


@dataclass(frozen=True, eq=False)
class BlobSettings:
    """What is a blob.

    threshold         grey values above the background that a pixel must exceed; None: estimated from the image, four times the noise, and
                      the `automatic_threshold` for a blob's brightest pixel
    background        what is dark: an image of the empty scene, or an odd number of pixels, then it is the mean of so many by so many
                      pixels around each; None: 0 everywhere, or `estimate_background` where there is no threshold either
    mask              (H, W) bool, True where nothing is looked for (see `static_mask`)
    weight_reference  pixels weigh their grey value above the "threshold" (least noise) or above the "background"
    connectivity      8: pixels that share a corner belong together; 4: a side
    min_size          px, the smallest diameter; smaller blobs, such as hot pixels, are left out
    max_size          px, the largest diameter; larger blobs, such as windows and lamps, are left out
    min_width         px, blobs that are narrower or lower than this are left out, such as broken rows
    min_roundness     blobs less round than this are left out
    flag_roundness    blobs less round than this have the flag UNROUND
    min_peak          grey values above the background that a blob's brightest pixel must exceed; None: the threshold
    min_weight        blobs whose pixels' weights sum to less are left out
    split             two peaks in one blob are two blobs where the saddle between them lies this share of the lower peak below it; 1: never
    step              instead of `split`: grey values by which neighbouring pixels must differ for blobs to part there, as particle tracking
                      velocimetry parts its particles
    nested_regions    whether an area that is larger than markers is a region from which markers must stand out by six times its noise, as
                      on a body that shines; None: where no threshold is given
    contrast          grey values by which a blob's brightest pixel must exceed the median of those around the blob; None: six times the
                      noise where no threshold is given, else 0
    quick             whether what overlaps is shared in 2 ms a component, so that the next image of a camera that runs need not wait: blobs
                      of more than 25 px then lie up to a pixel elsewhere
    """

    threshold: float | None = None
    background: ArrayLike | int | None = None
    mask: ArrayLike | None = None
    weight_reference: str = "threshold"
    connectivity: int = 8
    min_size: float = 2.0
    max_size: float = 64.0
    min_width: float = 1.0
    min_roundness: float = 0.0
    flag_roundness: float = 0.6
    min_peak: float | None = None
    min_weight: float = 0.0
    split: float = 0.2
    step: float | None = None
    nested_regions: bool | None = None
    contrast: float | None = None
    quick: bool = False

    def check(self) -> None:
        """Raise AsterismError where a setting is out of range."""
        if self.connectivity not in (4, 8):
            raise AsterismError(f"connectivity {self.connectivity} is not known; choose 4 or 8.")
        if not 0 <= self.min_size <= self.max_size:
            raise AsterismError(f"blobs of {self.min_size} to {self.max_size} px: give a smallest size that is not above the largest.")
        if not self.split > 0:
            raise AsterismError(f"split {self.split} is not positive; give a share such as 0.2, or 1 to leave overlapping blobs whole.")
        if self.step is not None and not self.step > 0:
            raise AsterismError(
                f"a step of {self.step} grey values is not positive; give for example 100, or none to part blobs at their valleys."
            )
        if self.min_peak is not None and not np.isfinite(self.min_peak):
            raise AsterismError(f"a least peak of {self.min_peak} grey values cannot be exceeded; give a number, or none to estimate it.")
        if self.weight_reference not in ("threshold", "background"):
            raise AsterismError(f"pixels cannot weigh from {self.weight_reference!r}; choose 'threshold' or 'background'.")


def find_blobs(image: ArrayLike, settings: BlobSettings | None = None) -> ImageBlobs:
    """Bright blobs of a grey image: pixels above a threshold that touch, their weighted centroids, shapes and flags.

    image     (H, W) uint8 or uint16
    settings  None: thresholds are estimated from the image

    Raises AsterismError for colour or other kinds of image, and for settings out of range.

    >>> image = np.zeros((40, 60), np.uint8)
    >>> image[10:15, 20:25] = 200
    >>> blobs = find_blobs(image, BlobSettings(threshold=50))
    >>> blobs.xy
    array([[22., 12.]])
    >>> blobs.size.round(1)
    array([5.6])
    """
    grey = as_grey(image)
    settings = BlobSettings() if settings is None else settings
    settings.check()
    settings = _with_thresholds(grey, settings)
    threshold = settings.threshold or 0.0
    level, base = levels_of(grey, threshold, settings.background)
    cut = _cut(grey, level, settings.mask)
    components = _components(grey, level, settings)
    # The kernel counts grey values from the base; what lies between it and the background is added to peaks afterwards.
    base, offset = (base, 0.0) if settings.weight_reference == "background" else (level, float(int(threshold)))
    limits = moments.MeasureLimits(
        min_area=settings.min_size**2 * np.pi / 4,
        max_area=settings.max_size**2 * np.pi / 4,
        min_peak=max(settings.min_peak or 0.0, int(threshold)) - offset,
        split=float(settings.split),
        step=float(settings.step or 0.0),
        saturated=float(saturated_from(grey)),
        contrast=float(settings.contrast or 0.0),
        sharings=_QUICK if settings.quick else moments.MOST_SHARED * moments.MOST_SWEEPS,
    )
    # A blob has a peak of its own, and no component has more peaks than pixels.
    bound = int((components.lasts - components.firsts).sum()) + len(components.order)
    out, flags = np.empty((bound, moments.COLUMNS)), np.empty(bound, np.uint8)
    found = moments.measure(moments.ImageArrays(grey, base, cut), components, limits, out, flags)
    blobs = out[:found]
    kept = (blobs[:, moments.WEIGHT] >= settings.min_weight) & (blobs[:, [moments.WIDE, moments.TALL]] >= settings.min_width).all(axis=1)
    if settings.contrast:
        distinct = np.empty(found, np.bool_)
        stands_out(grey, blobs, float(settings.contrast), distinct)
        kept &= distinct
    return _image_blobs(blobs[kept], flags[:found][kept], offset, settings)


def _with_thresholds(grey: Grey, settings: BlobSettings) -> BlobSettings:
    """The settings with the thresholds that are estimated from the image where none is given."""
    nested = settings.threshold is None if settings.nested_regions is None else settings.nested_regions
    if settings.threshold is not None:
        return replace(settings, nested_regions=nested)
    background = settings.background
    found = estimate_thresholds(grey, background)
    if found.uneven and background is None:
        # Light that lies unevenly over the image hides dim markers in its dark part and makes blobs of its bright one.
        background = estimate_background([grey])
        found = estimate_thresholds(grey, background)
    return replace(
        settings,
        threshold=found.blob,
        background=background,
        min_peak=max(settings.min_peak or 0.0, found.peak),
        nested_regions=nested,
        contrast=RULES.peak_sigmas * found.noise if settings.contrast is None else settings.contrast,
    )


def _cut(grey: Grey, level: Grey, mask: ArrayLike | None) -> NDArray[np.uint8]:
    """Where a blob may go on unseen (H, W): at the image's edge and beside the mask. OUT level: nothing is above it under the mask."""
    cut = np.ones(grey.shape, np.uint8)
    cut[1:-1, 1:-1] = 0
    if mask is None:
        return cut
    import cv2

    hidden = np.asarray(mask, dtype=bool)
    if hidden.shape != grey.shape:
        raise AsterismError(f"the mask is {size_text(hidden)}, the image {size_text(grey)}; make the mask from images of this camera.")
    # Nothing exceeds the end of the scale.
    level[hidden] = np.iinfo(grey.dtype).max
    cut |= cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3), np.uint8))
    return cut


def _components(grey: Grey, level: Grey, settings: BlobSettings) -> Components:
    """The components above the level. OUT level: raised in regions larger than markers where that is asked for."""
    height, width = grey.shape
    # Runs of a row are a pixel apart at least.
    capacity = height * ((width + 1) // 2)
    runs = Runs(*(np.empty(capacity, np.int32) for _ in range(4)))
    largest, most = settings.max_size**2 * np.pi / 4, int(np.iinfo(grey.dtype).max)
    reach = int(settings.connectivity == 8)
    # A raised threshold uncovers the regions inside, which may hold brighter ones in turn.
    for last in range(_NESTED, -1, -1):
        count = find_runs(grey, level, reach, runs)
        components = group_runs(runs, count)
        if not settings.nested_regions or not last or not raise_threshold(grey, level, components, largest, RULES.min_noise, most):
            break
    return components._replace(rows=runs.rows[:count], firsts=runs.firsts[:count], lasts=runs.lasts[:count])


def _image_blobs(rows: Floats, flags: NDArray[np.uint8], offset: float, settings: BlobSettings) -> ImageBlobs:
    """Blobs from the kernel's rows: axes from second moments, to which each pixel's own extent adds 1/12 px2."""
    xx, yy, xy = rows[:, moments.XX] + 1 / 12, rows[:, moments.YY] + 1 / 12, rows[:, moments.XY]
    # The two eigenvalues of a symmetric 2 x 2 matrix are its half trace plus and minus this.
    half, difference = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    roundness = np.sqrt(np.maximum(half - difference, 0.0) / (half + difference))
    keep = roundness >= settings.min_roundness
    flags = flags | np.where(roundness < settings.flag_roundness, np.uint8(Flag.UNROUND), np.uint8(0))
    return ImageBlobs(
        rows[keep][:, [moments.X, moments.Y]],
        2.0 * np.sqrt(rows[keep, moments.AREA] / np.pi),
        rows[keep][:, [moments.WIDE, moments.TALL]],
        roundness[keep],
        rows[keep, moments.PEAK] + offset,
        rows[keep, moments.WEIGHT],
        flags[keep],
    )


def static_mask(
    images: Iterable[ArrayLike],
    *,
    threshold: float | None = None,
    background: ArrayLike | int | None = None,
    share: float = 0.9,
    margin: int = 2,
) -> NDArray[np.bool_]:
    """Where reflections never move: True (H, W) within `margin` px of pixels that are above the threshold in this share of the images.

    Markers must move between the images: one that rests in nearly all of them is masked too. Threshold and background as in `BlobSettings`,
    the threshold for each image by itself where None. Raises AsterismError where there is no image, or where their sizes differ.

    >>> images = np.zeros((10, 20, 30), np.uint8)
    >>> images[:, 5, 5] = 255  # a lamp
    >>> images[np.arange(10), 12, np.arange(10, 30, 2)] = 255  # a marker on its way
    >>> np.argwhere(static_mask(images, threshold=100, margin=0)).tolist()
    [[5, 5]]
    """
    import cv2

    above: NDArray[np.int64] | None = None
    total = 0
    for image in images:
        grey = as_grey(image)
        limit = automatic_threshold(grey, background) if threshold is None else threshold
        bright = grey > levels_of(grey, limit, background)[0]
        if above is not None and above.shape != bright.shape:
            raise AsterismError(f"an image is {size_text(grey)}, the first one {size_text(above)}; give images of one camera.")
        above = bright.astype(np.int64) if above is None else above + bright
        total += 1
    if above is None:
        raise AsterismError("there is no image to find static reflections in; give some of this camera.")
    around = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return cv2.dilate((above >= share * total).astype(np.uint8), around).astype(bool)
