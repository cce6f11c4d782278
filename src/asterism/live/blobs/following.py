"""Blobs of one camera's last images in; the same blobs at an instant between two of them, out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from asterism.live.blobs._follow_kernels import link_blobs
from asterism.recording import Floats, Ints
from asterism.synchronization.common_clock import RULES


@dataclass(eq=False)
class FollowedImage:
    """The blobs of an image with the blob of the image before that each of them was.

    time      s on the common clock
    arrived   s on this machine's clock
    xy        (n, 2) px
    sizes     (n,) px, NaN where unknown
    before    (n,) the blob of the image before, -1 where none is clear
    velocity  (n, 2) px/s from there to here; 0 where there is none
    """

    time: float
    arrived: float
    xy: Floats
    sizes: Floats
    before: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    velocity: Floats = field(default_factory=lambda: np.empty((0, 2)))


def follow(last: FollowedImage | None, image: FollowedImage, longest: float) -> None:
    """Link an image to the one before, as `synchronization.common_clock.link` does, with the past only. longest: s between linked images.

    A blob is sought where the speed of its own path leads; it is linked where that is clear: nearest both ways, no second one near, and no
    further off than most are. O(n * m).
    """
    image.before, image.velocity = np.full(len(image.xy), -1), np.zeros((len(image.xy), 2))
    if last is None or not len(last.xy) or not len(image.xy) or not 0 < image.time - last.time <= longest:
        return
    step = image.time - last.time
    ways = last.xy + step * last.velocity
    link_blobs(ways, image.xy, RULES.clear, RULES.near_px, RULES.spreads, image.before)
    linked = np.flatnonzero(image.before >= 0)
    image.velocity[linked] = (image.xy[linked] - last.xy[image.before[linked]]) / step


def between(before: FollowedImage | None, start: FollowedImage, end: FollowedImage, instant: float) -> tuple[Floats, Floats]:
    """The blobs (n, 2) px and sizes (n,) px of a camera at an instant between two of its images; those that have no link are left out.

    before: the image before the two. On the parabola through three images where the path has them, else on the line through two.
    """
    linked = np.flatnonzero(end.before >= 0)
    first = end.before[linked]
    share = (instant - start.time) / (end.time - start.time)
    xy = (1 - share) * start.xy[first] + share * end.xy[linked]
    sizes = (1 - share) * start.sizes[first] + share * end.sizes[linked]
    if before is not None and len(start.before):
        earlier = start.before[first]
        known = earlier >= 0
        # Newton's third term: what the speed changed by between the two pairs of images.
        bend = (end.velocity[linked[known]] - start.velocity[first[known]]) / (end.time - before.time)
        xy[known] += bend * (instant - start.time) * (instant - end.time)
    return xy, sizes
