"""Footage of a calibration target in; where each camera saw it out."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from asterism.calibration.boards.views import BoardViews
from asterism.calibration.coded_target import target_views
from asterism.garment.capture import Reader
from asterism.garment.footage import ColourFootage
from asterism.garment.pattern import Pattern
from asterism.garment.target import coded_target
from asterism.progress import Progress

_TOGETHER = 8
"""Moments whose images are in memory together."""


def find_target(
    footage: ColourFootage, pattern: Pattern, read: Reader, *, every: int = 1, workers: int = 1, progress: Progress | None = None
) -> BoardViews:
    """Read a target in all images of all cameras.

    read   what one image shows; called from several threads where there are several workers
    every  read each n-th moment only

    The result does not depend on the number of workers. Raises AsterismError where the pattern is of several pieces, or no image shows six
    circles of it that are not in a line.
    """
    target = coded_target(pattern)
    chosen = islice(footage, 0, None, every)
    numbers: list[int] = []
    seen: list[list[Any]] = []
    sizes: dict[int, tuple[int, int]] = {}
    with ThreadPoolExecutor(max(1, workers)) as pool:
        # Only so many images are in memory at a time.
        while batch := list(islice(chosen, _TOGETHER)):
            images = [image for _, group in batch for image in group if image is not None]
            done = iter(pool.map(read, images) if workers > 1 else map(read, images))
            for number, group in batch:
                for c, image in enumerate(group):
                    if image is not None:
                        sizes.setdefault(c, (int(image.shape[1]), int(image.shape[0])))
                numbers.append(number)
                seen.append([None if image is None else next(done) for image in group])
            if progress is not None:
                progress(min(1.0, len(numbers) * every / len(footage)), f"looking for the target, frame {numbers[-1]}")
    views = target_views(target, seen, footage.names, [sizes.get(c, (0, 0)) for c in range(len(footage.names))])
    return replace(views, frames=np.array(numbers, dtype=np.int64)[views.frames], findings=getattr(footage, "findings", ()))
