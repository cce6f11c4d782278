"""A grey image in; the bright blobs in it out: places, sizes, shapes, and what is doubtful about each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.detection import _ground_kernels, _kernels
from asterism.errors import AsterismError
from asterism.recording import Floats

Grey = NDArray[np.unsignedinteger[Any]]

_LIT = 0.03
"""Share of bright pixels above which an image shows more than markers."""
_DEEPEST = 3
"""How many grounds may lie one on the other, such as a window, a body before it, and a shirt."""
_QUIETEST = 1.5
"""Grey values of noise that every image is taken to have: compression leaves such where a camera has less."""
_EVERY, _BLOCK, _AROUND = 4, 64, 25
"""Pixels from one that is looked at to the next, wide is a block whose light is told, and wide is what counts as around a pixel."""


class Flag(IntFlag):
    """What may be wrong with a blob."""

    AT_BORDER = _kernels.AT_BORDER
    """Touches the image's border or the mask: part of it may be missing, its centroid drawn away."""
    SATURATED = _kernels.SATURATED
    """Has pixels at the end of the grey scale."""
    OVERLAPPING = _kernels.OVERLAPPING
    """Split from a neighbour that it overlaps."""
    UNROUND = _kernels.UNROUND
    """Longer than round markers are: two that overlap without a valley between them, one that moves fast, or no marker."""


@dataclass(frozen=True)
class Spots:
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


