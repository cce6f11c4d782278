"""Images of one camera as they come in; the blobs in each at once, by thresholds learnt from the images before it, out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.detection.blobs import BlobSettings, Flag, ImageBlobs, find_blobs, static_mask
from asterism.detection.camera_images import CHECKS, common_thresholds
from asterism.detection.grey import Grey, grey_of_colour, saturated_from, size_text
from asterism.detection.thresholds import RULES
from asterism.errors import AsterismError

MOST_BLOBS = 2000
"""Blobs of one image that are passed on, the heaviest first. A dense suit in a near view has hundreds; half of it cuts one with a lit room
behind it, and twice as many fill the pipe of all cameras."""


@dataclass(frozen=True)
class LearningRules:
    """From which images the thresholds of a running camera are learnt: as many as off line, spread over what has passed.

    first_s   s between the first ones, so that all are there after 2.4 s; at half they show one posture, at double the first thresholds of
              an uneven room hold for 5 s
    every_s   s between them at last: 24 are two minutes. A cloud before the sun takes half a minute; learnt from half of it, a person who
              stands still becomes part of the background; at double, the light of an evening falls by more than noise in between
    jump      grey values by which the mean of an image leaves that of all images learnt from, after which it is learnt from at once: six
              times the least noise, as for a blob. At half a person in white who comes near does it, at double a gain of 3 dB in a dark
              image does not
    """

    first_s: float = 0.1
    every_s: float = 5.0
    jump: float = RULES.peak_sigmas * RULES.min_noise


LEARNING = LearningRules()


@dataclass(frozen=True, eq=False)
class RunningBlobs:
    """What one image shows.

    blobs       whole ones: those that the image's edge or the mask cuts are left out, as off line
    at_border   how many these are
    brightness  mean grey value, by every fourth pixel of every fourth row
    saturated   share of these pixels at the end of the grey scale
    crowded     whether there were more than `MOST_BLOBS`, of which the lightest are left out
    """

    blobs: ImageBlobs
    at_border: int
    brightness: float
    saturated: float
    crowded: bool


def compile_search() -> None:
    """Compile the kernels that `RunningDetection` calls, or load them, so that no image waits for it: some seconds the first time."""
    # Two blobs that overlap, and one at the edge.
    image = np.full((64, 64), 20, np.uint8)
    image[20:26, 20:26], image[30:36, 24:30], image[0:4, 0:4] = 200, 210, 255
    RunningDetection(BlobSettings()).find(image, 0.0)


@dataclass
class RunningDetection:
    """Finds blobs in one image after the other, as `detect` does in a whole recording, by what the past shows.

    settings  as off line; where they have no threshold, it is learnt: see `LearningRules`
    empty     s from the first image on during which nobody is in view; what shines in nearly all images of them (`static_mask`) is masked
              from then on. 0: nothing is masked

    The first image has the thresholds that suit it alone. O(pixels) an image, 24 images of memory.
    """

    settings: BlobSettings
    empty: float = 0.0
    _learnt: deque[tuple[float, Grey]] = field(default_factory=lambda: deque(maxlen=CHECKS.sampled))
    """(s, image) from which thresholds are learnt."""
    _range: tuple[float, float] = (np.inf, -np.inf)
    """Least and greatest mean grey value of these."""
    _step: float = LEARNING.first_s
    _begin: float | None = None
    _current: BlobSettings = field(init=False)
    _mask: NDArray[np.bool_] | None = None
    _masks: bool = field(init=False)

    def __post_init__(self) -> None:
        self.settings.check()
        self.settings = replace(self.settings, quick=True)
        self._current, self._masks = self.settings, self.empty > 0

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) px of the camera's images; None before the first."""
        return None if not self._learnt else (self._learnt[0][1].shape[1], self._learnt[0][1].shape[0])

    @property
    def threshold(self) -> float | None:
        """Grey values above the background that a blob's pixels exceed; None where each image has its own."""
        return self._current.threshold

    @property
    def masked(self) -> float:
        """Share of the image under the mask."""
        return 0.0 if self._mask is None else float(self._mask.mean())

    def find(self, image: ArrayLike, time: float) -> RunningBlobs:
        """The blobs of the next image, (H, W) grey or (H, W, 3) BGR; time: s on the camera's clock.

        Raises AsterismError where it is no image, or of another size or depth than those before it: a rig is of one size.
        """
        grey = grey_of_colour(np.asarray(image))
        if self._learnt and (grey.shape != self._learnt[0][1].shape or grey.dtype != self._learnt[0][1].dtype):
            first = self._learnt[0][1]
            raise AsterismError(f"an image of {size_text(grey)} {grey.dtype} after images of {size_text(first)} {first.dtype}.")
        few = grey[:: RULES.every, :: RULES.every]
        brightness = float(few.mean())
        self._learn(grey, brightness, time)
        self._mask_lights(time)
        blobs = find_blobs(grey, self._current)
        whole = (blobs.flags & Flag.AT_BORDER) == 0
        crowded = int(whole.sum()) > MOST_BLOBS
        if crowded:
            # The heaviest, in their order.
            whole[np.argsort(np.where(whole, -blobs.weight, np.inf), kind="stable")[MOST_BLOBS:]] = False
        kept = ImageBlobs(**{name: column[whole] for name, column in vars(blobs).items()})
        saturated = float((few >= saturated_from(grey)).mean())
        return RunningBlobs(kept, int((blobs.flags & Flag.AT_BORDER > 0).sum()), brightness, saturated, crowded)

    def _learn(self, grey: Grey, brightness: float, time: float) -> None:
        """Take the image into what is learnt from, where it is due or the light has changed."""
        # A clock that was set back begins the waiting anew.
        since = np.inf if not self._learnt or time < self._learnt[-1][0] else time - self._learnt[-1][0]
        jumped = not self._range[0] - LEARNING.jump <= brightness <= self._range[1] + LEARNING.jump
        if since >= self._step or jumped:
            self._begin = time if self._begin is None else self._begin
            if len(self._learnt) == CHECKS.sampled and self._step < LEARNING.every_s:
                # Every other one, so that those that are left are spread over all that has passed.
                self._learnt = deque(list(self._learnt)[::2], maxlen=CHECKS.sampled)
                self._step *= 2.0
            self._learnt.append((time, grey.copy()))
            known = len(self._learnt)
            # Learnt at 1, 2, 4, 8, 16 and 24 images: those between hardly change what is known, and to learn takes as long as ten searches.
            if not jumped and known & (known - 1) and known < CHECKS.sampled:
                return
            some = [image for _, image in self._learnt]
            means = [float(image[:: RULES.every, :: RULES.every].mean()) for image in some]
            self._range = (min(means), max(means))
            self._current = replace(common_thresholds(some, self.settings)[0], mask=self._both_masks())

    def _mask_lights(self, time: float) -> None:
        """Mask what has shone in the empty room, as soon as that is over."""
        if self._masks and self._begin is not None and time - self._begin >= self.empty and len(self._learnt) >= CHECKS.min_to_mask:
            some = [image for _, image in self._learnt]
            self._mask = static_mask(some, threshold=self._current.threshold, background=self._current.background)
            self._current, self._masks = replace(self._current, mask=self._both_masks()), False

    def _both_masks(self) -> ArrayLike | None:
        if self._mask is None or self.settings.mask is None:
            return self.settings.mask if self._mask is None else self._mask
        return self._mask | np.asarray(self.settings.mask, dtype=np.bool_)