def find_blobs(
    image: ArrayLike,
    *,
    threshold: float | None = None,
    background: ArrayLike | int | None = None,
    mask: ArrayLike | None = None,
    weigh_from: str = "threshold",
    connectivity: int = 8,
    min_size: float = 2.0,
    max_size: float = 64.0,
    min_width: float = 1.0,
    min_roundness: float = 0.0,
    round_from: float = 0.6,
    min_peak: float | None = None,
    min_weight: float = 0.0,
    split: float = 0.2,
    step: float | None = None,
    inside: bool | None = None,
    contrast: float | None = None,
) -> Spots:
    """Bright blobs of a grey image: pixels above a threshold that touch, their weighted centroids, shapes and doubts.

    image          (H, W) uint8 or uint16
    threshold      grey values above the background that a pixel must exceed; None: told from the image, four times the noise, and the
                   `automatic_threshold` for a blob's brightest pixel
    background     what is dark: an image of the empty scene, or an odd number of pixels: then it is the mean of so many by so many pixels
                   around each; None: 0 everywhere, `uneven_light` where there is no threshold either
    mask           (H, W) bool, True where nothing is looked for (see `static_mask`)
    weigh_from     pixels weigh their grey value above the "threshold" (least noise) or above the "background"
    connectivity   8: pixels that share a corner belong together; 4: a side
    min_size       px, smaller blobs are left out; so are those larger than max_size, such as windows and lamps
    min_width      px, blobs that are narrower or lower than this are left out, such as broken rows
    min_roundness  blobs less round than this are left out, those less round than round_from flagged
    min_peak       grey values above the background that a blob's brightest pixel must exceed; None: the threshold
    min_weight     blobs whose pixels' weights sum to less are left out
    split          two peaks in one blob are two blobs where the saddle between them lies this share of the lower peak below it; 1: never
    step           instead of `split`: grey values by which neighbouring pixels must differ for blobs to part there, as particle tracking
                   velocimetry parts its particles
    inside         whether an area that is larger than markers is a ground of its own, from which markers stand out by six times its noise,
                   as on a body that shines; None: where no threshold is given
    contrast       grey values by which a blob's brightest pixel must exceed the median of those around the blob; None: six times the noise
                   where no threshold is given, else 0

    Raises AsterismError for colour or other kinds of image, and for settings out of range.
    """
    grey = as_grey(image)
    _check(connectivity, min_size, max_size, split, step, weigh_from)
    inside = threshold is None if inside is None else inside
    if threshold is None:
        threshold, peak, noise, odd = tell_thresholds(grey, background)
        if odd and background is None:
            background = uneven_light([grey])
            threshold, peak, noise, _ = tell_thresholds(grey, background)
        min_peak, contrast = max(min_peak or 0.0, peak), 6.0 * noise if contrast is None else contrast
    level, base = _levels(grey, threshold, background)
    cut = np.ones(grey.shape, np.uint8)
    cut[1:-1, 1:-1] = 0
    if mask is not None:
        import cv2

        hidden = np.asarray(mask, dtype=bool)
        if hidden.shape != grey.shape:
            raise AsterismError(f"the mask is {_shape(hidden)}, the image {_shape(grey)}; learn it from images of this camera.")
        level[hidden] = np.iinfo(grey.dtype).max
        cut |= cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3), np.uint8))
    height, width = grey.shape
    capacity = height * ((width + 1) // 2)
    rows, firsts, lasts, parents = (np.empty(capacity, np.int32) for _ in range(4))
    largest, most = max_size**2 * np.pi / 4, int(np.iinfo(grey.dtype).max)
    for last in range(_DEEPEST, -1, -1):
        count = _kernels.find_runs(grey, level, int(connectivity == 8), rows, firsts, lasts, parents)
        order, starts = _kernels.by_component(parents, count)
        if (
            not inside
            or not last
            or not _ground_kernels.raise_levels(grey, level, rows, firsts, lasts, order, starts, largest, _QUIETEST, most)
        ):
            break
    bound = int((lasts[:count] - firsts[:count]).sum()) + count
    out, flags = np.empty((bound, _kernels.COLUMNS)), np.empty(bound, np.uint8)
    base, off = (base, 0.0) if weigh_from == "background" else (level, float(int(threshold)))
    limits = np.array([min_size**2 * np.pi / 4, largest, max(min_peak or 0.0, int(threshold)) - off])
    top = _brightest(grey)
    found = _kernels.measure(grey, base, cut, rows, firsts, lasts, order, starts, limits, split, step or 0.0, top, out, flags)
    blobs = out[:found]
    fits = (blobs[:, _kernels.WEIGHT] >= min_weight) & (blobs[:, [_kernels.WIDE, _kernels.TALL]] >= min_width).all(axis=1)
    if contrast:
        clear = np.empty(found, np.bool_)
        _ground_kernels.stand_out(grey, blobs, float(contrast), clear)
        fits &= clear
    return _spots(blobs[fits], flags[:found][fits], off, min_roundness, round_from)


def automatic_threshold(image: ArrayLike, background: ArrayLike | int | None = None) -> float:
    """Grey values above the background that stand out from an image's dark: six times its noise above the median.

    The noise is told from the pixels below the median, which markers do not touch, and from how pixels differ from those beside them. Every
    fourth pixel of every fourth row is looked at.
    """
    return tell_thresholds(as_grey(image), background)[1]


def tell_thresholds(grey: Grey, background: ArrayLike | int | None = None) -> tuple[float, float, float, bool]:
    """Grey values above the background: what a blob's pixels exceed, what its brightest one does (`automatic_threshold`), the standard
    deviation of the noise, and whether the image is uneven or lit (`uneven_light`).

    A blob reaches down to four times the noise, so that dim ones are whole; that is lower only where there is more noise than compression
    leaves.
    """
    few, most = _few(grey), int(np.iinfo(grey.dtype).max)
    dark = few if background is None else few - _few(background_of(grey, background))
    lowest = int(dark.min())
    counts = np.bincount((dark - lowest).ravel())
    foot, level, noise, uneven, lit = _level(counts, _noise(grey, few))
    reach, stands_out = (float(min(max(value + lowest, 0), most - 1)) for value in (foot, level))
    return reach, stands_out, noise, uneven or lit


def uneven_light(images: Sequence[ArrayLike]) -> Grey | int | None:
    """How to take off light that lies unevenly over images of one camera: a background for `find_blobs`; None where it is even.

    It is uneven where the darker half of the pixels differ by more than twice the noise of pixels side by side, or where more than 3 % are
    brighter than six times the noise. The light is the lower quartile of each 64 by 64 pixels of the median image, with straight lines
    between their centres, so that markers are no part of it. Where that leaves those 3 %, it is the mean of 25 by 25 pixels around each
    if the darker half was uneven, since the light has texture; else, as with a bright window, nothing is taken off.
    """
    import cv2

    first = as_grey(images[0])
    few = _few(first) if len(images) == 1 else np.median([_few(as_grey(image)) for image in images], axis=0).astype(np.int64)
    noise = _noise(first, _few(first))
    _, level, _, uneven, lit = _level(np.bincount(few.ravel()), noise)
    if not uneven and not lit:
        return None
    side = _BLOCK // _EVERY
    tall, wide = (max(round(length / side), 1) for length in few.shape)
    even = np.asarray(cv2.resize(few.astype(np.float32), (wide * side, tall * side), interpolation=cv2.INTER_NEAREST))
    blocks = np.quantile(even.reshape(tall, side, wide, side), 0.25, axis=(1, 3))
    smooth = _lines(first.shape[0], tall) @ blocks @ _lines(first.shape[1], wide).T
    light = np.clip(np.rint(smooth), 0, np.iinfo(first.dtype).max).astype(first.dtype)
    left = few - _few(light)
    _, lower, *_, lit = _level(np.bincount((left - left.min()).ravel()), noise)
    if not lit and lower + left.min() < level:
        return light
    return _AROUND if uneven else None


def _lines(length: int, blocks: int) -> Floats:
    """(length, blocks) how much each pixel takes of the values of equal blocks: straight lines through their centres, and on."""
    place = (np.arange(length) + 0.5) * blocks / length - 0.5
    low = np.clip(np.floor(place), 0, max(blocks - 2, 0)).astype(np.int64)
    shares = np.zeros((length, blocks))
    shares[np.arange(length), low] = 1.0
    if blocks > 1:
        shares[np.arange(length), low] -= place - low
        shares[np.arange(length), low + 1] = place - low
    return shares


def _few(grey: Grey) -> NDArray[np.int64]:
    return grey[::_EVERY, ::_EVERY].astype(np.int64)


def _level(counts: NDArray[np.int64], noise: float) -> tuple[int, int, float, bool, bool]:
    """Of grey values that are counted from 0: what a blob reaches down to, what stands out, the standard deviation of the dark, whether
    that is more than the noise's, and whether more stands out than markers would."""
    shares = np.cumsum(counts) / counts.sum()
    quarter, middle = (int(np.searchsorted(shares, share, side="right")) for share in (0.25, 0.5))
    spread = (middle - quarter) / _ground_kernels.QUARTILE
    noise = max(noise, _QUIETEST)
    most = max(spread, noise)
    level, foot = int(middle + 6.0 * most) + 1, int(middle + max(4.0 * most, 6.0 * _QUIETEST)) + 1
    return foot, level, most, spread > 2.0 * noise, level < len(counts) and bool(1.0 - shares[level] > _LIT)


def _noise(grey: Grey, few: NDArray[np.int64]) -> float:
    """The standard deviation of the noise, by how pixels differ from those to their right: nine of ten by less than 2.33 times that.

    Where a quarter of the pixels is black, the noise below is cut off, and they differ by that much less.
    """
    beside = grey[::_EVERY, 1::_EVERY]
    steps = np.bincount(np.abs(few[:, : beside.shape[1]] - beside).ravel(), minlength=1)
    cut = 1.6 if np.count_nonzero(few) < 0.75 * few.size else 1.0
    return cut * float(np.searchsorted(np.cumsum(steps), 0.9 * steps.sum())) / 2.33


def static_mask(
    images: Iterable[ArrayLike],
    *,
    threshold: float | None = None,
    background: ArrayLike | int | None = None,
    share: float = 0.9,
    margin: int = 2,
) -> NDArray[np.bool_]:
    """Where reflections stand still: True (H, W) within `margin` px of pixels that are above the threshold in this share of the images.

    Markers must move between the images: one that rests in nearly all of them is masked too. Threshold and background as in `find_blobs`,
    the threshold for each image by itself where None. Raises AsterismError where there is no image, or where their sizes differ.
    """
    import cv2

    above: NDArray[np.int64] | None = None
    total = 0
    for image in images:
        grey = as_grey(image)
        own = automatic_threshold(grey, background) if threshold is None else threshold
        bright = grey > _levels(grey, own, background)[0]
        if above is not None and above.shape != bright.shape:
            raise AsterismError(f"an image is {_shape(grey)}, the first one {_shape(above)}; give images of one camera.")
        above = bright.astype(np.int64) if above is None else above + bright
        total += 1
    if above is None:
        raise AsterismError("there is no image to learn static reflections from; give some of this camera.")
    around = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return cv2.dilate((above >= share * total).astype(np.uint8), around).astype(bool)


def as_grey(image: ArrayLike) -> Grey:
    """The image as rows of uint8 or uint16. Raises AsterismError for anything else; colour images whose channels agree are grey."""
    grey = np.asarray(image)
    if grey.ndim == 3 and grey.shape[2] in (3, 4) and (grey[..., 0] == grey[..., 1]).all() and (grey[..., 0] == grey[..., 2]).all():
        grey = grey[..., 0]
    if grey.ndim != 2 or not grey.size:
        raise AsterismError(f"an image of shape {grey.shape} is no grey image; give rows and columns of grey values.")
    if grey.dtype.kind != "u" or grey.dtype.itemsize > 2:
        raise AsterismError(f"an image of {grey.dtype} values; give 8 or 16 bit grey values without sign.")
    return np.require(grey, grey.dtype.newbyteorder("="), ["C", "W"])


def _check(connectivity: int, min_size: float, max_size: float, split: float, step: float | None, weigh_from: str) -> None:
    if connectivity not in (4, 8):
        raise AsterismError(f"connectivity {connectivity} is not known; choose 4 or 8.")
    if not 0 <= min_size <= max_size:
        raise AsterismError(f"blobs of {min_size} to {max_size} px cannot be; give a smallest size not above the largest.")
    if not split > 0:
        raise AsterismError(f"split {split} is not positive; give a share such as 0.2, or 1 to leave overlapping blobs as they are.")
    if step is not None and not step > 0:
        raise AsterismError(f"a step of {step} grey values is not positive; give for example 100, or none to part blobs at their valleys.")
    if weigh_from not in ("threshold", "background"):
        raise AsterismError(f"pixels cannot weigh from {weigh_from!r}; choose 'threshold' or 'background'.")


def _brightest(grey: Grey) -> int:
    """The end of the grey scale: where the brightest pixel has all of 9 to 15 bits set, a camera of as many bits wrote the image."""
    most, brightest = int(np.iinfo(grey.dtype).max), int(grey.max())
    return brightest if 255 < brightest < most and brightest & (brightest + 1) == 0 else most


def background_of(grey: Grey, background: ArrayLike | int | None) -> Grey:
    """The dark behind an image, of its shape and type: see `find_blobs`. Raises AsterismError where it does not fit."""
    if background is None:
        return np.zeros_like(grey)
    if isinstance(background, int | np.integer):
        if background < 3 or background % 2 == 0:
            raise AsterismError(f"a background of {background} pixels; give an odd number from 3 on.")
        import cv2

        # Rounded down: an integer exceeds the mean by more than a threshold if and only if it exceeds the mean so rounded by more.
        sums = np.asarray(cv2.boxFilter(grey, cv2.CV_64F, (int(background), int(background)), normalize=False))
        sums /= int(background) ** 2
        return sums.astype(grey.dtype)
    base = as_grey(background)
    if base.shape != grey.shape or base.dtype != grey.dtype:
        raise AsterismError(
            f"the background is {_shape(base)} {base.dtype}, the image {_shape(grey)} {grey.dtype}; give one of this camera."
        )
    return base


def _levels(grey: Grey, threshold: float, background: ArrayLike | int | None) -> tuple[Grey, Grey]:
    """Per pixel the grey value that must be exceeded, and the background, both of the image's type."""
    base = background_of(grey, background)
    most = int(np.iinfo(grey.dtype).max)
    if not 0 <= threshold < most:
        raise AsterismError(f"threshold {threshold} is outside the grey scale; give 0 to {most - 1} for images of {grey.dtype}.")
    if background is None:
        return np.full_like(grey, int(threshold)), base
    import cv2

    return np.asarray(cv2.add(base, np.full_like(base, int(threshold)))), base


def _spots(rows: Floats, flags: NDArray[np.uint8], off: float, min_roundness: float, round_from: float) -> Spots:
    """Blobs from the kernel's rows: axes from second moments, to which each pixel's own extent adds 1/12 px2."""
    xx, yy, xy = rows[:, _kernels.XX] + 1 / 12, rows[:, _kernels.YY] + 1 / 12, rows[:, _kernels.XY]
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    roundness = np.sqrt(np.maximum(half - apart, 0.0) / (half + apart))
    keep = roundness >= min_roundness
    flags = flags | np.where(roundness < round_from, np.uint8(Flag.UNROUND), np.uint8(0))
    return Spots(
        rows[keep][:, [_kernels.X, _kernels.Y]],
        2.0 * np.sqrt(rows[keep, _kernels.AREA] / np.pi),
        rows[keep][:, [_kernels.WIDE, _kernels.TALL]],
        roundness[keep],
        rows[keep, _kernels.PEAK] + off,
        rows[keep, _kernels.WEIGHT],
        flags[keep],
    )


def _shape(image: NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
